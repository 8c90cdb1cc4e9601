"""The current surface for pulling cables taut: edges folded by other cables, seams, anchors.

Only edge lengths, measured through fold points, and the order of cells around vertices enter.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from itertools import accumulate, pairwise
from types import MappingProxyType

import numpy as np

from crms_fenicsx.cabling.cables.points_on_edges import (
    CROSSING,
    NodeTable,
    fractions_of,
    positions_of,
)
from crms_fenicsx.cabling.cables.strip import StripShape, own_surface
from crms_fenicsx.foundation.meshes.triangles import norm, vectors
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, floats, ints, pointers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import ON_SURFACE, feet_of
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import Edge
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells, Ring, ring_of
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane

BASE = 1 << 32
"""Above any vertex id: an edge (a, b) has the key a BASE + b."""


class FoldPoints:
    """Fold points, in order along each edge: edges (k, 2), counts (k,), points (m, 3)."""

    def __init__(self, edges: Integers, counts: Integers, points: Array) -> None:
        self.edges, self.points = edges, points
        self._first = pointers(counts)
        keys = ints(edges[:, 0] * BASE + edges[:, 1])  # tuples would burden garbage collection
        self._number = dict(zip(keys, range(len(keys)), strict=True))

    @classmethod
    def of(
        cls,
        cables: Sequence[LaidCable],
        nodes: NodeTable | None = None,
        near: Sequence[int] | None = None,
    ) -> FoldPoints:
        """Current fold points of taut cables with given nodes, without lifted ones; only those on
        edges between the vertices `near`, if given."""
        table, fractions = nodes or NodeTable.of(cables), fractions_of(cables)
        on = (table.size == 2) & (table.kind != CROSSING) & table.taut & ~table.lifted
        rows = np.flatnonzero(on)
        if near is not None:
            rows = rows[np.isin(table.support[rows, :2], near).all(axis=1)]
        first, second = table.support[rows, 0], table.support[rows, 1]
        rows = rows[np.lexsort((rows, fractions[rows], second, first))]
        edges = table.support[rows, :2]
        starts = np.flatnonzero(np.diff(edges, axis=0, prepend=-1).any(axis=1))
        counts = np.diff(starts, append=len(rows))
        return cls(edges[starts], counts, positions_of(cables)[rows])

    def on(self, edge: Edge) -> Array:
        """Positions of the points on an edge, (k, 3)."""
        k = self.number(edge)
        return self.points[:0] if k is None else self.points[self._first[k] : self._first[k + 1]]

    def number(self, edge: Edge) -> int | None:
        """Index of an edge in `edges`; None without fold points."""
        return self._number.get(edge[0] * BASE + edge[1])

    def lengths(self, shape: StripShape) -> list[float]:
        """Lengths of the edges through their fold points, (k,)."""
        if not len(self.edges):
            return []
        ends = shape.current[np.searchsorted(shape.strip.vertices, self.edges)]
        first = self._first + 2 * np.arange(len(self._first))  # each edge has two vertices more
        line = np.empty((first[-1], 3))
        inner = np.ones(len(line), dtype=bool)
        for k, at in enumerate((first[:-1], first[1:] - 1)):
            line[at], inner[at] = ends[:, k], False
        line[inner] = self.points
        steps = norm(np.diff(line, axis=0, append=line[-1:]))
        steps[first[1:] - 1] = 0.0
        return floats(np.add.reduceat(steps, first[:-1]))


NO_FOLDS = FoldPoints(np.zeros((0, 2), dtype=int), np.zeros(0, dtype=int), np.zeros((0, 3)))
"""Fold points of a membrane without cables."""


def refuse_places_behind(membrane: Membrane, route: Array, name: str) -> None:
    """Reject a route (k, 3) with a point that lies only on cells behind a seam. Collective."""
    positions, cells = own_surface(membrane)
    hidden = np.isin(np.arange(len(cells)), membrane.mesh.hidden)
    behind, outer = membrane.comm.allreduce(np.array([hidden.sum(), (~hidden).sum()]))
    if outer == 0:
        raise PathError(
            f"lay_cable: {name!r} finds no outer side of the membrane: each of its pieces meets "
            "others at a seam from behind; turn them with the `outside` of the mesh."
        )
    if behind == 0:
        return
    if route.shape[1] == 2:
        positions = positions * (1.0, 1.0, 0.0)
    course = np.pad(route, ((0, 0), (0, 3 - route.shape[1])))
    feet = [feet_of(positions, cells[some], course, membrane.comm) for some in (hidden, ~hidden)]
    for i, (point, on_hidden, on_outer) in enumerate(zip(vectors(course), *feet, strict=True)):
        reach = ON_SURFACE * on_hidden.size
        if on_hidden.distance <= reach and on_outer.distance > max(reach, on_hidden.distance):
            raise PathError(
                f"lay_cable: point {i} of {name!r} at {as_text(point)} lies on a part of the "
                "membrane behind a seam, such as a wall below a roof, where no cable can be laid; "
                "lead it over the outer side, or turn that part with the `outside` of the mesh."
            )


def refuse_forks(path: Path, shape: StripShape, name: str) -> None:
    """Reject a path over a seam of more than two outer cells, as its continuation is ambiguous."""
    places = vectors(path.positions(shape.strip.vertices, shape.current))
    for point, place in zip(path.points, places, strict=True):
        if len(point.support) == 2 and (n := len(shape.strip.outer_rows(point.support))) > 2:
            raise PathError(
                f"lay_cable: {name!r} comes to a seam of {n} outer cells at {as_text(place)}, "
                "where it has no one way on; end it before the seam, and lay another one beyond."
            )


class CreasedSurface:
    """Edge lengths and neighbours on the current surface, folded by taut cables."""

    def __init__(
        self,
        shape: StripShape,
        folds: FoldPoints,
        anchors: Mapping[int, Array] = MappingProxyType({}),
        ends: Mapping[int, tuple[int, ...]] = MappingProxyType({}),
    ) -> None:
        self.shape, self.strip, self.folds = shape, shape.strip, folds
        self.anchors = _places(anchors)
        self.ends = ends

    def with_anchors(
        self, anchors: Mapping[int, Array], ends: Mapping[int, tuple[int, ...]]
    ) -> CreasedSurface:
        """The same surface with other anchors."""
        self._bent  # noqa: B018 - computed once for both
        surface = copy(self)
        surface.anchors, surface.ends = _places(anchors), ends
        return surface

    @cached_property
    def _bent(self) -> list[float]:
        """Lengths of the edges with fold points, by their numbers."""
        return self.folds.lengths(self.shape)

    def length(self, edge: Edge) -> float:
        """Length of an edge through its fold points."""
        at = self.shape.places
        if edge[1] in self.anchors:
            return math.dist(at[edge[0]], self.anchors[edge[1]])
        k = self.folds.number(edge)
        return math.dist(at[edge[0]], at[edge[1]]) if k is None else self._bent[k]

    def _line(self, edge: Edge) -> list[Sequence[float]]:
        """Positions along an edge: its vertices and the fold points between."""
        points, at = map(floats, vectors(self.folds.on(edge))), self.shape.places
        return [at[edge[0]], *points, at[edge[1]]]

    def opposite_vertices(self, edge: Edge) -> tuple[int, ...]:
        """Vertices opposite to an edge."""
        if edge[1] in self.anchors:
            around = self.membrane_ring(edge[0]).neighbours
            return tuple(v for v in (around[0], around[-1]) if edge[1] in self._joined_to(v))
        cells = [self.strip.corners[row] for row in self.strip.outer_rows(edge)]
        opposite = tuple([v for cell in cells for v in cell if v not in edge])
        if self.anchors and self.is_boundary(edge):
            return (*opposite, *sorted(self._joined_to(edge[0]) & self._joined_to(edge[1])))
        return opposite

    def is_boundary(self, support: tuple[int, ...]) -> bool:
        """Whether a vertex or an edge lies on the membrane's boundary."""
        if len(support) == 1:
            return not self.membrane_ring(support[0]).closed
        known = self.strip.complete.intersection(support)
        return len(support) == 2 and bool(known) and len(self.strip.outer_rows(support)) == 1

    def _joined_to(self, vertex: int) -> set[int]:
        """Anchors to which a boundary vertex is joined."""
        place = self.shape.places[vertex]
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
        cells = (self.strip.corners[row] for row in self.strip.outer_rows((vertex,)))
        return ring_of(vertex, cells)

    def place(self, edge: Edge, fraction: float) -> Array:
        """Position on an edge at a fraction of its length, (3,)."""
        line = self._line(edge)
        arcs = _arcs(line)
        at = max(fraction, 0.0) * arcs[-1]
        if at >= arcs[-1]:
            return np.array(line[-1])
        k = bisect(arcs, at) - 1
        step, more = arcs[k + 1] - arcs[k], at - arcs[k]
        return np.array([(b - a) / step * more + a for a, b in zip(*line[k : k + 2], strict=True)])


def _places(anchors: Mapping[int, Array]) -> dict[int, tuple[float, float, float]]:
    return {k: (float(x[0]), float(x[1]), float(x[2])) for k, x in anchors.items()}


def _arcs(line: Sequence[Sequence[float]]) -> list[float]:
    """Arc lengths of a polyline (n, 3); faster than `arc_lengths` for the few points of an edge."""
    steps = ((b[0] - a[0], b[1] - a[1], b[2] - a[2]) for a, b in pairwise(line))
    sizes = (math.sqrt(x * x + y * y + z * z) for x, y, z in steps)
    return list(accumulate(sizes, initial=0.0))
