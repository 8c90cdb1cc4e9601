"""Nodes of all cables as arrays, and the cable points in order along edges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from itertools import chain

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cabling.cables.strip import Simplices
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, pointers, runs
from crms_fenicsx.model.cable_state import CableNode, NodeId
from crms_fenicsx.model.laid_cable import LaidCable

VERTEX, FOLD, EDGE_SLIDER, TIED, ANCHOR, CROSSING = range(6)
NUMBERS = dict(
    zip(("vertex", "fold", "edge slider", "tied", "anchor", "crossing"), range(6), strict=True)
)
"""Numbers of `CableNode.kind`."""


NODE = np.dtype(
    [
        ("kind", np.int64),
        ("crossing", np.int64),  # its number, or -1
        # number of support vertices, 0 for anchors; their ids, padded with -1; unfolded weights
        ("size", np.int64),
        ("support", np.int64, 3),
        ("weights", float, 3),
    ]
)
"""Record of a node, without its position in space."""


class NodeTable:
    """All n nodes of some cables, without positions: `NODE` records, with fields as attributes."""

    def __init__(
        self,
        nodes: Sequence[Sequence[CableNode]],
        rows: npt.NDArray[np.void],
        taut: Booleans,
        lifted: Booleans,
        on: tuple[Simplices, Integers] | None = None,
    ) -> None:
        self.nodes, self.rows = nodes, rows  # nodes: by cable
        counts = np.array([len(own) for own in nodes], dtype=np.int64)
        self.starts = pointers(counts)  # first row of each cable
        self.cable = np.repeat(np.arange(len(nodes)), counts)  # (n,) number of the cable
        self.place = np.arange(len(rows)) - self.starts[self.cable]  # (n,) index of the node in it
        self.kind: Integers
        self.crossing: Integers
        self.size: Integers
        self.support: Integers
        self.weights: Array
        for name in NODE.names or ():
            setattr(self, name, np.ascontiguousarray(rows[name]))
        self.slides = (self.kind == FOLD) | (self.kind == EDGE_SLIDER)
        self.in_air = (self.kind == CROSSING) & (self.size == 1)  # above a common vertex
        self._on = on  # simplices of a strip, and the number of each node's
        self._set_flags(taut, lifted)

    def _set_flags(self, taut: Booleans, lifted: Booleans) -> None:
        self.taut_cables = taut  # (cables,)
        self.taut, self.lifted = np.repeat(taut, np.diff(self.starts)), lifted  # (n,)

    @classmethod
    def of(cls, cables: Sequence[LaidCable], known: NodeTable | None = None) -> NodeTable:
        """Table of the cables' nodes; unchanged parts are taken from a known table."""
        nodes = [cable.state.nodes for cable in cables]
        taut = np.array([cable.taut for cable in cables], dtype=bool)
        lifted = np.concatenate([taut[:0], *(cable.state.lifted for cable in cables)])
        if known is None or len(known.nodes) != len(nodes):
            return cls(nodes, node_rows(nodes), taut, lifted)
        changed = np.array(
            [a is not b for a, b in zip(nodes, known.nodes, strict=True)], dtype=bool
        )
        if not changed.any():
            table = copy(known)
            table._set_flags(taut, lifted)
            return table
        counts, first = np.array([len(own) for own in nodes]), known.starts[:-1].copy()
        first[changed] = known.starts[-1] + pointers(counts[changed])[:-1]
        new = node_rows([nodes[c] for c in np.flatnonzero(changed)])
        rows = np.concatenate([known.rows, new])[runs(first, counts)]
        return cls(nodes, rows, taut, lifted)

    def on(self, simplices: Simplices) -> Integers:
        """Numbers of the nodes' simplices, (n,); -1 for anchors."""
        if self._on is None or self._on[0] is not simplices:
            self._on = simplices, simplices.find(self.support)
        return self._on[1]

    def ids(self, rows: Integers) -> list[NodeId]:
        """Cable and node numbers of some rows."""
        return list(zip(map(int, self.cable[rows]), map(int, self.place[rows]), strict=True))


def node_rows(nodes: Iterable[Sequence[CableNode]]) -> npt.NDArray[np.void]:
    """Rows of `NodeTable`, in a loop over nodes."""
    every = list(chain.from_iterable(nodes))
    rows, points = np.zeros(len(every), dtype=NODE), [node.point for node in every]
    supports = [() if point is None else point.support for point in points]
    rows["kind"] = [NUMBERS[node.kind] for node in every]
    rows["crossing"] = [-1 if node.crossing is None else node.crossing for node in every]
    rows["size"] = list(map(len, supports))
    rows["support"] = -1
    there = np.arange(3) < rows["size"][:, None]
    rows["support"][there] = np.fromiter(chain.from_iterable(supports), np.int64)
    weights = [point.weights for point in points if point is not None]
    rows["weights"][there] = np.fromiter(chain.from_iterable(weights), float)
    return rows


def positions_of(cables: Sequence[LaidCable]) -> Array:
    """Positions of the cables' nodes, (n, 3) (length)."""
    return np.concatenate([np.zeros((0, 3)), *(cable.state.positions for cable in cables)])


def fractions_of(cables: Sequence[LaidCable]) -> Array:
    """Fractions of the cables' nodes on their edges, (n,)."""
    return np.concatenate([np.zeros(0), *(cable.state.fractions for cable in cables)])


class PointsOnEdges:
    """Chosen points of taut cables on each edge, as arrays."""

    def __init__(
        self, table: NodeTable, chosen: Booleans, on: Integers, fractions: Array, size: int
    ) -> None:
        nodes = np.flatnonzero((table.size == 2) & (table.kind != CROSSING) & table.taut)
        edges, first, inverse = np.unique(on[nodes], return_index=True, return_inverse=True)
        nodes, edge = nodes[chosen[nodes]], inverse[chosen[nodes]]
        order = np.lexsort((nodes, fractions[nodes], first[edge]))
        # rows of the points, edge by edge, each from its first vertex to its last
        self.nodes, edge = nodes[order], edges[edge[order]]
        begins = np.flatnonzero(np.diff(edge, prepend=-1))
        self.edges = edge[begins]  # numbers of the edges with points
        # (size,) first point of each simplex, and number of points
        self.starts, self.counts = np.zeros(size, dtype=np.int64), np.bincount(edge, minlength=size)
        self.starts[self.edges] = begins
        # (nodes,) index along the edge, from 0; -1 for all other nodes
        self.place = np.full(len(on), -1)
        self.place[self.nodes] = np.arange(len(self.nodes)) - self.starts[edge]
