"""Solve one increment of the loads: equilibrium, follower loads and verification."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.other_states import (
    SCATTER_CHECK,
    lower_state,
    may_have_others,
)
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.loading import Target, has_free_rim
from crms_fenicsx.analysis.verification.report import Check, Verification
from crms_fenicsx.analysis.verification.verifier import Verifier
from crms_fenicsx.cabling.contact.lift_off import is_foot, size_at
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, SAME_VALUE, TOL
from crms_fenicsx.model.versions import StateWarning

if TYPE_CHECKING:
    from crms_fenicsx.cabling.paths.tried_paths import TriedPaths

PARTS = 0.2, 1.5
"""Bounds of the part of the wind's change that is made at once."""


def _starting_prestress(
    system: System, target: Target, share: float, stressed: bool = True
) -> tuple[float, ...]:
    """Extra prestress in H0 for each attempt (force per length); zero for the last one. From the
    present state or, if not `stressed`, from the unstressed membrane. Collective."""
    # A flat sheet has no stiffness against pressure: its stress will be 0.3 (p^2 L^2 E t)^(1/3).
    scene, size = system.scene, system.scene.membrane.size
    modulus = max(m.reference_modulus for m in scene.materials.values())
    travel = share * target.movements.travel
    loads = abs(scene.pressure) + system.added_force_per_area()
    loads += sum(abs(load.factor) * load.intensity for load in scene.loads)
    coming = 0.3 * (loads * size) ** (2 / 3) * modulus ** (1 / 3)
    coming = max(coming, 0.3 * modulus * (travel / size) ** 2)
    present = np.sqrt(max(2 * scene.energies.get("membrane", 0.0) * modulus, 0.0)) / size
    if stressed and present > 0.3 * coming:
        return (0.0,)
    return (coming, 0.1 * coming, 0.01 * coming, 0.0)


def _covered_ends(scene: Scene) -> Iterator[StateWarning]:
    """Warn of cable ends that start above the membrane and now lie under it. Collective."""
    over = [
        (cable, which, end, foot)
        for cable in scene.cables
        for which, end, foot in (("start", 0, 1), ("end", -1, len(cable.state.nodes) - 2))
        if len(cable.state.nodes) > 2
        and cable.state.nodes[end].kind == "anchor"
        and is_foot(cable, foot)
    ]
    if not over:
        return
    shape = scene.net.strip_shape()
    for cable, which, end, foot in over:
        node = cable.state.nodes[foot]
        above = cable.state.positions[end] - shape.mean(*node.interpolation())
        gap = float(above @ shape.normal(node.support))
        if gap < -TOL.sunk * size_at(shape, node.support):
            yield StateWarning(
                "cable end",
                f"the {which} of {cable.name!r} at {as_text(cable.state.positions[end])} lies "
                f"{-gap:.3g} under the membrane, which a cable cannot pass; move it up or off the "
                "membrane.",
            )


@dataclass(frozen=True)
class Increment:
    """Result of an increment."""

    outcome: Outcome  # of all its solves
    # of the accepted state; None if verification is off or no equilibrium was found
    verification: Verification | None = None
    # of instability, of cable ends under the membrane and of uncertain forces
    warnings: tuple[StateWarning, ...] = ()


SAME_TENSIONS, OTHER_TENSIONS = 1e-6, 1e-4
"""Changes of tensions, relative to the largest, below which a state under lagged pressure counts as
one before, and above which as another."""


def _taking_turns(tensions: Sequence[Array]) -> Booleans:
    """Whether each cable has another tension in some of the solves (n_cables,) since a state that
    has now returned; none if none has."""
    now = tensions[-1]
    size = float(now.max(initial=0.0))
    apart = [float(np.abs(one - now).max(initial=0.0)) for one in tensions]
    same = [k for k, change in enumerate(apart[:-2]) if change <= SAME_TENSIONS * size]
    since = np.abs(np.array(tensions[same[-1] :] if same else tensions[-1:]) - now).max(axis=0)
    return np.asarray(since > OTHER_TENSIONS * size)


