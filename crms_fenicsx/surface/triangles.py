"""Geometry of many triangles at once.

Everything is elementwise, so that a part of a mesh rounds as the whole.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Cells whose projection keeps less than this part of their area are walls.
WALL = 1e-6


def vectors(rows: Floats) -> list[Floats]:
    """Return the rows of an array, for loops."""
    return [rows[i] for i in range(len(rows))]


def lists(rows: Ints) -> list[list[int]]:
    """Return the rows of an array as lists of Python integers."""
    return cast(list[list[int]], rows.tolist())


def norm(a: Floats) -> Floats:
    """Return the lengths of the vectors in the last axis."""
    return np.asarray(np.sqrt(dot(a, a)), dtype=np.float64)


def cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products of the vectors in the last axes."""
    # by components: the library's cross product takes longer to set up than to compute
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


def dot(a: Floats, b: Floats) -> Floats:
    """Return the scalar products of the vectors in the last axes."""
    total = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return np.asarray(total, dtype=np.float64)


def side_lengths(triangles: Floats) -> Floats:
    """Return (m, 3) lengths of the sides of (m, 3, 3) triangles."""
    return norm(triangles[:, [1, 2, 0]] - triangles)


def longest_sides(triangles: Floats) -> Floats:
    """Return (m,) lengths of the longest sides."""
    return np.asarray(np.max(side_lengths(triangles), axis=1, initial=0.0))


def double_areas(triangles: Floats) -> Floats:
    """Return (m, 3) normals, as long as twice the area."""
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def altitudes(triangles: Floats) -> Floats:
    """Return (m,) smallest altitudes."""
    longest = longest_sides(triangles)
    quotient = norm(double_areas(triangles)) / np.where(longest > 0.0, longest, 1.0)
    return np.asarray(quotient, dtype=np.float64)


def balls(triangles: Floats) -> tuple[Floats, Floats]:
    """Return (m, 3) centres and (m,) radii of balls around the triangles."""
    centre = np.asarray(triangles.sum(axis=1) / 3.0, dtype=np.float64)
    return centre, np.asarray(np.max(norm(triangles - centre[:, None]), axis=1, initial=0.0))


def closest(triangles: Floats, target: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the places nearest to `target`, (3,) or (m, 3), in each of (m, 3, 3) triangles.

    As (m, 3) weights of the corners, (m, 3) positions and (m,) distances. In slivers the weights
    are badly conditioned, the positions and distances are not.
    """
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


def mix(weights: Floats, triangles: Floats) -> Floats:
    """Return (m, 3) positions from (m, 3) weights of the corners of (m, 3, 3) triangles."""
    product = weights[:, :, None] * triangles
    mixed: Floats = product[:, 0] + product[:, 1] + product[:, 2]
    return mixed


def flattened(triangles: Floats) -> Floats:
    """Return the triangles' plans: z = 0."""
    flat = triangles.copy()
    flat[..., 2] = 0.0
    return flat
