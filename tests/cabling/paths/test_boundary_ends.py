"""Ends of cables that are moved: along the boundary, off it, through the air and back."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import CABLE, KINDS, PRESSURE, advanced, clamped, place, put, sheet
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.cabling.paths.boundary_ends import renew_ends
from crms_fenicsx.cabling.paths.path_change import PathChange

N = 9


def solved(comm, kind: str, path, L0: float) -> tuple[Scene, LaidCable, Solver]:
    """A cable on the inflated square."""
    scene = sheet(comm, N, kind)
    cable = scene.lay_cable(CABLE, path, L0=L0)
    solver = advanced(Solver(scene), pressure=PRESSURE)
    return scene, cable, solver


def assert_same(found: tuple[Scene, LaidCable], fresh: tuple[Scene, LaidCable], rel: float) -> None:
    """The same but for the side on which a vertex is passed, on this coarse mesh."""
    assert found[0].energy == pytest.approx(fresh[0].energy, rel=rel)
    assert found[1].tension == pytest.approx(fresh[1].tension, rel=rel)
    np.testing.assert_allclose(place(found[1], 50.0), place(fresh[1], 50.0), atol=0.05 * 100 / N)


@pytest.mark.ranks
@pytest.mark.parametrize("kind", KINDS)
def test_ends_dragged_along_the_boundary(comm, kind: str) -> None:
    """Over vertices of the boundary, and back, the cable ends in the state of one laid there."""
    first, cable, solver = solved(comm, kind, [(0, 30), (100, 30)], 100.0)
    before = (first.energy, cable.tension)
    solver.advance(move={cable: (0, 20, 0)}, steps=2)
    assert cable.ends == ("held", "held")
    np.testing.assert_allclose(cable.state.positions[[0, 1]], [[0, 50, 0]] * 2, atol=1e-9)
    fresh = solved(comm, kind, [(0, 50), (100, 50)], 100.0)
    assert_same((first, cable), fresh[:2], 1e-4)
    solver.advance(move={cable: (0, -20, 0)}, steps=2)
    assert (first.energy, cable.tension) == pytest.approx(before, rel=1e-4)


def test_ends_moved_over_many_cells_at_once(comm) -> None:
    """In one step they come to cells that no cable has been near before."""
    scene, cable, solver = solved(comm, "structured", [(0, 20), (100, 20)], 100.0)
    solver.advance(move={cable: (0, 60, 0)})
    np.testing.assert_allclose(
        cable.state.positions[[0, -1]], [[0, 80, 0], [100, 80, 0]], atol=1e-9
    )
    fresh = solved(comm, "structured", [(0, 80), (100, 80)], 100.0)
    assert_same((scene, cable), fresh[:2], 1e-4)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("movement", "stays"), [((-4, 0, -2), True), ((0, 4, -2), False), ((0, -4, -2), False)]
)
def test_an_end_moved_aside_lays_its_cable_anew(comm, movement, stays: bool) -> None:
    """Also one that was held on the boundary, where two points of the cable coincide."""
    scene, cable, _ = solved(comm, "structured", [(0, 30), (100, 30)], 100.0)
    assert cable.state.memory.path_is_geodesic and cable.ends == ("held", "held")
    put(cable, "positions", 0, cable.state.positions[0] + movement)
    renew_ends(PathChange(scene.net))
    assert cable.state.memory.path_is_geodesic == stays


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["structured", "unstructured"])
def test_ends_moved_off_and_through_the_air(comm, kind: str) -> None:
    scene, cable, solver = solved(comm, kind, [(0, 30), (100, 30)], 100.0)
    solver.advance(move={cable.start: (-5, 0, 0), cable.end: (5, 0, 0)}, L0={cable: 110.0}, steps=2)
    assert cable.ends == ("off", "off")
    assert {cable.state.nodes[1].kind, cable.state.nodes[-2].kind} == {"edge slider"}
    solver.advance(move={cable: (0, 15, 0)}, steps=3)
    fresh = solved(comm, kind, [(-5, 45, 0), (105, 45, 0)], 110.0)
    assert_same((scene, cable), fresh[:2], 1e-2)
    # lifted high and put down again the cable has found its way over other cells
    solver.advance(move={cable: (0, 0, 10)}, steps=2)
    assert cable.state.lifted.any()
    solver.advance(move={cable: (0, 0, -10)}, steps=2)
    assert_same((scene, cable), fresh[:2], 1e-2)


def test_an_end_that_comes_back_is_held_again(comm) -> None:
    scene, cable, solver = solved(comm, "unstructured", [(0, 30), (100, 30)], 100.0)
    before = (scene.energy, cable.tension)
    solver.advance(move={cable.start: (-4, 0, 0)}, L0={cable: 104.0})
    assert cable.ends == ("off", "held")
    solver.advance(move={cable.start: (4, 0, 0)}, L0={cable: 100.0})
    assert cable.ends == ("held", "held") and cable.state.nodes[1].kind == "tied"
    assert (scene.energy, cable.tension) == pytest.approx(before, rel=1e-4)


@pytest.mark.ranks
@pytest.mark.parametrize("last", [False, True])
def test_an_anchor_moved_over_the_membrane_and_back(comm, last: bool) -> None:
    """The path's end follows it from cell to cell; left behind it would lead there and back."""
    ends = [(-2.5, 76.0, 0.2), (101.6, 7.8, 2.8)]
    scene, cable, solver = solved(comm, "structured", ends[::-1] if last else ends, 123.0)
    before = (scene.energy, cable.tension)
    solver.advance(move={cable.end if last else cable.start: (4.6, 8.0, 0.0)})
    assert cable.ends == (("off", "held") if last else ("held", "off"))
    solver.advance(move={cable.end if last else cable.start: (-4.6, -8.0, 0.0)})
    assert cable.ends == ("off", "off")
    assert (scene.energy, cable.tension) == pytest.approx(before, rel=1e-7)


