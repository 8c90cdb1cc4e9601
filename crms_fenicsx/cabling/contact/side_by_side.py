"""Cables side by side along lines of the mesh: which vertices face which cables, and what presses.

Of two cables those of the one with more vertices, or the first, face the nearest ones of the other.
Cables that have a common vertex lie on each other there until, on the mesh as given, they are
farther apart than both radii. Only vertices beyond face the other cable, where both run within 30
degrees of each other: cables of a net part at once where they cross.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.element_tables import stiffest
from crms_fenicsx.cabling.cables.points_on_edges import VERTEX, NodeTable, positions_of
from crms_fenicsx.cabling.cables.strip import NOBODY, StripShape
from crms_fenicsx.energy.terms.side_contact import Facing
from crms_fenicsx.foundation.meshes.triangles import closest_on_segments, dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, pointers, runs
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.foundation.surface.closest_point import Balls
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE

BESIDE = 2
"""Number of vertices of the other cable before and behind the nearest one that a vertex faces, as
the curve between two vertices depends on the next ones; and how many cells away cables face each
other, of which each comes nearer by one at most before they are sought again."""

STIFF = 10.0
"""Stiffness of the contact, relative to that of fabric between the cables' axes: under the same
force it yields by a tenth of the fabric's strain."""


def _is_round(cables: Sequence[LaidCable], slack: bool = False) -> Booleans:
    """Whether each cable is taut, or may be `slack`, lies along a line and has a diameter, (n,)."""
    return np.array(
        [
            one.cable.diameter > 0.0 and one.state.laid.line is not None and (slack or one.taut)
            for one in cables
        ],
        dtype=bool,
    )


def facing_on_mesh(
    net: CableNet, materials: Iterable[MembraneMaterial], cells: int = BESIDE
) -> Facing:
    """Vertices of taut cables that face others within some `cells`, on the stress-free mesh; the
    same on all ranks, with rows of the table of nodes as blocks. Collective."""
    cables, nodes, shape = net.cables, net.nodes, net.strip_shape()
    strip = shape.strip
    inside = strip.simplices.cells[strip.owner != NOBODY]
    corners = shape.stress_free[inside]
    sizes = np.zeros(len(strip.vertices))
    longest = norm(corners - np.roll(corners, 1, axis=1)).max(axis=1, initial=0.0)
    np.maximum.at(sizes, inside, longest[:, None])
    at = np.searchsorted(strip.vertices, nodes.support[:, 0]).clip(0, len(strip.vertices) - 1)
    places = shape.stress_free[at]
    chosen = _is_round(cables)
    meeting = Meeting.of(net.membrane, cables, chosen, nodes)
    found = _facing(cables, chosen, nodes, places, cells * sizes[at], cells, meeting)
    found.stiffness[:] = stiffnesses(found, nodes, shape, materials)
    return found


def stiffnesses(
    facing: Facing, nodes: NodeTable, shape: StripShape, materials: Iterable[MembraneMaterial]
) -> Array:
    """Stiffness of the contact of each facing vertex, (n,) (force/length)."""
    on = np.flatnonzero((nodes.kind == VERTEX) & ~nodes.lifted)
    X = shape.stress_free[np.searchsorted(shape.strip.vertices, nodes.support[on, 0])]
    ways = np.where(np.diff(nodes.cable[on]) == 0, norm(np.diff(X, axis=0)), 0.0)
    lengths = (np.append(ways, 0.0) + np.append(0.0, ways)) / 2
    own = lengths[np.searchsorted(on, facing.blocks[facing.pointers[:-1]])]
    return np.asarray(STIFF * stiffest(materials) * own / facing.least)


