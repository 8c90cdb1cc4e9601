"""Records of accepted load steps, in a folder locked for one solver."""

from __future__ import annotations

import fcntl
import gc
import os
import time
import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.cabling.cables.deformed_surface import gained_volume
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import explained, make_writable
from crms_fenicsx.results.output.history import History, Value

if TYPE_CHECKING:
    from crms_fenicsx.results.error_estimate import ErrorEstimator
    from crms_fenicsx.results.output.paraview import Series


NAME = ".lock"
"""Name of the locked file, which is never removed: a recreated file could be locked twice."""


class _FolderLock:
    """Lock on a folder, until it or its process ends, where the file system has locks."""

    def __init__(self, folder: Path, comm: MPI.Intracomm) -> None:
        self.folder, self.comm = folder, comm
        self._own = f"process {os.getpid()} on {os.uname().nodename}"
        self._taken = False

    def take(self, going_on: bool) -> None:
        """Acquire the lock. Collective."""
        deadline = time.monotonic() + (10.0 if going_on else 0.0)
        collected = False
        while not self._taken:
            holder = checks.from_first(self.comm, self._try)
            waits = self.comm.bcast(holder != self._own and time.monotonic() < deadline)
            self._taken = holder is None
            if holder is not None and collected and not waits:
                raise InputError(
                    f"the folder {self.folder} has results of another solver, which is still "
                    f"writing there ({holder}); use another folder for this one, or let the "
                    "other one end first: its process, or in the same script `del solver`."
                )
            if not self._taken:
                gc.collect()  # frees solvers in reference cycles, such as frames of errors
                time.sleep(0.1 if collected else 0.0)
                collected = True

    def _try(self) -> str | None:
        """Try to lock on this rank; returns the current holder, or None."""
        make_writable(self.folder)
        path = self.folder / NAME
        with explained(path):
            number = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(number, 200, 0).decode(errors="replace")
            os.close(number)
            return holder or "another process"
        except OSError:
            pass  # no locks on this file system
        with suppress(OSError):  # the text only serves messages
            os.ftruncate(number, 0)
            os.pwrite(number, self._own.encode(), 0)
        weakref.finalize(self, os.close, number)
        return None


