"""The membrane's current surface as a cable sees it: bent edges, and anchors beyond the boundary.

A path is pulled taut by lengths of edges and the order of the cells at a vertex alone. An edge is
as long as the way through the fold points on it.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from types import MappingProxyType

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.runtime.arrays import Array, floats
from crms_fenicsx.surface.intrinsic import MissingCells, Ring, ring_of
from crms_fenicsx.surface.points import Edge


class CreasedSurface:
    """Lengths and neighbours on the current surface, folded by the cables in tension."""

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

    def length(self, edge: Edge) -> float:
        """Length of an edge through all fold points on it."""
        if edge[1] in self.anchors:
            return math.dist(self._at[edge[0]], self.anchors[edge[1]])
        bends = self.bends.get(edge)
        if bends is None:
            return math.dist(self._at[edge[0]], self._at[edge[1]])
        total, (x, y, z) = 0.0, self._at[edge[0]]
        for p, q, r in self._line(edge, bends)[1:]:
            total += math.sqrt((p - x) * (p - x) + (q - y) * (q - y) + (r - z) * (r - z))
            x, y, z = p, q, r
        return total

    def _line(self, edge: Edge, bends: Sequence[Array]) -> list[Sequence[float]]:
        """Positions along an edge: its vertices and the fold points between."""
        return [self._at[edge[0]], *map(floats, bends), self._at[edge[1]]]

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
        """Position on an edge at a share of its length, (3,)."""
        line = self._line(edge, self.bends.get(edge, ()))
        arcs = _arcs(line)
        at = max(fraction, 0.0) * arcs[-1]
        if at >= arcs[-1]:
            return np.array(line[-1])
        k = bisect(arcs, at) - 1
        step, more = arcs[k + 1] - arcs[k], at - arcs[k]
        return np.array([(b - a) / step * more + a for a, b in zip(*line[k : k + 2], strict=True)])


def _arcs(line: Sequence[Sequence[float]]) -> list[float]:
    """Lengths of a polyline (n, 3) from its first point to each one.

    An edge has few points: `arc_lengths` takes longer to set up than to compute.
    """
    steps = ((b[0] - a[0], b[1] - a[1], b[2] - a[2]) for a, b in pairwise(line))
    sizes = (math.sqrt(x * x + y * y + z * z) for x, y, z in steps)
    return list(accumulate(sizes, initial=0.0))
