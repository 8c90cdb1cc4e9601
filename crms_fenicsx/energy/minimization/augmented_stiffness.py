"""H0 factorised by MUMPS with the cable tensions as extra unknowns.

With the dyads' gradients as columns of G and their stiffnesses C,

    [ K            G C^1/2 ] [ y ]   [ b ]
    [ C^1/2 G^T    -1      ] [ t ] = [ 0 ]     means     (K + G C G^T) y = b.

The matrix is as sparse as K and needs no solve per cable. It has one negative eigenvalue per dyad
if and only if H0 = K + G C G^T is positive definite (Haynsworth).
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans

CONTROLS = {7: 0, 8: 0, 12: 1, 13: 1, 14: 100}
"""MUMPS integer controls: approximate minimum degree, no scaling, standard ordering, sequential
root (a parallel one would not count all negative pivots), 100 % extra workspace."""
THRESHOLD = 1
"""Index of MUMPS's real control for the pivoting threshold."""
ENDED, NEGATIVE_PIVOTS = 1, 12
"""Indices in MUMPS's INFOG: error code (negative after an error), number of negative pivots."""


class AugmentedStiffness:
    """Factorised matrix of displacements and tensions. Collective.

    `pivoting` may be off where H0 is definite: the factorisation then exists in any order.

    Attributes: `factor`: PETSc's factorisation; `negative`: number of negative eigenvalues of H0.
    """

    def __init__(self, stiffness: PETSc.Mat, prefix: str, pivoting: bool = False) -> None:
        self._stiffness, self._prefix, self._pivoting = stiffness, prefix, pivoting
        self._pattern: Booleans = np.zeros((0, 0), dtype=bool)
        self._matrix: PETSc.Mat | None = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._matrix is not None:
            for petsc in (self._b, self._y, self.factor, self._matrix):
                petsc.destroy()
            self._matrix = None

    def factorize(self, columns: Array) -> bool:
        """Factorise with this rank's rows of G C^1/2, (n, n_dyads). Collective. Returns whether H0
        is positive definite."""
        comm = self._stiffness.comm.tompi4py()
        changed = columns.shape != self._pattern.shape or bool((columns != 0)[~self._pattern].any())
        pointers, indices, values = self._stiffness.getValuesCSR()
        if comm.allreduce(changed, op=MPI.LOR):
            self.destroy()
            self._create(pointers, indices, columns)
        assert self._matrix is not None
        self._values[self._of_stiffness] = values
        self._values[self._of_columns] = columns[self._pattern]
        self._matrix.setValuesCSR(self._pointers, self._indices, self._values)
        self._matrix.assemble()
        self.factor.setUp()
        told = self.factor.getFactorMatrix().getMumpsInfog
        self.negative = int(told(NEGATIVE_PIVOTS)) - columns.shape[1]
        return told(ENDED) >= 0 and self.negative == 0

    def _create(self, pointers: Array, indices: Array, columns: Array) -> None:
        """Create matrix and factorisation for the pattern of a stiffness and of dyad columns; a
        column's block of three components stays whole even if some are zero now."""
        n, n_dyads = columns.shape
        comm, n_global = self._stiffness.comm.tompi4py(), self._stiffness.getSize()[0]
        used = (columns != 0).reshape(n // 3, 3, n_dyads).any(axis=1)
        self._pattern = np.repeat(used, 3, axis=0)
        rows, dyads = np.nonzero(self._pattern)
        # The tensions' rows follow on the last rank. MUMPS reads only the upper triangle.
        tensions = np.arange(n_dyads * (comm.rank == comm.size - 1))
        widths, more = np.diff(pointers), np.bincount(rows, minlength=n)
        ends = np.cumsum(widths + more)
        self._pointers = np.concatenate([[0], ends, ends[-1:].sum() + 1 + tensions])
        self._pointers = self._pointers.astype(PETSc.IntType)
        before = np.repeat(np.cumsum(more) - more, widths)
        self._of_stiffness = np.arange(len(indices)) + before
        self._of_columns = np.arange(len(rows)) + pointers[1:][rows]
        size = self._pointers[-1]
        self._indices, self._values = np.empty(size, dtype=PETSc.IntType), -np.ones(size)
        self._indices[self._of_stiffness] = indices
        self._indices[self._of_columns] = n_global + dyads
        self._indices[size - len(tensions) :] = n_global + tensions
        local = n + len(tensions)
        self._matrix = PETSc.Mat().createAIJ(
            ((local, n_global + n_dyads),) * 2,
            csr=(self._pointers, self._indices, self._values),
            comm=comm,
        )
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._b, self._y = self._matrix.createVecs()
        self.factor = PETSc.PC().create(comm)
        self.factor.setOptionsPrefix(self._prefix)
        self.factor.setOperators(self._matrix)
        self.factor.setType(PETSc.PC.Type.CHOLESKY)
        self.factor.setFactorSolverType("mumps")
        self.factor.setFromOptions()
        self.factor.setFactorSetUpSolverType()
        matrix = self.factor.getFactorMatrix()
        for key, value in CONTROLS.items():
            matrix.setMumpsIcntl(key, value)
        if not self._pivoting:
            matrix.setMumpsCntl(THRESHOLD, 0.0)

    def solve(self, b: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve ``H0 y = b``."""
        n = b.getLocalSize()
        self._b.array[:n] = b.array_r
        self._b.array[n:] = 0.0
        self.factor.apply(self._b, self._y)
        y.array[:] = self._y.array_r[:n]
