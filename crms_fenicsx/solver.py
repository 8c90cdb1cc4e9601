"""Load stepping: increments of pressure, end movements and cable lengths, each solved in turn."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energies.paper.step_history import StepHistory
from crms_fenicsx.equilibrium.search import EquilibriumSearch
from crms_fenicsx.equilibrium.state import State
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.model.membrane import Marker
from crms_fenicsx.output.recorder import Recorder
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import (
    ConvergenceError,
    FrictionWarning,
    InputError,
    PathWarning,
    collective,
)
from crms_fenicsx.runtime.interrupt import postponed, stop_together
from crms_fenicsx.runtime.readonly import ReadOnly
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.steps.loading import Target, checked_target, has_free_rim
from crms_fenicsx.verification.verifier import Verifier

if TYPE_CHECKING:
    from crms_fenicsx.checkpoint import Run
    from crms_fenicsx.checkpoint.journal import Journal
    from crms_fenicsx.contact.contact_force import ContactForces
    from crms_fenicsx.model.laid_cable import LaidCable
    from crms_fenicsx.output import History, Line
    from crms_fenicsx.paths.tried_paths import TriedPaths
    from crms_fenicsx.results.membrane_results import MembraneResults
    from crms_fenicsx.results.reactions import Reactions

logger = logging.getLogger("crms_fenicsx")

ANOTHER = "make another Solver(scene, ...), which goes on from the scene as it is"
"""What to do instead of assigning a solver's options."""
MOST_TURNS = 50
"""Solves of an increment with the paper's pressure on a membrane with free edges."""


