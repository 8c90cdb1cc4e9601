"""The equilibrium with the friction forces of its own state: solve, renew them, solve again."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from crms_fenicsx.equilibrium.contact_loop import ContactLoop
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.paths.tried_paths import TriedPaths

if TYPE_CHECKING:
    from crms_fenicsx.friction.axial_iteration import AxialIteration
    from crms_fenicsx.friction.lateral_iteration import LateralIteration

logger = logging.getLogger("crms_fenicsx")

MAX_PASSES = 30
"""How often friction forces are taken from the state that they have led to."""

PATIENCE = 12
"""How often they may be without their change becoming less: where the state answers a small change
of a force by a large one, as at the edge of lifting off, they go round in circles."""

Solve = Callable[[tuple[float, ...], bool], Outcome]
"""Finds an equilibrium with the friction forces that there are, or a state near to it."""


class FrictionLoop:
    """Solves one load step of cables with friction, or without any."""

    def __init__(self, contacts: ContactLoop, solve: Solve, tried: TriedPaths | None) -> None:
        self.contacts, self._solve, self.tried = contacts, solve, tried
        self.system, self.scene = contacts.system, contacts.scene

    def solve(self, h0_prestress: tuple[float, ...]) -> Outcome:
        """Solve, again and again until the friction forces are those of its own state. Collective.

        While these change much the states are worked out near their equilibrium only.
        """
        solve, lags = self._solve, self._lags()
        outcome = solve(h0_prestress, bool(lags))
        if not lags:
            return outcome
        from crms_fenicsx.friction.lateral_iteration import NEARLY

        rough = True
        change, least, waited = 0.0, math.inf, 0
        for passes in range(1, MAX_PASSES + 1):
            outcome = replace(outcome, passes=passes)
            if not outcome.converged:
                return outcome
            shape = self.scene.net.strip_shape()
            changes = [lag.renew(shape) for lag in lags]
            if all(c <= lag.settled for c, lag in zip(changes, lags, strict=True)):
                if not rough:
                    return outcome
                outcome, rough = outcome + self.contacts.solve((0.0,)), False
                continue
            change = max(changes)
            logger.debug("pass %d: friction forces change by %.2g", passes, change)
            least, waited = min(change, least), waited + 1 if change >= least else 0
            given_up = waited == PATIENCE or passes == MAX_PASSES
            if given_up and change > NEARLY:
                break
            if change > NEARLY and self.tried is not None:
                self.tried.rejected.clear()
            self.system.renew_friction()
            if change <= NEARLY and not any(cable.has_coulomb for cable in self.scene.cables):
                # Friction along a cable moves its path too little for others.
                solve = self.contacts.solve_in_cells
            rough = change > NEARLY
            outcome = outcome + solve((0.0,), rough)
            if given_up and outcome.converged:
                return replace(outcome, passes=passes, unsettled=change)
        reason = f"friction forces still change by {change:.1%} after {outcome.passes} passes"
        return replace(outcome, converged=False, reason=reason)

    def _lags(self) -> list[LateralIteration | AxialIteration]:
        """The iterations of the friction forces of the cables, sideways and along."""
        lags: list[LateralIteration | AxialIteration] = []
        for cable in self.scene.cables:
            if cable.has_coulomb:
                from crms_fenicsx.friction.lateral_iteration import LateralIteration

                lags.append(LateralIteration(cable))
            if cable.axial is not None:
                from crms_fenicsx.friction.axial_iteration import AxialIteration

                lags.append(AxialIteration(cable))
        return lags
