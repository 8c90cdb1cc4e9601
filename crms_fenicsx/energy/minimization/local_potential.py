"""The potential of some blocks with all others held, minimised by Newton's method.

Its terms are the elements that depend on these blocks; all other forces on them are constant.
Blocks fall into clusters that share no element. Each has its own energy and step length; all step
together. Clusters on one cable interact by the stiffness of its pieces, see `CableTension.split`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from crms_fenicsx.energy.minimization.cluster_matrix import ClusterMatrix
from crms_fenicsx.energy.minimization.clusters import SPRINGS, Clusters
from crms_fenicsx.energy.minimization.damping import Damping
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.cluster_layout import ClusterLayout
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans

DESCENT, SHORTEST = 1e-4, 1e-6
"""Fraction of the predicted descent that a step must achieve (Armijo), and the shortest step."""

SHORT, TWICE = 0.3, 2
"""Length, relative to Newton's, below which a step by the exact second derivatives is short, and
the number of short steps after which H0 replaces them for as many steps."""

STEADY = 1e-11
"""Energy change, relative to its parts, below which the trapezoidal rule avoids rounding."""


class LocalPotential:
    """Part of a potential that depends on some blocks, as a function of them alone.

    Creating one is collective: ranks with clusters on a common cable exchange only their number.

    Attributes: `layout`: the clusters, as blocks of `clusters`; `blocks` (n,): the moving blocks in
    the clusters' order; `x` (n_blocks, 3): displacements of the blocks of `clusters` (length),
    changed in place; `g` (n, 3): forces on the moving blocks, last evaluated (force); `energies`
    (n_clusters,): cluster energies (force x length); `steps`: Newton steps made.
    """

    def __init__(self, whole: Potential, clusters: Clusters) -> None:
        kinds = range(len(whole.terms))
        tables = [(k, table) for k in kinds for table in clusters.elements_of(k)]
        elements = [table.element_blocks for _, table in tables]
        moving = np.flatnonzero(clusters.moves).astype(np.int32)
        self.layout = ClusterLayout(clusters.layout(), moving, elements)
        self.terms: list[EnergyTerm] = []
        for k, table in tables:
            term = whole.terms[k].of_elements(table, whole.sums_of(whole.terms[k]))
            self.terms.append(term.split(self.layout.groups, whole.comm))
        self._clusters = [self.layout.clusters_of(*own) for own in elements]
        for term in self.terms:
            term.attach(self.layout)  # type: ignore[arg-type]  # as much as terms need
        self._sums = [np.zeros(term.n_sums) for term in self.terms]
        springs: Sequence[Any] = clusters.elements_of(SPRINGS)
        self._damping = [Damping(table) for table in springs]
        self.x, self._forces = clusters.x, np.zeros_like(clusters.x)
        self.blocks = self.layout.blocks
        self.g: Array = np.zeros((len(self.blocks), 3))
        self.energies: Array = np.zeros(self.layout.n_clusters)
        self._others, self._start = self.g.copy(), self.x[self.blocks]
        self.steps, self._n_all = 0, whole.comm.allreduce(self.layout.n_clusters)
        given = clusters.g[self.blocks]
        self.layout.project(given)
        self._evaluate()
        # Forces from everything but these terms are constant.
        self._others = given - self.g
        self.g[:] = given
        self._sizes = self._by_cluster(np.abs)
        patterns = [pattern for term in self.terms for pattern in term.patterns]
        patterns += [pattern for damping in self._damping for pattern in damping.patterns]
        columns = [term.columns for term in self.terms if term.columns is not None]
        self._matrix = ClusterMatrix(self.layout, patterns, *columns)

    def _by_cluster(self, function: Callable[[Array], Array]) -> Array:
        """Sum over each cluster of a function of the element energies."""
        total = np.zeros(self.layout.n_clusters)
        for term, sums, cluster in zip(self.terms, self._sums, self._clusters, strict=True):
            own = cluster >= 0
            values = function(term.element_energies(sums))[own]
            total += np.bincount(cluster[own], values, minlength=len(total))
        return total

    def _evaluate(self) -> None:
        """Compute cluster energies and block forces at the current state."""
        self.layout.whole.place_tied_points(self.x)
        self._forces[:] = 0.0
        for term, sums in zip(self.terms, self._sums, strict=True):
            term.sums(self.x, sums)
            term.add_gradient(self.x, sums, self._forces)
        self._take_forces()
        self.g += self._others
        work = np.sum(self._others * (self.x[self.blocks] - self._start), axis=1)
        np.add(self._by_cluster(np.asarray), self._sum(work), out=self.energies)

    def _take_forces(self) -> None:
        """Set `g` from the forces accumulated on all blocks."""
        self.layout.whole.transfer_tied_forces(self._forces)
        np.take(self._forces, self.blocks, axis=0, out=self.g)
        self.layout.project(self.g)

    def _sum(self, values: Array) -> Array:
        """Sums of block values (n,) over each cluster."""
        total = np.bincount(self.layout.cluster, values, self.layout.n_clusters)
        return total.astype(np.float64)

    def residuals(self) -> Array:
        """Norm of the forces on each cluster, (n_clusters,)."""
        return np.sqrt(self._sum(np.sum(self.g**2, axis=1)))

    def relax(self, tolerance: float, most: int) -> Booleans:
        """Minimise the energy of each cluster to `tolerance` (force) in at most `most` steps.
        Returns whether each block's cluster has not converged, (n,)."""
        n = self.layout.n_clusters
        least = np.maximum(tolerance / max(self._n_all, 1) ** 0.5, 1e-3 * self.residuals())
        able = np.ones(n, dtype=bool)
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
        return np.asarray((self.residuals() > least)[self.layout.cluster])

    def _step(self, todo: Booleans, exact: Booleans) -> Array:
        """Make a Newton step with line search in each cluster; todo, exact (n_clusters,). Returns
        the step lengths, 1 at most; 0 where the energy does not fall."""
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
        """Newton directions of descent at the current state, (n, 3)."""
        d, left = np.zeros_like(self.g), todo.copy()
        for kind in (True, False):
            wanted = left & exact if kind else left
            if wanted.any():
                self._assemble(wanted, kind)
                left &= ~self._matrix.solve(wanted, -self.g, d)
        return d

    def _assemble(self, wanted: Booleans, exact: bool) -> None:
        """Assemble second derivatives, or H0, of the wanted clusters at the current state."""
        A = self._matrix
        A.clear()
        for term, cluster in zip(self.terms, self._clusters, strict=True):
            if term.active is not None:
                np.take(np.append(wanted, False), cluster, out=term.active)
        if not exact:
            self._forces[:] = 0.0  # held blocks need no damping
            self._forces[self.blocks] = self.g
            for damping in self._damping:
                damping.add_stiffness(self.layout, self.x, self._forces, A)  # type: ignore[arg-type]
        for term, sums in zip(self.terms, self._sums, strict=True):
            (term.add_hessian if exact else term.add_stiffness)(self.x, sums, A)
            if term.columns is not None:
                term.dyad_columns(self.x, sums, exact)
                A.take_columns(term.columns)
        A.close(exact)
