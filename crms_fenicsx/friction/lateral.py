"""Lateral friction: bounds and slips of a load step, and their tables.

The bound F = mu N (3.2-3) depends on the unknown state. It is constant during a minimisation, then
updated from the result, until it settles.

While bounds are constant the path may change. Persisting nodes keep their bounds; those of
vanishing nodes are shared among their successors, so that the sum, and with it the energies of the
compared paths, do not change for another reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.contact.contact_force import (
    contact_forces,
    directions,
    held_nodes,
    paper_forces,
    supports_of,
    turns,
)
from crms_fenicsx.energies.lateral_friction import Slips
from crms_fenicsx.energies.paper.cable_elements import FrictionElements
from crms_fenicsx.energies.smooth_coulomb import stored_and_lost
from crms_fenicsx.friction.passes import SLIDES
from crms_fenicsx.friction.slip import (
    NodeSlips,
    material_curve,
    node_slips,
    slip_forces,
    succession,
)
from crms_fenicsx.meshes.triangles import norm
from crms_fenicsx.model.friction import Friction, LateralFrictionState, LateralLaw
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array

NOISE = 1e-6
"""Negligible lateral force, relative to the tension."""
LEAST_STRAIN = 1e-4
"""Least strain for the force by which a cable first sticks."""

LEAST_RISE = 1e-3
"""Rise of the tension, relative to it, for bounds to grow: an idle cable's smoothing gives less."""


def start_step(cable: LaidCable, shape: StripShape) -> None:
    """Prepare a cable with friction for a load step."""
    # A cable not yet in tension sticks at first, as no bound is known. So that a tightened one
    # sticks too, its bounds grow in advance with its tension in place: with the last step's bounds
    # it could slide until it is slack, a self-sustaining state without friction.
    if cable.cable.sideways is None:
        return
    if cable.lateral is None:
        cable.update(
            lateral=LateralFrictionState(material_curve(cable, shape), (), np.zeros(0), np.zeros(0))
        )
    remap(cable)
    grip, friction = cable.lateral, cable.cable.sideways
    assert grip is not None
    if friction.law == "step":
        bounds = friction.mu * paper_forces(cable)[held_nodes(cable)]
        ways = _ways(cable, grip, shape)
        cable.update(lateral=replace(grip, bounds=bounds, moving=ways, known=True))
        return
    expected = _tension_in_place(cable)
    rises = expected > (1 + LEAST_RISE) * cable.tension
    if not grip.known or (rises and not (cable.tension > 0.0 and grip.bounds.any())):
        force = max(cable.tension, expected, cable.cable.EA * LEAST_STRAIN)
        cable.update(lateral=replace(grip, bounds=np.full(len(grip.supports), force), known=False))
    elif rises:
        cable.update(lateral=replace(grip, bounds=grip.bounds * (expected / cable.tension)))


def _tension_in_place(cable: LaidCable) -> float:
    """Tension (force) of a cable in its last place, with its ends at their current positions."""
    # from its old length, as new crossings are not in equilibrium yet
    length, places = cable.length, cable.positions[cable.contacts()]
    if cable.ends_before is not None:
        beside = places[[1, -2]]
        chords = norm(places[[0, -1]] - beside) - norm(cable.ends_before - beside)
        length += float(chords.sum())
    return cable.cable.EA * (length / cable.L0 - 1)


def _ways(cable: LaidCable, grip: LateralFrictionState, shape: StripShape) -> Array:
    """Sliding directions of nodes: that of the cable's pull, or that of the last step."""
    numbers = held_nodes(cable)
    pull = contact_forces(cable, shape).lateral[numbers]
    ways: Array = np.sign(pull) * (np.abs(pull) > NOISE * cable.tension)
    slips = node_slips(cable, grip.curve, shape)
    rows = grip.rows(slips.supports)
    ways[rows] = np.where(ways[rows] != 0.0, ways[rows], slips.moving)
    return ways


def remap(cable: LaidCable) -> None:
    """Transfer the bounds to the cable's current nodes."""
    grip = cable.lateral
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
    cable.update(lateral=replace(grip, supports=now, bounds=bounds, moving=moving, cone=cone))


def energies(cable: LaidCable, shape: StripShape) -> tuple[float, float]:
    """Energies that a cable's friction stores, and has dissipated in this step."""
    friction, grip = cable.cable.sideways, cable.lateral
    if friction is None or grip is None or not cable.taut:
        return 0.0, 0.0
    slips = node_slips(cable, grip.curve, shape)
    if friction.law == "step":
        rows = grip.rows(slips.supports)
        return 0.0, float(np.sum(grip.bounds[rows] * grip.moving[rows] * slips.slip))
    law = grip.law(slips.supports, friction.tolerance * slips.size)
    return stored_and_lost(slips.slip, *law)


