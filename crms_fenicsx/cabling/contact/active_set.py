"""Active set of a solve: cables in tension, contacts, crossings.

It is updated from a solved state, and the solve repeated until nothing changes. Each member may
change back and forth only a few times in a solve, so that it terminates.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.crossings import at_crossings, stacks
from crms_fenicsx.cabling.cables.points_on_edges import (
    VERTEX,
    NodeTable,
    fractions_of,
    positions_of,
)
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact import lift_off as contact
from crms_fenicsx.cabling.contact.free_spans import FreeSpans, Gap
from crms_fenicsx.cabling.contact.lift_off import Polylines
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Booleans, Integers, floats, ints
from crms_fenicsx.foundation.surface.lines import gaps
from crms_fenicsx.foundation.surface.points import Support
from crms_fenicsx.model.cable_state import Crossing, NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, TOL, UNSTRAINED


def parting(crossings: Sequence[Crossing], lines: Polylines, shape: StripShape) -> set[int]:
    """Numbers of the crossings where the upper cable pulls the lower one up."""
    nodes = lines.nodes
    at = np.flatnonzero((nodes.crossing >= 0) & ~nodes.lifted)
    upper = np.array([crossing.upper for crossing in crossings], dtype=np.int64)
    free = [not one.separated and not one.clamped for one in crossings]
    together = np.array(free, dtype=bool)
    number = nodes.crossing[at]
    at = at[together[number] & (nodes.cable[at] == upper[number])]
    pulls = lines.pulls(at, *shape.around(nodes.on(shape.strip.simplices)[at]))
    return set(ints(nodes.crossing[at[pulls > TOL.contact]]))


def joining(
    crossings: Sequence[Crossing], lines: Polylines, shape: StripShape, sliding: Booleans
) -> set[int]:
    """Numbers of the separated crossings whose cables would penetrate each other; not at vertices
    of cables that are `sliding` (n,), which leave them."""
    joined = set[int]()
    apart = [
        n for n, one in enumerate(crossings)
        if one.separated and len(one.support) == 1
        and not (sliding[one.lower] or sliding[one.upper])
    ]  # fmt: skip
    if apart:
        found, sizes = lines.gaps(shape, [crossings[n] for n in apart], 2)
        joined = {apart[n] for n in np.flatnonzero(found < -TOL.contact * sizes)}
    apart = [n for n, one in enumerate(crossings) if one.separated and len(one.support) > 1]
    pairs = [(crossings[n].lower, crossings[n].upper) for n in apart]
    cables = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    links = np.array([crossings[n].links for n in apart], dtype=np.int64).reshape(-1, 2)
    lower, upper = (lines.straight_parts(cables[:, k], links[:, k]) for k in (0, 1))
    normals, _ = shape.normals_and_sizes([crossings[n].support for n in apart])
    deep = gaps(lower, upper, normals) < -TOL.contact * norm(lower[:, 1] - lower[:, 0])
    return joined | {apart[n] for n in np.flatnonzero(deep)}


ContactKey = tuple[str, Support] | tuple[str, str]
"""A cable and its place on the mesh, or the upper and lower of two crossing cables."""

ContactHistory = tuple[set[ContactKey], set[ContactKey]]
"""Contacts released, and those that then stay closed however the cable pulls."""


class _ContactMemory(Protocol):
    """Contact history of the last load step."""

    # released, settled: released contacts; those that then stay closed however the cable pulls
    released: set[ContactKey]
    settled: set[ContactKey]

    def has_rested(self, cable: LaidCable) -> bool:
        """Return whether a cable has not moved since the last load step."""


class ActiveSet:
    """Updates the active set in a search for the equilibrium.

    Attributes: `only_lifted`: whether all changes of the last update are cables that lift off.
    """

    def __init__(
        self, net: CableNet, memory: _ContactMemory | None, history: ContactHistory | None = None
    ) -> None:
        """`history`: of this load step, if cables have no memory of the last one."""
        self.net, self._memory = net, memory
        self._switches: Counter[str] = Counter()
        self._tried: set[str] = set()
        """Cables already tried in tension."""
        self._first_look, self.only_lifted = history is None, False
        self._released, self._settled = history or (
            (set(), set()) if memory is None else (memory.released, memory.settled)
        )

    def tighten(self) -> list[str]:
        """Begin a solve on given paths: switch cables between slack and taut for their current
        lengths; return the changes in words. Collective."""
        # Each trial of other paths that is rejected restores taut cables, which may slacken again.
        self._switches.clear()
        return self._switch(self.net.strip_shape(), None)

    def update(self, shape: StripShape) -> list[str]:
        """Update the active set from a solved state and return the changes in words."""
        self.only_lifted = True
        if self._first_look:
            self._forget()
        lines = Polylines(self.net.nodes, positions_of(self.net.cables), ~self._sliding)
        changes = self._switch(shape, lines) or self._contacts(shape, lines)
        if not changes and self.net.crossings:
            changes = self._crossings(shape, lines)
        self.only_lifted &= len(changes) > 0
        return changes

    def _forget(self) -> None:
        """Forget the contact history of cables that have moved; other contacts would recur."""
        self._first_look = False
        moved = {cable.name for cable in self.net.cables if not self._rested(cable)}
        for keys in (self._released, self._settled):
            keys -= {key for key in keys if not moved.isdisjoint(key)}

    def _rested(self, cable: LaidCable) -> bool:
        """Whether a cable has not moved since the last load step."""
        return self._memory is not None and self._memory.has_rested(cable)

    def cycling_cable(self) -> str:
        """Name of a cable that keeps switching between slack and taut; "" if none does."""
        return next((name for name, n in self._switches.items() if n > BUDGET.switches), "")

    def _switch(self, shape: StripShape, solved: Polylines | None) -> list[str]:
        """Tighten slack cables that have become too short for their paths, slacken others if the
        polylines are those of a solved state.

        Near the limit a cable is in equilibrium both slack, on flat cells, and in tension, on cells
        that it has folded and that bulge. It counts as taut if it is nearly tight on flat cells and
        remains tight on folded ones, which is tried once per search. A taut cable that would be
        slack on flat cells is released first, so that the result does not depend on the load path;
        not with axial friction, which is path-dependent, nor along edges, where no cell bulges.
        """
        changes, tightened = list[str](), list[int]()
        lengths, flat = None if solved is None else floats(solved.lengths), None
        for c, cable in enumerate(self.net.cables):
            if cable.cable.law == "step":
                continue
            if not cable.taut and cable.lifts_off:
                contact.drape(cable, shape)
            untried = cable.name not in self._tried and not self._rested(cable)
            judged = solved is not None and cable.taut
            if lengths is not None and judged and cable.state.law.parts is None:
                taut = tight = lengths[c] > cable.L0 * (1 + UNSTRAINED)
            else:
                taut = tight = cable.is_tight(nearly=untried and not judged)
            alone = cable.slides_freely and not cable.is_divided
            new = judged and tight and untried
            if solved is not None and new and alone and cable.folds_cells:
                if flat is None:
                    flat = floats(solved.flat_lengths(shape, fractions_of(self.net.cables)))
                taut = flat[c] > cable.L0
            if taut == cable.taut:
                continue
            if taut or not tight:
                self._tried.add(cable.name)
            # A cable that slackens recovers its folds from the straight path.
            cable.update(taut=taut, path_is_geodesic=taut and cable.state.memory.path_is_geodesic)
            tightened += [c] if taut else []
            self._switches[cable.name] += 1
            self.only_lifted = False
            changes.append(f"{cable.name} {'tightens' if taut else 'slackens'}")
        for c, k in self._over_lifted(self.net.nodes) if tightened else ():
            if c in tightened:
                contact.lift(self.net.cables[c], [k])
        return changes + (self._join_clamps(shape) if tightened else [])

    def _join_clamps(self, shape: StripShape) -> list[str]:
        """Let cables that have lifted off clamps, while one of them was slack, touch down there."""
        net, nodes = self.net, self.net.nodes
        if not nodes.lifted.any():
            return []
        number = {cable.name: c for c, cable in enumerate(net.cables)}
        rows: list[int] = []
        for clamp in net.clamps:
            own = np.isin(nodes.cable, [number[name] for name in clamp.cables]) & nodes.taut
            own &= (nodes.kind == VERTEX) & (nodes.support[:, 0] == clamp.vertex)
            if not nodes.lifted[own].all():
                rows += ints(np.flatnonzero(own & nodes.lifted))
        return self._touch(np.unique(np.array(rows, dtype=np.int64)), nodes, shape)

    def _over_lifted(self, nodes: NodeTable) -> set[NodeId]:
        """Nodes of cables over others that have lifted off, at common vertices."""
        if not nodes.lifted.any():
            return set()
        rows, starts = stacks(nodes, self.net.cables)
        off = np.append(0, np.cumsum(nodes.lifted[rows]))
        below = off[:-1] > np.repeat(off[starts[:-1]], np.diff(starts))
        return set(nodes.ids(rows[below & ~self._sliding[nodes.cable[rows]]]))

    def _contacts(self, shape: StripShape, lines: Polylines) -> list[str]:
        """Release taut cables where they pull the membrane; close contacts that penetrate."""
        net, nodes = self.net, lines.nodes
        held = np.array([cable.taut and cable.lifts_off for cable in net.cables], dtype=bool)
        may = held[nodes.cable]
        alone = nodes.ids(lines.released(shape, may & ~lines.shared))
        pulling = [(id, [id]) for id in alone] + self._pulling_together(shape, lines, may)
        released: dict[int, list[int]] = defaultdict(list)
        for lowest, together in pulling:
            key = self._key(*lowest)
            if key not in self._settled:
                self._released.add(key)
                for c, k in together:
                    released[c].append(k)
        # Cables in sleeves span holes of the membrane.
        spanning = np.array(
            [cable.taut and cable.state.lifted.any() for cable in net.cables], dtype=bool
        )
        held |= spanning
        off = np.unique(nodes.cable[nodes.lifted & held[nodes.cable]])
        changes: list[str] = []
        free = FreeSpans(net.cables, nodes, shape, held, folded=True)
        over = self._over_lifted(nodes)
        for c in sorted({*released, *ints(off)}):
            new = self._change(c, released[c], free, over)
            if new:  # the cable folds other edges now, perhaps below other spans
                free = FreeSpans(net.cables, net.nodes, shape, held, folded=True)
            changes += new
        return changes + self._pressed_down(shape, nodes)

    def _key(self, c: int, k: int) -> ContactKey:
        """Key of the contact of a cable with what is below it."""
        cable = self.net.cables[c]
        return cable.name, cable.state.nodes[k].support

    def _change(
        self, c: int, released: Sequence[int], free: FreeSpans, over: Collection[NodeId]
    ) -> list[str]:
        """Release a cable at some nodes, and let it touch down under its spans, but for the nodes
        `over` cables that have lifted off: there it meets these."""
        cable = self.net.cables[c]
        places = {}
        if cable.state.lifted.any():
            free.move(c)
            places = free.captured(c, -TOL.contact)
            places = {k: one for k, one in places.items() if (c, k) not in over}
            unclear = cable.slides_freely and not self._rested(cable)
            if unclear and not released and not places:
                nearly = free.captured(c, TOL.touching)
                # The folds around a vertex do not bulge up to the span where one was released.
                keys = [key for key in self._released if key[0] == cable.name]
                parted = {v for _, at in keys if not isinstance(at, str) for v in at}
                # Nor does the membrane at the vertices of a cable along edges.
                at = ((k, cable.state.nodes[k]) for k in nearly)
                places = {
                    k: nearly[k]
                    for k, node in at
                    if node.kind != "vertex" and parted.isdisjoint(node.support)
                }
        if released:
            contact.lift(cable, released)
        if places:
            contact.touch(cable, places)
            self.only_lifted = False
        self._settled |= {self._key(c, k) for k in places} & self._released
        texts = [f"{cable.name} lifts off at {cable.state.nodes[k].point}" for k in released]
        return texts + [
            f"{cable.name} touches down at {cable.state.nodes[k].point}" for k in places
        ]

    @property
    def _sliding(self) -> Booleans:
        """Whether each cable slides aside: it leaves the vertices where it crosses others, and
        until then those below it stay."""
        of = [self._memory is not None and not cable.keeps_line for cable in self.net.cables]
        return np.array(of, dtype=bool)

    def _pulling_together(
        self, shape: StripShape, lines: Polylines, may: Booleans
    ) -> list[tuple[NodeId, list[NodeId]]]:
        """Nodes at common vertices where the upper cables together pull outward: that of the lowest
        of them, and all."""
        if not lines.shared.any():
            return []
        table, sums = lines.pulls_of_stacks(shape, self.net.cables, may)
        sums[:, 1:][~lines.held[table[:, 1:]]] = -np.inf
        found = []
        for stack in np.flatnonzero((sums > TOL.contact).any(axis=1)):
            nodes = lines.nodes.ids(table[stack])
            # of several sums the largest, of those that may open
            for n in np.argsort(-sums[stack], kind="stable"):
                if sums[stack, n] > TOL.contact and self._key(*nodes[n]) not in self._settled:
                    found.append((nodes[n], nodes[: n + 1]))
                    break
        return found

    def _pressed_down(self, shape: StripShape, before: NodeTable) -> list[str]:
        """Close the contacts of cables below others that touch the membrane, and of those that lie
        on a cable which has come down at a vertex."""
        if not before.lifted.any():
            return []
        net, nodes = self.net, self.net.nodes
        pairs = [one for one in net.crossings if len(one.support) == 1 and not one.separated]
        lower, upper = at_crossings(pairs, before).T
        down = nodes.lifted[upper] & before.lifted[lower] & ~nodes.lifted[lower]
        rows, starts = stacks(nodes, net.cables)
        touching = np.append(np.cumsum(~nodes.lifted[rows]), 0)
        above = np.repeat(touching[starts[1:] - 1], np.diff(starts)) > touching[:-1]
        below = rows[above & nodes.lifted[rows] & ~self._sliding[nodes.cable[rows]]]
        return self._touch(np.append(upper[down], below), before, shape)

    def _touch(self, rows: Integers, before: NodeTable, shape: StripShape) -> list[str]:
        """Let cables touch down at some vertices, given by the rows of their nodes."""
        changes = []
        for row, (c, k) in zip(ints(rows), before.ids(rows), strict=True):
            cable = self.net.cables[c]
            place = shape.at(cable.state.nodes[k].support[0])
            contact.touch(cable, {k: Gap(0.0, np.nan, place, place, True)})
            changes.append(f"{cable.name} touches down at {cable.state.nodes[k].point}")
            if before.lifted[row] and self._key(c, k) in self._released:
                self._settled.add(self._key(c, k))
        self.only_lifted &= not changes
        return changes

    def _crossings(self, shape: StripShape, lines: Polylines) -> list[str]:
        changes, down = list[str](), []
        net, nodes = self.net, lines.nodes
        pulled = parting(net.crossings, lines, shape)
        joined = joining(net.crossings, lines, shape, self._sliding)
        crossings = list(net.crossings)
        for number, crossing in enumerate(net.crossings):
            names = net.cables[crossing.upper].name, net.cables[crossing.lower].name
            # Key without place: a crossing may return in another cell than where it was separated.
            if number in pulled and names not in self._settled:
                crossings[number] = replace(crossing, separated=True)
                self._released.add(names)
                changes.append("{} lifts off {}".format(*names))
            elif number in joined:
                self.only_lifted = False
                crossings[number] = replace(crossing, separated=False)
                if names in self._released:
                    self._settled.add(names)
                changes.append("{} touches {}".format(*names))
                down += [crossing] if len(crossing.support) == 1 else []
        net.crossings = tuple(crossings)
        lower, upper = at_crossings(down, nodes).T
        return changes + self._touch(upper[~nodes.lifted[lower]], nodes, shape)
