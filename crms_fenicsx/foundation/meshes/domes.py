"""Membranes with a curved stress-free shape: spherical cap and air hall."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.meshes.gmsh_model import mesh_with_sizes, own_model, read_model
from crms_fenicsx.foundation.meshes.membrane_mesh import Ranks, mesh_generator
from crms_fenicsx.foundation.meshes.plane import (
    RECTANGLE_CORNERS,
    RECTANGLE_SIDES,
    ellipse_arrays,
    rectangle_corners,
)
from crms_fenicsx.foundation.meshes.refinement import (
    Length,
    PlanPoint,
    Refinement,
    TargetSize,
    check_size,
)
from crms_fenicsx.foundation.meshes.surface import SurfaceArrays
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans


@mesh_generator
def spherical_cap(
    comm: MPI.Intracomm,
    radius: Length,
    height: Length,
    size: Length,
    *,
    center: PlanPoint = (0.0, 0.0),
    refinements: Sequence[Refinement] = (),
    ranks: Ranks | None = None,
) -> SurfaceArrays:
    """Mesh a spherical cap with its rim in the plane z = 0.

    A flat circle is meshed and mapped to the sphere by stereographic projection. It is conformal,
    so the triangles keep their quality, and there is no seam.

    Parameters
    ----------
    radius
        Radius of the rim, not of the sphere (length).
    height
        Height of the top above the rim (length); larger than `radius` for more than a hemisphere.
    size
        Edge length of the triangles (length).
    center
        Coordinates (x, y) of the rim's centre.
    comm, refinements, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, or `size` is larger than `radius`.

    Examples
    --------
    >>> mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=10.0, height=5.0, size=4.0)
    >>> sorted(mesh.edges)
    ['boundary']
    """
    check_size("the spherical cap", size, radius, math.pi * (radius**2 + height**2))
    x, y = map(float, center)
    origin = np.array([x, y, 0.0])
    diameter = (radius**2 + height**2) / height  # of the sphere
    target = TargetSize(size, refinements)

    def lifted(flat: Array) -> Array:
        """Project points of the plane tangent at the top from the sphere's lowest point."""
        shrink = 1.0 / (1.0 + (flat[..., :1] ** 2 + flat[..., 1:2] ** 2) / diameter**2)
        rise = height - diameter * (1.0 - shrink)
        up: Array = np.concatenate([flat[..., :2] * shrink, rise], axis=-1)
        return origin + up

    def flat_size(flat: Array) -> float:
        return target(lifted(flat)) * (1.0 + float(flat[:2] @ flat[:2]) / diameter**2)

    rim = diameter * height / radius
    arrays = ellipse_arrays(0.0, 0.0, rim, rim, flat_size)
    points = lifted(np.asarray(arrays.points))
    points[np.abs(points[:, 2]) < 1e-10 * diameter, 2] = 0.0

    project = functools.partial(_onto_sphere, (x, y), radius, height)
    return SurfaceArrays(points, arrays.cells, project=project)


def _onto_sphere(
    center: tuple[float, float], radius: float, height: float, points: Array, on_rim: Booleans
) -> Array:
    """Move points (3, n) to a spherical cap, those marked `on_rim` (n,) to its rim."""
    below = (height**2 - radius**2) / (2 * height)  # z of the sphere's centre
    foot = np.array([[center[0]], [center[1]], [0.0]])
    middle = foot + np.where(on_rim, 0.0, [[0.0], [0.0], [below]])
    reach = np.where(on_rim, radius, (radius**2 + height**2) / (2 * height))
    return np.asarray(middle + reach * (points - middle) / np.linalg.norm(points - middle, axis=0))


@mesh_generator
def air_hall(
    comm: MPI.Intracomm,
    width: Length,
    depth: Length,
    height: Length,
    size: Length,
    *,
    corner: PlanPoint = (0.0, 0.0),
    refinements: Sequence[Refinement] = (),
    ranks: Ranks | None = None,
) -> SurfaceArrays:
    """Mesh an air hall: a half-cylinder with rounded ends over a rectangle in z = 0.

    With c = min(width, depth) / 2, and the distances u, v of a point of the plan from the nearer
    side in x and in y, the surface is ::

        z = height f(u) f(v),    f(s) = sqrt(1 - (1 - s / c)^2) for s < c,  1 for s >= c.

    Its sections are half ellipses (half circles for height = c) that rise vertically from the
    ground; horizontal sections have corners that are rounder the higher they are, as in
    air-supported sports halls. The surface is smooth except at the four corners, where it is a
    cone, and where the ends meet the half-cylinder, where the curvature jumps.

    Edge and point groups are those of `rectangle`.

    Parameters
    ----------
    width, depth
        Extents of the plan in x and y (length).
    height
        Height of the top (length).
    size
        Edge length of the triangles (length).
    corner
        Coordinates (x, y) of the corner of the plan with the smallest x and y.
    comm, refinements, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, or `size` is larger than a side.

    Examples
    --------
    >>> mesh = meshes.air_hall(MPI.COMM_WORLD, 12.0, 8.0, height=4.0, size=2.0)
    >>> sorted(mesh.edges)
    ['back', 'boundary', 'front', 'left', 'right']
    """
    area = width * depth + 2.0 * height * (width + depth)
    check_size("the air hall", size, min(width, depth), area)
    x, y = map(float, corner)
    with own_model() as gmsh:
        _add_hall(gmsh, x, y, width, depth, height)
        mesh_with_sizes(gmsh, TargetSize(size, refinements))
        arrays = read_model(gmsh)
    points = np.array(arrays.points)
    # the kernel's parametric curves miss the plan's sides by rounding
    lines = {"left": (0, x), "right": (0, x + width), "front": (1, y), "back": (1, y + depth)}
    for name, (axis, value) in lines.items():
        points[np.unique(np.asarray(arrays.edges[name])), axis] = value
    project = functools.partial(_onto_hall, (x, y), (width, depth), height)
    return SurfaceArrays(points, arrays.cells, arrays.edges, {}, arrays.point_groups, project)


