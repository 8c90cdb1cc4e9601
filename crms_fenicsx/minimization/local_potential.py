"""The potential of some blocks with all others held, minimised by Newton's method.

Its terms are the parts of the whole's terms that depend on these blocks; what else acts on them
keeps its force. So energy and forces change as those of the whole do, at the cost of few elements.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.local_layout import LocalLayout
from crms_fenicsx.dofs.preallocation import RowSizes
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.initial_hessian import InitialHessian
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Array, Indices

DESCENT, SHORTEST = 1e-4, 1e-6
"""Least part of the descent promised that a step must keep, and the shortest one tried."""

SHORT, TWICE = 0.3, 2
"""Steps by the exact second derivatives that are shorter than this part of Newton's, and after how
many of these H0 takes their place for as many."""


class LocalPotential:
    """Part of a potential that depends on some blocks of this process, as a function of them alone.

    The state is the whole's, whose displacements it changes in place.

    Parameters
    ----------
    whole
        A potential, evaluated at its current state, forces in `g` included.
    blocks
        Owned blocks of its layout, (n,), ascending; see `LocalLayout`.

    Attributes
    ----------
    g : (n, 3)
        Forces on the blocks at the last evaluation (force).
    steps
        Steps of Newton's method that were made.
    """

    def __init__(self, whole: Potential, blocks: Indices) -> None:
        self.unknowns = LocalLayout(whole.unknowns, blocks)
        self.blocks, self.x = blocks, whole.x
        self.comm = self.unknowns.comm
        chosen = np.zeros(whole.unknowns.n_local, dtype=bool)
        chosen[blocks] = True
        self._layout = whole.unknowns
        chosen[self._layout.riders] = chosen[self._layout.interpolation].any(axis=1)
        parts = (term.restricted(chosen, whole.sums_of(term)) for term in whole.terms)
        self.terms: list[EnergyTerm] = [part for part in parts if part is not None]
        for term in self.terms:
            term.attach(self.unknowns)
        self._sums = [np.zeros(term.n_sums) for term in self.terms]
        self._damping = None if whole.damping is None else whole.damping.restricted(chosen)
        self._forces = np.zeros_like(whole.x)
        self.g = np.zeros((len(blocks), 3))
        self._others, self._start = np.zeros_like(self.g), self.x[blocks]
        self.steps = 0
        given = np.where(self.unknowns.held, 0.0, whole.g[blocks])
        self.energy = self.evaluate()
        # What acts on the blocks beside these terms, and stays as it is.
        self._others = given - self.g
        self.g[:] = given
        self.h0 = InitialHessian(self, "crms_local_")

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.h0.destroy()

    def evaluate(self) -> float:
        """Energy of the terms at the current state (force x length); leaves the forces in `g`."""
        energy = float(np.vdot(self._others, self.x[self.blocks] - self._start))
        self._forces[:] = 0.0
        self._layout.place_riders(self.x)
        for term, sums in zip(self.terms, self._sums, strict=True):
            term.sums(self.x, sums)
            energy += term.energy(sums)
            term.add_gradient(self.x, sums, self._forces)
        self._take_forces()
        self.g += self._others
        return energy

    def _take_forces(self) -> None:
        """Take what has been added up on all blocks."""
        self._layout.hand_over(self._forces)
        np.take(self._forces, self.blocks, axis=0, out=self.g)
        np.copyto(self.g, 0.0, where=self.unknowns.held)
        self.unknowns.project(self.g)

    def count_stiffness(self) -> RowSizes:
        """As `Potential.count_stiffness`."""
        sizes = RowSizes(self.unknowns)
        for term in (*self.terms, *([] if self._damping is None else [self._damping])):
            term.count_stiffness(sizes)
        return sizes

    def add_stiffness(self, A: PETSc.Mat, exact: bool = False) -> None:
        """As `Potential.add_stiffness`."""
        if self._damping is not None and not exact:
            self._forces[self.blocks] = self.g
            self._damping.add_stiffness(self.unknowns, self.x, self._forces, A)
        for term, sums in zip(self.terms, self._sums, strict=True):
            (term.add_hessian if exact else term.add_stiffness)(self.x, sums, A)

    def dyads(self) -> Iterator[tuple[EnergyTerm, int, float]]:
        """As `Potential.dyads`."""
        for term, sums in zip(self.terms, self._sums, strict=True):
            for k, value in enumerate(term.dyads(sums)):
                if value > 0.0:
                    yield term, k, float(value)

    def dyad_column(self, term: EnergyTerm, k: int) -> None:
        """As `Potential.dyad_column`."""
        self._forces[:] = 0.0
        term.add_dyad_column(k, self.x, self._forces)
        self._take_forces()

    def residual(self) -> float:
        """Norm of the forces on the blocks."""
        return float(np.linalg.norm(self.g))

    def relax(self, tolerance: float, most: int) -> bool:
        """Minimise until the forces' norm is below a tolerance; say whether it is.

        Parameters
        ----------
        tolerance
            Norm of the forces that is small enough (force).
        most
            Steps at most.
        """
        short = 0
        for step in range(most):
            if self.residual() <= tolerance:
                return True
            exact = step > 0 and short < TWICE
            length = self._step(exact)
            if length < SHORTEST:
                return False
            if exact:
                short = short + 1 if length < SHORT else 0
            else:
                short -= short >= TWICE
        return self.residual() <= tolerance

    def _step(self, exact: bool) -> float:
        """Make a step of Newton's method as far as the energy falls; return its length, 1 at most.

        Parameters
        ----------
        exact
            Whether by the second derivatives where these are definite, else by H0.
        """
        start, g0 = self.x[self.blocks], self.g.copy()
        d = self._direction(g0, exact)
        slope = float(np.vdot(d, g0))
        length = 1.0
        while True:
            self.x[self.blocks] = start + length * d
            energy = self.evaluate()
            change = energy - self.energy
            if change <= DESCENT * length * slope:
                break
            if length < SHORTEST:
                self.x[self.blocks] = start
                self.energy = self.evaluate()
                return 0.0
            curved = change - slope * length
            best = -slope * length**2 / (2 * curved) if curved > 0.0 else 0.5 * length
            length = min(max(best, 0.1 * length), 0.5 * length)
        self.energy = energy
        self.steps += 1
        return length

    def _direction(self, g: Array, exact: bool) -> Array:
        """Newton's step from the current state, downhill, (n, 3)."""
        b, y = self.h0.matrix.createVecs()
        for tried in (True, False) if exact else (False,):
            if not self.h0.rebuild(tried):
                continue
            self.g[:] = g
            b.array[:] = -g.ravel()
            self.h0.solve(b, y)
            if b.dot(y) > 0.0:
                break
        d: Array = y.array.reshape(-1, 3).copy()
        b.destroy()
        y.destroy()
        return d
