"""Progress of a run: a bar on a terminal, log records elsewhere."""

from __future__ import annotations

import logging
import math
import sys
from types import TracebackType
from typing import Any

from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import InputError

_log = logging.getLogger("crms_fenicsx")
_BAR_FORMAT = "{l_bar}{bar}| {n:g}/{total:g} [{elapsed}<{remaining}{postfix}]"


def progress(comm: MPI.Intracomm, total: float, title: str) -> Progress:
    """Return a context manager that shows how much of `total` is done; not collective.

    Rank 0 draws a bar if its standard error is a terminal; otherwise it logs to the logger
    "crms_fenicsx" at level INFO, whose handlers the caller sets up. Other ranks are silent.

    Parameters
    ----------
    comm : MPI communicator
    total : float
        The whole amount, such as a number of load steps; finite, not negative.
    title : str
        Title of the bar.

    Raises
    ------
    InputError
        If the total is negative or not finite.

    Examples
    --------
    >>> with progress(MPI.COMM_WORLD, 2, "inflating") as bar:
    ...     bar.advance(note="12 iterations")
    ...     bar.advance(note="9 iterations")
    """
    return Progress(comm, total, title)


class Progress:
    """Context manager returned by `progress`."""

    def __init__(self, comm: MPI.Intracomm, total: float, title: str) -> None:
        if not (math.isfinite(total) and total >= 0):
            raise InputError(f"progress of {title!r}: total {total}; pass a number, 0 or more.")
        self.total = total
        self.title = title
        self.done: float = 0
        self._speaks = comm.rank == 0
        self._bar: Any = None

    def __enter__(self) -> Progress:
        if self._speaks and sys.stderr is not None and sys.stderr.isatty():
            try:
                from tqdm import tqdm
            except ImportError:  # the bar is only a convenience: the log has the same information
                return self
            self._bar = tqdm(
                total=self.total, desc=self.title, file=sys.stderr, bar_format=_BAR_FORMAT
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def advance(self, n: float = 1, note: str = "") -> None:
        """Report that `n` more of the total is done."""
        self.done += n
        if self._bar is not None:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(n)
        elif self._speaks:
            _log.info("%s %g/%g%s", self.title, self.done, self.total, f": {note}" if note else "")
