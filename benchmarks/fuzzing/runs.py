"""Runs random scenes, and checks the properties of every answer."""

from __future__ import annotations

import logging
import re
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    Friction,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.verification.verifier import Verifier
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.foundation.runtime import errors
from crms_fenicsx.foundation.runtime.arrays import Array
from fuzzing.scenes import CableData, SceneData

SECONDS = 30
"""Time of the processor after which a scene counts as hanging."""
FALL = 1e-8
"""Rise of the energy between two stages of a minimisation, relative to the sum of its parts, that
is rounding, or what the trapezoidal rule misses near the minimum where friction is not smooth."""
SAME_ENERGY, SAME_TENSION = 1e-6, 1e-4
"""Relative differences up to which two answers are the same."""
SHAKES = (1e-4, 1e-2)
"""Sizes of the displacements about an equilibrium, relative to the cells."""
LENGTH, FORCE, PUSH = 0.0254, 9.80665, (31.0, -17.0, 5.0)
"""Other units, and another place."""


class HangError(Exception):
    """A scene has taken too long."""


@dataclass
class Result:
    """What came of a scene.

    Attributes
    ----------
    number, kind
        The scene's.
    outcome
        "converged", "refused" (an error of the package that says what to do) or "failed".
    text
        The error, without its numbers.
    energies, tensions
        After each load step, the latter of all cables in a row.
    problems
        What must not be.
    notes
        What is worth to know, such as another equilibrium of the same scene.
    evaluations, steps, halvings, seconds
        What it took.
    """

    number: int
    kind: str
    outcome: str = "converged"
    text: str = ""
    energies: list[float] = field(default_factory=list)
    tensions: list[list[float]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    evaluations: int = 0
    steps: int = 0
    halvings: int = 0
    seconds: float = 0.0
    verification: float = 0.0


@contextmanager
def watched(result: Result) -> Iterator[None]:
    """Look at each minimisation and at each state that is verified."""
    solve, check, stage = Minimizer.solve, Verifier.check, Minimizer.solve
    levels: list[float] = []

    def solving(self: Minimizer, *args: Any, **kwargs: Any) -> Any:
        levels.clear()
        own = self.potential.evaluate_terms

        def evaluate_terms() -> tuple[float, float]:
            energy, scale = own()
            levels.append(energy)
            return energy, scale

        self.potential.evaluate_terms = evaluate_terms  # type: ignore[method-assign]
        try:
            outcome = solve(self, *args, **kwargs)
        finally:
            del self.potential.evaluate_terms
        size = sum(abs(v) for v in self.potential.energies().values())
        size += self.atol * float(np.ptp(self.potential.unknowns.X)) / FALL  # nothing at all
        rises = np.diff(levels)
        if outcome.converged and len(rises) and rises.max() > FALL * size:
            result.problems.append(f"energy rises in a minimisation by {rises.max() / size:.1e}")
        return outcome

    def checking(self: Verifier, system: System, outcome: Any, *others: Any) -> Any:
        found = check(self, system, outcome, *others)
        result.notes += [f"doubtful: {check.name}" for check in found.doubtful]
        if not found.passed:
            result.notes += [f"halved, not verified: {check.name}" for check in found.failed]
        else:
            result.notes += lower_states(system)
        return found

    Minimizer.solve, Verifier.check = solving, checking  # type: ignore[method-assign]
    try:
        yield
    finally:
        Minimizer.solve, Verifier.check = stage, check  # type: ignore[method-assign]


def lower_states(system: System) -> list[str]:
    """States near an equilibrium with less energy, in words."""
    potential, unknowns, scene = system.potential, system.unknowns, system.scene
    n = unknowns.n_owned
    potential.sum_up()
    here = potential.energies()
    saved, found = potential.x.copy(), []
    cells = scene.mesh.mesh.topology.index_map(2).size_global
    size = scene.membrane.size / np.sqrt(cells)
    rounding = 1e-13 * sum(abs(v) for v in here.values())
    random = np.random.default_rng(scene.comm.rank)
    for shake in SHAKES:
        way = random.normal(size=(n, 3)) * shake * size
        way[unknowns.held[:n]] = 0.0
        potential.x[:n] = saved[:n] + way
        if unknowns.bounds is not None:
            np.maximum(potential.x[:n], unknowns.bounds[0][:n], out=potential.x[:n])
        potential.place()
        potential.sum_up()
        rise = sum(potential.energies()[name] - here[name] for name in here)
        if rise < -rounding:
            found.append(f"lower state within {shake:g} cells")
        if not np.isfinite(rise):
            found.append("energy not finite beside the equilibrium")
    potential.x[:] = saved
    unknowns.read_vertices(potential.x, scene.u.x.array.reshape(-1, 3))
    potential.sum_up()
    return found


@contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise a `HangError` when something takes too long."""

    def ring(*_: object) -> None:
        raise HangError(f"more than {seconds} s")

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def run(data: SceneData, comm: MPI.Intracomm = MPI.COMM_WORLD) -> Result:
    """Run a scene, and its twin where it has one."""
    began = time.process_time()
    result = Result(data.number, data.kind)
    with limited(SECONDS), warnings.catch_warnings():
        warnings.simplefilter("error")
        for own in (
            errors.DoubtWarning, errors.FrictionWarning, errors.PathWarning,
            errors.PenaltyWarning, errors.SnapThroughWarning,
        ):  # fmt: skip
            warnings.simplefilter("ignore", own)
        try:
            with watched(result):
                play(data, comm, result)
                if data.twin and result.outcome == "converged":
                    compare(data, comm, result)
        except (errors.InputError, errors.ConvergenceError) as error:
            result.outcome, result.text = "refused", kind_of(error)
        except Exception as error:
            logging.getLogger("crms_fenicsx").debug("%s", error, exc_info=True)
            result.problems.append(f"{type(error).__name__}: {error}")
    if result.problems:
        result.outcome = "failed"
    result.seconds = time.process_time() - began
    return result


def kind_of(error: Exception) -> str:
    """An error's text without what differs from scene to scene."""
    text = str(error).split(": unbalanced force")[0]
    text = re.sub(r"\[[^\]]*\]|\([^)]*\d[^)]*\)", "()", text)
    text = re.sub(r"'cable \d+'|cable \d+(, cable \d+)*", "cable", text)
    return f"{type(error).__name__}: " + re.sub(r"-?\d[\d.e+-]*%?", "#", text)[:160]


def play(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """Build a scene and do to it what is to be done."""
    root = comm.rank == 0
    mesh = meshes.from_arrays(comm, data.points if root else None, data.cells if root else None)
    kind, arguments = data.material
    make: Any = IsotropicMembrane if kind == "isotropic" else OrthotropicMembrane
    scene = Scene(mesh, make(**arguments), **data.laws)  # type: ignore[arg-type]
    if data.held == "all":
        scene.fix("boundary")
    else:
        along = data.points @ np.array(data.axis)
        limit, middle = 0.4 * float(np.ptp(along)), float(along.min() + along.max()) / 2
        scene.fix(lambda x: np.abs(np.array(data.axis) @ x - middle) > limit)
    if data.floor is not None:
        scene.floor(data.floor)
    solver = Solver(scene)
    try:
        for name, what in data.events:
            if name == "lay":
                lay(scene, what)
            elif name == "load":
                if scene.loads:
                    scene.remove_load("load")
                scene.put_load(what)
            else:
                steps = len(solver.steps)
                advance(solver, what)
                result.steps += len(solver.steps) - steps
                new = solver.steps[steps:]
                result.evaluations += sum(step.outcome.evaluations for step in new)
                result.halvings += sum(step.halvings for step in new)
                if new and new[-1].verification is not None:
                    result.verification += sum(s.verification.seconds for s in new)  # type: ignore[union-attr]
                inspect(solver, result)
    finally:
        if solver._increments._system is not None:
            solver.system.destroy()


def lay(scene: Scene, data: CableData) -> None:
    """Lay a cable."""
    friction: Any = 0.0 if data.friction is None else Friction(**data.friction)
    scene.lay_cable(
        Cable(data.EA, data.law, friction),  # type: ignore[arg-type]
        data.path, L0=data.L0, tension=data.tension, layer=data.layer,
        hold="sleeve" if data.sleeve else "outside",
    )  # fmt: skip


def advance(solver: Solver, loads: dict[str, Any]) -> None:
    """Take load steps; what concerns a cable that does not hold by its end is left out."""
    cables = solver.scene.cables
    move: dict[object, tuple[float, float, float]] = {}
    for (c, which), way in loads.get("move", {}).items():
        cable = cables[c]
        for end in (cable.start, cable.end):
            if (
                which in ("both", end.which)
                and cable.state.nodes[cable.node_of(end.which)].point is None
            ):
                move[end] = way
    if "boundary" in loads:
        if all(solver.scene.held[solver.scene.vertices("boundary")].ravel()):
            move["boundary"] = loads["boundary"]
    L0 = {
        cables[c]: factor * cables[c].L0
        for c, factor in loads.get("L0", {}).items()
        if cables[c].cable.law == "total"
    }
    solver.advance(
        pressure=loads.get("pressure"), load=loads.get("load"), move=move, L0=L0,
        steps=loads["steps"],
    )  # fmt: skip


def inspect(solver: Solver, result: Result) -> None:
    """Look at an accepted state."""
    scene, step = solver.scene, solver.steps[-1]
    tensions = [float(cable.tension) for cable in scene.cables]
    result.energies.append(float(step.energy))
    result.tensions.append(tensions)
    values = [step.energy, *tensions, *scene.u.x.array, *(c.length for c in scene.cables)]
    if not np.isfinite(values).all():
        result.problems.append("not finite")
    for cable in scene.cables:
        if cable.cable.law == "total" and min(cable.tension, *cable.tensions) < 0.0:
            result.problems.append(f"{cable.name} is compressed")
        coulomb = cable.cable.sideways is None or cable.has_coulomb
        grips = [
            grip for grip in (cable.state.law.lateral, cable.state.law.axial) if grip is not None
        ]
        if coulomb and any(grip.dissipated < 0.0 for grip in grips):
            result.problems.append(f"negative dissipation of {cable.name}")


def compare(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """Run the twin of a scene, and compare the answers after the last load step."""
    if data.twin in ("more steps", "laid later") and (
        data.has_friction or "step" in data.laws.values() or data.floor is not None
    ):
        return  # the answer depends on the way to it
    other, unit, force = twin(data)
    if other is None:
        return
    second = Result(data.number, data.kind)
    try:
        play(other, comm, second)
    except (errors.InputError, errors.ConvergenceError) as error:
        result.notes.append(f"{data.twin}: refused, {kind_of(error)}")
        return
    finally:
        result.problems += [f"{data.twin}: {text}" for text in second.problems]
    a, b = result.energies[-1], second.energies[-1] / (unit * force)
    size = max(abs(a), abs(b), *(abs(e) for e in result.energies), 1e-9)
    gap = abs(a - b) / size
    T, S = np.array(result.tensions[-1]), np.array(second.tensions[-1]) / force
    top = max(T.max(initial=0.0), S.max(initial=0.0), 1e-9)
    slack = float(np.abs(T - S).max(initial=0.0)) / top
    if gap > SAME_ENERGY or slack > SAME_TENSION:
        result.notes.append(
            f"{data.twin}: another equilibrium, energies {a:.8g} and {b:.8g}, "
            f"tensions {T.round(4).tolist()} and {S.round(4).tolist()}"
        )


def twin(data: SceneData) -> tuple[SceneData | None, float, float]:
    """The scene with the same answer, and the units of length and force of that."""
    random = np.random.default_rng(data.number)
    if data.twin == "units":
        return scaled(data, LENGTH, FORCE), LENGTH, FORCE
    if data.twin == "turned":
        return moved(data, *rotation(data, random)), 1.0, 1.0
    if data.twin == "mirrored":
        mirror = np.diag([-1.0, 1.0, 1.0])
        return moved(data, mirror, np.zeros(3)), 1.0, 1.0
    if data.twin == "renumbered":
        order = random.permutation(len(data.points))
        cells = np.argsort(order)[data.cells][random.permutation(len(data.cells))]
        cells = np.stack([np.roll(cell, random.integers(3)) for cell in cells])
        return replace(data, points=data.points[order], cells=cells), 1.0, 1.0
    if data.twin == "more steps":
        events = tuple(
            (name, what | {"steps": 2 * what["steps"] + 1} if name == "advance" else what)
            for name, what in data.events
        )
        return replace(data, events=events), 1.0, 1.0
    return later(data), 1.0, 1.0


def later(data: SceneData) -> SceneData | None:
    """The scene with its cables laid a load step later, if their lengths do not depend on it."""
    names = [name for name, _ in data.events]
    cables, steps = data.cables, [e for e in data.events if e[0] != "lay"]
    movable = any("move" in w or "L0" in w or "boundary" in w for n, w in steps if n == "advance")
    if movable or "lay" not in names or any(cable.L0 is None for cable in cables):
        return None
    first = next(i for i, event in enumerate(steps) if event[0] == "advance")
    laid = [("lay", cable) for cable in cables]
    if names[0] == "lay":  # first a load step without them
        steps = [*steps[: first + 1], *laid, *steps[first:]]
    else:
        steps = [*laid, *steps]
    return replace(data, events=tuple(steps))


def rotation(data: SceneData, random: np.random.Generator) -> tuple[Array, Array]:
    """A turn, (3, 3), and a translation. Paths in plan and floors have a vertical of their own."""
    if data.floor is not None or any(c.path.shape[1] == 2 for c in data.cables):
        a = random.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
        return turn, np.array([*PUSH[:2], 0.0])
    # Not so far that "up" were no longer the outside.
    axis = np.array([*random.normal(size=2), 0.0])
    axis /= np.linalg.norm(axis)
    K = np.cross(np.eye(3), axis)
    a = random.uniform(0.1, 0.6)
    turn = np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K
    return turn, np.array(PUSH)


def moved(data: SceneData, turn: Array, push: Array) -> SceneData:
    """A scene turned or mirrored, and then pushed."""

    def vector(v: Any) -> tuple[float, ...]:
        return tuple(float(x) for x in turn @ np.asarray(v))

    def way(path: Array) -> Array:
        if path.shape[1] == 2:
            return path @ turn[:2, :2].T + push[:2]
        return path @ turn.T + push

    events: list[tuple[str, Any]] = []
    for name, what in data.events:
        if name == "lay":
            what = replace(what, path=way(what.path))
        elif name == "load":
            what = vector(what)
        else:
            what = dict(what)
            if "move" in what:
                what["move"] = {end: vector(v) for end, v in what["move"].items()}
            if "boundary" in what:
                what["boundary"] = vector(what["boundary"])
        events.append((name, what))
    kind, arguments = data.material
    if "warp" in arguments:
        arguments = arguments | {"warp": vector(arguments["warp"])}
    cells = data.cells if np.linalg.det(turn) > 0 else data.cells[:, [0, 2, 1]]
    return replace(
        data, points=data.points @ turn.T + push, cells=cells, events=tuple(events),
        material=(kind, arguments), axis=vector(data.axis),
    )  # fmt: skip


def scaled(data: SceneData, unit: float, force: float) -> SceneData:
    """A scene in other units: all lengths and forces multiplied."""
    area = unit * unit
    events: list[tuple[str, Any]] = []
    for name, what in data.events:
        if name == "lay":
            what = replace(
                what,
                path=what.path * unit,
                EA=what.EA * force,
                L0=None if what.L0 is None else what.L0 * unit,
                tension=None if what.tension is None else what.tension * force,
            )
        elif name == "load":
            what = tuple(x * force / area for x in what)
        else:
            what = dict(what)
            if "pressure" in what:
                what["pressure"] *= force / area
            if "move" in what:
                what["move"] = {end: tuple(x * unit for x in v) for end, v in what["move"].items()}
            if "boundary" in what:
                what["boundary"] = tuple(x * unit for x in what["boundary"])
        events.append((name, what))
    kind, given = data.material
    arguments = dict(given)
    for name in ("E", "E1", "E2", "G12"):
        if name in arguments:
            arguments[name] *= force / area
    arguments["thickness"] *= unit
    arguments["prestress"] *= force / unit
    return replace(
        data, points=data.points * unit, events=tuple(events), material=(kind, arguments),
        floor=None if data.floor is None else data.floor * unit,
    )  # fmt: skip
