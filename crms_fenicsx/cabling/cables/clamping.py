"""Clamps and bonds: where two cables meet, and the nodes at which they divide a tension.

A cable slips through m clamps of limited grip as a chain of m + 1 parts
(`energy.terms.capstan_chain`), with dry friction bounded by the grip at each clamp. The rest arc is
that at clamping or after the last slip.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cabling.cables.points_on_edges import NodeTable
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, cross, dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, floats
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.model.cable import Bonds, Clamp, ClampedParts
from crms_fenicsx.model.cable_state import Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL

TOLERANCE = 1e-3
"""Elastic slip at a clamp, relative to the elongation of the adjacent part under its grip."""

CLAMP_SLIP = 1e-6
"""Elastic slip at a clamp of unlimited grip, with axial friction, relative to the cable length."""


@dataclass(frozen=True)
class _CablesMeeting:
    """A place where two cables cross."""

    place: Array  # (3,) midpoint between both (length)
    gap: float  # distance of the cables (length)
    reach: float  # mean length of the segments that cross (length)
    at: tuple[float, float]  # fraction of each unstressed length up to there
    vertex: int | None = None  # that both share, along lines of the mesh


def meetings(a: LaidCable, b: LaidCable) -> list[_CablesMeeting]:
    """Crossings of two cables, in the order of the first one."""
    if a.state.laid.line is not None and b.state.laid.line is not None:
        return _at_common_vertices(a, b)
    (x, u), (y, v) = (_straight_parts(cable) for cable in (a, b))
    across = cross(u[:, None], v[None])
    square = dot(across, across)
    sizes = dot(u, u)[:, None] * dot(v, v)[None]
    apart = y[None] - x[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = dot(cross(apart, v[None]), across) / square
        t = dot(cross(apart, u[:, None]), across) / square
        gap = np.abs(dot(apart, across)) / np.sqrt(square)
        # Where they bend, cables that lie apart may do so beyond the ends of all parts there.
        ends = [SAME_PLACE + gap / np.sqrt(dot(way, way)) for way in (u[:, None], v[None])]
    inside = (-ends[0] <= s) & (s <= 1 + ends[0]) & (-ends[1] <= t) & (t <= 1 + ends[1])
    found: list[_CablesMeeting] = []
    for i, j in np.argwhere(inside & (square > TOL.oblique**2 * sizes)):
        along = [float(np.clip(share[i, j], 0.0, 1.0)) for share in (s, t)]
        first, second = x[i] + along[0] * u[i], y[j] + along[1] * v[j]
        place, reach = (first + second) / 2, float(norm(u[i]) + norm(v[j])) / 2
        at = _share(a, int(i), along[0]), _share(b, int(j), along[1])
        found.append(_CablesMeeting(place, float(norm(second - first)), reach, at))
    kept: list[_CablesMeeting] = []
    for one in sorted(found, key=lambda one: one.gap):
        near = max(1e-6 * one.reach, 2 * one.gap)
        if one.gap < one.reach and all(norm(k.place - one.place) >= near for k in kept):
            kept.append(one)
    return sorted(kept, key=lambda one: one.at)


def _at_common_vertices(a: LaidCable, b: LaidCable) -> list[_CablesMeeting]:
    """Vertices that two cables along lines of the mesh share, in the order of the first one; not
    the ends of either, beside which a part would have no length."""
    first, second = _nodes_at_vertices(a), _nodes_at_vertices(b)
    found = []
    for vertex in first.keys() & second.keys():
        i, j = first[vertex], second[vertex]
        x, y = a.state.positions[i], b.state.positions[j]
        ends = np.array([c.state.positions[k] - x for c in (a, b) for k in (0, -1)])
        if norm(ends).min() <= SAME_PLACE * min(a.length, b.length):
            continue
        reach = float(norm(np.diff(a.state.positions, axis=0)).mean())
        at = _share(a, *_link(a, i)), _share(b, *_link(b, j))
        found.append(_CablesMeeting((x + y) / 2, float(norm(y - x)), reach, at, vertex))
    return sorted(found, key=lambda one: one.at)


def _nodes_at_vertices(cable: LaidCable) -> dict[int, int]:
    """Nodes of a cable by the vertices at which they are, or above which it touches others."""
    return {
        node.support[0]: k
        for k, node in enumerate(cable.state.nodes)
        if node.kind in ("vertex", "crossing") and len(node.support) == 1
    }


def _link(cable: LaidCable, k: int) -> tuple[int, float]:
    """Segment between contacts on which a node is, and its fraction of that."""
    contacts, x = cable.contacts(), cable.state.positions
    i = int(np.searchsorted(contacts, k, side="right")) - 1
    passed, left = norm(x[[k, contacts[i + 1]]] - x[[contacts[i], k]])
    return i, float(passed / (passed + left))


def _straight_parts(cable: LaidCable) -> tuple[Array, Array]:
    """Start points of a cable's segments between contacts, and segment vectors, (n, 3)."""
    x = cable.state.positions[cable.contacts()]
    return x[:-1], np.diff(x, axis=0)


