"""Search for the equilibrium of a load step with friction.

Nested loops:

    friction     forces from the previous state, until they are those of the state itself,
    paths        cables slide into other cells where that lowers the energy,
    contacts     cables turn slack or taut, lift off and touch down, separate and join at crossings,
    minimiser    of the potential of these cables on these paths.

Each outer loop examines a state near its minimum, before full convergence, so that a change costs
little and no change costs nothing.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.model.tolerances import BUDGET

if TYPE_CHECKING:
    from crms_fenicsx.analysis.equilibrium.contact_loop import ContactLoop
    from crms_fenicsx.cabling.contact.active_set import ContactHistory
    from crms_fenicsx.cabling.friction.passes import AxialIteration, LateralIteration
    from crms_fenicsx.cabling.paths.tried_paths import TriedPaths

logger = logging.getLogger("crms_fenicsx")

Solve = Callable[[tuple[float, ...], bool], Outcome]
"""Solves for the equilibrium, or a state near it, with given friction forces."""


class FrictionLoop:
    """Solves one load step of cables with or without friction."""

    def __init__(self, contacts: ContactLoop, solve: Solve, tried: TriedPaths | None) -> None:
        self.contacts, self._solve, self.tried = contacts, solve, tried
        self.system, self.scene = contacts.system, contacts.scene

    def solve(self, h0_prestress: tuple[float, ...]) -> Outcome:
        """Solve until the friction forces are consistent with the state. Collective. While these
        change much, states are only computed near their equilibrium."""
        solve, lags = self._solve, self._friction_iterations()
        outcome = solve(h0_prestress, bool(lags))
        if not lags:
            return outcome
        from crms_fenicsx.cabling.friction.passes import NEARLY

        rough = True
        change, least, waited = 0.0, math.inf, 0
        for passes in range(1, BUDGET.passes + 1):
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
            given_up = waited == BUDGET.patience or passes == BUDGET.passes
            if given_up and change > NEARLY:
                break
            if change > NEARLY and self.tried is not None:
                self.tried.rejected.clear()
                self.tried.passes.clear()
            self.system.renew_friction()
            if change <= NEARLY and not any(cable.has_coulomb for cable in self.scene.cables):
                # Axial friction changes a cable's path too little for a new search of paths.
                solve = self.contacts.solve_in_cells
            rough = change > NEARLY
            outcome = outcome + solve((0.0,), rough)
            if given_up and outcome.converged:
                return replace(outcome, passes=passes, unsettled=change)
        reason = f"friction forces still change by {change:.1%} after {outcome.passes} passes"
        return replace(outcome, converged=False, reason=reason)

    def _friction_iterations(self) -> list[LateralIteration | AxialIteration]:
        """Iterations of the lateral and axial friction forces of all cables."""
        lags: list[LateralIteration | AxialIteration] = []
        for cable in self.scene.cables:
            if cable.has_coulomb and cable.state.law.lateral is not None:
                from crms_fenicsx.cabling.friction.passes import LateralIteration

                lags.append(LateralIteration(cable))
            if cable.state.law.axial is not None:
                from crms_fenicsx.cabling.friction.passes import AxialIteration

                lags.append(AxialIteration(cable))
        return lags


class EquilibriumSearch:
    """Finds the equilibrium at a scene's loads, starting from its state; without tried paths on the
    cables' present ones. Repeated searches, at turned loads of one load step, go on with the
    contacts of rows that slide: these would change back and forth as rows and loads turn."""

    def __init__(self, system: System, tried: TriedPaths | None) -> None:
        self.system, self.scene, self.tried = system, system.scene, tried
        self._history: ContactHistory = (set(), set())
        system.begin_rows()

    def find(self, h0_prestress: tuple[float, ...]) -> Outcome:
        """Find the equilibrium and leave the scene in it. Collective. In wind, which is to turn
        before the next search, the mesh follows rows that slide only once; see `rows_rest`."""
        self._begin_friction()
        self.system.prepare()
        self.system.rows_rest = True
        if not self.scene.cables:
            self.system.read_scene()
            outcome = self.system.minimize(h0_prestress)
            self.system.write_scene()
            return outcome
        contacts, friction = self._loops(self.scene.state)
        outcome = friction.solve(h0_prestress)
        if self.system.rows_rest:
            outcome = self._unsmoothed(outcome, contacts)
        if self.tried is not None:
            self.tried.end_step(self.scene.cables)
        return outcome

    def _loops(self, start: SceneState) -> tuple[ContactLoop, FrictionLoop]:
        """Nest the loops of a load step with cables from a start state."""
        from crms_fenicsx.analysis.equilibrium.contact_loop import ContactLoop
        from crms_fenicsx.cabling.cables.cable_net import refuse_held_clamps
        from crms_fenicsx.cabling.contact.active_set import ActiveSet
        from crms_fenicsx.cabling.paths.boundary_ends import refuse_ends_along_rim, renew_ends

        refuse_ends_along_rim(self.scene.net)
        if not self.system.slide:
            refuse_held_clamps(self.scene.net)
        if self.tried is None:
            history = self._history if self.system.shifts is not None else None
            active = ActiveSet(self.scene.net, None, history)
            contacts = ContactLoop(self.system, active, None, start)
            return contacts, FrictionLoop(contacts, contacts.solve_in_cells, None)
        from crms_fenicsx.analysis.equilibrium.path_loop import PathLoop
        from crms_fenicsx.cabling.paths.geodesic_sliding import GeodesicSliding
        from crms_fenicsx.cabling.paths.path_change import PathChange

        self.tried.begin_step()
        change = PathChange(self.scene.net)
        sliding = GeodesicSliding(change, self.tried)
        contacts = ContactLoop(self.system, ActiveSet(self.scene.net, self.tried), sliding, start)
        changed = renew_ends(change)
        if sliding.renew_projections(self.scene.net.strip_shape()) or changed:
            self.system.rebuild()
        return contacts, FrictionLoop(contacts, PathLoop(contacts).solve, self.tried)

    def _unsmoothed(self, outcome: Outcome, contacts: ContactLoop) -> Outcome:
        """Repeat a solve until cable lengths are those of their polylines. Smoothing is meant for
        the gradient, which rotates a segment that shrinks to zero at a vertex; the length that it
        adds hardly depends on the state, and is subtracted."""

        for k in range(BUDGET.lengths):
            if not outcome.converged or not self.system.renew_smoothing_length():
                return outcome
            if k == 0:
                again = FrictionLoop(contacts, contacts.solve_in_cells, self.tried).solve((0.0,))
            else:  # friction forces settle too coarsely: their updates would keep changing lengths
                again = contacts.solve_in_cells((0.0,), rough=False)
                again = replace(again, unsettled=outcome.unsettled)
            outcome = outcome + again
        reason = "the smoothed lengths of a cable's short segments do not settle"
        return replace(outcome, converged=False, reason=reason)

    def _begin_friction(self) -> None:
        """Begin a load step for the cables with friction."""
        net = self.scene.net
        if not net.has_friction:
            return  # axial friction starts from its last state
        from crms_fenicsx.cabling.friction.lateral import start_step

        shape = net.strip_shape()
        sliding = [
            cable for cable in net.cables
            if not cable.slides_freely
            and (self.system.slide or cable.state.laid.line is None)
        ]  # fmt: skip
        known = all(cable.state.law.lateral is not None for cable in sliding)
        for cable in sliding:
            start_step(cable, shape)
        if not known:
            self.system.invalidate()
