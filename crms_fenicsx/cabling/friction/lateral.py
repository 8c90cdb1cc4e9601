"""Lateral friction: bounds and slips of a load step, and their tables.

The bound F = mu N (3.2-3) depends on the unknown state. It is constant during a minimisation, then
updated from the result, until it settles. In the paper's friction element it is that of the state
at the step's start, as are its vertex and its direction (assumption 7).

While bounds are constant the path may change. Persisting nodes keep their bounds; those of
vanishing nodes are shared among their successors, so that the sum, and with it the energies of the
compared paths, do not change for another reason.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import (
    contact_forces,
    directions,
    held_nodes,
    paper_forces,
    supports_of,
    turns,
)
from crms_fenicsx.cabling.friction.slip import (
    NodeSlips,
    material_curve,
    node_slips,
    slip_forces,
    succession,
)
from crms_fenicsx.energy.terms.lateral_friction import Slips, stored_and_lost
from crms_fenicsx.energy.terms.paper.cable_elements import FrictionElements
from crms_fenicsx.foundation.meshes.triangles import dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array, ints
from crms_fenicsx.model.friction import (
    ElementSlips,
    Friction,
    LateralFrictionState,
    LateralLaw,
    MaterialCurve,
)
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


def start_step(cable: LaidCable, shape: StripShape) -> None:
    """Prepare a cable with friction for a load step."""
    if cable.cable.sideways is None:
        return
    last = cable.state.law.lateral or LateralFrictionState(
        material_curve(cable, shape), (), np.zeros(0), np.zeros(0)
    )
    if last.elements is not None:
        last = replace(last, bounds=last.elements.bound)
    cable.update(lateral=last)
    remap(cable)
    grip = cable.state.law.lateral
    assert grip is not None
    if grip.elements is not None:
        return
    # A cable not yet in tension sticks at first, as no bound is known. So that a tightened one
    # sticks too, its bounds grow in advance with its tension in place: with the last step's bounds
    # it could slide until it is slack, a self-sustaining state without friction.
    expected = _tension_in_place(cable)
    rises = expected > (1 + TOL.bound_rise) * cable.tension
    if not grip.known or (rises and not (cable.tension > 0.0 and grip.bounds.any())):
        force = max(cable.tension, expected, cable.cable.EA * TOL.slight)
        cable.update(lateral=replace(grip, bounds=np.full(len(grip.supports), force), known=False))
    elif rises:
        cable.update(lateral=replace(grip, bounds=grip.bounds * (expected / cable.tension)))


def _tension_in_place(cable: LaidCable) -> float:
    """Tension (force) of a cable in its last place, with its ends at their current positions."""
    # from its old length, as new crossings are not in equilibrium yet
    length, places = cable.length, cable.state.positions[cable.contacts()]
    if cable.state.memory.ends_before is not None:
        beside = places[[1, -2]]
        chords = norm(places[[0, -1]] - beside) - norm(cable.state.memory.ends_before - beside)
        length += float(chords.sum())
    return cable.cable.EA * (length / cable.L0 - 1)


def start_elements(
    cable: LaidCable, curve: MaterialCurve, shape: StripShape,
    last: LateralFrictionState | None = None,
) -> None:  # fmt: skip
    """Make the friction elements of the load step that starts from the current state."""
    friction, nodes, supports = cable.cable.sideways, held_nodes(cable), tuple(supports_of(cable))
    assert friction is not None
    if last is None or last.supports != supports:
        nothing, spent = np.zeros(len(nodes)), 0.0 if last is None else last.dissipated
        last = LateralFrictionState(curve, supports, nothing, nothing, spent, known=True)
    elements = ElementSlips.missing(friction.mu * paper_forces(cable)[nodes])
    cable.update(lateral=replace(last, curve=curve, elements=elements))
    place_elements(cable, shape)


def place_elements(cable: LaidCable, shape: StripShape) -> None:
    """Place the friction elements that nodes do not have yet: at the nearer end of the edge, in the
    direction to the cable's left. Their slip starts with that of the node."""
    grip = cable.state.law.lateral
    if grip is None or grip.elements is None:
        return
    slips, old = node_slips(cable, grip.curve, shape, grip.line), grip.elements
    rows = np.array(grip.rows(slips.supports), dtype=np.int64)
    new = np.isnan(old.offset[rows])
    if not new.any():
        return
    nodes, edges = np.array(slips.nodes, dtype=np.int64)[new], np.array(slips.supports)[new]
    rows = rows[new]
    vertices, left, offset = old.vertices.copy(), old.left.copy(), old.offset.copy()
    vertices[rows] = np.where(cable.state.fractions[nodes] > 0.5, edges[:, 1], edges[:, 0])
    ways = turns(cable)
    turned = np.isin(nodes, list(ways))  # a point that coincides with others has no direction
    before, after = np.array([ways[k] for k in nodes[turned]]).reshape(-1, 2, 3).swapaxes(0, 1)
    left[rows[turned]] = directions(cable, nodes[turned], shape, before, after)[1]
    to_node = cable.state.positions[nodes] - np.array([shape.at(v) for v in vertices[rows]])
    offset[rows] = slips.slip[new] - dot(left[rows], to_node)
    placed = replace(old, vertices=vertices, left=left, offset=offset)
    cable.update(lateral=replace(grip, elements=placed))


