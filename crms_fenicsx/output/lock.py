"""A lock that keeps a folder to one writer at a time."""

from __future__ import annotations

import fcntl
import gc
import os
import time
import weakref
from contextlib import suppress
from pathlib import Path

from mpi4py import MPI

from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import explained, make_writable

NAME = ".lock"
"""Name of the file that is locked. It stays, as a file that comes and goes could be locked twice.
"""
GRACE = 10.0
"""Seconds for which a run that goes on waits for the processes of the one that was killed."""


class FolderLock:
    """Keeps other writers, of this process and of others, out of a folder.

    Rank 0 holds the lock until this object is gone or its process ends, however it ends. Where the
    file system knows no locks, nobody is kept out.
    """

    def __init__(self, folder: Path, comm: MPI.Intracomm) -> None:
        self.folder, self.comm = folder, comm
        self._own = f"process {os.getpid()} on {os.uname().nodename}"
        self._taken = False

    def take(self, going_on: bool) -> None:
        """Keep others out from now on. Collective."""
        deadline = time.monotonic() + (GRACE if going_on else 0.0)
        collected = False
        while not self._taken:
            holder: str | None = None
            with raised_together(self.comm):
                if self.comm.rank == 0:
                    holder = self._try()
            waits = holder != self._own and time.monotonic() < deadline
            holder, waits = self.comm.bcast((holder, waits))
            self._taken = holder is None
            if holder is not None and collected and not waits:
                raise InputError(
                    f"the folder {self.folder} has results of another solver, which goes on "
                    f"writing there ({holder}); give this one a folder of its own, or let the "
                    "other one end first: its process, or in the same script `del solver`."
                )
            if not self._taken:
                gc.collect()  # a solver in a cycle of references, as the frames of errors are
                time.sleep(0.1 if collected else 0.0)
                collected = True

    def _try(self) -> str | None:
        """Take the lock on this rank; who has it, if it is not free."""
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
        with suppress(OSError):  # the text is for messages only
            os.ftruncate(number, 0)
            os.pwrite(number, self._own.encode(), 0)
        weakref.finalize(self, os.close, number)
        return None
