"""The potential of some blocks, in clusters: against the whole's energy, forces and stiffness."""

import itertools

import numpy as np
import pytest
from mpi4py import MPI
from polygon_twins import dense_cluster
from taylor import OnMesh, dense, noise
from term_scene import FABRIC, ISOTROPIC, STIFF, cable_square, displaced

from crms_fenicsx.energy.minimization.local_potential import LocalPotential, gather
from crms_fenicsx.energy.minimization.relaxation import LocalRelaxation
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
    """The potential of some blocks, and which blocks of the whole its own are."""
    moves = np.zeros(potential.unknowns.n_local, dtype=bool)
    moves[blocks] = True
    clusters = gather(potential, moves, np.zeros_like(moves), STRATEGY.largest_cluster)
    return LocalPotential(potential, clusters, STRATEGY), clusters.numbers


def free_blocks(potential, points=True, vertices=False):
    """Blocks that may move."""
    unknowns = potential.unknowns
    free = np.flatnonzero(~unknowns.held[: unknowns.n_owned].all(axis=1))
    is_point = free >= unknowns.n_vertices
    return free[(is_point & points) | (~is_point & vertices)].astype(np.int32)


@pytest.mark.parametrize("material", [ISOTROPIC, STIFF, FABRIC], ids=["wrinkling", "raw", "fabric"])
@pytest.mark.parametrize("vertices", [False, True], ids=["points", "with vertices"])
def test_energy_and_forces_are_those_of_the_whole(material, vertices):
    """One cluster, so that each cable is in one piece: exact for any displacement of its blocks."""
    potential = evaluated(material)
    chosen = free_blocks(potential, vertices=vertices)
    local, numbers = local_potential(potential, chosen)
    layout = local.layout
    largest = np.argmax(np.diff(layout.starts))
    blocks = np.sort(numbers[layout.blocks[layout.cluster == largest]])
    assert len(blocks) > 5
    local, numbers = local_potential(potential, blocks)
    assert local.layout.n_clusters == 1
    whole = numbers[local.blocks]
    before, own = potential.energy(), local.energies.sum()
    np.testing.assert_allclose(local.g, potential.g[whole], atol=1e-11)
    kept = potential.x[whole].copy()
    step = 0.05 * noise(potential.unknowns.X[whole], 4)
    local.layout.project(step)
    potential.x[whole] = local.x[local.blocks] = kept + step
    local._evaluate()
    potential.place()
    after = potential.evaluate()
    change = local.energies.sum() - own
    assert abs(change) > 1e-3
    assert change == pytest.approx(after - before, rel=1e-9)
    g = np.where(potential.unknowns.held, 0.0, potential.g)[whole]
    np.testing.assert_allclose(local.g, g, atol=1e-9 * np.abs(g).max())


def test_clusters_have_no_element_in_common():
    potential = evaluated()
    blocks = free_blocks(potential)[::3]
    local, numbers = local_potential(potential, blocks)
    assert local.layout.n_clusters > 3
    whole = numbers[local.blocks]
    number = {int(b): int(c) for b, c in zip(whole, local.layout.cluster, strict=True)}
    moves = np.isin(np.arange(potential.unknowns.n_local), blocks)
    tables = [term.elements_on(moves) for term in potential.terms]
    assert sum(table is not None for table in tables) == len(local.terms) > 3
    for table in tables:
        pointers, members = ([0], []) if table is None else table.element_blocks
        for a, b in itertools.pairwise(pointers):
            assert len({number[int(m)] for m in members[a:b] if int(m) in number}) <= 1


