"""Files that are complete at any moment, whenever the run is killed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from crms_fenicsx.errors import InputError

PARTIAL = ".partial-"
"""Prefix of a file that is still being written; it keeps the suffix, which says the format."""


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Write a file beside `path` in the block; it takes the place of `path` when it is complete.

    Parameters
    ----------
    path : Path
        The file; its folder exists.

    Yields
    ------
    Path
        Where to write instead, in the same folder.

    Raises
    ------
    InputError
        When the system refuses to write; the file at `path` is then as before.
    """
    partial = path.with_name(PARTIAL + path.name)
    try:
        yield partial
        with open(partial, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        _forget(partial)
        raise InputError(
            f"{path} cannot be written ({error.strerror or error}): free some space or give "
            "another folder"
        ) from error
    except BaseException:
        _forget(partial)
        raise


def make_writable(folder: Path) -> None:
    """Create a folder where it is missing, and try to write in it.

    Raises
    ------
    InputError
        When that is not possible.
    """
    trial = folder / (PARTIAL + "trial")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise InputError(
            f"the folder {folder} cannot be written ({error.strerror or error}): "
            "give another one, or the right to write there"
        ) from error


def _forget(partial: Path) -> None:
    try:
        partial.unlink(missing_ok=True)
    except OSError:  # the error that led here says more
        pass
