"""The equilibrium of a load step: what changes the potential itself, around its minimisation.

Loops, one inside the other:

    friction     its forces are those of the state found before, until they are its own,
    paths        cables slide into other cells where that lowers the energy,
    contacts     cables turn slack or taut, lift off and touch down, part and join at crossings,
    minimiser    of the potential of these cables on these paths.

Each outer loop looks at a state that is near its minimum, before the last digits are worked out,
so that a change costs little and none costs nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from crms_fenicsx.contact.active_set import ActiveSet
from crms_fenicsx.equilibrium.state import State
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.paths.tried_paths import TriedPaths

if TYPE_CHECKING:
    from crms_fenicsx.equilibrium.contact_loop import ContactLoop
    from crms_fenicsx.equilibrium.friction_loop import FrictionLoop

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
        contacts, friction = self._loops(State.of(self.scene))
        outcome = self._unsmoothed(friction.solve(h0_prestress), contacts)
        if self.slide and self.tried is not None:
            self.tried.end_step(self.scene.cables)
        return outcome

    def _loops(self, start: State) -> tuple[ContactLoop, FrictionLoop]:
        """Nest the loops of a load step with cables that starts in a state."""
        from crms_fenicsx.equilibrium.contact_loop import ContactLoop
        from crms_fenicsx.equilibrium.friction_loop import FrictionLoop

        if not self.slide:
            contacts = ContactLoop(self.system, ActiveSet(self.scene.net, None), None, start)
            return contacts, FrictionLoop(contacts, contacts.solve_in_cells, None)
        from crms_fenicsx.equilibrium.path_loop import PathLoop
        from crms_fenicsx.paths.boundary_ends import renew_ends
        from crms_fenicsx.paths.path_change import PathChange
        from crms_fenicsx.paths.retrace import Retracer

        if self.tried is None:
            self.tried = TriedPaths()
        self.tried.begin_step()
        change = PathChange(self.scene.net)
        retracer = Retracer(change, self.tried)
        contacts = ContactLoop(self.system, ActiveSet(self.scene.net, self.tried), retracer, start)
        paths = PathLoop(contacts, change, self.tried)
        changed = renew_ends(change)
        if retracer.renew_projections() or changed:
            self.system.rebuild()
        return contacts, FrictionLoop(contacts, paths.solve, self.tried)

    def _unsmoothed(self, outcome: Outcome, contacts: ContactLoop) -> Outcome:
        """Repeat a solve until cables are as long as their polylines, though these are smoothed.

        Smoothing has its place in the gradient, which turns a segment that comes to an end at a
        vertex; the length that it adds hardly depends on the state, and is taken off.
        """
        from crms_fenicsx.equilibrium.friction_loop import FrictionLoop

        for k in range(MAX_LENGTHS):
            if not outcome.converged or not self.system.renew_excess():
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
        known = all(cable.slides_freely or cable.grip is not None for cable in net.cables)
        for cable in net.cables:
            start_step(cable, shape)
        if not known:
            self.system.invalidate()
