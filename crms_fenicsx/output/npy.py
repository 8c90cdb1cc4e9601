"""Arrays in numpy's format (.npy) whose rows are spread over the ranks.

Rows have global ids, so that any number of ranks can write them and any other read them. Nobody has
the whole array: for writing, each rank is sent the rows of its slab of ids.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx.output.shared_file import write_together
from crms_fenicsx.runtime.arrays import Integers
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import readable, size_of_file

Rows = npt.NDArray[Any]

HEADER = 128
"""Bytes before the numbers."""

FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""An odd number whose multiples look random."""


def write_rows(path: Path, comm: MPI.Intracomm, ids: Integers, values: Rows, total: int) -> str:
    """Write an array to which every rank has some rows. Collective.

    Parameters
    ----------
    path
        The file; its folder exists.
    comm
        Its ranks write together.
    ids : (n,)
        Which rows of the file this rank has, from 0 to total - 1, in any order.
    values : (n,) or (n, c)
        The rows. Those of the same id add up; those that nobody has are zero.
    total
        Number of rows of the file.

    Returns
    -------
    The file's `digest`.

    Raises
    ------
    InputError
        On all ranks, when the file cannot be written.
    """
    rows = values.astype(values.dtype.newbyteorder("<"), copy=False)
    shape = (total, *rows.shape[1:])
    slab = max(-(-total // comm.size), 1)
    first, last = (min(rank * slab, total) for rank in (comm.rank, comm.rank + 1))
    order = np.argsort(ids, kind="stable")
    own = np.zeros((last - first, *shape[1:]), dtype=rows.dtype)
    counts = np.bincount(ids // slab, minlength=comm.size)
    their_ids, their_rows = (_sent(part[order], counts, comm) for part in (ids, rows))
    np.add.at(own, their_ids - first, their_rows)

    text = _header(rows.dtype, shape)
    row_size = rows.dtype.itemsize * int(np.prod(shape[1:]))
    parts = [(len(text) + first * row_size, own)]
    if comm.rank == 0:
        parts.append((0, np.frombuffer(text, dtype=np.uint8)))
    write_together(path, comm, len(text) + total * row_size, parts)
    return digest(comm, first + np.arange(last - first), own)


def _header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    """How a file of version 1.0 begins: the same bytes for the same type and shape."""
    text = repr({"descr": dtype.str, "fortran_order": False, "shape": shape})
    return b"\x93NUMPY\x01\x00\x76\x00" + text.ljust(HEADER - 11).encode() + b"\n"


def digest(comm: MPI.Intracomm, ids: Integers, values: Rows) -> str:
    """A number of an array that another one hardly has, from the rows of all ranks. Collective.

    Parameters
    ----------
    comm
        Its ranks have each row once.
    ids : (n,)
        This rank's rows.
    values : (n,) or (n, c)
        What they hold.
    """
    columns = np.ascontiguousarray(values.reshape(len(values), int(np.prod(values.shape[1:]))))
    words = columns.view(np.uint64) if columns.dtype.itemsize == 8 else columns.astype(np.uint64)
    numbers = np.zeros(len(ids), dtype=np.uint64)
    for column in (ids.astype(np.uint64), *words.T):
        numbers = (numbers ^ column) * FACTOR
        numbers ^= numbers >> np.uint64(29)
    return f"{comm.allreduce(int(numbers.sum())) % 2**64:016x}"


def _sent(rows: Rows, counts: Integers, comm: MPI.Intracomm) -> Rows:
    """Send each rank its share of the rows, one share after the other; return what has come."""
    coming = np.zeros_like(counts)
    comm.Alltoall(counts, coming)
    received = np.zeros((int(coming.sum()), *rows.shape[1:]), dtype=rows.dtype)
    row = MPI.BYTE.Create_contiguous(rows.dtype.itemsize * int(np.prod(rows.shape[1:]))).Commit()
    comm.Alltoallv([np.ascontiguousarray(rows), counts, row], [received, coming, row])
    row.Free()
    return received


def read_rows(
    path: Path,
    comm: MPI.Intracomm,
    ids: Integers | None,
    dtype: npt.DTypeLike,
    shape: tuple[int, ...],
    due: str,
    owned: int | None = None,
) -> Rows:
    """Read some rows of an array. Collective, for errors.

    Parameters
    ----------
    path
        The file.
    comm
        Its ranks read together, each its own rows.
    ids : (n,)
        Which rows; None: all.
    dtype, shape
        Those of the whole array; a file with others is not read.
    due
        The `digest` that the file has if it is as it was written.
    owned
        How many rows, the first ones, this rank owns: each is owned by one rank. None: all.

    Returns
    -------
    (n, ...)

    Raises
    ------
    InputError
        On all ranks: the file is missing, or not what it should be.
    """
    on_disk = np.dtype(dtype).newbyteorder("<")
    found: Rows = np.zeros((0, *shape[1:]), dtype=on_disk)
    with raised_together(comm):
        start = _checked(path, on_disk, shape)
        if shape[0] > 0:  # an empty file cannot be mapped
            whole = np.memmap(path, on_disk, "r", start, shape)
            found = np.array(whole if ids is None else whole[ids])
    if ids is None:  # all ranks have all
        has = digest(MPI.COMM_SELF, np.arange(len(found)), found)
    else:
        has = digest(comm, ids[:owned], found[:owned])
    with raised_together(comm):
        if has != due:
            raise InputError(
                f"{path} is damaged: its numbers are not those that were written; take another "
                "checkpoint"
            )
    return found.astype(dtype)


def _checked(path: Path, dtype: np.dtype[Any], shape: tuple[int, ...]) -> int:
    """Where the numbers begin in a file that has the type and shape wanted (bytes).

    Nothing that it says of itself is interpreted: it begins with what was written, or is refused.
    """
    header = _header(dtype, shape)
    with readable(path, "give a checkpoint that is complete"):
        size = size_of_file(path)
        with open(path, "rb") as file:
            begins = file.read(HEADER)
    if begins != header:
        raise InputError(
            f"{path} is damaged: it does not begin like numbers of type {dtype} and shape {shape}; "
            "take another checkpoint"
        )
    wanted = HEADER + dtype.itemsize * math.prod(shape)
    if size != wanted:
        raise InputError(
            f"{path} is damaged: it has {size} bytes instead of {wanted}; take another checkpoint"
        )
    return HEADER
