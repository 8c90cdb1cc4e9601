"""Axial friction: bounds, slips and dissipation of a load step, and their tables.

The history, as for lateral friction (`cabling.friction.slip`), is the cable's curve on the
stress-free membrane at the end of the last load step, with the rest arc at each place: the
unstressed arc that sat there minus the elastic slip. A node uses the place nearest to its own, so
the history survives lateral sliding, also over vertices.

The friction bound of a node follows from wrap angle and tension, and is constant during a
minimisation. Then the law ``T2/T1 = exp(mu theta)`` is solved for the resulting lengths
(`energy.terms.capstan_chain`), which gives the bounds of the next pass. Only lengths and
angles change between passes, and little. A cable without known bounds starts without friction,
which gives lengths near the solution; a sticking one would be stretched by the motion of its ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cabling.cables.clamping import bounds_and_slips, held_by_clamps
from crms_fenicsx.cabling.cables.element_tables import CableTables
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import (
    cable_over,
    edge_directions,
    held_nodes,
    turns,
)
from crms_fenicsx.cabling.contact.lift_off import is_foot
from crms_fenicsx.cabling.friction.slip import material_place, succession
from crms_fenicsx.energy.terms.axial_friction import Chains, Grips
from crms_fenicsx.energy.terms.lateral_friction import coulomb_forces
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, ints
from crms_fenicsx.foundation.surface.points import Support
from crms_fenicsx.model.friction import AxialFrictionState, MaterialCurve
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE

LEAST_PART = 0.01
"""Least relaxation factor for changes of the bounds."""


@dataclass(frozen=True)
class RestPlaces:
    """Rest arcs at nodes with axial friction: ``slope * s + offset``, s the edge fraction, and at
    vertices ``by_shift . w + offset``, w the shift of the stress-free place."""

    nodes: list[int]  # their numbers
    slope: Array  # (n,), with
    offset: Array  # (n,) (length)
    by_shift: Array  # (n, 3)
    rest: Array  # (n,) at the current places (length)
    size: Array  # (n,) size of the surrounding stress-free cells (length)


def initial_state(cable: LaidCable, shape: StripShape) -> AxialFrictionState:
    """State of a cable at uniform strain, as after laying."""
    supports = _supports(cable)
    curve, rest = _curve(cable, shape, [], np.zeros(0))
    none, zero = np.zeros(0), np.zeros(len(supports))
    return AxialFrictionState(curve, rest, supports, zero, zero, zero, none, none, none, zero)


def _supports(cable: LaidCable) -> tuple[Support, ...]:
    """Supports of the nodes with axial friction; negative numbers for clamps."""
    last = len(cable.state.nodes) - 1
    supports: list[Support] = []
    for k in sorted({*held_nodes(cable), *cable.clamped}):
        if k in cable.clamped:
            supports.append((-1 - cable.clamped.index(k),))  # no vertex has such a number
            continue
        node, anchor = cable.state.nodes[k], {1: 0, last - 1: last}.get(k)
        if (
            anchor is not None
            and node.kind == "vertex"
            and cable.state.nodes[anchor].kind == "anchor"
        ):
            away = np.linalg.norm(cable.state.positions[k] - cable.state.positions[anchor])
            if away <= SAME_PLACE * cable.length:
                continue
        assert node.point is not None
        supports.append(node.point.support)
    return tuple(supports)


def is_aligned(cable: LaidCable) -> bool:
    """Whether the axial state refers to the current nodes with friction."""
    return (
        cable.state.law.axial is None
        or not cable.taut
        or cable.state.law.axial.supports == _supports(cable)
    )


def gripped_nodes(cable: LaidCable) -> list[int]:
    """Node numbers of the axial state, which stay fixed during a minimisation."""
    assert cable.state.law.axial is not None
    own, clamps = set(cable.state.law.axial.supports), cable.clamped
    return sorted(
        k
        for k in {*held_nodes(cable), *clamps}
        if k in clamps
        or ((point := cable.state.nodes[k].point) is not None and point.support in own)
    )


def remap_axial(cable: LaidCable) -> None:
    """Transfer the bounds to the cable's current nodes."""
    grip = cable.state.law.axial
    if grip is None or (now := _supports(cable)) == grip.supports:
        return
    stays, rows, heirs = succession(grip.supports, now)
    old = np.array([grip.bounds, grip.eps, grip.elastic, grip.slips])
    new = np.zeros((4, len(now)))
    new[:, stays] = old[:, rows]
    for gone, heir in heirs:
        new[:3, heir] += old[:3, gone].sum(axis=1, keepdims=True) / len(heir)
    if cable.cable.cone:
        # eps is as large as the slip: another one would do other work, and block path changes.
        new[1:3, stays] = old[1:3, rows]
        for gone, heir in heirs:
            added = [k for k in heir if k not in stays]
            if added and gone.stop > gone.start:
                new[1:, added] = old[1:, gone].mean(axis=1, keepdims=True)
    clamped = np.array([support[0] < 0 for support in now], dtype=bool)
    if clamped.any():
        bound, most = held_by_clamps(cable)
        order = [-1 - support[0] for support in now if support[0] < 0]
        new[:3, clamped] = np.array([bound, most, most])[:, order]
    bounds, eps, elastic, slips = new
    cable.update(
        axial=replace(grip, supports=now, bounds=bounds, eps=eps, elastic=elastic, slips=slips)
    )


