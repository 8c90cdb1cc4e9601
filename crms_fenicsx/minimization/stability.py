"""Stability: negative eigenvalues of the second derivatives; convexity of the way to a state.

A factorisation K = L D L^T of the sparse part tells how many it has (Sylvester). With the dyads
G C G^T, C > 0, there are (Haynsworth)

    n(K + G C G^T) = n(K) + p(C^-1 + G^T K^-1 G) - m,

n and p the numbers of negative and positive eigenvalues, m that of the dyads.

Along the straight way from one state to the other the energy's slope rises where it is convex. At
the end's loads a stable path from the start leads down such a way, and the slope goes up to zero.
Where the slope falls in between, the energy has negative second derivatives there: something may
have snapped through. Only the slopes' ratios count, so that units and sizes do not.
"""

from __future__ import annotations

import itertools

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.minimization.initial_hessian import WORKSPACE, InitialHessian
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Array, Indices

FALL = 0.01
"""Fall of the slope, relative to the largest one, from which on the energy is not convex."""

PLACES = (0.0, 1 / 3, 2 / 3, 1.0)
"""Where the slope is found, as parts of the way; the last one is the state itself."""


def is_convex_from(potential: Potential, start: Array) -> bool:
    """Whether the energy is convex on the way from a start to the potential's state. Collective. It
    takes four evaluations; the state is afterwards as before, and evaluated. Shapes and units:
    start (n_local, 3) (length)."""
    n, end = potential.unknowns.n_owned, potential.x.copy()
    way = end - start
    free = np.where(potential.unknowns.held[:n], 0.0, way[:n])
    slopes = np.zeros(len(PLACES))
    for k, part in enumerate(PLACES):
        potential.x[:] = end if part == 1.0 else start + part * way
        potential.place()
        potential.evaluate()
        slopes[k] = np.vdot(potential.g[:n], free)
    potential.comm.Allreduce(MPI.IN_PLACE, slopes, op=MPI.SUM)
    falls = [a - b for a, b in itertools.combinations(slopes.tolist(), 2)]
    return bool(max(falls) <= FALL * np.abs(slopes).max())


NEGATIVE_PIVOTS = 12
"""Where MUMPS's global information has their number."""


class ExactTangent:
    """The second derivatives of a potential at its state, factorised. Collective.

    Attributes: `negative`: number of ways in which the energy falls. Shapes and units: springs
    (n_owned,) (force/length).
    """

    def __init__(
        self, potential: Potential, h0: InitialHessian, springs: Array | None = None
    ) -> None:
        self.potential = potential
        potential.evaluate()
        self._held, A = h0.assemble(exact=True), h0.matrix
        if springs is not None:
            diagonal = A.getDiagonal()
            free = ~np.isnan(springs)[:, None] & ~self._held
            change = (np.nan_to_num(springs) - h0.shift)[:, None]
            diagonal.array[:] += np.where(free, change, 0.0).ravel()
            A.setDiagonal(diagonal)
            diagonal.destroy()
        A.setOption(PETSc.Mat.Option.SPD, False)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._matrix, self._pc = A, PETSc.PC().create(potential.comm)
        self._pc.setOperators(A)
        self._pc.setType(PETSc.PC.Type.CHOLESKY)
        self._pc.setFactorSolverType("mumps")
        self._pc.setFactorSetUpSolverType()
        self._pc.getFactorMatrix().setMumpsIcntl(14, WORKSPACE)
        self._pc.setUp()
        self._pc.setReusePreconditioner(True)  # the matrix may become another one
        negative = int(self._pc.getFactorMatrix().getMumpsInfog(NEGATIVE_PIVOTS))
        self._stiffness, columns = potential.dyad_columns(self._held)
        self._columns = columns.T
        self._solved = self._apply(self._columns)
        products = self._products(self._columns, self._solved)
        self._inner = np.diag(1 / self._stiffness) + (products + products.T) / 2
        positive = int(np.sum(np.linalg.eigvalsh(self._inner) > 0.0))
        self.negative = negative + positive - len(self._stiffness)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._pc.destroy()

    def compliance(self, blocks: Indices) -> Array:
        """Displacements of blocks by unit forces on them, (3 k, 3 k) (length/force). Collective.
        Shapes: blocks (k,)."""
        potential, unknowns = self.potential, self.potential.unknowns
        n, first = unknowns.n_owned, potential.comm.rank == 0
        found: Array = np.zeros((3 * len(blocks), 3 * len(blocks)))
        for k in range(3 * len(blocks)):
            potential.g[:] = 0.0
            if first:
                potential.g[blocks[k // 3], k % 3] = 1.0
            unknowns.gather_forces(potential.g_vector, potential.g)
            force = np.where(self._held, 0.0, potential.g[:n]).reshape(1, -1)
            potential.g[:n] = self._solve(force).reshape(n, 3)
            unknowns.update_ghosts(potential.g_vector)
            if first:
                found[k, :] = potential.g[blocks].ravel()
        return np.asarray(potential.comm.bcast((found + found.T) / 2))

    def _solve(self, vectors: Array) -> Array:
        """The inverse with the dyads on vectors, (k, 3 n_owned)."""
        found = self._apply(vectors)
        if len(self._columns):
            shares = np.linalg.solve(self._inner, self._products(self._solved, vectors))
            found -= shares.T @ self._solved
        return found

    def _apply(self, vectors: Array) -> Array:
        """``K^-1`` on vectors, (k, 3 n_owned)."""
        b, y = self._matrix.createVecs()
        found = np.zeros_like(vectors)
        for k, vector in enumerate(vectors):
            b.array[:] = vector
            self._pc.apply(b, y)
            found[k, :] = y.array_r
        b.destroy()
        y.destroy()
        return found

    def _products(self, a: Array, b: Array) -> Array:
        """Products of vectors, (k, m)."""
        products = np.ascontiguousarray(a @ b.T)
        self.potential.comm.Allreduce(MPI.IN_PLACE, products, op=MPI.SUM)
        return products
