"""Equilibrium on given paths: minimise, update the active set, and repeat.

The active set holds the cables in tension, their contacts with the membrane and their crossings. It
is updated from solved states. The path of a lifted cable part is kept below its span.
"""

from __future__ import annotations

import logging
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import replace

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.cabling.cables.row_shifts import NEAR, SETTLED
from crms_fenicsx.cabling.contact.active_set import ActiveSet
from crms_fenicsx.cabling.paths.geodesic_sliding import GeodesicSliding
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.tolerances import BUDGET, TOL

logger = logging.getLogger("crms_fenicsx")

Look = Callable[[bool], bool]
"""Called near equilibrium with whether contacts change; returns whether to end the solve."""


class ContactLoop:
    """Solves one load step on given paths."""

    def __init__(
        self, system: System, active: ActiveSet, sliding: GeodesicSliding | None, start: SceneState
    ) -> None:
        self.system, self.scene = system, system.scene
        self.active, self.sliding, self.start = active, sliding, start
        self._projections = 0
        # in wind, which is to turn before the next search, the mesh follows rows only once
        self._once = self.scene.loads.has_wind

    def solve_in_cells(self, h0_prestress: tuple[float, ...], rough: bool) -> Outcome:
        """Find the equilibrium on the current paths, or a state near it if `rough`."""
        return self.solve(h0_prestress, operator.not_ if rough else None)

    def solve(self, h0_prestress: tuple[float, ...], look: Look | None = None) -> Outcome:
        """Find the equilibrium on the current paths. Collective. `look` is called near it."""
        system, active = self.system, self.active
        system.read_scene()
        system.locate_cables()
        changes = active.tighten()  # contacts need a solved state
        if self.sliding is not None and not changes and self.sliding.straighten():
            changes = ["paths pulled taut"]
        total: Outcome | None = None
        looked, ended, way = False, False, 0.0

        def interrupt(residual: float, scale: float, last: bool) -> bool:
            nonlocal changes, looked, ended
            shift, near = system.largest_shift(), residual <= TOL.path_residual * scale
            if looked:
                return False
            system.write_scene()
            if residual > self._weakest() * TOL.contact_residual and not last:
                return False
            if system.holds_rows and not near:
                return False
            changes = self._changes()
            # states on other paths are compared with rows at rest
            near = near and (self.sliding is None or shift <= SETTLED)
            if not near or (changes and not self._may_join_paths()):
                return bool(changes)
            ended = look is not None and look(bool(changes))
            if ended:  # new paths are solved together with new contacts
                changes = []
            looked = not changes
            return ended or bool(changes)

        while True:
            self._prepare(changes, way)
            changes = []
            outcome = system.minimize(h0_prestress, interrupt)
            h0_prestress = (0.0,)  # the membrane is stressed now
            begins = total is None
            total = outcome if total is None else total + outcome
            if not outcome.converged or (ended and self.sliding is not None):
                return total
            if outcome.reason != "interrupted":
                system.write_scene()
                changes = self._changes()
            elif not changes and not looked and not ended:  # a look may have changed paths
                system.write_scene()
            solved = outcome.reason != "interrupted" and not changes
            last = math.inf if begins else way
            way = system.follow_rows(begins, solved)
            if system.collapse:
                return replace(total, converged=False, reason=system.collapse)
            # friction is updated from places also near equilibrium, where a look ends a solve; at
            # the end, small shifts that no longer shrink are due to the solver's tolerance
            rests = way <= NEAR if outcome.reason == "interrupted" else last <= way <= SETTLED
            if not changes and (self._once or rests or way == 0.0):
                if way > 0.0 and outcome.reason == "converged" and not self._once:
                    total += system.settle()
                elif way > 0.0:
                    system.renew_base()
                if not looked and look is not None:
                    look(False)
                return total
            if active.cycling_cable():
                reason = f"{active.cycling_cable()} keeps turning from slack to taut and back"
                return replace(total, converged=False, reason=reason)

    def _prepare(self, changes: Sequence[str], way: float) -> None:
        """Bring the potential to changed contacts, or to a mesh that has followed its rows by a
        `way`. Collective."""
        system = self.system
        if changes:
            logger.debug("%s", "; ".join(changes))
            if self.sliding is not None:
                self.sliding.straighten()
            system.rebuild()
            system.read_scene()
        elif way > 0.0:
            system.renew_base()
        # every term starts the step from there, but the mesh goes on from where it has moved
        if system.has_history and self.scene.membrane.moved is self.start.membrane.moved:
            _restore_positions(self.scene, self.start)
            system.read_scene()

    def _may_join_paths(self) -> bool:
        """Whether paths may change together with contacts: where cables only lift off, so that the
        state's energy still is a bound, and no friction forces belong to the old contacts."""
        return self.active.only_lifted and not self.scene.net.has_friction

    def _weakest(self) -> float:
        """Least tension, or friction force, of the cables in tension (force)."""
        taut = [cable for cable in self.scene.cables if cable.taut]
        grips = [
            float(c.state.law.lateral.bounds.sum())
            for c in taut
            if c.has_coulomb and c.state.law.lateral
        ]
        return min((*(cable.tension for cable in taut), *filter(None, grips)), default=0.0)

    def _changes(self) -> list[str]:
        """Apply the changes that the solved state demands and return them in words."""
        shape = self.scene.net.strip_shape()
        changes = self.active.update(shape)
        if self.sliding is not None and not changes and self._projections < BUDGET.changes:
            changes = self.sliding.renew_projections(shape)
            self._projections += len(changes)
        if changes or not self.system.holds_rows:
            return changes
        self.system.holds_rows = False
        return ["rows slide"] if any(c.taut and c.takes_line for c in self.scene.cables) else []


def _restore_positions(scene: Scene, state: SceneState) -> None:
    """Restore the positions of membrane and cables on their new paths. Collective. Path points that
    existed are put back; new ones are placed on the restored membrane."""
    scene.u.x.array[:] = state.u
    scene.frame.state = state.frame
    shape = scene.net.strip_shape()
    for cable, was in state.net.cables.items():
        known = {_key(was.nodes, k): k for k in range(len(was.nodes)) if not was.lifted[k]}
        positions, fractions = cable.state.positions.copy(), cable.state.fractions.copy()
        for k in range(len(cable.state.nodes)):
            old = known.get(_key(cable.state.nodes, k))
            if old is not None:
                positions[k], fractions[k] = was.positions[old], was.fractions[old]
            else:
                positions[k] = shape.mean(*cable.interpolation(k))
        cable.update(positions=positions, fractions=fractions)


def _key(nodes: Sequence[CableNode], k: int) -> object:
    """Key that identifies a node while its path changes."""
    point = nodes[k].point
    if point is None:
        return "end", k > 0
    return nodes[k].kind, point.support if nodes[k].slides else point
