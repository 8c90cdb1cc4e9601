"""Crossings of cables, found from their paths; lifted parts by the cells under them.

Two cables that cross inside a cell share one free point there, or the folds of one would cut the
other. The cells follow from the order of the cables' points around each cell: a crossing that
slides over an edge is found in the next cell, one that slides off vanishes. Cables that cross at a
vertex move with it; they share a free point where both have lifted off and touch each other.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence, Set
from dataclasses import replace
from itertools import chain, pairwise, product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cabling.cables.points_on_edges import (
    ANCHOR,
    CROSSING,
    VERTEX,
    NodeTable,
    PointsOnEdges,
    fractions_of,
    node_rows,
    positions_of,
)
from crms_fenicsx.cabling.cables.strip import Simplices, Strip
from crms_fenicsx.foundation.meshes.triangles import lists, vectors
from crms_fenicsx.foundation.runtime.arrays import (
    Array,
    Booleans,
    Integers,
    flags,
    ints,
    pointers,
    runs,
)
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
)
from crms_fenicsx.model.cable_state import CableNode, Crossing
from crms_fenicsx.model.laid_cable import LaidCable


class _Meeting(NamedTuple):
    """Two crossing links: rows of their first nodes, fractions along each, place in the cell; at a
    vertex of both, rows of their nodes there."""

    first: int
    second: int
    along: tuple[float, float]
    point: SurfacePoint


class Meetings:
    """Crossings of links in the same cell, of a link along an edge with points on that edge, and at
    common vertices. The node table must contain no crossings."""

    def __init__(self, nodes: NodeTable, fractions: Array, strip: Strip) -> None:
        self.strip, self.nodes, self.fractions = strip, nodes, fractions
        simplices = strip.simplices
        self.on = nodes.on(simplices)
        self.points = PointsOnEdges(nodes, nodes.taut, self.on, fractions, len(simplices.owner))
        there = nodes.taut & (nodes.size > 0)
        first = np.flatnonzero(there[:-1] & there[1:] & (nodes.cable[:-1] == nodes.cable[1:]))
        both = simplices.spanned(self.on[first], self.on[first + 1])
        assert np.all(both >= 0), "a link that lies on no cell of the strip"
        follows = simplices.corners[both, 2] < 0
        self._follows = first[follows], both[follows]
        self._inside = first[~follows], simplices.rows[simplices.pointers[both[~follows]]]

    def on_edges(self) -> list[_Meeting]:
        """Points on an edge along which a link of another cable runs."""
        found, nodes, points = [], self.nodes, self.points
        some = points.counts[self._follows[1]] > 0
        for link, edge in zip(*(ints(part[some]) for part in self._follows), strict=True):
            a, b = map(int, self.strip.vertices[self.strip.simplices.corners[edge, :2]])
            start = points.starts[edge]
            for point in ints(points.nodes[start : start + points.counts[edge]]):
                if nodes.cable[point] != nodes.cable[link]:
                    fraction = float(self.fractions[point])
                    ascending = nodes.size[link] == 1 and nodes.support[link, 0] == a
                    along = fraction if ascending else 1 - fraction
                    place = EdgePoint((a, b), fraction)
                    found.append(_Meeting(link, point, (along, 0.0), place))
        return found

    def in_cells(self) -> list[_Meeting]:
        """Crossing chords of one cell: their ends alternate around it."""
        first, second, row = self._pairs()
        ends = np.stack([first, first + 1, second, second + 1], axis=1)
        rims = self._rim(ends.ravel(), np.repeat(row, 4)).reshape(-1, 4)
        flat = self._flat(ends.ravel(), np.repeat(row, 4)).reshape(-1, 4, 3)
        t = _intersections(flat)
        inside = np.any(rims < 0, axis=1)  # cable ends inside the cell
        meet = np.all((0.0 < t) & (t < 1.0), axis=1)
        low, high = np.sort(rims[:, :2], axis=1).T
        between = (low[:, None] < rims[:, 2:]) & (rims[:, 2:] < high[:, None])
        apart = np.all(np.diff(np.sort(rims, axis=1), axis=1) > 0, axis=1)
        crosses = np.where(inside, meet, apart & (between[:, 0] != between[:, 1]))
        t = np.clip(t[crosses], 0.0, 1.0)
        start, end = flat[crosses, 0], flat[crosses, 1]
        weights = np.maximum(start + t[:, :1] * (end - start), 0.0)
        weights /= (weights[:, 0] + weights[:, 1] + weights[:, 2])[:, None]
        parts = first[crosses], second[crosses], t, self.strip.cells[row[crosses]], weights
        return [
            _Meeting(one, other, (s, r), CellPoint(tuple(cell), tuple(share)))
            for one, other, (s, r), cell, share in zip(*map(np.ndarray.tolist, parts), strict=True)
        ]

    def at_vertices(self, cables: Sequence[LaidCable]) -> list[_Meeting]:
        """Common vertices of two cables, one of which may lift off: without their ends, and where
        they run along one line."""
        nodes = self.nodes
        rows, starts = stacks(nodes, cables)
        one = np.arange(len(rows))
        after = np.repeat(starts[1:], np.diff(starts)) - one - 1
        one, other = np.repeat(one, after), runs(one + 1, after)
        ends = np.append(nodes.starts[:-1], nodes.starts[1:] - 1)
        beside = ends + np.repeat((1, -1), len(cables))
        ends = np.append(ends, beside[nodes.kind[ends] == ANCHOR])
        inner = ~np.isin(rows, ends)
        first, second = (rows[k[inner[one] & inner[other]]] for k in (one, other))
        lifts = np.array([cable.lifts_off for cable in cables], dtype=bool)[nodes.cable]
        cross = (nodes.cable[first] != nodes.cable[second]) & (lifts[first] | lifts[second])
        for a, b in product((-1, 1), repeat=2):
            cross &= self.on[first + a] != self.on[second + b]
        pairs = zip(ints(first[cross]), ints(second[cross]), strict=True)
        return [_Meeting(a, b, (0.0, 0.0), VertexPoint(int(nodes.support[a, 0]))) for a, b in pairs]

    def _pairs(self) -> tuple[Integers, Integers, Integers]:
        """Pairs of links of two cables in one cell: their first nodes, and the cell's row."""
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
        """Position of nodes among the corners and points around cells; -1 inside."""
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
    """Parameters (n, 2) of intersections of lines 01 and 23, from weights (n, 4, 3)."""
    a, b, p, q = (ends[:, k, :2].T for k in range(4))
    u, v, w = b - a, q - p, p - a
    cross = u[0] * v[1] - u[1] * v[0]
    parallel = cross == 0.0
    cross[parallel] = 1.0
    t = np.stack([w[0] * v[1] - w[1] * v[0], w[0] * u[1] - w[1] * u[0]], axis=1) / cross[:, None]
    t[parallel] = 0.5
    return t


