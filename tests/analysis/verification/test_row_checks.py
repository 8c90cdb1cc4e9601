"""Lines that slide with their cables: sideways balance, support forces, derivatives, and vertices
whose places stay for what is fixed to the material there."""

from __future__ import annotations

import numpy as np
import pytest
from bent_rows import bent_mesh, bent_row
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, IsotropicMembrane, LaidCable, Scene, Solver
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.analysis.verification.row_checks import _forces_on_cells, _pulls, row_checks
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.foundations import foundations

FIXED = "held where its line stays"


def unloaded(solver: Solver) -> Array:
    """No forces on the blocks of a solver's layout."""
    return np.zeros((solver.system.unknowns.n_local, 3))


@pytest.mark.ranks
@pytest.mark.parametrize("rigid", [True, False], ids=["rigid", "free"])
def test_sideways_forces_balance_unless_a_place_is_shifted(
    comm: MPI.Intracomm, rigid: bool
) -> None:
    """The check measures what a shift of one vertex by .01 of a cell leaves: .7 percent or more."""
    scene, cable = bent_row(comm, rigid=rigid)
    solver = Solver(scene)
    step = solver.advance(pressure=0.0 if rigid else 0.3)
    check = step.verification["sideways balance"]
    assert check.where == cable.name
    assert check.value < 1e-6
    shape = scene.net.strip_shape()
    at = np.searchsorted(shape.strip.vertices, cable.state.nodes[4].support)
    if rigid:
        current, free = shape.current.copy(), shape.stress_free
        current[at, 1] += 0.01
        places = cable.state.positions.copy()
        places[4, 1] += 0.01
        cable.update(positions=places)
    else:
        current, free = shape.current, shape.stress_free.copy()
        free[at, 1] += 0.01
    moved = StripShape(shape.strip, current, free)
    assert row_checks(solver.system, unloaded(solver), moved, {})[cable]["sideways balance"] > 3e-3


@pytest.mark.ranks
def test_forces_on_places_are_derivatives_of_the_energy(comm: MPI.Intracomm) -> None:
    """To 1e-6 of the largest, by central differences, also along the row, where they do not
    vanish."""
    scene, _ = bent_row(comm, rigid=False, prestress=2.0)
    solver = Solver(scene)
    solver.advance(pressure=0.3)
    system = solver.system
    assert system.shifts is not None
    system.potential.sum_up()
    numbering, term = system.shifts.numbering, system.shifts.energy
    found = _forces_on_cells(system.shifts, unloaded(solver), scene.net.strip_shape())
    sums, x, step = np.zeros(1), system.potential.x, 1e-5
    slopes = np.zeros_like(found)
    for k, block in enumerate(numbering.shift_blocks):
        for i in range(3):
            values = []
            for sign in (1.0, -1.0):
                sums[:] = 0.0
                moved = x.copy()
                if block >= 0:
                    moved[block, i] += sign * step
                term.sums(moved, sums)
                values.append(comm.allreduce(float(sums[0])))
            slopes[k, i] = (values[0] - values[1]) / (2 * step)
    term.sums(x, sums)
    np.testing.assert_allclose(slopes, found, rtol=0.0, atol=1e-6 * np.abs(found).max())
    assert np.abs(found).max() > 0.01


@pytest.mark.ranks
def test_supports_of_a_rigid_sheet_take_the_contact_forces(comm: MPI.Intracomm) -> None:
    """At each vertex to 1e-9 of the tension; with pressure the sum balances it, to 1e-9 as well."""
    scene, cable = bent_row(comm, rigid=True)
    solver = Solver(scene)
    solver.advance()
    assert np.abs(cable.state.positions[:, 1] - 2.0).max() < 1e-3  # pulled straight
    found = solver.reactions(lambda x: np.full(x.shape[1], True))
    pulls = _pulls(cable)
    for k in range(2, 9):
        away = np.linalg.norm(found.positions - cable.state.positions[k], axis=1)
        own = found.forces[away < 1e-6].sum(axis=0)
        total = comm.allreduce(own)
        np.testing.assert_allclose(total, -pulls[k], rtol=0.0, atol=1e-9 * cable.tension)
    np.testing.assert_allclose(found.total, 0.0, atol=1e-9 * cable.tension)
    solver.advance(pressure=0.05)
    found = solver.reactions(lambda x: np.full(x.shape[1], True))
    np.testing.assert_allclose(found.total, (0.0, 0.0, -0.05 * 32.0), atol=1e-9)
    assert foundations(solver.system).unbalanced < 1e-9


