"""Lift-off and recontact: where a cable touches the membrane, and its gap elsewhere.

A cable lies on the outside of the membrane and can push, but not pull it. Where its tensions at a
contact have an outward resultant, the contact is released and the cable passes straight above;
where it would penetrate the membrane, it touches down again. No upper cable pulls a lower one up;
where cables cross at a vertex, the upper ones lift off together if their pulls have an outward sum.

Contacts released and restored in one solve stay closed, which prevents chattering.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from crms_fenicsx.cabling.cables.clamping import clamped_nodes
from crms_fenicsx.cabling.cables.crossings import at_crossings, stacks
from crms_fenicsx.cabling.cables.points_on_edges import (
    ANCHOR,
    CROSSING,
    VERTEX,
    NodeTable,
    positions_of,
)
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.free_spans import FreeSpans, Gap, under
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints
from crms_fenicsx.foundation.surface import lines
from crms_fenicsx.foundation.surface.points import CellPoint
from crms_fenicsx.model.cable_state import Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL


def size_at(shape: StripShape, support: tuple[int, ...]) -> float:
    """Cell size around a vertex or an edge (length)."""
    return float(shape.normals_and_sizes([support])[1][0])


def may_lift(cable: LaidCable) -> Iterator[int]:
    """Nodes at which a cable may lift off: all but ends and crossings."""
    for k, node in enumerate(cable.state.nodes[1:-1], start=1):
        if not node.touches_cable:
            yield k


def is_foot(cable: LaidCable, k: int) -> bool:
    """Whether a node is only the foot of an anchor, where no cable can touch."""
    nodes = cable.state.nodes
    in_cell = isinstance(nodes[k].point, CellPoint)
    return in_cell and "anchor" in (nodes[k - 1].kind, nodes[k + 1].kind)


class Polylines:
    """Cables as polylines through their contacts with the membrane, each other and anchors."""

    def __init__(self, nodes: NodeTable, positions: Array, held: Booleans | None = None) -> None:
        """`held`: cables (n,) that the mesh holds where they lie along its edges."""
        self.nodes, self.positions = nodes, positions
        self.contacts = np.flatnonzero(~nodes.lifted)  # (m,) rows of the contacts
        self._starts = np.searchsorted(self.contacts, nodes.starts)  # first contact of each cable
        self._x = positions[self.contacts]
        self._arc = lines.arc_lengths(self._x, self._starts)
        self.held = np.zeros(len(nodes.kind), dtype=bool) if held is None else held[nodes.cable]

    @classmethod
    def of(cls, cables: Sequence[LaidCable]) -> Polylines:
        """The polylines of some cables."""
        return cls(NodeTable.of(cables), positions_of(cables))

    @cached_property
    def shared(self) -> Booleans:
        """Contacts on which another cable lies, or that lie on one, (n,)."""
        nodes = self.nodes
        found = np.zeros(len(nodes.kind), dtype=bool)
        at = np.flatnonzero((nodes.kind == VERTEX) & nodes.taut & ~nodes.lifted)
        _, of, counts = np.unique(nodes.support[at, 0], return_inverse=True, return_counts=True)
        found[at] = counts[of] > 1
        return found

    @property
    def lengths(self) -> Array:
        """Lengths of the cables, (n,)."""
        return self._arc[self._starts[1:] - 1]

    @cached_property
    def on_membrane(self) -> Booleans:
        """Nodes (n,) at which cables touch the membrane only, and do not end."""
        nodes = self.nodes
        found = ~nodes.lifted & (nodes.kind != CROSSING) & (nodes.crossing < 0)
        found[nodes.starts[:-1]] = found[nodes.starts[1:] - 1] = False
        return found

    def pulls(self, rows: Integers, normals: Array, reaches: Array) -> Array:
        """Outward forces (m,) of cables at contacts `rows` (m,) along `normals` (m, 3), relative to
        the tension; -1 where a cable lies on its anchor or on another cable. Points close together,
        as around a vertex, share one contact: the turn is taken between the distances `reaches`
        (m,) before and after it, excluding that at contacts shared with other cables, which press
        there, and at vertices of cables that are held."""
        nodes = self.nodes
        # Along edges of the mesh the turn at a vertex is the force there, as no fold point is near.
        vertex = np.pad(nodes.kind == VERTEX, 1)
        row = vertex[:-2] & vertex[1:-1] & vertex[2:]
        crossed = (nodes.kind == CROSSING) | (nodes.crossing >= 0) | self.shared
        stops = (crossed | (row & self.held))[self.contacts]
        ends = self._starts[nodes.cable[rows][:, None] + np.arange(2)]
        at, given = np.searchsorted(self.contacts, rows), (normals, reaches, SAME_PLACE)
        return np.asarray(lines.pulls(self._x, self._arc, ends, stops, at, *given))

    def released(self, shape: StripShape, chosen: Booleans) -> Integers:
        """Rows of the chosen nodes (n,) at which cables pull the membrane outward."""
        nodes = self.nodes
        on = np.flatnonzero(chosen & self.on_membrane)
        around = shape.around(nodes.on(shape.strip.simplices)[on])
        beside = (nodes.kind[on - 1] == ANCHOR) | (nodes.kind[on + 1] == ANCHOR)
        feet = (nodes.size[on] == 3) & beside
        return on[(self.pulls(on, *around) > TOL.contact) | feet]

    def pulls_of_stacks(
        self, shape: StripShape, cables: Sequence[LaidCable], may: Booleans
    ) -> tuple[Integers, Array]:
        """Contacts of cables at vertices that they share: rows (m, k) from the uppermost cable to
        the lowest, padded with -1, and the outward sums (m, k) of the pulls of each and those above
        it, relative to their largest tension; -inf where not all these nodes `may` (n,) lift off,
        and where a cable would leave those that it is clamped to.
        """
        nodes = self.nodes
        rows, starts = stacks(nodes, cables)
        rows, counts = rows[::-1], np.diff(starts)[::-1]
        touches = ~nodes.lifted[rows]
        of = np.repeat(np.arange(len(counts)), counts)[touches]
        rows, counts = rows[touches], np.bincount(of, minlength=len(counts))
        table = np.full((len(counts), int(counts.max(initial=0))), -1)
        at = np.arange(table.shape[1]) < counts[:, None]
        table[at] = rows
        pulls = self.pulls(rows, *shape.around(nodes.on(shape.strip.simplices)[rows]))
        # after each contact; slack cables may have been draped since
        parts = np.zeros(len(self.contacts))
        for start, cable in zip(self._starts, cables, strict=False):
            if cable.taut:
                own = cable.part_tensions
                parts[start : start + len(own)] = own
        k = np.searchsorted(self.contacts, rows)
        tension = (parts[k - 1] + parts[k]) / 2
        largest, sums = np.zeros(table.shape), np.full(table.shape, -np.inf)
        sums[at] = np.where(may[rows] & (pulls > -1.0), pulls * tension, -np.inf)
        largest[at] = tension
        largest = np.maximum(np.maximum.accumulate(largest, axis=1), 1e-300)
        joined = np.cumsum((table >= 0) & clamped_nodes(nodes, cables)[table], axis=1)
        leaves = (joined > 0) & (joined < joined[:, -1:])
        return table, np.where(leaves, -np.inf, np.cumsum(sums, axis=1) / largest)

    def gaps(
        self, shape: StripShape, crossings: Sequence[Crossing], reach: int
    ) -> tuple[Array, Array]:
        """Gaps (m,) between the cables of crossings where they cross, up to `reach` contacts beside
        their nodes there, of the upper above the lower one, and cell sizes (m,); inf if they do
        not cross there (length)."""
        nodes, contacts = self.nodes, self.contacts
        cables = np.array([(k.lower, k.upper) for k in crossings], dtype=np.int64).reshape(-1, 2)
        at = at_crossings(crossings, nodes)
        first = np.searchsorted(contacts, at) - reach
        last = np.searchsorted(contacts, at, side="right") + reach - 1
        first = np.maximum(first, self._starts[cables])
        last = np.minimum(last, self._starts[cables + 1] - 1)
        normals, sizes = shape.normals_and_sizes([one.support for one in crossings])
        return np.asarray(lines.gaps_of_polylines(self._x, first, last, normals)), sizes

    def straight_parts(self, cables: Integers, links: Integers) -> Array:
        """Ends (m, 2, 3) of segments of `cables` (m,) after `links` (m,), crossings not counted."""
        nodes, contacts = self.nodes, self.contacts
        own = np.flatnonzero(nodes.kind != CROSSING)
        at = np.searchsorted(own, nodes.starts[cables]) + links
        first = contacts[np.searchsorted(contacts, own[at], side="right") - 1]
        last = contacts[np.searchsorted(contacts, own[at + 1])]
        return np.stack([self.positions[first], self.positions[last]], axis=1)

    def flat_lengths(self, shape: StripShape, fractions: Array) -> Array:
        """Lengths (n,) of the cables on unfolded cells (length)."""
        own, places = self._flat_places(shape, fractions)
        starts = np.searchsorted(own, self.nodes.starts)
        return np.asarray(lines.arc_lengths(places, starts)[starts[1:] - 1])

    def collapsed(self, shape: StripShape, fractions: Array) -> set[int]:
        """Numbers of the cables with a chord between two edges that is much shorter than on
        unfolded cells: the edges are bent towards each other."""
        nodes = self.nodes
        own, places = self._flat_places(shape, fractions)
        on_edge = nodes.size[own] == 2
        chords = on_edge[1:] & on_edge[:-1] & (nodes.cable[own[1:]] == nodes.cable[own[:-1]])
        now, flat = (norm(np.diff(x, axis=0)) for x in (self.positions[own], places))
        return set(ints(nodes.cable[own[1:]][chords & (now < TOL.collapsed * flat)]))

    def _flat_places(self, shape: StripShape, fractions: Array) -> tuple[Integers, Array]:
        """Rows of the contacts (m,) and their places on unfolded cells (m, 3)."""
        nodes, simplices = self.nodes, shape.strip.simplices
        own = self.contacts[nodes.kind[self.contacts] != CROSSING]
        on, weights, s = nodes.on(simplices)[own], nodes.weights[own].copy(), fractions[own]
        slides = (nodes.size[own] == 2) & ~np.isnan(s)
        weights[slides, :2] = np.stack([1 - s, s], axis=1)[slides]
        places = np.einsum("nk,nki->ni", weights, shape.current[simplices.corners[on]])
        return own, np.where((nodes.kind[own] == ANCHOR)[:, None], self.positions[own], places)


def released(cable: LaidCable, shape: StripShape) -> list[int]:
    """Nodes at which the cable pulls the membrane outward."""
    if not cable.lifts_off:
        return []
    lines = Polylines.of([cable])
    return ints(lines.released(shape, ~clamped_nodes(lines.nodes, [cable])))


def captured(cable: LaidCable, shape: StripShape, height: float | None = None) -> dict[int, Gap]:
    """Nodes where a free span penetrates the membrane, or is lower than a `height` relative to the
    cell size, with the contact points; for a cable alone. Moves the lifted nodes onto their span.
    """
    if height is None:
        height = -TOL.contact
    every = np.ones(1, dtype=bool)
    free = FreeSpans([cable], NodeTable.of([cable]), shape, every)
    free.move(0)
    return free.captured(0, height)


def sunk(cables: Sequence[LaidCable], nodes: NodeTable, shape: StripShape) -> set[int]:
    """Numbers of cables with a span deep below the membrane beside a vertex, beyond the ends of the
    path's edges, so that none can stop it; perhaps far beyond, if the span ends at another cable
    and their crossing has slid out of its cell."""
    may = np.array([cable.taut and cable.lifts_off for cable in cables], dtype=bool)
    free = FreeSpans(cables, nodes, shape, may, reach=np.inf)
    found = set()
    for n in np.flatnonzero((free.past >= 0) & (free.heights < -TOL.sunk * free.sizes)):
        # The span passes the line of a nearly parallel edge far away: check at the vertex.
        first, last = free.ends[n]
        place = under((int(free.past[n]),), (first, last), shape)
        if place.gap < -TOL.sunk * free.sizes[n]:
            found.add(int(nodes.cable[free.rows[n]]))
    return found


def lift(cable: LaidCable, nodes: Sequence[int]) -> None:
    """Release a cable's contacts at some nodes."""
    lifted = cable.state.lifted.copy()
    lifted[nodes] = True
    cable.update(lifted=lifted)


def touch(cable: LaidCable, places: Mapping[int, Gap]) -> None:
    """Restore a cable's contacts at some nodes."""
    lifted, positions, fractions = (
        array.copy() for array in (cable.state.lifted, cable.state.positions, cable.state.fractions)
    )
    for k, place in places.items():
        lifted[k] = False
        positions[k] = place.place
        if cable.state.nodes[k].slides:
            fractions[k] = min(max(place.fraction, TOL.inside), 1 - TOL.inside)
    cable.update(lifted=lifted, positions=positions, fractions=fractions)


def drape(cable: LaidCable, shape: StripShape) -> None:
    """Find the contacts of a cable pulled over the membrane as a rigid surface."""
    for _ in range(len(cable.state.nodes) + 1):
        free = released(cable, shape)
        lift(cable, free)
        places = {} if free else captured(cable, shape)
        touch(cable, places)
        positions = cable.state.positions.copy()
        for k in places:  # a slack cable is not solved: put the point where its fraction says
            positions[k] = shape.mean(*cable.interpolation(k))
        cable.update(positions=positions)
        if not free and not places:
            return
