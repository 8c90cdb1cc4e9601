"""Files that are complete at any moment, whenever the run is killed."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

from crms_fenicsx.runtime.errors import InputError, raised_together

PARTIAL = ".partial-"
"""Prefix of a file that is still being written; it keeps the suffix, which says the format."""


def partial_of(path: Path) -> Path:
    """Where a file or folder is written before it takes the place of `path`."""
    return path.with_name(PARTIAL + path.name)


def absolute(path: str | Path, comm: MPI.Intracomm) -> Path:
    """The path from the root, that of rank 0: where it leads now, and wherever the run goes later.
    Collective."""
    with raised_together(comm), explained(Path(path)):
        path = Path(path).absolute()
    return Path(comm.bcast(path))


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Say of what the system refuses to write in the block that it is `path`."""
    try:
        yield
    except OSError as error:
        remedy = (
            "something has taken its folder away; put it back or give another folder"
            if error.errno == errno.ENOENT
            else "free some space or give another folder"
        )
        why = error.strerror or error
        raise InputError(f"{path} cannot be written ({why}): {remedy}") from None


@contextmanager
def readable(what: object, remedy: str) -> Iterator[None]:
    """Say of what the system refuses to read in the block what it is."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{what} cannot be read ({error.strerror or error}); {remedy}") from None


LARGEST_TEXT = 2**30
"""Most bytes of a file of text that is read."""


def size_of_file(path: Path) -> int:
    """Size of a file that can be read to its end (bytes)."""
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is no regular file")
    return status.st_size


def read_text(path: Path) -> bytes:
    """Read a file of text."""
    size = size_of_file(path)
    if size > LARGEST_TEXT:
        raise OSError(errno.EFBIG, f"it has {size} bytes, more than {LARGEST_TEXT}")
    return path.read_bytes()


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Write a file beside `path` in the block; it takes the place of `path` when it is complete.
    Yields where to write instead, in the same folder."""
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
    """Wait until a file, or the names in a folder, are on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def make_writable(folder: Path) -> None:
    """Create a folder where it is missing, and try to write in it."""
    trial = folder / (PARTIAL + "trial")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink(missing_ok=True)  # another process may have tried at the same time
    except OSError as error:
        raise InputError(
            f"the folder {folder} cannot be written ({error.strerror or error}): "
            "give another one, or the right to write there"
        ) from None


def forget(partial: Path) -> None:
    """Remove a file that has not become complete."""
    try:
        partial.unlink(missing_ok=True)
    except OSError:  # the error that led here says more
        pass
