"""Other ways of crossing cables are tried one by one, and taken where that lowers the energy.

Two cables that press each other into the membrane have several minima of the energy nearby, in
which no vertex holds a cable: a cable slides past a vertex on the one side or on the other, two
cables cross an edge beside their crossing at one point or at two, and a contact beside a span is
closed, as the cable has folded the membrane there, or open. Which of them is found depends on the
order of the loads. Their energies tell which one is the equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.contact.active_set import ContactKey
from crms_fenicsx.contact.lift_off import Gap, captured, lift, may_lift, outward_pulls, touch
from crms_fenicsx.model.cable_state import Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BEYOND
from crms_fenicsx.paths.clamp_release import beside_vertices, put_onto
from crms_fenicsx.paths.held_vertices import VertexRun
from crms_fenicsx.paths.path_change import PathChange
from crms_fenicsx.paths.tried_paths import TriedPaths, WayKey
from crms_fenicsx.paths.vertex_passing import pass_run
from crms_fenicsx.surface.points import Edge

FEW = 4
"""Crossings up to which other ways are tried. Nets have some at each crossing, and each of them
changes the energy by a small part of what the mesh errs by."""

MOST = 12
"""How many ways are tried in one load step."""

NEAR = 0.05
"""Part of an edge within which a cable that slides past a vertex may pass it on the other side."""

LOW = 0.125
"""Height above the membrane, relative to the cells' size, up to which a cable may touch it."""

LIGHT = 0.04
"""Turn of the cable (rad) at a contact up to which this may be open as well."""


@dataclass(frozen=True)
class Way:
    """Another way of some cables."""

    cable: int  # one of them, by number
    key: WayKey  # what it is known by while the cable stays where it is
    take: Callable[[], bool]  # moves the cables; says whether they can go there


