"""Geometry of triangles: areas, normals, edges without a counterpart.

Everything is elementwise, so that a part of a mesh rounds as the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from dolfinx import fem, la

from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.runtime.compat import geometry_dofmap

# Cells whose projection keeps less than this part of their area are walls.
WALL = 1e-6


def vectors(rows: Array) -> list[Array]:
    """Return the rows of an array, for loops."""
    return [rows[i] for i in range(len(rows))]


def lists(rows: Integers) -> list[list[int]]:
    """Return the rows of an array as lists of Python integers."""
    return cast(list[list[int]], rows.tolist())


def norm(a: Array) -> Array:
    """Return the lengths of the vectors in the last axis."""
    return np.asarray(np.sqrt(dot(a, a)), dtype=np.float64)


def cross(a: Array, b: Array) -> Array:
    """Return the cross products of the vectors in the last axes."""
    # by components: the library's cross product takes longer to set up than to compute
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products of the vectors in the last axes."""
    total = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return np.asarray(total, dtype=np.float64)


def arc_lengths(points: Array) -> Array:
    """Return the lengths (n,) of a polyline (n, 3) from its first point to each one."""
    first = np.zeros(min(len(points), 1))
    return np.concatenate([first, np.cumsum(norm(np.diff(points, axis=0)))])


def longest_sides(triangles: Array) -> Array:
    """Return (m,) lengths of the longest sides of (m, 3, 3) triangles."""
    sides = norm(triangles[:, [1, 2, 0]] - triangles)
    return np.asarray(np.max(sides, axis=1, initial=0.0))


def double_areas(triangles: Array) -> Array:
    """Return (m, 3) normals, as long as twice the area."""
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def altitudes(triangles: Array) -> Array:
    """Return (m,) smallest altitudes."""
    longest = longest_sides(triangles)
    quotient = norm(double_areas(triangles)) / np.where(longest > 0.0, longest, 1.0)
    return np.asarray(quotient, dtype=np.float64)


def balls(triangles: Array) -> tuple[Array, Array]:
    """Return (m, 3) centres and (m,) radii of balls around the triangles."""
    centre = np.asarray(triangles.sum(axis=1) / 3.0, dtype=np.float64)
    return centre, np.asarray(np.max(norm(triangles - centre[:, None]), axis=1, initial=0.0))


def closest(triangles: Array, target: Array) -> tuple[Array, Array, Array]:
    """Return the places nearest to `target`, (3,) or (m, 3), in each of (m, 3, 3) triangles: (m, 3)
    weights, which are badly conditioned in slivers, (m, 3) positions and (m,) distances."""
    every = np.arange(len(triangles))
    target = np.broadcast_to(target, (len(triangles), 3))
    sides = triangles[:, [1, 2, 0]] - triangles
    square = dot(sides, sides)
    t = dot(target[:, None] - triangles, sides) / np.where(square > 0.0, square, 1.0)
    t = np.clip(t, 0.0, 1.0)
    on_sides = triangles + t[..., None] * sides
    to_sides = norm(on_sides - target[:, None])
    side = np.argmin(to_sides, axis=1)
    gaps, places, t = to_sides[every, side], on_sides[every, side], t[every, side]
    weights = np.zeros((len(triangles), 3))
    weights[every, side], weights[every, (side + 1) % 3] = 1.0 - t, t

    normal = double_areas(triangles)
    square = dot(normal, normal)
    to_corners = triangles - target[:, None]
    opposite = cross(to_corners[:, [1, 2, 0]], to_corners[:, [2, 0, 1]])
    inner = dot(opposite, normal[:, None]) / np.where(square > 0.0, square, 1.0)[:, None]
    inside = (inner >= 0.0).all(axis=1) & (square > 0.0)
    weights[inside] = inner[inside] / inner[inside].sum(axis=1)[:, None]
    height = dot(triangles[inside, 0] - target[inside], normal[inside]) / square[inside]
    places[inside] = target[inside] + height[:, None] * normal[inside]
    gaps[inside] = norm(places[inside] - target[inside])
    return weights, places, gaps


def mix(weights: Array, triangles: Array) -> Array:
    """Return (m, 3) positions from (m, 3) weights of the corners of (m, 3, 3) triangles."""
    product = weights[:, :, None] * triangles
    mixed: Array = product[:, 0] + product[:, 1] + product[:, 2]
    return mixed


def flattened(triangles: Array) -> Array:
    """Return the triangles' plans: z = 0."""
    flat = triangles.copy()
    flat[..., 2] = 0.0
    return flat


def area_vectors(mesh: Any, cells: Any = slice(None)) -> Array:
    """Normals of the stress-free cells, as long as their areas, (n, 3); of all, with ghosts."""
    x = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
    return np.asarray(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2, dtype=float)


def cell_sides(mesh: Any, cells: Indices) -> Array:
    """Stress-free sides of cells, from each corner to the next one, (n, 3, 3)."""
    x: Array = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[cells]], dtype=float)
    return np.roll(x, -1, axis=1) - x


def cell_normals(mesh: Any, cells: Any = slice(None)) -> Array:
    """Unit normals of the stress-free cells, (n, 3); of all, with ghosts."""
    normal = area_vectors(mesh, cells)
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
    """Edges at which the cells under pressure (m,) do not cancel each other. Collective."""
    # The exact follower pressure has a potential only if these are held or slide in planes: each
    # cell makes a volume with the origin, whose sides over an edge cancel if as many cells pass it
    # in the one sense as in the other; not so at the rim of what is pressed, or at a seam of three.
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
