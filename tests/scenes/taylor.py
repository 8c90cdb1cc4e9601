"""Taylor tests of terms of free points, and dense stiffnesses; see `minimization.taylor`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.taylor import (
    STEPS,
    Differentiable,
    TermsOnLayout,
    fitted_order,
    gradient_order,
    noise,
    stiffness_order,
)
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern

__all__ = [
    "STEPS", "fitted_order", "gradient_order", "noise", "stiffness_error", "stiffness_order",
]  # fmt: skip
Array = npt.NDArray[Any]


def stiffness_error(f: Differentiable, x: Array, d: Array, h: float = 1e-4) -> float:
    """Relative difference of stiffness times d and the gradient's central difference."""
    ahead, behind = f.value(x + h * d)[1], f.value(x - h * d)[1]
    difference: Array = np.asarray((ahead - behind) / (2 * h), dtype=np.float64)
    error: Array = np.asarray(f.times(x, d) - difference, dtype=np.float64)
    return float(np.sqrt(f.dot(error, error) / f.dot(difference, difference)))


class Points:
    """Free points without a mesh: as much of a layout as the terms of cables need."""

    comm = MPI.COMM_SELF

    def __init__(self, X: Array) -> None:
        self.X = X
        self.n_local = len(X)


class DenseBlocks:
    """A stiffness with all its blocks, (n, n, 3, 3)."""

    def __init__(self, n: int) -> None:
        self.values = np.zeros((n, n, 3, 3))

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's values one by one."""
        np.add.at(self.values, (pattern.rows, pattern.cols), pattern.blocks())


class TermOnPoints:
    """A term of free points on this process alone."""

    def __init__(self, term: Any, X: Array) -> None:
        self.term, self.X = term, X
        term.attach(Points(X))
        self.sums = np.zeros(term.n_sums)

    def value(self, x: Array) -> tuple[float, Array]:
        self.term.sums(x, self.sums)
        g = np.zeros_like(self.X)
        self.term.add_gradient(x, self.sums, g)
        return self.term.energy(self.sums), g

    def matrix(self, x: Array) -> Array:
        """Dense stiffness (3 n, 3 n)."""
        self.term.sums(x, self.sums)
        n = len(self.X)
        A = DenseBlocks(len(self.X))
        self.term.add_stiffness(x, self.sums, A)
        return A.values.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)

    def times(self, x: Array, d: Array) -> Array:
        return (self.matrix(x) @ d.ravel()).reshape(-1, 3)

    def dot(self, a: Array, b: Array) -> float:
        return float(np.vdot(a, b))


class OnMesh(TermsOnLayout):
    """Terms of a distributed layout; arrays hold the points that this rank owns."""

    def matrix(self, x: Array) -> Array:
        """Dense stiffness, the same on all ranks."""
        A = self.assembled(x)
        entries = dense(A)
        A.destroy()
        return entries


def dense(A: PETSc.Mat) -> Array:
    """All entries of a distributed matrix, the same on all ranks."""
    indptr, columns, values = A.getValuesCSR()
    rows = np.zeros((len(indptr) - 1, A.getSize()[1]))
    rows[np.repeat(np.arange(len(rows)), np.diff(indptr)), columns] = values
    entries: Array = np.concatenate(A.getComm().tompi4py().allgather(rows))
    return entries


def is_semidefinite(K: Array) -> bool:
    """Whether a matrix is symmetric and has no negative eigenvalue, to rounding."""
    size = np.abs(K).max()
    symmetric = np.abs(K - K.T).max() <= 1e-12 * size
    return bool(symmetric and np.linalg.eigvalsh(K).min() >= -1e-11 * size)
