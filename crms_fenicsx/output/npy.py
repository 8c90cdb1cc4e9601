"""Arrays in numpy's format (.npy) whose rows are spread over the ranks.

Rows have global ids, so that any number of ranks can write them and any other read them. The first
rank has the whole array while it writes or reads the file.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx.runtime.arrays import Integers
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.runtime.files import readable, replaced, size_of_file

Rows = npt.NDArray[Any]

HEADER = 128
"""Bytes before the numbers."""

FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""An odd number whose multiples look random."""


def write_rows(path: Path, comm: MPI.Intracomm, ids: Integers, values: Rows, total: int) -> str:
    """Write an array of which every rank has some rows. Collective.

    Shapes: ids (n,), values (n,). Returns the file's `digest`.
    """
    parts, found = comm.gather((ids, values)), ""
    with raised_together(comm):
        if parts is not None:
            whole = np.zeros((total, *values.shape[1:]), dtype=values.dtype.newbyteorder("<"))
            for rows, own in parts:
                np.add.at(whole, rows, own)
            with replaced(path) as partial, open(partial, "wb") as file:
                file.write(_header(whole.dtype, whole.shape))
                file.write(whole.data if whole.size else b"")
            found = digest(MPI.COMM_SELF, np.arange(total), whole)
    return comm.bcast(found)


def _header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    """How a file of version 1.0 begins: the same bytes for the same type and shape."""
    text = repr({"descr": dtype.str, "fortran_order": False, "shape": shape})
    return b"\x93NUMPY\x01\x00\x76\x00" + text.ljust(HEADER - 11).encode() + b"\n"


def digest(comm: MPI.Intracomm, ids: Integers, values: Rows) -> str:
    """A number of an array that another one hardly has, from the rows of all ranks. Collective.

    Shapes: ids (n,), values (n,).
    """
    columns = np.ascontiguousarray(values.reshape(len(values), int(np.prod(values.shape[1:]))))
    words = columns.view(np.uint64) if columns.dtype.itemsize == 8 else columns.astype(np.uint64)
    numbers = np.zeros(len(ids), dtype=np.uint64)
    for column in (ids.astype(np.uint64), *words.T):
        numbers = (numbers ^ column) * FACTOR
        numbers ^= numbers >> np.uint64(29)
    return f"{comm.allreduce(int(numbers.sum())) % 2**64:016x}"


def read_rows(
    path: Path,
    comm: MPI.Intracomm,
    ids: Integers | None,
    dtype: npt.DTypeLike,
    shape: tuple[int, ...],
    due: str,
) -> Rows:
    """Read some rows of an array. Collective.

    Shapes: ids (n,). Returns (n, ...).
    """
    wanted, parts = comm.gather(ids), None
    with raised_together(comm):
        if wanted is not None:
            whole = _checked(path, np.dtype(dtype).newbyteorder("<"), shape, due).astype(dtype)
            parts = [whole if rows is None else whole[rows] for rows in wanted]
    return comm.scatter(parts)


def _checked(path: Path, dtype: np.dtype[Any], shape: tuple[int, ...], due: str) -> Rows:
    """Read an array of the type, shape and `digest` wanted, or raise `InputError`.

    Nothing that the file says of itself is interpreted: it begins as it was written, or is refused.
    """
    wrong, size = "", HEADER + dtype.itemsize * math.prod(shape)
    with readable(path, "give a checkpoint that is complete"):
        found = size_of_file(path)
        with open(path, "rb") as file:
            if file.read(HEADER) != _header(dtype, shape):
                wrong = f"it does not begin like numbers of type {dtype} and shape {shape}"
            elif found != size:
                wrong = f"it has {found} bytes instead of {size}"
            else:
                values = np.fromfile(file, dtype).reshape(shape)
    if not wrong and digest(MPI.COMM_SELF, np.arange(len(values)), values) != due:
        wrong = "its numbers are not those that were written"
    if wrong:
        raise InputError(f"{path} is damaged: {wrong}; take another checkpoint")
    return values