def stacks(nodes: NodeTable, cables: Sequence[LaidCable]) -> tuple[Integers, Integers]:
    """Nodes of cables in tension at vertices that they share: rows (n,), vertex by vertex and from
    the lowest cable to the uppermost, and the first of each vertex, (m + 1,)."""
    rows = np.flatnonzero((nodes.kind == VERTEX) & nodes.taut)
    layer = np.array([cable.layer for cable in cables], dtype=np.int64)[nodes.cable[rows]]
    order = np.lexsort((rows, layer, nodes.support[rows, 0]))
    rows = rows[order]
    _, counts = np.unique(nodes.support[rows, 0], return_counts=True)
    shared = counts > 1
    return rows[np.repeat(shared, counts)], pointers(counts[shared])


def at_crossings(crossings: Sequence[Crossing], nodes: NodeTable) -> Integers:
    """Rows (m, 2) of the lower and upper cables' nodes before crossings, or at their vertices."""
    cables = np.array([(one.lower, one.upper) for one in crossings], dtype=np.int64).reshape(-1, 2)
    links = np.array([one.links for one in crossings], dtype=np.int64).reshape(-1, 2)
    own = np.flatnonzero(nodes.kind != CROSSING)
    found: Integers = own[np.searchsorted(own, nodes.starts[cables]) + links]
    return found


