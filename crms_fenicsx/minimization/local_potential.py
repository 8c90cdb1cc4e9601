"""The potential of some blocks with all others held, minimised by Newton's method.

Its terms are the parts of the whole's terms that depend on these blocks; what else acts on them
keeps its force. Blocks fall into clusters that no element joins. Each has an energy of its own, and
makes Newton steps of its own length, all at the same time. Clusters on the same cable know of each
other by the stiffness of the cable's pieces, see `CableTension.split`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crms_fenicsx.dofs.cluster_layout import ClusterLayout
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.cluster_matrix import ClusterMatrix
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices

DESCENT, SHORTEST = 1e-4, 1e-6
"""Least part of the descent promised that a step must keep, and the shortest one tried."""

SHORT, TWICE = 0.3, 2
"""Steps by the exact second derivatives that are shorter than this part of Newton's, and after how
many of these H0 takes their place for as many."""

STEADY = 1e-11
"""Change of the energy, relative to the sizes of its parts, in which rounding drowns the rest; the
trapezoidal rule takes its place."""

LARGEST = 400
"""Blocks of a cluster beyond which it is left to the minimiser of all unknowns."""


class LocalPotential:
    """Part of a potential that depends on some blocks of this process, as a function of them alone.

    The state is the whole's, whose displacements it changes in place.

    Parameters
    ----------
    whole
        A potential, evaluated at its current state, forces in `g` included.
    blocks
        Owned blocks of its layout that are free to move, without riders, (n,).

    Attributes
    ----------
    g : (n, 3)
        Forces on the blocks, in the clusters' order, at the last evaluation (force).
    energies : (n_clusters,)
        Energy of each cluster there (force x length).
    steps
        Steps of Newton's method that were made.
    """

    def __init__(self, whole: Potential, blocks: Indices) -> None:
        terms, layout, chosen = _restricted(whole, blocks)
        large = (np.diff(layout.starts) > LARGEST)[layout.cluster]
        if large.any():
            terms, layout, chosen = _restricted(whole, layout.blocks[~large])
        self.layout = layout
        self.terms: list[EnergyTerm] = [term.split(self.layout.groups()) for term in terms]
        self._clusters = [self.layout.clusters_of(*term.element_blocks()) for term in self.terms]
        for term in self.terms:
            term.attach(self.layout)  # type: ignore[arg-type]  # as much of one as they need
        self._sums = [np.zeros(term.n_sums) for term in self.terms]
        self._damping = None if whole.damping is None else whole.damping.restricted(chosen)
        self.x, self._forces = whole.x, np.zeros_like(whole.x)
        self.blocks = self.layout.blocks
        self.g: Array = np.zeros((len(self.blocks), 3))
        self.energies: Array = np.zeros(self.layout.n_clusters)
        self._others, self._start = self.g.copy(), self.x[self.blocks]
        self.steps = 0
        given = whole.g[self.blocks]
        self.layout.project(given)
        self._evaluate()
        # What acts on the blocks beside these terms, and stays as it is.
        self._others = given - self.g
        self.g[:] = given
        self._sizes = self._by_cluster(np.abs)
        self._matrix = ClusterMatrix(self.layout)

    def _by_cluster(self, function: Callable[[Array], Array]) -> Array:
        """Sum of a function of the elements' energies over each cluster."""
        total = np.zeros(self.layout.n_clusters)
        for term, sums, cluster in zip(self.terms, self._sums, self._clusters, strict=True):
            own = cluster >= 0
            values = function(term.element_energies(sums))[own]
            total += np.bincount(cluster[own], values, minlength=len(total))
        return total

    def _evaluate(self) -> None:
        """Compute the clusters' energies, and the forces on the blocks, at the current state."""
        self.layout.whole.place_riders(self.x)
        self._forces[:] = 0.0
        for term, sums in zip(self.terms, self._sums, strict=True):
            term.sums(self.x, sums)
            term.add_gradient(self.x, sums, self._forces)
        self._take_forces()
        self.g += self._others
        work = np.sum(self._others * (self.x[self.blocks] - self._start), axis=1)
        np.add(self._by_cluster(np.asarray), self._sum(work), out=self.energies)

    def _take_forces(self) -> None:
        """Take what has been added up on all blocks."""
        self.layout.whole.hand_over(self._forces)
        np.take(self._forces, self.blocks, axis=0, out=self.g)
        self.layout.project(self.g)

    def _sum(self, values: Array) -> Array:
        """Sums of values of blocks (n,) over the clusters."""
        total = np.bincount(self.layout.cluster, values, self.layout.n_clusters)
        return total.astype(np.float64)

    def residuals(self) -> Array:
        """Norm of the forces on each cluster, (n_clusters,)."""
        return np.sqrt(self._sum(np.sum(self.g**2, axis=1)))

    def relax(self, tolerance: float, most: int) -> Indices:
        """Minimise the energy of each cluster.

        Parameters
        ----------
        tolerance
            Norm of all forces that is small enough (force).
        most
            Steps of each cluster at most.

        Returns
        -------
        Blocks of the clusters that have not come there.
        """
        n = self.layout.n_clusters
        least = np.maximum(tolerance / max(n, 1) ** 0.5, 1e-3 * self.residuals())
        able = np.asarray(np.ones(n), dtype=bool)
        short = np.zeros(n, dtype=int)
        for step in range(most):
            todo = able & (self.residuals() > least)
            if not todo.any():
                break
            exact = todo & (short < TWICE) & (step > 0)
            lengths = self._step(todo, exact)
            able &= ~todo | (lengths > 0.0)
            short[exact] = np.where(lengths < SHORT, short + 1, 0)[exact]
            short -= todo & ~exact & (short >= TWICE)
        return self.blocks[(self.residuals() > least)[self.layout.cluster]]

    def _step(self, todo: Booleans, exact: Booleans) -> Array:
        """Make a step of Newton's method in each cluster, as far as its energy falls.

        Parameters
        ----------
        todo, exact : (n_clusters,)
            Which clusters, and which of them by the second derivatives if these are definite,
            else by H0.

        Returns
        -------
        Lengths of the steps, 1 at most; 0 where the energy does not fall.
        """
        cluster, start, g0 = self.layout.cluster, self.x[self.blocks], self.g.copy()
        energies0 = self.energies.copy()
        d = self._directions(todo, exact)
        slopes = self._sum(np.sum(d * g0, axis=1))
        lengths = np.where(todo & (slopes < 0.0), 1.0, 0.0)
        pending = lengths > 0.0
        while True:
            self.x[self.blocks] = start + lengths[cluster, None] * d
            self._evaluate()
            change = self.energies - energies0
            steady = np.abs(change) <= STEADY * self._sizes
            rule = 0.5 * lengths * (slopes + self._sum(np.sum(d * self.g, axis=1)))
            change = np.where(steady, rule, change)
            pending &= ~(change <= DESCENT * lengths * slopes)
            if not pending.any():
                self.steps += int(np.count_nonzero(lengths))
                return lengths
            curved = np.where(pending, change - slopes * lengths, 1.0)
            with np.errstate(invalid="ignore", divide="ignore"):
                best = np.where(curved > 0.0, -slopes * lengths**2 / (2 * curved), 0.5 * lengths)
            shorter = np.clip(np.nan_to_num(best, nan=0.0), 0.1 * lengths, 0.5 * lengths)
            shorter[shorter < SHORTEST] = 0.0
            lengths = np.where(pending, shorter, lengths)
            pending &= lengths > 0.0

    def _directions(self, todo: Booleans, exact: Booleans) -> Array:
        """Newton's steps from the current state, downhill, (n, 3)."""
        d, g, left = np.zeros_like(self.g), self.g.copy(), todo.copy()
        for kind in (True, False):
            wanted = left & exact if kind else left
            if not wanted.any():
                continue
            self.g[:] = g
            self._assemble(kind)
            for c in np.flatnonzero(wanted):
                own = slice(self.layout.starts[c], self.layout.starts[c + 1])
                y = self._matrix.solve(int(c), -g[own].ravel())
                if y is not None:
                    d[own] = y.reshape(-1, 3)
                    left[c] = False
        return d

    def _assemble(self, exact: bool) -> None:
        """Assemble second derivatives, or H0, at the current state."""
        A = self._matrix
        A.clear()
        if not exact and self._damping is not None:
            self._forces[self.blocks] = self.g
            self._damping.add_stiffness(self.layout, self.x, self._forces, A)  # type: ignore[arg-type]
        for term, sums in zip(self.terms, self._sums, strict=True):
            (term.add_hessian if exact else term.add_stiffness)(self.x, sums, A)
            term.add_dyads(self.x, sums, A)
        A.close()


def _restricted(
    whole: Potential, blocks: Indices
) -> tuple[list[EnergyTerm], ClusterLayout, Booleans]:
    """Parts of the terms that depend on blocks, these in clusters, and what moves, (n_local,)."""
    chosen = np.zeros(whole.unknowns.n_local, dtype=bool)
    chosen[blocks] = True
    chosen[whole.unknowns.riders] |= chosen[whole.unknowns.interpolation].any(axis=1)
    parts = [term.restricted(chosen, whole.sums_of(term)) for term in whole.terms]
    terms = [part for part in parts if part is not None]
    elements = [term.element_blocks() for term in terms]
    return terms, ClusterLayout(whole.unknowns, blocks, elements), chosen
