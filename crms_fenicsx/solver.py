"""Load stepping: increments of pressure, end movements and cable lengths, each solved in turn."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx import checks
from crms_fenicsx.errors import ConvergenceError, InputError, PathWarning, raised_together
from crms_fenicsx.minimizer import Outcome
from crms_fenicsx.output.recorder import Recorder
from crms_fenicsx.scene import Marker, Scene
from crms_fenicsx.state import State
from crms_fenicsx.system import System

if TYPE_CHECKING:
    from crms_fenicsx.output import History
    from crms_fenicsx.results import MembraneResults, Reactions

Array = npt.NDArray[np.float64]
logger = logging.getLogger("crms_fenicsx")

TYPE_OF_MOVE = "a laid cable, one of its ends, or the name of a group of held vertices"


@dataclass(frozen=True)
class Step:
    """An accepted load step.

    Attributes
    ----------
    number
        Counted from 1 over the solver's life.
    outcome
        What the solve took; failed attempts of the step are included.
    energies
        Energy of each kind of term (force x length).
    seconds
        Wall time.
    halvings
        How often the increment had to be halved.
    """

    number: int
    outcome: Outcome
    energies: dict[str, float]
    seconds: float
    halvings: int

    @property
    def energy(self) -> float:
        """Total potential energy (force x length)."""
        return sum(self.energies.values())


@dataclass(frozen=True)
class Target:
    """Loads to reach, and those to start from."""

    pressure: tuple[float, float]
    cable_ends: list[tuple[int, int, Array]]
    moved: Array
    lengths: list[tuple[int, float, float]]


class Solver:
    """Brings a scene from one equilibrium to the next.

    Parameters
    ----------
    scene
        The scene; its state is advanced.
    results
        Folder for the history table and the ParaView files; none are written without. That it can
        be written is checked now.
    prefix
        Prefix of this solver's options in PETSc's options database.
    rtol
        Tolerance of the unbalanced force, relative to the largest norm of one kind of nodal
        forces.
    max_halvings
        How often an increment is halved before the solver gives up.

    Attributes
    ----------
    steps : list of Step
        The accepted steps.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        results: str | FilePath | None = None,
        prefix: str = "crms_",
        rtol: float = 1e-9,
        max_halvings: int = 8,
    ) -> None:
        if not isinstance(scene, Scene):
            raise InputError(f"Solver: scene is of type {type(scene).__name__}; give a Scene.")
        if not 0 < checks.finite("Solver: rtol", rtol) < 1:
            raise InputError(f"Solver: rtol = {rtol} must lie between 0 and 1, as 1e-9 does.")
        if not isinstance(prefix, str) or prefix.startswith("-"):
            raise InputError(
                f"Solver: prefix = {prefix!r} is no options prefix; give a text without the "
                'leading hyphen, as in "crms_".'
            )
        self.scene, self.prefix, self.rtol = scene, prefix, float(rtol)
        self.max_halvings = checks.whole("Solver: max_halvings", max_halvings, 0)
        self.steps: list[Step] = []
        self._system: System | None = None
        self._recorder = Recorder(scene, results)

    @property
    def system(self) -> System:
        """The potential of the scene and its minimiser; made when first needed."""
        if self._system is None:
            self._system = System(self.scene, self.prefix, self.rtol)
        return self._system

    @property
    def history(self) -> History:
        """A row of numbers for each accepted step; `Recorder` says which."""
        return self._recorder.history

    def results(self) -> MembraneResults:
        """Stresses, strains and state of the membrane's cells in the current state. Collective.

        Returns
        -------
        MembraneResults
            Values in this rank's cells.
        """
        from crms_fenicsx.results import membrane_results

        return membrane_results(self.system)

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
        from crms_fenicsx.results import reactions

        return reactions(self.system, where)

    def draw(self, filename: str | FilePath, *, colour: str | None = None, **options: Any) -> None:
        """Draw the scene as it is, and say or colour the cables' tensions. Collective.

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
        """
        from crms_fenicsx.output.scene_pictures import draw_scene

        draw_scene(self.system, filename, colour=colour, **options)

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
        from crms_fenicsx.output.scene_pictures import draw_scene_history

        draw_scene_history(self.history, filename, panels, **options)

    def advance(
        self,
        *,
        pressure: float | None = None,
        move: Mapping[object, tuple[float, float, float]] | None = None,
        L0: Mapping[object, float] | None = None,
        steps: int = 1,
    ) -> Step:
        """Go to new loads in equal increments, and write each state.

        An increment without equilibrium is halved from the last good state, and grows again.

        Parameters
        ----------
        pressure
            Pressure to reach (force per area), positive to the membrane's outside.
        move
            Displacements (length) of cables (both ends), cable ends (``cable.start``) or held
            groups of vertices, by which they move during this call. What is named twice, as a
            corner of two groups, moves by the sum. Groups need to be held only in the directions
            in which they move.
        L0
            Unstressed lengths of cables to reach (length).
        steps
            Number of increments.

        Returns
        -------
        Step
            The last step.

        Raises
        ------
        InputError
            A load that cannot be applied; nothing is computed then.
        ConvergenceError
            No equilibrium was found; the scene is at the last good state.
        """
        from crms_fenicsx.progress import progress

        target = self._target(
            pressure, {} if move is None else move, {} if L0 is None else L0, steps
        )
        scene = self.scene
        if target.pressure[1] != 0.0:
            self._check_boundary_held()
        first = State.of(scene)
        done, increment, halvings = 0.0, 1.0, 0
        began = time.perf_counter()
        spent: Outcome | None = None
        with progress(scene.comm, steps, "load steps") as bar:
            while done < steps - 1e-9:
                goal = min(done + increment, np.floor(done + 1e-9) + 1.0)
                good = State.of(scene)
                self._apply(first, target, goal / steps)
                try:
                    outcome = self.system.solve(self._h0_prestress(target, (goal - done) / steps))
                except BaseException:  # also an interrupt leaves a state that is one
                    self._go_back(good)
                    raise
                spent = outcome if spent is None else spent + outcome
                if not outcome.converged:
                    self._go_back(good)
                    halvings += 1
                    self.system.rebuild()  # cables may have switched on the way
                    increment = (goal - done) / 2
                    if increment < 0.5**self.max_halvings * (1 - 1e-9):
                        raise self._failure(outcome, done / steps)
                    logger.info("halving the increment: %s", outcome.reason)
                    continue
                self.system.commit()
                seconds = time.perf_counter() - began
                step = Step(len(self.steps) + 1, spent, dict(scene.energies), seconds, halvings)
                self.steps.append(step)
                self._warn_of_blocked()
                self._recorder.write(step, self.system)
                if abs(goal - round(goal)) < 1e-9:
                    bar.advance(1, f"energy {step.energy:.6g}")
                done, increment = goal, min(2 * (goal - done), 1.0)
                began, spent, halvings = time.perf_counter(), None, 0
        return self.steps[-1]

    def _go_back(self, good: State) -> None:
        """Bring the scene back to a good state after an increment without equilibrium."""
        good.restore(self.scene)
        if self._system is not None:  # its tables may be those of other cables in tension
            self._system.expire()

    def _failure(self, outcome: Outcome, done: float) -> ConvergenceError:
        return ConvergenceError(
            f"step {len(self.steps) + 1}: no equilibrium found, {outcome.reason}: unbalanced force "
            f"{outcome.residual:.3g}, tolerance {outcome.tolerance:.3g}, with the increment halved "
            f"{self.max_halvings} times; {done:.2%} of the loads are on and the scene is at that "
            "state. Try more steps, check that the cables can carry tension where they lie, and "
            "look at the state reached."
        )

    def _target(
        self,
        pressure: float | None,
        move: Mapping[object, tuple[float, float, float]],
        L0: Mapping[object, float],
        steps: int,
    ) -> Target:
        """Check the loads and say what they change. Raises InputError."""
        from crms_fenicsx.cables.cable import CableEnd, LaidCable

        scene = self.scene
        checks.whole("advance: steps", steps, 1)
        scene.check_finite("advance")
        if not scene.comm.allreduce(int(scene.held.any())):
            raise InputError(
                "advance: nothing of the membrane is held; hold its boundary with "
                'scene.fix("boundary").'
            )
        value = scene.pressure if pressure is None else pressure
        value = checks.finite("advance: pressure", value)
        for name, given in (("move", move), ("L0", L0)):
            if not isinstance(given, Mapping):
                raise InputError(
                    f"advance: {name} = {given!r} is no mapping; write {name}={{what: value}}."
                )
        ends: list[tuple[int, int, Array]] = []
        vertices: list[tuple[npt.NDArray[np.int32], Array]] = []
        for key, vector in move.items():
            displacement = checks.vector(f"advance: move of {key!r}", vector)
            if isinstance(key, LaidCable):
                wanted = [key.start, key.end]
            elif isinstance(key, CableEnd):
                wanted = [key]
            elif isinstance(key, str):
                vertices.append((self._held_group(key, displacement), displacement))
                continue
            else:
                raise InputError(f"advance: cannot move {key!r}; give {TYPE_OF_MOVE}.")
            for end in wanted:
                c, k = self._number(end.cable), end.cable.node_of(end.which)
                if end.cable.nodes[k].kind != "anchor":
                    raise InputError(
                        f"advance: the {end.which} of {end.cable.name!r} is tied to the membrane, "
                        "which is not held there; hold it with scene.fix before laying the cable, "
                        "or lay the cable to an anchor off the membrane."
                    )
                ends.append((c, k, displacement))
        moved = self._moved(vertices)
        self._check_above_floor(moved)
        lengths = []
        for key, length in L0.items():
            if not isinstance(key, LaidCable):
                raise InputError(f"advance: L0 of {key!r}; give a laid cable.")
            if key.cable.law == "step":
                raise InputError(
                    f"advance: {key.name!r} has the step-wise law (2.2-2), which has no unstressed "
                    'length; use Cable(law="total").'
                )
            length = checks.positive(f"advance: L0 of {key.name!r}", length)
            lengths.append((self._number(key), key.L0, length))
        return Target((scene.pressure, value), ends, moved, lengths)

    def _number(self, cable: object) -> int:
        for c, other in enumerate(self.scene.cables):
            if other is cable:
                return c
        raise InputError(f"advance: {cable!r} is not a cable of this scene.")

    def _held_group(self, name: str, displacement: Array) -> npt.NDArray[np.int32]:
        dofs = self.scene.vertices(name)
        moving = displacement != 0.0
        with raised_together(self.scene.comm):
            if not self.scene.held[dofs][:, moving].all():
                letters = "".join(np.array(list("xyz"))[moving])
                raise InputError(
                    f"advance: {name!r} is not held in {letters}, so that it cannot be moved by "
                    f"{displacement}; call scene.fix({name!r}, {letters!r}) first."
                )
        return dofs

    def _check_above_floor(self, moved: Array) -> None:
        """The floor is for the free vertices; held ones must not be moved through it."""
        scene = self.scene
        if scene.floor_level is None:
            return
        with raised_together(scene.comm):
            places = scene.positions()
            heights = places[:, 2] + moved[:, 2]
            through = np.flatnonzero((moved[:, 2] < 0) & (heights < scene.floor_level))
            if len(through):
                raise InputError(
                    f"advance: move brings the vertex at {places[through[0]]} to z = "
                    f"{heights[through[0]]:g}, below the floor z = {scene.floor_level:g}; move it "
                    "less."
                )

    def _moved(self, vertices: list[tuple[npt.NDArray[np.int32], Array]]) -> Array:
        """Movements of all vertices, (n, 3); those of a vertex in several groups add up."""
        moved = np.zeros_like(self.scene.held, dtype=np.float64)
        for dofs, displacement in vertices:
            moved[dofs] += displacement
        return moved

    def _check_boundary_held(self) -> None:
        """The exact follower pressure has a potential only if the boundary is held."""
        scene = self.scene
        if scene.pressure_law != "total":
            return
        dofs = scene.vertices("boundary") if self._has_boundary() else np.zeros(0, dtype=np.int32)
        with raised_together(scene.comm):
            free = dofs[~scene.held[dofs].all(axis=1)]
            if len(free):
                place = scene.V.tabulate_dof_coordinates()[free[0]]
                raise InputError(
                    f"advance: pressure on a membrane whose boundary is free at {place}: the "
                    'follower pressure needs it held (scene.fix("boundary")); with free edges '
                    'use Scene(..., pressure="step").'
                )

    def _has_boundary(self) -> bool:
        return bool(self.scene.comm.allreduce(len(self.scene.mesh.edges["boundary"])))

    def _apply(self, first: State, target: Target, share: float) -> None:
        """Set the loads at a share of this call's increments."""
        scene = self.scene
        scene.pressure = target.pressure[0] + share * (target.pressure[1] - target.pressure[0])
        u = scene.u.x.array.reshape(-1, 3)
        some = target.moved != 0.0
        u[some] = first.u.reshape(-1, 3)[some] + share * target.moved[some]
        for c, k, _ in target.cable_ends:
            scene.cables[c].positions[k] = first.cables[c].positions[k]
        for c, k, displacement in target.cable_ends:
            scene.cables[c].positions[k] += share * displacement
        for c, start, end in target.lengths:
            scene.cables[c].L0 = start + share * (end - start)

    def _h0_prestress(self, target: Target, share: float) -> tuple[float, ...]:
        """Extra prestress in H0 for the first stages of a solve.

        A flat sheet has no stiffness against pressure. The stress that it will have is estimated
        from the load, 0.3 (p^2 L^2 E t)^(1/3), and from the movement; a stressed sheet gets none.
        """
        scene, size = self.scene, self.system.size
        modulus = max(m.reference_modulus for m in scene.materials.values())
        moves = [float(np.linalg.norm(d)) for *_, d in target.cable_ends]
        moves.append(float(np.max(np.linalg.norm(target.moved, axis=1), initial=0.0)))
        travel = share * scene.comm.allreduce(max(moves), op=MPI.MAX)
        coming = 0.3 * abs(scene.pressure * size) ** (2 / 3) * modulus ** (1 / 3)
        coming = max(coming, 0.3 * modulus * (travel / size) ** 2)
        present = np.sqrt(max(2 * scene.energies.get("membrane", 0.0) * modulus, 0.0)) / size
        if present > 0.3 * coming:
            return (0.0,)
        return (coming, 0.1 * coming, 0.01 * coming, 0.0)

    def _warn_of_blocked(self) -> None:
        for cable in self.scene.cables:
            if cable.blocked and self.scene.comm.rank == 0:
                place = cable.positions[cable.blocked[0]]
                warnings.warn(
                    f"step {len(self.steps)}: {cable.name!r} has run into {len(cable.blocked)} "
                    f"mesh vertices, the first at {place}; it cannot slide on into other cells, so "
                    "that the result is that of a cable blocked there.",
                    PathWarning,
                    stacklevel=3,
                )
