"""Files that all ranks write at once, each its own parts, so that nothing is gathered."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.runtime.errors import raised_together
from crms_fenicsx.runtime.files import explained, forget, partial_of

SLAB = 2**30
"""Most bytes that one call writes, as MPI counts them in 32 bits."""

Part = tuple[int, NDArray[Any]]
"""Where in a file, in bytes from its beginning, an array goes."""


def write_together(path: Path, comm: MPI.Intracomm, size: int, parts: Sequence[Part]) -> None:
    """Write a file of which every rank has some parts. Collective.

    It takes the place of `path` when it is complete. Ranks write independently of each other, as
    each has few parts, long ones: MPI's collective writing would gain nothing, and waits forever
    for a rank whose disk is full.
    """
    partial = partial_of(path)
    try:
        with raised_together(comm), explained(path):
            if comm.rank == 0:
                with open(partial, "wb") as new:
                    new.truncate(size)
        with raised_together(comm), explained(path), _as_system_error(path):
            file = MPI.File.Open(comm, os.fspath(partial), MPI.MODE_WRONLY)
        try:
            with raised_together(comm), explained(path), _as_system_error(path):
                for offset, array in parts:
                    _write(file, offset, array)
            with raised_together(comm), explained(path), _as_system_error(path):
                file.Sync()  # now it is on the disk
        finally:
            file.Close()
        with raised_together(comm), explained(path):
            if comm.rank == 0:
                os.replace(partial, path)
    except BaseException:
        if comm.rank == 0:
            forget(partial)
        raise


def first_row(count: int, comm: MPI.Intracomm) -> tuple[int, int]:
    """Number of this rank's first row, if the ranks' rows follow each other. Collective.

    Returns first: how many rows the ranks before this one have; total: how many all have.
    """
    before = comm.exscan(count)
    return (0 if before is None else int(before)), int(comm.allreduce(count))


def _write(file: MPI.File, offset: int, array: NDArray[Any]) -> None:
    left = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    while len(left):
        now = min(len(left), SLAB)
        file.Write_at(offset, [left[:now], MPI.BYTE])
        left, offset = left[now:], offset + now


@contextmanager
def _as_system_error(path: Path) -> Iterator[None]:
    """Let an error of MPI be one of the system, of which MPI does not tell the reason."""
    try:
        yield
    except MPI.Exception as error:
        disk = os.statvfs(path.parent)
        free = disk.f_bavail * disk.f_frsize
        raise OSError(f"{error}; the disk has {free} bytes left") from error
