"""Read a mesh file with gmsh or meshio: a program for a separate process, see `mesh_files`.

It imports nothing of this package, as that would start MPI. It writes the result to standard
output: "E" and an error text, or "A" and arrays in numpy's format .npz.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

Arrays = dict[str, Any]

BASE, GROWTH = 4 * 2**30, 60
"""Memory limit of reading: base (bytes), and bytes per byte of the file."""


def limit(file: Path, seconds: int) -> None:
    """Limit this process's resources, so that no file can exhaust the machine."""
    try:
        import resource
    except ImportError:  # not available on every system
        return
    most = BASE + GROWTH * file.stat().st_size
    for what, value in ((resource.RLIMIT_AS, most), (resource.RLIMIT_CPU, seconds)):
        _, hard = resource.getrlimit(what)
        lower = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(what, (lower, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _read_by_gmsh(file: Path) -> Arrays:
    import gmsh

    gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.logger.start()
    gmsh.merge(str(file))
    errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
    if errors:
        raise ValueError("; ".join(errors))
    return gmsh_arrays(gmsh)


def read_step(file: Path, size: str, unit: str) -> Arrays:
    """Read a STEP file with OpenCASCADE and mesh its faces. Groups are "face 1" ... and, for curves
    with one face, "edge 1" ..., for those between faces "line 1" ...; `size` is the edge length in
    `unit`."""
    import gmsh

    gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    for name, value in (("General.Terminal", 0), ("Mesh.Algorithm", 6), ("Mesh.ElementOrder", 1)):
        gmsh.option.setNumber(name, value)
    gmsh.option.setString("Geometry.OCCTargetUnit", unit.upper())
    for name in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(name, float(size))
    gmsh.model.occ.importShapes(os.fspath(file), highestDimOnly=False)
    gmsh.model.occ.removeAllDuplicates()  # touching faces share their curves
    gmsh.model.occ.synchronize()
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    if not faces:
        raise ValueError("it has no faces")
    for k, face in enumerate(faces, 1):
        gmsh.model.addPhysicalGroup(2, [face], name=f"face {k}")
    numbers = {"edge": 0, "line": 0}
    for _, curve in gmsh.model.getEntities(1):
        count = len(gmsh.model.getAdjacencies(1, curve)[0])
        if count > 0:
            kind = "edge" if count == 1 else "line"
            numbers[kind] += 1
            gmsh.model.addPhysicalGroup(1, [curve], name=f"{kind} {numbers[kind]}")
    gmsh.model.mesh.generate(2)
    return gmsh_arrays(gmsh)


def gmsh_arrays(gmsh: Any) -> Arrays:
    """Triangles, nodes and physical groups of the current gmsh model, as named arrays."""
    import numpy as np

    mesh = gmsh.model.mesh
    kinds = [mesh.getElementProperties(kind)[0] for kind in mesh.getElementTypes(2)]
    tags, corners = mesh.getElementsByType(2)
    nodes, coordinates, _ = mesh.getNodes()
    arrays = {
        "triangles": tags, "corners": corners, "nodes": nodes, "coordinates": coordinates,
    }  # fmt: skip
    names: list[str] = []
    dimensions: list[int] = []
    for dimension, tag in gmsh.model.getPhysicalGroups():
        if dimension > 2:
            continue
        name = gmsh.model.getPhysicalName(dimension, tag) or str(tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
            kind = (15, 1, 2)[dimension]  # gmsh's element types of point, line and triangle
            members = mesh.getElementsByType(kind, entity)
            arrays[f"members {len(names)}"] = members[0 if dimension == 2 else 1]
            names.append(name)
            dimensions.append(dimension)
    arrays = {key: np.asarray(value) for key, value in arrays.items()}
    return arrays | {"kinds": kinds, "names": names, "dimensions": dimensions}


def _read_by_meshio(file: Path) -> Arrays:
    """Points, cells and groups of a file, as named arrays; `blocks` -1 means points."""
    import numpy as np

    said = io.StringIO()
    try:
        # meshio prints and exits if a file does not match its suffix
        with (
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            np.errstate(all="ignore"),
        ):
            import meshio

            content = meshio.read(file)
    except MemoryError:
        raise
    except (Exception, SystemExit) as error:
        raise ValueError(said.getvalue().strip() or repr(error)) from error
    arrays: Arrays = {"points": np.asarray(content.points)}
    names: list[str] = []
    blocks: list[int] = []
    for number, block in enumerate(content.cells):
        if block.type in ("vertex", "line", "triangle"):
            arrays[f"cells {number}"] = np.asarray(block.data)
            for name, members in _groups(content, number):
                arrays[f"members {len(names)}"] = members
                names.append(name)
                blocks.append(number)
    for name, members in content.point_sets.items():
        arrays[f"members {len(names)}"] = np.asarray(members)
        names.append(name)
        blocks.append(-1)
    types = [block.type for block in content.cells]
    return arrays | {"types": types, "names": names, "blocks": blocks}


def _groups(content: Any, number: int) -> list[tuple[str, Any]]:
    """Names and members (indices or mask) of the groups in one block of cells."""
    import numpy as np

    dimension = {"vertex": 0, "line": 1, "triangle": 2}[content.cells[number].type]
    found: list[tuple[str, Any]] = []
    for name, sets in content.cell_sets.items():
        if not name.startswith("gmsh:") and sets[number] is not None:
            found.append((name, np.asarray(sets[number])))
    names = {int(tag): name for name, (tag, dim) in content.field_data.items() if dim == dimension}
    for key in ("gmsh:physical", "medit:ref"):  # meshio's names of the integer cell markers
        if key in content.cell_data:
            tags = np.asarray(content.cell_data[key][number]).ravel()
            found += [
                (names.get(int(tag), str(int(tag))), tags == tag)
                for tag in np.unique(tags)
                if tag != 0
            ]
    return found


def main(reader: str, path: str, seconds: str, *options: str) -> None:
    """Read a file and write its contents to standard output."""
    answer = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # silence output of the libraries
        os.dup2(nowhere, stream)
    file = Path(path)
    try:
        limit(file, int(seconds))
        readers = {"gmsh": _read_by_gmsh, "meshio": _read_by_meshio, "STEP": read_step}
        arrays = readers[reader](file, *options)  # type: ignore[operator]
        import numpy as np

        wrong = [key for key, value in arrays.items()
                 if isinstance(value, np.ndarray) and value.dtype.kind not in "biuf"]  # fmt: skip
        if wrong:
            raise ValueError(f"{wrong[0]}: expected numbers, found {arrays[wrong[0]].dtype}")
        texts = {key: json.dumps(v) for key, v in arrays.items() if isinstance(v, list)}
        content = io.BytesIO()
        np.savez(content, **(arrays | texts))
        answer.write(b"A" + content.getvalue())
    except MemoryError:
        answer.write(b"E" + b"it asks for more memory than a file of its size can need")
    except Exception as error:
        answer.write(b"E" + (str(error) or repr(error)).encode(errors="replace"))
    answer.flush()
    os._exit(0)  # skip the libraries' cleanup


if __name__ == "__main__":
    del sys.path[0]  # this file's folder, whose modules could shadow libraries
    main(*sys.argv[1:])
