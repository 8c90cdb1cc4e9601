"""Exceptions and warnings, and how an error of one rank is raised on all ranks."""

from __future__ import annotations

import atexit
import gc
import logging
import pickle
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc  # noqa: F401 (registers its exit handler before ours)

from crms_fenicsx.foundation.runtime.arrays import Array

PATIENCE = 60.0
"""Time a rank with an error waits for the other ranks to fail as well (s)."""
FAILED = 30081
"""Tag of the messages by which ranks announce an error to each other."""


class InputError(ValueError):
    """Invalid input; the message names the argument, its value and the remedy."""


class MeshError(InputError):
    """A mesh that is not an orientable triangulated surface."""


class PathError(InputError):
    """A cable path that cannot be laid on the membrane."""


class ConvergenceError(RuntimeError):
    """A load step did not reach equilibrium, even with the smallest load increment."""


class PathWarning(UserWarning):
    """A cable is blocked, lies where it cannot lie, or stays where its edge moves.

    A fold point has run into a mesh vertex, which blocks its path; `meshes.along` has made cells of
    small angles; a cable end has moved to the lower side of the membrane; or an edge moves under a
    cable end that has an anchor in space.
    """


class NetWarning(UserWarning):
    """A net that ends before the membrane's edge because its meshes would fold, or crossings
    without a clamp because their cables lie apart."""


class DoubtWarning(UserWarning):
    """An equilibrium of which some forces are known within a range only, which the warning gives.

    The mesh is too coarse there, or the forces are small beside the others of the scene.
    """


class FrictionWarning(UserWarning):
    """Friction forces of low accuracy.

    The paper's friction elements hold a cable, although the paper has no sticking; or the friction
    iteration does not converge, because a small change of the forces changes the state much.
    """


class PenaltyWarning(UserWarning):
    """A penalty factor outside the range in which folded elements are stable and do not lock."""


class PatternWarning(UserWarning):
    """Too few cells across a panel of a cutting pattern to compute its flat shape accurately."""


class SnapThroughWarning(UserWarning):
    """No path of stable equilibria connects a load step's state to the previous one.

    The structure has snapped through between them; the warning gives the loads.
    """


class InstabilityWarning(UserWarning):
    """An unstable equilibrium: the structure leaves it under the smallest disturbance."""


class PondWarning(InstabilityWarning):
    """An unstable equilibrium of a ponded membrane: water would keep accumulating."""


class PictureWarning(UserWarning):
    """A mesh too large for a picture, which one process draws from the whole mesh."""


def show_warnings() -> None:
    """Let Python show warnings again if FFCx has redirected them to a log without handlers."""
    logger: logging.Logger | None = logging.getLogger("py.warnings")
    while logger is not None:
        if any(not isinstance(one, logging.NullHandler) for one in logger.handlers):
            return
        logger = logger.parent
    logging.captureWarnings(False)


def as_text(position: Sequence[float] | Array) -> str:
    """Format a position for messages, with rounding errors of zero shown as zero."""
    least = 1e-12 * max(map(abs, position))
    return "(" + ", ".join(f"{x if abs(x) > least else 0.0:.6g}" for x in position) + ")"


@contextmanager
def raised_together(comm: MPI.Intracomm) -> Iterator[None]:
    """Raise an exception of the block, on any rank, on all ranks of `comm`: that of the lowest rank
    that has one. The block must not communicate, as a rank may leave it early."""
    error: Exception | None = None
    try:
        yield
    except Exception as exception:  # raised below, on all ranks
        error = exception
    failed = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failed == comm.size:
        return
    if comm.size > 1:
        kind, text = comm.bcast(_kind_and_text(error) if comm.rank == failed else None, failed)
        if comm.rank != failed:
            try:
                passed_on = kind(text)
            except TypeError:  # its constructor takes more than a text, as for codec errors
                passed_on = RuntimeError(f"{kind.__name__}: {text}")
            passed_on.on_all_ranks = True
            raise passed_on from None  # this rank's own error is usually the same
    if error is not None:
        error.on_all_ranks = True  # type: ignore[attr-defined]
        raise error


def _kind_and_text(error: Exception | None) -> tuple[type[Exception], str]:
    """Type and text from which another rank can build the same error."""
    kind, text = type(error or RuntimeError()), str(error)
    try:
        pickle.dumps(kind)
    except Exception:  # the class exists on this rank only, such as one local to a function
        return RuntimeError, f"{kind.__name__}: {text}"
    return kind, text


@contextmanager
def garbage_kept() -> Iterator[None]:
    """Collect no garbage in a block where many small objects are made and kept, through which each
    collection would walk, or where an exception of a callback may pass through PETSc: Python may
    start a collection while petsc4py formats its traceback, and crashes in a destructor that runs
    with the exception set."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def all_failed(comm: MPI.Intracomm) -> bool:
    """Whether all ranks arrive here with an error within `PATIENCE` seconds."""
    # Point-to-point messages: a collective operation would match those of the other ranks.
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
    """Print an error that occurred on this rank only, and abort all ranks."""
    print(
        f"{error}\n{where}: this was raised on rank {comm.rank} of {comm.size}, and not on all "
        f"ranks within {PATIENCE:g} seconds; all ranks are ended.",
        file=sys.stderr,
        flush=True,
    )
    comm.Abort(1)


def _abort_after_an_error() -> None:
    """Let `python -m mpi4py` abort all ranks when the program has failed on one, as it promises. It
    does so only at exit, after PETSc's finalization, which waits for all ranks."""
    failed = getattr(sys, "last_value", None) is not None
    if failed and "mpi4py.run" in sys.modules and MPI.COMM_WORLD.size > 1:
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)


atexit.register(_abort_after_an_error)
