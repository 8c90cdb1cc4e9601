"""Where the paths of cables in tension cross, lifted parts by the cells under them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crms_fenicsx.cables.node_table import VERTEX, NodeTable
from crms_fenicsx.cables.points_on_edges import PointsOnEdges
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers, runs
from crms_fenicsx.surface.points import CellPoint, EdgePoint


class Meeting(NamedTuple):
    """Two links that cross: their first nodes, how far along each, and the place in the cell."""

    first: NodeId
    second: NodeId
    along: tuple[float, float]
    point: CellPoint | EdgePoint


class Meetings:
    """Finds where links cross that lie in the same cell, or on an edge with points."""

    def __init__(self, cables: Sequence[LaidCable], strip: Strip) -> None:
        self.strip, self.nodes = strip, NodeTable(cables)
        nodes, simplices = self.nodes, strip.simplices
        self.on = simplices.find(nodes.support)
        self.fractions = np.concatenate([np.zeros(0), *(cable.fractions for cable in cables)])
        self.points = PointsOnEdges(
            nodes, nodes.taut, self.on, self.fractions, len(simplices.owner)
        )
        there = nodes.taut & (nodes.size > 0)
        first = np.flatnonzero(there[:-1] & there[1:] & (nodes.cable[:-1] == nodes.cable[1:]))
        both = simplices.spanned(nodes.support[first], nodes.support[first + 1])
        assert np.all(both >= 0), "a link that lies on no cell of the strip"
        follows = simplices.corners[both, 2] < 0
        self._follows = first[follows], both[follows]
        self._inside = first[~follows], simplices.rows[simplices.pointers[both[~follows]]]

    def find(self) -> list[Meeting]:
        """All meetings."""
        return self._on_edges() + self._in_cells()

    def _on_edges(self) -> list[Meeting]:
        """Points on an edge that a link of another cable follows."""
        found, nodes, points = [], self.nodes, self.points
        some = points.counts[self._follows[1]] > 0
        for link, edge in zip(*(part[some] for part in self._follows), strict=True):
            a, b = map(int, self.strip.vertices[self.strip.simplices.corners[edge, :2]])
            start = points.starts[edge]
            for point in points.nodes[start : start + points.counts[edge]]:
                if nodes.cable[point] != nodes.cable[link]:
                    fraction = float(self.fractions[point])
                    ascending = nodes.size[link] == 1 and nodes.support[link, 0] == a
                    along = fraction if ascending else 1 - fraction
                    first, second = nodes.ids(np.array([link, point]))
                    place = EdgePoint((a, b), fraction)
                    found.append(Meeting(first, second, (along, 0.0), place))
        return found

    def _in_cells(self) -> list[Meeting]:
        """Chords of one cell that cross: their ends alternate around it."""
        first, second, row = self._pairs()
        ends = np.stack([first, first + 1, second, second + 1], axis=1)
        rims = self._rim(ends.ravel(), np.repeat(row, 4)).reshape(-1, 4)
        flat = self._flat(ends.ravel(), np.repeat(row, 4)).reshape(-1, 4, 3)
        t = _intersections(flat)
        inside = np.any(rims < 0, axis=1)  # an end of a cable inside the cell
        meet = np.all((0.0 < t) & (t < 1.0), axis=1)
        crosses = np.where(inside, meet, _alternate(rims))
        t = np.clip(t[crosses], 0.0, 1.0)
        start, end = flat[crosses, 0], flat[crosses, 1]
        weights = np.maximum(start + t[:, :1] * (end - start), 0.0)
        weights /= (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]
        links = (self.nodes.ids(own[crosses]) for own in (first, second))
        cells = self.strip.cells[row[crosses]]
        return [
            Meeting(one, other, (float(s), float(r)), CellPoint(tuple(cell), tuple(share)))
            for one, other, (s, r), cell, share in zip(*links, t, cells, weights, strict=True)
        ]

    def _pairs(self) -> tuple[Integers, Integers, Integers]:
        """Links of two cables in one cell: their first nodes, and the cell's row in the strip."""
        link, row = self._inside
        order = np.argsort(row, kind="stable")
        link, row = link[order], row[order]
        after = np.searchsorted(row, row, side="right") - np.arange(len(row)) - 1
        one = np.repeat(np.arange(len(row)), after)
        other = runs(np.arange(len(row)) + 1, after)
        apart = self.nodes.cable[link[one]] != self.nodes.cable[link[other]]
        one, other = one[apart], other[apart]
        return link[one], link[other], row[one]

    def _rim(self, nodes: Integers, rows: Integers) -> Integers:
        """Places of nodes among the corners and points around cells; -1 for those inside."""
        simplices, points = self.strip.simplices, self.points
        sides, forward = simplices.sides[rows], simplices.forward[rows]
        counts = points.counts[sides]
        corners = np.cumsum(counts + 1, axis=1) - counts - 1
        k = np.argmax(sides == self.on[nodes, None], axis=1)
        every = np.arange(len(nodes))
        along = points.place[nodes]
        along = np.where(forward[every, k], along, counts[every, k] - 1 - along)
        at = np.where(points.place[nodes] >= 0, corners[every, k] + 1 + along, -1)
        vertex = simplices.corners[self.on[nodes], :1]
        k = np.argmax(simplices.cells[rows] == vertex, axis=1)
        return np.where(self.nodes.kind[nodes] == VERTEX, corners[every, k], at)

    def _flat(self, nodes: Integers, rows: Integers) -> Array:
        """Barycentric weights of nodes in cells, (n, 3)."""
        weights, s = self.nodes.weights[nodes], self.fractions[nodes]
        slides = (self.nodes.size[nodes] == 2) & ~np.isnan(s)
        weights[slides, :2] = np.stack([1 - s, s], axis=1)[slides]
        same = self.strip.cells[rows][:, :, None] == self.nodes.support[nodes][:, None, :]
        flat: Array = np.sum(np.where(same, weights[:, None, :], 0.0), axis=2)
        return flat


def _alternate(rims: Integers) -> Booleans:
    """Whether the ends of two chords, (n, 4) places around a cell, are all apart and alternate."""
    low, high = np.sort(rims[:, :2], axis=1).T
    between = (low[:, None] < rims[:, 2:]) & (rims[:, 2:] < high[:, None])
    apart = np.all(np.diff(np.sort(rims, axis=1), axis=1) > 0, axis=1)
    alternate: Booleans = apart & (between[:, 0] != between[:, 1])
    return alternate


def _intersections(ends: Array) -> Array:
    """Where lines 01 and 23, in barycentric weights (n, 4, 3), cross: their parameters, (n, 2)."""
    a, b, p, q = (ends[:, k, :2].T for k in range(4))
    u, v, w = b - a, q - p, p - a
    cross = u[0] * v[1] - u[1] * v[0]
    parallel = cross == 0.0
    cross[parallel] = 1.0
    t = np.stack([w[0] * v[1] - w[1] * v[0], w[0] * u[1] - w[1] * u[0]], axis=1) / cross[:, None]
    t[parallel] = 0.5
    return t
