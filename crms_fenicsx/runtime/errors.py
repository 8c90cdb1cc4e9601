"""Errors that name the thing, its value and the remedy, and reach all ranks together."""

from __future__ import annotations

import atexit
import functools
import logging
import pickle
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, cast

from mpi4py import MPI
from petsc4py import PETSc  # noqa: F401 (its end is registered before what is registered here)

from crms_fenicsx.runtime.arrays import Array

PATIENCE = 60.0
"""Seconds for which a rank with an error waits for the others to have one as well."""
FAILED = 30081
"""Tag of the messages by which ranks tell each other that they have an error."""


Method = TypeVar("Method", bound=Callable[..., Any])


class InputError(ValueError):
    """Something the user gave cannot be used: says what, its value and what to do."""


class MeshError(InputError):
    """A mesh that is no orientable triangulated surface."""


class PathError(InputError):
    """A cable path that cannot be laid on the membrane."""


class ConvergenceError(RuntimeError):
    """A load step did not reach equilibrium, however small its increment was made."""


class PathWarning(UserWarning):
    """A cable is where it cannot go on, or cannot be.

    A fold point has run into a mesh vertex, where its path is blocked; or an end has come to lie
    under the membrane.
    """


class NetWarning(UserWarning):
    """A net that ends before the membrane does, as its meshes would fold, or crossings without a
    clamp, as cables lie apart there."""


class FrictionWarning(UserWarning):
    """Friction forces that are crude.

    Those of the paper's law have pushed a cable back, as sticking is beyond it; or forces went
    round in circles, as the state answers a small change of them by a large one.
    """


class PenaltyWarning(UserWarning):
    """A penalty factor outside the range in which folded elements are stable and do not lock."""


class PatternWarning(UserWarning):
    """Too few cells across a piece of a cutting pattern to know its flat shape well."""


class SnapThroughWarning(UserWarning):
    """No stable equilibria connect a load step's state to the one before.

    Between them the structure has fallen, or been turned inside out. The warning says at which
    loads.
    """


class InstabilityWarning(UserWarning):
    """An equilibrium that is not stable: the least disturbance makes the structure leave it."""


class PondWarning(InstabilityWarning):
    """Water on a membrane in an equilibrium that is not stable: it would gather on."""


class PictureWarning(UserWarning):
    """A mesh too large for a picture, which one process draws from all of it."""


def show_warnings() -> None:
    """Let Python show warnings again, which FFCx has sent to a log when nobody reads it."""
    logger: logging.Logger | None = logging.getLogger("py.warnings")
    while logger is not None:
        if any(not isinstance(one, logging.NullHandler) for one in logger.handlers):
            return
        logger = logger.parent
    logging.captureWarnings(False)


def as_text(position: Sequence[float] | Array) -> str:
    """A place as messages show it: what rounding has left of a zero is one."""
    least = 1e-12 * max(map(abs, position))
    return "(" + ", ".join(f"{x if abs(x) > least else 0.0:.6g}" for x in position) + ")"


@contextmanager
def raised_together(comm: MPI.Intracomm) -> Iterator[None]:
    """Let an exception in the block on any rank be raised on all ranks of `comm`. The block must
    not communicate, so that a rank that leaves it early keeps nobody waiting. Every rank raises the
    error of the lowest rank that has one."""
    error: Exception | None = None
    try:
        yield
    except Exception as exception:  # passed on below, on all ranks
        error = exception
    failed = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failed == comm.size:
        return
    if comm.size > 1:
        kind, text = comm.bcast(_kind_and_text(error) if comm.rank == failed else None, failed)
        if comm.rank != failed:
            try:
                passed_on = kind(text)
            except TypeError:  # made of more than a text, as errors of codecs are
                passed_on = RuntimeError(f"{kind.__name__}: {text}")
            raise passed_on from None  # its own, if it has one, is most often the same
    if error is not None:
        raise error


def _kind_and_text(error: Exception | None) -> tuple[type[Exception], str]:
    """What makes the same error on another rank."""
    kind, text = type(error or RuntimeError()), str(error)
    try:
        pickle.dumps(kind)
    except Exception:  # of a class that is known here only, as one inside of a function
        return RuntimeError, f"{kind.__name__}: {text}"
    return kind, text


def collective(method: Method) -> Method:
    """Let no rank wait for ever in a method that another one has left with an error. The errors of
    this package are raised on all ranks. A bug, a lack of memory or an interrupt may strike one
    rank alone, while the others are in a reduction that it will never reach. So a rank with an
    error waits for the others to have one too, for `PATIENCE` seconds, and if they do not it prints
    its traceback and ends all ranks."""

    @functools.wraps(method)
    def guarded(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True  # IPython and pytest leave this call out of tracebacks
        try:
            return method(*args, **kwargs)
        except BaseException as error:
            # A collective method that is called by another one has asked already. What has no
            # ranks is no object of the kind: an argument that was refused.
            comm: Any = getattr(next(iter((*args, *kwargs.values())), None), "comm", None)
            if not getattr(error, "on_all_ranks", comm is None):
                if not all_failed(comm):
                    end_all(comm, traceback.format_exc(), method.__qualname__)
                error.on_all_ranks = True  # type: ignore[attr-defined]
            raise

    return cast(Method, guarded)


def all_failed(comm: MPI.Intracomm) -> bool:
    """Whether all ranks come here, because of an error, within `PATIENCE` seconds."""
    # Messages between two ranks, as a collective operation would meet those of the others.
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    nothing: Any = [None, 0, MPI.BYTE]
    requests = [comm.Isend(nothing, rank, FAILED) for rank in others]
    requests += [comm.Irecv(nothing, rank, FAILED) for rank in others]
    deadline, pause = time.monotonic() + PATIENCE, 1e-4
    while not MPI.Request.Testall(requests):
        if time.monotonic() > deadline:
            return False
        time.sleep(pause)
        pause = min(2 * pause, 0.1)
    return True


def end_all(comm: MPI.Intracomm, error: str, where: str) -> None:
    """Print an error that one rank alone has had somewhere, and end all ranks."""
    print(
        f"{error}\n{where}: this was raised on rank {comm.rank} of {comm.size}, and not on all "
        f"ranks within {PATIENCE:g} seconds; all ranks are ended.",
        file=sys.stderr,
        flush=True,
    )
    comm.Abort(1)


def _abort_after_an_error() -> None:
    """Let `python -m mpi4py` end all ranks when the program has failed on one, as it promises. It
    does so at the very end, and PETSc's own end, which comes before, waits for all ranks."""
    failed = getattr(sys, "last_value", None) is not None
    if failed and "mpi4py.run" in sys.modules and MPI.COMM_WORLD.size > 1:
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)


atexit.register(_abort_after_an_error)