class Recorder:
    """Records a scene's load steps.

    Columns of the `history`: "step", "halvings" of the increment, "pressure", "load" factors,
    "energy" and that of each kind of term, energy "dissipated" by friction and "passes" of its
    forces, "volume" gained; "tension", "length" and "L0" of each cable (also "start" and "end"
    tensions with friction along it or clamps), the force of each "clamp" along the membrane;
    "force", "bar length" and "bar L0" of each bar; "case" and "limit state" of a combination;
    "warnings", "blocked points", and the solve's
    "iterations", "evaluations", "factorizations", "solves", "flips", "residual" (force) and
    "seconds". With `estimate` also "error of energy" (force x length) and "relative error".
    """

    def __init__(self, scene: Scene, folder: str | Path | None, estimate: bool = False) -> None:
        self.scene = scene
        self._estimator: ErrorEstimator | None = None
        if estimate:
            from crms_fenicsx.results.error_estimate import ErrorEstimator

            self._estimator = ErrorEstimator(scene)
        self.series: Series | None = None
        self._lock: _FolderLock | None = None
        self.history = History(None if folder is None else Path(folder) / "history.csv", scene.comm)
        if folder is not None:
            from crms_fenicsx.results.output.paraview import Series

            self.series = Series(folder, scene.comm)
            self._lock = _FolderLock(self.series.folder, scene.comm)

    def claim(self, going_on: bool = False) -> None:
        """Lock the folder for this recorder, until it or its process ends. Collective."""
        if self._lock is not None:
            self._lock.take(going_on)

    def write(self, step: Step, system: System, case: str = "") -> None:
        """Record the step just accepted, of a named load case. Collective."""
        row = self._row(step)
        if self._estimator is not None:
            estimate = self._estimator.of(system)
            row["error of energy"], row["relative error"] = estimate.total, estimate.relative
        if case:
            row["case"] = case
            if self.scene.case.base is not None:
                row["limit state"] = self.scene.case.state
        self.history.append(row)
        if self.series is not None:
            from crms_fenicsx.results.view_data import current_view

            self.series.write(step.number, *current_view(system), case)

    def resume(self, rows: Sequence[Mapping[str, Value]]) -> None:
        """Continue after the steps of an earlier run, in its files if they match. Collective."""
        with raised_together(self.scene.comm):
            self.history.resume(rows)
        path = self.history.path
        if self.series is not None and path is not None:
            same = checks.from_first(self.scene.comm, lambda: _begins(path, self.history))
            self.series.resume(range(1, len(rows) + 1) if same else [])

    def _row(self, step: Step) -> dict[str, Value]:
        scene, outcome = self.scene, step.outcome
        row: dict[str, Value] = {
            "step": step.number,
            "halvings": step.halvings,
            "pressure": scene.pressure,
        }
        for load in scene.loads:
            row["load" if load.name == "load" else f"load {load.name}"] = load.factor
        for pond in scene.ponds:
            row[f"load {pond.name}"] = pond.factor
            row[f"level {pond.name}"] = pond.level
            row[f"volume {pond.name}"] = pond.volume
        row["energy"] = step.energy
        row |= {f"energy {name}": value for name, value in step.energies.items()}
        held = any(
            c.state.law.lateral is not None or c.state.law.axial is not None for c in scene.cables
        )
        held |= any(cable.may_slip for cable in scene.cables)
        if held or "dissipated" in self.history.columns:
            row["dissipated"] = scene.dissipated
            row["passes"] = outcome.passes
        if scene.air.sealed is not None:
            row["temperature"] = scene.air.sealed.temperature
            row["atmosphere"] = scene.air.sealed.atmosphere
        if scene.pressure != 0.0 or "volume" in self.history.columns:
            row["volume"] = self._volume()
        for cable in scene.cables:
            row[f"tension {cable.name}"] = cable.tension
            if cable.is_divided:
                row[f"tension {cable.name} start"] = float(cable.tensions[0])
                row[f"tension {cable.name} end"] = float(cable.tensions[-1])
            row[f"length {cable.name}"] = cable.length
            row[f"L0 {cable.name}"] = cable.L0
        if scene.clamps:
            from crms_fenicsx.results.cable_and_bar_results import clamp_results

            for clamp in clamp_results(scene).values():
                row[f"clamp {clamp.name}"] = clamp.size
        for bar in scene.bars:
            row[f"force {bar.name}"] = bar.force
            row[f"bar length {bar.name}"] = bar.length
            row[f"bar L0 {bar.name}"] = bar.L0
        if scene.cables or "blocked points" in self.history.columns:
            row["blocked points"] = sum(len(cable.blocked) for cable in scene.cables)
        if step.warnings:
            row["warnings"] = "; ".join(map(str, step.warnings))
        counts = ("iterations", "evaluations", "factorizations", "solves", "flips", "residual")
        row |= {name: getattr(outcome, name) for name in counts}
        # ranks' clocks differ, but a row must be the same on all
        row["seconds"] = scene.comm.bcast(step.seconds)
        return row

    def _volume(self) -> float:
        """Volume gained at this step, from the work of the pressure where possible."""
        scene = self.scene
        if scene.pressure_law == "total" and scene.pressure != 0.0 and scene.air.sealed is None:
            return -scene.energies["pressure"] / scene.pressure
        return gained_volume(scene.net)


def _begins(path: Path, history: History) -> bool:
    """Whether a table in a file begins with the rows of a history."""
    try:
        there = History.read(path)  # raises InputError if missing
    except InputError:
        return False
    n = len(history)
    return len(there) >= n > 0 and all(
        column in there.columns and np.array_equal(there[column][:n], history[column])
        for column in ("step", "energy")
    )
