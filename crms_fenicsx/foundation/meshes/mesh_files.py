"""Membranes from files, and from a user's gmsh model.

Files are read in a separate process: gmsh and meshio expect sound files, and a damaged or malicious
one may crash them, hang them or make them exhaust the memory. This ends only that process.
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.foundation.meshes import reader_process
from crms_fenicsx.foundation.meshes.gmsh_model import (
    imported,
    own_model,
    read_model,
    renumbered,
    surface_of_model,
)
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, Ranks, build_and_distribute
from crms_fenicsx.foundation.meshes.orientation import UPWARD, Outside
from crms_fenicsx.foundation.meshes.surface import SurfaceArrays
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Integers
from crms_fenicsx.foundation.runtime.errors import MeshError
from crms_fenicsx.foundation.runtime.files import readable

SECONDS, SPEED = 30, 1e6
"""Limit of processor time: base (s), and file size (bytes) per additional second."""

LARGEST = 2**33
"""Largest file size (bytes): limits that grow with the size do not stop inflated files."""

SCRUBBED = ("OMPI_", "PMIX_", "PRTE_", "PMI_", "MPI_", "HYDRA_", "SLURM_")
"""Prefixes of the environment variables that make a process an MPI rank."""


def _read_isolated(
    file: Path, reader: Literal["gmsh", "meshio", "STEP"], *options: str
) -> dict[str, Any]:
    """Run `reader_process` on a file; return its arrays and its lists of numbers and texts."""
    size = file.stat().st_size
    if size > LARGEST:
        raise MeshError(
            f"'{file}' has {size} bytes, more than {LARGEST}; pass a coarser mesh and refine it."
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
        why = f"it did not finish within {seconds} s"
    else:
        why = f"it ended with the status {done.returncode}"
    raise MeshError(
        f"{reader} cannot read '{file}': {why[:1000]}; make the file again, or use another one."
    )


SUFFIXES = (
    ".vtu", ".vtk", ".stl", ".obj", ".ply", ".off", ".xdmf", ".med", ".inp", ".mesh", ".meshb",
)  # fmt: skip
"""Formats read by meshio that may contain triangles."""

SIZES = {"vertex": 1, "line": 2, "triangle": 3}
"""Number of corners of the cell types that are read."""


def from_gmsh(
    comm: MPI.Intracomm, *, outside: Outside = UPWARD, ranks: Ranks | None = None
) -> MembraneMesh:
    """Make a membrane from the current gmsh model of rank 0, meshed by the user.

    All its triangles are used. Physical groups become groups: surfaces `parts`, curves `edges`,
    points `points`, under their names or, if unnamed, their tags ("1"). Curves that are embedded in
    a surface or divide it are lines of the mesh, along which `Scene.lay_cable` lays cables.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective, and rank 0 holds the whole mesh first.
        Other ranks need no model.
    outside, ranks
        As for `from_arrays`.

    Raises
    ------
    MeshError
        On all ranks, if gmsh is not initialised on rank 0, the model has no triangles or has other
        surface elements, or `from_arrays` refuses it.
    """

    def build() -> SurfaceArrays:
        gmsh = imported("gmsh")
        if not gmsh.isInitialized():
            raise MeshError(
                "gmsh is not initialised on rank 0; build and mesh a model there first."
            )
        return read_model(gmsh)

    return build_and_distribute(comm, build, outside, ranks)


def from_file(
    comm: MPI.Intracomm,
    path: str | os.PathLike[str],
    *,
    outside: Outside = UPWARD,
    ranks: Ranks | None = None,
) -> MembraneMesh:
    """Read a membrane from a file.

    gmsh reads .geo (and meshes its surfaces) and .msh; meshio reads .vtu, .vtk, .stl, .obj, .ply,
    .off, .xdmf, .med, .inp (Abaqus), .mesh and .meshb (Medit). A .geo file is a program that can
    run commands of the operating system: read only files you trust. Other files are read as data in
    a process with limited memory and time, which protects against damaged and malicious files.

    Groups are physical groups in gmsh files (see `from_gmsh`). In other files they are cell sets of
    triangles (`parts`), lines (`edges`) and vertices (`points`), point sets (`points`), and the
    markers gmsh:physical or medit:ref, where 0 means none. Points without a triangle are left out.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective. Rank 0 reads, and holds the whole mesh
        first.
    path
        The file.
    outside, ranks
        As for `from_arrays`.

    Raises
    ------
    MeshError
        On all ranks, if the file does not exist, cannot be read, has no triangles or has other
        surface elements, or `from_arrays` refuses it.
    """

    def build() -> SurfaceArrays:
        file = checks.file("from_file: path", path)
        if not file.is_file():
            raise MeshError(f"there is no mesh file '{file}' (in {Path.cwd()}); check the path.")
        suffix = file.suffix.lower()
        if suffix == ".geo":
            return _read_script(file)
        if suffix == ".msh":
            with readable(f"'{file}'", "check path and permissions"), file.open("rb") as stream:
                is_mesh = stream.read(64).startswith(b"$MeshFormat")
            if not is_mesh:  # gmsh would run it as a script
                raise MeshError(
                    f"'{file}' is not a gmsh mesh, as it does not begin with $MeshFormat; save it "
                    "with gmsh."
                )
            model = _read_isolated(file, "gmsh")
            return _named(file, lambda: surface_of_model(model))
        if suffix not in SUFFIXES:
            raise MeshError(
                f"'{file}' has the suffix '{suffix}'; convert it to one of .geo, .msh, "
                f"{', '.join(SUFFIXES)}."
            )
        content = _read_isolated(file, "meshio")
        return _named(file, lambda: _surface_of(content))

    return build_and_distribute(comm, build, outside, ranks)


def from_step(
    comm: MPI.Intracomm,
    path: str | os.PathLike[str],
    size: float,
    *,
    unit: str = "m",
    outside: Outside = UPWARD,
    ranks: Ranks | None = None,
) -> MembraneMesh:
    """Mesh the faces of a STEP file, read by gmsh's OpenCASCADE.

    Each face is a part, "face 1" and so on in the file's order, each curve that bounds one face an
    edge group, "edge 1" and so on, and each curve between faces "line 1" and so on. Touching
    faces share vertices. The file is read in a limited process, as in `from_file`.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective. Rank 0 reads, and holds the whole mesh
        first.
    path
        The file, ending in .step or .stp.
    size
        Edge length of the cells (length, in `unit`).
    unit
        Length unit of the mesh, "m", "cm" or "mm"; the file defines its own.
    outside, ranks
        As for `from_arrays`.

    Raises
    ------
    InputError
        On all ranks: a size that is not positive, or an unknown unit.
    MeshError
        On all ranks, if the file does not exist, cannot be read or has no faces, or `from_arrays`
        refuses it.

    Examples
    --------
    >>> mesh = meshes.from_step(MPI.COMM_WORLD, "roof.step", size=0.5)
    """

    def build() -> SurfaceArrays:
        checks.positive("from_step: size", size)
        checks.one_of("from_step: unit", unit, ("m", "cm", "mm"))
        file = checks.file("from_step: path", path)
        if not file.is_file():
            raise MeshError(f"there is no STEP file '{file}' (in {Path.cwd()}); check the path.")
        if file.suffix.lower() not in (".step", ".stp"):
            raise MeshError(f"'{file}' has the suffix '{file.suffix}'; pass a .step or .stp file.")
        with readable(f"'{file}'", "check path and permissions"), file.open("rb") as stream:
            is_step = b"ISO-10303-21" in stream.read(256)
        if not is_step:
            raise MeshError(f"'{file}' is not a STEP file, as it does not begin with ISO-10303-21.")
        model = _read_isolated(file, "STEP", repr(float(size)), unit)
        return _named(file, lambda: surface_of_model(model))

    return build_and_distribute(comm, build, outside, ranks)


def _read_script(file: Path) -> SurfaceArrays:
    """Run a .geo file, trusted by the user, in this process."""
    with own_model(quiet_only=True) as gmsh:
        gmsh.logger.start()
        try:
            gmsh.merge(str(file))
            if len(gmsh.model.mesh.getElementTypes(2)) == 0:
                gmsh.model.mesh.generate(2)
            errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
        except Exception as error:  # gmsh raises no specific class
            raise MeshError(f"gmsh cannot read '{file}': {error}") from None
        finally:
            gmsh.logger.stop()
        if errors:
            raise MeshError(f"gmsh cannot read '{file}': {'; '.join(errors)}")
        return _named(file, lambda: read_model(gmsh))


def _named(file: Path, read: Callable[[], SurfaceArrays]) -> SurfaceArrays:
    """Read, with the file's name prepended to error messages."""
    try:
        return read()
    except MeshError as error:
        raise MeshError(f"'{file}': {error}") from None


