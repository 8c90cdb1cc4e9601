"""Initial Hessian H0 of the quasi-Newton solver: sparse stiffness plus one dyad per cable.

A cable's elongation couples all its points: EA/L0 times the dyad of the length's gradient would be
a dense block. H0 = K + G C G^T keeps it apart, with the sparse stiffness K of all terms, a column
of G per taut cable, and C = diag(EA/L0). It is solved by Sherman-Morrison-Woodbury:

    H0^-1 = K^-1 - Z (C^-1 + G^T Z)^-1 Z^T,   Z = K^-1 G.

On several processes the solves for Z dominate, so H0 is factorised with the tensions as unknowns
(`augmented_stiffness.py`); so it is on one process where K alone is indefinite.

With very many unknowns and no cables, or by PETSc options, algebraic multigrid replaces K^-1, and
the formula preconditions conjugate gradients on K + G C G^T.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.augmented_stiffness import AugmentedStiffness
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import STRATEGY, Strategy
from crms_fenicsx.foundation.dofs.block_patterns import StiffnessMatrix
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.compat import direct_solver

QUIET = {"mat_cholmod_print": "0"}
"""Stops CHOLMOD from printing that a matrix is indefinite; errors are raised anyway."""
INDEFINITE = 76, 81
"""PETSc's error codes when an external factorisation finds K indefinite."""
WORKSPACE = 100
"""Extra memory for MUMPS beyond its estimate (per cent)."""
SHIFT = 1e-9
"""Shift of a stiffness's diagonal, relative to the sum of its block's trace and the geometric mean
of all traces. The largest trace, of a cable segment much shorter than a cell, would slow down the
soft sideways motion of whole cables."""

EXACT_SHIFT = 1e-12
"""The same for second derivatives, just above their rounding: they must be definite without it. A
cable on a stiff membrane has less lateral stiffness than `SHIFT` of the edges that it folds, and
Newton's method would take a hundredth of its steps."""

MULTIGRID = {
    "mg_levels_pc_type": "bjacobi",
    "mg_levels_sub_pc_type": "icc",
    "mg_levels_sub_pc_factor_shift_type": "positive_definite",
}
"""Smoother of the multigrid: Jacobi's does not resolve cables, long chains of stiff links."""


def at_bounds(potential: Potential) -> npt.NDArray[np.bool_]:
    """Owned components in contact with an obstacle, (n, 3)."""
    n = potential.unknowns.n_owned
    lower, upper = potential.unknowns.bounds  # type: ignore[misc]
    x, g = potential.x[:n], potential.g[:n]
    pressed: npt.NDArray[np.bool_] = ((x <= lower[:n]) & (g > 0)) | ((x >= upper[:n]) & (g < 0))
    return pressed


def _set_defaults(prefix: str, values: dict[str, str]) -> None:
    """Set options in PETSc's database unless present."""
    options = PETSc.Options(prefix)
    for name, value in values.items():
        if not options.hasName(name):
            options[name] = value


def _shift_diagonal(matrix: PETSc.Mat, traces: Array, part: float = SHIFT) -> Array:
    """Shift a matrix's diagonal by a small part of the owned blocks' traces (n,) plus their
    geometric mean, and return the shift of each block, (n,)."""
    some = np.log(traces[traces > 0.0])
    total = np.array([some.sum(), len(some)])
    matrix.getComm().tompi4py().Allreduce(MPI.IN_PLACE, total)
    mean = float(np.exp(total[0] / total[1])) if total[1] else 1.0
    added = matrix.createVecLeft()
    shift: Array = part * (np.maximum(traces, 0.0) + mean)
    added.array[:] = np.repeat(shift, 3)
    matrix.setDiagonal(added, PETSc.InsertMode.ADD_VALUES)
    added.destroy()
    return shift


