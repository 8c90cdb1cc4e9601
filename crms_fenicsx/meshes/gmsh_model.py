"""Work in a gmsh model of our own, and read the triangles of a gmsh model."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.errors import MeshError
from crms_fenicsx.meshes.surface import SurfaceArrays

_LINE, _TRIANGLE, _POINT = 1, 2, 15  # gmsh's element types
_FRONTAL_DELAUNAY = 6
_OPTIONS = {
    "General.Terminal": 0,
    "Mesh.Algorithm": _FRONTAL_DELAUNAY,
    "Mesh.ElementOrder": 1,
    "Mesh.RecombineAll": 0,
    "Mesh.MeshSizeMin": 0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeFactor": 1,
}


@contextmanager
def own_model(*, quiet_only: bool = False) -> Iterator[Any]:
    """Enter a new, empty gmsh model and yield the gmsh module.

    A session that the user has started goes on afterwards with the user's model and options;
    otherwise gmsh is finalised again.

    Parameters
    ----------
    quiet_only
        Leave gmsh's meshing options as they are: a script may count on its defaults.
    """
    import gmsh

    started = not gmsh.isInitialized()
    if started:
        # not interruptible: that would replace Python's handler of Ctrl-C
        gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
        previous = ""
    else:
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


def mesh_with_sizes(gmsh: Any, target: Callable[[NDArray[np.float64]], float]) -> None:
    """Mesh the surfaces of the current model.

    Parameters
    ----------
    gmsh
        The gmsh module, in a model of our own.
    target
        Callable that maps a point, shape (3,), to the wanted edge length there.
    """

    def size_at(dim: int, tag: int, x: float, y: float, z: float, lc: float) -> float:
        return target(np.array([x, y, z]))

    gmsh.model.mesh.setSizeCallback(size_at)
    gmsh.model.mesh.generate(2)


def read_model(gmsh: Any) -> SurfaceArrays:
    """Read the triangles and the physical groups of the current model.

    Nodes that are the corner of no triangle, such as the centres of circles, are left out.
    A triangle that is there several times is taken once: .msh files of version 2 repeat it for
    each of its physical groups.

    Raises
    ------
    MeshError
        If the model has no triangles, surface elements of another kind, or a physical group
        with nodes that are the corners of no triangle.
    """
    for kind in gmsh.model.mesh.getElementTypes(2):
        if kind != _TRIANGLE:
            name = gmsh.model.mesh.getElementProperties(kind)[0]
            raise MeshError(
                f"the gmsh model has surface elements of the type '{name}': mesh it with "
                "3-node triangles (Mesh.ElementOrder = 1, no recombination)"
            )
    tags, nodes = gmsh.model.mesh.getElementsByType(_TRIANGLE)
    if len(tags) == 0:
        raise MeshError(
            "the gmsh model has no triangles: define a surface, mesh it with "
            "gmsh.model.mesh.generate(2) and, where there are physical groups, put the surface "
            "into one before saving"
        )
    used, cells = np.unique(nodes.astype(np.int64), return_inverse=True)
    node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(node_tags)
    rows = order[np.searchsorted(node_tags, used, sorter=order)]
    tag_order = np.argsort(tags)
    cells, cell_of_element = _without_repetitions(cells.reshape(-1, 3))
    edges: dict[str, list[NDArray[np.int64]]] = {}
    parts: dict[str, list[NDArray[np.int64]]] = {}
    points: dict[str, list[NDArray[np.int64]]] = {}
    for dim, tag in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
            if dim == 2:
                members = gmsh.model.mesh.getElementsByType(_TRIANGLE, entity)[0]
                found = np.searchsorted(tags, members, sorter=tag_order)
                parts.setdefault(name, []).append(cell_of_element[tag_order[found]])
            elif dim == 1:
                members = gmsh.model.mesh.getElementsByType(_LINE, entity)[1]
                edges.setdefault(name, []).append(_renumbered(used, members, name).reshape(-1, 2))
            elif dim == 0:
                members = gmsh.model.mesh.getElementsByType(_POINT, entity)[1]
                points.setdefault(name, []).append(_renumbered(used, members, name))
    return SurfaceArrays(
        coordinates.reshape(-1, 3)[rows],
        cells,
        {name: np.concatenate(group) for name, group in edges.items()},
        {name: np.concatenate(group) for name, group in parts.items()},
        {name: np.concatenate(group) for name, group in points.items()},
    )


def _without_repetitions(
    triangles: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the different triangles, in the order given, and the place of each one there."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort(corners.T)
    is_new = np.ones(len(triangles), dtype=bool)
    is_new[1:] = (np.diff(corners[order], axis=0) != 0).any(axis=1)
    # the sort is stable: of equal triangles the first one given comes first
    first_given = order[is_new][np.cumsum(is_new) - 1]
    representative = np.empty(len(triangles), dtype=np.int64)
    representative[order] = first_given
    kept, place = np.unique(representative, return_inverse=True)
    return triangles[kept], place.astype(np.int64)


def _renumbered(
    used: NDArray[np.int64], nodes: NDArray[np.uint64], group: str
) -> NDArray[np.int64]:
    tags = nodes.astype(np.int64)
    found = np.searchsorted(used, tags).clip(max=len(used) - 1)
    missing = tags[used[found] != tags]
    if len(missing):
        raise MeshError(
            f"the physical group '{group}' has node {missing[0]}, which is the corner of no "
            "triangle: take it out of the group or embed it in a surface"
        )
    return found.astype(np.int64)
