"""The initial Hessian H0 of the quasi-Newton solver: sparse stiffness and a dyad for each cable.

The elongation of a whole cable couples all its points: its stiffness EA/L0 times the dyad of the
length's gradient would be a dense block. H0 = K + G C G^T keeps it apart, with the sparse stiffness
K of all terms, factorised, a column of G for each cable in tension and C = diag(EA/L0). It is
solved by the formula of Sherman, Morrison and Woodbury,

    H0^-1 = K^-1 - Z (C^-1 + G^T Z)^-1 Z^T,   Z = K^-1 G.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.potential import Potential

Array = npt.NDArray[np.float64]

SHIFT = 1e-9
"""Added to the diagonal of K, relative to its largest block's trace."""
WORKSPACE = 100
"""How much more memory MUMPS takes than it estimates, in per cent."""


def at_bounds(potential: Potential) -> npt.NDArray[np.bool_]:
    """Owned components that are pressed against an obstacle, (n, 3)."""
    n = potential.unknowns.n_owned
    lower, upper = potential.unknowns.bounds  # type: ignore[misc]
    x, g = potential.x[:n], potential.g[:n]
    pressed: npt.NDArray[np.bool_] = ((x <= lower[:n]) & (g > 0)) | ((x >= upper[:n]) & (g < 0))
    return pressed


class InitialHessian:
    """H0 of a potential, positive definite; held components and those across rails are decoupled.

    Parameters
    ----------
    potential
        Its terms' stiffness is assembled.
    prefix
        Prefix of the options of K's solver; by default CHOLMOD on one process and MUMPS on
        several.

    Attributes
    ----------
    matrix : PETSc.Mat
        K.
    """

    def __init__(self, potential: Potential, prefix: str) -> None:
        self.potential = potential
        unknowns = potential.unknowns
        self.matrix = PETSc.Mat().create(unknowns.comm)
        self.matrix.setSizes(((3 * unknowns.n_owned, 3 * unknowns.n_global),) * 2)
        self.matrix.setBlockSize(3)
        self.matrix.setType(PETSc.Mat.Type.AIJ)
        lgmap = unknowns.lgmap()
        self.matrix.setLGMap(lgmap, lgmap)
        lgmap.destroy()
        self.matrix.setUp()
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.ksp = PETSc.KSP().create(unknowns.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(self.matrix)
        self.ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self.ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType("cholmod" if unknowns.comm.size == 1 else "mumps")
        self.ksp.setFromOptions()
        if pc.getFactorSolverType() == "mumps":
            # Its estimate is too small for some distributions of a mesh, and it fails then. What
            # is in the options database still comes first.
            pc.setFactorSetUpSolverType()
            pc.getFactorMatrix().setMumpsIcntl(14, WORKSPACE)
        self._new = True
        self._columns: list[PETSc.Vec] = []
        self._solved: list[PETSc.Vec] = []
        self._inner: Array = np.zeros((0, 0))

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._drop_columns()
        self.ksp.destroy()
        self.matrix.destroy()

    def _drop_columns(self) -> None:
        for vector in (*self._columns, *self._solved):
            vector.destroy()
        self._columns, self._solved = [], []

    def rebuild(self) -> None:
        """Assemble at the potential's current state.

        Its sums must be up to date, and `g` the unbalanced forces there.
        """
        held = self.potential.unknowns.held[: self.potential.unknowns.n_owned].copy()
        if self.potential.unknowns.bounds is not None:
            held |= at_bounds(self.potential)
        self._assemble(held)
        self._drop_columns()
        self._add_dyads(held)

    def _assemble(self, held: npt.NDArray[np.bool_]) -> None:
        A, unknowns = self.matrix, self.potential.unknowns
        A.zeroEntries()
        if self._new:  # every diagonal entry must exist, also of points that no term touches
            blocks = unknowns.matrix_numbers[unknowns.n_vertices : unknowns.n_owned, None]
            A.setValuesBlockedLocalRCV(
                blocks, blocks, np.zeros((unknowns.n_points, 9)), PETSc.InsertMode.ADD
            )
            self._new = False
        self.potential.add_stiffness(A)
        A.assemble()
        diagonal = A.getDiagonal()
        # The trace of a block does not depend on how the scene is turned in space.
        traces = np.where(held, 0.0, diagonal.array.reshape(-1, 3)).sum(axis=1)
        diagonal.destroy()
        sizes = np.array([traces.max(initial=0.0), unknowns.n_rails])
        unknowns.comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
        largest = float(sizes[0]) if sizes[0] > 0 else 1.0
        A.shift(SHIFT * largest)
        if sizes[1]:
            self._stiffen_across_rails(largest)
        rows = np.flatnonzero(held) + 3 * unknowns.start
        A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=largest)
        A.setOption(PETSc.Mat.Option.SPD, True)

    def _stiffen_across_rails(self, value: float) -> None:
        """Give the components across the rails, which have no stiffness, this one."""
        A, unknowns = self.matrix, self.potential.unknowns
        own = unknowns.rails < unknowns.n_owned
        d = unknowns.directions[own]
        across = value * (np.eye(3) - d[:, :, None] * d[:, None, :])
        blocks = unknowns.matrix_numbers[unknowns.rails[own], None]
        A.setValuesBlockedLocalRCV(blocks, blocks, across.reshape(-1, 9), PETSc.InsertMode.ADD)
        A.assemble()

    def _add_dyads(self, held: npt.NDArray[np.bool_]) -> None:
        """Columns G, Z = K^-1 G and (C^-1 + G^T Z)^-1."""
        potential, stiffness = self.potential, []
        n = potential.unknowns.n_owned
        for term, k, value in potential.dyads():
            potential.dyad_column(term, k)
            potential.g[:n][held] = 0.0
            column, solved = potential.g_vector.copy(), potential.g_vector.duplicate()
            self.ksp.solve(column, solved)
            self._columns.append(column)
            self._solved.append(solved)
            stiffness.append(value)
        products = [[g.dot(z) for z in self._solved] for g in self._columns]
        if stiffness:
            inner = np.diag(1 / np.array(stiffness)) + np.array(products)
            self._inner = np.asarray(np.linalg.inv(inner), dtype=float)

    def solve_for(self, ksp: PETSc.KSP) -> None:
        """Make `ksp` a solver of H0."""
        ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(_Solve(self))

    def solve(self, b: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve ``H0 y = b``."""
        self.ksp.solve(b, y)
        if self._solved:
            shares = self._inner @ np.array([z.dot(b) for z in self._solved])
            for share, z in zip(shares, self._solved, strict=True):
                y.axpy(-share, z)


class _Solve:
    """What PETSc calls as a preconditioner; it would also call a `destroy`."""

    def __init__(self, h0: InitialHessian) -> None:
        self.h0 = h0

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, y: PETSc.Vec) -> None:
        self.h0.solve(b, y)
