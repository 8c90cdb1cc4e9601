"""Relaxation on several ranks: as on one, wherever the elements of a patch are."""

from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI
from taylor import noise
from term_scene import cable_square

from crms_fenicsx import Cable, Friction, Solver
from crms_fenicsx.energy.minimization.relaxation import Relaxation
from crms_fenicsx.energy.minimization.strategy import STRATEGY

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]


def scattered(midpoints):
    """Each cell on any rank."""
    return np.random.default_rng(4).integers(0, MPI.COMM_WORLD.size, len(midpoints))


def sectors(midpoints):
    """All but the first rank, in sectors around the middle."""
    x, y = (midpoints[:, :2] - 50.0).T
    turn = (np.arctan2(y, x) / (2 * np.pi)) % 1.0
    others = MPI.COMM_WORLD.size - 1
    return 1 + (turn * others).astype(int) if others else np.zeros(len(midpoints), int)


def keys(unknowns):
    """What tells owned vertices and points from others, on any number of ranks, (n, 4)."""
    n = unknowns.n_owned
    is_point = np.arange(n) >= unknowns.n_vertices
    return np.column_stack([is_point, np.round(unknowns.X[:n], 9)])


def by_key(potential):
    """Keys and displacements of all ranks' vertices and points, in an order of their own."""
    rows = np.column_stack([keys(potential.unknowns), potential.x[: potential.unknowns.n_owned]])
    rows = np.concatenate(potential.comm.allgather(rows))
    return rows[np.lexsort(rows.T[:4])]


def out_of_balance_in_the_middle(system, solved):
    """Displacements in balance but for what is in the middle."""
    places = {tuple(row[:4]): row[4:] for row in solved}
    own = keys(system.unknowns)
    near = np.linalg.norm(own[:, 1:3] - (50.0, 45.0), axis=1) < 12.0
    shake = 0.1 * noise(own[:, 1:], 3) * (near[:, None] & ~system.unknowns.held[: len(own)])
    return np.array([places[tuple(row)] for row in own]).reshape(-1, 3) + shake


@pytest.fixture(scope="module")
def solved():
    """The state in balance, found by each rank for itself."""
    system = cable_square(MPI.COMM_SELF)
    system.minimize((0.0,))
    return by_key(system.potential)


@pytest.mark.parametrize("ranks", [None, scattered, sectors], ids=["default", "any", "sectors"])
def test_relaxed_state_is_that_of_one_rank(comm, solved, ranks):
    # three rings would be all of this small mesh
    strategy = replace(STRATEGY, patch_rings=1, most_relaxed=1.0)
    states, steps = [], []
    for processes, division in ((MPI.COMM_SELF, None), (comm, ranks)):
        system = cable_square(processes, ranks=division)
        potential = system.potential
        n = system.unknowns.n_owned
        potential.x[:n] = out_of_balance_in_the_middle(system, solved)
        potential.place()
        energy = potential.evaluate()
        before, relaxation = by_key(potential), Relaxation(potential, strategy)
        assert relaxation.relax(10.0)
        assert potential.energy() < energy
        states.append(by_key(potential))
        steps.append(relaxation.steps)
        relaxation.destroy()
    moved = np.abs(states[0] - before).max(axis=1) > 1e-3
    assert moved[states[0][:, 0] == 0.0].any() and moved[states[0][:, 0] == 1.0].any()
    assert 4 < np.count_nonzero(moved) < len(moved)
    np.testing.assert_allclose(states[1], states[0], atol=1e-9)
    assert steps[0] == steps[1] > 0


@pytest.mark.parametrize("limit", ["most_relaxed", "largest_patch"])
def test_large_patches_are_left_to_the_solve(comm, solved, limit):
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    potential.x[:n] = out_of_balance_in_the_middle(system, solved)
    potential.place()
    potential.evaluate()
    before = potential.x.copy()
    relaxation = Relaxation(potential, replace(STRATEGY, patch_rings=1, **{limit: 0}))
    assert not relaxation.relax(10.0)
    np.testing.assert_array_equal(potential.x, before)
    assert relaxation.steps == 0
    relaxation.destroy()


def test_friction_along_one_cable_leaves_the_others_relaxed(comm):
    """Forces of terms without elements are held meanwhile."""
    steps = []
    for friction in (0.0, Friction(0.0, along=0.05)):
        scene = sheet(comm, 20)
        solver = advanced(Solver(scene, verify=False), pressure=0.01)
        for y, mu in ((33.0, 0.0), (64.0, friction)):
            scene.lay_cable(Cable(EA=32000.0, friction=mu), [(-10.0, y, 0.0), (110.0, y + 5, 0.0)])
        steps.append(solver.advance(pressure=0.02).outcome.local_steps)
    assert min(steps) > 0