class Solver:
    """Brings a scene from one equilibrium to the next.

    Parameters
    ----------
    scene
        The scene; its state is advanced.
    results
        Folder for the history table and the ParaView files; none are written without. That it can
        be written is checked now. The first load step (or `load`) takes it for this solver alone,
        until the solver is gone or its process ends.
    resume
        Whether to go on from where this script has come to before, when it was killed or stopped.
        A solver that is told so, or not so, writes a checkpoint of each load step into the folder
        `results`, and keeps one of each call to `advance`. With True a call that was complete
        takes its result from there instead of computing it, and the one that was interrupted goes
        on from its last load step; all else that the script does, such as laying cables and
        drawing, it does again. A script that does something else than before is refused. With
        False the first load step replaces the checkpoints that are there. With None, the default,
        none are written.
    prefix
        Prefix of this solver's options in PETSc's options database.
    rtol
        Tolerance of the unbalanced force, relative to the largest norm of one kind of nodal
        forces.
    max_halvings
        How often an increment is halved before the solver gives up.
    slide
        Whether cables may slide sideways into other cells than those that they cross. Without it
        they slide inside their cells only, and a `PathWarning` tells when they run into a vertex.
    verify
        Whether to check each solved step on ways of its own, without the gradient and the forms:
        ``step.verification``. A state that fails is treated as one that did not converge.

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
    prefix: ReadOnly[str] = ReadOnly("_prefix", ANOTHER)
    rtol: ReadOnly[float] = ReadOnly("_rtol", ANOTHER)
    max_halvings: ReadOnly[int] = ReadOnly("_max_halvings", ANOTHER)
    slide: ReadOnly[bool] = ReadOnly("_slide", ANOTHER)

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
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(f"Solver: scene is of type {type(scene).__name__}; give a Scene.")
        checks.same(
            scene.comm,
            "Solver",
            results=results,
            resume=resume,
            prefix=prefix,
            rtol=rtol,
            max_halvings=max_halvings,
            slide=slide,
            verify=verify,
        )
        if not 0 < checks.finite("Solver: rtol", rtol) < 1:
            raise InputError(f"Solver: rtol = {rtol} must lie between 0 and 1, as 1e-9 does.")
        if not isinstance(prefix, str) or prefix.startswith("-"):
            raise InputError(
                f"Solver: prefix = {prefix!r} is no options prefix; give a text without the "
                'leading hyphen, as in "crms_".'
            )
        if results is not None:
            results = checks.file("Solver: results", results)
        if resume is not None and not isinstance(resume, bool):
            raise InputError(f"Solver: resume = {resume!r}; give True, False or None.")
        if resume is not None and results is None:
            raise InputError(
                f"Solver: resume = {resume}, but no results: give a folder, where checkpoints go, "
                'as in results="results/dome".'
            )
        self._scene, self.comm = scene, scene.comm
        self._prefix, self._rtol = prefix, float(rtol)
        self._max_halvings = checks.whole("Solver: max_halvings", max_halvings, 0)
        self._slide = bool(slide)
        self._verifier = Verifier(scene) if verify else None
        self.steps: list[Step] = []
        self._system: System | None = None
        self._search: EquilibriumSearch | None = None
        self._earlier: Run | None = None
        """The run that this one goes on from."""
        self._known: tuple[LaidCable, ...] = ()
        """The cables of the load steps before."""
        self._recorder = Recorder(scene, results)
        self._journal: Journal | None = None
        self._resumes = bool(resume)
        if resume is not None and results is not None:
            from crms_fenicsx.checkpoint.journal import FOLDER, Journal

            options = {"rtol": self.rtol, "max_halvings": self.max_halvings, "slide": self.slide}
            self._journal = Journal(results / FOLDER, scene.comm, options, resume)

    @property
    def system(self) -> System:
        """The potential of the scene and its minimiser; made when first needed."""
        if self._system is not None and self._system.is_outdated:
            self._drop_system()  # another solver has advanced the scene
        if self._system is None:
            self._system = System(self.scene, self.prefix, self.rtol)
        return self._system

    def _drop_system(self) -> None:
        if self._system is not None:
            self._system.destroy()
        self._system = self._search = self._earlier = None

    @property
    def search(self) -> EquilibriumSearch:
        """What finds the equilibrium of each load step; made when first needed."""
        system = self.system
        if self._search is None:
            tried = None if self._earlier is None or not self.slide else self._earlier.tried
            self._search = EquilibriumSearch(system, self.slide, tried)
        return self._search

    @property
    def history(self) -> History:
        """A row of numbers for each accepted step; `Recorder` says which."""
        return self._recorder.history

    @collective
    def results(self) -> MembraneResults:
        """Stresses, strains and state of the membrane's cells in the current state. Collective.

        Returns
        -------
        MembraneResults
            Values in this rank's cells.
        """
        from crms_fenicsx.results.membrane_results import membrane_results

        return membrane_results(self.system)

    @collective
    def reactions(self, where: str | Marker) -> Reactions:
        """Forces that supports exert on the membrane, in the current state. Collective.

        Those on a cable's ends are not among them: ``cable.start.reaction``.

        Parameters
        ----------
        where
            Held vertices, as for `Scene.vertices`.

        Returns
        -------
        Reactions
            Their sum, and the force on each of this rank's vertices.

        Raises
        ------
        InputError
            As `Scene.vertices`.
        """
        from crms_fenicsx.results.reactions import reactions

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
            At the points of the cable's `line`: among others ``line``, the normal force per length
            of cable.

        Raises
        ------
        InputError
            It is no cable of this scene.
        """
        from crms_fenicsx.contact.contact_force import contact_forces

        checks.same(self.comm, "contact_forces", cable=cable)
        if not any(cable is own for own in self.scene.cables):
            raise InputError(f"contact_forces: {cable!r} is not a cable of this scene.")
        return contact_forces(cable, self.scene.net.strip_shape()).at(cable.line_nodes())

    @collective
    def draw(self, filename: str | FilePath, *, colour: str | None = None, **options: Any) -> None:
        """Draw the scene as it is, and say or colour the cables' tensions. Collective.

        Cables are striped where they are off the membrane.

        Parameters
        ----------
        filename
            Picture to write; its suffix (.png, .pdf, .svg ...) says the format.
        colour
            None, "height", "displacement", "stress", "stress 2", "strain" or "state".
        **options
            ``unit`` and ``force``, the names of the units of length and force; ``ghost=True`` to
            show the stress-free shape; and as for `crms_fenicsx.output.draw_shape`: ``view``,
            ``box``, ``title``, ``limits`` ...

        Raises
        ------
        InputError
            An unknown colour or option, or a file that cannot be written.

        Warns
        -----
        PictureWarning
            The mesh is too large for a picture (500 000 cells); nothing is drawn.
        """
        from crms_fenicsx.output.figures.scene import draw_scene

        checks.same(self.comm, "draw", filename=filename, colour=colour, **options)
        filename = checks.file("draw: filename", filename)
        draw_scene(self.system, filename, colour=colour, **options)

    @collective
    def draw_paths(
        self,
        filename: str | FilePath,
        lines: Sequence[Line] = (),
        paths: Sequence[Line] = (),
        **options: Any,
    ) -> None:
        """Draw paths of cables and ways of points over the stress-free mesh, in plan. Collective.

        Parameters
        ----------
        filename
            Picture to write; its suffix says the format.
        lines
            Paths of cables, such as ``Line(cable.line, name="now")``.
        paths
            Ways of points, step by step.
        **options
            ``unit``, the name of the unit of length; and as for `crms_fenicsx.output.draw_path`:
            ``closeups``, ``title`` ...

        Raises
        ------
        InputError
            Nothing to draw, an unknown option, or a file that cannot be written.

        Warns
        -----
        PictureWarning
            The mesh is too large for a picture (500 000 cells), and left out.
        """
        from crms_fenicsx.output.figures.scene import draw_scene_paths

        checks.same(self.comm, "draw_paths", filename=filename, **options)
        filename = checks.file("draw_paths: filename", filename)
        draw_scene_paths(self.scene, filename, lines, paths, **options)

    @collective
    def draw_history(
        self,
        filename: str | FilePath,
        panels: Sequence[Sequence[str]] | None = None,
        **options: Any,
    ) -> None:
        """Plot the history over the load steps. Collective.

        Parameters
        ----------
        filename
            Picture to write; its suffix says the format.
        panels
            Columns of `history` that share a panel; a choice by default.
        **options
            ``unit`` and ``force``, the names of the units of length and force; and as for
            `crms_fenicsx.output.draw_history`: ``units``, ``title`` ...

        Raises
        ------
        InputError
            No step yet, an unknown column, or a file that cannot be written.
        """
        from crms_fenicsx.output.figures.scene import draw_scene_history

        checks.same(self.comm, "draw_history", filename=filename, panels=panels, **options)
        filename = checks.file("draw_history: filename", filename)
        draw_scene_history(self.history, filename, panels, **options)

    @collective
    def advance(
        self,
        *,
        pressure: float | None = None,
        move: Mapping[object, tuple[float, float, float]] | None = None,
        L0: Mapping[object, float] | None = None,
        load: float | None = None,
        steps: int = 1,
    ) -> Step:
        """Go to new loads in equal increments, and write each state.

        An increment without equilibrium is halved from the last good state, and grows again. With
        the paper's pressure, ``pressure="step"``, an increment of a membrane with free edges is
        solved until the pressure is normal to the state found: an equilibrium of the follower
        pressure, whatever the number of steps.

        Parameters
        ----------
        pressure
            Pressure to reach (force per area), positive to the membrane's outside.
        move
            Displacements (length) of cables (both ends), cable ends (``cable.start``) or held
            groups of vertices, by which they move during this call. What is named twice, as a
            corner of two groups, moves by the sum. Groups need to be held only in the directions
            in which they move. Cable ends on a moved group stay where they are unless they are
            moved as well.
        L0
            Unstressed lengths of cables to reach (length).
        load
            Factor to reach of the dead load that `Scene.put_load` has put on the membrane.
        steps
            Number of increments.

        Returns
        -------
        Step
            The last step.

        Raises
        ------
        InputError
            A load that cannot be applied, or results in a folder to which another solver writes;
            nothing is computed then.
        ConvergenceError
            No equilibrium was found; the scene is at the last good state.
        KeyboardInterrupt, SystemExit
            On all ranks, after Ctrl-C or SIGTERM on one of them, which wait for the next evaluation
            of the energy; a second signal ends the process at once. The scene is at the last good
            state, which with `resume` is in a checkpoint.
        """
        from crms_fenicsx.runtime.progress import progress

        scene = self.scene
        checks.same(
            self.comm, "advance", pressure=pressure, move=move, L0=L0, load=load, steps=steps
        )
        checks.whole("advance: steps", steps, 1)
        move, L0 = {} if move is None else move, {} if L0 is None else L0
        target = checked_target(scene, pressure, move, L0, load)
        self._recorder.claim(self._resumes)
        self._forget_removed()
        first = State.of(scene)
        done, increment = self._resumed(pressure, move, L0, load, steps)
        halvings, began = 0, time.perf_counter()
        spent: Outcome | None = None
        with postponed(scene.comm), progress(scene.comm, steps, "load steps") as bar:
            if done >= 1:
                bar.advance(int(done + 1e-9), "done before")
            while done < steps - 1e-9:
                stop_together(scene.comm)
                goal = min(done + increment, np.floor(done + 1e-9) + 1.0)
                good, history = State.of(scene), scene.step_history
                target.apply(scene, first, done / steps, goal / steps)
                try:
                    prestress = self._h0_prestress(target, (goal - done) / steps)
                    if self._verifier is not None:
                        self._verifier.begin()
                    outcome = self.search.find(prestress)
                    if outcome.converged and has_free_rim(scene):
                        outcome = self._turn_pressure(outcome)
                    verification = None
                    if self._verifier is not None and outcome.converged:
                        verification = self._verifier.check(self.system, outcome)
                        if not verification.passed:
                            outcome = replace(outcome, converged=False, reason=str(verification))
                    if outcome.converged:
                        self.system.commit()
                except BaseException:  # also an interrupt leaves a state that is one
                    self._go_back(good, history)
                    raise
                spent = outcome if spent is None else spent + outcome
                if not outcome.converged:
                    self._go_back(good, history)
                    halvings += 1
                    increment = (goal - done) / 2
                    if increment < 0.5**self.max_halvings * (1 - 1e-9):
                        failure = self._failure(outcome, done / steps)
                        self._keep(done, increment, str(failure))
                        raise failure
                    logger.info("halving the increment: %s", outcome.reason)
                    continue
                seconds = time.perf_counter() - began
                step = Step(
                    len(self.steps) + 1, spent, dict(scene.energies), seconds, halvings,
                    verification,
                )  # fmt: skip
                self.steps.append(step)
                self._warn_of_blocked()
                self._warn_of_friction(good, outcome.unsettled)
                if abs(goal - round(goal)) < 1e-9:
                    bar.advance(1, f"energy {step.energy:.6g}")
                done, increment = goal, min(2 * (goal - done), 1.0)
                self._record(step, done, increment)
                began, spent, halvings = time.perf_counter(), None, 0
        return self.steps[-1]

    def _resumed(
        self,
        pressure: float | None,
        move: Mapping[object, tuple[float, float, float]],
        L0: Mapping[object, float],
        load: float | None,
        steps: int,
    ) -> tuple[float, float]:
        """Bring scene and solver to where a call to `advance` has come to before. Collective.

        Returns
        -------
        Number of increments that are done, and the next one; 0 and 1 for a new call.
        """
        if self._journal is None:
            return 0.0, 1.0
        from crms_fenicsx.checkpoint.call_record import plain_loads

        loads = plain_loads(pressure, move, L0, load, steps)
        come, run = self._journal.begin(self.scene, loads, steps)
        if run is not None:
            self._go_on_from(run)
        if come.failure is not None:
            raise ConvergenceError(come.failure)
        return come.done, come.increment

    def _record(self, step: Step, done: float, increment: float) -> None:
        """Write what is written of a load step; the checkpoint last, as it counts on the others."""
        if self._journal is not None:
            self._journal.make_way()
        self._recorder.write(step, self.system)
        self._keep(done, increment)

    def _keep(self, done: float, increment: float, failure: str | None = None) -> None:
        """Write a checkpoint of the state that a call to `advance` has come to, if there are."""
        if self._journal is not None:
            from crms_fenicsx.checkpoint.journal import Progress

            self._journal.keep(self.scene, self._run, Progress(done, increment, failure))
            self.system.reset_h0()  # a resumed run takes the same way

    @property
    def _run(self) -> Run:
        """What this solver knows of its load steps."""
        from crms_fenicsx.checkpoint import Run

        return Run(self.steps, list(self.history), self.scene.step_history, self._tried)

    @property
    def _tried(self) -> TriedPaths | None:
        """Paths that cables have not taken, if any were tried."""
        if self._search is not None and self._search.tried is not None:
            return self._search.tried
        return None if self._earlier is None else self._earlier.tried

    def _forget_removed(self) -> None:
        """Let cables not inherit paths that were tried for one of their name that is gone."""
        tried = self._tried
        for cable in self._known:
            if tried is not None and cable not in self.scene.cables:
                tried.forget(cable.name)
        self._known = self.scene.cables

    def _go_on_from(self, run: Run) -> None:
        """Take over the load steps of a run whose state the scene has."""
        self._drop_system()
        self._earlier, self._known = run, self.scene.cables
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
        from crms_fenicsx.checkpoint import save

        save(folder, self.scene, self._run)
        if self._system is not None:
            self._system.reset_h0()  # what goes on from the checkpoint takes the same way

    @collective
    def load(self, folder: str | FilePath) -> None:
        """Go on from a state that `save` has saved, on any number of processes. Collective.

        The script builds mesh, scene and solver as they were. Held vertices, floor, loads and
        cables come from the checkpoint, and replace those that the script has given so far; what
        follows is as if the run had not ended. Results go on, too, where the solver's folder has
        those of the steps before.

        Parameters
        ----------
        folder
            Where the checkpoint is.

        Raises
        ------
        InputError
            On all ranks: a solver that has made steps or whose scene has cables, a checkpoint of
            another mesh, material or law (it says which), one that is missing or damaged, or
            results in a folder to which another solver writes. The scene is then as before.

        Examples
        --------
        >>> scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
        >>> solver = Solver(scene, results="results/dome")
        >>> solver.load("results/dome/checkpoint")
        >>> solver.advance(L0={scene.cable("ridge"): 99.0})
        """
        from crms_fenicsx.checkpoint import load

        if self.steps or self.scene.cables:
            raise InputError(
                f"load: there are {len(self.steps)} load steps and {len(self.scene.cables)} cables "
                "already; load into a new scene and solver, before laying cables."
            )
        self._recorder.claim(going_on=True)
        self._go_on_from(load(folder, self.scene))

    def _turn_pressure(self, outcome: Outcome) -> Outcome:
        """Repeat a step with the paper's pressure until its forces are normal to the end state.

        Each solve is a step of its own for what counts by steps.
        """
        for _ in range(MOST_TURNS):
            self.system.commit()
            more = self.search.find((0.0,))
            outcome = outcome + more
            if more.iterations == 0 or not more.converged:
                return outcome
        reason = f"the pressure at free edges still turns after {MOST_TURNS} solves"
        return replace(outcome, converged=False, reason=reason)

    def _go_back(self, good: State, history: StepHistory | None) -> None:
        """Bring the scene back to a good state after an increment without equilibrium.

        `history` is what step-wise laws knew then.
        """
        good.restore(self.scene)
        if self.scene.step_history is not history:  # the pressure has turned
            self.scene.step_history = history
            self.scene.commits += 1
        if self._system is not None:  # its tables may be those of other cables in tension
            self._system.invalidate()

    def _failure(self, outcome: Outcome, done: float) -> ConvergenceError:
        return ConvergenceError(
            f"step {len(self.steps) + 1}: no equilibrium found, {outcome.reason}: unbalanced force "
            f"{outcome.residual:.3g}, tolerance {outcome.tolerance:.3g}, with the increment halved "
            f"{self.max_halvings} times; {done:.2%} of the loads are on and the scene is at that "
            "state. Try more steps, check that the cables can carry tension where they lie, and "
            "look at the state reached."
        )

    def _h0_prestress(self, target: Target, share: float) -> tuple[float, ...]:
        """Extra prestress in H0 for the first stages of a solve.

        A flat sheet has no stiffness against pressure. The stress that it will have is estimated
        from the load, 0.3 (p^2 L^2 E t)^(1/3), and from the movement; a stressed sheet gets none.
        """
        scene, size = self.scene, self.scene.membrane.size
        modulus = max(m.reference_modulus for m in scene.materials.values())
        moves = [float(np.linalg.norm(d)) for *_, d in target.cable_ends]
        moves.append(float(np.max(np.linalg.norm(target.moved, axis=1), initial=0.0)))
        travel = share * scene.comm.allreduce(max(moves), op=MPI.MAX)
        loads = abs(scene.pressure)
        if scene.dead_forces is not None:
            loads += abs(scene.load) * scene.dead_forces.intensity
        loads += self.system.added_force_per_area()
        coming = 0.3 * (loads * size) ** (2 / 3) * modulus ** (1 / 3)
        coming = max(coming, 0.3 * modulus * (travel / size) ** 2)
        present = np.sqrt(max(2 * scene.energies.get("membrane", 0.0) * modulus, 0.0)) / size
        if present > 0.3 * coming:
            return (0.0,)
        return (coming, 0.1 * coming, 0.01 * coming, 0.0)

    def _warn_of_friction(self, before: State, unsettled: float) -> None:
        """Friction forces that have not settled; the paper's friction element pushes a cable back
        that should stick."""
        if unsettled > 0.0 and self.scene.comm.rank == 0:
            warnings.warn(
                f"step {len(self.steps)}: friction forces went round in circles and are right to "
                f"{unsettled:.1%} of their sum only; make the mesh finer along the cables.",
                FrictionWarning,
                stacklevel=4,
            )
        for cable, was in zip(self.scene.cables, before.cables, strict=True):
            gained = 0.0 if was.grip is None else was.grip.dissipated
            if cable.grip is None or cable.has_coulomb or cable.grip.dissipated >= gained:
                continue
            if self.scene.comm.rank == 0:
                warnings.warn(
                    f"step {len(self.steps)}: the friction elements of {cable.name!r} have pushed "
                    f"it back and given {gained - cable.grip.dissipated:.3g} of work, as their "
                    'force does not know of sticking; use Friction(law="coulomb") or more steps.',
                    FrictionWarning,
                    stacklevel=4,
                )

    def _warn_of_blocked(self) -> None:
        if self.slide:
            return
        for cable in self.scene.cables:
            if cable.blocked and self.scene.comm.rank == 0:
                place = cable.positions[cable.blocked[0]]
                warnings.warn(
                    f"step {len(self.steps)}: {cable.name!r} has run into {len(cable.blocked)} "
                    f"mesh vertices, the first at {place}; it cannot slide on into other cells, so "
                    "that the result is that of a cable blocked there.",
                    PathWarning,
                    stacklevel=4,
                )
