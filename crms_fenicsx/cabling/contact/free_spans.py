"""Free spans of cables, and the membrane below them.

Between two contacts a cable runs straight above the membrane. Its path is kept on the cells below,
and its lifted nodes mark the edges and vertices there, which show how high the span is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from crms_fenicsx.cabling.cables.points_on_edges import (
    ANCHOR,
    CROSSING,
    NodeTable,
    fractions_of,
    positions_of,
)
from crms_fenicsx.cabling.cables.strip import NOBODY, StripShape
from crms_fenicsx.foundation.meshes.triangles import dot
from crms_fenicsx.foundation.runtime.arrays import (
    Array,
    Booleans,
    Integers,
    flags,
    floats,
    ints,
    pointers,
    runs,
)
from crms_fenicsx.foundation.surface import lines
from crms_fenicsx.foundation.surface.points import EdgePoint, Support
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


class Gap(NamedTuple):
    """Gap between a free span and the membrane, at one of the cable's nodes."""

    gap: float  # height of the span along the membrane's normal (length)
    fraction: float  # on the edge; NaN at a vertex
    place: Array  # place, above: (3,) point of the membrane, and of the span
    above: Array
    # whether both lie within the ends of edge and span, or the span is just beyond an edge's end:
    # paths keep that far off vertices, so the two sides need not be distinguished.
    inside: bool
    # vertex at the edge's end that the span passes closely on the other side; -1 if none
    past: int = -1


def under(
    support: Support,
    span: tuple[Array, Array],
    shape: StripShape,
    bends: Sequence[Array] = (),
) -> Gap:
    """Gap of a free span at an edge, with the points (3,) where other cables fold it, or at a
    vertex."""
    line = [shape.at(support[0])] if len(support) == 1 else [
        shape.at(support[0]), *bends, shape.at(support[-1])
    ]  # fmt: skip
    gap, fraction, place, above, inside, end = lines.passed(
        np.array(line), *span, shape.normal(support), TOL.inside, TOL.reach
    )
    return Gap(gap, fraction, place, above, inside, support[end] if end >= 0 else -1)


