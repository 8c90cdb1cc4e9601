"""The membrane's current surface as a cable sees it: bent edges, and anchors beyond the boundary.

A path is pulled taut by lengths of edges and the order of the cells at a vertex alone. An edge is
as long as the way through the fold points on it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.intrinsic import MissingCells, Ring, ring_of
from crms_fenicsx.surface.points import Edge
from crms_fenicsx.surface.triangles import arc_lengths, norm


class CreasedSurface:
    """Lengths and neighbours on the current surface, folded by the cables in tension.

    Parameters
    ----------
    shape
        Positions of the vertices around the cables.
    bends
        Positions of the fold points on each edge, in order.
    anchors
        Positions of anchors beyond the boundary, by ids that no vertex has: a cable runs on to its
        anchor over triangles that join the anchor to the edges of the boundary. Each vertex of the
        boundary is joined to the nearest of them.
    ends
        The vertices of the boundary that are next to an anchor along the cable: joined to it in any
        case.
    """

    def __init__(
        self,
        shape: StripShape,
        bends: Mapping[Edge, Sequence[Array]],
        anchors: Mapping[int, Array] = MappingProxyType({}),
        ends: Mapping[int, tuple[int, ...]] = MappingProxyType({}),
    ) -> None:
        self.shape, self.strip, self.bends = shape, shape.strip, bends
        self.anchors = {k: (float(x[0]), float(x[1]), float(x[2])) for k, x in anchors.items()}
        self.ends = ends
        self._at = shape.places

    def line(self, edge: Edge) -> Array:
        """Positions along an edge: its vertices and the fold points between, (n, 3)."""
        return np.array([self.shape.at(edge[0]), *self.bends.get(edge, ()), self.shape.at(edge[1])])

    def length(self, edge: Edge) -> float:
        """Length of an edge through all fold points on it."""
        if edge[1] in self.anchors:
            return math.dist(self._at[edge[0]], self.anchors[edge[1]])
        if edge not in self.bends:
            return math.dist(self._at[edge[0]], self._at[edge[1]])
        return self._bent_lengths[edge]

    @cached_property
    def _bent_lengths(self) -> dict[Edge, float]:
        """Lengths of the edges with fold points on them."""
        most = max(map(len, self.bends.values()), default=0)
        lines = [
            [self._at[a], *points, *[self._at[b]] * (1 + most - len(points))]
            for (a, b), points in self.bends.items()
        ]
        parts = norm(np.diff(np.array(lines).reshape(-1, most + 2, 3), axis=1))
        return dict(zip(self.bends, map(float, parts.sum(axis=1)), strict=True))

    def opposite_vertices(self, edge: Edge) -> tuple[int, ...]:
        """Vertices opposite to an edge."""
        if edge[1] in self.anchors:
            around = self.membrane_ring(edge[0]).neighbours
            return tuple(v for v in (around[0], around[-1]) if edge[1] in self._joined_to(v))
        cells = (self.strip.corners[row] for row in self.strip.outer_rows(edge))
        opposite = tuple(v for cell in cells for v in cell if v not in edge)
        if self.anchors and self.is_boundary(edge):
            return (*opposite, *sorted(self._joined_to(edge[0]) & self._joined_to(edge[1])))
        return opposite

    def is_boundary(self, support: tuple[int, ...]) -> bool:
        """Whether a vertex or an edge of the membrane lies on its boundary."""
        if len(support) == 1:
            return not self.membrane_ring(support[0]).closed
        known = self.strip.complete.intersection(support)
        return len(support) == 2 and bool(known) and len(self.strip.outer_rows(support)) == 1

    def _joined_to(self, vertex: int) -> set[int]:
        """The anchors to which a vertex of the boundary is joined."""
        place = self._at[vertex]
        nearest = min(self.anchors, key=lambda k: (math.dist(place, self.anchors[k]), k))
        return {nearest} | {k for k, vertices in self.ends.items() if vertex in vertices}

    def ring(self, vertex: int) -> Ring:
        """Neighbours of a vertex in order."""
        ring = self.membrane_ring(vertex)
        if ring.closed or not self.anchors:
            return ring
        around = (vertex, ring.neighbours[0], ring.neighbours[-1])
        common = set.intersection(*(self._joined_to(v) for v in around))
        one = len(common) == 1 and self._joined_to(vertex) == common
        return Ring((*ring.neighbours, *common), True) if one else ring

    def membrane_ring(self, vertex: int) -> Ring:
        """Neighbours of a vertex in order, without anchors."""
        if vertex not in self.strip.complete:
            raise MissingCells([vertex])
        return ring_of(
            vertex,
            [
                (cell[k - 2], cell[k - 1])
                for cell in (self.strip.corners[row] for row in self.strip.outer_rows((vertex,)))
                for k in (cell.index(vertex),)
            ],
        )

    def place(self, edge: Edge, fraction: float) -> Array:
        """Position on an edge at a share of its length."""
        line = self.line(edge)
        run = arc_lengths(line)
        place = [np.interp(fraction * run[-1], run, line[:, i]) for i in range(3)]
        return np.array(place)
