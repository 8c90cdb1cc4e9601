"""A cable's own line: what users draw, measure and give back, whatever its way over the mesh is."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced, clamped
from grids import alternating, grid
from mpi4py import MPI

from crms_fenicsx import Cable, Friction, Scene, Solver, meshes
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length

EA = 32000.0
PATHS = {
    "held": [(0.0, 47.0), (100.0, 52.0)],
    "tied": [(12.0, 13.0), (80.0, 71.0)],
    "off": [(40.0, -3.0, 0.0), (61.0, 104.0, 0.0)],
    "far off": [(-80.0, 50.0, 0.0), (180.0, 51.0, 0.0)],
}


def inflated(comm: MPI.Intracomm, *, structured: bool = True) -> tuple[Scene, Solver]:
    return inflated_on(meshes.rectangle(comm, 100.0, 100.0, 12.5, structured=structured))


def inflated_on(mesh: meshes.MembraneMesh) -> tuple[Scene, Solver]:
    scene = clamped(mesh)
    solver = advanced(Solver(scene), pressure=0.01)
    return scene, solver


def tightened(comm: MPI.Intracomm, ends: str, structured: bool) -> tuple[Scene, LaidCable]:
    scene, solver = inflated(comm, structured=structured)
    cable = scene.lay_cable(Cable(EA), PATHS[ends])
    down = 25.0 if ends == "far off" else 6.0
    if cable.ends[0] == "off":
        solver.advance(move={cable: (0.0, 0.0, -down)})
    else:
        solver.advance(L0={cable: 0.99 * cable.L0})
    assert cable.tension > 10.0
    return scene, cable


def straight_over(comm: MPI.Intracomm) -> tuple[Scene, LaidCable]:
    """A cable that touches in the middle only: its way below it takes other lengths."""
    scene, solver = inflated(comm)
    cable = scene.lay_cable(Cable(EA), PATHS["far off"])
    solver.advance(L0={cable: 0.999 * cable.L0})
    assert cable.state.lifted.sum() >= 3
    return scene, cable


@pytest.mark.ranks
@pytest.mark.parametrize("ends", PATHS)
def test_its_length_is_the_cables(comm: MPI.Intracomm, ends: str) -> None:
    scene, cable = tightened(comm, ends, structured=False)
    line = cable.line
    assert polyline_length(line) == pytest.approx(cable.length, rel=1e-12)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).min() > 0.0  # ends are there once
    np.testing.assert_allclose(line[[0, -1]], cable.state.positions[[0, -1]], atol=1e-12)
    assert len(cable.free_spans) == len(cable.tensions) == len(line) - 1
    np.testing.assert_array_equal(cable.tensions, cable.tension)
    if ends != "tied":  # one may lift off right beside its tie
        assert {*cable.free_spans[[0, -1]]} == {"off" in ends}
    assert all(np.array_equal(line, other) for other in scene.comm.allgather(line))
    line[:] = np.nan  # a copy
    assert np.isfinite(cable.state.positions).all()


@pytest.mark.parametrize("along", [0.0, 0.3])
def test_tension_is_what_the_line_says(comm: MPI.Intracomm, along: float) -> None:
    """Also where a point of the cable is held at a vertex, and the segment there is smoothed."""
    line = np.linspace(0.0, 100.0, 7)  # diagonals to and fro: some vertices have eight edges
    surface = grid(line, line, other=~alternating(6, 6), by_rows=True)
    scene, solver = inflated_on(meshes.from_arrays(comm, *surface))
    paths = [(0.0, 18.567), (100.0, 65.378)], [(60.831, 0.0), (40.121, 100.0)]
    friction = Friction(0.3, along=along) if along else 0.3
    cables = [
        scene.lay_cable(Cable(EA, friction=friction), paths[0]),
        scene.lay_cable(Cable(EA), paths[1]),
    ]
    smoothing_length = 0.0
    for loads in ({"L0": {c: 0.99 * c.L0 for c in cables}}, {"pressure": 0.02}):
        solver.advance(**loads)
        for cable in cables:
            length = polyline_length(cable.line)
            assert cable.length == pytest.approx(length, rel=1e-14)
            assert cable.tension == pytest.approx(EA * (length / cable.L0 - 1), rel=1e-8)
            smoothing_length = max(smoothing_length, abs(cable.state.law.smoothing_length))
        strain = sum(c.tension**2 * c.L0 / (2 * EA) for c in cables)
        if not along:
            assert scene.energies["cables"] == pytest.approx(strain, rel=1e-8)
    assert smoothing_length > 1e-6  # of a tension of 29, 3e-5


def test_it_runs_straight_where_the_cable_is_lifted(comm: MPI.Intracomm) -> None:
    scene, cable = straight_over(comm)
    assert polyline_length(cable.line) == pytest.approx(cable.length, rel=1e-12)
    assert len(cable.line) < len(cable.state.nodes)
    assert cable.free_spans[0] and cable.free_spans[-1] and not cable.free_spans.all()
    # the way on the mesh below is marked from node to node, the cable's own line goes on
    assert np.all(np.diff(cable.line[:, 0]) > 0.0)
    touching = ~np.isnan(cable.state.reference_positions[:, 0]) & ~cable.state.lifted
    assert touching.sum() == len(cable.line) - 2
    forces = Solver(scene).contact_forces(cable)
    assert forces.line.shape == forces.normal.shape == (len(cable.line),)
    assert np.isnan(forces.line[[0, -1]]).all() or np.all(forces.normal[[0, -1]] == 0.0)


@pytest.mark.parametrize("structured", [True, False])
@pytest.mark.parametrize("ends", PATHS)
def test_laid_again_it_lies_in_the_same_fold(
    comm: MPI.Intracomm, ends: str, structured: bool
) -> None:
    """The membrane is folded along it, so that its points lie on no straight edge of a cell."""
    scene, cable = tightened(comm, ends, structured)
    again = scene.lay_cable(cable.cable, cable.line)
    back = scene.lay_cable(cable.cable, cable.line[::-1])
    assert again.ends == cable.ends and back.ends == cable.ends[::-1]
    for other, path in ((again, again.path.points), (back, back.path.points[::-1])):
        assert other.length == pytest.approx(cable.length, rel=1e-9)
        if not cable.state.lifted.any():
            assert path == cable.path.points
    np.testing.assert_allclose(again.line, cable.line, atol=1e-9)


def test_laid_again_where_it_is_lifted(comm: MPI.Intracomm) -> None:
    scene, cable = straight_over(comm)
    again = scene.lay_cable(cable.cable, cable.line)
    assert again.length == pytest.approx(cable.length, rel=1e-6)
    assert again.state.lifted.sum() >= 3


@pytest.mark.ranks
def test_laid_again_across_another(comm: MPI.Intracomm) -> None:
    """The point where two cross inside a cell is in the line, but in no path."""
    scene, solver = inflated(comm)
    lower = scene.lay_cable(Cable(EA), [(0.0, 44.0), (100.0, 47.0)])
    upper = scene.lay_cable(Cable(EA), [(44.0, 0.0), (53.0, 100.0)])
    solver.advance(L0={cable: 0.99 * cable.L0 for cable in (lower, upper)})
    assert {node.kind for node in upper.state.nodes} >= {"crossing"}
    again = scene.lay_cable(upper.cable, upper.line)
    assert again.path == upper.path
    assert again.length == pytest.approx(upper.length, rel=1e-4)


def test_a_line_after_the_shape_has_changed_is_a_route_like_others(comm: MPI.Intracomm) -> None:
    scene, cable = tightened(comm, "held", structured=True)
    line = cable.line
    Solver(scene).advance(pressure=0.012)
    again = scene.lay_cable(cable.cable, line)
    assert again.length == pytest.approx(cable.length, rel=1e-2)


@pytest.mark.ranks
def test_tensions_along_it(comm: MPI.Intracomm) -> None:
    """One for each part, also where an anchor lies on the membrane's held edge."""
    scene, solver = inflated(comm)
    cable = scene.lay_cable(Cable(EA, friction=Friction(0.0, along=0.3)), PATHS["held"])
    solver.advance(L0={cable: 0.99 * cable.L0})
    assert len(cable.tensions) == len(cable.line) - 1 == len(cable.part_tensions) - 2
    np.testing.assert_array_equal(cable.tensions, cable.part_tensions[1:-1])
    assert np.linalg.norm(cable.end.reaction) == pytest.approx(cable.tensions[-1], rel=1e-9)