def _onto_hall(
    corner: Sequence[float], sides: Sequence[float], height: float, points: Array, on_rim: Booleans
) -> Array:
    """Move points (3, n) to the hall, along gradients of ``f(u)^2 f(v)^2 - (z / height)^2``."""
    end, moved = min(sides) / 2, points[:, ~on_rim]
    for _ in range(8):  # Newton's method, starting close to the surface
        centre = [(c + side / 2) for c, side in zip(corner, sides, strict=True)]
        aside = [moved[i] - centre[i] for i in (0, 1)]
        a, b = (
            np.maximum(np.abs(r) - s / 2 + end, 0.0) / end
            for r, s in zip(aside, sides, strict=True)
        )
        value = (1 - a**2) * (1 - b**2) - (moved[2] / height) ** 2
        slope = np.stack([
            -2 * a * (1 - b**2) * np.sign(aside[0]) / end,
            -2 * b * (1 - a**2) * np.sign(aside[1]) / end,
            -2 * moved[2] / height**2,
        ])  # fmt: skip
        moved = moved - slope * value / np.maximum((slope**2).sum(axis=0), 1e-300)
    onto = points.copy()
    onto[:, ~on_rim] = moved
    return onto


def _add_hall(gmsh: Any, x: float, y: float, width: float, depth: float, height: float) -> None:
    """Add the hall as one rational B-spline surface, which is exact, with its groups."""
    end = min(width, depth) / 2
    along_x, rise_x, weight_x, knots_x, multiplicity_x = _profile(width, end)
    along_y, rise_y, weight_y, knots_y, multiplicity_y = _profile(depth, end)
    kernel = gmsh.model.occ
    control = [
        kernel.addPoint(x + u, y + v, height * p * q)
        for v, q in zip(along_y, rise_y, strict=True)
        for u, p in zip(along_x, rise_x, strict=True)
    ]
    surface = kernel.addBSplineSurface(
        control, len(along_x), degreeU=2, degreeV=2, knotsU=knots_x, knotsV=knots_y,
        weights=np.outer(weight_y, weight_x).ravel().tolist(),
        multiplicitiesU=multiplicity_x, multiplicitiesV=multiplicity_y,
    )  # fmt: skip
    kernel.remove([(0, point) for point in control])
    kernel.synchronize()
    corners = rectangle_corners(x, y, width, depth)
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    for dim, places, names in ((1, middles, RECTANGLE_SIDES), (0, corners, RECTANGLE_CORNERS)):
        for _, tag in gmsh.model.getBoundary([(2, surface)], recursive=dim == 0):
            low, high = np.array(gmsh.model.getBoundingBox(dim, abs(tag))).reshape(2, 3)
            offset = places - (low + high)[:2] / 2
            nearest = int(np.argmin(np.einsum("ij,ij->i", offset, offset)))
            gmsh.model.addPhysicalGroup(dim, [abs(tag)], name=names[nearest])


def _profile(
    length: float, end: float
) -> tuple[list[float], list[float], list[float], list[int], list[int]]:
    """Control points, heights, weights, knots and multiplicities of a profile of height 1."""
    w = math.sqrt(0.5)
    if length - 2 * end <= 1e-9 * length:
        middle = length / 2
        along = [0.0, 0.0, middle, length, length]
        return along, [0.0, 1.0, 1.0, 1.0, 0.0], [1.0, w, 1.0, w, 1.0], [0, 1, 2], [3, 2, 3]
    along = [0.0, 0.0, end, length / 2, length - end, length, length]
    rise = [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    return along, rise, [1.0, w, 1.0, 1.0, 1.0, w, 1.0], [0, 1, 2, 3], [3, 2, 2, 3]
