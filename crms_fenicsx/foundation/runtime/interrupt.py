"""Ctrl-C, and the termination signal of batch systems, during collective work.

A signal reaches the ranks at different moments, or one rank only; an exception raised at once would
leave the other ranks in a reduction for ever. So signals are only recorded during load steps. The
reduction of each evaluation of the potential exchanges the records, and all ranks stop at the same
evaluation. A second signal ends the process at once.
"""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc  # noqa: F401 (installs its handlers before ours)

logger = logging.getLogger("crms_fenicsx")

Handler = Callable[[int, FrameType | None], Any] | signal.Handlers

USUAL: dict[int, Handler] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""Signals handled here, with Python's default handlers; a handler set by others stays."""

_noted = 0
"""Number of the signal received, 0 if none; global, as signal handlers belong to the process."""


def noted() -> bool:
    """Whether this rank has received a signal that it has not acted on."""
    return _noted != 0


def _note(number: int, frame: FrameType | None) -> None:
    global _noted
    _noted = number
    signal.signal(number, signal.SIG_DFL)  # a second signal also interrupts compiled code


def _restore_handler(number: int) -> None:
    """Reinstall the handler that Python knows, which a library may have replaced since."""
    known = signal.getsignal(number)
    if known is not None and threading.current_thread() is threading.main_thread():
        signal.signal(number, known)


_restore_handler(signal.SIGPIPE)


@contextmanager
def postponed(comm: MPI.Intracomm) -> Iterator[None]:
    """Record signals during the block for `stop_together`. Collective. Handlers other than Python's
    defaults stay; only the main thread can handle signals."""
    taken = {}
    if threading.current_thread() is threading.main_thread():
        taken = {n: usual for n, usual in USUAL.items() if signal.getsignal(n) is usual}
    for number in taken:
        signal.signal(number, _note)
    try:
        yield
    finally:
        for number, usual in taken.items():
            signal.signal(number, usual)
    stop_together(comm)


def stop_together(comm: MPI.Intracomm) -> None:
    """Stop on all ranks if one of them has received a signal. Collective."""
    global _noted
    number = comm.allreduce(_noted, op=MPI.MAX)
    if number == 0:
        return
    _noted = 0
    if comm.rank == 0:
        logger.warning(
            "stopped by %s; files of the results are whole, and with Solver(..., resume=True) the "
            "next run continues from the last load step", signal.Signals(number).name,
        )  # fmt: skip
    if number == signal.SIGTERM:
        raise SystemExit(128 + number)
    raise KeyboardInterrupt
