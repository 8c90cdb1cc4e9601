"""Errors that name the thing, its value and the remedy, and reach all ranks together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI


class InputError(ValueError):
    """Something the user gave cannot be used: says what, its value and what to do."""


class MeshError(InputError):
    """A mesh that is no orientable triangulated surface."""


class PathError(InputError):
    """A cable path that cannot be laid on the membrane."""


class ConvergenceError(RuntimeError):
    """A load step did not reach equilibrium, however small its increment was made."""


class PathWarning(UserWarning):
    """A cable's fold point has run into a mesh vertex: its path is blocked there."""


class FrictionWarning(UserWarning):
    """Friction with the paper's law has pushed a cable back: a cable that sticks is beyond it."""


class PenaltyWarning(UserWarning):
    """A penalty factor outside the range in which folded elements are stable and do not lock."""


class PictureWarning(UserWarning):
    """A mesh too large for a picture, which one process draws from all of it."""


@contextmanager
def raised_together(comm: MPI.Intracomm) -> Iterator[None]:
    """Let an exception in the block on any rank be raised on all ranks of `comm`.

    The block must not communicate, so that a rank that leaves it early keeps nobody waiting.
    Every rank raises the error of the lowest rank that has one.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as exception:  # passed on below, on all ranks
        error = exception
    failed = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failed == comm.size:
        return
    if comm.size > 1:
        kind, text = comm.bcast(
            (type(error), str(error)) if comm.rank == failed else None, root=failed
        )
        if comm.rank != failed:
            try:
                passed_on = kind(text)
            except TypeError:  # made of more than a text, as errors of codecs are
                passed_on = RuntimeError(f"{kind.__name__}: {text}")
            raise passed_on
    if error is not None:
        raise error