class IncrementSolver:
    """Brings a scene to equilibrium at an increment's loads, or restores its state before."""

    def __init__(self, scene: Scene, options: Options) -> None:
        self.scene, self._options = scene, options
        self._verifier = Verifier(scene) if options.verify else None
        self._system: System | None = None
        self._version = 0
        """Number of the scene's state that the system has led to."""
        self.tried: TriedPaths | None = None
        """Paths that cables tried and rejected; None before the first."""
        self._known: tuple[LaidCable, ...] = ()
        """Cables at the last load step."""

    @property
    def system(self) -> System:
        """The scene's potential and its minimiser, made on first use."""
        if self._system is not None and self._version != self.scene.versions.state_version:
            self.release()  # another solver has advanced the scene
        if self._system is None:
            options = self._options
            self._system = System(self.scene, options.prefix, options.rtol, options.slide)
            self._version = self.scene.versions.state_version
        return self._system

    def release(self) -> None:
        """Free the potential's memory; `system` makes it again."""
        if self._system is not None:
            self._system.release()
        self._system = self.tried = None

    @property
    def search(self) -> EquilibriumSearch:
        """A search for the equilibrium, which continues from the paths tried before."""
        system = self.system
        on_lines = all(cable.state.laid.line is not None for cable in self.scene.cables)
        if not self._options.slide or on_lines:
            return EquilibriumSearch(system, None)
        if self.tried is None:
            from crms_fenicsx.cabling.paths.tried_paths import TriedPaths

            self.tried = TriedPaths()
        return EquilibriumSearch(system, self.tried)

    def forget_removed(self) -> None:
        """Drop tried paths of removed cables: a new cable may have the same name."""
        for cable in self._known:
            if self.tried is not None and cable not in self.scene.cables:
                self.tried.forget(cable.name)
        self._known = self.scene.cables

    def resume(self, tried: TriedPaths | None) -> None:
        """Continue from the scene's state and the paths tried before."""
        self.release()
        self.tried, self._known = tried, self.scene.cables

    def restart_h0(self) -> None:
        """Reset H0, so that the next solve equals that of a resumed run."""
        if self._system is not None:
            self._system.reset_h0()

    def solve(
        self, target: Target, first: SceneState, before: SceneState, done: float, goal: float,
        steps: int,
    ) -> Increment:  # fmt: skip
        """Solve and verify an increment; restore the state before if it fails. Collective."""
        try:
            target.apply(self.scene, first, done / steps, goal / steps)
            share = (goal - done) / steps
            prestress = _starting_prestress(self.system, target, share)
            at_once: Callable[[], tuple[float, ...]] | None = None
            if goal > steps - 1e-9:
                loaded = self.scene.comm.allreduce(bool(before.u.any()), op=MPI.LOR)
                whole = partial(_starting_prestress, self.system, target, 1.0, False)
                at_once = whole if loaded else tuple
            found = self._solve(prestress, at_once)
        except BaseException:
            self._restore(before)
            raise
        if not found.outcome.converged:
            self._restore(before)
        return found

    def _solve(
        self, h0_prestress: tuple[float, ...], at_once: Callable[[], tuple[float, ...]] | None
    ) -> Increment:
        """`at_once`: gives that of `lower_state`; None: no states of less energy are looked for."""
        if self._verifier is not None:
            self._verifier.begin()
        search, verification = self.search, None
        outcome = search.find(h0_prestress)
        if outcome.converged and has_free_rim(self.scene):
            outcome = self._iterate_pressure(outcome)
        if outcome.converged and self.scene.loads.has_wind:
            outcome = self._iterate_wind(outcome, search)
        hanging = next((pond for pond in self.scene.ponds if pond.volume < 0.0), None)
        if outcome.converged and hanging is not None:
            size = f"{hanging.volume:.3g}"
            reason = f"the pond {hanging.name!r} has the volume {size}, over cells that face down"
            outcome = replace(outcome, converged=False, reason=reason)
        self.system.release_rows()
        if self._verifier is not None and outcome.converged:
            scatter: tuple[Check, ...] = ()
            if at_once is not None and may_have_others(self.system):
                outcome, scatter = self._lower(outcome, at_once())
            verification = self._verifier.check(self.system, outcome, scatter)
            if not verification.passed:
                outcome = replace(outcome, converged=False, reason=str(verification))
        warnings = self._warnings(outcome) if outcome.converged else ()
        if outcome.converged and verification is not None:
            warnings += verification.warnings
        if self._options.stability == "refuse":
            unstable = [one.text for one in warnings if one.is_unstable]
            if unstable:
                outcome = replace(outcome, converged=False, reason=unstable[0])
        if outcome.converged:
            self._commit()
        return Increment(outcome, verification, warnings)

    def _lower(
        self, outcome: Outcome, at_once: tuple[float, ...]
    ) -> tuple[Outcome, tuple[Check, ...]]:
        """Look for states of less energy, and check how far they are. Collective."""
        found = lower_state(self.system, at_once)
        apart = f"equilibria up to {found.distance:.3g} apart near {as_text(found.place)}"
        where = apart if found.energy > 0.0 else ""
        check = Check(SCATTER_CHECK, found.energy, SAME_VALUE, where, binding=False)
        total, same = outcome + found.outcome, ("converged", "reason", "residual", "nonconvex")
        return replace(total, **{name: getattr(outcome, name) for name in same}), (check,)

    def _warnings(self, outcome: Outcome) -> tuple[StateWarning, ...]:
        """Warnings about the state found. Collective."""
        found = list(_covered_ends(self.scene))
        if self._options.stability != "ignore" and (self.system.bars or self.system.ponds):
            from crms_fenicsx.analysis.equilibrium.instability import instabilities

            found += instabilities(self.system, outcome.tolerance)
        return tuple(found)

    def _iterate_pressure(self, outcome: Outcome) -> Outcome:
        """Solve again under lagged pressure until its forces are normal to the final shape."""
        earlier: list[Array] = []
        for _ in range(BUDGET.follower_solves):
            self._commit()
            more = self.search.find((0.0,))
            outcome = outcome + more
            if more.iterations == 0 or not more.converged:
                return outcome
            earlier.append(np.array([cable.tension for cable in self.scene.cables]))
            turning = _taking_turns(earlier)
            if turning.any():
                names = ", ".join(self.scene.cables[c].name for c in np.flatnonzero(turning))
                reason = (
                    f"{names}: as the pressure at free edges turns, states with different "
                    "contacts or paths alternate; lay them farther from vertices and mesh "
                    "lines beside those edges, and from each other's crossings there"
                )
                return replace(outcome, converged=False, reason=reason, takes_turns=True)
        reason = f"the pressure at free edges still turns after {BUDGET.follower_solves} solves"
        return replace(outcome, converged=False, reason=reason)

    def _iterate_wind(self, outcome: Outcome, search: EquilibriumSearch) -> Outcome:
        """Solve again until the wind forces match the shape found, and rows that slide rest."""
        scene, comm = self.scene, self.scene.comm
        rows = self.system.shifts is not None  # each solve moves them only once
        solves = BUDGET.follower_solves + (BUDGET.changes if rows else 0)
        last: list[Array] = []
        part, (least, most), before = 1.0, PARTS, math.inf
        for _ in range(solves):
            turned = tuple(load.with_current_normals(scene.membrane) for load in scene.loads)
            pairs = list(zip(turned, scene.loads, strict=True))
            changes = [new.factor * (new.forces - old.forces) for new, old in pairs]
            change = np.sum(changes, axis=0)
            size = comm.allreduce(float(np.vdot(change, change)), op=MPI.SUM) ** 0.5
            if size <= self._options.rtol * outcome.scale and self.system.rows_rest:
                return outcome
            if last:  # Aitken's factor: forces that alternate are halved, others go further
                more = change - last[0]
                products = np.array([np.vdot(last[0], more), np.vdot(more, more)])
                comm.Allreduce(MPI.IN_PLACE, products)
                if size > before:  # the factor swings, as where cells slacken and tighten in turn
                    most = max(part / 2, least)
                part *= -products[0] / max(products[1], 1e-300)
                part = float(np.clip(part, least, most))
            last, before = [change], size
            scene.loads.update(
                loads=tuple(
                    replace(new, forces=old.forces + part * (new.forces - old.forces))
                    if new is not old
                    else new
                    for new, old in pairs
                )
            )
            self._commit()
            outcome = outcome + search.find((0.0,))
            if not outcome.converged:
                return outcome
        reason = f"the wind still turns with the membrane after {solves} solves"
        return replace(outcome, converged=False, reason=reason)

    def _commit(self) -> None:
        """End a load step at the state found. Collective."""
        self.system.commit()
        self._version = self.scene.versions.state_version

    def snapshot(self) -> SceneState:
        """The scene's state and the paths tried."""
        return replace(self.scene.state, tried=deepcopy(self.tried))

    def go_back_to(self, snapshot: SceneState) -> None:
        """Restore a state and the paths tried up to it."""
        self._restore(snapshot)
        self.tried, self._known = deepcopy(snapshot.tried), self.scene.cables

    def _restore(self, state: SceneState) -> None:
        """Restore a state of the scene."""
        scene, system = self.scene, self._system
        # Terms hold the history of step-wise laws, so another history needs new terms.
        same = scene.step_history is state.step_history
        keeps = same and self._version == scene.versions.state_version
        scene.state = state
        if system is not None:  # its tables may be for other taut cables
            system.invalidate()
            if keeps:
                self._version = scene.versions.state_version


@dataclass(frozen=True)
class Options:
    """Arguments of `crms_fenicsx.Solver` except the scene."""

    results: Path | None
    resume: bool | None
    prefix: str
    rtol: float
    max_halvings: int
    slide: bool
    verify: bool
    estimate: bool
    stability: Literal["warn", "refuse", "ignore"] = "warn"

    def __post_init__(self) -> None:
        if not 0 < self.rtol < 1:
            raise InputError(f"Solver: rtol = {self.rtol} must be between 0 and 1, as in 1e-9.")
        if self.resume is not None and not isinstance(self.resume, bool):
            raise InputError(f"Solver: resume = {self.resume!r}; expected True, False or None.")
        if self.resume is not None and self.results is None:
            raise InputError(
                f"Solver: resume = {self.resume}, but no results: name a folder for the "
                'checkpoints, as in results="results/dome".'
            )