@pytest.mark.ranks
def test_sensitivities_follow_lines_that_slide(comm: MPI.Intracomm) -> None:
    """Derivatives of tensions of a small net agree with differences of load steps, to 1e-4, with
    none of them one-sided."""
    scene = Scene(bent_mesh(comm, wide=(1, 2, 3)), IsotropicMembrane(800.0, 0.3, 1.0))
    scene.fix("boundary")
    cables = [scene.lay_cable(Cable(EA=500.0), along=f"A{k}") for k in (1, 2, 3)]
    lengths = {cable: 0.99 * cable.L0 for cable in cables}
    solver = Solver(scene)
    solver.advance(pressure=0.4, L0=lengths)
    found = solver.sensitivities([*cables], [cables[0], "pressure"])
    assert found.one_sided == ()
    start = solver.snapshot()
    for k, size in enumerate((1e-4, 1e-4)):
        ends = []
        for sign in (1.0, -1.0):
            solver.restore(start)
            if k == 0:
                solver.advance(L0={cables[0]: lengths[cables[0]] + sign * size})
            else:
                solver.advance(pressure=0.4 + sign * size)
            ends.append([cable.tension for cable in cables])
        slopes = np.subtract(*ends) / (2 * size)
        np.testing.assert_allclose(found.values[:, k], slopes, rtol=1e-4)


def middle_of(scene: Scene, cable: LaidCable) -> tuple[int, Array]:
    """The local number of the vertex in a cable's middle, -1 elsewhere, and its stress-free place;
    for one process."""
    away = np.linalg.norm(scene.positions() - cable.state.positions[4], axis=1)
    at = int(np.argmin(away))
    return at, scene.membrane.stress_free[at].copy()


def fixed_scene(comm: MPI.Intracomm, what: str) -> tuple[Scene, LaidCable, Step, Array]:
    """The vault under pressure with something at the middle of the line, and what the place of the
    vertex there moves."""
    scene, cable = bent_row(comm, rigid=False, bow=0.4)
    at, place = middle_of(scene, cable)
    x, y, z = cable.state.positions[4]
    if what == "bar":
        scene.add_bar(Bar(EA=1.0), scene.vertex_at((x, y, z)), (x, y, z + 1.0))
    elif what in ("force", "field"):
        forces = fem.Function(scene.V)
        rows = forces.x.array.reshape(-1, 3)
        rows[at if what == "force" else slice(None), 2] = -1e-3
        scene.put_forces(forces)
    elif what == "end":
        ends = [(x + 0.3, y + 0.1), (x + 0.3, 3.9)]
        scene.lay_cable(Cable(EA=10.0), ends, tension=0.01, hold="sleeve")
    step = Solver(scene).advance(pressure=0.4, load=1.0 if scene.factors else None)
    return scene, cable, step, scene.membrane.stress_free[at] - place


@pytest.mark.filterwarnings("ignore:.*is held sideways by")
@pytest.mark.parametrize("what", ["bar", "force", "end"])
def test_places_stay_for_what_is_fixed_to_them(what: str) -> None:
    """The line stays there, is held sideways, and is told of by name."""
    _, cable, step, moved = fixed_scene(MPI.COMM_SELF, what)
    assert not moved.any()
    assert step.verification[FIXED].where == cable.name
    assert step.verification[FIXED].value > 0.05
    assert any("where its line stays" in str(one) for one in step.verification.warnings)


@pytest.mark.parametrize("what", ["", "field"])
def test_places_move_with_fields_of_forces(what: str) -> None:
    """Forces of another program on all vertices hold no line."""
    _, _, step, moved = fixed_scene(MPI.COMM_SELF, what)
    assert moved[1] < -0.3
    assert step.verification[FIXED].value == 0.0
    assert step.verification.verdict == "verified"
