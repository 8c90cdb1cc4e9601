"""Geometry of triangles: areas, normals, edges where pressure is not balanced.

All operations are elementwise, so that a part of a mesh gives the same digits as the whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from dolfinx import fem, la

from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

# Cells with a smaller ratio of plan area to area are walls.
WALL = 1e-6


def vectors(rows: Array) -> list[Array]:
    """The rows of an array as a list of arrays, for loops."""
    return [rows[i] for i in range(len(rows))]


def lists(rows: Integers) -> list[list[int]]:
    """The rows of an integer array as lists of Python ints."""
    return cast(list[list[int]], rows.tolist())


def norm(a: Array) -> Array:
    """Lengths of the vectors in the last axis."""
    return np.asarray(np.sqrt(dot(a, a)), dtype=np.float64)


def cross(a: Array, b: Array) -> Array:
    """Cross products of the vectors in the last axes."""
    # by components: numpy's cross product takes longer to set up than to compute
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


def cross_in_plane(a: Array, b: Array) -> Array:
    """Cross products of vectors in the plane, in the last axes."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def dot(a: Array, b: Array) -> Array:
    """Scalar products of the vectors in the last axes."""
    total = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return np.asarray(total, dtype=np.float64)


def arc_lengths(points: Array) -> Array:
    """Arc lengths (n,) of a polyline's points (n, 3), from its first point."""
    first = np.zeros(min(len(points), 1))
    return np.concatenate([first, np.cumsum(norm(np.diff(points, axis=0)))])


def longest_sides(triangles: Array) -> Array:
    """Lengths (m,) of the longest sides of triangles (m, 3, 3)."""
    sides = norm(triangles[:, [1, 2, 0]] - triangles)
    return np.asarray(np.max(sides, axis=1, initial=0.0))


def double_areas(triangles: Array) -> Array:
    """Normals (m, 3) with a length of twice the area."""
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def shapes(corners: Array) -> tuple[Array, Array]:
    """Unit normals (m, 3) and sines (m,) of the smallest angles of triangles (m, 3, 3)."""
    normals = double_areas(corners)
    area = norm(normals)
    sides = np.sort(norm(corners[:, [1, 2, 0]] - corners), axis=1)
    sines = area / np.maximum(sides[:, 1] * sides[:, 2], 1e-300)
    return normals / np.maximum(area, 1e-300)[:, None], sines


def altitudes(triangles: Array) -> Array:
    """Smallest altitudes (m,)."""
    longest = longest_sides(triangles)
    quotient = norm(double_areas(triangles)) / np.where(longest > 0.0, longest, 1.0)
    return np.asarray(quotient, dtype=np.float64)


def vertex_normals(points: Array, cells: Integers) -> Array:
    """Unit normals (n, 3) at vertices, of the cells around weighted by their angles: so a line over
    an edge turns by the same angle as when both cells lie in one plane."""
    corners = points[cells]
    normals = double_areas(corners)
    normals /= norm(normals)[:, None]
    total = np.zeros_like(points)
    for k in range(3):
        u, v = (corners[:, (k + i) % 3] - corners[:, k] for i in (1, 2))
        angle = np.arctan2(norm(cross(u, v)), dot(u, v))
        for i in range(3):
            total[:, i] += np.bincount(cells[:, k], angle * normals[:, i], len(points))
    size = norm(total)
    return np.asarray(total / np.where(size > 0.0, size, 1.0)[:, None])


def side_turns(places: Array, normals: Array) -> Array:
    """Angles (k,) by which a polyline (k, 3) turns sideways at its points on a surface with unit
    normals (k, 3); zero at the ends."""
    steps = np.diff(places, axis=0)
    turns = np.zeros(len(places))
    before, after = steps[:-1], steps[1:]
    flat = [one - dot(one, normals[1:-1])[:, None] * normals[1:-1] for one in (before, after)]
    turns[1:-1] = np.arctan2(dot(cross(*flat), normals[1:-1]), dot(*flat))
    return turns


def closest_on_segments(start: Array, way: Array, place: Array) -> tuple[Array, Array, Array]:
    """Shares of the segments' ways (..., d) from their starts to the points closest to places,
    (...), these points (..., d) and their distances (...)."""
    square = (way * way).sum(axis=-1)
    share = ((place - start) * way).sum(axis=-1) / np.where(square > 0.0, square, 1.0)
    share = share.clip(0.0, 1.0)
    found = start + share[..., None] * way
    return share, found, np.sqrt(((found - place) ** 2).sum(axis=-1))


def closest(triangles: Array, target: Array) -> tuple[Array, Array, Array]:
    """Weights (m, 3), positions (m, 3) and distances (m,) of the points closest to `target`."""
    every = np.arange(len(triangles))
    target = np.broadcast_to(target, (len(triangles), 3))
    sides = triangles[:, [1, 2, 0]] - triangles
    t, on_sides, to_sides = closest_on_segments(triangles, sides, target[:, None])
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
    """Positions (m, 3) from weights (m, 3) of the corners of triangles (m, 3, 3)."""
    product = weights[:, :, None] * triangles
    mixed: Array = product[:, 0] + product[:, 1] + product[:, 2]
    return mixed


def flattened(triangles: Array) -> Array:
    """Projections of the triangles on the plane z = 0."""
    flat = triangles.copy()
    flat[..., 2] = 0.0
    return flat


def area_vectors(mesh: Any, cells: Any = slice(None)) -> Array:
    """Area vectors of stress-free cells, (n, 3); by default of all."""
    x = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
    return double_areas(np.asarray(x, dtype=float)) / 2


def cell_sides(mesh: Any, cells: Any = slice(None)) -> Array:
    """Side vectors of stress-free cells, from each corner to the next, (n, 3, 3)."""
    x: Array = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[cells]], dtype=float)
    return np.roll(x, -1, axis=1) - x


def cell_normals(mesh: Any, cells: Any = slice(None)) -> Array:
    """Unit normals of stress-free cells, (n, 3); by default of all, with ghosts."""
    normal = area_vectors(mesh, cells)
    return normal / np.linalg.norm(normal, axis=1)[:, None]


@dataclass(frozen=True)
class OpenEdges:
    """Edges where the volume contributions of pressurised cells do not cancel, on this rank."""

    numbers: Indices  # (n,) local numbers of the edges, owned and ghosts, sorted
    vertices: Indices  # (n, 2) their vertices by local degree of freedom
    # (n, 2) numbers of these vertices in the mesh as given, the lower one first
    ids: Integers
    senses: Array  # (n,) number of cells that run from the first vertex to the second, minus back


def open_edges(V: fem.FunctionSpace, pressed: Booleans) -> OpenEdges:
    """Edges where contributions of the pressurised cells (m,) do not cancel. Collective."""
    # Exact follower pressure has a potential only if these edges are held or slide in planes. Each
    # cell spans a volume with the origin, and volumes' side faces over an edge cancel if as many
    # cells run along the edge in one sense as in the other: not at the rim of the pressurised
    # cells, nor at a seam of three.
    mesh = V.mesh
    numbers = mesh.topology.connectivity(2, 1).array.reshape(-1, 3)
    ids = cell_vertex_ids(mesh)
    sides = np.stack([np.roll(np.arange(3), -1), np.roll(np.arange(3), -2)], axis=1)
    start, end = ids[:, sides[:, 0]], ids[:, sides[:, 1]]  # side k is opposite corner k
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
