"""Files of a checkpoint: a folder that is replaced as a whole, and arrays (.npy) in it.

A complete folder exists whenever the run is killed. The new folder is written beside the old one;
then the old one is moved aside, the new one takes its place, and the old one is deleted. A run
killed between the two moves leaves the old one aside.

Rows of arrays have global ids. Any number of ranks can write an array's rows and any other number
read them. The first rank holds the whole array meanwhile.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.arrays import Integers
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import (
    explained,
    flush,
    make_writable,
    partial_of,
    readable,
    replaced,
    size_of_file,
)

ASIDE = ".old-"
"""Prefix of a folder that is being replaced."""


def _aside(folder: Path) -> Path:
    return folder.with_name(ASIDE + folder.name)


def complete(folder: Path) -> Path:
    """The folder, or the one set aside if a run was killed while replacing it."""
    return _aside(folder) if _aside(folder).exists() and not folder.exists() else folder


@contextmanager
def replaced_folder(folder: Path, comm: MPI.Intracomm, mark: str) -> Iterator[Path]:
    """Yield a folder to fill, then put it in the place of `folder`, `mark` last. Collective."""
    partial, aside = partial_of(folder), _aside(folder)
    with raised_together(comm), explained(folder):
        if comm.rank == 0:
            make_writable(folder.parent)
            if aside.exists() and not folder.exists():
                os.replace(aside, folder)
            holds = not folder.is_dir() or any(folder.iterdir())
            if folder.exists() and not (folder / mark).exists() and holds:
                raise InputError(f"{folder} is not a checkpoint; use another folder.")
            for rest in (partial, aside):
                if rest.exists():
                    shutil.rmtree(rest)
            partial.mkdir()
    try:
        yield partial
        with raised_together(comm), explained(folder):
            if comm.rank == 0:
                flush(partial / mark)
                flush(partial)
                if folder.exists():
                    os.replace(folder, aside)
                try:
                    os.replace(partial, folder)
                except OSError:
                    if aside.exists():
                        os.replace(aside, folder)
                    raise
                flush(folder.parent)
                shutil.rmtree(aside, ignore_errors=True)  # else the next call does
    except BaseException:
        if comm.rank == 0:
            shutil.rmtree(partial, ignore_errors=True)
        raise


Rows = npt.NDArray[Any]


def write_rows(path: Path, comm: MPI.Intracomm, ids: Integers, values: Rows, total: int) -> str:
    """Write an array from all ranks' rows `ids` (n,); returns its digest. Collective."""
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
    """Header of an .npy file of version 1.0: equal bytes for equal type and shape."""
    text = repr({"descr": dtype.str, "fortran_order": False, "shape": shape})
    return b"\x93NUMPY\x01\x00\x76\x00" + text.ljust(117).encode() + b"\n"


def digest(comm: MPI.Intracomm, ids: Integers, values: Rows) -> str:
    """Checksum of all ranks' rows (n, ...), independent of their distribution. Collective."""
    columns = np.ascontiguousarray(values.reshape(len(values), int(np.prod(values.shape[1:]))))
    words = columns.view(np.uint64) if columns.dtype.itemsize == 8 else columns.astype(np.uint64)
    numbers = np.zeros(len(ids), dtype=np.uint64)
    for column in (ids.astype(np.uint64), *words.T):
        numbers = (numbers ^ column) * np.uint64(0x9E3779B97F4A7C15)  # golden ratio
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
    """Read rows `ids` (n,) of an array, (n, ...), or all rows for None. Collective."""
    wanted, parts = comm.gather(ids), None
    with raised_together(comm):
        if wanted is not None:
            whole = _checked(path, np.dtype(dtype).newbyteorder("<"), shape, due).astype(dtype)
            parts = [whole if rows is None else whole[rows] for rows in wanted]
    return comm.scatter(parts)


def _checked(path: Path, dtype: np.dtype[Any], shape: tuple[int, ...], due: str) -> Rows:
    """Read an array of given type, shape and digest; raises `InputError` otherwise."""
    head, values = _header(dtype, shape), np.zeros(0, dtype)
    with readable(path, "pass a checkpoint that is complete"):
        size_of_file(path)  # refuses what is not a file
        with open(path, "rb") as file:
            if file.read(len(head)) == head:
                values = np.fromfile(file, dtype)
    whole = values.reshape(shape) if values.size == math.prod(shape) else None
    if whole is None or digest(MPI.COMM_SELF, np.arange(len(whole)), whole) != due:
        raise InputError(
            f"{path} is damaged: its numbers of shape {shape} are not those that were written; "
            "use another checkpoint."
        )
    return whole
