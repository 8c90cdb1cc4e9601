"""A separate gmsh model to work in, and conversion of a gmsh model's triangles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from crms_fenicsx.foundation.meshes.plan_lines import PlanRows
from crms_fenicsx.foundation.meshes.reader_process import gmsh_arrays
from crms_fenicsx.foundation.meshes.surface import SurfaceArrays
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import MeshError

_TRIANGLE = "Triangle 3"  # gmsh's name
_FRONTAL_DELAUNAY = 6

AGAIN = "which is not there; mesh the model again"

Groups = dict[str, list[Integers]]
_OPTIONS = {
    "General.Terminal": 0,
    "Mesh.Algorithm": _FRONTAL_DELAUNAY,
    "Mesh.ElementOrder": 1,
    "Mesh.RecombineAll": 0,
    "Mesh.MeshSizeMin": 0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeFactor": 1,
}


def imported(package: str) -> Any:
    """Import an optional package for making or reading meshes."""
    try:
        return import_module(package)
    except (ImportError, OSError) as error:  # OSError: a shared library of gmsh is missing
        raise MeshError(
            f"this mesh needs {package}, which cannot be imported ({error}); install it: "
            "pip install 'crms_fenicsx[mesh]', conda install python-gmsh meshio, or "
            "apt install python3-gmsh python3-meshio."
        ) from error


@contextmanager
def own_model(*, quiet_only: bool = False) -> Iterator[Any]:
    """Yield gmsh with a new, empty model; a user's session is restored afterwards."""
    gmsh = imported("gmsh")
    started = not gmsh.isInitialized()
    if started:
        # interruptible=True would replace Python's handler of Ctrl-C
        gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    previous = gmsh.model.getCurrent()
    names = ["General.Terminal"] if quiet_only else list(_OPTIONS)
    saved = {name: gmsh.option.getNumber(name) for name in names}
    try:
        for name in names:
            gmsh.option.setNumber(name, _OPTIONS[name])
        gmsh.model.add("crms_fenicsx")
        try:
            yield gmsh
        finally:
            gmsh.model.remove()
            if not started and previous in gmsh.model.list():
                gmsh.model.setCurrent(previous)
    finally:
        for name, value in saved.items():
            gmsh.option.setNumber(name, value)
        if started:
            gmsh.finalize()


def mesh_with_sizes(gmsh: Any, target: Callable[[Array], float]) -> None:
    """Mesh the surfaces of the current model with edge lengths `target` of positions (3,)."""

    def size_at(dim: int, tag: int, x: float, y: float, z: float, lc: float) -> float:
        return target(np.array([x, y, z]))

    gmsh.model.mesh.setSizeCallback(size_at)
    gmsh.model.mesh.generate(2)


def add_rim_points(geometry: Any, rows: PlanRows, rim: dict[float, int]) -> None:
    """Add to a gmsh model's points `rim`, by their places, those of rows."""
    for vertex, place in rows.places.items():
        if place not in rim:
            rim[place] = geometry.addPoint(*rows.points[vertex])


def add_rows(geometry: Any, rows: PlanRows, rim: Mapping[float, int]) -> dict[str, list[int]]:
    """Add the edges of rows to a gmsh model with points `rim`, by their places; returns those of
    each line."""
    tags = [
        rim[rows.places[vertex]] if vertex in rows.places else geometry.addPoint(*point)
        for vertex, point in enumerate(rows.points)
    ]
    return {
        name: [geometry.addLine(tags[a], tags[b]) for a, b in pairwise(row)]
        for name, row in rows.rows.items()
    }


def embed_rows(gmsh: Any, edges: Mapping[str, list[int]], surface: int) -> None:
    """Let the mesh of a surface have the edges of rows, as named groups."""
    for name, members in edges.items():
        for edge in members:
            gmsh.model.mesh.setTransfiniteCurve(edge, 2)  # one edge of the mesh
        gmsh.model.mesh.embed(1, members, 2, surface)
        gmsh.model.addPhysicalGroup(1, members, name=name)


def read_model(gmsh: Any) -> SurfaceArrays:
    """Triangles and physical groups of the current model."""
    return surface_of_model(gmsh_arrays(gmsh))


def surface_of_model(model: dict[str, Any]) -> SurfaceArrays:
    """Triangles and groups from the arrays of `gmsh_arrays`, without unused nodes."""
    for kind in model["kinds"]:
        if kind != _TRIANGLE:
            raise MeshError(
                f"the gmsh model has surface elements of the type '{kind}'; mesh it with "
                "3-node triangles (Mesh.ElementOrder = 1, no recombination)."
            )
    tags = model["triangles"]
    if len(tags) == 0:
        raise MeshError(
            "the gmsh model has no triangles; define a surface, mesh it with "
            "gmsh.model.mesh.generate(2) and, where there are physical groups, put the surface "
            "into one before saving."
        )
    used, cells = np.unique(model["corners"].astype(np.int64), return_inverse=True)
    order = np.argsort(model["nodes"])
    nodes = model["nodes"][order].astype(np.int64)
    rows = order[_found(nodes, used, "there is a triangle with")]
    tag_order = np.argsort(tags)
    sorted_tags = tags[tag_order].astype(np.int64)
    # .msh files of version 2 repeat a triangle for each of its physical groups
    corners = np.sort(cells.reshape(-1, 3), axis=1)
    _, first, same = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    kept, cell_of_element = np.unique(first[same.ravel()], return_inverse=True)
    groups: tuple[Groups, Groups, Groups] = ({}, {}, {})
    for k, (name, dimension) in enumerate(zip(model["names"], model["dimensions"], strict=True)):
        members = model[f"members {k}"].astype(np.int64)
        if dimension == 2:
            what = f"the physical group '{name}' has triangle"
            members = cell_of_element[tag_order[_found(sorted_tags, members, what)]]
        else:
            members = renumbered(used, members, name)
            members = members.reshape(-1, 2) if dimension == 1 else members
        groups[dimension].setdefault(name, []).append(members)
    points, edges, parts = (
        {name: np.concatenate(found) for name, found in group.items()} for group in groups
    )
    places, cells = model["coordinates"].reshape(-1, 3)[rows], cells.reshape(-1, 3)[kept]
    return SurfaceArrays(places, cells, edges, parts, points)


def renumbered(used: Integers, nodes: Integers, group: str) -> Integers:
    """Indices of a group's nodes among the sorted used nodes."""
    remedy = "which belongs to no triangle; remove it from the group or embed it in a surface"
    return _found(used, nodes, f"the group '{group}' has node", remedy)


def _found(known: Integers, wanted: Integers, what: str, remedy: str = AGAIN) -> Integers:
    """Indices of numbers in a sorted array."""
    found = np.searchsorted(known, wanted).clip(max=max(len(known) - 1, 0))
    missing = wanted[known[found] != wanted] if len(known) else wanted
    if len(missing):
        raise MeshError(f"{what} {missing[0]}, {remedy}.")
    return found.astype(np.int64)
