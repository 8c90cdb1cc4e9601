"""Multigrid under cables: their points eliminated exactly, then the membrane as if without them.

Cables' points are tied to soft fabric by stiff springs, to which multigrid is blind: on the whole
stiffness K conjugate gradients take more than a thousand iterations. With the points p before the
vertices v,

    K = [ Kpp  Kpv ]      S = Kvv - Kvp Kpp^-1 Kpv,
        [ Kvp  Kvv ]

Kpp is a set of chains, which is cheap to factorise. What is left of a folded cell or of a penalty
in the Schur complement S is nearly the plain cell: the point lies near the line between the
vertices. So multigrid on M, the stiffness of the membrane with all cells plain and without cables,
takes the place of S^-1:

    B = [ 1  -Kpp^-1 Kpv ] [ Kpp^-1      ] [ 1             ]
        [          1     ] [         M^-1 ] [ -Kvp Kpp^-1  1 ].

B is symmetric and positive definite whatever stands for Kpp^-1 and M^-1, if these are.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.dofs.stiffness_matrix import StiffnessMatrix
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Array


def stiffen_across_edge_sliders(A: PETSc.Mat, unknowns: Unknowns, value: float) -> None:
    """Give the components across the edge sliders, which have no stiffness, this one.
    Collective."""
    own = unknowns.edge_sliders < unknowns.n_owned
    d = unknowns.directions[own]
    across = value * (np.eye(3) - d[:, :, None] * d[:, None, :])
    blocks = unknowns.edge_sliders[own, None].astype(PETSc.IntType)
    A.setValuesBlockedLocalRCV(blocks, blocks, across.reshape(-1, 9), PETSc.InsertMode.ADD)
    A.assemble()


def exact_matrix(potential: Potential) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Second derivatives at the potential's current state, evaluated there. Collective. Rows and
    columns of held components, of those across edge sliders and of points that no term touches are
    those of the identity. Returns all of them, and all but the dyads of what couples very many
    points, as a cable's length; the same object where there are none. They are to be destroyed."""
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
    stiffnesses, columns = potential.dyad_columns(held)
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
"""Added to a stiffness's diagonal, relative to the sum of its block's trace and the geometric mean
of all. The largest trace alone, that of a cable's segment much shorter than a cell, would slow down
the soft sideways motion of whole cables."""

EXACT_SHIFT = 1e-12
"""The same for second derivatives, which are of use only if definite without it: so much more than
their rounding. On a stiff membrane a cable is held sideways by less than `SHIFT` of the stiffness
of the edges that it folds, and Newton's method would take a hundredth of its steps."""

MULTIGRID = {
    "mg_levels_pc_type": "bjacobi",
    "mg_levels_sub_pc_type": "icc",
    "mg_levels_sub_pc_factor_shift_type": "positive_definite",
}
"""Smoother of the multigrid: cables are long chains of stiff links, to which Jacobi's is blind."""


def set_defaults(prefix: str, values: dict[str, str]) -> None:
    """Put options into PETSc's database unless they are there."""
    options = PETSc.Options(prefix)
    for name, value in values.items():
        if not options.hasName(name):
            options[name] = value


def block_traces(matrix: PETSc.Mat, held: npt.NDArray[np.bool_]) -> Array:
    """Traces of the owned diagonal blocks without components that are held, (n, 3); (n,). They do
    not depend on how the scene is turned in space."""
    diagonal = matrix.getDiagonal()
    traces: Array = np.where(held, 0.0, diagonal.array.reshape(-1, 3)).sum(axis=1)
    diagonal.destroy()
    return traces


def shift_diagonal(matrix: PETSc.Mat, traces: Array, part: float = SHIFT) -> Array:
    """Add to a matrix's diagonal a small part of the owned blocks' traces, (n,), and their mean.
    Returns what was added to each block, (n,)."""
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


def tell_rigid_motions(matrix: PETSc.Mat, potential: Potential) -> None:
    """Attach what costs little energy, of which multigrid makes its coarse levels. The matrix is of
    all blocks, or of the vertices, which come first."""
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
    """The stiffness of the membrane without cables, in a preconditioner of type `fieldsplit`.

    Attributes: `matrix`: M, of the vertices, numbered as by DOLFINx.
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
        """Set the preconditioner's fields, and how each is solved by default."""
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
        # All ranks factorise all chains: their solves take half of the time of MUMPS's on two.
        points = {"ksp_type": "preonly", "pc_type": "redundant"}
        points["redundant_pc_type"] = "cholesky"
        points["redundant_pc_factor_mat_solver_type"] = "cholmod"
        # PETSc would take residuals with S, which is not what the levels are made of.
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
        tell_rigid_motions(M, self.potential)
