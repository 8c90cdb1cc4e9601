"""Load stepping: increments of pressure, end movements and cable lengths, each solved in turn."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Literal
from weakref import WeakMethod

import numpy as np

from crms_fenicsx import checkpoint
from crms_fenicsx.checkpoint import Run
from crms_fenicsx.checkpoint.codec import Plain
from crms_fenicsx.checkpoint.journal import FOLDER, CallProgress, Journal, plain_loads
from crms_fenicsx.equilibrium.search import EquilibriumSearch
from crms_fenicsx.equilibrium.state import State
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.output.figures.draw_scene import Drawing
from crms_fenicsx.output.history import History
from crms_fenicsx.output.recorder import Recorder
from crms_fenicsx.output.report import Reporting
from crms_fenicsx.results.solver_results import SolverResults
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.checks import counted
from crms_fenicsx.runtime.errors import ConvergenceError, InputError, collective
from crms_fenicsx.runtime.interrupt import postponed, stop_together
from crms_fenicsx.runtime.progress import progress
from crms_fenicsx.runtime.readonly import ReadOnly
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.increment_solver import IncrementSolver
from crms_fenicsx.steps.load_cases import LoadCases
from crms_fenicsx.steps.load_step import (
    Step,
    no_equilibrium,
    warn_of_blocked,
    warn_of_friction,
    warn_of_state,
)
from crms_fenicsx.steps.loading import checked_target
from crms_fenicsx.steps.movements import Move
from crms_fenicsx.steps.options import checked_options
from crms_fenicsx.steps.snap_through import SnapThroughSearch

logger = logging.getLogger("crms_fenicsx")

ANOTHER = "make another Solver(scene, ...), which goes on from the scene as it is"
"""What to do instead of assigning a solver's options."""