def _share(cable: LaidCable, i: int, t: float) -> float:
    """Fraction of the unstressed length up to a place on segment i."""
    sizes = norm(_straight_parts(cable)[1]) / (1 + cable.part_tensions / cable.cable.EA)
    of = cable.parts_of(cable.contacts()[:-1])
    own = of == of[i]
    passed = float(sizes[:i][own[:i]].sum() + t * sizes[i]) / float(sizes[own].sum())
    parts = cable.state.law.parts
    clamps = floats(parts.at) if parts is not None and parts.nodes else []
    start, end = [0.0, *clamps, 1.0][int(of[i]) :][:2]
    return start + passed * (end - start)


def named(clamps: Sequence[Clamp], cables: tuple[str, str]) -> str:
    """Unused name for a new clamp of two cables."""
    taken, name = {clamp.name for clamp in clamps}, " x ".join(cables)
    numbers = (f" ({k})" if k else "" for k in [0, *range(2, len(taken) + 3)])
    return next(name + number for number in numbers if name + number not in taken)


def with_clamps(
    crossings: Sequence[Crossing], clamps: Sequence[Clamp], cables: Sequence[LaidCable]
) -> list[Crossing]:
    """Known crossings, with each clamp at the nearest one of its cables, or at a new one."""
    number = {cable.name: c for c, cable in enumerate(cables)}
    held = {clamp.name for clamp in clamps}
    found = [
        one if one.clamp is None or one.clamp in held else replace(one, clamp=None)
        for one in crossings
    ]
    marked = {one.clamp for one in found}
    for clamp in clamps:
        if clamp.name in marked:
            continue
        c, d = (number[name] for name in clamp.cables)
        lower, upper = sorted((c, d), key=lambda k: (cables[k].layer, k))
        free = [
            (float(norm(one.place - clamp.place)), k)
            for k, one in enumerate(found)
            if one.clamp is None and (one.lower, one.upper) == (lower, upper)
        ]
        if free:
            k = min(free)[1]
            found[k] = replace(found[k], clamp=clamp.name, separated=False)
        else:
            new = Crossing(lower, upper, (), (0, 0), clamp.place, (), clamp=clamp.name)
            found.append(new)
    return found