def _set_near_null_space(matrix: PETSc.Mat, potential: Potential) -> None:
    """Attach the rigid body modes as near null space for the coarse levels."""
    unknowns, comm = potential.unknowns, potential.comm
    motions = [matrix.createVecLeft() for _ in range(6)]
    n = motions[0].getLocalSize() // 3
    places = unknowns.X[:n] + potential.x[:n]
    places = places - comm.allreduce(places.sum(axis=0)) / (motions[0].getSize() // 3)
    for k, axis in enumerate(np.eye(3)):
        motions[k].array[:] = np.tile(axis, n)
        motions[3 + k].array[:] = np.cross(axis, places).ravel()
    for k, motion in enumerate(motions):
        for other in motions[:k]:
            motion.axpy(-motion.dot(other), other)
        motion.normalize()
    space = PETSc.NullSpace().create(vectors=motions, comm=comm)
    matrix.setNearNullSpace(space)
    for kept in (space, *motions):
        kept.destroy()


def stiffen_across_sliders(A: PETSc.Mat, unknowns: Unknowns, value: float) -> None:
    """Add this stiffness where sliders cannot move, as they have none there. Collective."""
    own = unknowns.sliders < unknowns.n_owned
    across = value * (np.eye(3) - unknowns.projectors[own])
    blocks = unknowns.sliders[own, None].astype(PETSc.IntType)
    A.setValuesBlockedLocalRCV(blocks, blocks, across.reshape(-1, 9), PETSc.InsertMode.ADD)
    A.assemble()


class InitialHessian:
    """Positive definite H0 of a potential, decoupled from held and across-slider components.

    Attributes: `matrix`: K; `shift` (n_owned,): last shift of K's diagonal blocks (force/length);
    `slackened`: whether it counts nearly taut cables as slack.
    """

    def __init__(self, potential: Potential, prefix: str, strategy: Strategy = STRATEGY) -> None:
        self.potential, self.strategy = potential, strategy
        unknowns = potential.unknowns
        self._stiffness = StiffnessMatrix(unknowns, potential.patterns())
        self.matrix = self._stiffness.petsc
        self.pc = PETSc.PC().create(unknowns.comm)
        self.pc.setOptionsPrefix(prefix)
        self.pc.setOperators(self.matrix)
        cables = any(term.of_cables for term in potential.terms)
        if cables or 3 * unknowns.n_global <= strategy.direct:
            self.pc.setType(PETSc.PC.Type.CHOLESKY)
            self.pc.setFactorSolverType(direct_solver(unknowns.comm))
        else:
            self.pc.setType(PETSc.PC.Type.GAMG)
        self.pc.setFromOptions()
        if self.pc.getType() == PETSc.PC.Type.GAMG:
            _set_defaults(prefix, MULTIGRID)
        self._exact = self.pc.getType() in (PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU)
        if self._exact and self.pc.getFactorSolverType() == "mumps":
            # MUMPS's own estimate is too small for some partitions, and it fails then. The options
            # database still takes precedence.
            self.pc.setFactorSetUpSolverType()
            self.pc.getFactorMatrix().setMumpsIcntl(14, WORKSPACE)
        self._augmented: AugmentedStiffness | None = None
        if self.pc.getType() == PETSc.PC.Type.CHOLESKY and PETSc.Sys.hasExternalPackage("mumps"):
            self._augmented = AugmentedStiffness(self.matrix, prefix)
        self._is_augmented = False
        self._outer: PETSc.KSP | None = None
        self._dyads: Array = np.zeros(0)
        self.shift: Array = np.zeros(0)
        self.slackened = False

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._outer is not None:
            self._outer.getOperators()[0].destroy()
            self._outer.destroy()
        if self._augmented is not None:
            self._augmented.destroy()
        self.pc.destroy()
        self._stiffness.destroy()

    def rebuild(self, exact: bool = False) -> bool:
        """Assemble at the potential's current state, whose sums and `g` (unbalanced forces) must be
        up to date. Returns whether H0 is definite, as far as is known; otherwise it is unusable."""
        exact &= self._exact
        held = self.assemble(exact)
        if not self._exact:
            _set_near_null_space(self.matrix, self.potential)
        self._dyads, columns = self.potential.dyad_columns(held, exact)
        self.slackened = exact and len(self._dyads) < sum(1 for _ in self.potential.dyads())
        augmentable = self._augmented is not None and len(self._dyads) > 0
        self._is_augmented = augmentable and self.pc.getFactorSolverType() == "mumps"
        if not self._is_augmented and self._set_up():
            self._add_dyads(columns)
            return True
        self._is_augmented = augmentable
        if self._augmented is None or not augmentable:
            return False
        return self._augmented.factorize(columns * np.sqrt(self._dyads))

    def _set_up(self) -> bool:
        """Factorise K, or set up multigrid, and return whether K is definite."""
        if self._exact and self.pc.getFactorSolverType() == "cholmod":
            _set_defaults(self.pc.getOptionsPrefix(), QUIET)
        try:
            self.pc.setUp()
        except PETSc.Error as error:
            if error.ierr not in INDEFINITE:
                raise
            kind, library = self.pc.getType(), self.pc.getFactorSolverType()
            self.pc.reset()
            self.pc.setOperators(self.matrix)
            self.pc.setType(kind)
            self.pc.setFactorSolverType(library)
            return False
        return True

    def assemble(self, exact: bool) -> npt.NDArray[np.bool_]:
        """Only assemble K at the potential's state, and return owned held components, (n, 3)."""
        A, unknowns = self.matrix, self.potential.unknowns
        held = unknowns.held[: unknowns.n_owned].copy()
        if unknowns.bounds is not None:
            held |= at_bounds(self.potential)
        self._held = held
        self._stiffness.clear()
        self.potential.add_stiffness(self._stiffness, exact)
        self._stiffness.assemble()
        diagonal = A.getDiagonal()
        traces = np.where(held, 0.0, diagonal.array.reshape(-1, 3)).sum(axis=1)  # of each block
        diagonal.destroy()
        sizes = np.array([traces.max(initial=0.0), unknowns.n_sliders])
        unknowns.comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
        largest = float(sizes[0]) if sizes[0] > 0 else 1.0
        self.shift = _shift_diagonal(A, traces, EXACT_SHIFT if exact else SHIFT)
        if sizes[1]:
            stiffen_across_sliders(A, unknowns, largest)
        rows = np.flatnonzero(held) + 3 * unknowns.start
        A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=largest)
        A.setOption(PETSc.Mat.Option.SPD, True)
        return held

    def _add_dyads(self, columns: Array) -> None:
        """Compute this rank's rows of Z = K^-1 G, and (C^-1 + G^T Z)^-1."""
        self._columns, self._shares = columns, np.empty(len(self._dyads))
        if not len(self._dyads):
            return
        self._solved = self._apply_to_all(columns)
        products = columns.T @ self._solved
        self.potential.comm.Allreduce(MPI.IN_PLACE, products)
        self._inner = np.linalg.inv(np.diag(1 / self._dyads) + products)

    def _apply_to_all(self, columns: Array) -> Array:
        """K^-1 or its preconditioner applied to columns: all at once if factorised, much faster. By
        multigrid one by one: several at once crash on several processes (PETSc 3.25)."""
        solved = np.empty_like(columns)
        if not self._exact:
            b, y = self.matrix.createVecs()
            for k in range(columns.shape[1]):
                b.array[:] = columns[:, k]
                self.pc.apply(b, y)
                self._take_out(y.array)
                solved[:, k] = y.array
            b.destroy()
            y.destroy()
            return solved
        size = ((len(columns), 3 * self.potential.unknowns.n_global), (None, columns.shape[1]))
        B, Y = (
            PETSc.Mat().createDense(size, array=array, comm=self.potential.comm)
            for array in (columns, solved)
        )
        self.pc.matApply(B, Y)
        B.destroy()
        Y.destroy()
        return solved

    def _sums_over_ranks(self, rows: Array, vector: PETSc.Vec) -> Array:
        """``rows^T vector`` by one reduction; valid until the next call."""
        np.dot(rows.T, vector.array_r, out=self._shares)
        self.potential.comm.Allreduce(MPI.IN_PLACE, self._shares)
        return self._shares

    def solve_for(self, ksp: PETSc.KSP) -> None:
        """Make `ksp` a solver of H0."""
        ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(Preconditioner(self.solve))

    def solve(self, b: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve ``H0 y = b``."""
        if self._augmented is not None and self._is_augmented:
            self._augmented.solve(b, y)
            return
        if self._exact:
            self.precondition(b, y)
            return
        if self._outer is None:
            self._outer = self._conjugate_gradients()
        self._outer.solve(b, y)

    def precondition(self, b: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply H0^-1 with K's preconditioner in place of K^-1; exact if K is factorised."""
        self.pc.apply(b, y)
        if not self._exact:
            self._take_out(y.array)
        if len(self._dyads):
            y.array -= self._solved @ (self._inner @ self._sums_over_ranks(self._solved, b))

    def _take_out(self, y: Array) -> None:
        """Remove held and across-slider components from multigrid's result, whose coarse levels
        ignore these constraints. It stays symmetric for right-hand sides without them."""
        unknowns = self.potential.unknowns
        values = y.reshape(-1, 3)
        values[self._held] = 0.0
        if unknowns.n_sliders:
            own = unknowns.sliders < unknowns.n_owned
            sliders, P = unknowns.sliders[own], unknowns.projectors[own]
            values[sliders] = np.einsum("nij,nj->ni", P, values[sliders])

    def multiply(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """``y = (K + G C G^T) x``."""
        self.matrix.mult(x, y)
        if len(self._dyads):
            y.array += self._columns @ (self._dyads * self._sums_over_ranks(self._columns, x))

    def _conjugate_gradients(self) -> PETSc.KSP:
        ksp = PETSc.KSP().create(self.potential.comm)
        operator = PETSc.Mat().createPython(self.matrix.getSizes(), comm=self.potential.comm)
        operator.setPythonContext(_Multiply(self.multiply))
        operator.setUp()
        ksp.setOperators(operator)
        ksp.setOptionsPrefix(self.pc.getOptionsPrefix())
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.setTolerances(rtol=self.strategy.cg_accuracy)
        ksp.setFromOptions()
        ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        ksp.getPC().setPythonContext(Preconditioner(self.precondition))
        return ksp


class Preconditioner:
    """PETSc Python preconditioner (PETSc would also call a `destroy`)."""

    def __init__(self, solve: Callable[[PETSc.Vec, PETSc.Vec], None]) -> None:
        self.solve = solve

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, y: PETSc.Vec) -> None:
        self.solve(b, y)


class _Multiply:
    """PETSc Python matrix."""

    def __init__(self, multiply: Callable[[PETSc.Vec, PETSc.Vec], None]) -> None:
        self.multiply = multiply

    def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self.multiply(x, y)
