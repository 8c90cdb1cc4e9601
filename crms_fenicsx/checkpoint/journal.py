"""Checkpoints of a run's calls of `Solver.advance`, so that its script can be started again.

Each call has a folder of its own, numbered from 1: a checkpoint of its last load step, and what it
was called with. Started again, the script makes the same calls. What a call has come to before is
taken from its folder instead of being computed, so that all that the script does in between finds
the scene as it was; the call that was interrupted goes on from its last load step.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from crms_fenicsx.checkpoint.call_record import difference, scene_record
from crms_fenicsx.checkpoint.codec import Plain, decode, encode
from crms_fenicsx.checkpoint.contents import Run
from crms_fenicsx.checkpoint.fingerprint import refuse_history
from crms_fenicsx.checkpoint.folder import ASIDE, complete
from crms_fenicsx.checkpoint.state import STATE, Saved, read, reading, restore, save
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import PARTIAL, explained, make_writable, partial_of
from crms_fenicsx.scene import Scene

logger = logging.getLogger("crms_fenicsx")

FOLDER = "checkpoints"
"""Name of the folder with those of the calls, in the one of the results."""
_OURS = re.compile(rf"({re.escape(PARTIAL)}|{re.escape(ASIDE)})?(\d{{4,9}})")


@dataclass(frozen=True)
class Progress:
    """How far a call has come."""

    # number of its increments that are done; with a part if increments were halved
    done: float = 0.0
    increment: float = 1.0  # the next one, 1 if it is whole
    failure: str | None = None  # why it has given up; None if it has not


class Journal:
    """Keeps what the calls of `Solver.advance` have come to."""

    def __init__(self, folder: Path, comm: MPI.Intracomm, options: Plain, resume: bool) -> None:
        self.folder, self.comm, self.options = folder.resolve(), comm, options
        self._replaying = resume
        self._call: Plain = {}
        self._number = 0
        self._outdated = 1
        """Number of the first call whose folder is not of this run; 0 if there are none."""
        with raised_together(comm):
            if comm.rank == 0:
                make_writable(self.folder)

    def begin(self, scene: Scene, loads: Plain) -> tuple[Progress, Run | None]:
        """Begin a call, and bring the scene to where it has come to before. Collective.

        Returns how far the call has come, and the load steps so far; none where it is computed from
        its beginning.
        """
        refuse_history(scene)
        steps = loads["steps"]
        self._number += 1
        call: Plain = {"solver": self.options, "advance": loads, "scene": scene_record(scene)}
        saved = self._saved() if self._replaying else None
        if saved is None:
            self._replaying, self._call, self._outdated = False, call, self._number
            return Progress(), None
        before = saved.contents.call
        if before is None:
            raise InputError(f"{saved.file} is no checkpoint of a call; take it away")
        for name, now in call.items():
            found = difference(before.get(name), now)
            if found is not None:
                raise InputError(
                    f"resume: at call {self._number} of advance the script is not the one that "
                    f"was interrupted: {name}, {found}. Run it as it was, or begin anew with "
                    f"resume=False, or delete {saved.file.parent} and those after it, to compute "
                    "from this call on anew."
                )
        with reading(saved.file):
            progress = decode(Progress, before["progress"])
            if not (0 <= progress.done <= steps and 0 < progress.increment <= 1):
                raise ValueError(f"{progress} of {steps} steps")
            if progress.done > 0 and not saved.contents.run.steps:
                raise ValueError(f"{progress.done} steps are done, but it has none")
        run = restore(saved, scene)
        self._call = call
        if progress.done < steps and progress.failure is None:
            self._replaying, self._outdated = False, self._number + 1
        logger.info("call %d of advance: %g of %d steps from %s", self._number, progress.done,
                    steps, saved.file.parent)  # fmt: skip
        return progress, run

    def make_way(self) -> None:
        """Remove the folders of calls that will be computed anew. Collective.

        The last one goes first, each at once: whenever the run is killed, what is left is one that
        can go on.
        """
        first, self._outdated = self._outdated, 0
        if first == 0:
            return
        with raised_together(self.comm), explained(self.folder):
            if self.comm.rank == 0:
                found = [(match, path) for path in self.folder.iterdir()
                         if (match := _OURS.fullmatch(path.name))]  # fmt: skip
                order = {PARTIAL: 0, ASIDE: 1, None: 2}
                found.sort(key=lambda one: (-int(one[0][2]), order[one[0][1]]))
                for match, path in found:
                    if int(match[2]) >= first:
                        _remove(path, self.folder / match[2])

    def keep(self, scene: Scene, run: Run, progress: Progress) -> None:
        """Write the checkpoint of a load step of the call. Collective."""
        self.make_way()
        save(self._place(), scene, run, self._call | {"progress": encode(progress)})

    def _place(self) -> Path:
        return self.folder / f"{self._number:04d}"

    def _saved(self) -> Saved | None:
        """What the call has come to before; None if it has not begun."""
        place, there = complete(self._place()), False
        with raised_together(self.comm):
            if self.comm.rank == 0:
                there = os.path.lexists(place / STATE)
        return read(place, self.comm) if self.comm.bcast(there) else None


def _remove(path: Path, folder: Path) -> None:
    """Remove a folder, its name first, so that none is ever there in parts."""
    partial = partial_of(folder)
    if path != partial:
        if partial.exists():
            shutil.rmtree(partial)
        os.replace(path, partial)
    shutil.rmtree(partial)
