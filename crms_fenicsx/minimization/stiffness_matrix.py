"""Matrices of a potential's unknowns: that of H0, and that of the exact second derivatives."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.minimization.potential import Potential


def empty_matrix(potential: Potential) -> PETSc.Mat:
    """A matrix with places for the stiffness of all terms, to be destroyed. Collective."""
    unknowns = potential.unknowns
    A = PETSc.Mat().create(unknowns.comm)
    A.setSizes(((3 * unknowns.n_owned, 3 * unknowns.n_global),) * 2)
    A.setBlockSize(3)
    A.setType(PETSc.Mat.Type.AIJ)
    lgmap = unknowns.lgmap()
    A.setLGMap(lgmap, lgmap)
    lgmap.destroy()
    potential.count_stiffness().allocate(A)
    A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    return A


def add_empty_diagonal(A: PETSc.Mat, unknowns: Unknowns) -> None:
    """Make places for every diagonal entry, also of points that no term touches."""
    blocks = unknowns.matrix_numbers[: unknowns.n_owned, None]
    zeros = np.zeros((unknowns.n_owned, 9))
    A.setValuesBlockedLocalRCV(blocks, blocks, zeros, PETSc.InsertMode.ADD)


def stiffen_across_rails(A: PETSc.Mat, unknowns: Unknowns, value: float) -> None:
    """Give the components across the rails, which have no stiffness, this one. Collective."""
    own = unknowns.rails < unknowns.n_owned
    d = unknowns.directions[own]
    across = value * (np.eye(3) - d[:, :, None] * d[:, None, :])
    blocks = unknowns.matrix_numbers[unknowns.rails[own], None]
    A.setValuesBlockedLocalRCV(blocks, blocks, across.reshape(-1, 9), PETSc.InsertMode.ADD)
    A.assemble()


def exact_matrix(potential: Potential) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Second derivatives at the potential's current state, evaluated there. Collective.

    Rows and columns of held components, of those across rails and of points that no term touches
    are those of the identity. Returns all of them, and all but the dyads of what couples very many
    points, as a cable's length; the same object where there are none. They are to be destroyed.
    """
    unknowns = potential.unknowns
    n, held = unknowns.n_owned, unknowns.held[: unknowns.n_owned]
    A = empty_matrix(potential)
    add_empty_diagonal(A, unknowns)
    potential.add_stiffness(A, exact=True)
    A.assemble()
    if unknowns.comm.allreduce(unknowns.n_rails):
        stiffen_across_rails(A, unknowns, 1.0)
    diagonal = A.getDiagonal()
    idle = ~diagonal.array.reshape(-1, 3).any(axis=1)
    idle[: unknowns.n_vertices] = False
    diagonal.destroy()
    rows = np.flatnonzero(held | idle[:, None]) + 3 * unknowns.start
    A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=1.0)
    dyads = list(potential.dyads())
    if not dyads:
        return A, A
    columns = np.empty((3 * n, len(dyads)), order="F")
    for column, (term, k, _) in zip(columns.T, dyads, strict=True):
        potential.dyad_column(term, k)
        potential.g[:n][held] = 0.0
        column[:] = potential.g[:n].ravel()
    size = ((3 * n, 3 * unknowns.n_global), (None, len(dyads)))
    U = PETSc.Mat().createDense(size, array=columns, comm=unknowns.comm)
    values = PETSc.Vec().createWithArray(
        np.array([value for _, _, value in dyads]), comm=PETSc.COMM_SELF
    )
    whole = PETSc.Mat().createLRC(A, U, values, U)
    U.destroy()
    values.destroy()
    return whole, A
