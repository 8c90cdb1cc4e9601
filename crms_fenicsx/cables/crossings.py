"""Crossing cables: found from their paths, lifted parts by the cells under them.

Two cables that cross inside a cell share one free point there; without it the folds of one would
cut through the other. Which cells those are follows from the order of the cables' points around
each cell, and so it changes by itself as paths and fold points move: a crossing that slides over
an edge is found in the next cell, one that slides off is gone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from crms_fenicsx.cables.points_on_edges import VERTEX, NodeTable, PointsOnEdges
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.model.cable_state import CableNode, Crossing, NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array, Integers, runs
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

    def on_edges(self) -> list[Meeting]:
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

    def in_cells(self) -> list[Meeting]:
        """Chords of one cell that cross: their ends alternate around it."""
        first, second, row = self._pairs()
        ends = np.stack([first, first + 1, second, second + 1], axis=1)
        rims = self._rim(ends.ravel(), np.repeat(row, 4)).reshape(-1, 4)
        flat = self._flat(ends.ravel(), np.repeat(row, 4)).reshape(-1, 4, 3)
        t = _intersections(flat)
        inside = np.any(rims < 0, axis=1)  # an end of a cable inside the cell
        meet = np.all((0.0 < t) & (t < 1.0), axis=1)
        low, high = np.sort(rims[:, :2], axis=1).T
        between = (low[:, None] < rims[:, 2:]) & (rims[:, 2:] < high[:, None])
        apart = np.all(np.diff(np.sort(rims, axis=1), axis=1) > 0, axis=1)
        crosses = np.where(inside, meet, apart & (between[:, 0] != between[:, 1]))
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


TANGLED = 8
"""Two crossings of the same cables with fewer cells than this between them are no way for taut
cables to lie."""


def arrange(
    cables: Sequence[LaidCable], strip: Strip, known: Sequence[Crossing]
) -> tuple[Crossing, ...]:
    """Find the crossings of the cables in tension, and insert their points into the cables."""
    before = [cable.state for cable in cables]
    for cable in cables:
        known = _remove_crossings(cable, known)
    meetings = Meetings(cables, strip)
    found = meetings.on_edges() + meetings.in_cells()
    inserted: list[dict[int, list[tuple[float, CableNode, Array]]]]
    inserted = [defaultdict(list) for _ in cables]
    left: dict[tuple[int, int], list[Crossing]] = defaultdict(list)
    for one in known:
        left[one.lower, one.upper].append(one)
    crossings: list[Crossing] = []
    for first, second, along, point in sorted(found, key=lambda m: (m.first, m.along[0])):
        places = []
        for (c, k), t in zip((first, second), along, strict=True):
            a, b = cables[c].positions[[k, min(k + 1, len(cables[c].nodes) - 1)]]
            places.append(a + t * (b - a))
        (lower, t_lower), (upper, t_upper) = sorted(
            zip((first, second), along, strict=True),
            key=lambda side: (cables[side[0][0]].layer, side[0][0]),
        )
        between = tuple(
            () if node.point is None else node.support
            for c, k in (lower, upper)
            for node in cables[c].nodes[k : k + 2]
        )
        numbers = (lower[1], upper[1])
        place = (places[0] + places[1]) / 2
        crossing = Crossing(lower[0], upper[0], point.support, numbers, place, between)
        crossing = _inherited(crossing, left[crossing.lower, crossing.upper], cables)
        number = len(crossings)
        crossings.append(crossing)
        if crossing.separated:
            continue
        node = CableNode("crossing", point, number)
        for member, t in ((lower, t_lower), (upper, t_upper)):
            if not _is_fold_point(cables, member, number, point):
                inserted[member[0]][member[1]].append((t, node, crossing.place))
    for c, cable in enumerate(cables):
        _insert(cable, inserted[c])
        old = before[c]
        if len(cable.nodes) == len(old.nodes) and all(map(_is_alike, cable.nodes, old.nodes)):
            # what the last solve has found of the cable's points stays
            cable.update(reference_positions=old.reference_positions, blocked=old.blocked)
    return tuple(crossings)


def _is_alike(one: CableNode, other: CableNode) -> bool:
    """Whether two nodes are of one kind, on or between the same vertices."""
    if one is other or one.point is other.point:
        return one.kind == other.kind
    alone = one.point is None or other.point is None
    return one.kind == other.kind and not alone and one.support == other.support


def tangled(crossings: Sequence[Crossing]) -> set[int]:
    """Numbers of upper cables that cross a lower one to and fro within a few cells."""
    found = set()
    for a, b in combinations(crossings, 2):
        if (a.lower, a.upper) == (b.lower, b.upper):
            if max(abs(i - j) for i, j in zip(a.links, b.links, strict=True)) <= TANGLED:
                found.add(a.upper)
    return found


def _inherited(crossing: Crossing, left: list[Crossing], cables: Sequence[LaidCable]) -> Crossing:
    """Go on from the nearest one left of these cables' crossings; a new one starts as they lie."""
    if not left:
        upper, k = cables[crossing.upper], crossing.links[1]
        return replace(crossing, separated=all(upper.lifted[k : k + 2]))
    away = [float(np.linalg.norm(k.place - crossing.place)) for k in left]
    old = left.pop(away.index(min(away)))
    # if they cross other edges before and after it, it would draw them aside where it was
    place = old.place if old.between == crossing.between else crossing.place
    return replace(crossing, separated=old.separated, place=place, clamp=old.clamp)


