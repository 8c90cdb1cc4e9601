"""Load stepping: increments of pressure, end movements and cable lengths, each solved in turn."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from crms_fenicsx.contact.contact_force import ContactForces, contact_forces
from crms_fenicsx.equilibrium.search import EquilibriumSearch
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Marker
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.output.history import History
from crms_fenicsx.output.recorder import Recorder
from crms_fenicsx.results.cable_and_bar_results import CableResults, cable_results
from crms_fenicsx.results.clamp_results import ClampResults, clamp_results
from crms_fenicsx.results.error_estimate import ErrorEstimate, ErrorEstimator
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.quantities import fields_of
from crms_fenicsx.results.reactions import Reactions, reactions
from crms_fenicsx.results.residual import Residual, Tangent, residual, tangent
from crms_fenicsx.results.sensitivities import Sensitivities, sensitivities
from crms_fenicsx.results.summary import Summary, summary
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.checks import counted
from crms_fenicsx.runtime.errors import ConvergenceError, InputError, collective, raised_together
from crms_fenicsx.runtime.handle import ReadOnly
from crms_fenicsx.runtime.interrupt import postponed, stop_together
from crms_fenicsx.runtime.progress import progress
from crms_fenicsx.scene import Scene
from crms_fenicsx.scene.state import SceneState
from crms_fenicsx.steps.increment_solver import IncrementSolver
from crms_fenicsx.steps.load_cases import Combination, check_combinations, split
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

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from crms_fenicsx.checkpoint import Run
    from crms_fenicsx.checkpoint.journal import Journal
    from crms_fenicsx.steps.rain import PondingCheck

logger = logging.getLogger("crms_fenicsx")

ANOTHER = "make another Solver(scene, ...), which goes on from the scene as it is"
"""What to do instead of assigning a solver's options."""