class FreeSpans:
    """The chosen cables' spans and the membrane below, at all lifted nodes but crossings and feet
    of anchors. With `folded`, edges are folded by the other cables in tension."""

    def __init__(
        self,
        cables: Sequence[LaidCable],
        nodes: NodeTable,
        shape: StripShape,
        chosen: Booleans,
        folded: bool = False,
        reach: float | None = None,
    ) -> None:
        reach = TOL.reach if reach is None else reach
        self.cables, self.nodes = cables, nodes
        x, self._fractions = positions_of(cables), fractions_of(cables)
        contacts = np.flatnonzero(~nodes.lifted)
        off = np.flatnonzero(nodes.lifted & chosen[nodes.cable])
        after = np.searchsorted(contacts, off)
        ends = np.stack([contacts[after - 1], contacts[after]], axis=1)
        share = (off - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
        x[off] = x[ends[:, 0]] + share[:, None] * (x[ends[:, 1]] - x[ends[:, 0]])
        beside = (nodes.kind[off - 1] == ANCHOR) | (nodes.kind[off + 1] == ANCHOR)
        below = (nodes.kind[off] != CROSSING) & ~((nodes.size[off] == 3) & beside)
        self.rows, span = off[below], after[below]  # (m,) of the nodes
        simplices = shape.strip.simplices
        on = nodes.on(simplices)
        corners = simplices.corners[on[self.rows]]
        # Cables slide aside where they cross in the air, and lift over vertices of another span.
        spans = contacts[span[:, None] + np.arange(-1, 1)]
        fractions, in_air = _fractions(shape.current[corners[:, 0]], x[spans]), nodes.in_air[spans]
        at_vertex = nodes.size[self.rows] == 1
        beyond = np.stack([fractions <= 0.0, fractions >= 1.0], axis=1) & in_air
        span += np.where(at_vertex, beyond @ np.array((-1, 1)), 0)
        spans = contacts[span[:, None] + np.arange(-1, 1)]
        self.ends = x[spans]  # (m, 2, 3) of spans
        normals, self.sizes = shape.around(on[self.rows])
        counts, folds = self._folds(on) if folded else (0 * self.rows, self.rows[:0])
        is_line = nodes.size[self.rows] > 1
        first = pointers(counts + 1 + is_line)
        points = np.empty((first[-1], 3))
        points[runs(first[:-1] + 1, counts)] = x[folds]
        points[first[:-1]] = shape.current[corners[:, 0]]
        last = corners[np.arange(len(corners)), nodes.size[self.rows] - 1]
        points[first[1:] - 1] = shape.current[last]
        self.found = lines.passed_by_spans(points, first, self.ends, normals, TOL.inside, reach)
        gaps, along, _, above, self.inside, end = self.found
        fractions, in_air = _fractions(points[first[:-1]], self.ends), nodes.in_air[spans]
        corner = (fractions <= 0.0) & in_air[:, 0] | (fractions >= 1.0) & in_air[:, 1]
        self.inside |= at_vertex & corner
        over_hole = simplices.owner[on[self.rows]] == NOBODY
        self.heights = np.where(over_hole, np.inf, gaps)  # (m,), along the normals
        self.inside, end = self.inside & ~over_hole, np.where(over_hole, -1, end)
        ids = nodes.support[self.rows]
        past = np.where(end == 0, ids[:, 0], ids[np.arange(len(ids)), nodes.size[self.rows] - 1])
        self.past = np.where(end >= 0, past, -1)  # (m,) as in `Gap`
        x[self.rows] = above
        self._positions = x
        slides = self.rows[nodes.slides[self.rows]]
        kept = np.clip(along[nodes.slides[self.rows]], TOL.inside, 1 - TOL.inside)
        self._fractions[slides] = kept  # keeps the path below the span
        self._of = np.searchsorted(self.rows, nodes.starts)  # first of each cable in `rows`

    def _folds(self, on: Integers) -> tuple[Integers, Integers]:
        """Number of points, (m,), that fold the edge at each node, and their rows, in order."""
        nodes, rows = self.nodes, self.rows
        at = np.flatnonzero((nodes.size == 2) & (nodes.kind != CROSSING) & nodes.taut)
        own = np.where(nodes.size[rows] == 2, on[rows], -1)
        at = at[~nodes.lifted[at] & np.isin(on[at], own)]
        at = at[np.lexsort((at, self._fractions[at], on[at]))]
        first = np.searchsorted(on[at], own)
        counts = np.searchsorted(on[at], own, side="right") - first
        of, every = np.repeat(np.arange(len(rows)), counts), at[runs(first, counts)]
        other = nodes.cable[every] != nodes.cable[rows[of]]
        return np.bincount(of[other], minlength=len(rows)), every[other]

    def move(self, c: int) -> None:
        """Move the lifted nodes of a cable onto its spans."""
        own = slice(*self.nodes.starts[c : c + 2])
        self.cables[c].update(
            positions=self._positions[own].copy(), fractions=self._fractions[own].copy()
        )

    def captured(self, c: int, height: float) -> dict[int, Gap]:
        """Nodes of a cable where its spans are lower than `height`, relative to the cell size.

        Where the path rounds a vertex that the span passes on the other side, beyond the ends of
        all path edges there, the span touches near the vertex, as no edge lies below it. This
        happens in steep regions: the path lies in one plane, while each edge is examined along its
        own normal.
        """
        own = slice(*self._of[c : c + 2])
        low = self._of[c] + np.flatnonzero(self.heights[own] < height * self.sizes[own])
        if len(low) == 0:
            return {}
        places = dict(zip(ints(self.nodes.place[self.rows[low]]), self.gaps(low), strict=True))
        passed = {k: one for k, one in places.items() if not one.inside and one.past >= 0}
        return {
            k: one
            for k, one in places.items()
            if one.inside or (height < 0.0 and _passed_by_all(self.cables[c], k, passed))
        }

    def gaps(self, some: Integers) -> list[Gap]:
        """Gaps at some of the nodes."""
        gaps, fractions, places, above = (values[some] for values in self.found[:4])
        rest = list(places), list(above), flags(self.inside[some]), ints(self.past[some])
        return list(map(Gap, floats(gaps), floats(fractions), *rest))


def _fractions(places: Array, spans: Array) -> Array:
    """Fractions along spans (n, 2, 3) of their lines' points nearest to places (n, 3)."""
    start, way = spans[:, 0], spans[:, 1] - spans[:, 0]
    found: Array = dot(places - start, way) / np.maximum(dot(way, way), 1e-300)
    return found


def _passed_by_all(cable: LaidCable, k: int, passed: Mapping[int, Gap]) -> bool:
    """Whether a span passes a vertex beyond the ends of all path edges around it."""
    if k not in passed:
        return False
    vertex = passed[k].past

    def around(n: int) -> bool:
        point = cable.state.nodes[n].point
        return isinstance(point, EdgePoint) and vertex in point.edge

    first = last = k
    while around(first - 1):
        first -= 1
    while around(last + 1):
        last += 1
    return all(n in passed and passed[n].past == vertex for n in range(first, last + 1))
