"""Load stepping: increments of loads, movements and unstressed lengths, solved one by one."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.increment_solver import IncrementSolver, Options
from crms_fenicsx.analysis.steps.load_cases import (
    Combination,
    branched,
    checked_combinations,
    checked_states,
    combined,
    staged,
)
from crms_fenicsx.analysis.steps.loading import checked_target
from crms_fenicsx.analysis.steps.movements import Move
from crms_fenicsx.analysis.steps.snap_through import SnapThroughSearch
from crms_fenicsx.analysis.steps.step_record import (
    Step,
    no_equilibrium,
    warn_of_blocked,
    warn_of_friction,
    warn_of_state,
    warn_of_staying,
)
from crms_fenicsx.cabling.contact.contact_force import ContactForces, contact_forces
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import (
    Count,
    File,
    Finite,
    Name,
    NonNegative,
    PerRank,
    Positive,
    Prefix,
    Whole,
    collective,
)
from crms_fenicsx.foundation.runtime.errors import ConvergenceError, InputError, raised_together
from crms_fenicsx.foundation.runtime.handle import ReadOnly
from crms_fenicsx.foundation.runtime.interrupt import postponed, stop_together
from crms_fenicsx.foundation.runtime.progress import progress
from crms_fenicsx.model.combination_table import CombinationTable
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Marker
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.model.versions import last_doubt
from crms_fenicsx.results.output.history import History
from crms_fenicsx.results.output.recorder import Recorder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from crms_fenicsx.results.cable_and_bar_results import CableResults, ClampResults
    from crms_fenicsx.results.checkpoint import Run
    from crms_fenicsx.results.checkpoint.journal import Journal
    from crms_fenicsx.results.error_estimate import ErrorEstimate
    from crms_fenicsx.results.membrane_results import MembraneResults
    from crms_fenicsx.results.rain import PondingCheck
    from crms_fenicsx.results.reactions import Reactions, Residual, Tangent
    from crms_fenicsx.results.sensitivities import Sensitivities
    from crms_fenicsx.results.summary import DesignTable, Summary


logger = logging.getLogger("crms_fenicsx")

ANOTHER = "make another Solver(scene, ...), which continues from the scene as it is"
"""Remedy in errors about assigning a solver's options."""


