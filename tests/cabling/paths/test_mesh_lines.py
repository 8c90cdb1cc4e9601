"""Cables on lines of the mesh, or beside them: the equilibrium does not know of the lines.

A cable on a line presses a valley into it, in which no string would move; its forces sideways tell
that it is held there. The square is 100 wide, clamped, E t = 24, nu = .25, pressure .01. Meshes
that have no line where the cables lie converge to the values REFERENCE.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from cabled_square import CABLE, PRESSURE, clamped, order, place, sheet

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.verification.doubts import tension_range
from crms_fenicsx.cabling.contact.contact_force import contact_forces, directions, turns
from crms_fenicsx.cabling.paths import held_vertices as held
from crms_fenicsx.cabling.paths.held_vertices import held_runs, held_vertices
from crms_fenicsx.cabling.paths.vertex_trials import VertexTrials

REFERENCE = {"T": 103.0532, "y": 29.60632, "W": -298.76483}
"""Of a cable from (0, 30) to (100, 30) with L0 = 100, as in `test_sliding`."""


def route(start, end, aside: float, h: float) -> list[tuple[float, float]]:
    """From start to end, with a detour by some cells to either side."""
    a, b = np.array(start, float), np.array(end, float)
    left = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
    middle = [a + 0.3 * (b - a) + aside * h * left, a + 0.7 * (b - a) - 0.6 * aside * h * left]
    return [tuple(p) for p in (a, *middle, b)]


def laid(comm, mesh, path, L0: float, way: str, friction: float = 0.0):
    """The cable, laid and inflated in one of several ways; returns its scene and the solver."""
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    solver = Solver(scene)
    cable = Cable(32000.0, friction=friction)
    if way == "after":
        solver.advance(pressure=PRESSURE)
    if way == "detour":
        h = 100.0 / np.sqrt(mesh.mesh.topology.index_map(2).size_global / 2)
        path = route(path[0], path[-1], 2.7, h)
    scene.lay_cable(cable, path, L0=L0)
    if way == "beyond and back":
        solver.advance(pressure=3 * PRESSURE)
    if way == "away and back":
        solver.advance(pressure=PRESSURE)
        (laid,) = scene.cables
        solver.advance(move={laid.start: (0.0, 6.0, 0.0)})
        solver.advance(move={laid.start: (0.0, -6.0, 0.0)})
    solver.advance(pressure=PRESSURE, steps=3 if way == "steps" else 1)
    return scene, solver


def lined(comm, kind: str, n: int):
    """A mesh of n cells a side with lines at multiples of 100/n, or without structure."""
    if kind == "structured":
        return meshes.rectangle(comm, 100.0, 100.0, 100.0 / n, structured=True)
    if kind == "unstructured":
        return meshes.rectangle(comm, 100.0, 100.0, 100.0 / n)
    x = np.linspace(0.0, 100.0, n + 1)
    corners = np.array([(a, b, 0.0) for b in x for a in x])
    middles = np.array([(a, b, 0.0) for b in (x[1:] + x[:-1]) / 2 for a in (x[1:] + x[:-1]) / 2])
    cells = []
    for k in range(n * n):
        a = k // n * (n + 1) + k % n
        ring = (a, a + 1, a + n + 2, a + n + 1, a)
        cells += [(p, q, len(corners) + k) for p, q in pairwise(ring)]
    points = np.concatenate([corners, middles])
    return meshes.from_arrays(comm, points, np.array(cells))


WAYS = ("straight", "detour", "after", "steps", "beyond and back", "away and back")


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["structured", "crossed", "unstructured"])
def test_one_equilibrium_whatever_the_way(comm, kind: str) -> None:
    """The line y = 30 is one of the meshes with structure; all ways end beside it."""
    mesh = lined(comm, kind, 20)
    found = []
    for way in WAYS:
        scene, solver = laid(comm, mesh, [(0, 30), (100, 30)], 100.0, way)
        found.append((scene.energy, scene.cables[0].tension, *place(scene.cables[0], 50.0)))
        before = scene.energy, scene.cables[0].tension
        again = solver.advance(pressure=PRESSURE)
        np.testing.assert_allclose((scene.energy, scene.cables[0].tension), before, rtol=1e-9)
        assert again.outcome.evaluations <= 5
    np.testing.assert_allclose(found, found[0] * np.ones((len(WAYS), 1)), rtol=1e-7)
    assert found[0][1] == pytest.approx(REFERENCE["T"], rel=2e-3)
    assert found[0][3] == pytest.approx(REFERENCE["y"], abs=0.02 * 5.0)


@pytest.mark.parametrize("start", [(0, 20), (0, 35)])
def test_along_diagonals(comm, start) -> None:
    end = (100.0 - start[1], 100.0)
    mesh = lined(comm, "structured", 20)
    L0 = float(np.linalg.norm(np.subtract(end, start)))
    energies = [laid(comm, mesh, [start, end], L0, way)[0].energy for way in WAYS[:3]]
    np.testing.assert_allclose(energies, energies[0], rtol=1e-9)


def test_it_converges_with_order_two(comm) -> None:
    errors = []
    sizes = (10, 20, 40)
    for n in sizes:
        scene, _ = laid(comm, lined(comm, "structured", n), [(0, 30), (100, 30)], 100.0, "straight")
        y = place(scene.cables[0], 50.0)[1]
        errors.append((scene.cables[0].tension - REFERENCE["T"], scene.energy - REFERENCE["W"]))
        assert y == pytest.approx(REFERENCE["y"], abs=0.02 * 100.0 / n)
    T, W = np.array(errors).T
    assert order([1 / n for n in sizes], T) > 1.9 and order([1 / n for n in sizes], W) > 1.9
    assert abs(T[-1]) < 1e-3 * REFERENCE["T"]


def test_a_tie_stays_one(comm) -> None:
    """On the line of symmetry the cable stays on its vertices."""
    for kind in ("structured", "crossed"):
        mesh = lined(comm, kind, 16)
        scene, _ = laid(comm, mesh, [(0, 50), (100, 50)], 100.0, "straight")
        assert {node.kind for node in scene.cables[0].state.nodes[1:-1]} == {"vertex"}


@pytest.mark.ranks
def test_a_cable_that_a_line_holds_is_doubtful(comm, monkeypatch) -> None:
    """Kept from leaving the line, though nothing is out of balance; it ends no run. The warning
    gives a range of its tension, which contains that of the cable that has left the line."""
    mesh = lined(comm, "structured", 20)
    path = [(0, 30), (100, 30)]
    scene, _ = laid(comm, mesh, path, 100.0, "straight")
    (free,) = scene.cables
    assert not scene.warnings
    monkeypatch.setattr(VertexTrials, "next", lambda *_: [])
    scene, solver = laid(comm, mesh, path, 100.0, "straight")
    (cable,) = scene.cables
    low, high = tension_range(cable, scene.net.strip_shape())
    assert low < free.tension < high == cable.tension
    (told,) = scene.warnings
    assert f"{cable.name!r} is between {low:.3g} and {high:.3g}" in told.text
    (step,) = solver.steps
    assert step.halvings == 0 and step.verification is not None
    check = step.verification["held by a line of the mesh"]
    assert check.where == "cable 1" and check in step.verification.doubtful


FLAT = {
    "rigid": ((0, 50), (40, 57), (100, 50)),
    "rigid, below": ((0, 50), (40, 43), (100, 50)),
    "rigid, diagonal": ((0, 0), (40, 52), (100, 100)),
    "rigid, beside lines": ((0, 47), (40, 60), (100, 47)),
    "free inside": ((0, 50), (40, 57), (100, 50)),
    "two that cross": ((0, 50), (40, 57), (100, 50)),
}


@pytest.mark.ranks
@pytest.mark.parametrize("unit", [1.0, 1e-3])
@pytest.mark.parametrize("case", FLAT)
def test_on_a_flat_sheet_a_cable_is_straight(comm, case: str, unit: float) -> None:
    """Laid askew and tightened, it has T = EA (d / L0 - 1) and presses on nothing."""
    mesh = meshes.rectangle(comm, 100.0 * unit, 100.0 * unit, 10.0 * unit, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=1e6, nu=0.3, thickness=0.08 * unit))
    scene.fix("boundary" if case == "free inside" else lambda x: np.full(x.shape[1], True))
    path = unit * np.array(FLAT[case], float)
    d = float(np.linalg.norm(path[-1] - path[0]))
    cables = [scene.lay_cable(Cable(EA=1.0), path)]
    if case == "two that cross":
        across = unit * np.array([(50.0, 0.0), (43.0, 70.0), (50.0, 100.0)])
        cables.append(scene.lay_cable(Cable(EA=1.0), across))
    solver = Solver(scene)
    for shorter, rtol in ((0.005, 3e-4), (0.03, 5e-5)):
        solver.advance(L0={cable: (1 - shorter) * d for cable in cables})
        for cable in cables:
            assert cable.tension == pytest.approx(1 / (1 - shorter) - 1, rel=rtol)
            assert cable.length == pytest.approx(d, rel=2e-6)
        last = solver.steps[-1]
        assert last.halvings == 0
        assert last.verification is not None and not last.verification.doubtful


@pytest.mark.ranks
def test_crossing_cables_on_lines(comm) -> None:
    """A net that is all on lines ends where one laid beside them does."""
    found = []
    for aside in (0.0, 1.7):
        scene = sheet(comm, 10, "structured")
        for layer, (a, b) in enumerate([((30, 0), (30, 100)), ((0, 40), (100, 40))]):
            path = [a, b] if aside == 0.0 else route(a, b, aside, 10.0)
            scene.lay_cable(CABLE, path, L0=100.3, layer=layer)
        Solver(scene).advance(pressure=PRESSURE)
        found.append([scene.energy, *(cable.tension for cable in scene.cables)])
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-4)
    np.testing.assert_allclose(found[0][1:], found[1][1:], rtol=5e-3)


def polar_dome(comm, rings: int, angle: float):
    """A cap of radius 20 and 80 degrees; lines of the mesh are meridians, turned by an angle."""
    around = 3 * rings
    r = np.radians(40.0) * np.arange(1, rings + 1) / rings
    t = np.arange(around) * 2 * np.pi / around + np.radians(angle)
    polar = [(a, b) for a in r for b in t]
    points = [(0.0, 0.0, 20.0)] + [
        (20 * np.sin(a) * np.cos(b), 20 * np.sin(a) * np.sin(b), 20 * np.cos(a)) for a, b in polar
    ]
    cells = [(0, 1 + k, 1 + (k + 1) % around) for k in range(around)]
    for i in range(rings - 1):
        for k in range(around):
            a, b = 1 + i * around + k, 1 + i * around + (k + 1) % around
            cells += [(a, a + around, b), (b, a + around, b + around)]
    return clamped(
        meshes.from_arrays(comm, np.array(points), np.array(cells)),
        IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3),
    )


def test_meridians_of_a_dome(comm) -> None:
    """A tight cable along lines of a cap's mesh, and across the cells of the same mesh turned.

    Both as long as on the facets: on the smooth surface the one across cells comes nearer to its
    end on the fine mesh, 11.97 kN, than the one along lines, and so they differ by more.
    """
    apart = []
    for rings in (6, 12):
        found = []
        for angle in (0.0, 5.0):
            scene = polar_dome(comm, rings, angle)
            cable = scene.lay_cable(
                Cable(30e3), [(-12.8, 0.0), (12.8, 0.0)], tension=50.0, measured_on="facets"
            )
            Solver(scene).advance(pressure=0.4)
            found.append(cable.tension)
        apart.append(abs(found[1] / found[0] - 1.0))
    assert apart[1] < apart[0] / 2 and apart[1] < 0.01


def test_what_the_mesh_holds_is_not_friction(comm) -> None:
    """With hardly any friction a cable on a line ends where it does without."""
    for kind in ("structured", "crossed"):
        mesh = lined(comm, kind, 20)
        free, rough = (
            laid(comm, mesh, [(0, 30), (100, 30)], 100.0, "straight", friction=mu)[0]
            for mu in (0.0, 1e-3)
        )
        assert rough.energy == pytest.approx(free.energy, rel=2e-6)
        assert rough.cables[0].tension == pytest.approx(free.cables[0].tension, rel=5e-5)


def glued(comm, monkeypatch, n: int = 10):
    """A cable that is held by the line on which it was laid; without verification."""
    monkeypatch.setattr(VertexTrials, "next", lambda *_: [])
    scene = sheet(comm, n, "structured")
    cable = scene.lay_cable(CABLE, [(0, 30), (100, 30)], L0=100.0)
    Solver(scene, verify=False).advance(pressure=PRESSURE)
    return cable, scene.net.strip_shape()


def test_directions_at_vertices_halve_the_angle_of_the_two_sides(comm, monkeypatch) -> None:
    """Cell by cell: where the plane square to the cable cuts the cells around the vertex."""
    cable, shape = glued(comm, monkeypatch)
    turned = turns(cable)
    nodes = [k for k in turned if cable.state.nodes[k].kind == "vertex"]
    before, after = (np.array([turned[k][i] for k in nodes]) for i in (0, 1))
    up, left = directions(cable, nodes, shape, before, after)
    for k, along, own_up, own_left in zip(nodes, before + after, up, left, strict=True):
        (vertex,) = cable.state.nodes[k].point.support
        along = along / np.linalg.norm(along)
        outside = shape.normal((vertex,))
        ways = {1: np.zeros(3), -1: np.zeros(3)}
        for row in shape.strip.outer_rows((vertex,)):
            a, b = (shape.at(v) - shape.at(vertex) for v in shape.strip.corners[row] if v != vertex)
            a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
            if (a @ along) * (b @ along) <= 0.0:
                way = a * abs(b @ along) + b * abs(a @ along)
                ways[1 if way @ np.cross(outside, along) > 0.0 else -1] += way
        expected = sum(side * way / np.linalg.norm(way) for side, way in ways.items())
        expected /= np.linalg.norm(expected)
        np.testing.assert_allclose(own_left, expected, atol=1e-12)
        np.testing.assert_allclose(own_up, np.cross(along, expected), atol=1e-12)


def test_forces_of_held_vertices(comm, monkeypatch) -> None:
    """Their sum tells how far the cable is from its place: 0.1 of the force that presses."""
    cable, shape = glued(comm, monkeypatch)
    forces = contact_forces(cable, shape)
    found = held_vertices(cable, shape)
    assert [one.vertex for one in found] == [
        node.point.support[0] for node in cable.state.nodes if node.kind == "vertex"
    ]
    for one in found:
        assert one.pull == pytest.approx(forces.lateral[list(one.nodes)].sum(), rel=1e-12)
    (run,) = held_runs(cable, shape)
    assert run.vertices == tuple(one.vertex for one in found[1:-1])
    press = sum(forces.normal[list(one.nodes)].sum() for one in found[1:-1])
    assert 0.08 < run.excess / press < 0.13
    assert not run.to_left  # to y < 30, as it goes to x = 100


def test_the_string_between_the_ends_of_a_run() -> None:
    """Against the solution of its equations: T w'' = -f."""
    rng = np.random.default_rng(3)
    places = np.sort(rng.uniform(0.0, 10.0, 9))
    forces = rng.normal(size=7)
    steps = np.diff(places)
    K = np.diag(1 / steps[1:] + 1 / steps[:-1])
    K -= np.diag(1 / steps[1:-1], 1) + np.diag(1 / steps[1:-1], -1)
    np.testing.assert_allclose(
        held.string_displacements(places, forces), np.linalg.solve(K, forces), atol=1e-12
    )
