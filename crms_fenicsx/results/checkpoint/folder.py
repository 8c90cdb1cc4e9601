"""Replace folders so that a complete one exists whenever the run is killed.

The new folder is written beside the old one; then the old one is moved aside, the new one takes its
place, and the old one is deleted. A run killed between the two moves leaves the old one aside.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import explained, flush, make_writable, partial_of

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
                raise InputError(f"{folder} is no checkpoint, but is there; give another folder")
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
