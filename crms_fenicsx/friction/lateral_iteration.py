"""Passes that settle the friction forces sideways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.contact_force import contact_forces
from crms_fenicsx.friction.aitken import AitkenRelaxation
from crms_fenicsx.friction.cone import law_sideways
from crms_fenicsx.friction.gripped_nodes import held_nodes
from crms_fenicsx.friction.slip import node_slips, slip_forces
from crms_fenicsx.model.friction_history import Grip
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array

SLIDES = 0.05
"""Slip in a load step, relative to the cells' size, from which on a node slides: with less, noise
would set off an avalanche where the static coefficient is larger; with much more it comes late."""

SETTLED, NEARLY = 1e-3, 0.02
"""Change of the bounds, relative to their sum, below which they have settled, and nearly so."""

LEAST_SHARE = 0.1
"""Least part of a change in how the bounds are divided that is taken."""

STEEPEST = 0.9
"""Largest part of a change of their sum that is taken to come back from the state."""

AGAINST = 30.0
"""As `STEEPEST`, where the state answers a larger sum by a smaller one."""


class LateralIteration:
    """Brings the bounds of one cable in a load step to those of the state that they lead to.

    The bounds are proportional to the tension, and a stiff cable that slides soon loses it: taking
    their sum over would converge slowly, so it is found by the secant method. How it is divided
    among the nodes can go back and forth between two states, so of a change of that a part is
    taken.
    """

    settled = SETTLED

    def __init__(self, cable: LaidCable) -> None:
        self.cable = cable
        self.change = np.inf
        self._forget()

    def _forget(self) -> None:
        self._pace = AitkenRelaxation(LEAST_SHARE)
        self._sums: tuple[float, float] | None = None

    def renew(self, shape: StripShape) -> float:
        """Take the bounds from the current state; return their change, relative to their sum."""
        cable, grip = self.cable, self.cable.grip
        assert grip is not None
        if not cable.taut:
            return 0.0
        # Only what slides while the bounds change little slides because it must.
        nearly = self.change < NEARLY
        found, moving = _bounds(cable, grip, shape, settled=nearly)
        self.change = _change(grip.bounds, found)
        if self.change <= SETTLED and not nearly:
            found, moving = _bounds(cable, grip, shape, settled=True)
            self.change = _change(grip.bounds, found)
        total, used = float(found.sum()), float(grip.bounds.sum())
        coupled = replace(grip, cone=law_sideways(cable, grip, shape))
        if coupled.cone is not None and used > 0.0:
            friction = cable.cable.sideways
            assert friction is not None
            slips = node_slips(cable, grip.curve, shape)
            changes = slip_forces(friction, coupled, slips) - slip_forces(friction, grip, slips)
            self.change = max(self.change, float(np.abs(changes).sum()) / used)
        if self.change <= SETTLED:  # the state found stays the one that belongs to its bounds
            return self.change
        if not grip.known or np.any(moving != grip.moving):  # another law from here on
            self._forget()
        elif total > 0.0 < used:
            shares = grip.bounds / used
            change = found / total - shares
            part = self._pace.factor(grip.supports, change)
            found = np.asarray(self._add_up(used, total) * (shares + part * change))
        cable.update(grip=replace(coupled, bounds=found, moving=moving, known=True))
        return self.change

    def _add_up(self, used: float, found: float) -> float:
        """Where the sum that is used and that which is found will be equal, by their logarithms."""
        here, slope = (float(np.log(used)), float(np.log(found))), 0.0
        if self._sums is not None and here[0] != self._sums[0]:
            slope = (here[1] - self._sums[1]) / (here[0] - self._sums[0])
        self._sums = here
        step = (here[1] - here[0]) / (1 - min(max(slope, -AGAINST), STEEPEST))
        return float(np.exp(here[0] + step))


def _change(used: Array, found: Array) -> float:
    """Change of the bounds, relative to their sum."""
    total, before = float(found.sum()), float(used.sum())
    if before == 0.0 == total:
        return 0.0
    return float(np.abs(found - used).sum()) / max(total, 1e-3 * before)


def _bounds(cable: LaidCable, grip: Grip, shape: StripShape, settled: bool) -> tuple[Array, Array]:
    """Friction bounds in the current state (force), and the directions in which nodes slide."""
    friction = cable.cable.sideways
    assert friction is not None
    slips = node_slips(cable, grip.curve, shape)
    moving = grip.moving.copy()
    rows = [grip.row_of[support] for support in slips.supports]
    if settled:
        starts = (np.abs(slips.slip) > SLIDES * slips.size) & (moving[rows] == 0.0)
        moving[rows] = np.where(starts, np.sign(slips.slip), moving[rows])
    in_motion = (moving[rows] != 0.0) | (slips.moving * slips.slip > 0.0)
    coefficients = np.full(len(grip.supports), friction.at_rest)
    coefficients[rows] = np.where(in_motion, friction.mu, friction.at_rest)
    return coefficients * contact_forces(cable, shape).bearing[held_nodes(cable)], moving