class Solver:
    """Advances a scene from one equilibrium to the next.

    Parameters
    ----------
    scene
        The scene; load steps change its state.
    results
        Folder for history and ParaView files; None writes none. The first load step (or `load`)
        reserves it until the solver is deleted or its process ends.
    resume
        Whether to continue a run of this script that was killed or stopped. True and False write a
        checkpoint after each load step into `results`, and keep the last one of each call of
        `advance`. With True, completed calls are restored from there, the interrupted one
        continues from its last load step, and the script repeats everything else, such as laying
        cables; a changed script is refused. With False, the first load step replaces old
        checkpoints. None, the default, writes none.
    prefix
        Prefix of this solver's PETSc options.
    rtol
        Tolerance of unbalanced forces, relative to the largest norm among kinds of nodal forces.
    max_halvings
        How often an increment is halved before the solver gives up.
    slide
        Whether cables may slide sideways into other cells, or with their lines of the mesh. If not,
        they stay in the cells that they cross, and a `PathWarning` reports when they reach a
        vertex; cables along lines are held on the fabric, as in pockets.
    verify
        Whether to check each solved step independently of the gradient and the forms; see
        ``step.verification``. A state that fails counts as not converged.
    estimate
        Whether the history records each step's estimated error, see `estimate_error`.
    stability
        Treatment of an equilibrium made unstable by bars, joints or ponds: "warn" by an
        `InstabilityWarning`, "refuse" as not converged, or "ignore" without checking.

    Attributes
    ----------
    steps : list of Step
        Accepted load steps.
    stages : dict
        `Combination` of each `stage` by name, for `judge` and `report`:
        ``solver.report("tent.html", solver.stages | solver.combine({...}))``.

    Raises
    ------
    InputError
        On all ranks: an invalid argument, or a folder that cannot be written.

    Examples
    --------
    A script that continues with ``python script.py --resume``:

    >>> solver = Solver(scene, results="results/dome", resume="--resume" in sys.argv)
    """

    scene: ReadOnly[Scene] = ReadOnly("_scene", ANOTHER)
    """The scene that it solves."""
    prefix: ReadOnly[str] = ReadOnly("_options.prefix", ANOTHER)
    rtol: ReadOnly[float] = ReadOnly("_options.rtol", ANOTHER)
    max_halvings: ReadOnly[int] = ReadOnly("_options.max_halvings", ANOTHER)
    slide: ReadOnly[bool] = ReadOnly("_options.slide", ANOTHER)

    @collective
    def __init__(
        self,
        scene: Scene,
        *,
        results: File | None = None,
        resume: bool | None = None,
        prefix: Prefix = "crms_",
        rtol: Finite = 1e-9,
        max_halvings: Whole = 8,
        slide: bool = True,
        verify: bool = True,
        estimate: bool = False,
        stability: Literal["warn", "refuse", "ignore"] = "warn",
    ) -> None:
        self._options = options = Options(
            results=None if results is None else Path(results), resume=resume, prefix=prefix,
            rtol=rtol, max_halvings=max_halvings, slide=slide, verify=verify, estimate=estimate,
            stability=stability,
        )  # fmt: skip
        self._scene, self.comm = scene, scene.comm
        self._increments = IncrementSolver(scene, options)
        self.steps: list[Step] = []
        self.case = ""
        """Name of the branch or stage of the load steps; "" outside."""
        self.stages: dict[str, Combination] = {}
        self.base: SceneState | None = None
        """State at which the first loads were applied; None before."""
        self._recorder = Recorder(scene, options.results, options.estimate)
        self._journal: Journal | None = None
        if options.resume is not None and options.results is not None:
            from crms_fenicsx.results.checkpoint.journal import FOLDER, Journal

            same = {k: x for k, x in vars(options).items() if k not in ("results", "resume")}
            self._journal = Journal(options.results / FOLDER, scene.comm, same, options.resume)

    def __repr__(self) -> str:
        """One line; not collective."""
        return f"Solver({checks.counted(len(self.steps), 'load step')}; {self.scene!r})"

    @property
    def system(self) -> System:
        """The scene's potential and its minimiser, made on first use."""
        return self._increments.system

    @property
    def search(self) -> EquilibriumSearch:
        """Search for the equilibrium of each load step, made on first use."""
        return self._increments.search

    @property
    def history(self) -> History:
        """Table with a row for each accepted step."""
        return self._recorder.history

    @collective
    def advance(
        self,
        *,
        pressure: float | FanControl | Sequence[FanControl] | None = None,
        move: Mapping[object, Move] | None = None,
        L0: Mapping[object, float] | None = None,
        load: float | Mapping[str, float] | None = None,
        temperature: float | None = None,
        atmosphere: float | None = None,
        steps: Count = 1,
    ) -> Step:
        """Advance to new loads in equal increments, and write each state.

        An increment without equilibrium is halved, starting from the last good state; later
        increments grow again. With ``pressure="lagged"`` and free edges an increment is repeated
        until the pressure is normal to the final shape, an equilibrium of the follower pressure
        independent of the number of steps.

        Parameters
        ----------
        pressure
            Target pressure (force per area), positive outward, or a `FanControl`, with which it
            follows a load in this call, or several, of which the highest pressure counts.
        move
            Displacements (length) during this call, or functions of them (`Rotation`, `Way`), of
            cables (both ends), cable ends (``cable.start``), held joints (``bar.start``) or held
            groups. A vertex of two groups moves by the sum. Groups need supports only in the
            directions of movement. Ends of bonded cables and of cables in pockets or along lines of
            the mesh that are held on a moved edge or vertex go with it unless given themselves.
            Those of other cables are anchored in space and stay, with a `PathWarning` unless they
            are given.
        L0
            Target unstressed lengths of cables and bars (length).
        load
            Target factors of loads and ponds by name; others keep theirs. A number is the factor of
            the only load.
        temperature, atmosphere
            For sealed air: target absolute temperature, relative to that at sealing, and
            atmospheric pressure (force per area); see `Scene.seal`.
        steps
            Number of increments.

        Returns
        -------
        Step
            The last step.

        Raises
        ------
        InputError
            Invalid loads, or another solver's folder; nothing is computed.
        ConvergenceError
            No equilibrium found; the scene keeps the last good state.
        KeyboardInterrupt, SystemExit
            On all ranks, after Ctrl-C or SIGTERM on one of them, at the next evaluation of the
            energy; a second signal ends the process at once. The scene keeps the last good state,
            which with `resume` is in a checkpoint.

        Examples
        --------
        >>> scene.put_load((0.0, 0.0, -0.2), name="snow", per="plan")
        >>> step = solver.advance(pressure=0.8, load={"snow": 1.5}, steps=2)
        >>> round(ridge.tension, 2)
        3.33
        >>> solver.advance(L0={ridge: 0.995 * ridge.L0}).verification.verdict
        'verified'
        """
        scene = self.scene
        air = {"temperature": temperature, "atmosphere": atmosphere}
        move, L0 = {} if move is None else move, {} if L0 is None else L0
        target = checked_target(scene, pressure, move, L0, load, steps, **air)
        warn_of_staying(scene, target.movements.staying_ends)
        self._recorder.claim(bool(self._options.resume))
        self._increments.forget_removed()
        if target.is_first_load(scene):
            self.base = self.snapshot()
        first = scene.state
        given = {"pressure": pressure, "load": load, "move": target.movements.samples, "L0": L0}
        done, increment = self._resumed(given | {"steps": steps} | air)
        search = SnapThroughSearch(self._increments, target, first, steps)
        halvings, turns, began = 0, 0, time.perf_counter()
        spent: Outcome | None = None
        with postponed(scene.comm), progress(scene.comm, steps, "load steps") as bar:
            if done >= 1:
                bar.advance(int(done + 1e-9), "done before")
            while done < steps - 1e-9:
                stop_together(scene.comm)
                goal = min(done + increment, np.floor(done + 1e-9) + 1.0)
                before = scene.state
                balanced = scene.in_equilibrium()
                found = self._increments.solve(target, first, before, done, goal, steps)
                outcome = found.outcome
                spent = outcome if spent is None else spent + outcome
                number = len(self.steps) + 1
                if not outcome.converged:
                    halvings, increment = halvings + 1, (goal - done) / 2
                    turns += outcome.takes_turns  # of states under turning pressure
                    if increment < 0.5**self.max_halvings * (1 - 1e-9) or turns > 3:
                        part, halved = done / steps, round(-np.log2(2 * increment))
                        ponds = target.ponds(scene, goal / steps)
                        failure = no_equilibrium(number, outcome, halved, part, ponds, scene.ponds)
                        self._keep(done, increment, str(failure))
                        raise failure
                    logger.info("halving the increment: %s", outcome.reason)
                    continue
                jump = search.find(before, done, goal, balanced) if outcome.nonconvex else None
                step = Step(
                    number, spent, dict(scene.energies), time.perf_counter() - began, halvings,
                    found.verification, found.warnings if jump is None else (jump, *found.warnings),
                )  # fmt: skip
                whole = abs(goal - round(goal)) < 1e-9
                self._accept(step, before, outcome.unsettled, whole)
                if whole:
                    bar.advance(1, f"energy {step.energy:.6g}")
                done, increment = goal, min(2 * (goal - done), 1.0)
                self._keep(done, increment)
                began, spent, halvings = time.perf_counter(), None, 0
        return self.steps[-1]

    def _accept(self, step: Step, before: SceneState, unsettled: float, whole: bool) -> None:
        """Accept a step that started from `before`, warn, and write history and files; parts of a
        divided increment are not told to be doubtful."""
        scene, lasting = self.scene, [one for one in before.warnings if one.lasts]
        scene.record(warnings=(*lasting, *step.warnings))
        if step.verification is not None:
            step = replace(step, verification=replace(step.verification, warnings=scene.warnings))
        self.steps.append(step)
        scene.versions.settle(scene.membrane.owned_u, step.verification)
        if not self.slide:
            warn_of_blocked(step.number, scene)
        warn_of_friction(step.number, scene, before, unsettled)
        told = [one for one in step.warnings if whole or one.kind != "doubtful"]
        warn_of_state(step.number, scene, told)
        if self._journal is not None:
            self._journal.remove_outdated()
        self._recorder.write(step, self.system, self.case)

    def _resumed(self, given: Mapping[str, Any]) -> tuple[float, float]:
        """Restore the progress of a call: increments done, and the next increment. Collective."""
        if self._journal is None:
            return 0.0, 1.0
        come, run = self._journal.begin(self.scene, given)
        if run is not None:
            self._go_on_from(run)
        if come.failure is not None:
            raise ConvergenceError(come.failure)
        return come.done, come.increment

    def _keep(self, done: float, increment: float, failure: str | None = None) -> None:
        """Write a checkpoint, if enabled."""
        if self._journal is not None:
            self._journal.keep(self.scene, self._run, done, increment, failure)
            self._increments.restart_h0()  # so that a resumed run repeats the same iterations

    @property
    def _run(self) -> Run:
        """The record of this solver's load steps."""
        from crms_fenicsx.results.checkpoint import Run

        return Run(self.steps, list(self.history), self._increments.tried)

    def _go_on_from(self, run: Run) -> None:
        """Take over the load steps of a run whose state is restored."""
        self._increments.resume(run.tried)
        self.steps = list(run.steps)
        self._recorder.resume(run.rows)

    @collective
    def snapshot(self) -> SceneState:
        """Snapshot of the scene and this solver, for `restore`.

        Collective. It stays in memory; `save` writes to a folder.

        Examples
        --------
        >>> calm = solver.snapshot()
        >>> step = solver.advance(pressure=2.0)
        >>> solver.restore(calm)
        >>> scene.pressure
        1.0
        """
        return self._increments.snapshot()

    @collective
    def restore(self, snapshot: PerRank[SceneState]) -> None:
        """Restore a state of the scene. Collective.

        Displacements, loads, supports, cables and added terms revert; load steps, history and files
        continue.

        Parameters
        ----------
        snapshot
            A state of the same scene.

        Raises
        ------
        InputError
            On all ranks: not a snapshot, or one of another scene.

        Examples
        --------
        >>> calm = solver.snapshot()
        >>> for pressure in (1.5, 2.0):
        ...     solver.restore(calm)
        ...     step = solver.advance(pressure=pressure)
        ...     print(pressure, round(ridge.tension, 1))
        1.5 6.6
        2.0 8.0
        """
        with raised_together(self.scene.comm):
            checks.of_type("restore: snapshot", snapshot, SceneState)
            if snapshot.scene is not self.scene:
                raise InputError("restore: the snapshot belongs to another scene.")
        self._increments.go_back_to(snapshot)

    @collective
    def branch(self, name: Name) -> AbstractContextManager[SceneState]:
        """Run load steps as a branch, and restore the scene's state afterwards. Collective.

        Parameters
        ----------
        name
            Name of the branch in the history's column "case".

        Yields
        ------
        SceneState
            Initial state of the branch, restored afterwards, also after an error.

        Raises
        ------
        InputError
            On all ranks: a name that is not a text, or a nested branch.

        Examples
        --------
        >>> with solver.branch("snow + wind"):
        ...     solver.advance(load={"snow": 1.5, "wind": 0.9})
        ...     tensions = [cable.tension for cable in scene.cables]
        """
        return branched(self, name)

    @collective
    def combine(
        self, combinations: Mapping[str, Mapping[str, Any]], *, steps: Count = 1
    ) -> dict[str, Combination]:
        """Apply load combinations, each from the current state, then restore it. Collective.

        Parameters
        ----------
        combinations
            By name of combination, the factors of its loads by name, and "pressure", "temperature"
            and "atmosphere" if they change, as in `Solver.advance`. Other loads stay: an empty
            combination is the base state. Further names: "state", the limit state that it is for:
            "ULS" (the default), "accidental", "erection" ..., or for serviceability
            "characteristic", "frequent", "quasi-permanent"; "prestress", a partial factor of the
            fabric's prestress, the forces that cables and bars have now, and the pressure;
            "without", names of cables and bars that are missing.
        steps
            Number of increments of each combination.

        Returns
        -------
        dict
            `Combination` by name, in rank 0's order.

        Raises
        ------
        InputError
            On all ranks, before anything is computed: an unknown load, limit state, cable or bar,
            a factor that is not finite, a combination without its design strength
            (`codes.FabricDesign`), a prestress that cannot be scaled, or an invalid number of
            steps.
        ConvergenceError
            A combination has no equilibrium; the message names it.

        Examples
        --------
        >>> found = solver.combine({
        ...     "snow": {"weight": 1.35, "snow": 1.5},
        ...     "storm": {"weight": 1.0, "wind along x": 1.5, "pressure": 0.6},
        ...     "calm": {"weight": 1.0, "state": "quasi-permanent"},
        ...     "ridge torn": {"weight": 1.0, "state": "accidental", "without": ["ridge"]},
        ... })
        >>> max(("snow", "storm"), key=lambda name: found[name].snapshot.tensions["ridge"])
        """
        table = combinations if isinstance(combinations, CombinationTable) else None
        return combined(self, checked_combinations(self.scene, combinations), steps, table)

    @collective
    def stage(self, name: Name, *, state: str = "erection") -> AbstractContextManager[SceneState]:
        """Change the scene to the next stage of erection, or of a failure. Collective.

        The block begins in the stage before. It may remove or add cables, bars, loads and
        supports, and call `advance` any number of times; a load step follows at its end if it
        changed the scene since. The stage is then in `stages`, judged by its limit state; the scene
        stays in it. After an error the scene is as before the block, and there is no such stage.

        Parameters
        ----------
        name
            Name of the stage, also in the history's column "case".
        state
            Limit state that it is for, such as "erection" or "accidental".

        Yields
        ------
        SceneState
            The state before, from which displacements in the stage are measured.

        Raises
        ------
        InputError
            On all ranks: an unknown limit state, one without its design strength
            (`codes.FabricDesign`), a name given before, or a stage within a branch or stage.
        ConvergenceError
            The stage has no equilibrium; the message names it.

        Examples
        --------
        >>> with solver.stage("ridge tightened"):
        ...     solver.advance(L0={ridge: 0.995 * ridge.L0})
        >>> with solver.stage("ridge removed"):
        ...     scene.remove("ridge")
        >>> list(solver.stages)
        ['ridge tightened', 'ridge removed']
        """
        return staged(self, name, state)

    @collective
    def check_ponding(self, rain: Positive, *, weight: Positive = 10.0) -> PondingCheck:
        """Check for ponding: fill the hollows with rain, repeatedly, as the membrane deflects under
        it. The scene's state is restored. Collective.

        Parameters
        ----------
        rain
            Depth of rain on the roof's plan (length). Each hollow takes at most all of it; a large
            value fills hollows until they overflow.
        weight
            Specific weight of water (force / length cubed); 10 kN / m^3.

        Returns
        -------
        PondingCheck
            The same on all ranks except the snapshot.

        Raises
        ------
        InputError
            On all ranks: a depth or weight that is not positive.

        Examples
        --------
        >>> check = solver.check_ponding(rain=0.1)
        >>> print(check)
        >>> check.dry, check.settled, check.depth
        """
        from crms_fenicsx.results.rain import NAME, Rain, acting_loads

        water, why, loads = Rain(self.scene, rain, weight), "", acting_loads(self.scene, self.case)
        before = self.snapshot()
        with nullcontext() if self.case else self.branch(NAME):
            try:
                water.put()
                with last_doubt(self.scene):
                    while water.fill():
                        self.advance(load={NAME: 1.0})
            except ConvergenceError as error:
                why = f"there is no equilibrium with it ({error})"
            finally:
                reached = self.snapshot()
                self.restore(before)
        return water.check(reached, why, loads)

    @collective
    def results(self) -> MembraneResults:
        """Section forces, strains and state of the membrane's cells. Collective.

        Returns
        -------
        MembraneResults
            Values in this rank's cells, in the current state.

        Examples
        --------
        >>> results = solver.results()
        >>> float(results.values("true force 1").max().round(1))
        6.6
        >>> results.shares()  # slack, wrinkled, taut
        (0.0, 0.0, 1.0)
        """
        from crms_fenicsx.results.membrane_results import membrane_results

        return membrane_results(self.system)

    @collective
    def reactions(self, where: str | Marker) -> Reactions:
        """Reactions of the supports at a place on everything attached there, in the current
        state.

        Collective. They hold the membrane, and each end of a cable or bar whose anchor or held
        joint is at one of the vertices, or on an edge between two of them.

        Parameters
        ----------
        where
            Vertices, as for `Scene.vertices`, or the name of a held joint, such as "start of mast".

        Returns
        -------
        Reactions
            Their sum, each part by name, and the reaction at each of this rank's vertices.

        Raises
        ------
        InputError
            As `Scene.vertices`.

        Examples
        --------
        >>> corner = solver.reactions("front left")
        >>> corner.total, corner.membrane, corner.parts
        """
        from crms_fenicsx.results.reactions import reactions

        return reactions(self.system, where)

    @collective
    def contact_forces(self, cable: LaidCable) -> ContactForces:
        """Contact forces of a cable on the membrane at its points, in the current state.
        Collective.

        Parameters
        ----------
        cable
            A cable of the scene.

        Returns
        -------
        ContactForces
            At the points of the cable's `line`; ``line`` is the force per length of cable.

        Raises
        ------
        InputError
            Not a cable of this scene.

        Examples
        --------
        >>> forces = solver.contact_forces(ridge)
        >>> round(float(forces.normal.sum()), 1)
        1.4
        """
        checks.own("contact_forces", "cable", cable, self.scene.cables)
        shape, beside = self.scene.net.strip_shape(), self.system.forces_beside()
        return contact_forces(cable, shape, beside.get(cable)).at(cable.line_nodes())

    @collective
    def cable_forces(self) -> dict[str, CableResults]:
        """Tensions, contact and end forces of the cables, in the current state. Collective.

        Returns
        -------
        dict
            Results by cable name, the same on all ranks.

        Examples
        --------
        >>> for name, cable in solver.cable_forces().items():
        ...     print(f"{name}: {cable.least:.3g} to {cable.largest:.3g}")
        """
        from crms_fenicsx.results.cable_and_bar_results import cable_results

        return cable_results(self.scene)

    @collective
    def clamp_forces(self) -> dict[str, ClampResults]:
        """Forces of the clamps between cables, in the current state. Collective.

        Returns
        -------
        dict
            Results by clamp name, the same on all ranks.

        Examples
        --------
        >>> max(clamp.size for clamp in solver.clamp_forces().values())
        """
        from crms_fenicsx.results.cable_and_bar_results import clamp_results

        return clamp_results(self.scene)

    @collective
    def summary(self) -> Summary:
        """Extreme values of the current state, for tables and envelopes. Collective.

        Returns
        -------
        Summary
            The same on all ranks.

        Examples
        --------
        >>> summary = solver.summary()
        >>> round(summary.membrane.largest["true force 1"].value, 1)
        6.6
        >>> round(summary.cables["ridge"].largest, 2)
        5.02
        """
        from crms_fenicsx.results.summary import summary

        return summary(self.system)

    @collective
    def judge(self, combinations: PerRank[Mapping[str, Combination]]) -> DesignTable:
        """Judge combinations by strengths and limits: what governs in each limit state. Collective.

        The scene's own state is restored.

        Parameters
        ----------
        combinations
            Result of `combine`, or `stages`.

        Returns
        -------
        DesignTable
            The same on all ranks; ``print`` shows it.

        Raises
        ------
        InputError
            On all ranks: no combinations, or those of another scene.

        Examples
        --------
        >>> scene.set_strengths((84.0, 80.0), cables=50.0)
        >>> table = solver.judge(solver.combine({"full": {}, "half": {"pressure": 0.5}}))
        >>> [(name, check.what, check.member) for _, name, check in table.rows]
        [('full', 'fabric', ''), ('full', 'cable', 'ridge')]
        """
        from crms_fenicsx.results.summary import judged

        return judged(self, checked_states("judge", self.scene, combinations))

    @collective
    def estimate_error(self) -> ErrorEstimate:
        """Estimate the discretisation error of the current state's energy, which is too high.
        Collective.

        The cost is about that of `results`. In the cases with references the estimate is 0.4 to 2.6
        times the true error (`tests/results/test_error_estimate.py`). It does not include the area
        between a curved boundary and its polygon.

        Returns
        -------
        ErrorEstimate
            Total of the membrane, and the contributions of this rank's cells.

        Raises
        ------
        InputError
            On all ranks: the scene was changed since its last load step, or there was none.

        Examples
        --------
        >>> solver.estimate_error().relative
        """
        from crms_fenicsx.results.error_estimate import ErrorEstimator

        self.scene.require_equilibrium("estimate_error")
        return ErrorEstimator(self.scene).of(self.system)

    @collective
    def residual(self) -> Residual:
        """Unbalanced forces in the current state, to be destroyed after use. Collective.

        They are the gradient of the potential energy: in equilibrium zero except at supports, where
        they are the support forces, and where the floor presses.

        Returns
        -------
        Residual
            As a function on `Scene.V`, by joint, and as a vector of all unknowns.

        Examples
        --------
        >>> residual = solver.residual()
        >>> residual.vector.norm()  # without what is held
        >>> residual.destroy()
        """
        from crms_fenicsx.results.reactions import residual

        return residual(self.system)

    @collective
    def tangent(self) -> Tangent:
        """Tangent stiffness in the current state, to be destroyed after use. Collective.

        It is the exact second derivative of the potential energy except for the terms in
        ``inexact``.

        Returns
        -------
        Tangent
            A PETSc matrix for vectors such as that of `residual`.

        Examples
        --------
        A Newton step for a membrane without cables:

        >>> residual, tangent = solver.residual(), solver.tangent()
        >>> ksp = PETSc.KSP().create(scene.comm)
        >>> ksp.setOperators(tangent.matrix, tangent.sparse)
        >>> step = residual.vector.duplicate()
        >>> ksp.solve(residual.vector, step)
        >>> owned = 3 * scene.V.dofmap.index_map.size_local
        >>> scene.u.x.array[:owned] -= step.array[:owned]
        >>> scene.u.x.scatter_forward()
        """
        from crms_fenicsx.results.reactions import tangent

        return tangent(self.system)

    @collective
    def sensitivities(self, of: Sequence[object], by: Sequence[object]) -> Sensitivities:
        """Derivatives of results by lengths, loads and stiffnesses in the current equilibrium.

        Collective. They use the exact tangent, with the present cable paths, contacts and slack
        parts of cables. Where sewn cables are about to become taut or slack, they are taken in both
        directions.

        Parameters
        ----------
        of
            Results: cables and bars (tension, axial force), ends of cables (size of the reaction),
            "energy", "volume", and coordinates of vertices, as ``(scene.vertex_at(p), "z")``.
        by
            Parameters: cables and bars (unstressed length), "pressure", names of loads (factor),
            and stiffnesses of cables, ``("EA", cable)``.

        Returns
        -------
        Sensitivities
            The same on all ranks.

        Raises
        ------
        InputError
            On all ranks: an unsupported result or parameter, a temperature load on fabric that
            cables fold or slide over, a scene out of equilibrium, friction
            or step-wise laws, or a singular tangent.

        Examples
        --------
        >>> found = solver.sensitivities([ridge, "energy"], [ridge, "pressure", "snow"])
        >>> found[ridge, "pressure"]
        """
        self.scene.require_equilibrium("sensitivities")
        from crms_fenicsx.results.sensitivities import sensitivities

        return sensitivities(self.system, of, by)

    def draw(self, filename: str | Path | None = None, **options: Any) -> Figure | None:
        """Draw the scene in its current state with `output.draw`. Collective.

        Parameters
        ----------
        filename
            Picture to write, in the format of its suffix (.png, .pdf, .svg ...). None returns it.
        **options
            Options of `draw`: ``colour``, ``unit``, ``force``, ``ghost``, ``view`` ...

        Returns
        -------
        matplotlib.figure.Figure
            On the first rank, if there is no filename; a notebook shows it. Else None.

        Raises
        ------
        InputError
            On all ranks: an unknown colour or option, or a file that cannot be written.

        Examples
        --------
        In a notebook:

        >>> solver.draw(colour="stress", unit="m", force="kN")
        """
        from crms_fenicsx.results.output.figures.draw_scene import draw

        return draw(self, filename, **options)

    @collective
    def report(
        self, filename: File,
        combinations: PerRank[Mapping[str, Combination] | None] = None, **options: Any,
    ) -> None:  # fmt: skip
        """Write a report for the checking engineer: HTML page, CSV tables, PDF. Collective.

        The page has a verdict with its reasons, what governs in each limit state, lines for
        signatures, the basis of design, materials, model, loads and combinations, section forces,
        utilisation and envelopes, pictures of governing combinations, cables, bars, ponds,
        foundation forces and the checks of all equilibria. It needs no other files or network, and
        is smaller than 5 MB. The tables lie beside ``tent.html``, as ``tent_membrane.csv``, with
        full precision. Results belong to the combinations' states, with their model and base state;
        strengths are the present ones. The scene's own state is restored. Without combinations the
        page warns in red if the scene has changed since its last load step. Ten or more bars whose
        names differ in a final number share rows on the page.

        Parameters
        ----------
        filename
            Name of the page, ending in .html. Older files are replaced once all new ones are
            complete.
        combinations
            Result of `combine`, or `stages`, or both, ``solver.stages | found``; stages have a
            chapter of their own. By default the current state alone.
        **options
            ``title``: heading. ``about``: names and texts below it; "Office", "Project", "Author",
            "Checker", "Revision" and "Date" also in the PDF's head and signatures. ``basis``:
            names and texts of the basis of design, as ``{"Codes": "EN 1990"}``.
            ``unit``, ``force``: names of the units of length and force. ``pictures``: membrane
            colours of each combination's pictures, as for `draw`, or "tension" of cables and bars;
            by default tension, displacement, section forces and utilisation. Of more than 12, those
            of governing combinations. Too large a page omits the last ones. ``view``:
            viewpoint, as for `draw`. ``sections``: additional ones, as of
            `design.patterns.report_sections`. ``order``: fabrication lengths of cables, from
            `nets.lengths_to_order`. ``foundations``: ends of cables and joints on each
            foundation, as ``{"F1": ["A1 start", "mast foot"]}``; ends at the same place belong
            together. ``strain_limit``: of the membrane's major principal strain, by default 0.1.
            ``template``: a jinja2 file, which may extend "report.html". ``pdf``: whether to write a
            PDF too, with WeasyPrint. ``interactive``: whether to write a rotatable view of each
            combination, as ``tent_view_1.html``, with pyvista and its trame.

        Raises
        ------
        InputError
            On all ranks, before anything is written: an invalid argument, a file that cannot be
            written, no WeasyPrint for PDF, an unfit template, or combinations of different models;
            the message names the difference.
        ImportError
            On all ranks: pyvista or trame is missing for `interactive`.

        Examples
        --------
        >>> found = solver.combine({"snow": {"snow": 1.5}, "storm": {"wind": 1.5}})
        >>> solver.report("results/tent.html", found, title="Tent", unit="m", force="kN")
        """
        from crms_fenicsx.results.output.report.reporting import write_report

        write_report(self, filename, combinations, **options)

    @collective
    def to_pyvista(self, *, radius: NonNegative | None = None) -> Any:
        """The current state as pyvista meshes with the ParaView files' arrays. Collective.

        Parameters
        ----------
        radius
            Radius of the tubes for cables and bars (length), by default 0.3 % of the membrane's
            size; 0 draws lines.

        Returns
        -------
        pyvista.MultiBlock
            On the first rank, else None. Blocks: "membrane" (deformed surface with the facets of
            folded cells, "displacement" at points, section forces and state of cells), "cables" and
            "bars" ("tension" of segments, "lifted", "contact force", number of the "line"),
            "supports" (held vertices, with the "held" directions) and "joints"; empty blocks are
            omitted. Names of cables, bars and joints are in ``field_data["names"]``.

        Raises
        ------
        InputError
            On all ranks: a radius that is negative or not finite.
        ImportError
            On all ranks: pyvista is missing.

        Examples
        --------
        >>> blocks = solver.to_pyvista()
        >>> plotter = pyvista.Plotter()
        >>> plotter.add_mesh(blocks["membrane"], scalars="true force 1", show_edges=True)
        >>> plotter.add_mesh(blocks["cables"], scalars="tension", cmap="YlOrRd")
        >>> plotter.show()
        """
        from crms_fenicsx.results.quantities import fields_of
        from crms_fenicsx.results.view_data import to_pyvista

        return to_pyvista(self.scene, fields_of(self.results()), radius)

    @collective
    def save(self, folder: File) -> None:
        """Save the state of the scene and this solver in a checkpoint. Collective.

        Parameters
        ----------
        folder
            Created if missing. An existing checkpoint is replaced once the new one is complete, so
            a run killed at any moment leaves the old or the new one.

        Raises
        ------
        InputError
            On all ranks: the folder has other contents or cannot be written.

        Examples
        --------
        A run that may be killed saves after each step:

        >>> for pressure in (0.1, 0.2, 0.3):
        ...     solver.advance(pressure=pressure)
        ...     solver.save("results/dome/checkpoint")
        """
        from crms_fenicsx.results import checkpoint

        checkpoint.save(folder, self.scene, self._run)
        self._increments.restart_h0()  # so that a resumed run repeats the same iterations

    @collective
    def load(self, folder: File) -> None:
        """Continue from a checkpoint of `save`, on any number of processes. Collective.

        The script builds mesh, scene and solver as before. Held vertices, floor, loads, cables and
        bars of the checkpoint replace those defined so far; cables and bars of the same name keep
        their Python objects. The run continues as if uninterrupted, and so do results files that
        exist in the solver's folder.

        Parameters
        ----------
        folder
            Folder of the checkpoint.

        Raises
        ------
        InputError
            On all ranks: a solver with load steps, a checkpoint of another mesh, material or law
            (the message names it), a missing or damaged one, or results in a folder that another
            solver writes. The scene is then unchanged.

        Examples
        --------
        >>> scene = Scene(mesh, fabric)
        >>> solver = Solver(scene, results="results/dome")
        >>> solver.load("results/dome/checkpoint")
        >>> step = solver.advance(L0={scene.cable("ridge"): 3.99})
        """
        if self.steps:
            raise InputError(
                f"load: there are {len(self.steps)} load steps already; load into a new scene and "
                "solver."
            )
        self._recorder.claim(going_on=True)
        from crms_fenicsx.results import checkpoint

        self._go_on_from(checkpoint.load(folder, self.scene))
