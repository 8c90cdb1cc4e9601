"""Twins of random scenes: done otherwise, they must have the same answer."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.runtime import errors
from crms_fenicsx.results.checkpoint.journal import Journal
from fuzzing.checks import (
    ENERGY,
    FORCE,
    LOOSE,
    Numbers,
    Result,
    answer,
    differs,
    empty,
    kind_of,
    scenario,
)
from fuzzing.scenes import SceneData
from fuzzing.world import Frame, World

PUSH = (31.0, -17.0, 5.0)
"""Another place."""
FRAMES = {
    "units": Frame(unit=0.0254, force=9.80665),
    "mm-N": Frame(unit=1e3, force=1e3),
    "tiny": Frame(unit=1e-3, force=1e-6),
    "huge": Frame(unit=1e2, force=1e7),
    "mirrored": Frame(np.diag([-1.0, 1.0, 1.0])),
}


def twin(name: str, data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """Run a scene otherwise, and compare with its result. Collective."""
    if name in SCRIPTS:
        SCRIPTS[name](data, comm, result)
        return
    options: dict[str, Any] = {}
    if name == "verify":
        options["verify"] = False
    elif name == "order":
        order = np.random.default_rng(data.number).permutation(len(data.features)).tolist()
        names = [n for n, _ in data.features]
        if "mast" in names:  # cables may end there
            order.sort(key=lambda k: names[k] != "mast")
        options["order"] = order
    else:
        other = variant(name, data)
        if other is None:
            return
        data, options["frame"] = other
    second = empty(data)
    with scenario(data, comm, second, **options):
        pass
    result.problems += [f"{name}: {text}" for text in second.problems]
    compare(name, data, result, second)


def variant(name: str, data: SceneData) -> tuple[SceneData, Frame] | None:
    """The scene with the same answer and its frame; None where there is none."""
    rng = np.random.default_rng(data.number)
    if name in FRAMES:
        return data, FRAMES[name]
    if name == "turned":
        return (data, turned(data, rng)) if data.held != "plane" else None
    if name == "renumbered":
        order = rng.permutation(len(data.points))
        cells = np.argsort(order)[data.cells][rng.permutation(len(data.cells))]
        cells = np.stack([np.roll(cell, rng.integers(3)) for cell in cells])
        return replace(data, points=data.points[order], cells=cells), Frame()
    if data.depends_on_way or data.features:
        return None
    if name == "more steps":
        events = tuple(
            (name, what | {"steps": 2 * what["steps"] + 1} if name == "advance" else what)
            for name, what in data.events
        )
        return replace(data, events=events), Frame()
    other = later(data)
    return None if other is None else (other, Frame())


def turned(data: SceneData, rng: np.random.Generator) -> Frame:
    """Turned and elsewhere. Paths in plan, loads and floors have a vertical of their own."""
    angle, axis = rng.uniform(0, 2 * np.pi), np.array([0.0, 0.0, 1.0])
    if data.ambiguous and not data.features and all(c["path"].shape[1] == 3 for c in data.cables):
        angle, axis = rng.uniform(0.1, 0.6), np.array([*rng.normal(size=2), 0.0])
        axis /= np.linalg.norm(axis)  # not so far that "up" were no longer the outside
    K = np.cross(np.eye(3), axis)
    return Frame(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K, np.array(PUSH))


def later(data: SceneData) -> SceneData | None:
    """The scene with its cables laid a load step later, if their lengths do not depend on it."""
    names = [name for name, _ in data.events]
    steps = [event for event in data.events if event[0] != "lay"]
    laid = [event for event in data.events if event[0] == "lay"]
    movable = any(w.keys() & {"ends", "lengths", "boundary"} for n, w in steps if n == "advance")
    if movable or not laid or any(cable["L0"] is None for cable in data.cables):
        return None
    first = next(i for i, event in enumerate(steps) if event[0] == "advance")
    if names[0] == "lay":  # first a load step without them
        steps = [*steps[: first + 1], *laid, *steps[first:]]
    else:
        steps = [*laid, *steps]
    return replace(data, events=tuple(steps))


def compare(name: str, data: SceneData, a: Result, b: Result) -> None:
    """Note in the first of two results of a scene where they differ."""
    if data.ambiguous:
        others(name, a, b)
        return
    if len(a.answers) != len(b.answers):
        a.problems.append(f"{name}: {len(a.answers)} and {len(b.answers)} states")
    for (what, x), (_, y) in zip(a.answers, b.answers, strict=False):
        text = differs(x, y, LOOSE if a.loose else 1.0)
        if text:
            e, d = x["energy"][0], y["energy"][0]
            a.problems.append(f"{name}, {what}: {text} (energies {e:.9g} {d:.9g})")
            return


def others(name: str, first: Result, second: Result) -> None:
    """Note whether two runs of a scene with several equilibria end in different ones."""
    a, b = first.energies[-1], second.energies[-1]
    gap = abs(a - b) / max(abs(a), abs(b), *map(abs, first.energies), 1e-9)
    T, S = np.array(first.tensions[-1]), np.array(second.tensions[-1])
    away = float(np.abs(T - S).max(initial=0.0)) / max(T.max(initial=0.0), S.max(initial=0.0), 1e-9)
    if gap > ENERGY or away > FORCE:
        first.notes.append(
            f"{name}: another equilibrium, energies {a:.8g} and {b:.8g}, "
            f"tensions {T.round(4).tolist()} and {S.round(4).tolist()}"
        )


def same(what: str, before: Numbers, world: World, result: Result, tight: float = 1.0) -> None:
    """Note if a state is not as it was. Collective."""
    text = differs(before, answer(world), LOOSE if result.loose else tight)
    if text:
        result.problems.append(f"{what}: {text}")


@contextmanager
def folder(comm: MPI.Intracomm) -> Iterator[Path]:
    """A folder of all ranks that goes again."""
    path = Path(comm.bcast(tempfile.mkdtemp(prefix="fuzz")))
    yield path
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(path, ignore_errors=True)


class Killed(BaseException):
    """Stands for the end of the process."""


@contextmanager
def killed(owner: type, method: str, after: int, *, done: bool) -> Iterator[None]:
    """Raise `Killed` at the call of a method with this number, once it is done or before."""
    whole, left = getattr(owner, method), after

    def counted(*arguments: Any, **options: Any) -> None:
        nonlocal left
        left -= 1
        if left != 0 or done:
            whole(*arguments, **options)
        if left == 0:
            raise Killed

    setattr(owner, method, counted)
    try:
        yield
    finally:
        setattr(owner, method, whole)


def stopped(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """A load step that is stopped leaves the state before, and the next one is as if it had not."""
    with scenario(data, comm) as world, scenario(data, comm) as other:
        u, before = world.scene.u.x.array.copy(), answer(world)
        load = {name: 1.1 * factor + 0.1 for name, factor in world.scene.factors.items()}
        for count in (1, 5, 30):
            with suppress(Killed), killed(Potential, "sum_up", count, done=False):
                world.advance(load=load, move="boundary", way=(0.0, 0.02, 0.03), of=0)
                result.notes.append("stopped: it was done before")
                return
            same(f"stopped after {count}", before, world, result, 1e-6)
            if not np.array_equal(u, world.scene.u.x.array):
                result.problems.append(f"stopped after {count}: u")
        for one in (world, other):
            one.advance(load=load)
        same("stopped, then a load step", answer(other), world, result)


def resumed(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """A script that ends after some checkpoints and goes on has the answer of one that did not."""
    after, second = int(np.random.default_rng(data.number).integers(1, 6)), empty(data)
    with folder(comm) as path:
        with suppress(Killed), killed(Journal, "keep", after, done=True):
            with scenario(data, comm, results=path / "out", resume=False):
                pass
        comm.barrier()
        with scenario(data, comm, second, results=path / "out", resume=True):
            compare("resume", data, result, second)


def loaded(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """A state that is saved and loaded is the same, and stays where it is."""
    with scenario(data, comm) as world, folder(comm) as path:
        before = answer(world)
        world.solver.save(path / "state")
        other = World(data, Frame(), comm)
        if "term" in result.names:
            other.put_term(**dict(data.features)["term"])
        other.solver.load(path / "state")
        same("load", before, other, result, 1e-3)
        settle("load", other, before, result)
        load = {name: 0.9 * factor for name, factor in world.scene.factors.items()}
        for one in (world, other):
            one.advance(load=load)
        same("load, then other loads", answer(world), other, result)
        other.close()


def settle(name: str, world: World, before: Numbers, result: Result) -> None:
    """A load step without anything new moves nothing."""
    world.solver.advance()
    same(f"{name}, a load step without anything new", before, world, result)


def branched(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """A branch ends in the state in which it began, bit by bit, and that is an equilibrium."""
    with scenario(data, comm) as world:
        before, u = answer(world), world.scene.u.x.array.copy()
        try:
            world.branch({name: 0.7 for name in world.scene.factors}, True, True, True,
                         {"move": "boundary", "way": (0.05, 0.0, 0.1), "of": 0})  # fmt: skip
        except (errors.ConvergenceError, errors.PathError) as error:  # a path over a hole
            result.notes.append(f"branch refused, {kind_of(error)}")
        same("branch", before, world, result, 1e-6)
        if not np.array_equal(u, world.scene.u.x.array):
            result.problems.append("branch: u")
        settle("branch", world, before, result)
        snapshot = world.solver.snapshot()
        load = {name: 1.1 * factor for name, factor in world.scene.factors.items()}
        try:
            world.advance(load=load)
            after = answer(world)
            world.solver.restore(snapshot)
            world.advance(load=load)
            same("restored, the same load step again", after, world, result)
        except errors.ConvergenceError as error:
            result.notes.append(f"restore refused, {kind_of(error)}")


def outputs(data: SceneData, comm: MPI.Intracomm, result: Result) -> None:
    """Files, tables and reports are written and agree with the state."""
    second = empty(data)
    with (
        folder(comm) as path,
        scenario(data, comm, second, results=path / "out", estimate=True) as world,
    ):
        compare("outputs", data, result, second)
        scene, solver = world.scene, world.solver
        results = solver.results()
        for name in results.names:
            if not np.isfinite(results.values(name)).all() and name != "utilisation":
                result.problems.append(f"results: {name} is not finite")
            results.function(name)
        for cable in scene.cables:
            one = solver.cable_forces()[cable.name]
            if not one.least <= one.mean * (1 + 1e-12) <= one.largest * (1 + 1e-9):
                result.problems.append(f"results: {cable.name} {one}")
        factors = {name: 0.8 * f for name, f in scene.factors.items()}
        found = solver.combine({"less": factors}) if factors else None
        try:
            solver.report(path / "out" / "report.html", found)
        except errors.InputError as error:
            result.notes.append(f"report: {kind_of(error)}")
        own = [row["energy"] for row in solver.history if not row.get("case")]
        if abs(own[-1] - scene.energy) > 1e-9 * abs(scene.energy):
            result.problems.append("outputs: history's energy")


SCRIPTS = {
    "stopped": stopped, "resume": resumed, "load": loaded, "branch": branched, "outputs": outputs,
}  # fmt: skip
