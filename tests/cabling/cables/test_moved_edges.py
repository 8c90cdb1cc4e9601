"""Cables whose ends lie on edges that move: sewn ones go along, others stay and say so."""

from __future__ import annotations

import warnings
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    IsotropicMembrane,
    LaidCable,
    PathError,
    PathWarning,
    Rotation,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.steps.movements import Move
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.cable import Hold

EA, PULL = 800.0, 2.0
STRAIN = np.array([[0.012, 0.007, 0.0], [-0.004, 0.021, 0.0], [0.003, -0.002, 0.0]])
HOLDS: tuple[Hold, ...] = ("bonded", "pocket")


def strained(x: Array, t: float) -> Array:
    """A uniform stretch, shear and tilt, not linear in time."""
    way: Array = t**2 * (STRAIN @ x)
    return way


def belted(
    comm: MPI.Intracomm, hold: Hold, size: float = 1.3, unit: float = 1.0, force: float = 1.0
) -> tuple[Solver, LaidCable]:
    """A sheet of 8 x 5 (in kN and m) with a cable from its left to its back edge, in equilibrium.
    It passes no vertex nearly, where the smoothing of its lengths would count."""
    stress = force / unit
    mesh = meshes.rectangle(comm, 8.0 * unit, 5.0 * unit, size * unit)
    scene = clamped(mesh, IsotropicMembrane(400.0 * stress, 0.3, 1.0, prestress=1.5 * stress))
    ends = [(0.0, 0.7 * unit), (7.1 * unit, 5.0 * unit)]
    cable = scene.lay_cable(Cable(EA * force), ends, hold=hold, tension=PULL * force)
    solver = advanced(Solver(scene, rtol=1e-11))
    return solver, cable


@pytest.mark.ranks
@pytest.mark.parametrize(("unit", "force"), [(1.0, 1.0), (1e3, 1e3)], ids=["kN, m", "N, mm"])
@pytest.mark.parametrize(("hold", "size"), list(product(HOLDS, (2.0, 1.3, 0.9))))
def test_a_uniform_strain_of_the_edge(
    comm: MPI.Intracomm, hold: Hold, size: float, unit: float, force: float
) -> None:
    """The cable has it, too, wherever its ends are on their edges: T = EA (|F d|/L0 - 1)."""
    solver, cable = belted(comm, hold, size, unit, force)
    way = (cable.line[-1] - cable.line[0]) / unit
    L0 = float(np.linalg.norm(way)) / (1 + PULL / EA)
    solver.advance(move={"boundary": strained}, steps=2)
    exact = EA * force * (float(np.linalg.norm(way + STRAIN @ way)) / L0 - 1)
    np.testing.assert_allclose(cable.tensions, exact, rtol=1e-8)
    solver.advance(move={"boundary": lambda x, t: t * (np.linalg.solve(np.eye(3) + STRAIN, x) - x)})
    np.testing.assert_allclose(cable.tensions, PULL * force, rtol=1e-7)


@pytest.mark.ranks
@pytest.mark.parametrize("hold", HOLDS)
def test_edges_that_move_by_more_than_a_cell(comm: MPI.Intracomm, hold: Hold) -> None:
    """A rigid motion leaves the tensions, though other cables come to lie where the ends were."""
    solver, cable = belted(comm, hold)
    before, line = cable.tensions, cable.line
    shift = (0.0, -3.0, 7.0)
    assert solver.advance(move={"boundary": shift}, steps=2).outcome.evaluations <= 3, "carried"
    np.testing.assert_allclose(cable.line, line + np.array(shift), atol=1e-12)
    solver.advance(move={"boundary": Rotation((1.0, 2.0, 0.0), (0.3, 0.1, 1.0), 2.0)}, steps=4)
    np.testing.assert_allclose(cable.tensions, before, rtol=1e-6)
    assert np.abs(cable.line - line).max() > 4.0


