"""Limits for one point of a sweep: number of evaluations, and wall time."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crms_fenicsx.energy.minimization.potential import Potential


class Hang(BaseException):
    """A point takes more than it may. No `Exception`, so that nothing takes it for an error."""


@contextmanager
def bounded(evaluations: int, seconds: float) -> Iterator[None]:
    """Raise `Hang` in the block once it has taken more than either; for the main thread.

    Parameters
    ----------
    evaluations
        Evaluations of energy and forces by all solvers together.
    seconds
        Wall time, for what evaluates nothing.
    """
    sum_up, spent = Potential.sum_up, 0  # each evaluation begins with it

    def counted(self: Potential) -> None:
        nonlocal spent
        spent += 1
        if spent > evaluations:
            raise Hang(f"more than {evaluations} evaluations")
        sum_up(self)

    def out_of_time(number: int, frame: Any) -> None:
        raise Hang(f"more than {seconds:g} s")

    Potential.sum_up = counted  # type: ignore[method-assign]
    before = signal.signal(signal.SIGALRM, out_of_time)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        Potential.sum_up = sum_up  # type: ignore[method-assign]
