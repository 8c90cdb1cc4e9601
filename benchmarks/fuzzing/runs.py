"""Runs random scenes and their twins."""

from __future__ import annotations

import logging
import signal
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from mpi4py import MPI

from crms_fenicsx.foundation.runtime import errors
from fuzzing.checks import Result, empty, kind_of, scenario, taylor, watched
from fuzzing.scenes import SceneData
from fuzzing.twins import twin

SECONDS = 30
"""Time of the processor after which a scene, with its twin, counts as hanging; one of many features
and each of its twins have twice as much."""
WARNINGS = (
    errors.DoubtWarning, errors.FrictionWarning, errors.PathWarning, errors.PenaltyWarning,
    errors.SnapThroughWarning,
)  # fmt: skip


class HangError(Exception):
    """A scene has taken too long."""


@contextmanager
def limited(seconds: int, spent: float = 0.0) -> Iterator[None]:
    """Raise a `HangError` when something takes too long, with what has been spent before."""

    def ring(*_: object) -> None:
        raise HangError(f"more than {seconds} s")

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, max(seconds - spent, 0.01))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def run(data: SceneData, comm: MPI.Intracomm = MPI.COMM_WORLD, ranks: Any = None) -> Result:
    """Run a scene and its twins. Collective."""
    began, result = time.process_time(), empty(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for own in WARNINGS if data.ambiguous else (*WARNINGS, errors.InstabilityWarning):
            warnings.simplefilter("ignore", own)
        for name in ("", *data.twins):
            go_on = attempt(name, data, comm, result, ranks)
            result.seconds = time.process_time() - began
            if not go_on:
                break
    if result.problems:
        result.outcome = "failed"
    return result


def attempt(name: str, data: SceneData, comm: MPI.Intracomm, result: Result, ranks: Any) -> bool:
    """Run a scene itself or a twin; whether twins can be run."""
    limits = (SECONDS, result.seconds) if data.ambiguous else (2 * SECONDS, 0.0)
    try:
        with limited(*limits), watched(result) if data.ambiguous else nullcontext():
            if name:
                twin(name, data, comm, result)
                return True
            with scenario(data, comm, result, ranks=ranks) as world:
                if not data.ambiguous:
                    taylor(world, result)
            return True
    except (errors.InputError, errors.ConvergenceError) as error:
        if not name:
            result.outcome, result.text = "refused", kind_of(error)
        elif data.ambiguous:
            result.notes.append(f"{name}: refused, {kind_of(error)}")
        else:
            result.problems.append(f"{name}: refused, {str(error)[:300]}")
    except Exception as error:
        logging.getLogger("crms_fenicsx").debug("%s", error, exc_info=True)
        where = traceback.extract_tb(error.__traceback__)[-1]
        result.problems.append(
            f"{name}: {type(error).__name__}: {str(error)[:300]} "
            f"({Path(where.filename).name}:{where.lineno})"
        )
    return name != ""
