"""Local relaxation on several ranks: as on one, wherever the elements of a cluster are."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from taylor import noise
from term_scene import cable_square, displaced

from crms_fenicsx.energy.minimization.relaxation import LocalRelaxation
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


def far_out_of_balance(system, _):
    """Displacements far out of balance everywhere."""
    shake = displaced(system.unknowns, 0.5, stretch=1.03)
    shake[: system.unknowns.n_vertices] *= 0.2
    n = system.unknowns.n_owned
    return system.potential.x[:n] + shake * ~system.unknowns.held[:n]


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
@pytest.mark.parametrize("kind", ["points", "patch"])
def test_relaxed_state_is_that_of_one_rank(comm, solved, ranks, kind):
    # three rings would be all of this small mesh
    strategy = replace(STRATEGY, patch_rings=1, most_relaxed=1.0 if kind == "patch" else 0.5)
    states, steps = [], []
    for processes, division in ((MPI.COMM_SELF, None), (comm, ranks)):
        system = cable_square(processes, ranks=division)
        potential = system.potential
        shaken = far_out_of_balance if kind == "points" else out_of_balance_in_the_middle
        potential.x[: system.unknowns.n_owned] = shaken(system, solved)
        potential.place()
        potential.evaluate()
        before, local = by_key(potential), LocalRelaxation(potential, strategy)
        assert local.relax_points(0.0) if kind == "points" else local.relax_patch(10.0)
        states.append(by_key(potential))
        steps.append(local.steps)
        local.destroy()
    moved = np.abs(states[0] - before).max(axis=1) > 1e-3
    assert moved[states[0][:, 0] == 0.0].any() == (kind == "patch")
    assert np.count_nonzero(moved) > 4
    np.testing.assert_allclose(states[1], states[0], atol=1e-9)
    assert steps[0] == steps[1] > 0