def _slips_now(cable: LaidCable, grip: LateralFrictionState, shape: StripShape) -> NodeSlips:
    """Slips of a cable's sliding nodes: from the material curve, or of its friction elements."""
    slips, own = node_slips(cable, grip.curve, shape, grip.line), grip.elements
    if own is None:
        return slips
    rows = np.array(grip.rows(slips.supports), dtype=np.int64)
    placed = ~np.isnan(own.offset[rows])
    nodes, rows = np.array(slips.nodes, dtype=np.int64)[placed], rows[placed]
    slip = slips.slip.copy()
    vertices = np.array([shape.at(v) for v in own.vertices[rows]]).reshape(-1, 3)
    slip[placed] = dot(own.left[rows], cable.state.positions[nodes] - vertices) + own.offset[rows]
    return replace(slips, slip=slip)


def remap(cable: LaidCable) -> None:
    """Transfer the bounds to the cable's current nodes."""
    grip = cable.state.law.lateral
    if grip is None or (now := tuple(supports_of(cable))) == grip.supports:
        return
    stays, rows, heirs = succession(grip.supports, now)
    bounds, moving = np.zeros(len(now)), np.zeros(len(now))
    bounds[stays], moving[stays] = grip.bounds[rows], grip.moving[rows]
    for gone, new in heirs:
        freed = grip.bounds[gone].copy()
        # Near its ends a cable may press on a boundary edge, much more than on all others.
        if len(new) > 1 and gone.start == new[0] == 0:
            bounds[0], freed[0] = freed[0], 0.0
        if len(new) > 1 and gone.stop == len(grip.supports) and new[-1] == len(now) - 1:
            bounds[-1], freed[-1] = freed[-1], 0.0
        bounds[new] += float(freed.sum()) / len(new)
        strongest = int(np.argmax(np.abs(grip.moving[gone])))
        for k in new:
            moving[k] = moving[k] or grip.moving[gone][strongest]
    cone = None
    if grip.cone is not None:
        old = np.array([grip.cone.bound, grip.cone.width, grip.cone.elastic])
        law = np.ones((3, len(now)))
        law[:, stays] = old[:, rows]
        for gone, new in heirs:
            if gone.stop > gone.start and not set(new) & set(stays):
                law[:, new] = old[:, gone].mean(axis=1, keepdims=True)
        cone = LateralLaw(*law)
    old_elements = grip.elements
    elements = None if old_elements is None else old_elements.remapped(bounds, stays, rows)
    changed = replace(grip, supports=now, bounds=bounds, moving=moving, cone=cone)
    cable.update(lateral=replace(changed, elements=elements))