class Solver:
    """Brings a scene from one equilibrium to the next.

    Parameters
    ----------
    scene
        The scene; its state is advanced.
    results
        Folder for the history and the ParaView files; without it none are written. The first load
        step (or `load`) reserves it until the solver is deleted or its process ends.
    resume
        Whether to continue a run of this script that was killed or stopped. With True or False each
        load step writes a checkpoint into `results`, of which the last one of each call to
        `advance` is kept. With True completed calls take their results from there, and the
        interrupted one continues from its last load step; the script repeats everything else, such
        as laying cables. A script that has changed is refused. With False the first load step
        replaces old checkpoints. None, the default, writes none.
    prefix
        Prefix of this solver's options in PETSc's options database.
    rtol
        Tolerance of the unbalanced force, relative to the largest norm of one kind of nodal forces.
    max_halvings
        How often an increment is halved before the solver gives up.
    slide
        Whether cables may slide sideways into other cells. Otherwise they stay inside the cells
        that they cross, and a `PathWarning` says when they reach a vertex.
    verify
        Whether to check each solved step independently of the gradient and the forms:
        ``step.verification``. A state that fails counts as a step that did not converge.
    estimate
        Whether the history has columns of each step's estimated error, see `estimate_error`.
    stability
        What to do about an equilibrium that bars, joints or ponds make unstable: "warn" by an
        `InstabilityWarning`, "refuse" it as a step that did not converge, or "ignore" it unseen.

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
        results: str | Path | None = None,
        resume: bool | None = None,
        prefix: str = "crms_",
        rtol: float = 1e-9,
        max_halvings: int = 8,
        slide: bool = True,
        verify: bool = True,
        estimate: bool = False,
        stability: Literal["warn", "refuse", "ignore"] = "warn",
    ) -> None:
        checks.of_type("Solver: scene", scene, Scene)
        self._options = options = checked_options(
            scene.comm, results=results, resume=resume, prefix=prefix, rtol=rtol,
            max_halvings=max_halvings, slide=slide, verify=verify, estimate=estimate,
            stability=stability,
        )  # fmt: skip
        self._scene, self.comm = scene, scene.comm
        self._increments = IncrementSolver(scene, options)
        self.steps: list[Step] = []
        self.case = ""
        """Internal: name of the branch that load steps belong to; "" in none."""
        self.base: SceneState | None = None
        """Internal: the state from which loads were first brought on; None before."""
        self._recorder = Recorder(scene, options.results, options.estimate)
        self._journal: Journal | None = None
        if options.resume is not None and options.results is not None:
            from crms_fenicsx.checkpoint.journal import FOLDER, Journal

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
        again. With ``pressure="step"`` and free edges an increment is solved until the pressure is
        normal to the state found, an equilibrium of the follower pressure whatever the number of
        steps.

        Parameters
        ----------
        pressure
            Pressure to reach (force per area), positive to the membrane's outside, or a
            `FanControl`, by which it follows a load in this call.
        move
            Displacements (length) during this call of cables (both ends), cable ends
            (``cable.start``), held joints (``bar.start``) or held groups, or functions that give
            them: `Rotation`, `Way`. A vertex of two groups moves by the sum. Groups need to be held
            only in the directions in which they move. Cable ends on a moved group stay unless they
            are moved as well.
        L0
            Unstressed lengths of cables and bars to reach (length).
        load
            Factors to reach of loads and ponds, by their names; the others stay. A number is the
            factor of the only load.
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
            On all ranks, after Ctrl-C or SIGTERM on one of them, at the next evaluation of the
            energy; a second signal ends the process at once. The scene is at the last good state,
            which with `resume` is in a checkpoint.
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
        first = scene.state
        given = {"pressure": pressure, "load": load, "move": target.movements.samples, "L0": L0}
        done, increment = self._resumed(given | {"steps": steps} | air)
        search = SnapThroughSearch(self._increments, target, first, steps)
        halvings, began = 0, time.perf_counter()
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
                jump = search.find(before, done, goal, balanced) if outcome.bent else None
                step = Step(
                    number, spent, dict(scene.energies), time.perf_counter() - began, halvings,
                    found.verification, found.warnings if jump is None else (jump, *found.warnings),
                )  # fmt: skip
                self._accept(step, before, outcome.unsettled)
                if abs(goal - round(goal)) < 1e-9:
                    bar.advance(1, f"energy {step.energy:.6g}")
                done, increment = goal, min(2 * (goal - done), 1.0)
                self._record(step, done, increment)
                began, spent, halvings = time.perf_counter(), None, 0
        return self.steps[-1]

    def _accept(self, step: Step, before: SceneState, unsettled: float) -> None:
        """Take over a step from a state, and warn of what is crude or in doubt in its state."""
        scene, lasting = self.scene, [one for one in before.warnings if one.lasts]
        scene.record(warnings=(*lasting, *step.warnings))
        if step.verification is not None:
            step = replace(step, verification=replace(step.verification, warnings=scene.warnings))
        self.steps.append(step)
        scene.versions.settle(scene.membrane.owned_u, step.verification)
        if not self.slide:
            warn_of_blocked(step.number, scene)
        warn_of_friction(step.number, scene, before, unsettled)
        warn_of_state(step.number, scene, step.warnings)

    def _resumed(self, given: Mapping[str, Any]) -> tuple[float, float]:
        """Restore the progress of a call: increments done, and the next one. Collective."""
        if self._journal is None:
            return 0.0, 1.0
        come, run = self._journal.begin(self.scene, given)
        if run is not None:
            self._go_on_from(run)
        if come.failure is not None:
            raise ConvergenceError(come.failure)
        return come.done, come.increment

    def _record(self, step: Step, done: float, increment: float) -> None:
        """Write history and files, then the checkpoint."""
        if self._journal is not None:
            self._journal.make_way()
        self._recorder.write(step, self.system, self.case)
        self._keep(done, increment)

    def _keep(self, done: float, increment: float, failure: str | None = None) -> None:
        """Write a checkpoint, if enabled."""
        if self._journal is not None:
            self._journal.keep(self.scene, self._run, done, increment, failure)
            self._increments.restart_h0()  # a resumed run takes the same way

    @property
    def _run(self) -> Run:
        """What this solver knows of its load steps."""
        from crms_fenicsx.checkpoint import Run

        return Run(self.steps, list(self.history), self._increments.tried)

    def _go_on_from(self, run: Run) -> None:
        """Take over the load steps of a run whose state the scene has."""
        self._increments.resume(run.tried)
        self.steps = list(run.steps)
        self._recorder.resume(run.rows)

    @collective
    def snapshot(self) -> SceneState:
        """The current state of the scene and of this solver, to go back to by `restore`.

        Collective. It stays in memory; `save` writes one to a folder.
        """
        return self._increments.snapshot()

    @collective
    def restore(self, snapshot: SceneState) -> None:
        """Bring the scene back to a state. Collective.

        Displacements, loads, supports, cables and added terms are those of then; load steps,
        history and files stay, and go on.

        Parameters
        ----------
        snapshot
            A state of the same scene.

        Raises
        ------
        InputError
            On all ranks: it is no snapshot, or one of another scene.
        """
        with raised_together(self.scene.comm):
            if not isinstance(snapshot, SceneState):
                raise InputError(
                    f"restore: {snapshot!r} is no snapshot; give what solver.snapshot() returned."
                )
            if snapshot.scene is not self.scene:
                raise InputError(
                    "restore: the snapshot is of another scene; give one of this scene."
                )
        self._increments.go_back_to(snapshot)

    @contextmanager
    def branch(self, name: str) -> Iterator[SceneState]:
        """Let load steps be a branch, after which the scene is as before. Collective.

        Parameters
        ----------
        name
            Name of the branch in the history's column "case".

        Yields
        ------
        SceneState
            The state that the branch begins in, and to which it comes back, also after an error.

        Raises
        ------
        InputError
            On all ranks: a name that is no text, or a branch within another one.

        Examples
        --------
        >>> with solver.branch("snow + wind"):
        ...     solver.advance(load={"snow": 1.5, "wind": 0.9})
        ...     tensions = [cable.tension for cable in scene.cables]
        """
        checks.same(self.scene.comm, "branch", name=name)
        checks.text("branch: name", name)
        if self.case:
            raise InputError(
                f"branch: {name!r} is within the branch {self.case!r}; let that one end first."
            )
        base, self.case = self.snapshot(), name
        try:
            yield base
        finally:
            self.case = ""
            self.restore(base)

    def combine(
        self, combinations: Mapping[str, Mapping[str, Any]], *, steps: int = 1
    ) -> dict[str, Combination]:
        """Bring on combinations of loads, each from the current state, which is restored.
        Collective.

        Parameters
        ----------
        combinations
            By its name the factors of each combination's loads, by theirs, and "pressure",
            "temperature" and "atmosphere" where they change, as in `Solver.advance`. What is not
            named stays: a combination that names nothing is the base state.
        steps
            Number of increments of each.

        Returns
        -------
        dict
            The `Combination` of each name, in the order that rank 0 gives.

        Raises
        ------
        InputError
            On all ranks and before anything is computed: a load that does not exist, a factor that
            is not finite, or a number of steps that is none.
        ConvergenceError
            A combination has no equilibrium; it says which.

        Examples
        --------
        >>> found = solver.combine({
        ...     "snow": {"weight": 1.35, "snow": 1.5},
        ...     "storm": {"weight": 1.0, "wind along x": 1.5, "pressure": 0.6},
        ... })
        >>> max(found, key=lambda name: found[name].snapshot.tensions["ridge"])
        """
        checks.same(self.scene.comm, "combine", combinations=combinations, steps=steps)
        check_combinations(self.scene, combinations)
        checks.whole("combine: steps", steps, 1)
        found = dict[str, Combination]()
        for name, given in checks.in_one_order(self.scene.comm, combinations).items():
            air, factors = split(given)
            with self.branch(name) as start:
                base = next((one.base for one in found.values()), start)  # alike, and kept once
                try:
                    step = self.advance(load=factors, steps=steps, **air)
                except ConvergenceError as error:
                    raise ConvergenceError(f"combination {name!r}: {error}") from None
                found[name] = Combination(name, step, self.snapshot(), base)
        return found

    @collective
    def check_ponding(self, rain: float, *, weight: float = 10.0) -> PondingCheck:
        """Fill the hollows of the current shape with rain, again and again as the membrane sinks
        under it. The scene's state is restored. Collective.

        Parameters
        ----------
        rain
            Depth of the rain that falls on the plan of the roof (length). No hollow takes more than
            all of it; a large value fills hollows to where they run over.
        weight
            Weight of water by volume (force / length cubed); 10 kN / m^3.

        Returns
        -------
        PondingCheck
            The same on all ranks but for the snapshot.

        Raises
        ------
        InputError
            On all ranks: a depth or weight that is not positive.

        Examples
        --------
        >>> check = solver.check_ponding(rain=0.1)
        >>> print(check)
        >>> check.passed, check.depth
        """
        checks.same(self.comm, "check_ponding", rain=rain, weight=weight)
        checks.positive("check_ponding: rain", rain)
        checks.positive("check_ponding: weight", weight)
        from crms_fenicsx.steps.rain import NAME, Rain

        water, why = Rain(self.scene, rain, weight), ""
        before = self.snapshot()
        with nullcontext() if self.case else self.branch(NAME):
            try:
                water.put()
                while water.fill():
                    self.advance(load={NAME: 1.0})
            except ConvergenceError as error:
                why = f"there is no equilibrium with it ({error})"
            finally:
                reached = self.snapshot()
                self.restore(before)
        return water.check(reached, why)

    @collective
    def results(self) -> MembraneResults:
        """Stresses, strains and state of the membrane's cells in the current state. Collective.

        Returns
        -------
        MembraneResults
            Values in this rank's cells.
        """
        return membrane_results(self.system)

    @collective
    def reactions(self, where: str | Marker) -> Reactions:
        """Forces that supports at a place exert on all that meets there, in the current state.

        Collective. What meets there is the membrane, and each end of a cable or a bar whose anchor
        or held joint is at one of the vertices, or on an edge between two of them.

        Parameters
        ----------
        where
            Vertices, as for `Scene.vertices`, or the name of a held joint, such as "start of mast".

        Returns
        -------
        Reactions
            Their sum, each part of it by name, and the force on each of this rank's vertices.

        Raises
        ------
        InputError
            As `Scene.vertices`.

        Examples
        --------
        >>> corner = solver.reactions("corner 1")
        >>> corner.total, corner.membrane, corner.parts["guy 1"]
        """
        return reactions(self.system, where)

    @collective
    def contact_forces(self, cable: LaidCable) -> ContactForces:
        """Forces of a cable on the membrane at its points, in the current state. Collective.

        Parameters
        ----------
        cable
            A cable of the scene.

        Returns
        -------
        ContactForces
            At the points of the cable's `line`; its ``line`` is the force per length of cable.

        Raises
        ------
        InputError
            It is no cable of this scene.
        """
        checks.same(self.comm, "contact_forces", cable=cable)
        if not any(cable is own for own in self.scene.cables):
            raise InputError(f"contact_forces: {cable!r} is not a cable of this scene.")
        return contact_forces(cable, self.scene.net.strip_shape()).at(cable.line_nodes())

    @collective
    def cable_forces(self) -> dict[str, CableResults]:
        """Tensions, contact and end forces of the cables, in the current state. Collective.

        Returns
        -------
        dict
            By the cables' names, the same on all ranks.

        Examples
        --------
        >>> for name, cable in solver.cable_forces().items():
        ...     print(f"{name}: {cable.least:.3g} to {cable.largest:.3g}")
        """
        return cable_results(self.scene)

    @collective
    def clamp_forces(self) -> dict[str, ClampResults]:
        """Forces of the clamps between cables, in the current state. Collective.

        Returns
        -------
        dict
            By the clamps' names, the same on all ranks.

        Examples
        --------
        >>> max(clamp.size for clamp in solver.clamp_forces().values())
        """
        return clamp_results(self.scene)

    @collective
    def summary(self) -> Summary:
        """The current state by its extremes: plain numbers for tables and envelopes. Collective.

        Returns
        -------
        Summary
            The same on all ranks.
        """
        return summary(self.system)

    @collective
    def estimate_error(self) -> ErrorEstimate:
        """Estimate by how much the mesh makes the energy of the current state too high. Collective.

        It costs about as much as `results`. On the cases with references it is 0.4 to 2.6 times
        the true error (`tests/results/test_error_estimate.py`). What the sides of a polygon cut off
        a curved boundary is not in it.

        Returns
        -------
        ErrorEstimate
            For the whole membrane, and the shares of this rank's cells.

        Raises
        ------
        InputError
            On all ranks: the scene has been changed since its last load step, or there was none.

        Examples
        --------
        >>> solver.estimate_error().relative
        """
        self.scene.require_equilibrium("estimate_error")
        return ErrorEstimator(self.scene).of(self.system)

    @collective
    def residual(self) -> Residual:
        """Forces that are not balanced in the current state, to be destroyed. Collective.

        They are the slope of the potential energy: in equilibrium zero but at supports, where they
        are the supports' forces, and where a floor presses.

        Returns
        -------
        Residual
            As a function on `Scene.V`, of the joints, and as a vector of all unknowns.

        Examples
        --------
        >>> residual = solver.residual()
        >>> residual.vector.norm()  # without what is held
        >>> residual.destroy()
        """
        return residual(self.system)

    @collective
    def tangent(self) -> Tangent:
        """Second derivatives of the potential energy, to be destroyed. Collective.

        They are exact but for the terms that ``inexact`` names.

        Returns
        -------
        Tangent
            A matrix of PETSc for vectors as that of `residual`.

        Examples
        --------
        A step of Newton's method, of a membrane without cables:

        >>> residual, tangent = solver.residual(), solver.tangent()
        >>> ksp = PETSc.KSP().create(scene.comm)
        >>> ksp.setOperators(tangent.matrix, tangent.sparse)
        >>> step = residual.vector.duplicate()
        >>> ksp.solve(residual.vector, step)
        >>> owned = 3 * scene.V.dofmap.index_map.size_local
        >>> scene.u.x.array[:owned] -= step.array[:owned]
        >>> scene.u.x.scatter_forward()
        """
        return tangent(self.system)

    @collective
    def sensitivities(self, of: Sequence[object], by: Sequence[object]) -> Sensitivities:
        """Derivatives of results by lengths, loads and stiffnesses in the current equilibrium.

        Collective. They come from the exact tangent, on the paths and contacts that there are.

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
            On all ranks: what is none of these, a scene that is not in equilibrium, friction or
            step-wise laws, or a state with a singular tangent.

        Examples
        --------
        >>> found = solver.sensitivities([ridge, "energy"], [ridge, "pressure", "snow"])
        >>> found[ridge, "pressure"]
        """
        checks.same(self.comm, "sensitivities", of=of, by=by)
        self.scene.require_equilibrium("sensitivities")
        return sensitivities(self.system, of, by)

    def draw(self, filename: str | Path | None = None, **options: Any) -> Figure | None:
        """Draw the scene in its current state, as `crms_fenicsx.output.draw`. Collective.

        Parameters
        ----------
        filename
            Picture to write; its suffix (.png, .pdf, .svg ...) says the format. None returns it.
        **options
            As for `draw`: ``colour``, ``unit``, ``force``, ``ghost``, ``view`` ...

        Returns
        -------
        matplotlib.figure.Figure
            On the first rank, without a file; a notebook shows it. Else None.

        Raises
        ------
        InputError
            On all ranks: an unknown colour or option, or a file that cannot be written.

        Examples
        --------
        In a notebook:

        >>> solver.draw(colour="warp", unit="m", force="kN")
        """
        from crms_fenicsx.output.figures.draw_scene import draw

        return draw(self, filename, **options)

    @collective
    def report(
        self, filename: str | Path,
        combinations: Mapping[str, Combination] | None = None, **options: Any,
    ) -> None:  # fmt: skip
        """Write a report for the checking engineer: one page of HTML, and CSV tables. Collective.

        The page has a verdict with its reasons, the model, loads and combinations, pictures,
        membrane forces, utilisation and envelopes, cables, bars, ponds, forces on foundations and
        the checks of all equilibria. It loads nothing from elsewhere, is smaller
        than 5 MB, and prints on A4. The tables lie beside ``tent.html``, as ``tent_membrane.csv``,
        with all digits. Results are those of the combinations' states, with the model and base
        state that these were brought on with; strengths are the present ones. The scene's own state
        is restored. Without combinations the page says in red if the scene has changed since its
        last load step. Ten or more bars whose names differ in a number at their end share rows on
        the page.

        Parameters
        ----------
        filename
            Of the page, ending in .html. Older files are replaced when all new ones are complete.
        combinations
            What `combine` returned; by default the current state alone.
        **options
            ``title``: heading. ``about``: names and texts below it, as ``{"Project": "..."}``.
            ``unit``, ``force``: names of the units of length and force. ``cable_strengths``:
            strengths of cables by their names, divided by the partial factors (force), for their
            utilisation; those of the fabric are `Scene.set_strengths`'s. ``pictures``: colours of
            the membrane in pictures of each combination, as for `draw`, or "tension" of cables and
            bars; by default tension, displacement, membrane forces and utilisation. The last ones
            are left out of too large a page. ``view``: where the viewer stands, as for `draw`.
            ``sections``: further ones, as of `crms_fenicsx.patterns.report_sections`. ``order``:
            lengths of the cables to be made, from `nets.lengths_to_order`. ``foundations``: what
            each carries, ends of cables and joints, as ``{"F1": ["A1 start", "mast foot"]}``; what
            meets at one place belongs together. ``strain_limit``: of the membrane's larger
            principal strain, by default 0.1. ``template``: a file of jinja2, which may extend
            "report.html". ``pdf``: whether to print the page beside it, by a browser that is found
            or that the variable CRMS_BROWSER names. ``interactive``: whether to write a page of
            each combination that can be turned, as ``tent_view_1.html``, by pyvista and its trame.

        Raises
        ------
        InputError
            On all ranks and before anything is written: an argument that cannot be used, a file
            that cannot be written, no browser for PDF, or combinations of models that differ; it
            says in what.
        ImportError
            On all ranks: there is no pyvista or trame for `interactive`.

        Examples
        --------
        >>> found = solver.combine({"snow": {"snow": 1.5}, "storm": {"wind": 1.5}})
        >>> solver.report("results/tent/report.html", found, title="Tent", unit="m", force="kN")
        """
        from crms_fenicsx.output.report.reporting import write_report

        write_report(self, filename, combinations, **options)

    @collective
    def to_pyvista(self, *, radius: float | None = None) -> Any:
        """The current state as meshes of pyvista, with the arrays of the ParaView files.
        Collective.

        Parameters
        ----------
        radius
            Of the tubes of cables and bars (length), by default 0.3 % of the membrane's size; 0:
            lines.

        Returns
        -------
        pyvista.MultiBlock
            On the first rank, else None. The blocks are "membrane" (the deformed surface with the
            facets of folded cells, "displacement" at points, section forces and state of cells),
            "cables" and "bars" ("tension" of segments, "lifted", "contact force", number of the
            "line"), "supports" (held vertices, with the "held" directions) and "joints", without
            empty ones. Names of cables, bars and joints are in ``field_data["names"]``.

        Raises
        ------
        InputError
            On all ranks: a radius that is negative or not finite.
        ImportError
            On all ranks: there is no pyvista.

        Examples
        --------
        >>> blocks = solver.to_pyvista()
        >>> plotter = pyvista.Plotter()
        >>> plotter.add_mesh(blocks["membrane"], scalars="warp", show_edges=True)
        >>> plotter.add_mesh(blocks["cables"], scalars="tension", cmap="YlOrRd")
        >>> plotter.show()
        """
        from crms_fenicsx.views.view_data import to_pyvista

        return to_pyvista(self.scene, fields_of(membrane_results(self.system)), radius)

    @collective
    def save(self, folder: str | Path) -> None:
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
        from crms_fenicsx import checkpoint

        checkpoint.save(folder, self.scene, self._run)
        self._increments.restart_h0()  # what goes on from the checkpoint takes the same way

    @collective
    def load(self, folder: str | Path) -> None:
        """Go on from a state that `save` has saved, on any number of processes. Collective.

        The script builds mesh, scene and solver as before. Held vertices, floor, loads, cables and
        bars of the checkpoint replace those given so far; cables and bars of the same name stay the
        objects. What follows is as if the run had not ended; results go on too, if the solver's
        folder has them.

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
        from crms_fenicsx import checkpoint

        self._go_on_from(checkpoint.load(folder, self.scene))
