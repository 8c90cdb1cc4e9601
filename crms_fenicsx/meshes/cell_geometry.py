"""Areas and normals of cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem, la

from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.runtime.compat import geometry_dofmap


def area_vectors(mesh: Any, cells: Any = slice(None)) -> Array:
    """Normals of the stress-free cells, as long as their areas, (n, 3); of all, with ghosts."""
    x = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
    return np.asarray(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2, dtype=float)


def cell_sides(mesh: Any, cells: Indices) -> Array:
    """Stress-free sides of cells, from each corner to the next one, (n, 3, 3)."""
    x: Array = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[cells]], dtype=float)
    return np.roll(x, -1, axis=1) - x


def cell_normals(mesh: Any) -> Array:
    """Unit normals of the stress-free cells, (n, 3), ghosts included."""
    normal = area_vectors(mesh)
    return normal / np.linalg.norm(normal, axis=1)[:, None]


@dataclass(frozen=True)
class OpenEdges:
    """Edges at which the cells under pressure do not cancel each other, as this rank knows them."""

    numbers: Indices  # (n,) local numbers of the edges, owned ones and ghosts, sorted
    vertices: Indices  # (n, 2) their vertices by local degree of freedom
    # (n, 2) the vertices' numbers in the mesh as it was given; the first one is lower
    ids: Integers
    senses: Array  # (n,) how many more cells pass from the first vertex to the second one than back


def open_edges(V: fem.FunctionSpace, pressed: Booleans) -> OpenEdges:
    """Edges at which the cells under pressure do not cancel each other. Collective.

    The exact follower pressure has a potential only if these are held or slide in planes: each cell
    makes a volume with the origin, whose sides over an edge cancel if as many cells pass it in the
    one sense as in the other. It is not so at the rim of what is under pressure, nor at a seam of
    three. Shapes: pressed (n,).
    """
    mesh = V.mesh
    numbers = mesh.topology.connectivity(2, 1).array.reshape(-1, 3)
    ids = cell_vertex_ids(mesh)
    sides = np.stack([np.roll(np.arange(3), -1), np.roll(np.arange(3), -2)], axis=1)
    start, end = ids[:, sides[:, 0]], ids[:, sides[:, 1]]  # side k lies opposite to k
    sense = np.where(start < end, 1.0, -1.0)
    total = la.vector(mesh.topology.index_map(1), dtype=np.float64)
    np.add.at(total.array, numbers[pressed], sense[pressed])
    total.scatter_reverse(la.InsertMode.add)
    total.scatter_forward()
    found = np.flatnonzero(total.array).astype(np.int32)
    pairs = np.zeros((len(total.array), 2), dtype=np.int32)
    named = np.zeros((len(total.array), 2), dtype=np.int64)
    order = np.where((sense > 0)[..., None], sides, sides[:, ::-1])  # (cells, 3, 2)
    pairs[numbers] = np.take_along_axis(V.dofmap.list[:, None, :], order, axis=2)
    named[numbers] = np.take_along_axis(ids[:, None, :], order, axis=2)
    return OpenEdges(found, pairs[found], named[found], total.array[found])
