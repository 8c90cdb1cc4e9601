"""Cables along lines of the mesh slide sideways, and the stress-free mesh follows: the inflated
square against its reference figures (kgf, cm), and states that no history may change."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from cabled_square import LINEAR, SIDE, clamped, order
from grids import Floats
from mpi4py import MPI
from plain_balance import forces
from same_state import assert_same_state
from sliding_rows import EA, PRESSURE, in_units, oblique, row_places, rowed, rowed_mesh

from crms_fenicsx import Cable, ConvergenceError, InputError, LaidCable, Solver
from crms_fenicsx.analysis.equilibrium.row_sliding import Motions, RowSliding
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene.scene import place_stress_free

T, Y, W = 103.0532, 29.39128, -298.76483
"""Tension, stress-free place of the middle and energy in the limit of fine meshes."""


def middle(cable: LaidCable) -> float:
    """Where the stress-free row passes the middle of the square."""
    places = row_places(cable)
    return float(np.interp(SIDE / 2, places[:, 0], places[:, 1]))


def figures(solver: Solver) -> list[float]:
    """Tensions and energy."""
    return [*(cable.tension for cable in solver.scene.cables), solver.scene.energy]


def test_the_square_converges_to_its_limits(comm: MPI.Intracomm) -> None:
    """By the second power of the cells' size; the number of Newton steps does not grow."""
    found = []
    for k in (10, 20, 40):
        solver, cable = rowed(rowed_mesh(comm, k))
        outcome = solver.advance(pressure=PRESSURE).outcome
        assert outcome.factorizations <= 6
        found.append((cable.tension, middle(cable), solver.scene.energy))
    errors = np.array(found) / (T, Y, W) - 1
    sizes = [1 / k for k in (10, 20, 40)]
    assert order(sizes, errors[:, 2]) == pytest.approx(2.05, abs=0.1)
    assert order(sizes, errors[:, 0]) == pytest.approx(2.25, abs=0.2)
    limits = errors[2] + (errors[2] - errors[1]) / 3
    np.testing.assert_allclose(limits, 0.0, atol=5e-5)
    assert abs(errors[2, 1]) < 1e-5 and abs(errors[0, 1]) < 3e-4


def test_an_independent_program_balances_the_states() -> None:
    """On the final mesh, by numpy alone: forces on vertices, and those on their stress-free places
    across the rows."""
    square, _ = rowed(rowed_mesh(MPI.COMM_SELF, 10, bow=10.0))
    both, cables = oblique(MPI.COMM_SELF, 8)
    for solver in (square, both):
        for load in (PRESSURE, 3 * PRESSURE):
            solver.advance(pressure=load)
            assert not any(cable.state.lifted.any() for cable in cables)
            energy, force, sideways = forces(solver.scene, solver.scene.cables)
            tension = min(cable.tension for cable in solver.scene.cables)
            assert energy == pytest.approx(solver.scene.energy, rel=1e-9)
            assert force < 1e-8 * tension and sideways < 5e-6 * tension


@pytest.mark.parametrize(("length", "force"), [(0.01, 9.81e-3), (10.0, 9.81)])
def test_in_any_units_and_place(comm: MPI.Intracomm, length: float, force: float) -> None:
    """In m and kN or mm and N, turned in space, far from the origin."""
    base, cable = rowed(rowed_mesh(comm, 10))
    base.advance(pressure=PRESSURE)
    turn, _ = np.linalg.qr(np.array([(1.0, 2.0, -1.0), (0.5, -1.0, 3.0), (2.0, 0.3, 1.0)]))
    turn *= np.sign(np.linalg.det(turn))
    origin = 1e3 * SIDE * length * np.array([1.0, -2.0, 0.5])

    def place(p: Floats) -> Floats:
        return np.asarray(length * p @ turn.T + origin)

    solver, other, pressure = in_units(rowed_mesh(comm, 10, place=place), length, force)
    solver.advance(pressure=pressure)
    assert other.tension / force == pytest.approx(cable.tension, rel=1e-8)
    assert solver.scene.energy / (force * length) == pytest.approx(base.scene.energy, rel=1e-8)
    back = (row_places(other) - origin) @ turn / length
    along = np.argsort(back[:, 0])  # the row's direction is that of the coordinates
    np.testing.assert_allclose(back[along], row_places(cable), atol=1e-6)


