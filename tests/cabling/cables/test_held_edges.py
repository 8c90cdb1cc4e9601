"""Cables over held edges: their points slide along them, as far as all forces balance."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from cabled_square import advanced, clamped, put, sheet
from mpi4py import MPI
from ridged_square import OBLIQUE, ridged
from scipy.optimize import minimize_scalar
from table_twins import points_by_edge
from taylor import OnMesh, gradient_order, is_semidefinite
from term_scene import ISOTROPIC, directions, displaced, irregular_square

from crms_fenicsx import Cable, LaidCable, PathWarning, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.model.cable_state import CableNode

CABLE = Cable(EA=32000.0)
OVER_THE_RIDGE = [(0.0, 31.0), (50.0, 53.0), (100.0, 64.0)]
"""From edge to edge of the square, across its held middle; not on the shortest way."""


def oblique(
    comm: MPI.Intracomm, shorter: float = 0.01, *, slide: bool = True
) -> tuple[Scene, LaidCable, Solver]:
    """An inflated square under a cable that is anchored off it on both sides."""
    scene = sheet(comm, 4, "unstructured", ISOTROPIC)
    solver = advanced(Solver(scene, slide=slide), pressure=0.01)
    cable = scene.lay_cable(CABLE, OBLIQUE)
    solver.advance(L0={cable: (1 - shorter) * cable.L0}, steps=2)
    return scene, cable, solver


def edge_sliders(cable: LaidCable) -> list[int]:
    return [k for k, node in enumerate(cable.state.nodes) if node.kind == "edge slider"]


def ride(scene: Scene, cable: LaidCable, places: dict[int, float]) -> None:
    """Tie the cable to these places of its edges."""
    nodes = list(cable.state.nodes)
    for k, s in places.items():
        point = nodes[k].point
        assert isinstance(point, EdgePoint)
        nodes[k] = CableNode("tied", EdgePoint(point.edge, s))
    cable.update(nodes=tuple(nodes))
    scene.versions.change_model()


def pull_at(cable: LaidCable, k: int) -> Array:
    """Force of the cable on what it passes at a node."""
    ways = cable.state.positions[[k - 1, k + 1]] - cable.state.positions[k]
    return cable.tension * np.sum(ways / np.linalg.norm(ways, axis=1)[:, None], axis=0)


def kinds(cable: LaidCable) -> str:
    """Initials, without those of the fold points."""
    letters = {"anchor": "a", "fold": "", "edge slider": "-", "tied": "r", "vertex": "v"}
    return "".join(letters[node.kind] for node in cable.state.nodes)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (OVER_THE_RIDGE, "ar-ra"),  # its ends are held at their own places
        (OBLIQUE, "a---a"),
        ([(-40, 15, -5), (100, 64, 0)], "a--ra"),
        ([(30, 40), (80, 60)], "r-r"),  # tied inside
        ([(0, 31), (50, 47.5)], "arra"),  # ends on the ridge
    ],
)
def test_which_points_slide_along_held_edges(comm, path, expected: str) -> None:
    assert kinds(ridged(comm).lay_cable(CABLE, path)) == expected


def test_only_edges_that_are_held_over_their_length_are_edge_sliders(comm) -> None:
    """Held vertices alone let the edges between them fold."""
    scene = Scene(meshes.rectangle(comm, 100.0, 100.0, 25.0), ISOTROPIC)
    scene.fix(lambda x: (x[0] < 1e-9) | (x[0] > 100 - 1e-9))
    cable = scene.lay_cable(CABLE, OBLIQUE)
    assert edge_sliders(cable) == []
    assert [node.kind for node in cable.state.nodes[:2]] == ["anchor", "fold"]


def test_energy_is_least_where_the_edge_slider_is(comm) -> None:
    """Against a search among cables that are tied to places of the edge; the ridge is raised."""
    scene = ridged(comm)
    cable = scene.lay_cable(CABLE, OVER_THE_RIDGE)
    (k,) = edge_sliders(cable)
    first = cable.state.fractions[k]
    solver = advanced(Solver(scene), pressure=0.01, move={"ridge": (0.0, 0.0, 8.0)})
    step = solver.advance(L0={cable: 0.99 * cable.L0})
    assert all(s.halvings == 0 and s.outcome.iterations < 40 for s in solver.steps)
    energy, found = scene.energy, cable.state.fractions[k]
    assert 0.1 < found < 0.9 and abs(found - first) > 0.02

    def tied(s: float) -> float:
        ride(scene, cable, {k: s})
        solver.advance()
        return scene.energy

    assert tied(first) > energy + 1e-3
    width = 0.05
    least = minimize_scalar(tied, bounds=(found - width, found + 0.7 * width), method="bounded")
    # the energy is known to about 1e-11, its second derivative is about T x 20^2 / 30 = 1000
    assert least.x == pytest.approx(found, abs=1e-5)
    assert least.fun == pytest.approx(step.energy, abs=1e-8)


def test_an_oblique_cable_over_a_held_boundary(comm) -> None:
    """It does not pull along the boundary, as it does where it is tied to its first places."""
    scene, cable, solver = oblique(comm, slide=False)
    first = [cable.state.nodes[k].point.fraction for k in edge_sliders(cable)]
    assert cable.tension > 20.0 and len(edge_sliders(cable)) == 2 and cable.blocked == []
    energy, places = scene.energy, {k: float(cable.state.fractions[k]) for k in edge_sliders(cable)}
    assert np.abs(cable.state.positions[edge_sliders(cable), 0] - [0, 100]).max() < 1e-12
    for k in edge_sliders(cable):
        # what is left balances the pressure on the facets beside the point
        assert abs(pull_at(cable, k)[1]) < 1e-3 * cable.tension
        assert np.linalg.norm(pull_at(cable, k)) > 0.01 * cable.tension
    h, slopes = 1e-3, []
    for k in places:
        energies = []
        for way in (h, -h):
            ride(scene, cable, {**places, k: places[k] + way})
            solver.advance()
            energies.append(scene.energy)
        assert min(energies) > energy
        slopes.append((energies[0] - energies[1]) / (2 * h))
    # a slope of a force along the edge of 1e-5 T
    assert np.abs(slopes).max() < 1e-5 * cable.tension * 25.0
    ride(scene, cable, dict(zip(places, first, strict=True)))
    solver.advance()
    assert scene.energy > energy + 1e-4
    assert max(abs(pull_at(cable, k)[1]) for k in places) > 5e-3 * cable.tension


@pytest.mark.ranks
def test_the_number_of_processes_does_not_matter(comm) -> None:
    (apart, cable, _), (alone, twin, _) = oblique(comm), oblique(MPI.COMM_SELF)
    assert cable.tension == pytest.approx(twin.tension, rel=1e-9)
    assert apart.energy == pytest.approx(alone.energy, rel=1e-9)
    np.testing.assert_allclose(cable.state.positions, twin.state.positions, rtol=0, atol=1e-7)
    np.testing.assert_allclose(cable.state.fractions, twin.state.fractions, rtol=0, atol=1e-8)


def spanned(comm: MPI.Intracomm) -> tuple[Scene, LaidCable, Solver]:
    """A cable from both sides of the square, held and tied, straight to its raised middle."""
    scene = ridged(comm)
    solver = advanced(Solver(scene), pressure=0.001, move={"ridge": (0.0, 0.0, 20.0)})
    cable = scene.lay_cable(CABLE, [*OVER_THE_RIDGE[:2], (85.0, 61.0)])
    solver.advance(L0={cable: 0.995 * cable.L0}, move={"ridge": (0.0, 3.0, 1.0)}, steps=2)
    return scene, cable, solver


@pytest.mark.ranks
def test_spans_from_edge_sliders_on_any_number_of_processes(comm) -> None:
    """Their ends may belong to ranks that have no cell of each other's."""
    scene, cable, solver = spanned(comm)
    assert cable.tension > 10.0
    assert kinds(cable) == "ar-r"
    assert cable.state.lifted.sum() >= 3 and edge_sliders(cable)[0] in cable.contacts()
    alone, twin, other = spanned(MPI.COMM_SELF)
    assert scene.energy == pytest.approx(alone.energy, rel=1e-9)
    assert cable.tension == pytest.approx(twin.tension, rel=1e-9)
    np.testing.assert_allclose(cable.state.positions, twin.state.positions, rtol=0, atol=1e-7)
    np.testing.assert_allclose(
        cable.state.reference_positions, twin.state.reference_positions, rtol=0, atol=1e-7
    )
    for group in ("ridge", "boundary"):
        found, expected = solver.reactions(group).total, other.reactions(group).total
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * cable.tension)


