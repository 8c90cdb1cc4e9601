"""What is active in one solve: cables in tension, contacts, crossings.

All this is decided from a solved state, and the solve repeated until nothing changes. Everything
may change back and forth only a few times in a solve, so that it ends.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.cables.points_on_edges import bends, nodes_on_edges
from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.contact import lift_off as contact
from crms_fenicsx.contact.lift_off import DEPTH, PULL, apparent_crossing, link_at, outward_pulls
from crms_fenicsx.model.cable_state import Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.surface.points import Edge, EdgePoint, Support, VertexPoint


def parting(
    crossings: Sequence[Crossing], cables: Sequence[LaidCable], shape: StripShape
) -> list[int]:
    """Numbers of the crossings at which the upper cable pulls the lower one up."""
    by_upper: dict[int, list[int]] = defaultdict(list)
    for number, crossing in enumerate(crossings):
        if not crossing.separated and crossing.clamp is None:
            by_upper[crossing.upper].append(number)
    found = []
    for c, own in by_upper.items():
        upper = cables[c]
        at = {node.crossing: k for k, node in enumerate(upper.nodes)}
        nodes = [at[number] for number in own]
        on = [n for n, k in enumerate(nodes) if not upper.lifted[k]]
        supports = [crossings[own[n]].support for n in on]
        pulls = outward_pulls(upper, [nodes[n] for n in on], *shape.normals_and_sizes(supports))
        found += [own[n] for n, pull in zip(on, pulls, strict=True) if pull > PULL]
    return found


def joins(crossing: Crossing, cables: Sequence[LaidCable], shape: StripShape) -> bool:
    """Whether two cables that have parted would run through each other."""
    if not crossing.separated:
        return False
    normal = shape.normal(crossing.support)
    (a, b), (c, d) = (
        link_at(cables[number], k)
        for number, k in zip((crossing.lower, crossing.upper), crossing.links, strict=True)
    )
    s, t = (min(max(x, 0.0), 1.0) for x in apparent_crossing(a, b, c, d, normal))
    gap = float((c + t * (d - c) - a - s * (b - a)) @ normal)
    return gap < -DEPTH * float(np.linalg.norm(b - a))


ContactKey = tuple[str, Support] | tuple[str, str]
"""A cable and its place on the mesh, or the upper and the lower one of two cables that cross."""

MAX_SWITCHES = 6
"""How often each cable may turn from slack to taut or back in one solve."""


class ContactMemory(Protocol):
    """What is known of the contacts in the last load step."""

    # released, settled: where contacts have been released, and where they then stay closed however
    # the cable pulls
    released: set[ContactKey]
    settled: set[ContactKey]

    def has_rested(self, cable: LaidCable) -> bool:
        """Return whether a cable is as the last load step has found it."""


class ActiveSet:
    """Decides what is active in one solve."""

    def __init__(self, net: CableNet, memory: ContactMemory | None) -> None:
        self.net, self._memory = net, memory
        self._switches: Counter[str] = Counter()
        self._tried: set[str] = set()
        """Cables that have been tried in tension."""
        self._first_look = True
        self._released, self._settled = (
            (set(), set()) if memory is None else (memory.released, memory.settled)
        )

    def tighten(self) -> list[str]:
        """Switch cables between slack and taut for their current lengths; say which. Collective."""
        shape = self.net.strip_shape()
        return [text for cable in self.net.cables for text in self._switch(cable, shape, False)]

    def update(self) -> list[str]:
        """Switch what a solved state asks for; say what, in words. Collective."""
        if self._first_look:
            self._forget()
        net, shape = self.net, self.net.strip_shape()
        changes = [text for cable in net.cables for text in self._switch(cable, shape, True)]
        if not changes:
            tops, on_edges = self._tops(), nodes_on_edges(net.cables, self._edges_under_spans())
            for c, cable in enumerate(net.cables):
                if cable.taut and not cable.sleeve:
                    covered = {v for v, top in tops.items() if top > (cable.layer, c)}
                    changes += self._contacts(cable, shape, covered, on_edges)
        if not changes and net.crossings:
            changes = self._crossings(shape)
        return changes

    def _forget(self) -> None:
        """Forget where cables were let go and touched, but not those that have not moved since.
        What has settled in the state that is there would settle again."""
        self._first_look = False
        moved = {cable.name for cable in self.net.cables if not self._rested(cable)}
        for keys in (self._released, self._settled):
            keys -= {key for key in keys if not moved.isdisjoint(key)}

    def _rested(self, cable: LaidCable) -> bool:
        """Whether a cable is as the last load step has found it."""
        return self._memory is not None and self._memory.has_rested(cable)

    def restless(self) -> str:
        """A cable that keeps turning from slack to taut and back; empty if there is none."""
        return next((name for name, n in self._switches.items() if n > MAX_SWITCHES), "")

    def _switch(self, cable: LaidCable, shape: StripShape, solved: bool) -> list[str]:
        """Tighten a slack cable that has become too short for its path, slacken another.

        Near the limit a cable is in equilibrium both slack, on flat cells, and in tension, on cells
        that it has folded and that bulge. It is in tension if it is nearly tight on flat cells and
        stays so on folded ones, which is tried once in each solve. One that is in tension, but on
        flat cells would be slack, is let go first, so that the way there does not matter;
        not with axial friction, where the way does.
        """
        if cable.cable.law == "step":
            return []
        if not cable.taut and not cable.sleeve:
            contact.drape(cable, shape)
        untried = cable.name not in self._tried and not self._rested(cable)
        judged = solved and cable.taut
        taut = tight = cable.is_tight(nearly=untried and not judged)
        if judged and tight and untried and cable.slides_freely and not cable.is_divided:
            taut = contact.flat_length(cable, shape) > cable.L0
        if taut == cable.taut:
            return []
        if taut or not tight:
            self._tried.add(cable.name)
        # One that slackens gets its folds back from the straight way.
        cable.update(taut=taut, path_is_geodesic=taut and cable.path_is_geodesic)
        self._switches[cable.name] += 1
        return [f"{cable.name} {'tightens' if taut else 'slackens'}"]

    def _contacts(
        self,
        cable: LaidCable,
        shape: StripShape,
        covered: set[int],
        on_edges: Mapping[Edge, Sequence[tuple[int, int]]],
    ) -> list[str]:
        def key(k: int) -> ContactKey:
            return cable.name, cable.nodes[k].support

        released = contact.released(cable, shape, covered)
        free = [k for k in released if key(k) not in self._settled]
        places = {}
        if cable.lifted.any():
            near = {edge: on_edges[edge] for edge in _edges_under(cable) if edge in on_edges}
            folds = bends(self.net.cables, near, but=cable)
            places = contact.captured(cable, shape, folds)
            unclear = cable.slides_freely and not self._rested(cable)
            if unclear and not free and not places:
                nearly = contact.captured(cable, shape, folds, contact.NEARLY)
                places = {k: place for k, place in nearly.items() if key(k) not in self._released}
        if free:
            contact.lift(cable, free)
        if places:
            contact.touch(cable, places)
        self._settled |= {key(k) for k in places} & self._released
        self._released |= {key(k) for k in free}
        texts = [f"{cable.name} lifts off at {cable.nodes[k].point}" for k in free]
        return texts + [f"{cable.name} touches down at {cable.nodes[k].point}" for k in places]

    def _edges_under_spans(self) -> set[Edge]:
        """Edges at which cables in tension are lifted off."""
        return {e for cable in self.net.cables if cable.taut for e in _edges_under(cable)}

    def _tops(self) -> dict[int, tuple[int, int]]:
        """The uppermost cable in tension on each vertex that one touches: its layer and number."""
        tops: dict[int, tuple[int, int]] = {}
        for c, cable in enumerate(self.net.cables):
            for k in cable.contacts() if cable.taut else []:
                point = cable.nodes[k].point
                if isinstance(point, VertexPoint):
                    order = (cable.layer, c)
                    tops[point.vertex] = max(order, tops.get(point.vertex, order))
        return tops

    def _crossings(self, shape: StripShape) -> list[str]:
        changes = []
        net = self.net
        pulled = parting(net.crossings, net.cables, shape)
        crossings = list(net.crossings)
        for number, crossing in enumerate(net.crossings):
            names = net.cables[crossing.upper].name, net.cables[crossing.lower].name
            # Not by place: a crossing may come back in another cell than that where it was left.
            if number in pulled and names not in self._settled:
                crossings[number] = replace(crossing, separated=True)
                self._released.add(names)
                changes.append("{} lifts off {}".format(*names))
            elif joins(crossing, net.cables, shape):
                crossings[number] = replace(crossing, separated=False)
                if names in self._released:
                    self._settled.add(names)
                changes.append("{} touches {}".format(*names))
        net.crossings = tuple(crossings)
        return changes


def _edges_under(cable: LaidCable) -> list[Edge]:
    """Edges over which a cable is lifted off, in order."""
    points = (cable.nodes[k].point for k in np.flatnonzero(cable.lifted))
    return [point.edge for point in points if isinstance(point, EdgePoint)]