def test_pieces_of_a_cable_together_are_never_below_its_energy():
    """The sum over clusters bounds the whole's change from above, and equals it to first order."""
    potential = evaluated()
    blocks = free_blocks(potential)[::3]
    local, numbers = local_potential(potential, blocks)
    before, own = potential.energy(), local.energies.sum()
    whole = numbers[local.blocks]
    kept = potential.x[whole].copy()
    gaps = []
    for h in (0.02, 0.01, 0.005):
        step = h * noise(potential.unknowns.X[whole], 2)
        local.layout.project(step)
        potential.x[whole] = local.x[local.blocks] = kept + step
        local._evaluate()
        potential.place()
        gaps.append(local.energies.sum() - own - (potential.evaluate() - before))
    assert min(gaps) > 0.0
    assert gaps[0] / gaps[1] == pytest.approx(4, rel=0.2)
    assert gaps[1] / gaps[2] == pytest.approx(4, rel=0.2)


@pytest.mark.parametrize("exact", [False, True], ids=["H0", "exact"])
def test_matrix_is_a_block_of_the_whole_one(exact):
    """H0 is another one for plain cells that are treated as folded ones."""
    potential = evaluated()
    blocks = free_blocks(potential, vertices=exact)[::2]
    whole = OnMesh.__new__(OnMesh)
    whole.potential, whole.unknowns, whole.exact = potential, potential.unknowns, exact
    potential.damping, damping = None, potential.damping
    local, own_numbers = local_potential(potential, blocks)
    x = potential.x[: potential.unknowns.n_owned].copy()
    K = dense(whole.assembled(x))
    potential.damping = damping
    for c in range(local.layout.n_clusters):
        own = own_numbers[local.blocks[local.layout.cluster == c]]
        rows = (3 * own[:, None] + np.arange(3)).ravel()
        expected = K[np.ix_(rows, rows)]
        local._matrix.clear()
        for term, sums in zip(local.terms, local._sums, strict=True):
            (term.add_hessian if exact else term.add_stiffness)(local.x, sums, local._matrix)
        atol = 1e-9 * np.abs(K).max()
        np.testing.assert_allclose(dense_cluster(local._matrix, c), expected, atol=atol)


def test_dyads_are_those_of_the_pieces():
    potential = evaluated()
    local, _ = local_potential(potential, free_blocks(potential)[::3])
    (tension,) = [t for t in local.terms if type(t).__name__ == "CableTension"]
    sums = local._sums[local.terms.index(tension)]
    local._matrix.clear()
    tension.dyad_columns(local.x, sums, exact=False)
    local._matrix.take_columns(tension.columns)
    expected = np.zeros((3 * len(local.blocks),) * 2)
    for k, value in enumerate(tension.dyads(sums, exact=False)):
        g = np.zeros_like(local.x)
        tension.add_dyad_column(k, local.x, g)
        column = g[local.blocks].ravel()
        expected += value * np.outer(column, column)
    for c in range(local.layout.n_clusters):
        own = slice(3 * local.layout.starts[c], 3 * local.layout.starts[c + 1])
        atol = 1e-12 * np.abs(expected).max()
        np.testing.assert_allclose(dense_cluster(local._matrix, c), expected[own, own], atol=atol)


@pytest.mark.parametrize("vertices", [False, True], ids=["points", "with vertices"])
def test_relaxed_blocks_are_in_balance(vertices):
    potential = evaluated(STIFF, size=0.1)
    local, _ = local_potential(potential, free_blocks(potential, vertices=vertices)[::4])
    energies, residual = local.energies.copy(), np.linalg.norm(local.g)
    late = local.relax(1e-8 * residual, 60)
    assert len(late) > 5 and not late.any()
    assert np.all(local.energies <= energies)
    assert np.linalg.norm(local.g) < 2e-3 * residual


def test_a_relaxation_lowers_the_energy_of_the_whole(comm):
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    shake = displaced(system.unknowns, 0.5, stretch=1.03)
    shake[: system.unknowns.n_vertices] *= 0.2
    potential.x[:n] += shake * ~system.unknowns.held[:n]
    potential.place()
    before = potential.evaluate()
    relaxation = LocalRelaxation(potential)
    points, _ = relaxation._residuals(relaxation._points)
    assert relaxation.relax_points(0.0)
    assert potential.energy() < before
    assert relaxation.steps > 0
    assert relaxation._residuals(relaxation._points)[0] < points
