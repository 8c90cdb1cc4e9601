"""All nodes of all cables as arrays, and the cables' points in order along the edges."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterator, Mapping, Sequence
from itertools import chain

import numpy as np

from crms_fenicsx.model.cable_state import CableNode, NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers, pointers
from crms_fenicsx.surface.points import Edge, EdgePoint

VERTEX, FOLD, EDGE_SLIDER, TIED, ANCHOR, CROSSING = range(6)
NUMBERS = dict(
    zip(("vertex", "fold", "edge slider", "tied", "anchor", "crossing"), range(6), strict=True)
)
"""The numbers of `CableNode.kind`."""


class NodeTable:
    """The nodes of some cables, n in all; what they are, not where they are in space."""

    def __init__(self, cables: Sequence[LaidCable]) -> None:
        nodes = [node for cable in cables for node in cable.nodes]
        counts = np.array([len(cable.nodes) for cable in cables], dtype=np.int64)
        n = len(nodes)
        self.starts = pointers(counts)  # rows at which the cables begin
        self.cable = np.repeat(np.arange(len(cables)), counts)  # (n,) number of the cable
        self.place = np.arange(n) - self.starts[self.cable]  # (n,) number of the node in it
        self.kind = np.fromiter((NUMBERS[node.kind] for node in nodes), np.int64, n)
        shared = (-1 if node.crossing is None else node.crossing for node in nodes)
        self.crossing = np.fromiter(shared, np.int64, n)
        points = [node.point for node in nodes]
        supports = [() if point is None else point.support for point in points]
        # (n, 3) vertices (ids) on which a node lies or between which, -1 after the last one, their
        # weights on the unfolded mesh, and (n,) how many these are; 0 for anchors
        self.size = np.fromiter(map(len, supports), np.int64, n)
        there = np.arange(3) < self.size[:, None]
        self.support = np.full((n, 3), -1)
        self.support[there] = np.fromiter(chain.from_iterable(supports), np.int64)
        weights = (point.weights for point in points if point is not None)
        self.weights = np.zeros((n, 3))
        self.weights[there] = np.fromiter(chain.from_iterable(weights), float)
        self.taut = np.repeat(np.array([cable.taut for cable in cables], dtype=bool), counts)
        empty = np.zeros(0, dtype=bool)
        self.lifted = np.concatenate([empty, *(cable.lifted for cable in cables)])
        self.slides = (self.kind == FOLD) | (self.kind == EDGE_SLIDER)

    def ids(self, rows: Integers) -> list[NodeId]:
        """Numbers of the cable and of the node for some rows."""
        return list(zip(map(int, self.cable[rows]), map(int, self.place[rows]), strict=True))


class PointsOnEdges:
    """Chosen points of cables in tension on each edge, as arrays."""

    def __init__(
        self, table: NodeTable, chosen: Booleans, on: Integers, fractions: Array, size: int
    ) -> None:
        nodes = np.flatnonzero((table.size == 2) & (table.kind != CROSSING) & table.taut)
        edges, first, inverse = np.unique(on[nodes], return_index=True, return_inverse=True)
        nodes, edge = nodes[chosen[nodes]], inverse[chosen[nodes]]
        order = np.lexsort((nodes, fractions[nodes], first[edge]))
        # rows of the points, edge after edge, each from its first vertex to its last
        self.nodes, edge = nodes[order], edges[edge[order]]
        begins = np.flatnonzero(np.diff(edge, prepend=-1))
        self.edges = edge[begins]  # numbers of the edges with points
        # (size,) where the points of each simplex begin, and how many there are
        self.starts, self.counts = np.zeros(size, dtype=np.int64), np.bincount(edge, minlength=size)
        self.starts[self.edges] = begins
        # (nodes,) place of each along its edge, from 0; -1 for all other nodes
        self.place = np.full(len(on), -1)
        self.place[self.nodes] = np.arange(len(self.nodes)) - self.starts[edge]


def on_edges(nodes: Sequence[CableNode]) -> Iterator[tuple[int, Edge]]:
    """Numbers of a cable's nodes on edges, crossings not counted, and these edges."""
    for k, node in enumerate(nodes):
        if isinstance(node.point, EdgePoint) and node.kind != "crossing":
            yield k, node.point.edge


def nodes_on_edges(
    cables: Sequence[LaidCable], wanted: Container[Edge] | None = None
) -> dict[Edge, list[NodeId]]:
    """Nodes of cables in tension on wanted edges, or on all, lifted ones too."""
    found: dict[Edge, list[NodeId]] = defaultdict(list)
    for c, cable in enumerate(cables):
        for k, edge in on_edges(cable.nodes) if cable.taut else ():
            if wanted is None or edge in wanted:
                found[edge].append((c, k))
    return found


def points_by_edge(
    cables: Sequence[LaidCable], nodes: Mapping[Edge, Sequence[tuple[int, int]]] | None = None
) -> dict[Edge, list[tuple[float, int, int]]]:
    """Points, none lifted, of cables in tension on each edge, sorted from its first vertex to its
    last: places on the edge (fractions), and numbers of cables and nodes."""
    found = {
        edge: sorted(
            (float(cables[c].fractions[k]), c, k) for c, k in members if not cables[c].lifted[k]
        )
        for edge, members in (nodes_on_edges(cables) if nodes is None else nodes).items()
    }
    return {edge: points for edge, points in found.items() if points}


def bends(
    cables: Sequence[LaidCable],
    nodes: Mapping[Edge, Sequence[tuple[int, int]]] | None = None,
    but: LaidCable | None = None,
) -> dict[Edge, list[Array]]:
    """Positions (3,) of the points on each edge, in order; see `points_by_edge`."""
    return {
        edge: [cables[c].positions[k] for _, c, k in points if cables[c] is not but]
        for edge, points in points_by_edge(cables, nodes).items()
    }