@pytest.mark.ranks
@pytest.mark.parametrize("hold", HOLDS)
def test_one_side_moves(comm: MPI.Intracomm, hold: Hold, tmp_path: Path) -> None:
    """As with the end moved by hand; also after a checkpoint, with the other end given."""
    way, aside = (-0.12, 0.3, 0.2), (0.02, 0.0, 0.1)
    found, folder = [], comm.bcast(tmp_path)
    for by_hand in (True, False):
        solver, cable = belted(comm, hold)
        own: dict[object, Move] = {cable.start: way} if by_hand else {}
        solver.advance(move={"left": way, **own}, steps=2)
        if not by_hand:
            solver.save(folder)
            solver, cable = belted(comm, hold)
            state = Solver(solver.scene)
            state.load(folder)
            solver, cable = state, state.scene.cable("cable 1")
        own = {cable.end: aside} if by_hand else {}
        solver.advance(move={"back": aside, cable.start: (0.0, 0.0, 0.0), **own})
        found.append(cable.tensions)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-7)
    assert np.abs(found[0] - PULL).max() > 0.5 * PULL


@pytest.mark.ranks
def test_ends_that_are_not_sewn_stay_and_say_so(comm: MPI.Intracomm) -> None:
    """Unless told to. Ends that have left the edge before, and edges that stay, say nothing."""
    tensions = []
    for told in (False, True):
        solver, cable = belted(comm, "outside")
        start = cable.state.positions[0].copy()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            stays: dict[object, Move] = {cable.start: (0.0, 0.0, 0.0)} if told else {}
            solver.advance(move={"left": (-0.05, 0.0, 0.0), **stays})
            assert len(caught) == (comm.rank == 0 and not told)
            if caught:
                assert caught[0].category is PathWarning and caught[0].filename == __file__
                words = str(caught[0].message)
                assert "the start of 'cable 1' stays in space" in words and "end of" not in words
            solver.advance(move={"left": (-0.05, 0.0, 0.0), "back": (0.0, 0.0, 0.0)})
            assert len(caught) == (comm.rank == 0 and not told)
        np.testing.assert_array_equal(cable.state.positions[0], start)
        tensions.append(cable.tension)
    # with more than two ranks PETSc sums what others send in the order in which it arrives
    rounding = 0.0 if comm.size <= 2 else 1e-12
    assert tensions[0] == pytest.approx(tensions[1], rel=rounding, abs=0.0)


@pytest.mark.ranks
def test_a_bonded_end_that_is_pulled_past_its_bonds_is_refused(comm: MPI.Intracomm) -> None:
    """By name, and the state stays."""
    solver, cable = belted(comm, "bonded")
    before = cable.tensions
    with pytest.raises(PathError, match=r"'cable 1' has an end .* past places .* bonded"):
        solver.advance(move={cable.start: (3.0, 1.0, 0.0)})
    np.testing.assert_array_equal(cable.tensions, before)
    solver.advance(move={"boundary": (0.0, 0.0, 1.0)})
    np.testing.assert_allclose(cable.tensions, before, rtol=1e-8)


@pytest.mark.ranks
def test_edge_cables_go_with_their_corner(comm: MPI.Intracomm) -> None:
    """Of a sail: in pockets, bonded and as belts, as with their ends moved by hand."""
    corners, found = ["front left", "front right", "back right", "back left"], []
    sides = ("front", "right", "back", "left")
    form = find_form(
        meshes.rectangle(comm, 5.0, 5.0, 1.0), 3.0, fixed=corners,
        lifted={"front left": (0.0, 0.0, 1.0), "back right": (0.0, 0.0, 1.0)},
        cables=[FormCable(side, tension=20.0, hold="bonded" if side == "left" else "pocket")
                for side in sides],
    )  # fmt: skip
    way = (0.04, 0.05, -0.03)
    for by_hand in (True, False):
        fabric = IsotropicMembrane(E=600.0, nu=0.3, thickness=1.0)
        sail = form.scene(fabric, Cable(EA=9e3), belts=Cable(EA=1200.0))
        solver = advanced(Solver(sail))
        at = np.array([0.0, 0.0, 1.0])
        ends = [end for cable in sail.cables for end in (cable.start, cable.end)]
        own = [
            end for end in ends
            if np.allclose(end.cable.state.positions[0 if end.which == "start" else -1], at)
        ]  # fmt: skip
        assert len(own) == 4, "of two edge cables and their belts"
        by_it: dict[object, Move] = dict.fromkeys(own, way) if by_hand else {}
        solver.advance(move={"front left": way, **by_it})
        found.append(np.concatenate([cable.tensions for cable in sail.cables]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6, atol=1e-6)