def test_two_oblique_rows_that_cross(comm: MPI.Intracomm) -> None:
    """Their vertex shifts in both directions; figures of an independent program."""
    due = {10: (88.901, 86.928, -231.183), 20: (88.636, 86.650, -235.265)}
    for k, rel in ((10, 5e-3), (20, 1e-3)):
        solver, _ = oblique(comm, k)
        assert solver.advance(pressure=PRESSURE).outcome.factorizations <= 8
        assert figures(solver) == pytest.approx(due[k], rel=rel)


@pytest.mark.ranks
def test_loads_up_and_back_and_the_number_of_ranks(comm: MPI.Intracomm) -> None:
    found = []
    for ranks in (comm, MPI.COMM_SELF):
        solver, _ = oblique(ranks, 10)
        solver.advance(pressure=PRESSURE)
        first = figures(solver)
        solver.advance(pressure=3 * PRESSURE)
        assert solver.scene.cables[0].tension > 1.3 * first[0]
        solver.advance(pressure=PRESSURE)
        assert figures(solver) == pytest.approx(first, rel=1e-6)
        found.append(first)
    if comm.size == 1:  # otherwise gmsh's cells lie on other ranks, with other rounding
        assert found[0] == found[1]
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.ranks
def test_laid_astray_it_finds_the_same_state(comm: MPI.Intracomm) -> None:
    """By up to .7 cells, each vertex at random."""
    ends = []
    for astray in (0.0, 0.7):
        solver, cable = rowed(rowed_mesh(comm, 20))
        scene = solver.scene
        X = scene.membrane.stress_free.copy()
        row = np.isclose(X[:, 1], 30.0) & (X[:, 0] > 0.1) & (X[:, 0] < SIDE - 0.1)
        at = np.round(X[row, 0] / 5.0).astype(int)
        X[row, 1] += astray * 5.0 * np.random.default_rng(2).uniform(-1, 1, 21)[at]
        if astray:
            place_stress_free(scene, X)
        solver.advance(pressure=PRESSURE)
        ends.append((*figures(solver), middle(cable)))
    assert ends[1] == pytest.approx(ends[0], rel=1e-6)


@pytest.mark.parametrize(("k", "rel"), [(20, 4e-4), (40, 1e-4)])
def test_slides_of_many_cells_in_one_step(comm: MPI.Intracomm, k: int, rel: float) -> None:
    """Laid along an arc 25 off, of 5 or 10 cells: the state of a mesh whose row is straight."""
    straight, cable = rowed(rowed_mesh(comm, k))
    bowed, other = rowed(rowed_mesh(comm, k, bow=25.0))
    for solver in (straight, bowed):
        solver.advance(pressure=PRESSURE)
    assert middle(other) == pytest.approx(middle(cable), abs=1e-2)
    assert figures(bowed) == pytest.approx(figures(straight), rel=rel)


def test_many_steps_lead_where_one_leads(comm: MPI.Intracomm) -> None:
    found = []
    for steps in (1, 4):
        solver, cable = rowed(rowed_mesh(comm, 20, bow=25.0), length=115.0)
        solver.advance(pressure=PRESSURE)
        solver.advance(L0={cable: SIDE}, steps=steps)
        found.append((*figures(solver), middle(cable)))
    assert found[1] == pytest.approx(found[0], rel=1e-4)


def test_a_row_slides_along_a_cable_in_a_pocket(comm: MPI.Intracomm) -> None:
    """Which stays on its line of the fabric; the crossing goes along it."""
    mesh = rowed_mesh(comm, 20, bow=10.0, across=50.0)
    solver, cable = rowed(mesh)
    pocket = solver.scene.lay_cable(Cable(EA), along="B", L0=SIDE, hold="pocket")
    assert solver.advance(pressure=PRESSURE).verification.passed
    np.testing.assert_allclose(row_places(pocket)[:, 0], 50.0, atol=1e-9)
    assert middle(cable) == pytest.approx(29.6, abs=0.5)
    places = row_places(cable)
    common = places[np.abs(places[:, 0] - 50.0) < 1e-9]
    assert len(common) == 1 and np.abs(row_places(pocket) - common).sum(axis=1).min() < 1e-9