def _surface_of(content: dict[str, Any]) -> SurfaceArrays:
    """Triangles and groups from the arrays read by meshio."""
    types: list[str] = content["types"]
    for kind in types:
        if kind not in ("vertex", "line", "triangle", "tetra"):
            raise MeshError(f"there are cells of the type '{kind}'; convert them to triangles.")
    given = content["points"]
    if given.ndim != 2:
        raise MeshError(f"the points have shape {given.shape}; pass (n, 3) or (n, 2) coordinates.")
    blocks = {k: _rows(content[f"cells {k}"], SIZES[kind], kind)
              for k, kind in enumerate(types) if kind in SIZES}  # fmt: skip
    triangles = [rows for k, rows in blocks.items() if types[k] == "triangle"]
    if sum(map(len, triangles)) == 0:
        raise MeshError("there are no triangles.")
    used, cells = np.unique(np.concatenate(triangles), return_inverse=True)
    if used[0] < 0 or used[-1] >= len(given):
        raise MeshError(
            f"there is a triangle with vertex {used[0] if used[0] < 0 else used[-1]}, but only "
            f"{len(given)} points."
        )
    groups: dict[str, dict[str, list[Integers]]] = {kind: {} for kind in SIZES}
    numbers = np.split(np.arange(cells.size // 3), np.cumsum([len(rows) for rows in triangles]))
    of_triangles = [k for k in blocks if types[k] == "triangle"]
    entities = blocks | dict(zip(of_triangles, numbers, strict=False))
    for k, (name, block) in enumerate(zip(content["names"], content["blocks"], strict=True)):
        members = content[f"members {k}"].ravel()
        if block < 0:
            kind, chosen = "vertex", renumbered(used, _whole(members, name), name)
        else:
            kind, chosen = types[block], _chosen(entities[block], members, name)
            if kind != "triangle":
                chosen = renumbered(used, chosen.ravel(), name).reshape(chosen.shape)
        if len(chosen):
            chosen = chosen.ravel() if kind == "vertex" else chosen
            groups[kind].setdefault(name, []).append(chosen)
    edges, parts, points = (
        {name: np.concatenate(found) for name, found in groups[kind].items()}
        for kind in ("line", "triangle", "vertex")
    )
    return SurfaceArrays(given[used], cells.reshape(-1, 3), edges, parts, points)


def _rows(cells: NDArray[Any], corners: int, kind: str) -> Integers:
    if cells.ndim != 2 or cells.shape[1] != corners:
        raise MeshError(f"cells of the type '{kind}' have the shape {cells.shape}.")
    return _whole(cells, f"cells of the type '{kind}'")


def _whole(numbers: NDArray[Any], what: str) -> Integers:
    if numbers.dtype.kind in "iu" or np.all(np.abs(numbers) < 2**53):
        whole = numbers.astype(np.int64)
        if np.array_equal(whole, numbers):
            return whole
    raise MeshError(f"{what}: some numbers are not indices.")


def _chosen(entities: Integers, members: NDArray[Any], name: str) -> Integers:
    """The entities selected by a mask or by indices."""
    if members.dtype != bool:
        members = _whole(members, f"group '{name}'")
        if len(members) and not 0 <= members.min() <= members.max() < len(entities):
            raise MeshError(
                f"group '{name}' has the members {members.min()} to {members.max()} of "
                f"{len(entities)}."
            )
    elif len(members) != len(entities):
        raise MeshError(f"group '{name}' marks {len(members)} of {len(entities)} cells.")
    return entities[members]
