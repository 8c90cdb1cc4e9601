"""Results at places, as functions, along supports and in sum, against exact values."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from grids import grid
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.design.study.values import displacements
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.results.reactions import held_lengths
from crms_fenicsx.results.summary import ALL_SUPPORTS, OTHER_SUPPORTS

R, P = 5.0, 0.4
"""Radius and pressure of the half cylinder."""
CROWN = np.array([[0.3, 0.8], [-0.2, 1.3], [0.1, 0.55]])
"""Places beside its crown, in plan."""


def half_pipe(
    comm: MPI.Intracomm, n: int, length: float = 2.0, on_one_rank: bool = False
) -> MembraneMesh:
    """Half a cylinder about the y axis, of two parts, "front" and "back"."""
    rows = max(round(n * length / (np.pi * R)), 2)
    angle = np.linspace(0.0, np.pi, n + 1)
    y = np.linspace(0.0, length, rows + 1)
    points = [np.column_stack([-R * np.cos(angle), 0 * angle + v, R * np.sin(angle)]) for v in y]
    a = (np.arange(rows)[:, None] * (n + 1) + np.arange(n)).ravel()
    below, above = np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)
    cells = np.concatenate([below, above])
    ring = np.tile(np.arange(n), 2 * rows)
    edge = np.arange(rows) * (n + 1)
    return meshes.from_arrays(
        comm, np.concatenate(points), cells,
        edges={
            "left": np.stack([edge, edge + n + 1], 1),
            "right": np.stack([edge, edge + n + 1], 1) + n,
        },
        parts={"front": np.flatnonzero(ring < n / 2), "back": np.flatnonzero(ring >= n / 2)},
        ranks=(lambda x: np.full(len(x), comm.size - 1)) if on_one_rank else None,
    )  # fmt: skip


def pipe(
    comm: MPI.Intracomm, n: int = 16, turned: float = 30.0, on_one_rank: bool = False
) -> Solver:
    """A half pipe under pressure, its ends free: hoop force p R, none along it."""
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    fabric = OrthotropicMembrane(
        E1=1e6, E2=1e6, G12=0.5e6, nu21=0.0, thickness=1.0, wrinkling=False,
        warp=lambda x: np.array([c * x[2], 0 * x[0] + s * R, -c * x[0]]),
    )  # fmt: skip
    scene = Scene(half_pipe(comm, n, on_one_rank=on_one_rank), fabric)
    for edge in ("left", "right"):
        scene.fix(edge)
    scene.fix(lambda x: x[2] > -1.0, "y")
    return advanced(Solver(scene), pressure=P)


def test_forces_along_a_turned_warp_at_places(comm: MPI.Intracomm) -> None:
    """Hoop force p R in a warp turned by 30 degrees: cos^2, sin^2 and sin cos of it."""
    errors = []
    for n in (8, 16, 32):
        found = pipe(comm, n).results().at(CROWN)
        exact = P * R * np.array([0.75, 0.25, -np.sqrt(3) / 4])
        values = np.stack([found["warp"], found["weft"], found["shear"]], axis=1)
        errors.append(np.abs(values - exact).max() / (P * R))
    assert errors[-1] < 3e-3
    assert np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0] < -1.7


@pytest.mark.ranks
def test_reactions_per_length(comm: MPI.Intracomm) -> None:
    """Straight down into the ground: p R along the whole edge, at its corners too."""
    errors = []
    for n in (8, 16, 32):
        found = pipe(comm, n).reactions("left")
        every = np.concatenate(comm.allgather(found.per_length))
        assert len(every)
        errors.append(np.abs(every[:, 2] + P * R).max() / (P * R))
    assert errors[-1] < 2e-3
    assert np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0] < -1.7


def test_lengths_of_held_edges_count_by_direction(comm: MPI.Intracomm) -> None:
    """A corner of two edges, of which one slides: each direction has its own length."""
    mesh = meshes.rectangle(comm, 4.0, 4.0, size=1.0, structured=True)
    scene = Scene(mesh, OrthotropicMembrane(1.0, 1.0, 0.5, 0.0, 1.0))
    scene.fix(lambda x: x[0] < 1e-9)
    scene.fix(lambda x: x[1] < 1e-9, "y")
    found = Solver(scene).reactions(lambda x: x[0] + x[1] < 1e-9)
    lengths = held_lengths(scene.membrane)
    X = scene.membrane.stress_free
    corner, side = np.hypot(X[:, 0], X[:, 1]) < 1e-9, (X[:, 0] < 1e-9) & (abs(X[:, 1] - 2) < 0.1)
    np.testing.assert_allclose(lengths[corner], np.tile([0.5, 1.0, 0.5], (corner.sum(), 1)))
    np.testing.assert_allclose(lengths[side], 1.0)
    assert not lengths[X[:, 0] + X[:, 1] > 7.5].any()
    assert not np.isnan(found.per_length).any()
    free = Solver(scene).reactions(lambda x: (x[1] < 1e-9) & (x[0] > 1.5) & (x[0] < 2.5))
    assert np.isnan(free.per_length[:, 0]).all()


def folded(comm: MPI.Intracomm) -> Solver:
    scene = sheet(comm, 5, "unstructured")
    solver = advanced(Solver(scene), pressure=0.01)
    cable = scene.lay_cable(Cable(32000.0), [(0.0, 47.0), (100.0, 52.0)], name="ridge")
    scene.lay_cable(Cable(5.0), [(30.0, 0.0), (35.0, 100.0)], L0=150.0, name="loose")
    solver.advance(L0={cable: 100.4})
    return solver


@pytest.mark.ranks
def test_places_lie_on_the_folded_surface(comm: MPI.Intracomm) -> None:
    """Points of a cable on the membrane are places of it, also when stress-free."""
    solver = folded(comm)
    results, cable = solver.results(), solver.scene.cable("ridge")
    line = cable.line[1:-1]
    found = results.at(line)
    np.testing.assert_allclose(found.positions, line, atol=1e-9)
    in_plan = results.at(line[:, :2])
    np.testing.assert_allclose(in_plan.positions[:, 2], line[:, 2], atol=1e-6)
    back = results.at(found.stress_free, on="stress-free")
    np.testing.assert_allclose(back.positions, found.positions, atol=1e-9)
    inner = np.isfinite(cable.state.reference_positions[:, 0])
    assert inner.sum() >= len(line)
    np.testing.assert_allclose(found.displacement, found.positions - found.stress_free)


def vertices(solver: Solver) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Stress-free and current places of all ranks' vertices by their ids. Collective."""
    membrane, comm = solver.scene.membrane, solver.comm
    n = membrane.V.dofmap.index_map.size_local
    own = (membrane.vertex_ids[:n], membrane.stress_free[:n], membrane.positions()[:n])
    return {int(v): (X, x) for part in comm.allgather(own) for v, X, x in zip(*part, strict=True)}


