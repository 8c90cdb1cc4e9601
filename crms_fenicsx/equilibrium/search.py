"""The equilibrium of a load step: what changes the potential itself, around its minimisation.

Loops, one inside the other:

    friction     its forces are those of the state found before, until they are its own,
    paths        cables slide into other cells where that lowers the energy,
    active set   cables turn slack or taut, lift off and touch down, part and join at crossings,
    minimiser    of the potential of these cables on these paths.

Each outer loop looks at a state that is near its minimum, before the last digits are worked out,
so that a change costs little and none costs nothing.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from crms_fenicsx.cables.state import State
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.outcome import Outcome

if TYPE_CHECKING:
    from crms_fenicsx.contact.active_set import ActiveSet
    from crms_fenicsx.friction.axial_iteration import AxialLag
    from crms_fenicsx.friction.lateral_iteration import Lag
    from crms_fenicsx.paths.retrace import Retracer, Tried

logger = logging.getLogger("crms_fenicsx")

CAUGHT, STUCK = 0.05, 0.15
"""Kinks of a folded edge (rad) from which on its cable is laid anew, and the state is refused.

Two fold points on edges that meet in a vertex can close in on each other away from it: their chord
has no direction any more, and a cable caught there can look as if it were in equilibrium. Kinks
of sound states are below 0.01 on meshes of 9 cells a side.
"""

TENSE = 0.01
"""Kinks (rad) from which on the fold points of a cable with friction are put back in place."""

MAX_PASSES = 30
"""How often friction forces are taken from the state that they have led to."""

PATIENCE = 12
"""How often they may be without their change becoming less: where the state answers a small change
of a force by a large one, as at the edge of lifting off, they go round in circles."""

MAX_PATHS = 60
"""How many sets of paths are tried in one load step before it is given up."""

_Solve = Callable[[tuple[float, ...], bool], Outcome]
"""Finds an equilibrium with the friction forces that there are, or a state near to it."""


@dataclass(frozen=True)
class _Try:
    """The equilibrium on some paths, perhaps not to the last digit, and how they want to change."""

    outcome: Outcome
    state: State
    energy: float
    flips: int


class EquilibriumSearch:
    """Finds the equilibrium at a scene's loads, starting from its state.

    Parameters
    ----------
    system
        The scene's potential.
    slide
        Whether cables may slide into other cells than those that they cross.
    """

    def __init__(self, system: System, slide: bool) -> None:
        self.system, self.scene = system, system.scene
        self.slide = slide
        self.paths: Retracer | None = None
        self.shadows = 0

    def remember(self, tried: Tried) -> None:
        """Go on from another search's load steps with the same cables."""
        if self.slide:
            from crms_fenicsx.paths.retrace import Retracer

            self.paths = Retracer(self.scene)
            self.paths.remember(tried)

    def find(self, h0_prestress: tuple[float, ...]) -> Outcome:
        """Find the equilibrium; the scene is then in it. Collective.

        Parameters
        ----------
        h0_prestress
            As for `Minimizer.solve`.
        """
        self._begin_friction()
        self.system.prepare()
        self.start = State.of(self.scene)
        if not self.scene.cables:
            self.system.read_scene()
            outcome = self.system.minimize(h0_prestress)
            self.system.write_scene()
            return outcome
        from crms_fenicsx.contact.active_set import ActiveSet

        if not self.slide:
            self.active: ActiveSet = ActiveSet(self.scene, None)
            outcome = self._with_friction(self._solve_in_cells, h0_prestress)
            return self._unsmoothed(outcome)
        from crms_fenicsx.paths.boundary_ends import renew_ends
        from crms_fenicsx.paths.retrace import Retracer

        if self.paths is None:
            self.paths = Retracer(self.scene)
        self.active = ActiveSet(self.scene, self.paths)
        self.paths.begin_step()
        self.shadows = 0
        changed = renew_ends(self.paths)
        if self.paths.renew_shadows() or changed:
            self.system.rebuild()
        outcome = self._with_friction(self._slide, h0_prestress)
        outcome = self._unsmoothed(outcome)
        self.paths.end_step()
        return outcome

    def _unsmoothed(self, outcome: Outcome) -> Outcome:
        """Repeat a solve until cables are as long as their polylines, though these are smoothed.

        Smoothing has its place in the gradient, which turns a segment that comes to an end at a
        vertex; the length that it adds hardly depends on the state, and is taken off.
        """
        for _ in range(MAX_PASSES):
            if not outcome.converged or not self.system.renew_excess():
                return outcome
            outcome = outcome + self._with_friction(self._solve_in_cells, (0.0,))
        reason = "the smoothed lengths of a cable's short segments do not settle"
        return replace(outcome, converged=False, reason=reason)

    @property
    def _has_friction(self) -> bool:
        """Whether friction holds some cable sideways; without it nothing of it is loaded."""
        return not all(cable.slides_freely for cable in self.scene.cables)

    def _begin_friction(self) -> None:
        """Let a load step begin for the cables with friction."""
        if not self._has_friction:
            return  # friction along a cable begins with its grip from before
        from crms_fenicsx.cables.strip_positions import StripShape
        from crms_fenicsx.friction.lateral import begin

        shape, cables = StripShape.of(self.scene), self.scene.cables
        known = all(cable.slides_freely or cable.grip is not None for cable in cables)
        for cable in cables:
            begin(cable, shape)
        if not known:
            self.system.invalidate()

    def _with_friction(self, solve: _Solve, h0_prestress: tuple[float, ...]) -> Outcome:
        """Solve, again and again until the friction forces are those of its own state.

        While these change much the states are worked out near their equilibrium only.
        """
        lags = self._lags()
        outcome = solve(h0_prestress, bool(lags))
        if not lags:
            return outcome
        from crms_fenicsx.cables.strip_positions import StripShape
        from crms_fenicsx.friction.lateral_iteration import NEARLY

        rough = True
        change, least, waited = 0.0, math.inf, 0
        for passes in range(1, MAX_PASSES + 1):
            outcome = replace(outcome, passes=passes)
            if not outcome.converged:
                return outcome
            shape = StripShape.of(self.scene)
            changes = [lag.renew(shape) for lag in lags]
            if all(c <= lag.settled for c, lag in zip(changes, lags, strict=True)):
                if not rough:
                    return outcome
                outcome, rough = outcome + self._settle((0.0,)), False
                continue
            change = max(changes)
            logger.debug("pass %d: friction forces change by %.2g", passes, change)
            least, waited = min(change, least), waited + 1 if change >= least else 0
            given_up = waited == PATIENCE or passes == MAX_PASSES
            if given_up and change > NEARLY:
                break
            if change > NEARLY and self.paths is not None:
                self.paths.withheld.clear()
            self.system.renew_friction()
            if change <= NEARLY and not any(cable.has_coulomb for cable in self.scene.cables):
                solve = self._solve_in_cells  # friction along moves a path too little for others
            rough = change > NEARLY
            outcome = outcome + solve((0.0,), rough)
            if given_up and outcome.converged:
                return replace(outcome, passes=passes, unsettled=change)
        reason = f"friction forces still change by {change:.1%} after {outcome.passes} passes"
        return replace(outcome, converged=False, reason=reason)

    def _lags(self) -> list[Lag | AxialLag]:
        """What follows the friction forces of the cables, sideways and along."""
        lags: list[Lag | AxialLag] = []
        for cable in self.scene.cables:
            if cable.has_coulomb:
                from crms_fenicsx.friction.lateral_iteration import Lag

                lags.append(Lag(cable))
            if cable.axial is not None:
                from crms_fenicsx.friction.axial_iteration import AxialLag

                lags.append(AxialLag(cable))
        return lags

    def _slide(self, h0_prestress: tuple[float, ...], rough: bool) -> Outcome:
        """Try new paths while the energy falls.

        What is tried is worked out near its equilibrium only, where energies can be compared; the
        last digits come at the end, unless all shall be `rough`.
        """
        from crms_fenicsx.cables.crossings import tangled
        from crms_fenicsx.paths.vertex_trials import Trial, VertexTrials

        paths, best = self.paths, self._try(h0_prestress, rough)
        assert paths is not None
        total, flips = best.outcome, best.flips
        trials = VertexTrials(paths)
        laid_again: set[int] = set()
        tries = 0
        while best.outcome.converged:
            led: list[Trial] = []
            if not flips:
                caught = self.system.caught_cables(CAUGHT) | tangled(self.scene.crossings)
                sunk = self._sunk()
                caught |= sunk
                caught = {c for c in caught - laid_again if self.scene.cables[c].slides_freely}
                # Through the membrane a cable is shorter: that energy is none to fall below.
                energy = math.inf if sunk & caught else self.system.objective
                best = replace(best, state=State.of(self.scene), energy=energy)
                if caught:
                    laid_again |= caught
                    paths.lay_again(caught)
                else:
                    scale = sum(map(abs, self.scene.energies.values()))
                    if tries < MAX_PATHS:
                        led = trials.next(best.energy, scale)
                    if not led:
                        flips = self._give_way(None)
                        if not flips and not self._relax_held():
                            break
            if tries == MAX_PATHS:
                reason = f"after {tries} changes the paths of the cables still want to change"
                return replace(total, converged=False, reason=reason)
            tries += 1
            tried = paths.offered
            refused = {name: set(ways) for name, ways in paths.refused.items()}
            self.system.rebuild()
            new = self._try((0.0,), rough=True)
            total = total + new.outcome
            if new.outcome.converged and new.energy < best.energy:
                best, flips = new, new.flips
                if led:
                    laid_again.clear()
                continue
            if led:
                if trials.halve(led):
                    paths.refused = refused
            else:
                paths.count_misled()
            best.state.restore(self.scene)
            # Half of the flips; one alone cannot be halved.
            flips = self._change_paths(flips // 2)
            if not flips:
                paths.withheld |= tried
                self.system.rebuild()
                total = total + self._settle((0.0,), lambda: True)
                best = replace(best, outcome=total)
        if total.converged and not rough and total.residual > total.tolerance:
            total = total + self._settle((0.0,))
        if not total.converged:
            return total
        paths.check_on_membrane()
        caught = self.system.caught_cables(STUCK) | self._sunk()
        if caught:
            names = ", ".join(self.scene.cables[c].name for c in sorted(caught))
            reason = f"{names}: caught between edges of the mesh; make it finer there"
            return replace(total, converged=False, reason=reason)
        return total

    def _sunk(self) -> set[int]:
        """Numbers of the cables that run through the membrane beside a vertex. Collective."""
        cables = self.scene.cables
        if not any(cable.lifted.any() for cable in cables):
            return set()
        from crms_fenicsx.cables.strip_positions import StripShape
        from crms_fenicsx.contact.lift_off import sunk

        return sunk(cables, StripShape.of(self.scene))

    def _try(self, h0_prestress: tuple[float, ...], rough: bool = False) -> _Try:
        """Equilibrium on the paths that there are; the scene then has those to try next.

        Parameters
        ----------
        h0_prestress
            As for `Minimizer.solve`.
        rough
            Whether to stop near the equilibrium.
        """
        flips = 0
        state, energy = self.start, 0.0

        def look() -> bool:
            nonlocal flips, state, energy
            state, energy = State.of(self.scene), self.system.objective
            flips = self._change_paths(None)
            return rough or flips > 0

        outcome = self._settle(h0_prestress, look)
        return _Try(replace(outcome, flips=flips), state, energy, flips)

    def _change_paths(self, most: int | None) -> int:
        """Lead the cables over vertices, `most` at most each; return over how many."""
        paths = self.paths
        if paths is None or most == 0:
            return 0
        return max(paths.retrace(most), self._give_way(most))

    def _give_way(self, most: int | None) -> int:
        """Lead cables with friction over the vertices that they have run into."""
        if not self._has_friction:
            return 0
        from crms_fenicsx.paths.friction_release import give_way

        assert self.paths is not None
        return give_way(self.paths, most)

    def _relax_held(self) -> bool:
        """Put caught fold points of cables with friction back on straight edges."""
        if not self._has_friction:
            return False
        from crms_fenicsx.paths.friction_release import relax

        assert self.paths is not None
        return relax(self.paths, self.system.caught_nodes(TENSE))

    def _solve_in_cells(self, h0_prestress: tuple[float, ...], rough: bool) -> Outcome:
        """Equilibrium on the paths that there are; near it only, if `rough`."""
        return self._settle(h0_prestress, (lambda: True) if rough else None)

    def _settle(
        self, h0_prestress: tuple[float, ...], look: Callable[[], bool] | None = None
    ) -> Outcome:
        """Equilibrium on the paths that there are.

        Parameters
        ----------
        h0_prestress
            As for `Minimizer.solve`.
        look
            Called once the active set has settled, near the equilibrium; if it returns true, the
            solve ends there.
        """
        system, active = self.system, self.active
        system.read_scene()
        system.locate_cables()
        changes = active.tighten()  # contacts can be judged on a solved state only
        if self.paths is not None and not changes and self.paths.straighten():
            changes = ["paths pulled taut"]
        total: Outcome | None = None
        looked = False

        def interrupt() -> bool:
            nonlocal changes, looked
            system.write_scene()
            changes = self._changes()
            if changes:
                return True
            looked = True
            return look is not None and look()

        while True:
            if changes:
                logger.debug("%s", "; ".join(changes))
                if self.paths is not None:
                    self.paths.straighten()
                system.rebuild()
                system.read_scene()
            if system.has_history:  # the step starts there for all its terms
                self.start.restore_positions(self.scene)
                system.read_scene()
            changes = []
            outcome = system.minimize(h0_prestress, interrupt)
            h0_prestress = (0.0,)  # the membrane has stresses now
            total = outcome if total is None else total + outcome
            if not outcome.converged:
                return total
            if outcome.reason != "interrupted":
                system.write_scene()
                changes = self._changes()
            if not changes:
                if not looked and look is not None:
                    look()
                return total
            if active.restless():
                reason = f"{active.restless()} keeps turning from slack to taut and back"
                return replace(total, converged=False, reason=reason)

    def _changes(self) -> list[str]:
        """Change what the solved state asks for; say what, in words."""
        changes = self.active.update()
        if self.paths is not None and not changes and self.shadows < MAX_PATHS:
            changes = self.paths.renew_shadows()
            self.shadows += len(changes)
        return changes
