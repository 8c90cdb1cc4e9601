"""Slip of a cable on the membrane at the nodes with friction.

The history is a curve on the stress-free membrane: the cable's line at the end of the last load
step. It is independent of edges, so it survives sliding into other cells. The slip of a fold point
is the signed distance of its material place from that curve, positive to the left of the cable,
plus the remaining elastic slip: within a small slip eps friction is elastic, to prevent creep.

The friction force is perpendicular to the cable's own line, which may turn in a load step. So each
update of the forces takes the present line, with the slips so far, as the origin of further slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import runs
from crms_fenicsx.energy.terms.lateral_friction import coulomb_forces
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, cross
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.foundation.surface.points import Support
from crms_fenicsx.model.friction import Friction, LateralFrictionState, MaterialCurve
from crms_fenicsx.model.laid_cable import LaidCable


def succession(
    old: Sequence[Support], now: Sequence[Support]
) -> tuple[list[int], list[int], list[tuple[slice, list[int]]]]:
    """New nodes that persist, their old numbers, and ranges of old nodes with their heirs."""
    was = {support: k for k, support in enumerate(old)}
    stays = [k for k, support in enumerate(now) if support in was]
    rows = [was[now[k]] for k in stays]
    if sorted(rows) != rows:  # not a successor of the old path
        stays, rows = [], []
    starts, ends = [-1, *stays], [*stays, len(now)]
    was_starts, was_ends = [-1, *rows], [*rows, len(old)]
    heirs = []
    for a, b, c, d in zip(starts, ends, was_starts, was_ends, strict=True):
        new = list(range(a + 1, b)) or [k for k in (a, b) if 0 <= k < len(now)]
        if new and d > c + 1:
            heirs.append((slice(c + 1, d), new))
    return stays, rows, heirs


@dataclass(frozen=True)
class NodeSlips:
    """Slips of sliding nodes, linear in their edge fractions s: ``slope * s + offset``."""

    nodes: list[int]  # (n,) their numbers
    supports: list[Support]  # their edges
    slope: Array  # (n,), with
    offset: Array  # (n,) (length)
    slip: Array  # (n,) at the current places (length)
    size: Array  # (n,) size of the surrounding stress-free cells (length)
    moving: Array  # (n,) sliding direction of the curve there in the last load step
    known: Booleans  # (n,) whether the cable was on the membrane there before


def material_curve(
    cable: LaidCable,
    shape: StripShape,
    elastic: dict[int, float] | None = None,
    moving: dict[int, float] | None = None,
) -> MaterialCurve:
    """The cable's current curve, with elastic slips (length) and sliding directions by node."""
    elastic, moving = elastic or {}, moving or {}
    parts = runs(cable)
    nodes = [k for run in parts for k in run]
    points = np.array([material_place(cable, k, shape) for k in nodes]).reshape(-1, 3)
    return MaterialCurve(
        points,
        arc_lengths(points),
        np.repeat(np.arange(len(parts)), [len(run) for run in parts]),
        np.array([elastic.get(k, 0.0) for k in nodes]),
        np.array([moving.get(k, 0.0) for k in nodes]),
    )


def slipped_line(cable: LaidCable, slips: NodeSlips, shape: StripShape) -> MaterialCurve | None:
    """The cable's current curve, with the slips of the load step so far; None if it touches the
    membrane at single points only."""
    nodes = np.array([k for run in runs(cable) for k in run])
    line = material_curve(cable, shape)
    known = np.isin(nodes, np.array(slips.nodes)[slips.known])
    if not len(line.joined):
        return None
    if not known.any():
        return line
    slip_of = dict(zip(slips.nodes, slips.slip, strict=True))
    values = [slip_of[k] for k in nodes[known]]
    return replace(line, elastic=np.interp(line.arc, line.arc[known], values))


def material_place(cable: LaidCable, k: int, shape: StripShape) -> Array:
    """Position of a node on the stress-free membrane, (3,)."""
    ids, weights = cable.interpolation(k)
    return np.asarray(np.dot(weights, [shape.stress_free_at(i) for i in ids]))


def node_slips(
    cable: LaidCable, curve: MaterialCurve, shape: StripShape, line: MaterialCurve | None = None
) -> NodeSlips:
    """Slips of a cable's sliding contacts, counted from a line of later in the step, if any; zero
    where it was not on the membrane before."""
    line = line or curve
    nodes, supports = [], []
    for k in cable.contacts():
        point = cable.state.nodes[k].point
        if cable.state.nodes[k].slides and point is not None:
            nodes.append(k)
            supports.append(point.support)
    ends = np.array([[shape.stress_free_at(v) for v in s] for s in supports]).reshape(-1, 2, 3)
    fractions, sides = cable.state.fractions[nodes], ends[:, 1] - ends[:, 0]
    places = ends[:, 0] + fractions[:, None] * sides
    at, _, parts = curve.nearest(places)
    size = np.array([shape.stress_free_size(s) for s in supports])
    around = (shape.stress_free_normals[shape.strip.solid_rows(s)] for s in supports)
    normals = np.array([own.sum(axis=0) for own in around]).reshape(-1, 3)
    first, last = np.full((2, len(nodes)), np.nan)
    for part in np.unique(parts[parts >= 0]):
        own = curve.arc[curve.part == part]
        first[parts == part], last[parts == part] = own[0], own[-1]
    # Elsewhere the cable has touched down in this step and has no slip yet.
    known = (at >= first - size) & (at <= last + size)
    slope, offset, moving = np.zeros((3, len(nodes)))
    moving[known] = curve.history(at[known], parts[known])[1]
    at, feet, parts = line.nearest(places[known])
    left = cross(normals[known], line.tangents(at, parts, size[known]))
    left /= np.linalg.norm(left, axis=1)[:, None]
    slope[known] = np.sum(sides[known] * left, axis=1)
    offset[known] = np.sum((ends[known, 0] - feet) * left, axis=1)
    offset[known] += line.history(at, parts)[0]
    slip = slope * fractions + offset
    return NodeSlips(nodes, supports, slope, offset, slip, size, moving, known)


def slip_forces(friction: Friction, grip: LateralFrictionState, slips: NodeSlips) -> Array:
    """Stick-slip friction forces of sliding nodes, (n,) (force)."""
    bounds, eps, _ = grip.law(slips.supports, friction.tolerance * slips.size)
    return coulomb_forces(slips.slip, bounds, eps)