def friction_forces(cable: LaidCable, shape: StripShape) -> Array:
    """Friction force (n,) at nodes with friction, positive on a cable sliding left (force)."""
    friction, grip = cable.cable.sideways, cable.lateral
    assert friction is not None and grip is not None
    # a node on a vertex cannot slip: friction balances the pull, up to the bound
    pull = contact_forces(cable, shape).lateral[held_nodes(cable)]
    forces = np.clip(pull, -grip.bounds, grip.bounds)
    slips = node_slips(cable, grip.curve, shape)
    rows = grip.rows(slips.supports)
    if friction.law == "step":
        forces[rows] = grip.bounds[rows] * grip.moving[rows]
    else:
        forces[rows] = slip_forces(friction, grip, slips)
    return np.asarray(forces)


def end_step(cable: LaidCable, shape: StripShape) -> None:
    """End a load step: slips then count from the cable's current place."""
    friction, grip = cable.cable.sideways, cable.lateral
    if friction is None or grip is None:
        return
    _, dissipated = energies(cable, shape)
    elastic: dict[int, float] = {}
    moving: dict[int, float] = {}
    if cable.taut:
        slips = node_slips(cable, grip.curve, shape)
        most = grip.law(slips.supports, friction.tolerance * slips.size)[2]
        elastic = dict(zip(slips.nodes, np.clip(slips.slip, -most, most), strict=True))
        slid = np.sign(slips.slip) * (np.abs(slips.slip) > SLIDES * slips.size)
        moving = dict(zip(slips.nodes, slid, strict=True))
    curve = material_curve(cable, shape, elastic, moving)
    ended = replace(
        grip,
        curve=curve,
        moving=np.zeros_like(grip.moving),
        known=grip.known and cable.taut,
        cone=None,  # the remaining elastic slip has the same force in the uncoupled law
        dissipated=grip.dissipated + dissipated,
    )
    cable.update(lateral=ended)


def slip_table(numbering: CableNumbering, shape: StripShape) -> Slips:
    """Nodes with stick-slip friction."""
    nodes: list[int] = []
    laws: list[Array] = [np.zeros((4, 0))]
    for c, _, friction, grip, slips in _slips(numbering, shape, "coulomb"):
        bounds, eps, _ = grip.law(slips.supports, friction.tolerance * slips.size)
        nodes += [numbering.row(c, k) for k in slips.nodes]
        laws.append(np.array([slips.slope, slips.offset, bounds, eps]))
    rows, law = np.array(nodes, dtype=np.int64), np.concatenate(laws, axis=1)
    own = numbering.strip.simplices.owner[numbering.on[rows]] == numbering.rank
    rows, points = rows[own], numbering.points_now()
    pointers, blocks = numbering.lines(numbering.on[rows], points)
    places = (points.place[rows] + 1).astype(np.int32)
    return Slips(pointers.astype(np.int32), blocks, places, *law[:, own].copy())


def element_table(numbering: CableNumbering, shape: StripShape) -> FrictionElements:
    """The paper's friction elements."""
    blocks, forces, offsets, owner = [], [], [], numbering.strip.simplices.owner
    for c, cable, _, grip, slips in _slips(numbering, shape, "step"):
        direction = turns(cable)
        for k, edge, slip in zip(slips.nodes, slips.supports, slips.slip, strict=True):
            if owner[numbering.on[numbering.row(c, k)]] != numbering.rank:
                continue
            vertex = edge[int(cable.fractions[k] > 0.5)]
            work = grip.at(edge) * grip.moving[grip.row_of[edge]]
            force = work * directions(cable, [k], shape, *(way[None] for way in direction[k]))[1][0]
            blocks.append((numbering.vertex(vertex), numbering.block(c, k)))
            forces.append(force)
            # The work of a node added in this step starts with its slip.
            offsets.append(work * slip - float(force @ (cable.positions[k] - shape.at(vertex))))
    return FrictionElements(
        np.array(blocks, dtype=np.int32).reshape(-1, 2),
        np.array(forces, dtype=float).reshape(-1, 3),
        np.array(offsets, dtype=float),
    )


def _slips(
    numbering: CableNumbering, shape: StripShape, law: str
) -> Iterator[tuple[int, LaidCable, Friction, LateralFrictionState, NodeSlips]]:
    """Slips of the nodes of taut cables with a given friction law."""
    for c, cable in enumerate(numbering.cables):
        friction, grip = cable.cable.sideways, cable.lateral
        if cable.taut and friction is not None and grip is not None and friction.law == law:
            yield c, cable, friction, grip, node_slips(cable, grip.curve, shape)
