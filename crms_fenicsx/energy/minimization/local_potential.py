"""The potential of some blocks with all others held, minimised by Newton's method.

Its terms are the elements that depend on these blocks; all other forces on them are constant.
Blocks fall into clusters that share no element. Each has its own energy and step length; all step
together. Clusters on one cable interact by the stiffness of its pieces, see `CableTension.split`.

Elements live on the ranks of their cells. A cluster with elements on several ranks is solved by the
rank that owns most of its blocks; the others send it their elements and block states. So clusters
are solved alike for any partition of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from crms_fenicsx.energy.minimization.cluster_matrix import ClusterLayout, ClusterMatrix
from crms_fenicsx.energy.minimization.damping import Damping
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import Strategy
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers

SPRINGS = -1
"""Term number of the damping springs."""

Tables = Sequence[tuple[int, ElementTable]]
Message = TypeVar("Message")


@dataclass(frozen=True)
class Clusters:
    """Clusters: their elements and the state of the n blocks that these address."""

    numbers: Integers  # (n,) global numbers of the blocks
    owned: Booleans  # (n,) whether the sending rank owns them
    # X, x, g: (n, 3) positions at zero displacement, displacements, forces of the whole potential
    X: Array
    x: Array
    g: Array
    moves: Booleans  # (n,) whether they belong to the clusters; all others are held
    held: Booleans  # (n, 3) components with a prescribed value
    projectors: Array  # (n, 3, 3) of sliders; zero for others
    # rides_on, weights: (n, 3) global numbers of the blocks that tied points ride on, -1 for other
    # blocks, and weights
    rides_on: Integers
    weights: Array
    tables: Tables  # term numbers of the potential, and elements of each

    @classmethod
    def of(cls, potential: Potential, moving: Indices, tables: Tables) -> Clusters:
        """This rank's part of the clusters with the blocks `moving`."""
        unknowns, n = potential.unknowns, potential.unknowns.n_local
        used = np.zeros(n, dtype=bool)
        used[moving] = True
        for _, table in tables:
            for name in table.addresses:
                used[getattr(table, name)] = True
        used[unknowns.interpolation[used[unknowns.tied_points]]] = True
        blocks = np.flatnonzero(used)
        number = np.full(n, -1, dtype=np.int32)
        number[blocks] = np.arange(len(blocks))
        numbers, moves = unknowns.numbers(), np.zeros(n, dtype=bool)
        moves[moving] = True
        projectors, weights = np.zeros((n, 3, 3)), np.zeros((n, 3))
        rides_on = np.full((n, 3), -1, dtype=np.int64)
        projectors[unknowns.sliders] = unknowns.projectors
        rides_on[unknowns.tied_points] = numbers[unknowns.interpolation]
        weights[unknowns.tied_points] = unknowns.weights
        values = (
            numbers.astype(np.int64), np.arange(n) < unknowns.n_owned, unknowns.X, potential.x,
            potential.g, moves, unknowns.held, projectors, rides_on, weights,
        )  # fmt: skip
        told = [(k, table.renumbered(number)) for k, table in tables]
        return cls(*(value[blocks] for value in values), told)  # type: ignore[call-arg, arg-type]

    @classmethod
    def joined(cls, parts: Sequence[Clusters]) -> Clusters:
        """Merge the parts of the same clusters sent by several ranks."""
        if len(parts) == 1:
            return parts[0]
        numbers = np.concatenate([part.numbers for part in parts])
        # Of duplicates the owner's comes last and is kept.
        order = np.argsort(np.concatenate([part.owned for part in parts]), kind="stable")
        _, last, place = np.unique(numbers[order[::-1]], return_index=True, return_inverse=True)
        kept = order[::-1][last]
        places = np.empty(len(order), dtype=np.int32)
        places[order[::-1]] = place
        at = np.split(places, np.cumsum([len(part.numbers) for part in parts])[:-1])
        names = [field.name for field in fields(cls) if field.name != "tables"]
        values = [np.concatenate([getattr(part, name) for part in parts])[kept] for name in names]
        told = [
            (k, t.renumbered(own)) for p, own in zip(parts, at, strict=True) for k, t in p.tables
        ]
        return cls(*values, told)  # type: ignore[call-arg]

    def layout(self) -> LocalBlocks:
        """The blocks as a layout."""
        blocks = LocalBlocks(self.X)
        blocks.held[:] = self.held
        tied_points = np.flatnonzero(self.rides_on[:, 0] >= 0).astype(np.int32)
        order = np.argsort(self.numbers)
        on = order[np.searchsorted(self.numbers[order], self.rides_on[tied_points])]
        blocks.set_tied_points(tied_points, on.astype(np.int32), self.weights[tied_points])
        sliders = np.flatnonzero(self.projectors.any(axis=(1, 2))).astype(np.int32)
        blocks.set_sliders(sliders, self.projectors[sliders])
        return blocks

    def elements_of(self, term: int) -> Sequence[ElementTable]:
        """Elements of a term, in as few tables as possible."""
        tables = [table for k, table in self.tables if k == term]
        return type(tables[0]).joined(tables) if tables else ()


def gather(potential: Potential, moves: Booleans, shared: Booleans, largest: int) -> Clusters:
    """Gather the clusters that this rank solves, of up to `largest` blocks; moves, shared
    (n_local,). Collective."""
    unknowns, comm = potential.unknowns, potential.comm
    blocks, tables = np.flatnonzero(moves).astype(np.int32), _elements(potential, moves)
    if comm.size == 1 and len(blocks) <= largest:
        return Clusters.of(potential, blocks, tables)
    elements = [table.element_blocks for k, table in tables if k != SPRINGS]
    layout = ClusterLayout(unknowns, blocks, elements)
    rank = _solvers(layout, shared, largest)[layout.cluster]
    parts = {}
    for solver in {comm.rank, *map(int, rank[rank >= 0])}:
        own = np.sort(layout.blocks[rank == solver])
        some = tables
        if len(own) < len(blocks):
            chosen = np.zeros_like(moves)
            chosen[own] = True
            some = _elements(potential, chosen)
        parts[solver] = Clusters.of(potential, own, some)
    return Clusters.joined(exchange(comm, parts))