@pytest.mark.ranks
def test_places_under_a_cable_are_those_of_folded_cells(comm: MPI.Intracomm) -> None:
    """Against triangles of two fold points and the vertex between them, made from the ids alone."""
    solver = folded(comm)
    cable, known = solver.scene.cable("ridge"), vertices(solver)
    rng, points, due = np.random.default_rng(0), [], []
    nodes = [
        (node.point.edge, place)
        for node, place in zip(cable.state.nodes, cable.state.positions, strict=True)
        if isinstance(node.point, EdgePoint)
    ]
    for (one, p), (other, q) in pairwise(nodes):
        ends = [known[vertex] for vertex in {*one} & {*other}]
        corners = [(X, x) for X, x in ends]
        for edge, place in ((one, p), (other, q)):
            (A, a), (B, b) = (known[vertex] for vertex in edge)
            to, on = np.linalg.norm(place - a), np.linalg.norm(place - b)
            corners.append((A + (B - A) * to / (to + on), place))
        for weights in (*rng.dirichlet((1, 1, 1), 3), np.array([0.0, 0.4, 0.6])):
            points.append(weights @ np.array([X for X, _ in corners]))
            due.append(weights @ np.array([x for _, x in corners]))
    assert len(points) > 30
    found = solver.results().at(points, on="stress-free")
    np.testing.assert_allclose(found.positions, due, atol=1e-9)
    moved = displacements(solver.scene, np.array(points))
    np.testing.assert_allclose(moved, found.displacement, atol=1e-12)
    np.testing.assert_allclose(moved, np.array(due) - points, atol=1e-9)


def saddle(comm: MPI.Intracomm) -> Solver:
    """A hypar with a tight cable over its arch, between two lines of the mesh."""
    at = np.linspace(-5.0, 5.0, 8)
    surface = grid(at, at, lambda x, y: 0.04 * (y**2 - x**2), by_rows=True)
    mesh = meshes.from_arrays(comm, *surface)
    scene = clamped(mesh, IsotropicMembrane(E=500.0, nu=0.3, thickness=1.0, prestress=5.0))
    solver = Solver(scene)
    cable = scene.lay_cable(Cable(1e4), [(-5.0, 0.3), (5.0, 0.3)], name="valley")
    solver.advance(L0={cable: 0.985 * cable.L0})
    return solver