def _facing(
    cables: Sequence[LaidCable], chosen: Booleans, nodes: NodeTable, places: Array, reach: Array,
    beside: int, meeting: Meeting,
) -> Facing:  # fmt: skip
    """Vertices of the chosen cables (n,) that face others of them within `reach` (m,) of their
    least distance, for nodes at `places` (m, 3): the nearest vertex and some `beside` it."""
    on = np.flatnonzero(chosen[nodes.cable] & (nodes.kind == VERTEX) & ~nodes.lifted)
    X, cable = places[on], nodes.cable[on]
    radii = np.array([one.cable.diameter / 2 for one in cables])
    most = float(radii[chosen].max(initial=0.0))
    count = np.bincount(nodes.cable[nodes.kind == VERTEX], minlength=len(cables))
    finer = np.argsort(np.lexsort((np.arange(len(cables)), -count)))
    i, j = Balls(X, np.zeros(len(X))).within(X, radii[cable] + most + reach[on])
    least, away = radii[cable[i]] + radii[cable[j]], norm(X[i] - X[j])
    near = (away <= least + reach[on[i]]) & (np.bincount(cable)[cable[j]] > 1)
    near &= finer[cable[i]] < finer[cable[j]]
    ways = _ways(X, cable)
    near &= ~meeting.pairs[cable[i], cable[j]] | (np.abs(dot(ways[i], ways[j])) > np.sqrt(0.75))
    near[near] = ~meeting.lies_on(nodes, on[i[near]], cable[j[near]], least[near])
    order = np.flatnonzero(near)[np.lexsort((away[near], cable[j[near]], i[near]))]
    pair = i[order] * len(cables) + cable[j[order]]
    order = order[np.flatnonzero(np.diff(pair, prepend=-1))]  # the nearest of each cable
    i, j, least = i[order], j[order], least[order]
    starts = np.searchsorted(cable, np.arange(len(cables) + 1))
    first = np.maximum(j - beside, starts[cable[j]])
    counts = np.minimum(j + beside, starts[cable[j] + 1] - 1) - first + 1
    begins = pointers(counts + 1)
    rows = np.empty(begins[-1], dtype=np.int64)
    rows[begins[:-1]] = on[i]
    rows[np.setdiff1d(np.arange(begins[-1]), begins[:-1])] = on[runs(first, counts)]
    return Facing(begins.astype(np.int32), rows, least, np.zeros(len(least)))


def _ways(places: Array, cable: Integers) -> Array:
    """Directions (n, 3) of chords between neighbours at places (n, 3) of cables (n,)."""
    same = np.diff(cable) == 0
    k = np.arange(len(cable))
    chords = places[k + np.append(same, False)] - places[k - np.append(False, same)]
    return chords / np.maximum(norm(chords), 1e-300)[:, None]


@dataclass(frozen=True)
class Meeting:
    """Cables with common vertices: whether each two have some (n, n), a cable not with itself, and
    the places (m, 3) of their nodes at vertices on the mesh as given."""

    pairs: Booleans
    places: Array

    @classmethod
    def of(
        cls, membrane: Membrane, cables: Sequence[LaidCable], chosen: Booleans, nodes: NodeTable
    ) -> Meeting:
        """Those of the chosen cables (n,). Collective."""
        rows = np.flatnonzero(chosen[nodes.cable] & (nodes.size == 1))
        ids, of = np.unique(nodes.support[rows, 0], return_inverse=True)
        has = np.zeros((len(cables), len(ids)), dtype=np.float32)
        has[nodes.cable[rows], of] = 1.0
        pairs = np.asarray(has @ has.T > 0.0) & ~np.eye(len(cables), dtype=bool)
        places = np.full((len(nodes.cable), 3), np.nan)
        if pairs.any():
            own = membrane.vertex_ids[: membrane.V.dofmap.index_map.size_local]
            _, here, at = np.intersect1d(own, ids, return_indices=True)
            given = np.zeros((len(ids), 3))
            given[at] = membrane.given[here]
            membrane.comm.Allreduce(MPI.IN_PLACE, given)
            places[rows] = given[of]
        return cls(pairs, places)

    def lies_on(self, nodes: NodeTable, rows: Integers, others: Integers, least: Array) -> Booleans:
        """Whether vertices in some rows (k,) belong to where their cables lie on others (k,)."""
        found = np.zeros(len(rows), dtype=bool)
        meet = np.flatnonzero(self.pairs[nodes.cable[rows], others])
        for pair in np.unique(np.stack([nodes.cable[rows[meet]], others[meet]], axis=1), axis=0):
            own, its = self._rows(nodes, *pair)
            some = meet[(nodes.cable[rows[meet]] == pair[0]) & (others[meet] == pair[1])]
            found[some] = np.isin(rows[some], own[self._together(nodes, own, its, least[some[0]])])
        return found

    def never_part(self, nodes: NodeTable, radii: Array) -> list[tuple[int, int]]:
        """Cables that lie on others from end to end, of radii (n,), and these; not those along the
        same vertices."""
        found = []
        for c, d in ((int(c), int(d)) for c, d in np.argwhere(self.pairs)):
            own, its = self._rows(nodes, c, d)
            common = np.isin(nodes.support[own, 0], nodes.support[its, 0])
            if not common.all() and self._together(nodes, own, its, radii[c] + radii[d]).all():
                found.append((c, d))
        return found

    @staticmethod
    def _rows(nodes: NodeTable, *cables: int) -> list[Integers]:
        """Rows of the nodes at vertices of each of some cables."""
        rows = [np.arange(*nodes.starts[c : c + 2]) for c in cables]
        return [own[nodes.size[own] == 1] for own in rows]

    def _together(self, nodes: NodeTable, own: Integers, its: Integers, least: float) -> Booleans:
        """Whether each of a cable's rows (k,) belongs to a stretch with common vertices in which it
        is no farther from the rows of another one than `least`."""
        X, Y = self.places[own], self.places[its]
        common = np.isin(nodes.support[own, 0], nodes.support[its, 0])
        away = closest_on_segments(Y[:-1], np.diff(Y, axis=0), X[:, None])[2].min(axis=1)
        near = common | (away <= least)
        stretch = np.cumsum(np.diff(near, prepend=near[:1]))
        return np.asarray(near & np.isin(stretch, stretch[common]))