def _is_fold_point(
    cables: Sequence[LaidCable], member: NodeId, number: int, point: CellPoint | EdgePoint
) -> bool:
    """Let a fold point on an edge that another cable follows be the crossing's point."""
    cable, k = cables[member[0]], member[1]
    node = cable.nodes[k]
    if not isinstance(point, EdgePoint) or node.kind == "vertex":
        return False
    nodes = list(cable.nodes)
    nodes[k] = CableNode(node.kind, node.point, number)
    cable.update(nodes=tuple(nodes))
    return True


def at_nodes(crossings: Sequence[Crossing], cable: LaidCable) -> tuple[Crossing, ...]:
    """The crossings with the places of a cable's nodes, for when its nodes are replaced."""
    found = list(crossings)
    for k, node in enumerate(cable.nodes):
        if node.crossing is not None:
            place = cable.positions[k].copy()
            found[node.crossing] = replace(found[node.crossing], place=place)
    return tuple(found)


def _remove_crossings(cable: LaidCable, known: Sequence[Crossing]) -> Sequence[Crossing]:
    """Take the crossings out of a cable's nodes; return them with the places of these."""
    keep = np.array([node.kind != "crossing" for node in cable.nodes])
    if keep.all() and all(node.crossing is None for node in cable.nodes):
        return known
    known = at_nodes(known, cable)
    nodes = [node for node, kept in zip(cable.nodes, keep, strict=True) if kept]
    cable.set_nodes(
        [node if node.crossing is None else CableNode(node.kind, node.point) for node in nodes],
        cable.positions[keep], cable.fractions[keep], cable.lifted[keep],
    )  # fmt: skip
    return known


def _insert(cable: LaidCable, new: dict[int, list[tuple[float, CableNode, Array]]]) -> None:
    """Insert crossings after some nodes, sorted by how far along the links they are."""
    if not new:
        return
    nodes: list[CableNode] = []
    places: list[Array] = []
    after: list[int] = []
    last = 0
    for k in sorted(new):
        nodes += cable.nodes[last : k + 1]
        for _, shared, place in sorted(new[k], key=lambda entry: entry[0]):
            nodes.append(shared)
            places.append(place)
            after.append(k + 1)
        last = k + 1
    cable.set_nodes(
        [*nodes, *cable.nodes[last:]],
        np.insert(cable.positions, after, places, axis=0),
        np.insert(cable.fractions, after, np.nan),
        np.insert(cable.lifted, after, False),
    )