def _elements(potential: Potential, moves: Booleans) -> Tables:
    """This rank's elements that depend on some blocks or on points tied to them."""
    unknowns, chosen = potential.unknowns, moves.copy()
    chosen[unknowns.tied_points] |= chosen[unknowns.interpolation].any(axis=1)
    tables = [(k, term.elements_on(chosen)) for k, term in enumerate(potential.terms)]
    if potential.damping is not None:
        tables.append((SPRINGS, potential.damping.elements_on(chosen)))
    return [(k, table) for k, table in tables if table is not None]


def _solvers(layout: ClusterLayout, shared: Booleans, largest: int) -> Integers:
    """Rank that solves each cluster, -1 if it has more than `largest` blocks; shared (n_local,).
    Collective."""
    unknowns = layout.whole
    assert isinstance(unknowns, Unknowns)
    comm = unknowns.comm
    own = layout.cluster[layout.blocks < unknowns.n_owned]
    sizes = np.bincount(own, minlength=layout.n_clusters)
    solvers = np.where(sizes > largest, -1, comm.rank)
    if comm.size == 1:
        return solvers
    known = shared[layout.blocks]
    seen, piece = np.unique(layout.cluster[known], return_inverse=True)
    told = comm.allgather((unknowns.numbers()[layout.blocks[known]], piece, sizes[seen]))
    counts = [len(own_sizes) for _, _, own_sizes in told]
    starts = np.cumsum([0, *counts])
    numbers, block = np.unique(np.concatenate([part[0] for part in told]), return_inverse=True)
    pieces = np.concatenate(
        [part[1] + start for part, start in zip(told, starts[:-1], strict=True)]
    )
    size, edges = starts[-1] + len(numbers), (pieces, starts[-1] + block)
    graph = sp.csr_matrix((np.ones(len(pieces), dtype=np.int8), edges), shape=(size, size))
    cluster = connected_components(graph, directed=False)[1][: starts[-1]]
    shares = np.zeros((int(cluster.max(initial=-1)) + 1, comm.size), dtype=np.int64)
    ranks = np.repeat(np.arange(comm.size), counts)
    np.add.at(shares, (cluster, ranks), np.concatenate([part[2] for part in told]))
    most = np.where(shares.sum(axis=1) > largest, -1, shares.argmax(axis=1))
    solvers[seen] = most[cluster[starts[comm.rank] : starts[comm.rank + 1]]]
    return solvers


def give_back(
    potential: Potential, clusters: Clusters, blocks: Indices, flags: Booleans
) -> Booleans:
    """Send displacements and flags of `blocks` (m,) to their owners, which update the potential,
    and return the flags of this rank's blocks, (n_local,). Collective."""
    starts = potential.unknowns.starts
    numbers, x = clusters.numbers[blocks], clusters.x[blocks]
    owner = np.searchsorted(starts, numbers, side="right") - 1
    messages: dict[int, tuple[Integers, Array, Booleans]] = {}
    for other in map(int, np.unique(owner)):
        own = owner == other
        messages[other] = numbers[own] - starts[other], x[own], flags[own]
    found: Booleans = np.zeros(potential.unknowns.n_local, dtype=bool)
    for place, values, flag in exchange(potential.comm, messages):
        potential.x[place] = values
        found[place] = flag
    return found


def exchange(comm: MPI.Intracomm, messages: Mapping[int, Message]) -> list[Message]:
    """Send messages to ranks and return those received, in rank order. Collective."""
    own = messages.get(comm.rank)
    if comm.size == 1:
        return [] if own is None else [own]
    others = [messages.get(rank) if rank != comm.rank else None for rank in range(comm.size)]
    received = comm.alltoall(others)
    received[comm.rank] = own
    return [message for message in received if message is not None]


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

    def __init__(self, whole: Potential, clusters: Clusters, strategy: Strategy) -> None:
        self.strategy = strategy
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
        self.layout.whole.transfer_tied_forces(self._forces)
        np.take(self._forces, self.blocks, axis=0, out=self.g)
        self.layout.project(self.g)
        self.g += self._others
        work = np.sum(self._others * (self.x[self.blocks] - self._start), axis=1)
        np.add(self._by_cluster(np.asarray), self._sum(work), out=self.energies)

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
            exact = todo & (short < self.strategy.twice) & (step > 0)
            lengths = self._step(todo, exact)
            able &= ~todo | (lengths > 0.0)
            short[exact] = np.where(lengths < self.strategy.short, short + 1, 0)[exact]
            short -= todo & ~exact & (short >= self.strategy.twice)
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
            pending &= ~(change <= self.strategy.descent * lengths * slopes)
            if not pending.any():
                self.steps += int(np.count_nonzero(lengths))
                return lengths
            curved = np.where(pending, change - slopes * lengths, 1.0)
            with np.errstate(invalid="ignore", divide="ignore"):
                best = np.where(curved > 0.0, -slopes * lengths**2 / (2 * curved), 0.5 * lengths)
            shorter = np.clip(np.nan_to_num(best, nan=0.0), 0.1 * lengths, 0.5 * lengths)
            shorter[shorter < self.strategy.shortest_local] = 0.0
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
