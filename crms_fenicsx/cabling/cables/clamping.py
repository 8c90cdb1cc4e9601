"""Clamps and bonds: vertices that two cables share, and the nodes at which they divide a tension.

A cable slips through m clamps of limited grip as a chain of m + 1 parts
(`energy.terms.capstan_chain`), with dry friction bounded by the grip at each clamp. The rest arc is
that at clamping or after the last slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crms_fenicsx.cabling.cables.points_on_edges import NodeTable
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, floats
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.model.cable import Bonds, Clamp, ClampedParts
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE

TOLERANCE = 1e-3
"""Elastic slip at a clamp, relative to the elongation of the adjacent part under its grip."""

CLAMP_SLIP = 1e-6
"""Elastic slip at a clamp of unlimited grip, with axial friction, relative to the cable length."""


def meetings(a: LaidCable, b: LaidCable) -> list[tuple[Clamp, float, float]]:
    """Clamps, without a name, of two cables at the vertices that they share, in the order of the
    first one; how far apart they are there, and the mean size of its segments (length). Not at the
    ends of either, beside which a part would have no length."""
    first, second = _nodes_at_vertices(a), _nodes_at_vertices(b)
    found = []
    for vertex in first.keys() & second.keys():
        i, j = first[vertex], second[vertex]
        x, y = a.state.positions[i], b.state.positions[j]
        ends = np.array([c.state.positions[k] - x for c in (a, b) for k in (0, -1)])
        if norm(ends).min() <= SAME_PLACE * min(a.length, b.length):
            continue
        reach = float(norm(np.diff(a.state.positions, axis=0)).mean())
        at = _share(a, i), _share(b, j)
        clamp = Clamp("", (a.name, b.name), at, (x + y) / 2, None, vertex)
        found.append((clamp, float(norm(y - x)), reach))
    return sorted(found, key=lambda one: one[0].at)


def _nodes_at_vertices(cable: LaidCable) -> dict[int, int]:
    """Nodes of a cable by the vertices at which they are, or above which it touches others."""
    return {
        node.support[0]: k
        for k, node in enumerate(cable.state.nodes)
        if node.kind in ("vertex", "crossing") and len(node.support) == 1
    }


def _share(cable: LaidCable, k: int) -> float:
    """Fraction of the unstressed length up to a node."""
    contacts, x = cable.contacts(), cable.state.positions
    i = int(np.searchsorted(contacts, k, side="right")) - 1
    passed, left = norm(x[[k, contacts[i + 1]]] - x[[contacts[i], k]])
    sizes = norm(np.diff(x[contacts], axis=0)) / (1 + cable.part_tensions / cable.cable.EA)
    of = cable.parts_of(contacts[:-1])
    own = of == of[i]
    before = float(sizes[:i][own[:i]].sum() + passed / (passed + left) * sizes[i])
    parts = cable.state.law.parts
    clamps = floats(parts.at) if parts is not None and parts.nodes else []
    start, end = [0.0, *clamps, 1.0][int(of[i]) :][:2]
    return start + before / float(sizes[own].sum()) * (end - start)


def named(clamps: Sequence[Clamp], cables: tuple[str, str]) -> str:
    """Unused name for a new clamp of two cables."""
    taken, name = {clamp.name for clamp in clamps}, " x ".join(cables)
    numbers = (f" ({k})" if k else "" for k in [0, *range(2, len(taken) + 3)])
    return next(name + number for number in numbers if name + number not in taken)


def divide(cables: Sequence[LaidCable], clamps: Sequence[Clamp]) -> tuple[Clamp, ...]:
    """Divide cables at the nodes of their clamps and return the clamps at their current places."""
    by_name = {cable.name: cable for cable in cables}
    nodes = {clamp.name: _at_vertex(clamp, by_name) for clamp in clamps}
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
    """Nodes of two cables at their clamp; none while one of them has lifted off it alone."""
    own = [cables[name] for name in clamp.cables]
    at = {cable.name: _nodes_at_vertices(cable)[clamp.vertex] for cable in own}
    return {} if any(cables[name].state.lifted[k] for name, k in at.items()) else at


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
