"""Slip of a cable on the membrane at the nodes with friction.

The history is a curve on the stress-free membrane: the cable's line at the end of the last load
step. It is independent of edges, so it survives sliding into other cells. The slip of a fold point
is the signed distance of its material place from that curve, positive to the left of the cable,
plus the remaining elastic slip: within a small slip eps friction is elastic, to prevent creep. A
cable along a row of vertices slips as their stress-free places shift.

The friction force is perpendicular to the cable's own line, which may turn in a load step. So each
update of the forces takes the present line, with the slips so far, as the origin of further slip.

Friction along the cable limits it, too, by the friction cone. A node with contact force N has the
forces ``mu N u`` sideways and ``along N v`` along the cable, with ``u^2 + v^2 <= 1``. It consists
of a spring in each direction, in series with one slider for both. The springs are those of the
uncoupled laws, with force ``y (2 - y)`` at the elastic slip y eps; the slider moves in the
direction of largest dissipation,

    mu s' : along t' = u : v

with s' and t' the slips of the load step sideways and along, minus the elastic ones. The energy of
springs and slider is convex in both slips. It is minimised alternately in each slip with the other
one fixed. Each law then has the uncoupled form with another bound and with a width that grows with
the other slip; both are exact at the slip of the given state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import held_nodes, runs, wrap_angles
from crms_fenicsx.energy.terms.lateral_friction import coulomb_forces
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, cross
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.foundation.surface.points import Support
from crms_fenicsx.model.friction import Friction, LateralFrictionState, LateralLaw, MaterialCurve
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
    """Slips of sliding nodes, linear in their edge fractions s: ``slope * s + offset``; at vertices
    of rows s is the shift across the row in cells."""

    nodes: list[int]  # (n,) their numbers
    supports: list[Support]  # their edges or vertices
    slope: Array  # (n,), with
    offset: Array  # (n,) (length)
    slip: Array  # (n,) at the current places (length)
    size: Array  # (n,) size of the surrounding stress-free cells (length)
    moving: Array  # (n,) sliding direction of the curve there in the last load step
    known: Booleans  # (n,) whether the cable was on the membrane there before
    left: Array  # (n, 3) direction of positive slip on the stress-free membrane; zero if unknown


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
    line, grip = line or curve, cable.state.law.lateral
    shifting = set() if grip is None else {*grip.shifting}
    nodes, supports = [], []
    for k in cable.contacts():
        node = cable.state.nodes[k]
        if node.point is not None and (node.slides or node.support in shifting):
            nodes.append(k)
            supports.append(node.support)
    on_row = np.array([len(s) == 1 for s in supports], dtype=bool)
    ends = np.array([[shape.stress_free_at(v) for v in (s[0], s[-1])] for s in supports])
    ends = ends.reshape(-1, 2, 3)
    fractions = np.where(on_row, 0.0, cable.state.fractions[nodes])
    sides = ends[:, 1] - ends[:, 0]
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
    all_left = np.zeros((len(nodes), 3))
    moving[known] = curve.history(at[known], parts[known])[1]
    at, feet, parts = line.nearest(places[known])
    left = cross(normals[known], line.tangents(at, parts, size[known]))
    left /= np.linalg.norm(left, axis=1)[:, None]
    all_left[known] = left
    slope[known] = np.where(on_row[known], size[known], np.sum(sides[known] * left, axis=1))
    offset[known] = np.sum((ends[known, 0] - feet) * left, axis=1)
    offset[known] += line.history(at, parts)[0]
    slip = slope * fractions + offset
    return NodeSlips(nodes, supports, slope, offset, slip, size, moving, known, all_left)


def slip_forces(friction: Friction, grip: LateralFrictionState, slips: NodeSlips) -> Array:
    """Stick-slip friction forces of sliding nodes, (n,) (force)."""
    bounds, eps, _ = grip.law(slips.supports, friction.tolerance * slips.size)
    return coulomb_forces(slips.slip, bounds, eps)


BISECTIONS = 60


@dataclass(frozen=True)
class Slip:
    """Slips of nodes in one direction, (n,)."""

    work: Array  # absolute slips times the coefficient of friction (length)
    eps: Array  # slip at which friction is mobilised, times the coefficient (length)

    @classmethod
    def of(cls, coefficient: float, slips: Array, eps: Array) -> Slip:
        """Create from signed slips and mobilisation slips, (n,) (length)."""
        return cls(coefficient * np.abs(slips), coefficient * eps)

    @property
    def mobilised(self) -> Array:
        """Force of the spring alone, relative to the bound."""
        y = np.minimum(self.work / self.eps, 1.0)
        return np.asarray(y * (2 - y))

    def plastic(self, share: Array) -> Array:
        """Plastic slip at a share of the bound (length)."""
        return np.asarray(np.maximum(self.work - self.eps * _elastic_part(share), 0.0))

    def law(self, share: Array, other: Array) -> tuple[Array, Array, Array]:
        """Law of these slips with the other ones fixed, as in `LateralLaw`."""
        # Where this slip is small relative to the other, the force is share = work/other; the width
        # gives the law this slope.
        slides = (other > 0.0) | (self.plastic(share) > 0.0)
        width = 1 + 2 * other / self.eps
        y = np.minimum(self.work / self.eps / width, 1.0)
        # The share vanishes with the slip, at the slope of the law.
        small = y < 1e-9
        bound = np.where(small, 1.0, share / np.where(small, 1.0, y * (2 - y)))
        return bound, width, np.where(slides, _elastic_part(share), 1.0)


def _elastic_part(share: Array) -> Array:
    """Elastic slip, relative to eps, for a force relative to the bound."""
    return np.asarray(1 - np.sqrt(np.maximum(1 - share, 0.0)))


def shares(a: Slip, b: Slip) -> tuple[Array, Array]:
    """Forces in both directions, relative to their bounds, (n,) and (n,)."""
    u, v = a.mobilised, b.mobilised
    # The angle lies between those at which b alone, and a alone, would just not slide.
    low, high = np.arccos(np.minimum(v, 1.0)), np.arcsin(np.minimum(u, 1.0))
    slides = u**2 + v**2 > 1.0
    for _ in range(BISECTIONS):
        angle = (low + high) / 2
        sine, cosine = np.sin(angle), np.cos(angle)
        more = a.plastic(sine) * cosine > b.plastic(cosine) * sine
        low, high = np.where(more, angle, low), np.where(more, high, angle)
    return np.where(slides, sine, u), np.where(slides, cosine, v)


def full_slips(cable: LaidCable, size: Array, wrap: Array) -> Array:
    """Axial slips at which uncoupled friction is mobilised, (n,) (length)."""
    # relative to the elongation of one cell of cable under the node's friction force, so that
    # sticking is much stiffer than the cable for any mesh and cable stiffness
    friction = cable.cable.friction
    assert isinstance(friction, Friction)
    strain = cable.length / cable.L0 - 1
    return np.where(wrap > 0, friction.tolerance * size * wrap * strain, 1.0)


def slips_sideways(
    cable: LaidCable, grip: LateralFrictionState, shape: StripShape, nodes: list[int]
) -> Slip:
    """Lateral slips of the given nodes; zero at vertices."""
    friction = cable.cable.sideways
    assert friction is not None
    found = node_slips(cable, grip.curve, shape, grip.line)
    slip_of = dict(zip(found.nodes, found.slip, strict=True))
    size = np.array([shape.stress_free_size(cable.state.nodes[k].support) for k in nodes])
    slips = np.array([slip_of.get(k, 0.0) for k in nodes])
    return Slip.of(friction.mu, slips, friction.tolerance * size)


def law_sideways(
    cable: LaidCable, grip: LateralFrictionState, shape: StripShape
) -> LateralLaw | None:
    """Lateral law reduced by axial friction at the nodes with friction; None if unchanged, as of a
    cable with a part in tension that as a whole is no longer than unstressed."""
    friction, axial = cable.cable.sideways, cable.state.law.axial
    assert friction is not None
    if not cable.cable.cone or axial is None or not len(axial.spans) or cable.length <= cable.L0:
        return None
    nodes = held_nodes(cable)
    row_of = {support: row for row, support in enumerate(axial.supports)}
    rows = [row_of.get(support, -1) for support in grip.supports]
    slips = np.where(np.array(rows) < 0, 0.0, axial.slips[rows])
    sideways = slips_sideways(cable, grip, shape, nodes)
    size = np.asarray(sideways.eps / (friction.mu * friction.tolerance), dtype=np.float64)
    wrap = friction.along * wrap_angles(cable, shape)[nodes]
    along = Slip.of(friction.along, slips, full_slips(cable, size, wrap))
    u, v = shares(sideways, along)
    law = np.array(sideways.law(u, along.plastic(v)))
    # A node on a vertex cannot slip sideways: it may use the remaining capacity.
    slides = [
        cable.state.nodes[k].slides or s in grip.shifting
        for k, s in zip(nodes, grip.supports, strict=True)
    ]
    fixed = ~np.array(slides, dtype=bool)
    law[:, fixed] = 1.0
    law[0, fixed] = np.sqrt(1 - along.mobilised[fixed] ** 2)
    return LateralLaw(*law)


def law_along(sideways: Slip, along: Slip) -> tuple[Array, Array, Array]:
    """Axial law reduced by lateral friction, as in `LateralLaw`."""
    u, v = shares(sideways, along)
    return along.law(v, sideways.plastic(u))
