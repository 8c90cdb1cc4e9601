"""Is an equilibrium stable? How many eigenvalues of the second derivatives are negative.

A factorisation K = L D L^T of the sparse part tells how many it has (Sylvester). With the dyads
G C G^T, C > 0, there are (Haynsworth)

    n(K + G C G^T) = n(K) + p(C^-1 + G^T K^-1 G) - m,

n and p the numbers of negative and positive eigenvalues, m that of the dyads.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.minimization.initial_hessian import WORKSPACE, InitialHessian
from crms_fenicsx.minimization.potential import Potential

NEGATIVE_PIVOTS = 12
"""Where MUMPS's global information has their number."""


def negative_eigenvalues(potential: Potential, h0: InitialHessian) -> int:
    """Number of ways in which the energy falls from an equilibrium. Collective.

    Parameters
    ----------
    potential
        In an equilibrium; it is evaluated there.
    h0
        Its matrix is used, and has to be rebuilt afterwards.
    """
    potential.evaluate()
    held, n = h0.assemble(exact=True), potential.unknowns.n_owned
    h0.matrix.setOption(PETSc.Mat.Option.SPD, False)
    h0.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    pc = PETSc.PC().create(potential.comm)
    pc.setOperators(h0.matrix)
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType("mumps")
    pc.setFactorSetUpSolverType()
    pc.getFactorMatrix().setMumpsIcntl(14, WORKSPACE)
    pc.setUp()
    negative = int(pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS))
    dyads = list(potential.dyads())
    columns, products = np.zeros((len(dyads), 3 * n)), np.zeros((len(dyads), len(dyads)))
    column, solved = h0.matrix.createVecs()
    for k, (term, number, _) in enumerate(dyads):
        potential.dyad_column(term, number)
        potential.g[:n][held] = 0.0
        columns[k] = potential.g[:n].ravel()
    for k in range(len(dyads)):
        column.array[:] = columns[k]
        pc.apply(column, solved)
        products[k] = columns @ solved.array
    for thing in (pc, column, solved):
        thing.destroy()
    potential.comm.Allreduce(MPI.IN_PLACE, products, op=MPI.SUM)
    inner = np.diag([1 / value for _, _, value in dyads]) + (products + products.T) / 2
    return negative + int(np.sum(np.linalg.eigvalsh(inner) > 0.0)) - len(dyads)