def energies(cable: LaidCable, shape: StripShape) -> tuple[float, float]:
    """Energies that a cable's friction stores, and has dissipated in this step."""
    friction, grip = cable.cable.sideways, cable.state.law.lateral
    if friction is None or grip is None or not cable.taut:
        return 0.0, 0.0
    slips = _slips_now(cable, grip, shape)
    law = grip.law(slips.supports, friction.tolerance * slips.size)
    return stored_and_lost(slips.slip, *law)


def friction_forces(cable: LaidCable, shape: StripShape) -> Array:
    """Friction force (n,) at nodes with friction, positive on a cable sliding left (force)."""
    friction, grip = cable.cable.sideways, cable.state.law.lateral
    assert friction is not None and grip is not None
    # a node on a vertex cannot slip: friction balances the pull, up to the bound
    pull = contact_forces(cable, shape).lateral[held_nodes(cable)]
    forces = np.clip(pull, -grip.bounds, grip.bounds)
    slips = _slips_now(cable, grip, shape)
    forces[grip.rows(slips.supports)] = slip_forces(friction, grip, slips)
    return np.asarray(forces)


def note_sliding(cable: LaidCable, shape: StripShape) -> None:
    """Note in which directions the nodes of the paper's friction elements slide in this step."""
    friction, grip = cable.cable.sideways, cable.state.law.lateral
    if friction is None or grip is None or grip.elements is None or not cable.taut:
        return
    slips, moving = _slips_now(cable, grip, shape), np.zeros(len(grip.supports))
    bounds, eps, _ = grip.law(slips.supports, friction.tolerance * slips.size)
    slid = (np.abs(slips.slip) >= eps) | (bounds == 0.0)
    moving[grip.rows(slips.supports)] = np.copysign(1.0, slips.slip) * slid
    cable.update(lateral=replace(grip, moving=moving))


def end_step(cable: LaidCable, shape: StripShape) -> None:
    """End a load step: slips then count from the cable's current place."""
    friction, grip = cable.cable.sideways, cable.state.law.lateral
    if friction is None or grip is None:
        return
    dissipated = grip.dissipated + energies(cable, shape)[1]
    elastic: dict[int, float] = {}
    moving: dict[int, float] = {}
    if cable.taut:
        slips = _slips_now(cable, grip, shape)
        most = grip.law(slips.supports, friction.tolerance * slips.size)[2]
        elastic = dict(zip(slips.nodes, np.clip(slips.slip, -most, most), strict=True))
        slid = np.sign(slips.slip) * (np.abs(slips.slip) > TOL.sliding * slips.size)
        moving = dict(zip(slips.nodes, slid, strict=True))
    curve = material_curve(cable, shape, elastic, moving)
    if grip.elements is not None:
        start_elements(cable, curve, shape, replace(grip, dissipated=dissipated))
        return
    ended = replace(
        grip,
        curve=curve,
        line=None,
        moving=np.zeros_like(grip.moving),
        known=grip.known and cable.taut,
        cone=None,  # the remaining elastic slip has the same force in the uncoupled law
        dissipated=dissipated,
    )
    cable.update(lateral=ended)


