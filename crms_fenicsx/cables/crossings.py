"""Crossing cables: where they cross, found from their paths alone.

Two cables that cross inside a cell share one free point there; without it the folds of one would
cut through the other. Which cells those are follows from the order of the cables' points around
each cell, and so it changes by itself as paths and fold points move: a crossing that slides over
an edge is found in the next cell, one that slides off is gone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.crossing import Crossing, NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import CellPoint, Edge, EdgePoint

TANGLED = 8
"""Two crossings of the same cables with fewer cells than this between them are no way for taut
cables to lie."""


class _Meeting(NamedTuple):
    """Two links that cross: their first nodes, how far along each, and the place in the cell."""

    first: NodeId
    second: NodeId
    along: tuple[float, float]
    point: CellPoint | EdgePoint


def arrange(
    cables: Sequence[LaidCable], strip: Strip, known: Sequence[Crossing]
) -> tuple[Crossing, ...]:
    """Find the crossings of the cables in tension, and insert their points into the cables.

    What the last solve has found of a cable's points stays where these are as before.

    Parameters
    ----------
    cables
        All cables; their nodes are replaced where crossings come or go.
    strip
        Cells around them.
    known
        The crossings before: which of them are separated is kept.
    """
    before = [(_points(cable), cable.reference_positions, cable.blocked) for cable in cables]
    for cable in cables:
        known = _remove_crossings(cable, known)
    meetings = _meetings(cables, strip)
    inserted: dict[NodeId, list[tuple[float, CableNode, Array]]] = defaultdict(list)
    left = list(known)
    crossings: list[Crossing] = []
    for first, second, along, point in sorted(meetings, key=lambda m: (m.first, m.along[0])):
        links = [_link(cables, member) for member in (first, second)]
        places = [a + t * (b - a) for (a, b), t in zip(links, along, strict=True)]
        (lower, t_lower), (upper, t_upper) = sorted(
            zip((first, second), along, strict=True), key=lambda side: _order(cables, side[0][0])
        )
        between = tuple(
            () if node.point is None else node.support
            for c, k in (lower, upper)
            for node in cables[c].nodes[k : k + 2]
        )
        numbers = (lower[1], upper[1])
        place = np.mean(places, axis=0)
        crossing = Crossing(lower[0], upper[0], point.support, numbers, place, between)
        crossing, number = _inherited(crossing, left, cables), len(crossings)
        crossings.append(crossing)
        if crossing.separated:
            continue
        node = CableNode("crossing", point, number)
        for member, t in ((lower, t_lower), (upper, t_upper)):
            if not _is_fold_point(cables, member, number, point):
                inserted[member].append((t, node, crossing.place))
    for c, cable in enumerate(cables):
        _insert(cable, {k: new for (d, k), new in inserted.items() if d == c})
        points, reference_positions, blocked = before[c]
        if _points(cable) == points:
            cable.update(reference_positions=reference_positions, blocked=blocked)
    return tuple(crossings)


def _points(cable: LaidCable) -> list[tuple[str, tuple[int, ...]]]:
    """What a cable's nodes are, and the vertices that they lie on or between."""
    return [(node.kind, () if node.point is None else node.point.support) for node in cable.nodes]


def tangled(crossings: Sequence[Crossing]) -> set[int]:
    """Numbers of upper cables that cross a lower one to and fro within a few cells."""
    found = set()
    for a, b in combinations(crossings, 2):
        if (a.lower, a.upper) == (b.lower, b.upper):
            if max(abs(i - j) for i, j in zip(a.links, b.links, strict=True)) <= TANGLED:
                found.add(a.upper)
    return found


def _order(cables: Sequence[LaidCable], c: int) -> tuple[int, int]:
    return cables[c].layer, c


def _link(cables: Sequence[LaidCable], member: NodeId) -> tuple[Array, Array]:
    c, k = member
    return cables[c].positions[k], cables[c].positions[min(k + 1, len(cables[c].nodes) - 1)]


def _inherited(crossing: Crossing, left: list[Crossing], cables: Sequence[LaidCable]) -> Crossing:
    """Go on from the nearest known crossing of these cables; a new one starts as they lie.

    It stays where it was if they cross the same edges before and after it: else it would draw them
    aside.
    """
    same = [k for k in left if (k.lower, k.upper) == (crossing.lower, crossing.upper)]
    if not same:
        upper, k = cables[crossing.upper], crossing.links[1]
        return replace(crossing, separated=all(upper.lifted[k : k + 2]))
    old = min(same, key=lambda k: float(np.linalg.norm(k.place - crossing.place)))
    left.remove(old)
    place = old.place if old.between == crossing.between else crossing.place
    return replace(crossing, separated=old.separated, place=place)


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
        [CableNode(node.kind, node.point) for node in nodes],
        cable.positions[keep], cable.fractions[keep], cable.lifted[keep],
    )  # fmt: skip
    return known


