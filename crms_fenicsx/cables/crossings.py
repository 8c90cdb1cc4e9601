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
from itertools import combinations

import numpy as np

from crms_fenicsx.cables.meetings import Meetings
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.crossing import Crossing, NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import CellPoint, EdgePoint

TANGLED = 8
"""Two crossings of the same cables with fewer cells than this between them are no way for taut
cables to lie."""


def arrange(
    cables: Sequence[LaidCable], strip: Strip, known: Sequence[Crossing]
) -> tuple[Crossing, ...]:
    """Find the crossings of the cables in tension, and insert their points into the cables.

    What the last solve has found of a cable's points stays where these are as before.
    """
    before = [cable.state for cable in cables]
    for cable in cables:
        known = _remove_crossings(cable, known)
    meetings = Meetings(cables, strip).find()
    inserted: list[dict[int, list[tuple[float, CableNode, Array]]]]
    inserted = [defaultdict(list) for _ in cables]
    left: dict[tuple[int, int], list[Crossing]] = defaultdict(list)
    for one in known:
        left[one.lower, one.upper].append(one)
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


def _order(cables: Sequence[LaidCable], c: int) -> tuple[int, int]:
    return cables[c].layer, c


def _link(cables: Sequence[LaidCable], member: NodeId) -> tuple[Array, Array]:
    c, k = member
    return cables[c].positions[k], cables[c].positions[min(k + 1, len(cables[c].nodes) - 1)]


def _inherited(crossing: Crossing, left: list[Crossing], cables: Sequence[LaidCable]) -> Crossing:
    """Go on from the nearest one left of these cables' crossings; a new one starts as they lie.

    It stays where it was if they cross the same edges before and after it: else it would draw them
    aside.
    """
    if not left:
        upper, k = cables[crossing.upper], crossing.links[1]
        return replace(crossing, separated=all(upper.lifted[k : k + 2]))
    away = [float(np.linalg.norm(k.place - crossing.place)) for k in left]
    old = left.pop(away.index(min(away)))
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
