"""Search for the equilibrium of a load step, with the friction forces of its own state.

Loops, one inside the other:

    friction     its forces are those of the state found before, until they are its own,
    paths        cables slide into other cells where that lowers the energy,
    contacts     cables turn slack or taut, lift off and touch down, part and join at crossings,
    minimiser    of the potential of these cables on these paths.

Each outer loop looks at a state that is near its minimum, before the last digits are worked out,
so that a change costs little and none costs nothing.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.scene.state import SceneState

if TYPE_CHECKING:
    from crms_fenicsx.equilibrium.contact_loop import ContactLoop
    from crms_fenicsx.friction.passes import AxialIteration, LateralIteration
    from crms_fenicsx.paths.tried_paths import TriedPaths

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
        While these change much the states are worked out near their equilibrium only."""
        solve, lags = self._solve, self._lags()
        outcome = solve(h0_prestress, bool(lags))
        if not lags:
            return outcome
        from crms_fenicsx.friction.passes import NEARLY

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
                from crms_fenicsx.friction.passes import LateralIteration

                lags.append(LateralIteration(cable))
            if cable.axial is not None:
                from crms_fenicsx.friction.passes import AxialIteration

                lags.append(AxialIteration(cable))
        return lags


MAX_LENGTHS = 30
"""How often a solve is repeated for what smoothing adds to the lengths of cables."""


class EquilibriumSearch:
    """Finds the equilibrium at a scene's loads, starting from its state."""

    def __init__(self, system: System, slide: bool, tried: TriedPaths | None = None) -> None:
        self.system, self.scene = system, system.scene
        self.slide, self.tried = slide, tried

    def find(self, h0_prestress: tuple[float, ...]) -> Outcome:
        """Find the equilibrium; the scene is then in it. Collective."""
        self._begin_friction()
        self.system.prepare()
        if not self.scene.cables:
            self.system.read_scene()
            outcome = self.system.minimize(h0_prestress)
            self.system.write_scene()
            return outcome
        contacts, friction = self._loops(self.scene.state)
        outcome = self._unsmoothed(friction.solve(h0_prestress), contacts)
        if self.slide and self.tried is not None:
            self.tried.end_step(self.scene.cables)
        return outcome

    def _loops(self, start: SceneState) -> tuple[ContactLoop, FrictionLoop]:
        """Nest the loops of a load step with cables that starts in a state."""
        from crms_fenicsx.contact.active_set import ActiveSet
        from crms_fenicsx.equilibrium.contact_loop import ContactLoop

        if not self.slide:
            contacts = ContactLoop(self.system, ActiveSet(self.scene.net, None), None, start)
            return contacts, FrictionLoop(contacts, contacts.solve_in_cells, None)
        from crms_fenicsx.equilibrium.path_loop import PathLoop
        from crms_fenicsx.paths.boundary_ends import renew_ends
        from crms_fenicsx.paths.geodesic_sliding import GeodesicSliding
        from crms_fenicsx.paths.path_change import PathChange
        from crms_fenicsx.paths.tried_paths import TriedPaths

        if self.tried is None:
            self.tried = TriedPaths()
        self.tried.begin_step()
        change = PathChange(self.scene.net)
        sliding = GeodesicSliding(change, self.tried)
        contacts = ContactLoop(self.system, ActiveSet(self.scene.net, self.tried), sliding, start)
        paths = PathLoop(contacts, change, self.tried)
        changed = renew_ends(change)
        if sliding.renew_projections() or changed:
            self.system.rebuild()
        return contacts, FrictionLoop(contacts, paths.solve, self.tried)

    def _unsmoothed(self, outcome: Outcome, contacts: ContactLoop) -> Outcome:
        """Repeat a solve until cables are as long as their polylines, though these are smoothed.
        Smoothing has its place in the gradient, which turns a segment that comes to an end at a
        vertex; the length that it adds hardly depends on the state, and is taken off."""

        for k in range(MAX_LENGTHS):
            if not outcome.converged or not self.system.renew_smoothing_length():
                return outcome
            if k == 0:
                again = FrictionLoop(contacts, contacts.solve_in_cells, self.tried).solve((0.0,))
            else:  # friction forces settle less sharply: each time they would lead to other lengths
                again = contacts.solve_in_cells((0.0,), rough=False)
                again = replace(again, unsettled=outcome.unsettled)
            outcome = outcome + again
        reason = "the smoothed lengths of a cable's short segments do not settle"
        return replace(outcome, converged=False, reason=reason)

    def _begin_friction(self) -> None:
        """Begin a load step for the cables with friction."""
        net = self.scene.net
        if not net.has_friction:
            return  # friction along a cable begins with its grip from before
        from crms_fenicsx.friction.lateral import start_step

        shape = net.strip_shape()
        known = all(cable.slides_freely or cable.lateral is not None for cable in net.cables)
        for cable in net.cables:
            start_step(cable, shape)
        if not known:
            self.system.invalidate()
