"""H0 factorised by CHOLMOD with the columns of cables made sparse, against K + G C G^T."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from term_scene import cable_square, displaced

from crms_fenicsx import Cable, IsotropicMembrane, Scene, meshes
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.initial_hessian import InitialHessian
from crms_fenicsx.minimization.stretched_stiffness import StretchedStiffness, tree

N = 9
RING = [(k, (k + 1) % N) for k in range(N)]


def of_pairs(pairs: list[tuple[int, int]]) -> tuple[np.ndarray, SimpleNamespace]:
    """A definite matrix with blocks of these pairs, and its memory."""
    rng = np.random.default_rng(1)
    K = np.kron(np.eye(N), 12.0 * np.ones((3, 3))) + 24.0 * np.eye(3 * N)
    for i, j in pairs:
        block = rng.uniform(0.5, 1.0, (3, 3))
        K[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
        K[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = block.T
    rows, cols = np.nonzero(K)
    pointers = np.append(0, np.cumsum(np.bincount(rows))).astype(np.int32)
    csr = pointers, cols.astype(np.int32), K[rows, cols]
    return K, SimpleNamespace(csr=csr, diagonal=lambda: np.flatnonzero(rows == cols))


def schur_complement(stretched: StretchedStiffness) -> np.ndarray:
    """Of the unknowns that are not branches'."""
    upper, n = stretched.petsc[:, :], 3 * N
    H = upper + np.triu(upper, 1).T
    return H[:n, :n] - H[:n, n:] @ np.linalg.solve(H[n:, n:], H[n:, :n])


@pytest.mark.parametrize("pairs", [RING, RING[:-1], RING[::2], [*RING, (0, 2), (0, 4)], []])
def test_eliminating_the_branches_leaves_the_dyads(pairs: list[tuple[int, int]]) -> None:
    """Along a ring, a line, separate parts and a star; as columns come, change, and go."""
    rng = np.random.default_rng(2)
    K, stiffness = of_pairs(pairs)
    stretched, matrices = StretchedStiffness(stiffness), []
    G = rng.normal(size=(3 * N, 3))
    G[3:6, 0] = G[12:, 1] = 0.0
    G[0, 2] = 0.0
    for m, factor, renewed in ((3, 1.0, True), (3, 2.0, False), (1, 1.0, True), (0, 1.0, True)):
        C = rng.uniform(1.0, 9.0, m)
        assert stretched.assemble(C, np.asfortranarray(factor * G[:, :m])) == renewed
        matrices.append(stretched.petsc.getSize()[0])
        expected = K + factor**2 * (G[:, :m] * C) @ G[:, :m].T
        np.testing.assert_allclose(schur_complement(stretched), expected, atol=1e-11)
    # a branch less than blocks for each column
    assert matrices == [3 * N + 7 + 3 + 8, 3 * N + 7 + 3 + 8, 3 * N + 7, 3 * N]
    stretched.destroy()


def test_branches_follow_the_matrix() -> None:
    """So that they couple what is coupled anyway."""
    _, stiffness = of_pairs(RING)
    pointers, indices, _ = stiffness.csr
    of_column = [np.arange(N), np.array([0, 1, 5, 7, 8]), np.zeros(0, dtype=int)]
    starts = np.cumsum([0] + [len(blocks) for blocks in of_column])
    before = tree(pointers, indices, starts, np.concatenate(of_column))
    assert before[:N].tolist() == [-1, *range(N - 1)]
    # 1 and 8 are beside 0, and 7 beside 8; 5 is beside none
    assert (before[N:] - N * (before[N:] >= 0)).tolist() == [-1, 0, 1, 4, 0]


def h0_of(system: System) -> InitialHessian:
    """H0 at a displaced state, evaluated."""
    potential, n = system.potential, system.unknowns.n_owned
    potential.x[:n] += displaced(system.unknowns, 0.3) * ~system.unknowns.held[:n]
    potential.place()
    potential.evaluate()
    return InitialHessian(potential, "crms_test_h0_")