def test_summary_knows_the_places_under_cables(comm: MPI.Intracomm) -> None:
    """The lowest one is on the cable; each value is that of the surface at its place."""
    solver = saddle(comm)
    found, results, cable = solver.summary(), solver.results(), solver.scene.cable("valley")
    sunk = (cable.state.positions - cable.state.reference_positions)[:, 2]
    own = solver.scene.u.x.array.reshape(-1, 3)[:, 2]
    vertex = comm.allreduce(float(own.min(initial=0.0)), op=MPI.MIN)
    assert found.lowest.value == pytest.approx(np.nanmin(sunk), rel=1e-9)
    assert found.lowest.value < 1.05 * vertex < 0.0
    assert results.at([found.lowest.at]).displacement[0, 2] == pytest.approx(found.lowest.value)
    assert found.displacement.value >= -found.lowest.value
    for extremes in (found.membrane.least, found.membrane.largest):
        for name, one in extremes.items():
            there = results.at([one.at])
            assert there[name][0] == one.value, name
            np.testing.assert_allclose(there.positions[0], one.at, atol=1e-12)


@pytest.mark.ranks
def test_functions_have_the_values_of_the_cells(comm: MPI.Intracomm) -> None:
    solver = folded(comm)
    solver.scene.set_strengths((10.0, 8.0))
    results = solver.results()
    V = solver.scene.membrane.cell_values
    n = len(results.state)
    for name in results.names:
        function = results.function(name)
        assert function.name == name
        values = function.x.array[V.dofmap.list[:n, 0]]
        np.testing.assert_array_equal(values, results.values(name))
    np.testing.assert_allclose(
        results.function("displacement").x.array, solver.scene.u.x.array, atol=1e-12
    )
    # the slow twin of the means, from all ranks' cells
    mean, W = results.function("true force 1", smooth=True), solver.scene.membrane.nodal_values
    x = solver.scene.membrane.mesh.mesh.geometry.x
    dofmap = geometry_dofmap(solver.scene.membrane.mesh.mesh)
    own = [
        (tuple(np.round(x[corner], 6)), results.true_forces[c, 0], results.stress_free_areas[c])
        for c in range(n)
        for corner in dofmap[c]
    ]
    sums: dict[tuple[float, ...], list[float]] = {}
    for place, value, area in (one for part in comm.allgather(own) for one in part):
        entry = sums.setdefault(place, [0.0, 0.0])
        entry[0] += area * value
        entry[1] += area
    for c in range(n):
        for corner, dof in zip(dofmap[c], W.dofmap.list[c], strict=True):
            total, area = sums[tuple(np.round(x[corner], 6))]
            assert mean.x.array[dof] == pytest.approx(total / area, rel=1e-12)
    # at a vertex, the place's smooth value is the mean there
    place, (total, area) = next(iter(sorted(sums.items())[len(sums) // 2 :]))
    found = results.at([place], on="stress-free", smooth=True)
    assert found["true force 1"][0] == pytest.approx(total / area, rel=1e-7)


@pytest.mark.ranks
@pytest.mark.parametrize("on_one_rank", [False, True])
def test_summary_of_the_pipe(comm: MPI.Intracomm, on_one_rank: bool) -> None:
    """Also where all other ranks have no cell."""
    solver = pipe(comm, on_one_rank=on_one_rank)
    scene = solver.scene
    scene.set_strengths({"front": (4.0, 2.0), "back": (2.0, 2.0)})
    found, results = solver.summary(), solver.results()
    assert sorted(found.parts) == ["", "back", "front"]
    area = sum(found.parts[name].area for name in ("front", "back"))
    assert found.membrane.area == pytest.approx(area, rel=1e-12)
    # p R cos^2(30 degrees) over the strengths in warp
    assert found.parts["front"].largest["utilisation"].value == pytest.approx(0.375, rel=0.1)
    assert found.parts["back"].largest["utilisation"].value == pytest.approx(0.75, rel=0.1)
    every = np.concatenate(comm.allgather(results.warp_weft))
    assert found.membrane.least["shear"].value == every[:, 2].min()
    assert found.membrane.largest["warp"].value == every[:, 0].max()
    at = results.at([found.membrane.largest["warp"].at])
    assert at["warp"][0] == found.membrane.largest["warp"].value
    supports = found.supports
    assert {"left", "right"} < set(supports)
    assert supports["left"].directions == "xyz"
    assert supports["left"].length == pytest.approx(2.0)
    assert supports["left"].mean == pytest.approx(P * R, rel=2e-2)
    # the pressure on the plan of the pipe
    assert supports[ALL_SUPPORTS].total[2] == pytest.approx(-P * 2 * R * 2.0, rel=1e-9)
    assert OTHER_SUPPORTS in supports
    assert found.displacement.value >= found.highest.value > 0.0
    assert found.pressure == P


def test_shares_go_by_the_stress_free_area(comm: MPI.Intracomm) -> None:
    """Strips of the sheet pulled, pulled and narrowed, and pushed: a quarter, a half, a quarter."""
    mesh = meshes.rectangle(comm, 4.0, 4.0, size=1.0, structured=True)
    scene = Scene(mesh, OrthotropicMembrane(1e3, 1e3, 500.0, 0.0, 1.0))
    X = scene.membrane.stress_free
    y = X[:, 1]
    # stretches along y: 1.05 below y = 1, 0.95 to y = 3 ...; along x 1.02 everywhere but the last
    new = np.interp(y, [0.0, 1.0, 3.0, 4.0], [0.0, 1.05, 1.05 + 1.9, 1.05 + 1.9 + 0.9])
    scene.u.x.array[:] = np.column_stack([0.02 * X[:, 0], new - y, 0 * y]).ravel()
    assert Solver(scene).results().shares() == pytest.approx((0.0, 0.75, 0.25))
    scene.u.x.array[:] = np.column_stack([-0.02 * X[:, 0], new - y, 0 * y]).ravel()
    assert Solver(scene).results().shares() == pytest.approx((0.75, 0.25, 0.0))


def test_forces_of_cables(comm: MPI.Intracomm) -> None:
    solver = folded(comm)
    found = solver.cable_forces()
    ridge, loose = found["ridge"], found["loose"]
    cable = solver.scene.cable("ridge")
    assert not ridge.slack
    assert ridge.least == ridge.mean == ridge.largest == cable.tension > 0.0
    assert loose.slack
    assert loose.largest == loose.contact_largest == 0.0
    assert ridge.length == cable.length
    assert ridge.start is not None
    assert np.linalg.norm(ridge.start) == pytest.approx(cable.tension, rel=1e-12)
    # what presses is what turns: the contact force over the length is about T times the angle
    turn = np.diff(cable.line[[0, 1, -2, -1]], axis=0)[[0, 2]]
    angle = np.arccos(np.dot(*(turn / np.linalg.norm(turn, axis=1)[:, None])))
    assert ridge.contact_mean * ridge.length == pytest.approx(cable.tension * angle, rel=0.15)
    assert ridge.contact_largest >= ridge.contact_mean


@pytest.mark.ranks
def test_bad_places_and_names(comm: MPI.Intracomm) -> None:
    solver = folded(comm)
    results = solver.results()
    for points, words in (
        ([(150.0, 50.0)], r"point 0 at \(150, 50\) is 50 off .* nearest to \(100, 50"),
        ([(50.0, 50.0), (-20.0, 50.0)], "point 1"),
        ([(50.0, 50.0, 99.0)], "point 0 at"),
        ([], "places in plan"),
        ([1.0, 2.0], "places in plan"),
        ("here", "places in plan"),
        ([(np.nan, 1.0)], "not finite"),
    ):
        with pytest.raises(InputError, match=words):
            results.at(points)
    with pytest.raises(InputError, match="on = 'plan'"):
        results.at([(50.0, 50.0)], on="plan")  # type: ignore[arg-type]
    for call in (results.function, results.at([(50.0, 50.0)]).__getitem__):
        with pytest.raises(
            InputError, match="no result 'force'; there are 'true force 1', 'true force 2'"
        ):
            call("force")
    with pytest.raises(InputError, match="no result 'utilisation'"):
        results.function("utilisation")
    with pytest.raises(InputError, match="no part 'roof'"):
        results.shares("roof")
    with pytest.raises(InputError, match=r"no strengths; .* scene.set_strengths"):
        results.utilisation()


def test_bad_strengths_leave_those_given_before(comm: MPI.Intracomm) -> None:
    scene = pipe(comm, 8).scene
    scene.set_strengths({"front": (4.0, 2.0)})
    for bad, words in (
        ({"top": (1.0, 1.0)}, "no part 'top'; it has the parts back, front"),
        ({"front": (1.0, -1.0)}, "strength of 'front' = -1.0 is not positive"),
        ((1.0, 2.0, 3.0), "pass two, of warp and weft"),
        ({}, "names no part"),
    ):
        with pytest.raises(InputError, match=words):
            scene.set_strengths(bad)  # type: ignore[arg-type]
    assert {name: one.strength for name, one in scene.membrane.strengths.items()} == {
        "front": (4.0, 2.0)
    }
