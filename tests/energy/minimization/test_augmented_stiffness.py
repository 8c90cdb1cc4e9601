"""H0 factorised with the tensions of cables as unknowns."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from taylor import noise
from term_scene import cable_square, displaced

from crms_fenicsx.energy.minimization.augmented_stiffness import AugmentedStiffness
from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian


def at_some_state(comm: MPI.Comm) -> InitialHessian:
    """H0 of a square with three cables in tension, displaced."""
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    potential.x[:n] = displaced(system.unknowns, 0.5) * ~system.unknowns.held[:n]
    potential.place()
    potential.evaluate()
    return InitialHessian(potential, "crms_test_h0_")


def assert_solved(h0: InitialHessian) -> None:
    """The residual of a solve, with K and the dyads multiplied one by one."""
    potential = h0.potential
    unknowns = potential.unknowns
    b, y, product = (potential.x_vector.duplicate() for _ in range(3))
    free = ~unknowns.held[: unknowns.n_owned]
    b.array[:] = (noise(unknowns.X, 4)[: unknowns.n_owned] * free).ravel()
    h0.solve(b, y)
    h0.matrix.mult(y, product)
    for term, k, value in list(potential.dyads()):
        potential.dyad_column(term, k)
        column = (potential.g[: unknowns.n_owned] * free).ravel()
        product.array[:] += value * column * potential.comm.allreduce(float(column @ y.array_r))
    product.axpy(-1.0, b)
    assert product.norm() < 1e-9 * b.norm()


@pytest.mark.ranks
def test_several_processes_solve_with_tensions_as_unknowns(comm: MPI.Comm) -> None:
    h0 = at_some_state(comm)
    assert h0.rebuild()
    assert h0._is_augmented == (comm.size > 1)
    assert len(list(h0.potential.dyads())) >= 2
    assert_solved(h0)
    h0.destroy()


def test_one_process_does_where_the_sparse_part_is_not_definite(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    h0 = at_some_state(MPI.COMM_SELF)
    monkeypatch.setattr(h0, "_set_up", lambda: False)
    assert h0.rebuild() and h0._is_augmented
    assert_solved(h0)
    monkeypatch.undo()
    assert h0.rebuild() and not h0._is_augmented
    assert_solved(h0)
    h0.destroy()


def of_diagonal(comm: MPI.Comm, diagonal: list[float]) -> tuple[PETSc.Mat, AugmentedStiffness]:
    """A diagonal matrix with the same entries on each rank."""
    n = len(diagonal)
    start = n * comm.rank
    csr = (range(n + 1), range(start, start + n), diagonal)
    K = PETSc.Mat().createAIJ(((n, n * comm.size),) * 2, csr=csr, comm=comm)
    return K, AugmentedStiffness(K, "crms_test_h0_")


@pytest.mark.ranks
@pytest.mark.parametrize("stiffness, definite", [(0.6, True), (0.4, False), (0.0, False)])
def test_a_dyad_makes_up_for_a_negative_eigenvalue(
    comm: MPI.Comm, stiffness: float, definite: bool
) -> None:
    """Of K + G C G^T, whose smallest eigenvalue is the stiffness less 0.5."""
    _, augmented = of_diagonal(comm, [1.0, -0.5 if comm.rank == comm.size - 1 else 1.0, 2.0])
    columns = np.zeros((3, 2))
    if comm.rank == comm.size - 1:
        columns[1, 0] = np.sqrt(stiffness)
    if comm.rank == 0:
        columns[2, 1] = 1.0
    assert augmented.factorize(columns) == definite
    augmented.destroy()


@pytest.mark.ranks
def test_dyads_come_and_go(comm: MPI.Comm) -> None:
    """Of cables that become taut, and of points that a cable reaches."""
    K, augmented = of_diagonal(comm, [1.0] * 6)
    b, y = K.createVecs()
    b.set(1.0)
    for columns in (np.eye(6)[:, :1], np.eye(6)[:, 3:5], np.ones((6, 2)) / 4, np.eye(6)[:, 3:5]):
        assert augmented.factorize(columns)
        augmented.solve(b, y)
        product = y.array_r + columns @ comm.allreduce(columns.T @ y.array_r)
        np.testing.assert_allclose(product, b.array_r, atol=1e-12)
    augmented.destroy()