def dense(h0: InitialHessian) -> np.ndarray:
    """K and the dyads of all terms."""
    values, columns, _ = h0.potential.dyad_columns(h0._held)
    return h0.matrix[:, :] + (columns * values) @ columns.T


def assert_solves(h0: InitialHessian) -> None:
    b, y = h0.matrix.createVecs()
    b.array[:] = np.random.default_rng(3).normal(size=b.getLocalSize())
    h0.solve(b, y)
    assert np.linalg.norm(dense(h0) @ y.array_r - b.array_r) < 1e-9 * b.norm()


def softened(h0: InitialHessian, monkeypatch: pytest.MonkeyPatch, parts: list[float]) -> list[bool]:
    """What `rebuild` returns with K reduced, along a column at the block where it is largest, by
    parts of the way from where K is indefinite to where K and the dyads are."""
    assemble = h0.assemble
    held = assemble(False)
    _, columns, _ = h0.potential.dyad_columns(held)
    block = int(np.argmax(np.abs(columns[:, 0]))) // 3
    a = np.zeros(len(columns))
    own = slice(3 * block, 3 * block + 3)
    a[own] = columns[own, 0]
    limits = [1 / (a @ np.linalg.solve(A, a)) for A in (h0.matrix[:, :], dense(h0))]
    assert limits[1] > 1.01 * limits[0]
    found = []
    for part in parts:

        def reduced(exact: bool, size: float = limits[0] + part * (limits[1] - limits[0])):
            h0.potential.evaluate()
            held = assemble(exact)
            rows = np.arange(own.start, own.stop, dtype=np.int32)
            h0.matrix.setValues(rows, rows, -size * np.outer(a[own], a[own]), addv=True)
            h0.matrix.assemble()
            return held

        monkeypatch.setattr(h0, "assemble", reduced)
        found.append(h0.rebuild())
        assert (np.linalg.eigvalsh(h0.matrix[:, :]).min() < 0.0) == (part > 0.0)
        assert (np.linalg.eigvalsh(dense(h0)).min() > 0.0) == found[-1]
        if found[-1]:
            assert_solves(h0)
    return found


def test_definite_where_the_dyads_make_up_for_what_k_lacks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As on several processes, without MUMPS; also after an indefinite one."""
    h0 = h0_of(cable_square(MPI.COMM_SELF))
    monkeypatch.setattr(h0._augmented, "factorize", None)
    assert softened(h0, monkeypatch, [-0.5, 0.5, 1.5, 0.9]) == [True, True, False, True]
    assert not h0._is_augmented
    h0.destroy()


@pytest.mark.parametrize("sealed", [False, True])
def test_a_clamped_net_with_and_without_sealed_air(
    sealed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each part of a cable between clamps has a column, the volume one that is not stretched."""
    mesh = meshes.rectangle(MPI.COMM_SELF, 10.0, 10.0, 1.3)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    scene.fix("boundary")
    for name, path in (("a", [(0.0, 4.0), (10.0, 5.0)]), ("b", [(4.1, 0.0), (5.3, 10.0)])):
        scene.lay_cable(Cable(300.0), path, tension=1.0, name=name)
    scene.clamp("a", "b")
    scene.air.update(pressure=0.1)
    if sealed:
        scene.seal(volume=100.0, atmosphere=0.3)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    assert system.unknowns.n_tied_points > 0
    h0 = h0_of(system)
    assert h0.rebuild()
    assert [len(h0._stretched._counts), len(h0._dyads)] == [4, int(sealed)]
    assert_solves(h0)
    if sealed:
        monkeypatch.setattr(h0, "_set_up", lambda: False)
        assert h0.rebuild() and h0._is_augmented
        assert_solves(h0)
    h0.destroy()


def test_no_taut_cable() -> None:
    """Nor a column."""
    h0 = h0_of(cable_square(MPI.COMM_SELF))
    h0.potential.dyads = lambda: iter(())
    assert h0.rebuild()
    assert_solves(h0)
    h0.destroy()
