"""Friction sideways and along a cable together: the cone.

A node on which the contact force N presses has the forces ``mu N u`` sideways and ``along N v``
along the cable, with ``u^2 + v^2 <= 1``. It gives way as a spring in each direction does, in series
with a slider for both: the springs are those of the laws on their own, force ``y (2 - y)`` at the
elastic slip y eps, and the slider goes in the direction that dissipates most,

    mu s' : along t' = u : v

with s' and t' the slips in the load step sideways and along, less the elastic ones. The energy of
springs and slider is a convex function of both slips. Its minimisation alternates between them: in
each law the other slip is held. A law of one slip alone has the same form, with another bound, and
a width that grows with the other slip; both are exact where the slip is that of the state found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.contact.contact_force import held_nodes, wrap_angles
from crms_fenicsx.friction.slip import node_slips
from crms_fenicsx.model.friction import Friction, LateralFrictionState, SidewaysLaw
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array

BISECTIONS = 60


@dataclass(frozen=True)
class Slip:
    """Slips of nodes in one direction, (n,)."""

    work: Array  # absolute slips times the coefficient of friction (length)
    eps: Array  # slip at which friction is mobilised, times the coefficient (length)

    @classmethod
    def of(cls, coefficient: float, slips: Array, eps: Array) -> Slip:
        """From signed slips and the ones at which friction is mobilised, (n,) (length)."""
        return cls(coefficient * np.abs(slips), coefficient * eps)

    @property
    def mobilised(self) -> Array:
        """Force that the spring alone would have, relative to the bound."""
        y = np.minimum(self.work / self.eps, 1.0)
        return np.asarray(y * (2 - y))

    def plastic(self, share: Array) -> Array:
        """What is not elastic, with a share of the bound (length)."""
        return np.asarray(np.maximum(self.work - self.eps * elastic_part(share), 0.0))

    def law(self, share: Array, other: Array) -> tuple[Array, Array, Array]:
        """Law of these slips while the other ones are held, as in `SidewaysLaw`."""
        # Where this slip is small beside the other one, the force is share = work/other: the width
        # is that with which the law has this slope.
        slides = (other > 0.0) | (self.plastic(share) > 0.0)
        width = 1 + 2 * other / self.eps
        y = np.minimum(self.work / self.eps / width, 1.0)
        # As the slip vanishes, so does the share, by the slope of the law.
        small = y < 1e-9
        bound = np.where(small, 1.0, share / np.where(small, 1.0, y * (2 - y)))
        return bound, width, np.where(slides, elastic_part(share), 1.0)


def elastic_part(share: Array) -> Array:
    """Elastic slip, relative to eps, with a force relative to the bound."""
    return np.asarray(1 - np.sqrt(np.maximum(1 - share, 0.0)))


def shares(a: Slip, b: Slip) -> tuple[Array, Array]:
    """Forces in the two directions, relative to their bounds, (n,) and (n,)."""
    u, v = a.mobilised, b.mobilised
    # The force turns from where b alone would not slide to where a alone would not.
    low, high = np.arccos(np.minimum(v, 1.0)), np.arcsin(np.minimum(u, 1.0))
    slides = u**2 + v**2 > 1.0
    for _ in range(BISECTIONS):
        angle = (low + high) / 2
        sine, cosine = np.sin(angle), np.cos(angle)
        more = a.plastic(sine) * cosine > b.plastic(cosine) * sine
        low, high = np.where(more, angle, low), np.where(more, high, angle)
    return np.where(slides, sine, u), np.where(slides, cosine, v)


def full_slips(cable: LaidCable, size: Array, wrap: Array) -> Array:
    """Slips along the cable at which friction is mobilised on its own, (n,) (length)."""
    # relative to what the force of a node that just holds stretches one cell by, so that sticking
    # is much stiffer than the cable on every mesh, however stiff the cable is
    friction = cable.cable.friction
    assert isinstance(friction, Friction)
    strain = cable.length / cable.L0 - 1
    return np.where(wrap > 0, friction.tolerance * size * wrap * strain, 1.0)


def slips_sideways(
    cable: LaidCable, grip: LateralFrictionState, shape: StripShape, nodes: list[int]
) -> Slip:
    """Slips sideways of some of a cable's nodes; none of those on vertices."""
    friction = cable.cable.sideways
    assert friction is not None
    found = node_slips(cable, grip.curve, shape)
    slip_of = dict(zip(found.nodes, found.slip, strict=True))
    size = np.array([shape.stress_free_size(cable.nodes[k].support) for k in nodes])
    slips = np.array([slip_of.get(k, 0.0) for k in nodes])
    return Slip.of(friction.mu, slips, friction.tolerance * size)


def law_sideways(
    cable: LaidCable, grip: LateralFrictionState, shape: StripShape
) -> SidewaysLaw | None:
    """The law sideways that friction along the cable leaves at the held nodes; None: unchanged."""
    friction, axial = cable.cable.sideways, cable.axial
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
    # A node on a vertex cannot slip sideways: it may take what is left.
    fixed = np.array([not cable.nodes[k].slides for k in nodes], dtype=bool)
    law[:, fixed] = 1.0
    law[0, fixed] = np.sqrt(1 - along.mobilised[fixed] ** 2)
    return SidewaysLaw(*law)


def law_along(sideways: Slip, along: Slip) -> tuple[Array, Array, Array]:
    """The law along the cable that friction sideways leaves, as in `SidewaysLaw`."""
    u, v = shares(sideways, along)
    return along.law(v, sideways.plastic(u))