def test_a_sleeve_slides_as_well(comm: MPI.Intracomm) -> None:
    """As the cable on the outside does where nothing lifts off."""
    found = []
    for hold in ("outside", "sleeve"):
        solver, _ = rowed(rowed_mesh(comm, 10), hold=hold)
        solver.advance(pressure=PRESSURE)
        found.append(figures(solver))
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_a_slack_cable_keeps_its_place(comm: MPI.Intracomm) -> None:
    """The first one, and where it slid last."""
    solver, cable = rowed(rowed_mesh(comm, 10), length=120.0)
    solver.advance(pressure=PRESSURE)
    assert not cable.taut and solver.scene.membrane.moved is None
    solver.advance(L0={cable: SIDE})
    assert cable.taut and middle(cable) < 29.5
    places = row_places(cable)
    solver.advance(L0={cable: 120.0})
    assert not cable.taut
    np.testing.assert_allclose(row_places(cable), places, atol=1e-6)  # of cells of 10


def test_held_lines_are_pockets(comm: MPI.Intracomm) -> None:
    mesh, found = rowed_mesh(comm, 10), []
    for hold, slide in (("outside", False), ("pocket", False), ("pocket", True)):
        solver, _ = rowed(mesh, hold=hold, slide=slide)
        solver.advance(pressure=PRESSURE)
        assert solver.scene.membrane.moved is None
        found.append((*figures(solver), solver.scene.u.x.array))
    for other in found[1:]:
        assert other[:2] == pytest.approx(found[0][:2], rel=1e-10)
        np.testing.assert_allclose(other[2], found[0][2], rtol=1e-10, atol=1e-10)


def test_scenes_of_one_mesh_slide_apart(comm: MPI.Intracomm) -> None:
    mesh = rowed_mesh(comm, 10)
    (one, _), (other, cable) = rowed(mesh), rowed(mesh)
    nodes = other.scene.mesh.mesh.geometry.x
    before = nodes.copy()
    one.advance(pressure=PRESSURE)
    np.testing.assert_array_equal(nodes, before)
    other.advance(pressure=PRESSURE)
    assert middle(cable) < 29.5
    assert_same_state(one.scene.state, other.scene.state, rtol=1e-9)


@pytest.mark.ranks
def test_snapshots_and_branches(comm: MPI.Intracomm) -> None:
    """Load steps from a state are the same after others, in and out of a branch."""
    solver, cable = rowed(rowed_mesh(comm, 10, bow=10.0))
    scene = solver.scene
    solver.advance(pressure=PRESSURE)
    kept, place = solver.snapshot(), middle(cable)
    with solver.branch("tight"):
        solver.advance(pressure=4 * PRESSURE, L0={cable: 97.0})
        first = figures(solver)
        assert abs(middle(cable) - place) > 1e-3
    assert middle(cable) == place
    assert_same_state(scene.state, kept)
    solver.advance(pressure=4 * PRESSURE, L0={cable: 97.0})
    # the mesh around the rows stays where the last shifts were small
    assert figures(solver) == pytest.approx(first, rel=1e-5)
    solver.restore(kept)
    assert middle(cable) == place