def faces_all(known: Facing, near: Facing) -> bool:
    """Whether all that vertices face in `near` they face in another table, too."""
    own, others = (
        np.repeat(one.blocks[one.pointers[:-1]], np.diff(one.pointers)) + 1j * one.blocks
        for one in (near, known)
    )
    return bool(np.isin(own, others).all())


def _gaps(facing: Facing, places: Array) -> tuple[Integers, Array, Array, Array]:
    """Of each facing vertex the rows (n, 6) on which the closest point of the curve depends, their
    weights, its distance (n,), and the direction from it (n, 3), for nodes at `places` (m, 3):
    Hermite's cubic between two vertices, with the slopes of the chords beside them."""
    at, blocks = facing.pointers.astype(np.int64), facing.blocks.astype(np.int64)
    begins, ends = at[:-1], at[1:] - 1
    counts = ends - begins - 1
    part, of = runs(begins + 1, counts), np.repeat(np.arange(len(begins)), counts)
    rows, chords = [part, part + 1], []
    for k in (part, part + 1):
        after, before = np.minimum(k + 1, ends[of]), np.maximum(k - 1, begins[of] + 1)
        rows += [after, before]
        chords.append(1.0 / (after - before))
    X, v = places[blocks[np.array(rows)]], places[blocks[begins[of]]]
    low: Array = np.zeros(len(of))
    high: Array = np.ones(len(of))
    for _ in range(60):  # to rounding
        t = np.array([low + (high - low) / 3, high - (high - low) / 3])
        one, other = (norm(_curve(_hermite(s, chords), X) - v) for s in t)
        low, high = np.where(one > other, t[0], low), np.where(one > other, high, t[1])
    weights = _hermite((low + high) / 2, chords)
    w = v - _curve(weights, X)
    away = norm(w)
    best = np.lexsort((away, of))[pointers(counts)[:-1]]
    ways = w[best] / np.maximum(away[best], 1e-300)[:, None]
    return blocks[np.array(rows)[:, best].T], weights[:, best].T, away[best], ways


def _hermite(t: Array, chords: Sequence[Array]) -> Array:
    """Weights (6, n) of the points of cubics at t (n,): both ends, and those beside each."""
    rise, start, end = t * t * (3 - 2 * t), t * (1 - t) ** 2, -t * t * (1 - t)
    start, end = start * chords[0], end * chords[1]
    return np.array([1 - rise, rise, start, -start, end, -end])


def _curve(weights: Array, points: Array) -> Array:
    return np.asarray(np.einsum("kn,kni->ni", weights, points))


