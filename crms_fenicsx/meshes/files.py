"""Membranes from files, and from a gmsh model that the user has built."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx import checks
from crms_fenicsx.errors import MeshError
from crms_fenicsx.meshes.gmsh_model import own_model, read_model
from crms_fenicsx.meshes.membrane_mesh import MembraneMesh, distributed
from crms_fenicsx.meshes.orientation import UPWARD, Outside
from crms_fenicsx.meshes.partition import Ranks
from crms_fenicsx.meshes.surface import SurfaceArrays

_GMSH_SUFFIXES = (".geo", ".msh")
_TAGS = ("gmsh:physical", "medit:ref")  # meshio's names of the integer marks of cells


def from_gmsh(
    comm: MPI.Intracomm, *, outside: Outside = UPWARD, ranks: Ranks | None = None
) -> MembraneMesh:
    """Make a membrane from the current gmsh model of rank 0, meshed by the user.

    All its triangles are used. Physical groups become groups: surfaces `parts`, curves
    `edges`, points `points`, under their names or, where they have none, their tags ("1").

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective. Other ranks need no model.
    outside
        The side that pressure acts towards, as for `from_arrays`.
    ranks
        The rank that shall own each cell, as for `from_arrays`.

    Raises
    ------
    MeshError
        On all ranks, if gmsh is not initialised on rank 0, the model has no triangles or
        other surface elements, or `from_arrays` would refuse it.
    """

    def build() -> SurfaceArrays:
        import gmsh

        if not gmsh.isInitialized():
            raise MeshError(
                "gmsh is not initialised on rank 0: build and mesh a model there before"
            )
        return read_model(gmsh)

    return distributed(comm, build, outside, ranks)


def from_file(
    comm: MPI.Intracomm,
    path: str | os.PathLike[str],
    *,
    outside: Outside = UPWARD,
    ranks: Ranks | None = None,
) -> MembraneMesh:
    """Read a membrane from a file.

    gmsh reads .geo (and meshes its surfaces) and .msh; meshio reads everything else that it
    knows by its suffix: .vtu, .vtk, .stl, .obj, .xdmf, .med, and others. A .geo file is a
    program: it can run commands of the operating system. Read only those that you trust.

    Groups are physical groups in gmsh's files (see `from_gmsh`). In the other files they are
    cell sets of triangles (`parts`), lines (`edges`) and vertices (`points`), point sets
    (`points`), and the marks called gmsh:physical or medit:ref, 0 meaning none. Points that are
    the corner of no triangle are left out.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective. Rank 0 reads.
    path
        The file.
    outside
        The side that pressure acts towards, as for `from_arrays`.
    ranks
        The rank that shall own each cell, as for `from_arrays`.

    Raises
    ------
    MeshError
        On all ranks, if there is no such file, it cannot be read, it has no triangles or
        other surface elements, or `from_arrays` would refuse it.
    """

    def build() -> SurfaceArrays:
        file = checks.file("from_file: path", path)
        if not file.is_file():
            raise MeshError(f"there is no mesh file '{file}' (in {Path.cwd()}): check the path")
        if file.suffix.lower() in _GMSH_SUFFIXES:
            return _read_by_gmsh(file)
        return _read_by_meshio(file)

    return distributed(comm, build, outside, ranks)


def _read_by_gmsh(file: Path) -> SurfaceArrays:
    is_script = file.suffix.lower() == ".geo"
    if not is_script:
        with file.open("rb") as stream:
            # gmsh would take anything else for a script, and run it
            if not stream.read(64).lstrip().startswith(b"$"):
                raise MeshError(
                    f"'{file}' is no gmsh mesh, it does not begin with $MeshFormat: save it "
                    "again with gmsh"
                )
    with own_model(quiet_only=True) as gmsh:
        gmsh.logger.start()
        try:
            gmsh.merge(str(file))
            if is_script and len(gmsh.model.mesh.getElementTypes(2)) == 0:
                gmsh.model.mesh.generate(2)
            errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
        except Exception as error:  # gmsh raises nothing more special
            raise MeshError(f"gmsh cannot read '{file}': {error}") from error
        finally:
            gmsh.logger.stop()
        if errors:
            raise MeshError(f"gmsh cannot read '{file}': {'; '.join(errors)}")
        try:
            return read_model(gmsh)
        except MeshError as error:
            raise MeshError(f"'{file}': {error}") from error


def _read_by_meshio(file: Path) -> SurfaceArrays:
    import meshio

    said = io.StringIO()
    try:
        # meshio prints, and ends the program, where a file is not what its suffix says; its
        # test for binary .stl files overflows on those that are text
        with (
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            np.errstate(over="ignore"),
        ):
            content = meshio.read(file)
    except (Exception, SystemExit) as error:
        raise MeshError(
            f"meshio cannot read '{file}': {said.getvalue().strip() or error!r}"
        ) from error
    return _surface_of(content, file)


def _surface_of(content: Any, file: Path) -> SurfaceArrays:
    """Take the triangles and the groups out of a meshio mesh."""
    for block in content.cells:
        if block.type not in ("vertex", "line", "triangle", "tetra"):
            raise MeshError(
                f"'{file}' has cells of the type '{block.type}': convert them to 3-node triangles"
            )
    blocks = [block for block in content.cells if block.type == "triangle"]
    if sum(len(block.data) for block in blocks) == 0:
        raise MeshError(f"'{file}' has no triangles")
    corners = np.concatenate([np.asarray(block.data, dtype=np.int64) for block in blocks])
    used, cells = np.unique(corners, return_inverse=True)
    if used[0] < 0 or used[-1] >= len(content.points):
        raise MeshError(
            f"'{file}' has a triangle with vertex {used[0] if used[0] < 0 else used[-1]}, but "
            f"only {len(content.points)} points"
        )
    edges: dict[str, list[NDArray[np.int64]]] = {}
    parts: dict[str, list[NDArray[np.int64]]] = {}
    points: dict[str, list[NDArray[np.int64]]] = {}
    groups = {"triangle": parts, "line": edges, "vertex": points}
    first_cell = 0
    for number, block in enumerate(content.cells):
        if block.type not in groups:
            continue
        entities: NDArray[np.int64]
        if block.type == "triangle":
            entities = np.arange(first_cell, first_cell + len(block.data))
            first_cell += len(block.data)
        else:
            entities = np.asarray(block.data, dtype=np.int64)
        for name, members in _groups_of_block(content, number):
            chosen = entities[members]
            if len(chosen):
                if block.type != "triangle":
                    chosen = _renumbered(used, chosen, name, file)
                chosen = chosen.ravel() if block.type == "vertex" else chosen
                groups[block.type].setdefault(name, []).append(chosen)
    for name, members in getattr(content, "point_sets", {}).items():
        vertices = _renumbered(used, np.asarray(members, dtype=np.int64), name, file)
        points.setdefault(name, []).append(vertices)
    return SurfaceArrays(
        np.asarray(content.points)[used],
        cells.reshape(-1, 3),
        {name: np.concatenate(group) for name, group in edges.items()},
        {name: np.concatenate(group) for name, group in parts.items()},
        {name: np.concatenate(group) for name, group in points.items()},
    )


def _groups_of_block(content: Any, number: int) -> list[tuple[str, NDArray[Any]]]:
    """Return names and members (indices or mask) of the groups in one block of cells."""
    dimension = {"vertex": 0, "line": 1, "triangle": 2}[content.cells[number].type]
    found: list[tuple[str, NDArray[Any]]] = []
    for name, sets in content.cell_sets.items():
        if not name.startswith("gmsh:") and sets[number] is not None:
            found.append((name, np.asarray(sets[number], dtype=np.int64)))
    names = {int(tag): name for name, (tag, dim) in content.field_data.items() if dim == dimension}
    for key in _TAGS:
        if key in content.cell_data:
            tags = np.asarray(content.cell_data[key][number]).ravel()
            found += [
                (names.get(int(tag), str(int(tag))), tags == tag)
                for tag in np.unique(tags)
                if tag != 0
            ]
    return found


def _renumbered(
    used: NDArray[np.int64], vertices: NDArray[np.int64], group: str, file: Path
) -> NDArray[np.int64]:
    found = np.searchsorted(used, vertices).clip(max=len(used) - 1)
    missing = vertices[used[found] != vertices]
    if len(missing):
        raise MeshError(
            f"group '{group}' of '{file}' has point {missing[0]}, which is the corner of no "
            "triangle: take it out of the group"
        )
    return found.astype(np.int64)