def test_a_collapse_divides_the_step(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """And leads to the same state; where it stays, it is told, and the last good state is kept."""
    follow, calls = RowSliding.follow, []

    def fails(self: RowSliding, *arguments: object) -> float:
        found = follow(self, *arguments)  # type: ignore[arg-type]
        calls.append(found)
        if len(calls) in refused:
            self.collapse = "A would slide so far that cells collapse"
        return found

    due, _ = rowed(rowed_mesh(comm, 10, bow=10.0))
    for _ in range(2):
        due.advance(pressure=2 * PRESSURE)
    monkeypatch.setattr(RowSliding, "follow", fails)
    refused = range(2, 3)
    solver, _ = rowed(rowed_mesh(comm, 10, bow=10.0), max_halvings=2)
    step = solver.advance(pressure=2 * PRESSURE)
    assert len(solver.steps) > 1 and step.verification.passed
    solver.advance()
    # up to where the mesh around the rows was last renewed
    assert figures(solver) == pytest.approx(figures(due), rel=5e-5)
    kept, refused = solver.snapshot(), range(10**6)
    with pytest.raises(ConvergenceError, match="A would slide so far"):
        solver.advance(pressure=4 * PRESSURE)
    assert_same_state(solver.scene.state, kept)


def test_far_slides_that_turn_cells_over_are_told(comm: MPI.Intracomm) -> None:
    """With the cable's name and what to do; the scene keeps its last state."""
    solver, cable = rowed(rowed_mesh(comm, 20, bow=62.0), max_halvings=0)
    before = solver.snapshot()
    with pytest.raises(ConvergenceError, match=r"slide so far that cells.*slide=False") as told:
        solver.advance(pressure=PRESSURE)
    assert cable.name in str(told.value)
    assert_same_state(solver.scene.state, before)


@pytest.mark.ranks
def test_saved_in_the_middle(comm: MPI.Intracomm, folder: Path) -> None:
    """Read on the mesh as given, by a file of one's own and by a resumed script."""
    mesh = rowed_mesh(comm, 10, bow=10.0)
    solver, cable = rowed(mesh)
    solver.advance(pressure=PRESSURE)
    solver.save(folder / "slid")
    other, again = rowed(mesh)
    other.load(folder / "slid")
    assert middle(again) == middle(cable) != 40.0
    assert_same_state(other.scene.state, solver.scene.state)
    for one in (solver, other):
        one.advance(pressure=2 * PRESSURE)
    assert figures(other) == pytest.approx(figures(solver), rel=1e-8)
    for resume, loads in ((False, (1, 2)), (True, (1, 2, 3))):
        run, _ = rowed(mesh, results=folder / "run", resume=resume)
        for load in loads:
            run.advance(pressure=load * PRESSURE)
        found = figures(run)
        del run
    solver.advance(pressure=3 * PRESSURE)
    assert found == pytest.approx(figures(solver), rel=1e-6)


@pytest.mark.parametrize("law", ["strain", "pressure"])
def test_stepwise_laws_cannot_follow(comm: MPI.Intracomm, law: str) -> None:
    scene = clamped(rowed_mesh(comm, 10), LINEAR, **{law: "step"})
    scene.lay_cable(Cable(EA), along="A", L0=SIDE)
    before = scene.state
    with pytest.raises(InputError, match=r"step-wise laws.*slide=False"):
        Solver(scene).advance(pressure=PRESSURE)
    assert_same_state(scene.state, before)
    Solver(scene, slide=False).advance(pressure=PRESSURE)


def test_sensitivities_against_differences(comm: MPI.Intracomm) -> None:
    """Their tangent knows that the rows slide."""
    solver, cables = oblique(comm, 8)
    scene = solver.scene
    solver.advance(pressure=PRESSURE)
    state, (a, b) = solver.snapshot(), cables
    L0 = a.L0
    found = solver.sensitivities([a, b, "energy"], [a, "pressure"])
    assert found.inexact == ()
    held = solver.system.slide
    assert isinstance(solver.system, System) and held
    for j, h in enumerate((1e-3, 1e-5)):
        results = []
        for sign in (1.0, -1.0):
            solver.restore(state)
            if j == 0:
                solver.advance(L0={a: L0 + sign * h})
            else:
                solver.advance(pressure=PRESSURE + sign * h)
            results.append([a.tension, b.tension, scene.energy])
        differences = (np.array(results[0]) - results[1]) / (2 * h)
        np.testing.assert_allclose(found.values[:, j], differences, rtol=1e-5)


def test_rows_that_are_thrown_to_and_fro_move_by_half_of_it() -> None:
    """And by all of it where interrupted solves go on in one direction, or to a new one."""
    motions, rows = Motions(), Mock(sizes=np.ones(2))
    way = np.array([(0.7, 0.0, 0.0), (0.2, 0.1, 0.0)])
    made = [one + motions.further(rows, one, solved=False) for one in (way, 0.8 * way, -0.8 * way)]
    np.testing.assert_allclose(made[:2], [way, 0.8 * way])
    np.testing.assert_allclose(made[2], -0.4 * way)
    again = 0.4 * way
    np.testing.assert_allclose(again + motions.further(rows, again, solved=False), 0.4 / 3 * way)
    np.testing.assert_array_equal(motions.further(rows, way, solved=True), 0.0 * way)
    np.testing.assert_array_equal(motions.further(rows, -way, solved=False), 0.0 * way)
    other = way[:1]  # of other vertices
    np.testing.assert_array_equal(motions.further(rows, other, solved=False), 0.0 * other)