def test_supports_carry_what_the_cable_hands_on(comm) -> None:
    scene, cable, solver = oblique(comm)
    anchors = cable.start.reaction + cable.end.reaction
    support = solver.reactions("boundary").membrane
    # the boundary is flat, so the pressure's resultant is that on the square's plan
    np.testing.assert_allclose(support + anchors, [0, 0, -100.0], atol=1e-6)
    assert np.linalg.norm(pull_at(cable, 1)) > 1.0
    # the state is found again, though positions count from where the edge sliders are now
    system = solver.system
    system.read_scene()
    assert system.potential.evaluate() == pytest.approx(scene.energy, rel=1e-13)


def whole(comm: MPI.Intracomm) -> tuple[System, OnMesh]:
    """All terms, with edge sliders, tied points and folds, on a floor."""
    scene = clamped(irregular_square(comm), ISOTROPIC)
    scene.floor(-1.0)
    scene.lay_cable(CABLE, OBLIQUE, tension=20.0)
    scene.lay_cable(Cable(20000.0), [(22, 52, 0), (130, 83, -4)], tension=20.0)
    scene.air.update(pressure=0.01)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    return system, OnMesh(system.unknowns, scene.u, system.potential.terms)


@pytest.mark.ranks
def test_gradient_and_stiffness_of_a_whole_potential(comm) -> None:
    system, f = whole(comm)
    assert (
        comm.allreduce(f.unknowns.n_sliders) >= 3 and comm.allreduce(f.unknowns.n_tied_points) >= 1
    )
    x = displaced(f.unknowns, 0.5)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.05), name
    assert is_semidefinite(f.matrix(x))
    assert {type(term).__name__ for term in system.potential.terms} >= {
        "FoldedMembraneEnergy", "FoldPenalty", "FoldedFollowerPressure",
    }  # fmt: skip


