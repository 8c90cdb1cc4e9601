"""Ctrl-C, and the signal by which batch systems end a job, in the middle of collective work.

A signal reaches each rank at another moment, or one rank only. An exception raised there and then
would leave the other ranks in a reduction for ever. So a signal is only noted while load steps are
computed; the reduction of each evaluation of the potential carries the notes of all ranks, and all
of them stop at the same one. A second signal ends the process at once.
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
from petsc4py import PETSc  # noqa: F401 (its handlers are there before they are replaced here)

logger = logging.getLogger("crms_fenicsx")

Handler = Callable[[int, FrameType | None], Any] | signal.Handlers

USUAL: dict[int, Handler] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""What is taken over, where nobody else has: signals and Python's own reaction to them."""

_noted = 0
"""The signal that has come; 0 if none. It belongs to the process, as handlers of signals do."""


def noted() -> bool:
    """Whether a signal has come on this rank that has not been obeyed yet."""
    return _noted != 0


def _note(number: int, frame: FrameType | None) -> None:
    global _noted
    _noted = number
    signal.signal(number, signal.SIG_DFL)  # the next one also ends what is in compiled code


def _restore_handler(number: int) -> None:
    """Give a signal the handler that Python knows, whatever a library has made of it since."""
    known = signal.getsignal(number)
    if known is not None and threading.current_thread() is threading.main_thread():
        signal.signal(number, known)


_restore_handler(signal.SIGPIPE)


@contextmanager
def postponed(comm: MPI.Intracomm) -> Iterator[None]:
    """Note signals in the block, for `stop_together`. Collective. Handlers that are not Python's
    own stay, and other threads than the main one have none."""
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
    """Stop on all ranks if one of them has been told to. Collective."""
    global _noted
    number = comm.allreduce(_noted, op=MPI.MAX)
    if number == 0:
        return
    _noted = 0
    if comm.rank == 0:
        logger.warning("stopped by %s", signal.Signals(number).name)
    if number == signal.SIGTERM:
        raise SystemExit(128 + number)
    raise KeyboardInterrupt
