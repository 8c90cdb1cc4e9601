"""Taylor tests: does a gradient belong to its energy, a stiffness to its gradient?

The remainder of an energy's expansion to first order shrinks with the square of the step if the
gradient is right, else with the step itself; with the stiffness in it, with the cube.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.potential import Potential

Array = npt.NDArray[Any]

STEPS = tuple(0.01 * 0.25 ** np.arange(6))
"""Steps, as parts of the direction given: so small that an error of 1e-3 in a gradient is seen."""
CUBIC_STEPS = tuple(0.1 * 0.5 ** np.arange(5))
"""Steps where the remainder is of third order, and soon drowns in rounding."""


class Differentiable(Protocol):
    """An energy of points (n, 3) with gradient and stiffness."""

    def value(self, x: Array) -> tuple[float, Array]:
        """Energy and gradient (n, 3)."""

    def times(self, x: Array, d: Array) -> Array:
        """Stiffness times a direction, (n, 3)."""

    def dot(self, a: Array, b: Array) -> float:
        """Scalar product over all ranks."""


class Points:
    """Free points without a mesh: as much of a layout as the terms of cables need."""

    comm = MPI.COMM_SELF

    def __init__(self, X: Array) -> None:
        self.X = X
        self.n_riders = self.n_rails = 0
        self.n_local = len(X)
        self.matrix_numbers = np.arange(len(X), dtype=PETSc.IntType)

    def spread(self, rows: Array, cols: Array) -> tuple[Array, Array, Array]:
        """Every block goes where it is."""
        return np.stack([rows, cols]), np.arange(len(rows)), np.ones(len(rows))


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
        A = PETSc.Mat().createDense(((3 * n, 3 * n),) * 2, comm=MPI.COMM_SELF)
        A.setBlockSize(3)
        A.setUp()
        numbers = np.arange(n, dtype=PETSc.IntType)
        A.setLGMap(*(PETSc.LGMap().create(numbers, bsize=3, comm=MPI.COMM_SELF),) * 2)
        self.term.add_stiffness(x, self.sums, A)
        A.assemble()
        dense: Array = A.getDenseArray().copy()
        A.destroy()
        return dense

    def times(self, x: Array, d: Array) -> Array:
        return (self.matrix(x) @ d.ravel()).reshape(-1, 3)

    def dot(self, a: Array, b: Array) -> float:
        return float(np.vdot(a, b))


class OnMesh:
    """Terms of a distributed layout; arrays hold the points that this rank owns."""

    def __init__(self, unknowns: Any, u: Any, terms: Sequence[EnergyTerm]) -> None:
        self.potential = Potential(unknowns, u, terms)
        self.unknowns = unknowns

    def value(self, x: Array) -> tuple[float, Array]:
        n = self.unknowns.n_owned
        self.potential.x[:n] = x
        self.potential.place()
        energy = self.potential.evaluate()
        return energy, self.potential.g[:n].copy()

    def assembled(self, x: Array) -> PETSc.Mat:
        """Stiffness, distributed."""
        self.value(x)
        unknowns = self.unknowns
        A = PETSc.Mat().create(unknowns.comm)
        A.setSizes(((3 * unknowns.n_owned, 3 * unknowns.n_global),) * 2)
        A.setBlockSize(3)
        A.setType(PETSc.Mat.Type.AIJ)
        A.setLGMap(*(unknowns.lgmap(),) * 2)
        A.setUp()
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self.potential.add_stiffness(A)
        A.assemble()
        return A

    def matrix(self, x: Array) -> Array:
        """Dense stiffness, the same on all ranks."""
        A = self.assembled(x)
        entries = dense(A)
        A.destroy()
        return entries

    def times(self, x: Array, d: Array) -> Array:
        A = self.assembled(x)
        vector = A.createVecRight()
        vector.setArray(d.ravel())
        result = A.createVecLeft()
        A.mult(vector, result)
        product: Array = result.getArray().reshape(-1, 3).copy()
        for thing in (A, vector, result):
            thing.destroy()
        return product

    def dot(self, a: Array, b: Array) -> float:
        return float(self.unknowns.comm.allreduce(float(np.vdot(a, b))))


def dense(A: PETSc.Mat) -> Array:
    """All entries of a distributed matrix, the same on all ranks."""
    indptr, columns, values = A.getValuesCSR()
    rows = np.zeros((len(indptr) - 1, A.getSize()[1]))
    rows[np.repeat(np.arange(len(rows)), np.diff(indptr)), columns] = values
    entries: Array = np.concatenate(A.getComm().tompi4py().allgather(rows))
    return entries


def fitted_order(steps: Sequence[float], remainders: Sequence[float]) -> float:
    """Exponent with which the remainders shrink."""
    return float(np.polyfit(np.log(steps), np.log(remainders), 1)[0])


def gradient_order(f: Differentiable, x: Array, d: Array, steps: Sequence[float] = STEPS) -> float:
    """2 if the gradient at x is right along d, 1 if it is not."""
    energy, g = f.value(x)
    slope = f.dot(g, d)
    remainders = [abs(f.value(x + h * d)[0] - energy - h * slope) for h in steps]
    return fitted_order(steps, remainders)


def stiffness_order(
    f: Differentiable, x: Array, d: Array, steps: Sequence[float] = CUBIC_STEPS
) -> float:
    """3 if gradient and stiffness at x are right along d, 2 if the stiffness is not."""
    energy, g = f.value(x)
    slope, curvature = f.dot(g, d), f.dot(d, f.times(x, d))
    remainders = [
        abs(f.value(x + h * d)[0] - energy - h * slope - h**2 / 2 * curvature) for h in steps
    ]
    return fitted_order(steps, remainders)


def stiffness_error(f: Differentiable, x: Array, d: Array, h: float = 1e-4) -> float:
    """Relative difference of stiffness times d and the central difference of the gradient."""
    difference = (f.value(x + h * d)[1] - f.value(x - h * d)[1]) / (2 * h)
    product = f.times(x, d)
    error = product - difference
    return float(np.sqrt(f.dot(error, error) / f.dot(difference, difference)))


def is_semidefinite(K: Array) -> bool:
    """Whether a matrix is symmetric and has no negative eigenvalue, to rounding."""
    size = np.abs(K).max()
    symmetric = np.abs(K - K.T).max() <= 1e-12 * size
    return bool(symmetric and np.linalg.eigvalsh(K).min() >= -1e-11 * size)


def noise(X: Array, seed: int) -> Array:
    """Random vectors (n, 3) that depend on the place alone, so on no numbering; size about 1.

    Waves shorter than the distances in a mesh of about 20 look random on its vertices.
    """
    rng = np.random.default_rng(seed)
    waves, phases = rng.uniform(-1, 1, (8, 3)), rng.uniform(0, 2 * np.pi, (8, 3))
    shake: Array = np.sin((X @ waves.T)[:, :, None] + phases).sum(axis=1) / 2
    return shake