def _insert(cable: LaidCable, new: dict[int, list[tuple[float, CableNode, Array]]]) -> None:
    if not new:
        return
    nodes: list[CableNode] = []
    positions, fractions, lifted = [], [], []
    for k, node in enumerate(cable.nodes):
        nodes.append(node)
        positions.append(cable.positions[k])
        fractions.append(float(cable.fractions[k]))
        lifted.append(bool(cable.lifted[k]))
        for _, shared, place in sorted(new.get(k, []), key=lambda entry: entry[0]):
            nodes.append(shared)
            positions.append(place)
            fractions.append(np.nan)
            lifted.append(False)
    cable.set_nodes(nodes, np.array(positions), np.array(fractions), np.array(lifted))


def _meetings(cables: Sequence[LaidCable], strip: Strip) -> list[_Meeting]:
    """Where the paths of cables in tension cross, lifted parts by the cells under them."""
    on_edge: dict[Edge, list[tuple[float, int, int]]] = defaultdict(list)
    chords: dict[int, list[NodeId]] = defaultdict(list)
    followed: dict[Edge, list[NodeId]] = defaultdict(list)
    for c, cable in enumerate(cables):
        if not cable.taut:
            continue
        for k, node in enumerate(cable.nodes):
            if isinstance(node.point, EdgePoint):
                on_edge[node.point.edge].append((float(cable.fractions[k]), c, k))
        for k, (a, b) in enumerate(pairwise(cable.nodes)):
            if a.point is None or b.point is None:
                continue
            both = tuple(sorted({*a.point.support, *b.point.support}))
            if len(both) == 2:
                followed[both[0], both[1]].append((c, k))
            else:
                chords[strip.rows(both)[0]].append((c, k))
    found = []
    for edge, links in followed.items():
        for fraction, c, k in on_edge.get(edge, []):
            for link in links:
                if link[0] != c:
                    ascending = cables[link[0]].nodes[link[1]].point.support == (edge[0],)  # type: ignore[union-attr]
                    along = fraction if ascending else 1 - fraction
                    found.append(_Meeting(link, (c, k), (along, 0.0), EdgePoint(edge, fraction)))
    for row, members in chords.items():
        if len({c for c, _ in members}) > 1:
            cell = [int(vertex) for vertex in strip.cells[row]]
            found += _meetings_in_cell(cables, cell, members, on_edge)
    return found


def _meetings_in_cell(
    cables: Sequence[LaidCable],
    cell: list[int],
    chords: Sequence[NodeId],
    on_edge: dict[Edge, list[tuple[float, int, int]]],
) -> list[_Meeting]:
    """Chords of one cell that cross: their ends alternate around it."""
    around: dict[NodeId | int, int] = {}  # places on the rim, of corners and of points
    for i, j in ((cell[0], cell[1]), (cell[1], cell[2]), (cell[2], cell[0])):
        around[i] = len(around)
        line = sorted(on_edge.get((min(i, j), max(i, j)), []))
        for _, c, k in line if i < j else line[::-1]:
            around[c, k] = len(around)

    def rim(member: NodeId) -> int | None:
        node = cables[member[0]].nodes[member[1]]
        assert node.point is not None
        return around.get(node.point.support[0] if node.kind == "vertex" else member)

    def flat(member: NodeId) -> Array:
        """Barycentric weights."""
        ids, weights = cables[member[0]].interpolation(member[1])
        share = dict(zip(ids, weights, strict=True))
        return np.array([share.get(vertex, 0.0) for vertex in cell])

    found = []
    for first, second in combinations(chords, 2):
        if first[0] == second[0]:
            continue
        ends = [(c, k + i) for c, k in (first, second) for i in (0, 1)]
        places = [rim(member) for member in ends]
        t = _intersection(*(flat(member) for member in ends))
        on_rim = [place for place in places if place is not None]
        if len(on_rim) < 4:  # an end of a cable inside the cell
            crosses = 0.0 < t[0] < 1.0 and 0.0 < t[1] < 1.0
        else:
            low, high = sorted(on_rim[:2])
            between = [low < place < high for place in on_rim[2:]]
            crosses = len(set(on_rim)) == 4 and between[0] != between[1]
        if crosses:
            t = (min(max(t[0], 0.0), 1.0), min(max(t[1], 0.0), 1.0))
            start, end = flat(ends[0]), flat(ends[1])
            weights: Array = np.maximum(start + t[0] * (end - start), 0.0)
            u, v, w = (float(x) for x in weights / weights.sum())
            point = CellPoint((cell[0], cell[1], cell[2]), (u, v, w))
            found.append(_Meeting(first, second, t, point))
    return found


def _intersection(a: Array, b: Array, p: Array, q: Array) -> tuple[float, float]:
    """Where lines ab and pq, in barycentric weights, cross: their parameters."""
    u, v, w = (b - a)[:2], (q - p)[:2], (p - a)[:2]
    cross = u[0] * v[1] - u[1] * v[0]
    if cross == 0.0:
        return 0.5, 0.5
    return float((w[0] * v[1] - w[1] * v[0]) / cross), float((w[0] * u[1] - w[1] * u[0]) / cross)
