"""Membranes with a curved stress-free shape: spherical cap and air hall."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.meshes.edge_table import line_of
from crms_fenicsx.foundation.meshes.gmsh_model import (
    add_rows,
    embed_rows,
    mesh_with_sizes,
    own_model,
    read_model,
)
from crms_fenicsx.foundation.meshes.membrane_mesh import Ranks, mesh_generator
from crms_fenicsx.foundation.meshes.plan_lines import (
    SAMPLES,
    Lines,
    Outline,
    PlanRows,
    PlanShape,
    rows_in,
    tell_turns,
)
from crms_fenicsx.foundation.meshes.plane import (
    RECTANGLE_CORNERS,
    RECTANGLE_SIDES,
    ellipse_arrays,
    ellipse_outline,
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
from crms_fenicsx.foundation.runtime.errors import MeshError


@mesh_generator
def spherical_cap(
    comm: MPI.Intracomm,
    radius: Length,
    height: Length,
    size: Length,
    *,
    center: PlanPoint = (0.0, 0.0),
    refinements: Sequence[Refinement] = (),
    lines: Lines | None = None,
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
    lines
        As for `rectangle`, but along great circles between their points: (x, y) on the part of the
        cap that faces up, or (x, y, z), projected from the sphere's centre. The rows of vertices
        lie on the great circles.
    comm, refinements, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, `size` is larger than `radius`, or
        lines are refused as by `rectangle`.

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

    def flattened(given: Array) -> Array:
        """Put a line (k, 2) or (k, 3) into the plane, along great circles."""
        ball, middle = diameter / 2, height - diameter / 2
        way = given[:, :2] - origin[:2]
        if given.shape[1] == 2:
            aside = np.minimum(np.hypot(*way.T) / ball, 1.0)
            up = ball * np.sqrt(1.0 - aside**2)
        else:
            up = given[:, 2] - middle
        way = _great_circles(np.column_stack([way, up]), ball, target.least / SAMPLES)
        return way[:, :2] / (0.5 + way[:, 2:] / diameter)

    rim = diameter * height / radius
    plan = PlanShape("spherical_cap", ellipse_outline(0.0, 0.0, rim, rim), flat_size)
    rows = rows_in(plan, lines, flattened)
    arrays = ellipse_arrays(0.0, 0.0, rim, rim, flat_size, rows)
    points = lifted(np.asarray(arrays.points))
    points[np.abs(points[:, 2]) < 1e-10 * diameter, 2] = 0.0

    project = functools.partial(_onto_sphere, (x, y), radius, height)
    return SurfaceArrays(points, arrays.cells, arrays.edges, project=project)


def _great_circles(points: Array, radius: float, step: float) -> Array:
    """Points at most a `step` apart on great circles between points (k, 3), whatever their
    distances from the sphere's centre, the origin."""
    far = np.abs(points).max(axis=1)
    if not np.all((far > 0.0) & (far < 1e6 * radius)):
        raise MeshError(
            "spherical_cap: a line has a point in the sphere's centre, or much too far away; pass "
            "points near the cap."
        )
    points = points / np.linalg.norm(points, axis=1)[:, None]
    found = [points[:1]]
    for start, end in pairwise(points):
        angle = 2.0 * math.atan2(*np.linalg.norm([end - start, end + start], axis=1))
        if math.sin(angle) < 1e-6 and angle > 1.0:
            raise MeshError(
                "spherical_cap: a line has two points in a row on opposite sides of the sphere; "
                "pass a point between them."
            )
        t = np.linspace(0.0, angle, math.ceil(radius * angle / step) + 1)[1:, None]
        found.append((np.sin(angle - t) * start + np.sin(t) * end) / math.sin(angle))
    return radius * np.concatenate(found)


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
    lines: Lines | None = None,
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
    lines
        As for `rectangle`: straight in plan between their points. The rows of vertices lie on the
        surface above. They turn sideways on it where a straight line in plan does, unless it runs
        along a ridge or across it at right angles; turns of more than 0.5 degrees are logged.
    comm, refinements, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, `size` is larger than a side, or
        lines are refused as by `rectangle`.

    Examples
    --------
    >>> mesh = meshes.air_hall(MPI.COMM_WORLD, 12.0, 8.0, height=4.0, size=2.0)
    >>> sorted(mesh.edges)
    ['back', 'boundary', 'front', 'left', 'right']
    """
    area = width * depth + 2.0 * height * (width + depth)
    check_size("the air hall", size, min(width, depth), area)
    x, y = map(float, corner)
    target, corners = TargetSize(size, refinements), rectangle_corners(x, y, width, depth)

    def lifted(plan: Array) -> Array:
        """Points (n, 3) of the hall above points (n, 2)."""
        aside = np.minimum(plan - corners[0], corners[2] - plan).clip(min=0.0)
        end = min(width, depth) / 2
        rise = np.sqrt(1.0 - (1.0 - np.minimum(aside, end) / end) ** 2)
        return np.column_stack([plan, height * rise[:, 0] * rise[:, 1]])

    outline = Outline(corners, np.arange(4))
    rows = rows_in(PlanShape("air_hall", outline, target, lifted, RECTANGLE_SIDES), lines)
    with own_model() as gmsh:
        surface = _add_hall(gmsh, x, y, width, depth, height)
        if rows.rows:
            _add_lines(gmsh, surface, rows)
        _name_hall(gmsh, corners)
        mesh_with_sizes(gmsh, target)
        arrays = read_model(gmsh)
    points = np.array(arrays.points)
    # the kernel's parametric curves miss the plan's sides by rounding
    sides = {"left": (0, x), "right": (0, x + width), "front": (1, y), "back": (1, y + depth)}
    for name, (axis, value) in sides.items():
        points[np.unique(np.asarray(arrays.edges[name])), axis] = value
    found = {
        name: line_of([(int(a), int(b)) for a, b in np.asarray(arrays.edges[name])])[0]
        for name in rows.rows
    }
    tell_turns("air_hall", points, np.asarray(arrays.cells), found)
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


def _add_hall(gmsh: Any, x: float, y: float, width: float, depth: float, height: float) -> int:
    """Add the hall as one rational B-spline surface, which is exact."""
    end = min(width, depth) / 2
    along_x, rise_x, weight_x, knots_x, multiplicity_x = _profile(width, end)
    along_y, rise_y, weight_y, knots_y, multiplicity_y = _profile(depth, end)
    kernel = gmsh.model.occ
    control = [
        kernel.addPoint(x + u, y + v, height * p * q)
        for v, q in zip(along_y, rise_y, strict=True)
        for u, p in zip(along_x, rise_x, strict=True)
    ]
    surface: int = kernel.addBSplineSurface(
        control, len(along_x), degreeU=2, degreeV=2, knotsU=knots_x, knotsV=knots_y,
        weights=np.outer(weight_y, weight_x).ravel().tolist(),
        multiplicitiesU=multiplicity_x, multiplicitiesV=multiplicity_y,
    )  # fmt: skip
    kernel.remove([(0, point) for point in control])
    kernel.synchronize()
    return surface


def _add_lines(gmsh: Any, surface: int, rows: PlanRows) -> None:
    """Divide the hall's rim at the ends of lines, and embed these."""
    kernel = gmsh.model.occ
    tags = [(0, kernel.addPoint(*rows.points[vertex])) for vertex in rows.places]
    _, (whole, *parts) = kernel.fragment([(2, surface)], tags)
    rim = {place: part[0][1] for place, part in zip(rows.places.values(), parts, strict=True)}
    edges = add_rows(kernel, rows, rim)
    kernel.synchronize()
    embed_rows(gmsh, edges, whole[0][1])


