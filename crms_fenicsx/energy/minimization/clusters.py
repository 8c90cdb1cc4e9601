"""Gathering of each cluster of blocks on one rank.

Elements live on the ranks of their cells. A cluster with elements on several ranks is solved by the
rank that owns most of its blocks; the others send it their elements and block states. So clusters
are solved alike for any partition of the mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.dofs.cluster_layout import ClusterLayout
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers

LARGEST = 400
"""Blocks beyond which a cluster is left to the global minimiser."""

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
    directions: Array  # (n, 3) lines of edge sliders; zero for others
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
        directions, weights = np.zeros((n, 3)), np.zeros((n, 3))
        rides_on = np.full((n, 3), -1, dtype=np.int64)
        directions[unknowns.edge_sliders] = unknowns.directions
        rides_on[unknowns.tied_points] = numbers[unknowns.interpolation]
        weights[unknowns.tied_points] = unknowns.weights
        values = (
            numbers.astype(np.int64), np.arange(n) < unknowns.n_owned, unknowns.X, potential.x,
            potential.g, moves, unknowns.held, directions, rides_on, weights,
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
        edge_sliders = np.flatnonzero(self.directions.any(axis=1)).astype(np.int32)
        blocks.set_edge_sliders(edge_sliders, self.directions[edge_sliders])
        return blocks

    def elements_of(self, term: int) -> Sequence[ElementTable]:
        """Elements of a term, in as few tables as possible."""
        tables = [table for k, table in self.tables if k == term]
        return type(tables[0]).joined(tables) if tables else ()


def gather(potential: Potential, moves: Booleans, shared: Booleans) -> Clusters:
    """Gather the clusters that this rank solves; moves, shared (n_local,). Collective."""
    unknowns, comm = potential.unknowns, potential.comm
    blocks, tables = np.flatnonzero(moves).astype(np.int32), _elements(potential, moves)
    if comm.size == 1 and len(blocks) <= LARGEST:
        return Clusters.of(potential, blocks, tables)
    elements = [table.element_blocks for k, table in tables if k != SPRINGS]
    layout = ClusterLayout(unknowns, blocks, elements)
    rank = _solvers(layout, shared)[layout.cluster]
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


def _solvers(layout: ClusterLayout, shared: Booleans) -> Integers:
    """Rank that solves each cluster, -1 if it is too large; shared (n_local,). Collective."""
    unknowns = layout.whole
    assert isinstance(unknowns, Unknowns)
    comm = unknowns.comm
    own = layout.cluster[layout.blocks < unknowns.n_owned]
    sizes = np.bincount(own, minlength=layout.n_clusters)
    solvers = np.where(sizes > LARGEST, -1, comm.rank)
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
    most = np.where(shares.sum(axis=1) > LARGEST, -1, shares.argmax(axis=1))
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