@pytest.mark.ranks
def test_whole_potential_does_not_depend_on_the_number_of_ranks(comm) -> None:
    found = []
    for group in (comm, MPI.COMM_SELF):
        _, f = whole(group)
        x, d = displaced(f.unknowns, 0.5), directions(f.unknowns)["all"]
        energy, g = f.value(x)
        product = f.times(x, d)
        found.append([energy, f.dot(g, g), f.dot(g, d), f.dot(d, product)])
        found[-1] += [f.dot(product, product), f.potential.evaluate_terms()[1]]
    np.testing.assert_allclose(*found, rtol=1e-10)


def test_the_floor_is_not_for_edge_sliders(comm) -> None:
    system, _ = whole(comm)
    bounds, unknowns = system.unknowns.bounds, system.unknowns
    assert bounds is not None
    assert np.all(bounds[0][unknowns.sliders] == -np.inf)
    free = ~unknowns.held.any(axis=1)
    free[unknowns.sliders] = False
    assert np.all(np.isfinite(bounds[0][free, 2]))


def test_an_anchor_may_come_to_an_edge_slider(comm) -> None:
    """The lengths of links to edge sliders are smoothed where they vanish, as to fold points."""
    system, _ = whole(comm)
    assert system.cables is not None and system.cables.tables is not None
    beside = np.isin(system.cables.tables.segments, system.unknowns.sliders).any(axis=1)
    assert np.all(system.cables.tables.eps[beside] > 0)
    assert comm.allreduce(int(beside.sum())) == 6