class CrossingTrials:
    """What is tried in one load step."""

    def __init__(self, change: PathChange, tried: TriedPaths) -> None:
        self.change, self.tried, self.net = change, tried, change.net
        self._left = MOST
        self._contacts = set(tried.released), set(tried.settled)

    def next(self) -> bool:
        """Move cables to a way that has not been tried; say whether there is one. Collective."""
        ways = [*self._clamps()] if self.net.clamps else []
        if 0 < len(self.net.crossings) <= FEW:
            ways += [*self._exchanges(), *self._sides(), *self._open(), *self._closed()]
        self._contacts = set(self.tried.released), set(self.tried.settled)
        for way in ways:
            known = self.tried.ways.setdefault(self.net.cables[way.cable].name, set())
            if self._left > 0 and way.key not in known:
                known.add(way.key)
                if way.take():
                    self._left -= 1
                    return True
        return False

    def accept(self) -> None:
        """Stay on the way: from there the others may lead elsewhere."""
        for known in self.tried.ways.values():
            known.clear()

    def reject(self) -> None:
        """Know of contacts what was known before the way was tried."""
        tried = self.tried
        for now, before in zip((tried.released, tried.settled), self._contacts, strict=True):
            now.clear()
            now |= before

    def _crossed(self) -> list[int]:
        """Numbers of the cables that cross others, and slide freely."""
        members = {c for one in self.net.crossings for c in (one.lower, one.upper)}
        return [c for c in sorted(members) if self._is_free(self.net.cables[c])]

    @staticmethod
    def _is_free(cable: LaidCable) -> bool:
        return cable.taut and cable.slides_freely and not cable.keeps_line

    def _clamps(self) -> Iterator[Way]:
        """Clamps beside vertices onto these."""
        for vertex, cables in beside_vertices(self.change):

            def take(vertex: int = vertex, cables: list[LaidCable] = cables) -> bool:
                return put_onto(self.change, cables, vertex)

            key = ("clamp", cables[1].name, (vertex,), False)
            yield Way(self.net.cables.index(cables[0]), key, take)

    def _sides(self) -> Iterator[Way]:
        """Past vertices on the other side, the nearest first."""
        found = []
        for c in self._crossed():
            cable = self.net.cables[c]
            fractions = np.where(cable.lifted, np.nan, cable.fractions)
            away = np.minimum(fractions, 1 - fractions)
            nearest: dict[int, float] = {}
            for k in np.flatnonzero(away < NEAR):
                if cable.nodes[k].slides:
                    vertex = cable.nodes[k].support[int(fractions[k] > 0.5)]
                    nearest[vertex] = min(nearest.get(vertex, NEAR), float(away[k]))
            found += [(near, c, vertex) for vertex, near in nearest.items()]
        for _, c, vertex in sorted(found):

            def take(c: int = c, vertex: int = vertex) -> bool:
                # On the side where the cable is already there is nothing to change.
                runs = (VertexRun((vertex,), to_left, 0.0, 0.0) for to_left in (True, False))
                return any(pass_run(self.change, c, run) for run in runs)

            yield Way(c, ("side", "", (vertex,), False), take)

    def _exchanges(self) -> Iterator[Way]:
        """Over edges beside a crossing that both cables cross, so that this is beyond the edge."""
        for crossing in self.net.crossings:
            pair = [self.net.cables[c] for c in (crossing.lower, crossing.upper)]
            if crossing.separated or not all(map(self._is_free, pair)):
                continue
            for edge in _shared_edges(crossing):
                at = [_node_on(cable, edge) for cable in pair]
                nodes = [(cable, k) for cable, k in zip(pair, at, strict=True) if k is not None]
                if len(nodes) < 2:
                    continue
                first, second = (float(cable.fractions[k]) for cable, k in nodes)
                apart = BEYOND / 2 if first > second else -BEYOND / 2
                middle = (first + second) / 2

                def take(
                    nodes: list[tuple[LaidCable, int]] = nodes, edge: Edge = edge,
                    places: tuple[float, float] = (middle - apart, middle + apart),
                ) -> bool:  # fmt: skip
                    for (cable, k), place in zip(nodes, places, strict=True):
                        self._put(cable, k, edge, place)
                    return True

                key = ("exchange", pair[1].name, edge, first > second)
                yield Way(crossing.lower, key, take)

    def _put(self, cable: LaidCable, k: int, edge: Edge, fraction: float) -> None:
        """Put a node elsewhere on its edge."""
        positions, fractions = cable.positions.copy(), cable.fractions.copy()
        positions[k] = self.change.surface(edge).place(edge, fraction)
        fractions[k] = fraction
        cable.update(positions=positions, fractions=fractions)

    def _open(self) -> Iterator[Way]:
        """With a contact beside a span let go, those that press least first."""
        shape = self.net.strip_shape()
        found = []
        for c in self._crossed():
            cable = self.net.cables[c]
            off = cable.lifted
            on = [k for k in may_lift(cable) if not off[k] and (off[k - 1] or off[k + 1])]
            if on and cable.lifts_off:
                around = shape.normals_and_sizes([cable.nodes[k].support for k in on])
                presses = -outward_pulls(cable, on, *around)
                found += [(press, c, k) for press, k in zip(presses, on, strict=True)]
        for press, c, k in sorted(found):
            cable = self.net.cables[c]
            key = cable.name, cable.nodes[k].support

            def take(cable: LaidCable = cable, k: int = k, key: ContactKey = key) -> bool:
                lift(cable, [k])
                self.tried.released.add(key)
                return True

            if press < LIGHT:
                yield Way(c, ("open", *key, False), take)

    def _closed(self) -> Iterator[Way]:
        """With a contact more at the end of a span, the lowest above the membrane first."""
        shape = self.net.strip_shape()
        found = []
        for c in self._crossed():
            cable = self.net.cables[c]
            off = cable.lifted
            if not off.any():
                continue
            for k, gap in captured(cable, shape, {}, LOW).items():
                if not (off[k - 1] and off[k + 1]):
                    found.append((gap.gap, c, k, gap))
        for _, c, k, gap in sorted(found, key=lambda one: one[:3]):
            cable = self.net.cables[c]
            key = cable.name, cable.nodes[k].support

            def take(
                cable: LaidCable = cable, k: int = k, gap: Gap = gap, key: ContactKey = key
            ) -> bool:
                touch(cable, {k: gap})
                self.tried.released.discard(key)
                return True

            yield Way(c, ("closed", *key, False), take)


def _shared_edges(crossing: Crossing) -> list[Edge]:
    """Edges that both cables cross next to their crossing."""
    lower, upper = crossing.between[:2], crossing.between[2:]
    return [(e[0], e[1]) for e in lower if len(e) == 2 and e in upper]


def _node_on(cable: LaidCable, edge: Edge) -> int | None:
    """The node with which a cable touches an edge and slides on it, if there is just one."""
    at = [k for k, node in enumerate(cable.nodes) if node.slides and node.support == edge]
    return at[0] if len(at) == 1 and not cable.lifted[at[0]] else None
