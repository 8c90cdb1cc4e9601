"""The potential of a patch: against the whole's energy, forces and stiffness."""

import numpy as np
import pytest
from mpi4py import MPI
from polygon_twins import closed
from taylor import OnMesh, dense, noise
from term_scene import FABRIC, ISOTROPIC, STIFF, cable_square, displaced

from crms_fenicsx.energy.minimization.initial_hessian import EXACT_SHIFT, SHIFT
from crms_fenicsx.energy.minimization.local_potential import LocalPotential, PatchData
from crms_fenicsx.energy.minimization.strategy import STRATEGY

pytestmark = pytest.mark.ranks


def evaluated(material=ISOTROPIC, size=0.3):
    """A potential at some state with forces, on this process alone, and its layout."""
    system = cable_square(MPI.COMM_SELF, material)
    potential, n = system.potential, system.unknowns.n_owned
    held = system.unknowns.held[:n]
    potential.x[:n] += displaced(system.unknowns, size, stretch=1.03) * ~held
    potential.place()
    potential.evaluate()
    potential.free_gradient(potential.g_vector.duplicate())
    return potential


def local_potential(potential, blocks):
    """The potential of some blocks, and those of the whole in the order of its own."""
    moves = np.zeros(potential.unknowns.n_local, dtype=bool)
    moves[blocks] = True
    patch = PatchData.of(potential, moves)
    local = LocalPotential(potential, patch, STRATEGY)
    return local, patch.numbers[local.blocks]


def free_blocks(potential, points=True, vertices=False):
    """Blocks that may move."""
    unknowns = potential.unknowns
    free = np.flatnonzero(~unknowns.held[: unknowns.n_owned].all(axis=1))
    is_point = free >= unknowns.n_vertices
    return free[(is_point & points) | (~is_point & vertices)].astype(np.int32)


@pytest.mark.parametrize("material", [ISOTROPIC, STIFF, FABRIC], ids=["wrinkling", "raw", "fabric"])
@pytest.mark.parametrize("vertices", [False, True], ids=["points", "with vertices"])
def test_energy_and_forces_are_those_of_the_whole(material, vertices):
    potential = evaluated(material)
    local, whole = local_potential(potential, free_blocks(potential, vertices=vertices)[::2])
    assert len(whole) > 5
    before, own = potential.energy(), local.energy
    np.testing.assert_allclose(local.g, potential.g[whole], atol=1e-11)
    kept = potential.x[whole].copy()
    step = local._project(0.05 * noise(potential.unknowns.X[whole], 4))
    potential.x[whole] = local.x[local.blocks] = kept + step
    local.evaluate()
    potential.place()
    after = potential.evaluate()
    change = local.energy - own
    assert abs(change) > 1e-3
    assert change == pytest.approx(after - before, rel=1e-9)
    g = np.where(potential.unknowns.held, 0.0, potential.g)[whole]
    np.testing.assert_allclose(local.g, g, atol=1e-9 * np.abs(g).max())


@pytest.mark.parametrize("exact", [False, True], ids=["H0", "exact"])
def test_matrix_is_a_block_of_the_whole_one(exact):
    """H0 is another one for plain cells that are treated as folded ones."""
    potential = evaluated()
    blocks = free_blocks(potential, vertices=exact)[::2]
    mesh = OnMesh.__new__(OnMesh)
    mesh.potential, mesh.unknowns, mesh.exact = potential, potential.unknowns, exact
    potential.damping, damping = None, potential.damping
    local, whole = local_potential(potential, blocks)
    n = potential.unknowns.n_owned
    K = dense(mesh.assembled(potential.x[:n].copy()))
    values, columns = potential.dyad_columns(potential.unknowns.held[:n], exact)
    K += columns * values @ columns.T
    potential.damping = damping
    rows = (3 * whole[:, None] + np.arange(3)).ravel()
    expected = K[np.ix_(rows, rows)]
    b = noise(potential.unknowns.X[whole], 3)
    local._assemble(exact)
    upper = np.triu(local._matrix.values)
    found = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(K).max())
    definite = 3.0 * np.abs(K).max() * np.eye(len(rows))
    local._matrix.values += definite
    y = local._matrix.solve(b, exact, local._bound, local._projectors)
    sliders = {k: P for k, P in zip(local._bound, local._projectors, strict=True) if P.any()}
    part = EXACT_SHIFT if exact else SHIFT
    matrix = closed(expected + definite, part, np.zeros((len(whole), 3), dtype=bool), sliders)
    np.testing.assert_allclose(matrix @ y.ravel(), b.ravel(), atol=1e-9 * np.abs(b).max())


def test_indefinite_second_derivatives_are_refused():
    """Then the direction is that of H0."""
    potential = evaluated()
    local, _ = local_potential(potential, free_blocks(potential))
    local._assemble(True)
    local._matrix.values -= 1e3 * np.abs(local._matrix.values).max() * np.eye(3 * len(local.blocks))
    assert local._matrix.solve(local.g, True, local._bound, local._projectors) is None


@pytest.mark.parametrize("vertices", [False, True], ids=["points", "with vertices"])
def test_relaxed_blocks_are_in_balance(vertices):
    potential = evaluated(STIFF, size=0.1)
    local, _ = local_potential(potential, free_blocks(potential, vertices=vertices)[::4])
    energy, residual = local.energy, np.linalg.norm(local.g)
    assert local.minimize(1e-3 * residual)
    assert local.energy < energy and local.steps > 0
    assert np.linalg.norm(local.g) <= 1e-3 * residual