@pytest.mark.ranks
def test_a_moved_edge_takes_its_edge_slider_along(comm) -> None:
    """Turned and shifted with its edge, the edge slider keeps its place there, slack or taut."""
    scene = ridged(comm)
    cable = scene.lay_cable(CABLE, OVER_THE_RIDGE, tension=20.0)
    (k,) = edge_sliders(cable)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    put(cable, "fractions", k, 0.3)
    on = np.abs(scene.V.tabulate_dof_coordinates()[:, 0] - 50.0) < 1e-9
    y = scene.V.tabulate_dof_coordinates()[:, 1]
    scene.u.x.array.reshape(-1, 3)[on] = np.stack([0 * y, 0.1 * y - 3.0, 4.0 + 0.2 * y], -1)[on]
    point = cable.state.nodes[k].point
    assert isinstance(point, EdgePoint)
    assert system.cables is not None
    # in the order of now, among other points on the edge
    assert points_by_edge(scene.cables)[point.edge] == [(0.3, 0, k)]
    d = np.array([0.0, 1.1, 0.2]) / np.hypot(1.1, 0.2)
    seen = 0
    for taut in (True, False):
        if not taut:
            cable.update(taut=False)
            system.rebuild()
        system.read_scene()
        unknowns, numbering = system.unknowns, system.cables.numbering
        block = numbering.blocks[numbering.numbers[0, k]]
        assert unknowns.n_sliders == (taut and block >= 0)
        if block < 0:
            continue
        unknowns.place_idle_tied_points(system.potential.x)
        ends = unknowns.X + system.potential.x
        a, b = (ends[system.cables.numbering.vertex(v)] for v in point.edge)
        np.testing.assert_allclose(ends[block], a + 0.3 * (b - a), atol=1e-12)
        if taut:
            np.testing.assert_allclose(unknowns.projectors, [np.outer(d, d)], atol=1e-12)
            seen += 1
    assert comm.allreduce(seen) >= 1


def test_a_cable_that_slackens_lets_go_of_its_edge_sliders(comm) -> None:
    scene, cable, solver = oblique(comm)
    places = cable.state.fractions[edge_sliders(cable)].copy()
    taut = scene.energy, cable.tension, cable.state.positions.copy()
    L0 = cable.L0
    solver.advance(L0={cable: 1.1 * L0})
    assert not cable.taut and cable.tension == 0.0
    # found once more from its position, before it slackens
    np.testing.assert_allclose(
        cable.state.fractions[edge_sliders(cable)], places, rtol=0, atol=1e-14
    )
    solver.advance(L0={cable: L0}, steps=2)
    assert scene.energy == pytest.approx(taut[0], rel=1e-9)
    assert cable.tension == pytest.approx(taut[1], rel=1e-9)
    np.testing.assert_allclose(cable.state.positions, taut[2], atol=1e-6)


def test_an_edge_slider_that_runs_into_a_vertex_is_reported(comm) -> None:
    """The anchor is moved along the boundary, beyond the edge that the cable passes."""
    scene, cable, solver = oblique(comm, slide=False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PathWarning)
        solver.advance(move={cable.start: (0.0, -20.0, 0.0)}, steps=2)
    assert edge_sliders(cable)[0] in cable.blocked
    assert all(w.category is PathWarning for w in caught)
    assert bool(caught) == (comm.rank == 0)
    # it stays on the line of its edge, and the state is found again
    assert abs(cable.state.positions[edge_sliders(cable)[0], 0]) < 1e-12
    solver.system.read_scene()
    assert solver.system.potential.evaluate() == pytest.approx(scene.energy, rel=1e-12)
    # beyond its edge's end, but not in the stress-free shape of the cells that it folds
    assert (
        cable.state.fractions[edge_sliders(cable)[0]] < 0
        or cable.state.fractions[edge_sliders(cable)[0]] > 1
    )
    surface = current_surface(scene.net)
    X = surface.stress_free[surface.triangles]
    areas = np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])[:, 2] / 2
    assert areas.min() > -1e-9
    assert comm.allreduce(float(areas.sum())) == pytest.approx(100.0**2, rel=1e-12)


def test_nothing_but_edge_sliders_is_free() -> None:
    """A cable over one triangle that is held around: no force but across the edge sliders."""
    corners = np.array([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (0.0, 10.0, 0.0)])
    mesh = meshes.from_arrays(MPI.COMM_SELF, corners, np.array([[0, 1, 2]]))
    scene = clamped(mesh, ISOTROPIC)
    path = [(-4.0, 2.0, -3.0), (12.0, 5.0, -2.0)]
    cable = scene.lay_cable(CABLE, path, tension=3000.0)
    assert kinds(cable) == "a--a"
    step = Solver(scene).advance()
    assert step.outcome.iterations < 20
    for k, d in ((1, np.array([0.0, 1.0, 0.0])), (2, np.array([-1.0, 1.0, 0.0]) / np.sqrt(2))):
        assert abs(pull_at(cable, k) @ d) < 1e-7 * cable.tension