def divide(
    cables: Sequence[LaidCable], crossings: Sequence[Crossing], clamps: Sequence[Clamp]
) -> tuple[Clamp, ...]:
    """Divide cables at the nodes of their clamps and return the clamps at their current places;
    off lines of the mesh clamps of slack cables have no effect."""
    nodes: dict[str, dict[str, int]] = defaultdict(dict)
    for cable in cables:
        for k, node in enumerate(cable.state.nodes):
            name = None if node.crossing is None else crossings[node.crossing].clamp
            if name is not None:
                nodes[name][cable.name] = k
    by_name = {cable.name: cable for cable in cables}
    for clamp in clamps:
        if len(nodes[clamp.name]) < 2 or clamp.vertex is not None:
            nodes[clamp.name] = _at_vertex(clamp, by_name)
    for cable in cables:
        shares = {
            nodes[clamp.name][cable.name]: (
                clamp.at[clamp.cables.index(cable.name)],
                clamp.slip or 0.0,
            )
            for clamp in clamps
            if cable.name in nodes[clamp.name]
        }
        if cable.state.laid.bonds is not None:
            bonds = zip(_bonded_nodes(cable), floats(cable.state.laid.bonds.at), strict=True)
            shares |= {k: (at, 0.0) for k, at in bonds}
        own = sorted(shares.items())
        cable.update(parts=_parts(cable, own))
    return placed(cables, clamps)


def placed(cables: Sequence[LaidCable], clamps: Sequence[Clamp]) -> tuple[Clamp, ...]:
    """Clamps with the current places of those on taut cables."""
    by_name = {cable.name: cable for cable in cables}
    found = []
    for clamp in clamps:
        cable = by_name[clamp.cables[0]]
        parts = cable.state.law.parts
        if cable.taut and parts is not None and parts.nodes:
            k = parts.nodes[int(np.argmin(np.abs(parts.at - clamp.at[0])))]
            clamp = replace(clamp, place=cable.state.positions[k].copy())
        found.append(clamp)
    return tuple(found)


def _at_vertex(clamp: Clamp, cables: dict[str, LaidCable]) -> dict[str, int]:
    """Nodes of two cables at a clamp's vertex, or of taut ones at the common one nearest to it."""
    a, b = (cables[name] for name in clamp.cables)
    if clamp.vertex is not None:
        at = {cable.name: _nodes_at_vertices(cable)[clamp.vertex] for cable in (a, b)}
        return at if not any(cables[name].state.lifted[k] for name, k in at.items()) else {}
    if not (a.taut and b.taut):
        return {}
    of_a, of_b = (
        {c.state.nodes[k].point: k for k in c.contacts() if c.state.nodes[k].kind == "vertex"}
        for c in (a, b)
    )
    away = [
        (float(norm(a.state.positions[k] - clamp.place)), k, of_b[point])
        for point, k in of_a.items()
        if point in of_b
    ]
    return {a.name: min(away)[1], b.name: min(away)[2]} if away else {}


def clamped_nodes(nodes: NodeTable, cables: Sequence[LaidCable]) -> Booleans:
    """Whether a clamp joins each node to another, (n,): these only lift off together."""
    clamped = np.zeros(len(nodes.kind), dtype=bool)
    for start, cable in zip(nodes.starts, cables, strict=False):
        clamped[start + np.array(cable.clamped, dtype=np.int64)] = True
    return clamped


def _parts(cable: LaidCable, own: Sequence[tuple[int, tuple[float, float]]]) -> ClampedParts | None:
    """Parts of a cable between clamps (nodes, unstressed fractions, grips); None without any."""
    old = cable.state.law.parts
    if not own:
        return None
    nodes = tuple(k for k, _ in own)
    at, grips = np.array([given for _, given in own]).T
    shares, count = np.maximum.accumulate(at), len(own) + 1
    if old is not None and np.array_equal(old.at, shares) and np.array_equal(old.grips, grips):
        return replace(old, nodes=nodes)
    force = np.full(count, cable.tension)
    smoothing = cable.state.law.smoothing_length * np.diff([0.0, *shares, 1.0])
    spent = 0.0 if old is None else old.dissipated
    return ClampedParts(
        shares, nodes, force, smoothing, grips, np.zeros(count - 1), dissipated=spent
    )


