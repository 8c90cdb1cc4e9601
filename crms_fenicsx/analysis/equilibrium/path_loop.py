"""Equilibrium on the paths of least energy: change paths while the energy falls.

Trial states near equilibrium suffice to compare energies; only the last one converges fully.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from crms_fenicsx.analysis.equilibrium.contact_loop import ContactLoop
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.cabling.cables.crossings import tangled
from crms_fenicsx.cabling.cables.points_on_edges import fractions_of, positions_of
from crms_fenicsx.cabling.contact.lift_off import Polylines, sunk
from crms_fenicsx.cabling.paths.crossing_trials import CrossingTrials
from crms_fenicsx.cabling.paths.path_change import leaves_cells
from crms_fenicsx.cabling.paths.vertex_trials import Trial, VertexTrials
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.model.tolerances import BUDGET, SAME_VALUE, TOL


@dataclass(frozen=True)
class _Try:
    """Equilibrium on some paths, perhaps rough, and the path changes it demands."""

    outcome: Outcome  # of the minimisation, with the vertices passed by the path change
    state: SceneState  # before the path change
    energy: float  # potential energy of that state (force x length)


class PathLoop:
    """Solves one load step of laterally sliding cables, and finds their paths."""

    def __init__(self, contacts: ContactLoop) -> None:
        assert contacts.sliding is not None
        self.contacts, self.sliding = contacts, contacts.sliding
        self.system, self.scene = contacts.system, contacts.scene
        self.change, self.tried = self.sliding.change, self.sliding.tried

    def solve(self, h0_prestress: tuple[float, ...], rough: bool) -> Outcome:
        """Find the equilibrium and the paths of the cables. Collective."""
        tried, trials = self.tried, VertexTrials(self.change, self.tried)
        others = CrossingTrials(self.change, tried)
        best = self._try(h0_prestress, rough)
        total, flips = best.outcome, best.outcome.flips
        laid_again, sunken = set[int](), set[int]()
        tries = 0
        settled = True  # the potential has the best paths and the scene is in equilibrium
        while best.outcome.converged:
            moved: list[Trial] = []
            other = False
            if not flips:
                caught: set[int] = set()
                if settled:
                    caught, sunken = self._caught(laid_again)
                    # A cable through the membrane is shorter: its energy is no bound.
                    energy = math.inf if sunken & caught else self.system.objective
                    best = replace(best, state=self.scene.state, energy=energy)
                if caught:
                    laid_again |= caught
                    for c in caught:  # the fold points are put back on straight edges
                        self.scene.cables[c].update(path_is_geodesic=False)
                else:
                    if tries < BUDGET.changes:
                        moved = trials.next(best.energy, self._scale())
                        other = not moved and others.next()
                    if not moved and not other and not settled:
                        self.system.rebuild()
                        total = total + self.contacts.solve_in_cells((0.0,), rough=True)
                        best, settled = replace(best, outcome=total), True
                        continue
                    if not moved and not other:
                        flips = self._pass_vertices(None)
                        if not flips and not self._straighten_kinks():
                            break
            if tries == BUDGET.changes:
                reason = f"the paths of the cables still change after {tries} updates"
                return replace(total, converged=False, reason=reason)
            tries += 1
            proposed, refused = tried.proposed, {k: set(v) for k, v in tried.refused.items()}
            self.system.rebuild()
            new = self._try((0.0,), rough=True)
            total = total + new.outcome
            excess = new.energy - best.energy if new.outcome.converged else math.inf
            if excess < (-SAME_VALUE * self._scale() if other else 0.0):
                best, flips, settled = new, new.outcome.flips, True
                if moved or other:
                    laid_again.clear()
                    others.accept(-excess)
                continue
            if other:
                others.reject(excess)
            elif not moved:
                tried.misled += 1
            elif trials.halve(moved):
                tried.refused = refused
            self.scene.state = best.state
            # Take back half of the flips; a single one cannot be halved.
            flips = self._change_paths(flips // 2)
            if not flips:
                tried.rejected |= proposed
                settled = False
        return self._accepted(total, rough, sunken)

    def _accepted(self, total: Outcome, rough: bool, sunken: set[int]) -> Outcome:
        """Converge fully, unless `rough`, and reject unsound states, such as with `sunken` cables,
        by number."""
        if total.converged and not rough and total.residual > total.tolerance:
            total = total + self.contacts.solve((0.0,))
            sunken = self._sunk()
        if not total.converged:
            return total
        self.sliding.check_on_membrane()
        caught = self.system.kinked_cables(3 * TOL.kink)
        if caught:
            # those whose fold points have approached each other away from vertices
            cables, net = self.scene.cables, self.scene.net
            lines = Polylines(net.nodes, positions_of(cables))
            caught &= lines.collapsed(net.strip_shape(), fractions_of(cables))
        caught |= sunken
        if caught:
            names = ", ".join(self.scene.cables[c].name for c in sorted(caught))
            reason = f"{names}: caught between edges of the mesh"
            return replace(total, converged=False, reason=reason)
        return total

    def _try(self, h0_prestress: tuple[float, ...], rough: bool) -> _Try:
        """Solve on the current paths; the scene is left with the next paths to try."""
        flips = 0
        state, energy = self.contacts.start, 0.0

        def look(contacts_change: bool) -> bool:
            nonlocal flips, state, energy
            state, energy = self.scene.state, self.system.objective
            flips = self._change_paths(None)
            return flips > 0 or (rough and not contacts_change)

        outcome = self.contacts.solve(h0_prestress, look)
        return _Try(replace(outcome, flips=flips), state, energy)

    def _change_paths(self, most: int | None) -> int:
        """Move the cables over at most `most` vertices each; return the number passed."""
        if most == 0:
            return 0
        return max(self.sliding.slide(most), self._pass_vertices(most))

    def _pass_vertices(self, most: int | None) -> int:
        """Move cables with friction over the vertices that they have reached."""
        if not self.scene.net.has_friction:
            return 0

        from crms_fenicsx.cabling.paths.sliding_with_friction import pass_vertices

        return pass_vertices(self.change, self.tried, most)

    def _straighten_kinks(self) -> bool:
        """Put caught fold points of cables with friction back on straight edges."""
        if not self.scene.net.has_friction:
            return False

        from crms_fenicsx.cabling.paths.sliding_with_friction import straighten_kinks

        return straighten_kinks(self.change, self.tried, self.system.kinked_nodes(TOL.tense_kink))

    def _scale(self) -> float:
        """Sum of the absolute energies of all kinds (force x length)."""
        return sum(map(abs, self.scene.energies.values()))

    def _caught(self, known: set[int]) -> tuple[set[int], set[int]]:
        """Numbers of the sliding cables, but the known ones, that kink edges, are tangled or run
        below the membrane; and of all cables that run below it. Collective."""
        caught, sunken = self.system.kinked_cables(TOL.kink), self._sunk()
        caught |= tangled(self.scene.net.crossings) | sunken
        return {c for c in caught if leaves_cells(self.scene.cables[c])} - known, sunken

    def _sunk(self) -> set[int]:
        """Numbers of the cables that run below the membrane beside a vertex. Collective."""
        cables = self.scene.cables
        if not any(cable.state.lifted.any() for cable in cables):
            return set()
        return sunk(cables, self.scene.net.nodes, self.scene.net.strip_shape())
