"""Flat membranes: rectangle, ellipse, circle and polygon, with checked outlines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.meshes.gmsh_model import (
    add_rim_points,
    add_rows,
    embed_rows,
    mesh_with_sizes,
    own_model,
    read_model,
)
from crms_fenicsx.foundation.meshes.membrane_mesh import Ranks, mesh_generator
from crms_fenicsx.foundation.meshes.plan_lines import (
    Lines,
    Outline,
    PlanRows,
    PlanShape,
    rows_in,
)
from crms_fenicsx.foundation.meshes.refinement import (
    Length,
    PlanPoint,
    Refinement,
    TargetSize,
    check_size,
)
from crms_fenicsx.foundation.meshes.surface import SurfaceArrays
from crms_fenicsx.foundation.meshes.triangles import cross_in_plane
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.foundation.runtime.errors import InputError, MeshError


def _simple_outline(corners: Sequence[Sequence[float]]) -> Array:
    """Check the corners (n, 2) of a simple polygon, in the given order."""
    try:
        outline = np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError):
        outline = np.empty(0)
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise MeshError(f"the polygon's corners are {corners!r}; pass three or more points (x, y).")
    if not np.isfinite(outline).all():
        raise MeshError(f"the polygon's corners {corners!r} are not all finite.")
    following = np.roll(outline, -1, axis=0)
    along = following - outline
    bad = np.flatnonzero((along == 0).all(axis=1))
    if len(bad):
        raise MeshError(
            f"side {bad[0] + 1} of the polygon has no length, from and to "
            f"{tuple(outline[bad[0]].tolist())}; pass each corner once."
        )
    i, j = np.triu_indices(len(outline), k=1)
    adjacent = (j == i + 1) | ((i == 0) & (j == len(outline) - 1))
    straight = cross_in_plane(along[i], along[j]) == 0
    folds_back = straight & (np.einsum("ij,ij->i", along[i], along[j]) < 0)
    meet = _meet(outline[i], following[i], outline[j], following[j])
    bad = np.flatnonzero(np.where(adjacent, folds_back, meet))
    if len(bad):
        raise MeshError(
            f"sides {i[bad[0]] + 1} and {j[bad[0]] + 1} of the polygon intersect or touch; pass "
            "the corners in their order around it."
        )
    return outline


def _meet(a: Array, b: Array, c: Array, d: Array) -> Booleans:
    """Whether segments a-b and c-d have a point in common."""
    apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
    c_d_sides = cross_in_plane(b - a, c - a) * cross_in_plane(b - a, d - a)
    a_b_sides = cross_in_plane(d - c, a - c) * cross_in_plane(d - c, b - c)
    return ~apart.any(axis=1) & (c_d_sides <= 0) & (a_b_sides <= 0)


_CHORDS = 256  # of an ellipse, where lines end on it

RECTANGLE_SIDES = ("front", "right", "back", "left")
RECTANGLE_CORNERS = ("front left", "front right", "back right", "back left")


@mesh_generator
def rectangle(
    comm: MPI.Intracomm,
    width: Length,
    depth: Length,
    size: Length,
    *,
    corner: PlanPoint = (0.0, 0.0),
    structured: bool = False,
    refinements: Sequence[Refinement] = (),
    lines: Lines | None = None,
    ranks: Ranks | None = None,
) -> SurfaceArrays:
    """Mesh a rectangle in the plane z = 0.

    Its sides are the edge groups "left" and "right" (smallest and largest x), "front" and "back"
    (smallest and largest y); its corners are the point groups "front left" and so on.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective, and rank 0 holds the whole mesh first.
    width, depth
        Extents in x and y (length).
    size
        Edge length of the triangles (length).
    corner
        Coordinates (x, y) of the corner with the smallest x and y.
    structured
        Cut round(width / size) x round(depth / size) equal rectangles, each by its diagonal
        from lower left to upper right, instead of meshing freely.
    refinements
        Where to refine an unstructured mesh.
    lines
        Lines that an unstructured mesh follows, by name: points (x, y) of a polyline each, which
        may be (x, y, z). Each becomes an edge group, along which `Scene.lay_cable` lays a cable.
        Lines may cross, and end on the rim or on each other; ends up to 0.2 `size` away are moved
        there, as are ends on the rim to each other and to corners, and each move is logged.
    ranks
        Rank of each cell, as for `from_arrays`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, `size` is larger than a side, a
        structured mesh is given refinements or lines, or a line leaves the plan, ends inside, runs
        back, crosses itself, runs along the rim or within 0.02 of a cell beside another line, or
        has the name of another group.

    Examples
    --------
    >>> mesh = meshes.rectangle(MPI.COMM_WORLD, 4.0, 3.0, size=0.5, structured=True)
    >>> sorted(mesh.edges)
    ['back', 'boundary', 'front', 'left', 'right']
    >>> below = meshes.Refinement([(0.0, 1.5), (4.0, 1.5)], size=0.2, distance=1.0)
    >>> fine = meshes.rectangle(MPI.COMM_WORLD, 4.0, 3.0, size=0.5, refinements=[below])
    >>> cross = {"A1": [(0.0, 0.0), (4.0, 3.0)], "B1": [(0.0, 2.0), (4.0, 1.0)]}
    >>> mesh = meshes.rectangle(MPI.COMM_WORLD, 4.0, 3.0, size=0.5, lines=cross)
    >>> sorted(mesh.edges)
    ['A1', 'B1', 'back', 'boundary', 'front', 'left', 'right']
    """
    check_size("the rectangle", size, min(width, depth), width * depth)
    x, y = map(float, corner)
    if structured:
        if refinements:
            raise InputError(
                f"a structured rectangle cannot take {len(refinements)} refinement(s); "
                "use structured=False."
            )
        if lines:
            raise InputError(
                f"a structured rectangle cannot take {len(lines)} line(s); use structured=False."
            )
        return _structured(x, y, width, depth, size)
    corners = rectangle_corners(x, y, width, depth)
    target = TargetSize(size, refinements)
    rows = _rows_in_polygon("rectangle", corners, target, RECTANGLE_SIDES, lines)
    return _polygon_arrays(corners, target, RECTANGLE_SIDES, RECTANGLE_CORNERS, rows)


@mesh_generator
def ellipse(
    comm: MPI.Intracomm,
    a: Length,
    b: Length,
    size: Length,
    *,
    center: PlanPoint = (0.0, 0.0),
    refinements: Sequence[Refinement] = (),
    lines: Lines | None = None,
    ranks: Ranks | None = None,
) -> SurfaceArrays:
    """Mesh an ellipse in the plane z = 0; the ends of its axes are vertices.

    Parameters
    ----------
    a, b
        Semi-axes along x and y (length).
    size
        Edge length of the triangles (length).
    center
        Coordinates (x, y) of the centre.
    comm, refinements, lines, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, `size` is larger than a semi-axis,
        or lines are refused as by `rectangle`.

    Examples
    --------
    >>> mesh = meshes.ellipse(MPI.COMM_WORLD, a=3.0, b=2.0, size=1.0)
    >>> float(mesh.mesh.geometry.x[:, 0].max())
    3.0
    """
    check_size("the ellipse", size, min(a, b), math.pi * a * b)
    x, y = map(float, center)
    target = TargetSize(size, refinements)
    plan = PlanShape("ellipse", ellipse_outline(x, y, a, b), target)
    return ellipse_arrays(x, y, a, b, target, rows_in(plan, lines))


@mesh_generator
def circle(
    comm: MPI.Intracomm,
    radius: Length,
    size: Length,
    *,
    center: PlanPoint = (0.0, 0.0),
    refinements: Sequence[Refinement] = (),
    lines: Lines | None = None,
    ranks: Ranks | None = None,
) -> SurfaceArrays:
    """Mesh a circle in the plane z = 0; its points on the axes are vertices.

    Parameters
    ----------
    radius
        Radius (length).
    size
        Edge length of the triangles (length).
    center
        Coordinates (x, y) of the centre.
    comm, refinements, lines, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if an argument is not finite or positive, `size` is larger than the radius, or
        lines are refused as by `rectangle`.

    Examples
    --------
    >>> mesh = meshes.circle(MPI.COMM_WORLD, radius=2.0, size=1.0)
    >>> sorted(mesh.edges)
    ['boundary']
    """
    check_size("the circle", size, radius, math.pi * radius**2)
    x, y = map(float, center)
    target = TargetSize(size, refinements)
    plan = PlanShape("circle", ellipse_outline(x, y, radius, radius), target)
    return ellipse_arrays(x, y, radius, radius, target, rows_in(plan, lines))


@mesh_generator
def polygon(
    comm: MPI.Intracomm,
    corners: Sequence[Sequence[float]],
    size: Length,
    *,
    names: Sequence[str] | None = None,
    refinements: Sequence[Refinement] = (),
    lines: Lines | None = None,
    ranks: Ranks | None = None,
) -> SurfaceArrays:
    """Mesh a polygon in the plane z = 0.

    Its corners are the point groups "corner 1", "corner 2", and so on.

    Parameters
    ----------
    corners
        Coordinates (x, y) of the corners in order, in either sense.
    size
        Edge length of the triangles (length).
    names
        Names of the sides' edge groups, the first for the side from corner 1 to corner 2. Names may
        repeat; by default "side 1", "side 2", and so on.
    comm, refinements, lines, ranks
        As for `rectangle`.

    Raises
    ------
    InputError
        On all ranks, if there are fewer than three corners, a side has no length, sides intersect
        or touch, the numbers of names and sides differ, `size` is not positive or larger than the
        polygon's extent, or lines are refused as by `rectangle`.

    Examples
    --------
    >>> corners = [(0.0, 0.0), (5.0, 0.0), (4.0, 3.0), (0.0, 3.0)]
    >>> names = ["gutter", "gable", "wall", "gable"]
    >>> mesh = meshes.polygon(MPI.COMM_WORLD, corners, 1.0, names=names)
    >>> sorted(mesh.edges)
    ['boundary', 'gable', 'gutter', 'wall']
    >>> sorted(mesh.points)
    ['corner 1', 'corner 2', 'corner 3', 'corner 4']
    """
    outline = _simple_outline(corners)
    if not isinstance(names, Sequence | None):
        raise InputError(f"the names of the polygon's sides are {names!r}; pass a list.")
    sides = [f"side {k}" for k in range(1, len(outline) + 1)] if names is None else list(names)
    if len(sides) != len(outline):
        raise InputError(
            f"there are {len(sides)} names for the {len(outline)} sides of the polygon; pass "
            "one for each."
        )
    for name in sides:
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"a side of the polygon has the name {name!r}; pass a string.")
    x, y = outline.T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    check_size("the polygon", size, float(np.ptp(outline, axis=0).min()), area)
    corner_names = [f"corner {k}" for k in range(1, len(outline) + 1)]
    target = TargetSize(size, refinements)
    rows = _rows_in_polygon("polygon", outline, target, sides, lines)
    return _polygon_arrays(outline, target, sides, corner_names, rows)


def ellipse_outline(x: float, y: float, a: float, b: float) -> Outline:
    """The rim of an ellipse, whose axes end at vertices."""
    angle = np.arange(_CHORDS) * (2.0 * np.pi / _CHORDS)
    corners = np.column_stack([x + a * np.cos(angle), y + b * np.sin(angle)])

    def exact(points: Array) -> Array:
        return _to_the_rim((x, y), (a, b), points.T, np.ones(len(points), dtype=bool)).T

    return Outline(corners, np.arange(0, _CHORDS, _CHORDS // 4), exact)


def ellipse_arrays(
    x: float, y: float, a: float, b: float, target: Callable[[Array], float], rows: PlanRows
) -> SurfaceArrays:
    """Mesh an ellipse about (x, y) with gmsh; `target` as for `mesh_with_sizes`, and `rows` by the
    places of `ellipse_outline`."""
    with own_model() as gmsh:
        geometry = gmsh.model.geo
        middle = geometry.addPoint(x, y, 0.0)
        ends = [
            geometry.addPoint(x + u * a, y + v * b, 0.0)
            for u, v in ((1, 0), (0, 1), (-1, 0), (0, -1))
        ]
        rim = {k * _CHORDS / 4: ends[k] for k in range(4)}
        add_rim_points(geometry, rows, rim)
        around = [rim[place] for place in sorted(rim)]
        major = ends[0] if a >= b else ends[1]
        arcs = [
            geometry.addEllipseArc(one, middle, major, other)
            for one, other in zip(around, around[1:] + around[:1], strict=True)
        ]
        surface = geometry.addPlaneSurface([geometry.addCurveLoop(arcs)])
        edges = add_rows(geometry, rows, rim)
        geometry.synchronize()
        embed_rows(gmsh, edges, surface)
        mesh_with_sizes(gmsh, target)
        arrays = read_model(gmsh)

    return replace(arrays, project=partial(_to_the_rim, (x, y), (a, b)))


def _to_the_rim(
    center: tuple[float, float], axes: tuple[float, float], points: Array, on_rim: Booleans
) -> Array:
    """Move those of the points (3, n) that are `on_rim` (n,) to the rim of an ellipse."""
    (x, y), (a, b), moved = center, axes, points.copy()
    offset = points[:2, on_rim] - [[x], [y]]
    moved[:2, on_rim] = [[x], [y]] + offset / np.hypot(offset[0] / a, offset[1] / b)
    return moved


def rectangle_corners(x: float, y: float, width: float, depth: float) -> Array:
    """Corners of a rectangle in the order of `RECTANGLE_CORNERS`, (4, 2)."""
    return np.array([(x, y), (x + width, y), (x + width, y + depth), (x, y + depth)])


def _structured(x: float, y: float, width: float, depth: float, size: float) -> SurfaceArrays:
    nx, ny = max(round(width / size), 1), max(round(depth / size), 1)
    points = np.stack(
        np.meshgrid(np.linspace(x, x + width, nx + 1), np.linspace(y, y + depth, ny + 1)), axis=-1
    ).reshape(-1, 2)
    grid = np.arange(len(points)).reshape(ny + 1, nx + 1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    cells = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    lines = dict(zip(RECTANGLE_SIDES, (grid[0], grid[:, -1], grid[-1], grid[:, 0]), strict=True))
    edges = {name: np.column_stack([line[:-1], line[1:]]) for name, line in lines.items()}
    corners = zip(RECTANGLE_CORNERS, grid[[0, 0, -1, -1], [0, -1, -1, 0]], strict=True)
    return SurfaceArrays(
        points, cells, edges, point_groups={name: np.array([k]) for name, k in corners}
    )


def _rows_in_polygon(
    call: str, corners: Array, target: TargetSize, sides: Sequence[str], lines: Lines | None
) -> PlanRows:
    outline = Outline(corners, np.arange(len(corners)))
    return rows_in(PlanShape(call, outline, target, taken=sides), lines)


def _polygon_arrays(
    outline: Array,
    target: TargetSize,
    sides: Sequence[str],
    corner_names: Sequence[str],
    rows: PlanRows,
) -> SurfaceArrays:
    with own_model() as gmsh:
        geometry = gmsh.model.geo
        corners = [geometry.addPoint(x, y, 0.0) for x, y in outline]
        rim = {float(k): corner for k, corner in enumerate(corners)}
        add_rim_points(geometry, rows, rim)
        places = sorted(rim)
        around = [rim[place] for place in places]
        lines = [
            geometry.addLine(a, b) for a, b in zip(around, around[1:] + around[:1], strict=True)
        ]
        surface = geometry.addPlaneSurface([geometry.addCurveLoop(lines)])
        edges = add_rows(geometry, rows, rim)
        geometry.synchronize()
        for name in dict.fromkeys(sides):
            members = [
                line for line, place in zip(lines, places, strict=True) if sides[int(place)] == name
            ]
            gmsh.model.addPhysicalGroup(1, members, name=name)
        for name, point in zip(corner_names, corners, strict=True):
            gmsh.model.addPhysicalGroup(0, [point], name=name)
        embed_rows(gmsh, edges, surface)
        mesh_with_sizes(gmsh, target)
        return read_model(gmsh)