def bonds_of(cable: LaidCable) -> Bonds:
    """Bonds of a cable lying on the membrane, at uniform strain."""
    last, x = len(cable.state.nodes) - 1, cable.state.positions
    passed = arc_lengths(x)
    inside = [
        k
        for k in cable.path_nodes()
        if 0 < k < last and norm(x[[k, k]] - x[[0, last]]).min() > SAME_PLACE * passed[-1]
    ]
    places = tuple(cable.state.nodes[k].support for k in inside)
    return Bonds(places, passed[inside] / passed[-1])


def bonded_parts(cable: LaidCable) -> ClampedParts:
    """Parts of a newly bonded cable."""
    assert cable.state.laid.bonds is not None
    count = len(cable.state.laid.bonds.at) + 1
    force = np.full(count, cable.tension)
    inner = np.zeros(count - 1)
    return ClampedParts(
        cable.state.laid.bonds.at, tuple(_bonded_nodes(cable)), force, np.zeros(count), inner, inner
    )


def _bonded_nodes(cable: LaidCable) -> list[int]:
    """Nodes at which a cable is bonded to the fabric, in order."""
    assert cable.state.laid.bonds is not None
    on, found = iter(cable.path_nodes()), []
    for support in cable.state.laid.bonds.supports:
        node = next((k for k in on if cable.state.nodes[k].support == support), None)
        if node is None:
            raise PathError(
                f"{cable.name!r} has an end that has moved past places at which it is bonded to "
                "the fabric; move it with the edge that it is sewn to, or lay the cable anew."
            )
        found.append(node)
    return found


def bounds_and_slips(cable: LaidCable) -> tuple[Array, Array]:
    """Grips (m,) and elastic slips (m,) (length) of clamps; unlimited grips are EA."""
    assert cable.state.law.parts is not None
    EA, lengths = cable.cable.EA, cable.L0 * np.diff([0.0, *cable.state.law.parts.at, 1.0])
    bounds = np.where(
        cable.state.law.parts.grips > 0.0, np.minimum(cable.state.law.parts.grips, EA), EA
    )
    return bounds, TOLERANCE * bounds / EA * np.minimum(lengths[1:], lengths[:-1])


def held_by_clamps(cable: LaidCable) -> tuple[Array, Array]:
    """The same for a cable with axial friction: unlimited grips get a smaller elastic slip, since
    spans between its nodes are shorter than parts."""
    assert cable.state.law.parts is not None
    bounds, eps = bounds_and_slips(cable)
    return bounds, np.where(cable.state.law.parts.grips > 0.0, eps, CLAMP_SLIP * cable.L0)


def smallest_slip(cables: Sequence[LaidCable]) -> float:
    """Smallest elastic slip of clamps through which cables may slip (length)."""
    own = [bounds_and_slips(cable)[1] for cable in cables if cable.taut and cable.may_slip]
    return float(np.concatenate([[np.inf], *own]).min())


def end_step(cables: Sequence[LaidCable], clamps: Sequence[Clamp]) -> tuple[Clamp, ...]:
    """End a load step: clamps adopt the slipped positions. Returns the clamps."""
    moved: dict[tuple[str, float], float] = {}
    for cable in cables:
        parts = cable.state.law.parts
        if parts is None or not parts.slips.any():
            continue
        if cable.state.law.axial is None:
            (_, eps), length = bounds_and_slips(cable), cable.L0
        else:
            (_, eps), length = held_by_clamps(cable), cable.L0 + cable.state.law.smoothing_length
        elastic = np.clip(parts.slips, -eps, eps)
        at = np.asarray(parts.at + (parts.slips - elastic) / length)
        moved |= {
            (cable.name, old): new for old, new in zip(floats(parts.at), floats(at), strict=True)
        }
        spent = parts.dissipated + parts.loss
        cable.update(parts=replace(parts, at=at, slips=elastic, loss=0.0, dissipated=spent))
    return tuple(
        replace(clamp, at=(first, second)) if (first, second) != clamp.at else clamp
        for clamp in clamps
        for first, second in [
            tuple(moved.get(key, key[1]) for key in zip(clamp.cables, clamp.at, strict=True))
        ]
    )