def test_an_anchor_moved_far_over_the_membrane(comm) -> None:
    """Over many cells at once, the path's end follows to where it is that of a new cable."""
    ends = [(-2.5, 76.0, 9.0), (101.6, 7.8, 2.8)]
    scene, cable, solver = solved(comm, "structured", ends, 126.0)
    solver.advance(move={cable.start: (12.0, 0.0, 0.0)})
    solver.advance(move={cable.start: (-2.0, -40.0, 0.0)}, L0={cable: 102.0})
    fresh, there, _ = solved(comm, "structured", [(7.0, 36.0, 9.0), ends[1]], 102.0)
    assert scene.energy == pytest.approx(fresh.energy, rel=5e-3)  # as it lifts off earlier
    assert set(cable.state.nodes[1].point.support) == set(there.state.nodes[1].point.support)


def test_anchors_pulled_up_from_the_boundary_keep_their_slack_cable(comm) -> None:
    """However steeply they rise, the path's ends stay below them, and the cable slack."""
    scene, cable, solver = solved(comm, "unstructured", [(0, 30), (100, 30)], 140.0)
    free = scene.energy
    for _ in range(2):
        solver.advance(move={cable.start: (0.5, 0, 9.0), cable.end: (-0.5, 0, 9.0)})
        assert not cable.taut and scene.energy == pytest.approx(free, rel=1e-6)
        shape = scene.net.strip_shape()
        for k, x in ((1, 0.0), (-2, 100.0)):
            foot = shape.mean(*cable.state.nodes[k].interpolation())
            assert abs(foot[0] - x) < 100 / N and foot[1] == pytest.approx(30.0, abs=1.0)


@pytest.mark.ranks
@pytest.mark.parametrize("last", [False, True])
def test_an_anchor_moved_off_the_membrane_over_cells_without_cables(comm, last: bool) -> None:
    """The path's end follows it at once to the boundary, where it is that of a new cable."""
    far, near, beyond = (120.0, 53.0, 0.0), (32.0, 51.0, 15.0), (-28.0, 76.0, 5.0)
    ends = [far, near] if last else [near, far]
    scene, cable, solver = solved(comm, "structured", ends, 90.0)
    way = np.subtract(beyond, near)
    solver.advance(move={cable.end if last else cable.start: tuple(way)}, L0={cable: 148.0})
    ends = [far, beyond] if last else [beyond, far]
    fresh, there, _ = solved(comm, "structured", ends, 148.0)
    assert_same((scene, cable), (fresh, there), 1e-3)


@pytest.mark.parametrize("moved", ["the anchor", "the edge"])
def test_an_end_that_comes_to_lie_over_the_membrane_does_not_go_round_by_its_edge(
    comm: MPI.Intracomm, moved: str
) -> None:
    """A just taut cable over a flat sheet stays without tension, and comes back to its edge."""
    foil = IsotropicMembrane(E=1000.0, nu=0.3, thickness=1.0, prestress=2.0)
    scene = sheet(comm, 4, material=foil, side=10.0)
    cable = scene.lay_cable(Cable(5000.0), [(0.0, 4.0), (10.0, 5.5)])
    solver = advanced(Solver(scene))
    what, way = (cable.start, 0.1) if moved == "the anchor" else ("left", -0.1)
    stays = {cable.start: (0.0, 0.0, 0.0)}
    solver.advance(move={**stays, what: (way, 0.0, 0.0)}, steps=2)
    straight = float(np.linalg.norm(cable.line[-1] - cable.line[0]))
    assert cable.length < straight + 1e-4 and cable.tension < 1e-2
    solver.advance(move={**stays, what: (-1.5 * way, 0.0, 0.0)}, steps=2)
    assert cable.tension == pytest.approx(5000.0 * (cable.length / cable.L0 - 1), abs=1e-2)
    assert cable.length == pytest.approx(np.linalg.norm(cable.line[-1] - cable.line[0]), rel=1e-5)


def test_an_end_that_comes_to_lie_under_the_membrane_goes_round_by_its_edge(comm) -> None:
    """In one step and in four, and in another one with the same loads."""
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0)
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.25, structured=True)
    found = []
    for steps in (1, 4):
        scene = clamped(mesh, foil)
        solver = advanced(Solver(scene), pressure=2.0)
        cable = scene.lay_cable(Cable(500.0), [(0.0, 4.3), (10.0, 6.1)])
        stays = {cable.start: (0.0, 0.0, 0.0)}
        solver.advance(move={"left": (-0.1, 0.0, 0.2), **stays}, steps=steps)
        assert cable.state.nodes[1].kind == "edge slider" and cable.state.positions[1][
            0
        ] == pytest.approx(-0.1)
        found += [cable.tension, solver.advance() and cable.tension]
    assert found == pytest.approx([found[0]] * 4, rel=1e-6)
