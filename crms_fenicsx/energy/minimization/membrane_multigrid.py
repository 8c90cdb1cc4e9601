"""Multigrid under cables: cable points are eliminated exactly, the membrane by multigrid.

Stiff springs tie cable points to soft fabric, which multigrid does not resolve: with the whole K
conjugate gradients take over a thousand iterations. With points p before vertices v,

    K = [ Kpp  Kpv ]      S = Kvv - Kvp Kpp^-1 Kpv,
        [ Kvp  Kvv ]

Kpp consists of chains, which are cheap to factorise. In the Schur complement S a folded cell or a
penalty amounts nearly to the plain cell, as the point lies near the line between the vertices. So
multigrid on M, the stiffness of the membrane with plain cells and without cables, replaces S^-1:

    B = [ 1  -Kpp^-1 Kpv ] [ Kpp^-1      ] [ 1             ]
        [          1     ] [         M^-1 ] [ -Kvp Kpp^-1  1 ].

B is symmetric positive definite for any such approximations of Kpp^-1 and M^-1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.dofs.stiffness_matrix import StiffnessMatrix
from crms_fenicsx.foundation.runtime.arrays import Array


def stiffen_across_edge_sliders(A: PETSc.Mat, unknowns: Unknowns, value: float) -> None:
    """Add this stiffness across the edge sliders, which have none there. Collective."""
    own = unknowns.edge_sliders < unknowns.n_owned
    d = unknowns.directions[own]
    across = value * (np.eye(3) - d[:, :, None] * d[:, None, :])
    blocks = unknowns.edge_sliders[own, None].astype(PETSc.IntType)
    A.setValuesBlockedLocalRCV(blocks, blocks, across.reshape(-1, 9), PETSc.InsertMode.ADD)
    A.assemble()


def exact_matrix(potential: Potential) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Second derivatives at the potential's current state, which must be evaluated. Collective.
    Rows and columns of held components, of those across edge sliders and of points that no term
    touches are the identity's. Returns the whole matrix and the one without the dyads that couple
    very many points (as a cable's length); the same object without dyads. Destroy both."""
    unknowns = potential.unknowns
    n, held = unknowns.n_owned, unknowns.held[: unknowns.n_owned]
    stiffness = StiffnessMatrix(unknowns, potential.patterns())
    potential.add_stiffness(stiffness, exact=True)
    stiffness.assemble()
    A = stiffness.petsc
    if unknowns.comm.allreduce(unknowns.n_edge_sliders):
        stiffen_across_edge_sliders(A, unknowns, 1.0)
    diagonal = A.getDiagonal()
    idle = ~diagonal.array.reshape(-1, 3).any(axis=1)
    idle[: unknowns.n_vertices] = False
    diagonal.destroy()
    rows = np.flatnonzero(held | idle[:, None]) + 3 * unknowns.start
    A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=1.0)
    stiffnesses, columns = potential.dyad_columns(held, exact=True)
    if not len(stiffnesses):
        return A, A
    size = ((3 * n, 3 * unknowns.n_global), (None, len(stiffnesses)))
    U = PETSc.Mat().createDense(size, array=columns, comm=unknowns.comm)
    values = PETSc.Vec().createWithArray(stiffnesses, comm=PETSc.COMM_SELF)
    whole = PETSc.Mat().createLRC(A, U, values, U)
    U.destroy()
    values.destroy()
    return whole, A


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


def set_defaults(prefix: str, values: dict[str, str]) -> None:
    """Set options in PETSc's database unless present."""
    options = PETSc.Options(prefix)
    for name, value in values.items():
        if not options.hasName(name):
            options[name] = value


def block_traces(matrix: PETSc.Mat, held: npt.NDArray[np.bool_]) -> Array:
    """Traces (n,) of owned diagonal blocks without `held` components (n, 3); rotation invariant."""
    diagonal = matrix.getDiagonal()
    traces: Array = np.where(held, 0.0, diagonal.array.reshape(-1, 3)).sum(axis=1)
    diagonal.destroy()
    return traces


def shift_diagonal(matrix: PETSc.Mat, traces: Array, part: float = SHIFT) -> Array:
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


def set_near_null_space(matrix: PETSc.Mat, potential: Potential) -> None:
    """Attach the rigid body modes as near null space for the coarse levels; the matrix has all
    blocks, or the vertices, which come first."""
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


class MembraneMultigrid:
    """Stiffness of the membrane without cables, for a preconditioner of type `fieldsplit`.

    Attributes: `matrix`: M, of the vertices, in DOLFINx's numbering.
    """

    def __init__(self, potential: Potential, pc: PETSc.PC) -> None:
        self.potential = potential
        unknowns = potential.unknowns
        patterns = potential.patterns(cables=False)
        self._stiffness = StiffnessMatrix(unknowns, patterns, of_vertices=True)
        self.matrix = self._stiffness.petsc
        self._split(pc, pc.getOptionsPrefix() or "")

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._stiffness.destroy()

    def _split(self, pc: PETSc.PC, prefix: str) -> None:
        """Set the preconditioner's fields and their default solvers."""
        unknowns = self.potential.unknowns
        first, n = 3 * unknowns.start, 3 * unknowns.n_vertices
        fields = []
        for name, size, start in (
            ("points", 3 * unknowns.n_points, first + n),
            ("vertices", n, first),
        ):
            rows = PETSc.IS().createStride(size, start, 1, comm=unknowns.comm)
            rows.setBlockSize(3)
            fields.append((name, rows))
        pc.setFieldSplitIS(*fields)
        for _, rows in fields:
            rows.destroy()
        pc.setFieldSplitType(PETSc.PC.CompositeType.SCHUR)
        pc.setFieldSplitSchurFactType(PETSc.PC.FieldSplitSchurFactType.FULL)
        pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, self.matrix)
        # Each rank factorises all chains: on two ranks their solves take half of MUMPS's time.
        points = {"ksp_type": "preonly", "pc_type": "redundant"}
        points["redundant_pc_type"] = "cholesky"
        points["redundant_pc_factor_mat_solver_type"] = "cholmod"
        # PETSc would compute residuals with S, but the levels are built from M.
        vertices = {"ksp_type": "preonly", "pc_type": "gamg", "pc_use_amat": "false"}
        set_defaults(f"{prefix}fieldsplit_points_", points)
        set_defaults(f"{prefix}fieldsplit_vertices_", vertices | MULTIGRID)

    def assemble(self, held: npt.NDArray[np.bool_]) -> None:
        """Assemble M at the potential's current state; `held` are owned components, (n, 3)."""
        M, n = self.matrix, self.potential.unknowns.n_vertices
        self._stiffness.clear()
        self.potential.add_stiffness_without_cables(self._stiffness)
        self._stiffness.assemble()
        traces = block_traces(M, held[:n])
        largest = self.potential.comm.allreduce(float(traces.max(initial=0.0)), op=MPI.MAX) or 1.0
        shift_diagonal(M, traces)
        rows = np.flatnonzero(held[:n]) + M.getOwnershipRange()[0]
        M.zeroRowsColumns(rows.astype(PETSc.IntType), diag=largest)
        M.setOption(PETSc.Mat.Option.SPD, True)
        set_near_null_space(M, self.potential)