def slip_table(numbering: CableNumbering, shape: StripShape) -> Slips:
    """Nodes with stick-slip friction."""
    nodes: list[int] = []
    laws: list[Array] = [np.zeros((7, 0))]
    for c, _, friction, grip, slips in _slips(numbering, shape, "coulomb"):
        bounds, eps, _ = grip.law(slips.supports, friction.tolerance * slips.size)
        nodes += [numbering.row(c, k) for k in slips.nodes]
        across = np.where(np.array([len(s) == 1 for s in slips.supports]), 1 / slips.size, 0.0)
        laws.append(np.array([slips.slope, slips.offset, bounds, eps, *(across * slips.left.T)]))
    rows, law = np.array(nodes, dtype=np.int64), np.concatenate(laws, axis=1)
    own = numbering.strip.simplices.owner[numbering.on[rows]] == numbering.rank
    slides = numbering.nodes.slides[rows]
    on_edge, at_vertex = np.flatnonzero(own & slides), np.flatnonzero(own & ~slides)
    points, of_edges = numbering.points_now(), rows[on_edge]
    pointers, blocks = numbering.lines(numbering.on[of_edges], points)
    shifts = numbering.shift_blocks_at(rows[at_vertex])
    pointers = np.append(pointers, pointers[-1] + 1 + np.arange(len(shifts)))
    places = np.append(points.place[of_edges] + 1, np.zeros(len(shifts)))
    law = law[:, np.append(on_edge, at_vertex)]
    slope, offset, bound, eps = law[:4].copy()
    return Slips(
        pointers.astype(np.int32), np.append(blocks, shifts).astype(np.int32),
        places.astype(np.int32), slope, offset, bound, eps, law[4:].T.copy(),
    )  # fmt: skip


def element_table(numbering: CableNumbering, shape: StripShape) -> FrictionElements:
    """The paper's friction elements."""
    blocks: list[tuple[int, int, int]] = []
    slopes: list[Array] = [np.zeros((0, 3, 3))]
    laws: list[Array] = [np.zeros((3, 0))]
    owner = numbering.strip.simplices.owner
    for c, _, friction, grip, slips in _slips(numbering, shape, "step"):
        own = [owner[numbering.on[numbering.row(c, k)]] == numbering.rank for k in slips.nodes]
        for k, edge in itertools.compress(zip(slips.nodes, slips.supports, strict=True), own):
            first, last = (numbering.vertex(v) for v in edge)
            blocks.append((first, numbering.block(c, k), last))
        elements, rows = grip.elements, grip.rows(slips.supports)
        assert elements is not None
        bounds, eps, _ = grip.law(slips.supports, friction.tolerance * slips.size)
        laws.append(np.array([elements.offset[rows], bounds, eps])[:, own])
        ends = np.array(slips.supports).reshape(-1, 2)
        at_last = (elements.vertices[rows] == ends[:, 1]).astype(float)
        weights = np.stack([at_last - 1, np.ones_like(at_last), -at_last], axis=1)
        slopes.append((weights[:, :, None] * elements.left[rows][:, None])[own])
    offset, bound, eps = np.concatenate(laws, axis=1).copy()
    table = np.array(blocks, dtype=np.int32).reshape(-1, 3)
    return FrictionElements(table, np.concatenate(slopes), offset, bound, eps)


def note_rows(numbering: CableNumbering) -> None:
    """Note which vertices slide with the taut cables along rows."""
    shifting = set(ints(numbering.shifts.vertices))
    for cable in numbering.cables:
        grip = cable.state.law.lateral
        if cable.taut and grip is not None and cable.state.laid.line is not None:
            on = (n.point for n in cable.state.nodes if n.point is not None)
            own = tuple(p.support for p in on if len(p.support) == 1 and p.support[0] in shifting)
            if own != grip.shifting:
                cable.update(lateral=replace(grip, shifting=own))


def _slips(
    numbering: CableNumbering, shape: StripShape, law: str
) -> Iterator[tuple[int, LaidCable, Friction, LateralFrictionState, NodeSlips]]:
    """Slips of the nodes of taut cables with a given friction law."""
    for c, cable in enumerate(numbering.cables):
        friction, grip = cable.cable.sideways, cable.state.law.lateral
        if cable.taut and friction is not None and grip is not None and friction.law == law:
            yield c, cable, friction, grip, node_slips(cable, grip.curve, shape, grip.line)