def reference_arcs(cable: LaidCable, shape: StripShape) -> RestPlaces:
    """Rest arcs at a cable's nodes, and their slopes along the edges or by shifts."""
    # Moving a fold point along its edge by v moves the cable's material by v . t, with t the mean
    # of the directions before and after; divided by the stretch, this is the slope. Then tensions
    # T1, T2 and friction give the fold point the force (T1 + T2)/2 (t2 - t1) along the edge, which
    # vanishes on a geodesic, as without friction. A vertex whose stress-free place shifts by w
    # moves over the fabric by F w.
    grip = cable.state.law.axial
    assert grip is not None
    nodes, contacts, direction = gripped_nodes(cable), cable.contacts(), turns(cable)
    places = np.array([material_place(cable, k, shape) for k in nodes]).reshape(-1, 3)
    slope, size = np.zeros((2, len(nodes)))
    stretch: Array = np.ones(len(nodes))
    for i, k in enumerate(nodes):
        point = cable.state.nodes[k].point
        assert point is not None
        size[i] = shape.stress_free_size(point.support)
        if k in direction:
            at = contacts.index(k)
            stretch[i] += cable.part_tensions[at - 1 : at + 1].mean() / cable.cable.EA
        if k in direction and cable.state.nodes[k].slides:
            parts = (np.linalg.norm(shape.at(v) - cable.state.positions[k]) for v in point.support)
            edge = edge_directions(cable, [k], shape)[0] * float(sum(parts))
            slope[i] = edge @ np.add(*direction[k]) / (2 * stretch[i])
    rest = _rest_at(grip, places)
    at_clamps = np.isin(nodes, cable.clamped)
    if at_clamps.any():
        assert cable.state.law.parts is not None
        rest[at_clamps] = cable.state.law.parts.at * (cable.L0 + cable.state.law.smoothing_length)
    fractions = np.where(np.isnan(cable.state.fractions[nodes]), 0.0, cable.state.fractions[nodes])
    by_shift = cable_over(cable, nodes, shape) / stretch[:, None]
    return RestPlaces(nodes, slope, rest - slope * fractions, by_shift, rest, size)


def _rest_at(grip: AxialFrictionState, places: Array) -> Array:
    """Rest arcs at places on the stress-free membrane (length)."""
    at, _, parts = grip.curve.nearest(places)
    if np.any(parts < 0):  # the cable was entirely off the membrane
        return np.zeros(len(places))
    first, last = grip.curve.arc[[0, -1]]
    inside = np.clip(at, first, last)
    # extrapolate at the cable's mean rate
    rate = (grip.rest[-1] - grip.rest[0]) / (last - first)
    return np.interp(inside, grip.curve.arc, grip.rest) + rate * (at - inside)


