"""Arrays in numpy's format (.npy) whose rows are spread over the ranks.

Rows have global ids, so that any number of ranks can write them and any other read them. Nobody has
the whole array: for writing, each rank is sent the rows of its slab of ids.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx.errors import InputError, raised_together
from crms_fenicsx.output.files import readable
from crms_fenicsx.output.shared_file import write_together

Integers = npt.NDArray[np.int64]
Rows = npt.NDArray[Any]


def write_rows(path: Path, comm: MPI.Intracomm, ids: Integers, values: Rows, total: int) -> None:
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

    head = io.BytesIO()
    header = {"descr": rows.dtype.str, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, header)
    text = np.frombuffer(head.getvalue(), dtype=np.uint8)
    row_size = rows.dtype.itemsize * int(np.prod(shape[1:]))
    parts = [(len(text) + first * row_size, own)]
    if comm.rank == 0:
        parts.append((0, text))
    write_together(path, comm, len(text) + total * row_size, parts)


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

    Returns
    -------
    (n, ...)

    Raises
    ------
    InputError
        On all ranks: the file is missing, or not what it should be.
    """
    on_disk = np.dtype(dtype).newbyteorder("<")
    found: Rows = np.zeros((0, *shape[1:]), dtype=dtype)
    with raised_together(comm):
        start = _checked(path, on_disk, shape)
        if shape[0] > 0:  # an empty file cannot be mapped
            whole = np.memmap(path, on_disk, "r", start, shape)
            found = np.array(whole if ids is None else whole[ids], dtype=dtype)
    return found


def _checked(path: Path, dtype: np.dtype[Any], shape: tuple[int, ...]) -> int:
    """Where the numbers begin in a file that has the type and shape wanted (bytes)."""
    with readable(path, "give a checkpoint that is complete"), open(path, "rb") as file:
        try:
            version = np.lib.format.read_magic(file)
            if version != (1, 0):
                raise ValueError(f"it is of version {version}")
            has_shape, by_columns, has_type = np.lib.format.read_array_header_1_0(file)
        except ValueError as error:
            raise InputError(f"{path} is damaged ({error}); take another checkpoint") from error
        start, size = file.tell(), os.fstat(file.fileno()).st_size
    if (has_shape, by_columns, has_type) != (shape, False, dtype):
        raise InputError(
            f"{path} holds numbers of type {has_type} and shape {has_shape} instead of {dtype} and "
            f"{shape}; take another checkpoint"
        )
    wanted = start + dtype.itemsize * int(np.prod(shape))
    if size != wanted:
        raise InputError(
            f"{path} is damaged: it has {size} bytes instead of {wanted}; take another checkpoint"
        )
    return start