def forces_beside(net: CableNet, materials: Iterable[MembraneMaterial]) -> dict[LaidCable, Array]:
    """Forces (n, 3) of other cables beside it at each cable's nodes. Collective."""
    forces = side_forces(facing_on_mesh(net, materials), positions_of(net.cables))
    return dict(zip(net.cables, np.split(forces, net.nodes.starts[1:-1]), strict=True))


def overlaps(net: CableNet) -> dict[LaidCable, float]:
    """By which part of their least distance each taut cable and one beside it are too near.
    Collective."""
    cables = net.cables
    nodes, places, found = _facing_in_space(net.membrane, cables, _is_round(cables))
    parts = 1.0 - _gaps(found, places)[2] / found.least
    worst = dict[LaidCable, float]()
    for k in np.flatnonzero(parts > 0.0):
        v, a = found.blocks[found.pointers[k] : found.pointers[k] + 2]
        for c in nodes.cable[[v, a]]:
            worst[cables[c]] = max(float(parts[k]), worst.get(cables[c], 0.0))
    return worst


def _facing_in_space(
    membrane: Membrane, cables: Sequence[LaidCable], chosen: Booleans
) -> tuple[NodeTable, Array, Facing]:
    """Nodes of cables, their places, and vertices that face others of the chosen ones (n,) which
    are too near where they are now. Collective."""
    nodes, places = NodeTable.of(cables), positions_of(cables)
    inner = (nodes.kind[1:] == VERTEX) & (nodes.kind[:-1] == VERTEX) & (np.diff(nodes.cable) == 0)
    reach = norm(np.diff(places, axis=0)).max(where=inner, initial=0.0)
    meeting = Meeting.of(membrane, cables, chosen, nodes)
    found = _facing(cables, chosen, nodes, places, np.full(len(places), reach), BESIDE, meeting)
    return nodes, places, found


def side_forces(facing: Facing, places: Array) -> Array:
    """Forces (m, 3) of cables on each other at nodes at `places` (m, 3), by plain numpy."""
    rows, weights, away, ways = _gaps(facing, places)
    push = (facing.stiffness * np.maximum(facing.least - away, 0.0))[:, None] * ways
    forces = np.zeros_like(places)
    np.add.at(forces, facing.blocks[facing.pointers[:-1]], push)
    np.subtract.at(forces, rows, weights[:, :, None] * push[:, None])
    return forces


def refuse_too_near(membrane: Membrane, cables: Sequence[LaidCable], new: int) -> None:
    """Refuse cables of which one of the last `new` lies nearer to another than both radii, but for
    stretches with common vertices next to which they part. Collective."""
    chosen = _is_round(cables, slack=True)
    if np.count_nonzero(chosen) < 2 or not chosen[-new:].any():
        return
    nodes, places, found = _facing_in_space(membrane, cables, chosen)
    away = _gaps(found, places)[2]
    k = int(np.argmin(away / found.least)) if len(away) else 0
    if len(away) and away[k] < (1.0 - SAME_PLACE) * found.least[k]:
        v, a = found.blocks[found.pointers[k] : found.pointers[k] + 2]
        one, other = (cables[int(nodes.cable[row])] for row in (v, a))
        raise InputError(
            f"lay_cable: {one.name!r} would lie {away[k]:.4g} from {other.name!r} near "
            f"{as_text(places[v])}, but with the diameters {one.cable.diameter:g} and "
            f"{other.cable.diameter:g} they touch at {found.least[k]:.4g}; lay them further apart, "
            "or without diameters, which then have no contact."
        )
    radii = np.array([cable.cable.diameter / 2 for cable in cables])
    for c, d in Meeting.of(membrane, cables, chosen, nodes).never_part(nodes, radii):
        if max(c, d) < len(cables) - new:
            continue
        raise InputError(
            f"lay_cable: {cables[c].name!r} and {cables[d].name!r} have a common vertex, and would "
            f"nowhere lie {radii[c] + radii[d]:.4g} from each other, at which they touch with the "
            f"diameters {2 * radii[c]:g} and {2 * radii[d]:g}: they would have no contact. Lay "
            "them further apart; on smaller cells if their ends, which nearly meet, have become "
            "one; or without diameters."
        )
