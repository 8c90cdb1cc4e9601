"""Atomic writing of files: a file is complete whenever the run is killed."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import InputError, raised_together

PARTIAL = ".partial-"
"""Prefix of a file being written; its suffix stays, as that selects the format."""


def partial_of(path: Path) -> Path:
    """Path under which a file or folder is written before it replaces `path`."""
    return path.with_name(PARTIAL + path.name)


def absolute(path: str | Path, comm: MPI.Intracomm) -> Path:
    """Rank 0's absolute path, fixed now even if the run changes its folder later. Collective."""
    with raised_together(comm), explained(Path(path)):
        path = Path(path).absolute()
    return Path(comm.bcast(path))


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn write errors of the block into an `InputError` that names `path`."""
    try:
        yield
    except OSError as error:
        remedy = (
            "its folder was removed; restore it or use another folder"
            if error.errno == errno.ENOENT
            else "free some space or use another folder"
        )
        why = error.strerror or error
        raise InputError(f"{path} cannot be written ({why}); {remedy}.") from None


@contextmanager
def readable(what: object, remedy: str) -> Iterator[None]:
    """Turn read errors of the block into an `InputError` that names `what`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{what} cannot be read ({error.strerror or error}); {remedy}.") from None


LARGEST_TEXT = 2**30
"""Size limit of text files to be read (bytes)."""


def size_of_file(path: Path) -> int:
    """Size of a regular file (bytes)."""
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    return status.st_size


def read_text(path: Path) -> bytes:
    """Read a text file of at most `LARGEST_TEXT` bytes."""
    size = size_of_file(path)
    if size > LARGEST_TEXT:
        raise OSError(errno.EFBIG, f"it has {size} bytes, more than {LARGEST_TEXT}")
    return path.read_bytes()


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` to write to; the file replaces `path` when complete."""
    partial = partial_of(path)
    try:
        with explained(path):
            yield partial
            flush(partial)
            os.replace(partial, path)
    except BaseException:
        forget(partial)
        raise


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def make_writable(folder: Path) -> None:
    """Create a folder if it is missing, and test that it is writable."""
    trial = folder / (PARTIAL + "trial")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink(missing_ok=True)  # another process may test at the same time
    except OSError as error:
        raise InputError(
            f"the folder {folder} cannot be written ({error.strerror or error}); "
            "use another one, or make it writable."
        ) from None


DXF_UNITS = {"mm": 4, "cm": 5, "m": 6, "in": 1, "ft": 2}
"""DXF codes of the units of length of written drawings."""


def dxf_library(call: str, instead: str = "") -> Any:
    """Import ezdxf, or raise an error that says how to install it and what to do without."""
    try:
        return import_module("ezdxf")
    except ImportError:
        raise ImportError(
            f"{call} needs ezdxf; install it (pip install ezdxf; Debian: python3-ezdxf)"
            f"{instead and ', or '}{instead}."
        ) from None


def new_drawing(call: str, unit: str, instead: str) -> Any:
    """A DXF document of ezdxf."""
    return dxf_library(call, instead).new("R2010", units=DXF_UNITS[unit])


def forget(partial: Path) -> None:
    """Remove an incomplete file."""
    try:
        partial.unlink(missing_ok=True)
    except OSError:  # the error that led here says more
        pass