def arrange(
    before: NodeTable,
    cables: Sequence[LaidCable],
    strip: Strip,
    known: Sequence[Crossing],
    clamped: Set[tuple[int, ...]] = frozenset(),
) -> tuple[tuple[Crossing, ...], NodeTable]:
    """Find the crossings of taut cables and insert their points into the cables, whose current
    nodes are `before`; `clamped`: numbers of pairs of cables, ascending, and the vertices at which
    they are clamped. Returns the crossings and the new nodes."""
    positions, fractions = positions_of(cables), fractions_of(cables)
    shared, places = np.flatnonzero(before.crossing >= 0), [one.place for one in known]
    for row in ints(shared):
        places[before.crossing[row]] = positions[row]
    kept = before.kind != CROSSING
    plain, nodes = _without_crossings(before, kept, strip.simplices)
    positions, fractions, lifted = positions[kept], fractions[kept], before.lifted[kept]
    meetings = Meetings(plain, fractions, strip)
    found = meetings.on_edges() + meetings.in_cells() + meetings.at_vertices(cables)
    found.sort(key=lambda meeting: (meeting.first, meeting.along[0]))
    links, ends, along = _lower_first(found, plain, cables)
    at = positions[links] + along[..., None] * (positions[ends] - positions[links])
    at_vertex = np.array([len(one.point.support) == 1 for one in found], dtype=bool)
    in_air = lifted[links].all(axis=1)
    crossings = _continued(
        zip(
            map(tuple, lists(plain.cable[links])), (one.point.support for one in found),
            map(tuple, lists(plain.place[links])), vectors((at[:, 0] + at[:, 1]) / 2),
            _between(nodes, links, ends),
            flags(lifted[links[:, 1]] & (lifted[ends[:, 1]] | at_vertex)),
            flags(at_vertex & ~in_air), strict=True,
        ),
        zip(known, places, _has_point(known, before.crossing[shared]), strict=True), clamped,
    )  # fmt: skip
    separated = np.array([one.separated for one in crossings], dtype=bool)
    numbers = _common_points(crossings, np.flatnonzero(at_vertex & in_air), len(found))
    shares = (~separated & (in_air | ~at_vertex))[:, None] & _first_of(numbers, links)
    # a fold point on an edge along which another cable runs is the crossing's point
    on_edge = np.array([len(one.support) == 2 for one in crossings], dtype=bool)[:, None]
    fold = shares & on_edge & (plain.kind[links] != VERTEX)
    rows = plain.rows.copy()
    rows["crossing"][links[fold]] = numbers[fold]
    for row in ints(np.unique(links[fold])):
        nodes[row] = replace(nodes[row], crossing=int(rows["crossing"][row]))
    after: Integers = links[shares & ~fold]
    number: Integers = numbers[shares & ~fold]
    share = np.append(np.full(len(rows), -1.0), along[shares & ~fold])
    order = np.lexsort((share, np.append(np.arange(len(rows)), after)))

    def joined(old: npt.NDArray[Any], of_crossings: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.concatenate([old, of_crossings[number]])[order]

    own_nodes = [CableNode("crossing", one.point, n) for n, one in enumerate(found)]
    new = np.empty(len(found), dtype=object)
    new[:] = own_nodes
    new_rows = node_rows([own_nodes])
    where = np.array([one.place for one in crossings]).reshape(-1, 3)
    nodes, positions, rows = joined(nodes, new), joined(positions, where), joined(rows, new_rows)
    fractions = joined(fractions, np.full(len(new), np.nan))
    lifted = joined(lifted, np.zeros(len(new), dtype=bool))
    counts = np.diff(plain.starts) + np.bincount(plain.cable[after], minlength=len(cables))
    starts = pointers(counts)
    for c in {*ints(before.cable[shared]), *ints(plain.cable[links[shares]])}:
        own, old = slice(*starts[c : c + 2]), slice(*before.starts[c : c + 2])
        state = cables[c].state
        cables[c].set_nodes(list(nodes[own]), positions[own], fractions[own], lifted[own])
        alike = (np.array_equal(rows[a][own], before.rows[a][old]) for a in ("kind", "support"))
        if all(alike):  # keep what the last solve has found of the points
            cables[c].update(reference_positions=state.reference_positions)
    on = strip.simplices, joined(meetings.on, strip.simplices.find(new_rows["support"]))
    of_cables = [cable.state.nodes for cable in cables]
    return tuple(crossings), NodeTable(of_cables, rows, before.taut_cables, lifted, on)


def _common_points(crossings: Sequence[Crossing], at_vertices: Integers, count: int) -> Integers:
    """Numbers (m, 2) of the crossings that give both cables of each their point: its own, but for
    cables that are clamped together above a vertex, which all share one."""
    numbers, first = np.arange(count), dict[Support, int]()
    for n in ints(at_vertices):
        if crossings[n].clamped:
            numbers[n] = first.setdefault(crossings[n].support, n)
    return np.repeat(numbers[:, None], 2, axis=1)


def _first_of(numbers: Integers, links: Integers) -> Booleans:
    """Whether each link (m, 2) is the first of its points, given by their numbers (m, 2)."""
    found = np.zeros(links.size, dtype=bool)
    pairs = np.stack([numbers.ravel(), links.ravel()], axis=1)
    found[np.unique(pairs, axis=0, return_index=True)[1]] = True
    return found.reshape(links.shape)


def _has_point(known: Sequence[Crossing], shared: Integers) -> list[bool]:
    """Whether the place of each crossing is of use: not at vertices, unless it has a free point, as
    those numbered `shared`."""
    free = set(ints(shared))
    return [len(one.support) != 1 or number in free for number, one in enumerate(known)]


def _continued(
    found: Iterable[tuple[Any, ...]],
    known: Iterable[tuple[Crossing, Array, bool]],
    clamped: Set[tuple[int, ...]],
) -> list[Crossing]:
    """Crossings, continuing the nearest known ones of the same cables at their given places, where
    these are of use, or new. `found`: both cables, support, links, place, between, whether
    separated, and whether that is certain."""
    left: dict[tuple[int, int], list[tuple[Crossing, Array, bool]]] = defaultdict(list)
    for one in known:
        left[one[0].lower, one[0].upper].append(one)
    crossings = []
    for (lower, upper), support, links, place, between, separated, certain in found:
        before, joined = left[lower, upper], (*sorted((lower, upper)), *support) in clamped
        if before:
            away = [float(np.linalg.norm(at - place)) for _, at, _ in before]
            old, at, placed = before.pop(away.index(min(away)))
            separated = separated if certain else old.separated
            # with other neighbouring edges the old place would pull these aside
            place = at if old.between == between and placed else place
        separated &= certain or not joined
        crossings.append(Crossing(lower, upper, support, links, place, between, separated, joined))
    return crossings


def _without_crossings(
    table: NodeTable, kept: Booleans, simplices: Simplices
) -> tuple[NodeTable, npt.NDArray[np.object_]]:
    """Table of the `kept` nodes without references to crossings, and these nodes."""
    every = np.empty(len(kept), dtype=object)
    every[:] = list(chain.from_iterable(table.nodes))
    nodes, rows = every[kept], table.rows[kept]
    for row in ints(np.flatnonzero(rows["crossing"] >= 0)):
        nodes[row] = CableNode(nodes[row].kind, nodes[row].point)
    rows["crossing"] = -1
    starts = pointers(np.bincount(table.cable[kept], minlength=len(table.nodes)))
    parts = [list(nodes[a:b]) for a, b in pairwise(ints(starts))]
    on = simplices, table.on(simplices)[kept]
    plain = NodeTable(parts, rows, table.taut_cables, table.lifted[kept], on)
    return plain, nodes


def _lower_first(
    found: Sequence[_Meeting], nodes: NodeTable, cables: Sequence[LaidCable]
) -> tuple[Integers, Integers, Array]:
    """First and last nodes (m, 2) of meeting links, the lower cable's first; fractions (m, 2)."""
    links = np.array([one[:2] for one in found], dtype=np.int64).reshape(-1, 2)
    along = np.array([one.along for one in found], dtype=float).reshape(-1, 2)
    cable = nodes.cable[links]
    layer = np.array([own.layer for own in cables], dtype=np.int64)[cable]
    turned = (layer[:, 0] > layer[:, 1]) | (
        (layer[:, 0] == layer[:, 1]) & (cable[:, 0] > cable[:, 1])
    )
    links[turned], along[turned] = links[turned, ::-1], along[turned, ::-1]
    return links, np.minimum(links + 1, nodes.starts[nodes.cable[links] + 1] - 1), along


def _between(
    nodes: npt.NDArray[np.object_], links: Integers, ends: Integers
) -> list[tuple[Support, ...]]:
    """Supports of the ends of crossing links, the lower one's first."""
    rows = np.stack([links, ends], axis=2).ravel()
    supports = [() if node.point is None else node.point.support for node in nodes[rows]]
    return [tuple(supports[n : n + 4]) for n in range(0, len(supports), 4)]


def tangled(crossings: Sequence[Crossing]) -> set[int]:
    """Numbers of upper cables that cross a lower one back and forth, without those at vertices."""
    times = Counter((one.lower, one.upper) for one in crossings if len(one.support) > 1)
    return {upper for (_, upper), crossed in times.items() if crossed > 1}


def at_nodes(crossings: Sequence[Crossing], cable: LaidCable) -> tuple[Crossing, ...]:
    """Crossings moved to a cable's nodes, before its nodes are replaced."""
    found = list(crossings)
    for k, node in enumerate(cable.state.nodes):
        if node.crossing is not None:
            place = cable.state.positions[k].copy()
            found[node.crossing] = replace(found[node.crossing], place=place)
    return tuple(found)
