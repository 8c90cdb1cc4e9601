"""Coupled lateral and axial friction: the friction cone.

A node with contact force N has the forces ``mu N u`` sideways and ``along N v`` along the cable,
with ``u^2 + v^2 <= 1``. It consists of a spring in each direction, in series with one slider for
both. The springs are those of the uncoupled laws, with force ``y (2 - y)`` at the elastic slip y
eps; the slider moves in the direction of largest dissipation,

    mu s' : along t' = u : v

with s' and t' the slips of the load step sideways and along, minus the elastic ones. The energy of
springs and slider is convex in both slips. It is minimised alternately in each slip with the other
one fixed. Each law then has the uncoupled form with another bound and with a width that grows with
the other slip; both are exact at the slip of the given state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import held_nodes, wrap_angles
from crms_fenicsx.cabling.friction.slip import node_slips
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.friction import Friction, LateralFrictionState, LateralLaw
from crms_fenicsx.model.laid_cable import LaidCable

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
        return np.asarray(np.maximum(self.work - self.eps * elastic_part(share), 0.0))

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
        return bound, width, np.where(slides, elastic_part(share), 1.0)


def elastic_part(share: Array) -> Array:
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
    """Lateral law reduced by axial friction at the nodes with friction; None if unchanged."""
    friction, axial = cable.cable.sideways, cable.state.axial
    assert friction is not None
    if not cable.cable.cone or axial is None or not len(axial.spans):
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
    fixed = np.array([not cable.state.nodes[k].slides for k in nodes], dtype=bool)
    law[:, fixed] = 1.0
    law[0, fixed] = np.sqrt(1 - along.mobilised[fixed] ** 2)
    return LateralLaw(*law)


def law_along(sideways: Slip, along: Slip) -> tuple[Array, Array, Array]:
    """Axial law reduced by lateral friction, as in `LateralLaw`."""
    u, v = shares(sideways, along)
    return along.law(v, sideways.plastic(u))