def _name_hall(gmsh: Any, corners: Array) -> None:
    """Name the sides and the corners of the hall's rim."""
    (surface,) = gmsh.model.getEntities(2)

    def middles(dim: int) -> tuple[list[int], Array]:
        """The parts of the rim, and where their middles are in the plan."""
        tags = [abs(tag) for _, tag in gmsh.model.getBoundary([surface], recursive=dim == 0)]
        boxes = np.array([gmsh.model.getBoundingBox(dim, tag) for tag in tags])
        return tags, (boxes[:, :2] + boxes[:, 3:5]) / 2

    tags, places = middles(1)
    gaps = np.abs(places[:, [1, 0, 1, 0]] - corners[range(4), [1, 0, 1, 0]])  # from the side's line
    nearest = gaps.argmin(axis=1)
    for k in dict.fromkeys(nearest.tolist()):
        members = [tag for tag, own in zip(tags, nearest, strict=True) if own == k]
        gmsh.model.addPhysicalGroup(1, members, name=RECTANGLE_SIDES[k])
    tags, places = middles(0)
    for name, corner in zip(RECTANGLE_CORNERS, corners, strict=True):
        nearest = np.linalg.norm(places - corner, axis=1).argmin()
        gmsh.model.addPhysicalGroup(0, [tags[nearest]], name=name)


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
