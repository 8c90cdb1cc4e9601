"""Stability: negative eigenvalues of the second derivatives, and convexity on the way to a state.

A factorisation with cable tensions as unknowns counts negative eigenvalues (Sylvester's law).

Along the straight way between two states the slope of a convex energy rises. At the end's loads a
stable path from the start leads down such a way, with the slope rising to zero. Where it falls in
between, the second derivative is negative: something may have snapped through. Only ratios of
slopes count, which makes the test independent of units and sizes.
"""

from __future__ import annotations

import itertools

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.minimization.augmented_stiffness import AugmentedStiffness
from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.runtime.arrays import Array, Indices

FALL = 0.01
"""Fall of the slope, relative to the largest one, above which the energy is not convex."""


def is_convex_from(potential: Potential, start: Array) -> bool:
    """Whether the energy is convex on the way from `start` (n_local, 3) (length) to the potential's
    state, which is restored and evaluated. Collective. Costs four evaluations."""
    n, end = potential.unknowns.n_owned, potential.x.copy()
    way = end - start
    free = np.where(potential.unknowns.held[:n], 0.0, way[:n])
    slopes = np.zeros(4)  # at the start, at a third and two thirds of the way, at the state
    for k in range(4):
        potential.x[:] = end if k == 3 else start + k / 3 * way
        potential.place()
        potential.evaluate()
        slopes[k] = np.vdot(potential.g[:n], free)
    potential.comm.Allreduce(MPI.IN_PLACE, slopes, op=MPI.SUM)
    falls = [a - b for a, b in itertools.combinations(slopes.tolist(), 2)]
    return bool(max(falls) <= FALL * np.abs(slopes).max())


class ExactTangent:
    """Factorised second derivatives of a potential at its state. Collective.

    Attributes: `negative`: count of negative eigenvalues. Units: springs (n_owned,) (force/length).
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
        self._b, self._y = A.createVecs()
        self._factors = AugmentedStiffness(A, "crms_tangent_", pivoting=True)
        stiffness, columns = potential.dyad_columns(self._held, exact=True)
        self._factors.factorize(columns * np.sqrt(stiffness))
        self.negative = self._factors.negative

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._factors.destroy()
        self._b.destroy()
        self._y.destroy()

    def compliance(self, blocks: Indices) -> Array:
        """Displacements (3 k, 3 k) (length/force) of `blocks` (k,) by unit forces. Collective."""
        potential, unknowns = self.potential, self.potential.unknowns
        n, first = unknowns.n_owned, potential.comm.rank == 0
        found: Array = np.zeros((3 * len(blocks), 3 * len(blocks)))
        for k in range(3 * len(blocks)):
            potential.g[:] = 0.0
            if first:
                potential.g[blocks[k // 3], k % 3] = 1.0
            unknowns.gather_forces(potential.g_vector, potential.g)
            self._b.array[:] = np.where(self._held, 0.0, potential.g[:n]).ravel()
            self._factors.solve(self._b, self._y)
            potential.g[:n] = self._y.array_r.reshape(n, 3)
            unknowns.update_ghosts(potential.g_vector)
            if first:
                found[k, :] = potential.g[blocks].ravel()
        return np.asarray(potential.comm.bcast((found + found.T) / 2))
