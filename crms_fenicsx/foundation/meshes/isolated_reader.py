"""Read mesh files with gmsh and meshio in a separate process.

These libraries expect sound files. A damaged or malicious one may crash them, hang them or make
them exhaust the memory; in a separate process this ends only that process.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np

from crms_fenicsx.foundation.meshes import reader_process
from crms_fenicsx.foundation.runtime.errors import MeshError

SECONDS, SPEED = 30, 1e6
"""Limit of processor time: base (s), and file size (bytes) per additional second."""

LARGEST = 2**33
"""Largest file size (bytes): limits that grow with the size do not stop inflated files."""

SCRUBBED = ("OMPI_", "PMIX_", "PRTE_", "PMI_", "MPI_", "HYDRA_", "SLURM_")
"""Prefixes of the environment variables that make a process an MPI rank."""


def read_isolated(
    file: Path, reader: Literal["gmsh", "meshio", "STEP"], *options: str
) -> dict[str, Any]:
    """Run `reader_process` on a file; return its arrays and its lists of numbers and texts."""
    size = file.stat().st_size
    if size > LARGEST:
        raise MeshError(
            f"'{file}' has {size} bytes, more than {LARGEST}: give a coarser mesh, and refine it"
        )
    seconds = SECONDS + int(size / SPEED)
    own = {name: text for name, text in os.environ.items() if not name.startswith(SCRUBBED)}
    one = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    done = subprocess.run(
        [
            sys.executable,
            reader_process.__file__,
            reader,
            os.fspath(file.resolve()),
            str(seconds),
            *options,
        ],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=own | one,
        check=False,
    )
    kind, answer = done.stdout[:1], done.stdout[1:]
    if kind == b"A" and done.returncode == 0:
        with np.load(io.BytesIO(answer), allow_pickle=False) as content:
            found = {key: content[key] for key in content.files}
        return {key: json.loads(str(a)) if a.dtype.kind == "U" else a for key, a in found.items()}
    if kind == b"E":
        why = answer.decode(errors="replace")
    elif done.returncode == -getattr(signal, "SIGXCPU", 0):
        why = f"it did not come to an end in {seconds} s"
    else:
        why = f"it ended with the status {done.returncode}"
    raise MeshError(
        f"{reader} cannot read '{file}': {why[:1000]}; make the file again, or take another one"
    )
