"""Trial configurations at crossings, accepted if they lower the energy.

Two cables that press each other into the membrane have several nearby minima of energy, in which no
vertex holds a cable: a cable passes a vertex on one side or the other; two cables cross an edge
beside their crossing at one point or at two; and a contact beside a span is closed, as the cable
has folded the membrane there, or open. The load path picks one; the energies tell the equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from crms_fenicsx.cabling.contact.active_set import ContactKey
from crms_fenicsx.cabling.contact.free_spans import Gap
from crms_fenicsx.cabling.contact.lift_off import Polylines, captured, lift, may_lift, touch
from crms_fenicsx.cabling.paths.held_vertices import VertexRun
from crms_fenicsx.cabling.paths.path_change import PathChange, leaves_cells
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths, WayKey
from crms_fenicsx.cabling.paths.vertex_trials import pass_run
from crms_fenicsx.foundation.surface.points import Edge
from crms_fenicsx.model.cable_state import Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, TOL


@dataclass(frozen=True)
class Way:
    """An alternative configuration of some cables."""

    cable: int  # one of them, by number
    key: WayKey  # identifies it while the cable does not move
    take: Callable[[], bool]  # moves the cables; returns whether that is possible


class CrossingTrials:
    """Trials of one load step."""

    def __init__(self, change: PathChange, tried: TriedPaths) -> None:
        self.change, self.tried, self.net = change, tried, change.net
        self._left = BUDGET.crossing_trials
        self._last: tuple[str, WayKey]  # trial to accept or to reject
        self._excess: dict[tuple[str, WayKey], float] = {}  # of rejected trials (force x length)
        self._contacts = set(tried.released), set(tried.settled)

    def next(self) -> bool:
        """Move cables to an untried configuration; return whether there is one. Collective."""
        ways: list[Way] = []
        if 0 < len(self._crossings) <= BUDGET.crossings:
            ways = [*self._exchanges(), *self._sides(), *self._open(), *self._closed()]
        self._contacts = set(self.tried.released), set(self.tried.settled)
        for way in ways:
            known = self.tried.ways.setdefault(self.net.cables[way.cable].name, set())
            if way.key not in known:
                known.add(way.key)  # also beyond the limit: repeating the load starts no others
                if self._left > 0 and way.take():
                    self._left -= 1
                    self._last = self.net.cables[way.cable].name, way.key
                    return True
        return False

    def accept(self, gain: float) -> None:
        """Accept a trial, perhaps another's, that lowers the energy by `gain` (force x length). Of
        those before, only the ones whose energy was too high by less may be worth another try."""
        self._excess = {way: excess - gain for way, excess in self._excess.items() if excess > gain}
        for name in self.tried.ways:
            self.tried.ways[name] = {key for one, key in self._excess if one == name}

    def reject(self, excess: float) -> None:
        """Reject the trial, whose energy is too high by `excess` (force x length), and restore the
        contact history before it."""
        self._excess[self._last] = excess
        tried = self.tried
        for now, before in zip((tried.released, tried.settled), self._contacts, strict=True):
            now.clear()
            now |= before

    @property
    def _crossings(self) -> list[Crossing]:
        """All crossings but those at vertices, which sliding cables leave by themselves."""
        return [one for one in self.net.crossings if len(one.support) > 1]

    def _crossed(self) -> list[int]:
        """Numbers of freely sliding cables that cross others."""
        members = {c for one in self._crossings for c in (one.lower, one.upper)}
        cables = self.net.cables
        return [c for c in sorted(members) if cables[c].taut and leaves_cells(cables[c])]

    def _sides(self) -> Iterator[Way]:
        """Vertices passed on the other side, the nearest first."""
        found = []
        for c in self._crossed():
            cable = self.net.cables[c]
            fractions = np.where(cable.state.lifted, np.nan, cable.state.fractions)
            away = np.minimum(fractions, 1 - fractions)
            nearest: dict[int, float] = {}
            for k in np.flatnonzero(away < TOL.beside_vertex):
                if cable.state.nodes[k].slides:
                    vertex = cable.state.nodes[k].support[int(fractions[k] > 0.5)]
                    nearest[vertex] = min(nearest.get(vertex, TOL.beside_vertex), float(away[k]))
            found += [(near, c, vertex) for vertex, near in nearest.items()]
        for _, c, vertex in sorted(found):
            yield Way(c, ("side", "", (vertex,), False), partial(self._pass, c, vertex))

    def _pass(self, c: int, vertex: int) -> bool:
        """Move a cable past a vertex; there is no way past on the side where it already is."""
        runs = (VertexRun((vertex,), to_left, 0.0) for to_left in (True, False))
        return any(pass_run(self.change, c, run) for run in runs)

    def _exchanges(self) -> Iterator[Way]:
        """Shared edges beside a crossing, both points swapped, which moves it over the edge."""
        for crossing, edge, nodes in self._shared_edges():
            first, second = (float(cable.state.fractions[k]) for cable, k in nodes)
            apart = TOL.beyond / 2 if first > second else -TOL.beyond / 2
            middle = (first + second) / 2
            take = partial(self._put, nodes, edge, (middle - apart, middle + apart))
            yield Way(crossing.lower, ("exchange", nodes[1][0].name, edge, first > second), take)

    def _shared_edges(self) -> Iterator[tuple[Crossing, Edge, list[tuple[LaidCable, int]]]]:
        """Edges next to crossings that both cables cross, with both nodes."""
        for crossing in self._crossings:
            pair = [self.net.cables[c] for c in (crossing.lower, crossing.upper)]
            if crossing.separated or not all(c.taut and leaves_cells(c) for c in pair):
                continue
            lower, upper = crossing.between[:2], crossing.between[2:]
            for edge in ((e[0], e[1]) for e in lower if len(e) == 2 and e in upper):
                at = [_node_on(cable, edge) for cable in pair]
                nodes = [(cable, k) for cable, k in zip(pair, at, strict=True) if k is not None]
                if len(nodes) == 2:
                    yield crossing, edge, nodes

    def _put(
        self, nodes: Sequence[tuple[LaidCable, int]], edge: Edge, places: Sequence[float]
    ) -> bool:
        """Move nodes along their edge, to fractions."""
        surface = self.change.surface(edge)
        for (cable, k), fraction in zip(nodes, places, strict=True):
            positions, fractions = cable.state.positions.copy(), cable.state.fractions.copy()
            positions[k], fractions[k] = surface.place(edge, fraction), fraction
            cable.update(positions=positions, fractions=fractions)
        return True

    def _open(self) -> Iterator[Way]:
        """Contacts beside spans, opened, those of least pressure first."""
        shape = self.net.strip_shape()
        found = []
        for c in self._crossed():
            cable = self.net.cables[c]
            off = cable.state.lifted
            on = [k for k in may_lift(cable) if not off[k] and (off[k - 1] or off[k + 1])]
            if on and cable.lifts_off:
                around = shape.normals_and_sizes([cable.state.nodes[k].support for k in on])
                presses = -Polylines.of([cable]).pulls(np.array(on), *around)
                found += [(press, c, k) for press, k in zip(presses, on, strict=True)]
        for press, c, k in sorted(found):
            cable = self.net.cables[c]
            if press < TOL.light_turn:
                key = cable.name, cable.state.nodes[k].support
                yield Way(c, ("open", *key, False), partial(self._lift, cable, k, key))

    def _lift(self, cable: LaidCable, k: int, key: ContactKey) -> bool:
        lift(cable, [k])
        self.tried.released.add(key)
        return True

    def _closed(self) -> Iterator[Way]:
        """Contacts at ends of spans, closed, the lowest above the membrane first."""
        shape = self.net.strip_shape()
        found = []
        for c in self._crossed():
            cable = self.net.cables[c]
            off = cable.state.lifted
            if not off.any():
                continue
            for k, gap in captured(cable, shape, TOL.reach).items():
                if not (off[k - 1] and off[k + 1]):
                    found.append((gap.gap, c, k, gap))
        for _, c, k, gap in sorted(found, key=lambda one: one[:3]):
            cable = self.net.cables[c]
            key = cable.name, cable.state.nodes[k].support
            yield Way(c, ("closed", *key, False), partial(self._touch, cable, {k: gap}, key))

    def _touch(self, cable: LaidCable, places: Mapping[int, Gap], key: ContactKey) -> bool:
        touch(cable, places)
        self.tried.released.discard(key)
        return True


def _node_on(cable: LaidCable, edge: Edge) -> int | None:
    """The only sliding contact of a cable on an edge; None if there is not exactly one."""
    at = [k for k, node in enumerate(cable.state.nodes) if node.slides and node.support == edge]
    return at[0] if len(at) == 1 and not cable.state.lifted[at[0]] else None