class Solver(LoadCases, SolverResults, Reporting, Drawing):
    """Brings a scene from one equilibrium to the next.

    Parameters
    ----------
    scene
        The scene; its state is advanced.
    results
        Folder for the history table and the ParaView files; without it none are written. Write
        access is checked now. The first load step (or `load`) reserves the folder for this solver,
        until the solver is deleted or its process ends.
    resume
        Whether to continue a run of this script that was killed or stopped. With True or False each
        load step writes a checkpoint into the folder `results`, which keeps the last one of each
        call to `advance`. With True completed calls take their results from the checkpoints, and
        the interrupted call continues from its last load step; the script repeats everything else,
        such as laying cables and drawing. A script that has changed is refused. With False the
        first load step replaces existing checkpoints. With None, the default, no checkpoints are
        written.
    prefix
        Prefix of this solver's options in PETSc's options database.
    rtol
        Tolerance of the unbalanced force, relative to the largest norm of one kind of nodal
        forces.
    max_halvings
        How often an increment is halved before the solver gives up.
    slide
        Whether cables may slide sideways into other cells. Otherwise they slide only inside the
        cells that they cross, and a `PathWarning` says when they reach a vertex.
    verify
        Whether to check each solved step independently of the gradient and the forms:
        ``step.verification``. A state that fails is treated like a step that did not converge.
    estimate
        Whether the history has columns with the estimated error of each step's energy, see
        `estimate_error`.
    stability
        What to do about an equilibrium that bars, joints or ponds make one that is not stable:
        "warn", by an `InstabilityWarning`; "refuse" it, like a step that did not converge; or
        "ignore" it, without looking.

    Attributes
    ----------
    steps : list of Step
        The accepted steps.

    Raises
    ------
    InputError
        On all ranks: an argument that cannot be used, or a folder that cannot be written.

    Examples
    --------
    A script that goes on after ``python script.py --resume``:

    >>> solver = Solver(scene, results="results/dome", resume="--resume" in sys.argv)
    """

    scene: ReadOnly[Scene] = ReadOnly("_scene", ANOTHER)
    prefix: ReadOnly[str] = ReadOnly("_options.prefix", ANOTHER)
    rtol: ReadOnly[float] = ReadOnly("_options.rtol", ANOTHER)
    max_halvings: ReadOnly[int] = ReadOnly("_options.max_halvings", ANOTHER)
    slide: ReadOnly[bool] = ReadOnly("_options.slide", ANOTHER)

    def __init__(
        self,
        scene: Scene,
        *,
        results: str | FilePath | None = None,
        resume: bool | None = None,
        prefix: str = "crms_",
        rtol: float = 1e-9,
        max_halvings: int = 8,
        slide: bool = True,
        verify: bool = True,
        estimate: bool = False,
        stability: Literal["warn", "refuse", "ignore"] = "warn",
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(f"Solver: scene is of type {type(scene).__name__}; give a Scene.")
        self._options = options = checked_options(
            scene.comm, results=results, resume=resume, prefix=prefix, rtol=rtol,
            max_halvings=max_halvings, slide=slide, verify=verify, estimate=estimate,
            stability=stability,
        )  # fmt: skip
        self._scene, self.comm = scene, scene.comm
        self._increments = IncrementSolver(scene, options)
        scene.fields = WeakMethod(self.fields)
        self.steps: list[Step] = []
        self._recorder = Recorder(scene, options.results, options.estimate)
        self._journal: Journal | None = None
        if options.resume is not None and options.results is not None:
            same = {"rtol": self.rtol, "max_halvings": self.max_halvings, "slide": self.slide}
            self._journal = Journal(options.results / FOLDER, scene.comm, same, options.resume)

    def __repr__(self) -> str:
        """In a line; not collective."""
        return f"Solver({counted(len(self.steps), 'load step')}; {self.scene!r})"

    @property
    def system(self) -> System:
        """The potential of the scene and its minimiser; made when first needed."""
        return self._increments.system

    @property
    def search(self) -> EquilibriumSearch:
        """What finds the equilibrium of each load step; made when first needed."""
        return self._increments.search

    @property
    def history(self) -> History:
        """A row of numbers for each accepted step; `Recorder` says which."""
        return self._recorder.history

    @collective
    def advance(
        self,
        *,
        pressure: float | FanControl | None = None,
        move: Mapping[object, Move] | None = None,
        L0: Mapping[object, float] | None = None,
        load: float | Mapping[str, float] | None = None,
        temperature: float | None = None,
        atmosphere: float | None = None,
        steps: int = 1,
    ) -> Step:
        """Go to new loads in equal increments, and write each state.

        An increment without equilibrium is halved, from the last good state; later increments grow
        again. With the paper's pressure, ``pressure="step"``, an increment of a membrane with free
        edges is solved until the pressure is normal to the state found: an equilibrium of the
        follower pressure, whatever the number of steps.

        Parameters
        ----------
        pressure
            Pressure to reach (force per area), positive to the membrane's outside, or a
            `FanControl`, by which it follows a load in this call.
        move
            Displacements (length) during this call of cables (both ends), cable ends
            (``cable.start``), held joints (``bar.start``) or held groups, or functions that give
            them: `Rotation`, `Way`. A vertex of two groups, such as a corner, moves by the sum.
            Groups need to be held only in the directions in which they move. Cable ends on a moved
            group stay where they are unless they are moved as well.
        L0
            Unstressed lengths of cables and bars to reach (length).
        load
            Factors to reach of loads and ponds, by their names; the other factors stay. If there is
            only one load, a number is its factor.
        temperature, atmosphere
            For sealed air: the absolute temperature to reach, relative to that at sealing, and the
            pressure of the atmosphere (force per area); see `Scene.seal`.
        steps
            Number of increments.

        Returns
        -------
        Step
            The last step.

        Raises
        ------
        InputError
            Loads that cannot be applied, or another solver's folder; nothing is computed then.
        ConvergenceError
            No equilibrium was found; the scene is at the last good state.
        KeyboardInterrupt, SystemExit
            On all ranks, after Ctrl-C or SIGTERM on one of them, which wait for the next evaluation
            of the energy; a second signal ends the process at once. The scene is at the last good
            state, which with `resume` is in a checkpoint.
        """
        scene = self.scene
        air = {"temperature": temperature, "atmosphere": atmosphere}
        checks.same(
            self.comm, "advance", pressure=pressure, move=move, L0=L0, load=load, steps=steps, **air
        )
        checks.whole("advance: steps", steps, 1)
        move, L0 = {} if move is None else move, {} if L0 is None else L0
        target = checked_target(scene, pressure, move, L0, load, steps, **air)
        self._recorder.claim(bool(self._options.resume))
        self._increments.forget_removed()
        if target.is_first_load(scene):
            self.base = self.snapshot()
        first = State.of(scene)
        loads = plain_loads(pressure, target.moves, L0, load, steps, air)
        done, increment = self._resumed(loads)
        search = SnapThroughSearch(self._increments, target, first, steps)
        halvings, began = 0, time.perf_counter()
        spent: Outcome | None = None
        with postponed(scene.comm), progress(scene.comm, steps, "load steps") as bar:
            if done >= 1:
                bar.advance(int(done + 1e-9), "done before")
            while done < steps - 1e-9:
                stop_together(scene.comm)
                goal = min(done + increment, np.floor(done + 1e-9) + 1.0)
                before, history = State.of(scene), scene.step_history
                balanced = scene.in_equilibrium()
                found = self._increments.solve(target, first, before, done, goal, steps)
                outcome = found.outcome
                spent = outcome if spent is None else spent + outcome
                number = len(self.steps) + 1
                if not outcome.converged:
                    halvings, increment = halvings + 1, (goal - done) / 2
                    if increment < 0.5**self.max_halvings * (1 - 1e-9):
                        part = done / steps
                        failure = no_equilibrium(
                            number, outcome, self.max_halvings, part,
                            target.ponds(scene, goal / steps), scene.ponds,
                        )  # fmt: skip
                        self._keep(done, increment, str(failure))
                        raise failure
                    logger.info("halving the increment: %s", outcome.reason)
                    continue
                if outcome.bent:
                    found = search.complete(found, before, history, done, goal, balanced)
                step = Step(
                    number, spent, dict(scene.energies), time.perf_counter() - began, halvings,
                    found.verification, found.warnings,
                )  # fmt: skip
                self._accept(step, before, outcome.unsettled)
                if abs(goal - round(goal)) < 1e-9:
                    bar.advance(1, f"energy {step.energy:.6g}")
                done, increment = goal, min(2 * (goal - done), 1.0)
                self._record(step, done, increment)
                began, spent, halvings = time.perf_counter(), None, 0
        return self.steps[-1]

    def _accept(self, step: Step, before: State, unsettled: float) -> None:
        """Take over a step from a state, and warn of what is crude or in doubt in its state."""
        scene, lasting = self.scene, [one for one in before.warnings if one.lasts]
        scene._warnings = (*lasting, *step.warnings)
        if step.verification is not None:
            step = replace(step, verification=replace(step.verification, warnings=scene.warnings))
        self.steps.append(step)
        scene.versions.settle(scene.membrane.owned_u, step.verification)
        if not self.slide:
            warn_of_blocked(step.number, scene)
        warn_of_friction(step.number, scene, before, unsettled)
        warn_of_state(step.number, scene, step.warnings)

    def _resumed(self, loads: Plain) -> tuple[float, float]:
        """Bring scene and solver to where a call to `advance` has come to before. Collective.

        Returns number of increments that are done, and the next one; 0 and 1 for a new call.
        """
        if self._journal is None:
            return 0.0, 1.0
        come, run = self._journal.begin(self.scene, loads)
        if run is not None:
            self._go_on_from(run)
        if come.failure is not None:
            raise ConvergenceError(come.failure)
        return come.done, come.increment

    def _record(self, step: Step, done: float, increment: float) -> None:
        """Write what is written of a load step; the checkpoint last, as it counts on the others."""
        if self._journal is not None:
            self._journal.make_way()
        self._recorder.write(step, self.system, self.case)
        self._keep(done, increment)

    def _keep(self, done: float, increment: float, failure: str | None = None) -> None:
        """Write a checkpoint of the state that a call to `advance` has come to, if there are."""
        if self._journal is not None:
            self._journal.keep(self.scene, self._run, CallProgress(done, increment, failure))
            self._increments.restart_h0()  # a resumed run takes the same way

    @property
    def _run(self) -> Run:
        """What this solver knows of its load steps."""
        return Run(self.steps, list(self.history), self.scene.step_history, self._increments.tried)

    def _go_on_from(self, run: Run) -> None:
        """Take over the load steps of a run whose state the scene has."""
        self._increments.resume(run.tried)
        self.steps = list(run.steps)
        self._recorder.resume(run.rows)

    @collective
    def save(self, folder: str | FilePath) -> None:
        """Save the state of the scene and of this solver, to go on from. Collective.

        Parameters
        ----------
        folder
            Created where it is missing; a checkpoint that is there is replaced when the new one is
            complete, so that a run that is killed at any moment leaves the old or the new one.

        Raises
        ------
        InputError
            On all ranks: the folder holds something else or cannot be written.

        Examples
        --------
        A run that may be killed saves after each step:

        >>> for pressure in (0.1, 0.2, 0.3):
        ...     solver.advance(pressure=pressure)
        ...     solver.save("results/dome/checkpoint")
        """
        checkpoint.save(folder, self.scene, self._run)
        self._increments.restart_h0()  # what goes on from the checkpoint takes the same way

    @collective
    def load(self, folder: str | FilePath) -> None:
        """Go on from a state that `save` has saved, on any number of processes. Collective.

        The script builds mesh, scene and solver as before. Held vertices, floor, loads, cables and
        bars come from the checkpoint and replace those given so far; cables and bars of the same
        name stay the objects. What follows is as if the run had not ended. Results go on, too,
        where the solver's folder has those of the steps before.

        Parameters
        ----------
        folder
            Where the checkpoint is.

        Raises
        ------
        InputError
            On all ranks: a solver that has made steps, a checkpoint of another mesh, material or
            law (it says which), one that is missing or damaged, or results in a folder to which
            another solver writes. The scene is then as before.

        Examples
        --------
        >>> scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
        >>> solver = Solver(scene, results="results/dome")
        >>> solver.load("results/dome/checkpoint")
        >>> solver.advance(L0={scene.cable("ridge"): 99.0})
        """
        if self.steps:
            raise InputError(
                f"load: there are {len(self.steps)} load steps already; load into a new scene and "
                "solver."
            )
        self._recorder.claim(going_on=True)
        self._go_on_from(checkpoint.load(folder, self.scene))