def store_solution(
    cable: LaidCable, spans: Array, unstressed: Array, tensions: Array, slips: Array, loss: float
) -> None:
    """Store lengths and tensions (n + 1,) of the solved spans, and slips (n,) between them."""
    grip = cable.state.law.axial
    assert grip is not None
    axial = replace(
        grip, tensions=between_contacts(cable, tensions), spans=spans.copy(),
        arcs=np.cumsum(unstressed)[:-1], slips=slips.copy(), loss=loss,
    )  # fmt: skip
    tension = cable.cable.EA / cable.L0 * max(cable.length - cable.L0, 0.0)
    parts = cable.state.law.parts
    if parts is not None and cable.may_slip:
        parts = replace(parts, slips=slips[np.isin(gripped_nodes(cable), cable.clamped)])
    cable.update(tension=tension, axial=axial, parts=parts)


def between_contacts(cable: LaidCable, of_spans: Array) -> Array:
    """Values of spans for the cable's segments between contacts."""
    span = np.searchsorted(gripped_nodes(cable), cable.contacts()[:-1], side="right")
    return np.asarray(of_spans[span])


def end_axial_step(cable: LaidCable, shape: StripShape) -> None:
    """End a load step: the present state becomes the rest state of the next one."""
    grip = cable.state.law.axial
    if grip is None:
        return
    dissipated = grip.dissipated + grip.loss
    if not cable.taut:
        cable.update(axial=replace(initial_state(cable, shape), dissipated=dissipated))
        return
    held = np.where(grip.bounds > 0, np.clip(grip.slips, -grip.elastic, grip.elastic), 0.0)
    if cable.cable.cone:  # the remaining elastic slip has the same force in the uncoupled law
        slides = grip.elastic < grip.eps
        force = np.abs(coulomb_forces(grip.slips, grip.bounds, np.maximum(grip.eps, EPSILON)))
        bounds, eps = np.where(slides, [force, grip.elastic], [grip.bounds, grip.eps])
        grip = replace(grip, bounds=bounds, eps=np.where(eps > 0.0, eps, grip.eps))
    curve, rest = _curve(cable, shape, gripped_nodes(cable), grip.arcs - held)
    axial = replace(grip, curve=curve, rest=rest, slips=held, loss=0.0, dissipated=dissipated)
    cable.update(axial=axial)


def _curve(
    cable: LaidCable, shape: StripShape, nodes: list[int], arcs: Array
) -> tuple[MaterialCurve, Array]:
    """A cable's curve on the stress-free membrane, and the rest arcs at its points."""
    # include the places below lifted parts, where the cable may touch down
    last = len(cable.state.nodes) - 1
    on = [k for k in cable.path_nodes() if not (0 < k < last and is_foot(cable, k))]
    points = np.array([material_place(cable, k, shape) for k in on]).reshape(-1, 3)
    parts, none = np.zeros(len(on), dtype=np.int64), np.zeros(len(on))
    curve = MaterialCurve(points, arc_lengths(points), parts, none, none)
    passed = arc_lengths(cable.state.positions)
    rest = np.interp(
        passed, passed[[0, *nodes, last]], [0.0, *arcs, cable.L0 + cable.state.law.smoothing_length]
    )
    return curve, rest[on]


def held_along(cable: LaidCable) -> bool:
    """Whether a cable is taut and has axial friction."""
    return cable.taut and cable.state.law.axial is not None


def chain_table(
    numbering: CableNumbering, tables: CableTables, held: Mapping[int, Sequence[int]]
) -> Chains:
    """Spans of cables, by number, between the nodes with axial friction or clamps that slip."""
    starts = np.cumsum([0] + [len(nodes) + 1 for nodes in held.values()])
    first = dict(zip(held, starts, strict=False))
    begins = numbering.nodes.ids(tables.links[:, 0])
    own = [s for s, (c, _) in enumerate(begins) if c in first]
    span = [
        first[c] + np.searchsorted(held[c], k, side="right") for c, k in (begins[s] for s in own)
    ]
    points = [one for one in _moving_points(numbering) if one[1] in held]
    rows = np.array([numbering.row(c, held[c][i]) for _, c, i in points], dtype=np.int64)
    folds = numbering.nodes.slides[rows]  # first
    pointers, blocks = numbering.lines(numbering.on[rows[folds]])
    shifts = numbering.shift_blocks_at(rows[~folds])
    pointers = np.append(pointers, pointers[-1] + 1 + np.arange(len(shifts)))
    return Chains(
        np.array([numbering.cables[c].cable.EA for c in held]), starts.astype(np.int64),
        tables.segments[own], tables.eps[own], np.array(span, dtype=np.int32),
        pointers.astype(np.int32), np.append(blocks, shifts).astype(np.int32),
        np.where(folds, numbering.points.place[rows] + 1, 0).astype(np.int32),
        np.array([first[c] - n + i for n, c, i in points], dtype=np.int32),
        numbering.strip.simplices.owner[numbering.on[rows]] == numbering.rank,
    )  # fmt: skip


def gripped_cables(numbering: CableNumbering) -> dict[int, list[int]]:
    """The nodes with axial friction of each taut cable, by number."""
    return {c: gripped_nodes(k) for c, k in enumerate(numbering.cables) if held_along(k)}


def grip_table(numbering: CableNumbering, shape: StripShape) -> Grips:
    """Current bounds and rest arcs of these cables."""
    places = {c: reference_arcs(k, shape) for c, k in enumerate(numbering.cables) if held_along(k)}
    grips = [axial for c in places if (axial := numbering.cables[c].state.law.axial) is not None]

    def joined(parts: list[Array]) -> Array:
        return np.concatenate([np.zeros(0), *parts])

    bound, points = joined([grip.bounds for grip in grips]), _moving_points(numbering)
    by_shift = np.array([places[c].by_shift[i] for _, c, i in points]).reshape(-1, 3)
    slope = np.array([places[c].slope[i] for _, c, i in points])
    slope[by_shift.any(axis=1)] = 1.0
    return Grips(
        joined([p.offset for p in places.values()]),
        bound,
        np.where(bound > 0.0, joined([grip.eps for grip in grips]), 1.0),
        np.where(bound > 0.0, joined([grip.elastic for grip in grips]), 1.0),
        joined([grip.slips for grip in grips]),
        slope,
        by_shift,
    )


def clamp_grips(cables: Sequence[LaidCable]) -> Grips:
    """Grips of cables at the clamps through which they may slip."""
    rows: list[Array] = [np.zeros((4, 0))]
    for cable in cables:
        parts = cable.state.law.parts
        assert parts is not None
        bounds, eps = bounds_and_slips(cable)
        rest = cable.L0 * parts.at + np.cumsum(parts.smoothing)[:-1]
        rows.append(np.array([rest, bounds, eps, parts.slips]))
    rest, bounds, eps, slips = np.concatenate(rows, axis=1)
    return Grips(rest, bounds, eps, eps, slips, np.zeros(0), np.zeros((0, 3)))


def _moving_points(numbering: CableNumbering) -> list[tuple[int, int, int]]:
    """Nodes with axial friction near this rank's cells that slide on edges, then vertices that
    shift: index of cable, cable, index of node."""
    near = numbering.strip.simplices.touch(numbering.strip.owner == numbering.rank)
    shifting = set(ints(numbering.shifts.vertices))
    folds, vertices = [], []
    for n, (c, nodes) in enumerate(gripped_cables(numbering).items()):
        cable = numbering.cables[c]
        for i, k in enumerate(nodes):
            if not near[numbering.on[numbering.row(c, k)]]:
                continue
            node = cable.state.nodes[k]
            if node.slides:
                folds.append((n, c, i))
            elif k not in cable.clamped and node.support[0] in shifting:
                vertices.append((n, c, i))
    return folds + vertices
