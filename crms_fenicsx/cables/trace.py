"""Tracing: the path of a cable from a route given in plan or in space.

Each leg of a route is the section of the surface with one plane. Which edges and vertices that
section meets is decided once, by the sign of every vertex's distance to the plane, with a small
neighbourhood of the plane counted as zero; after that no coordinate can contradict it. A leg is
then the shortest way from its start to its end within its section.
"""

from __future__ import annotations

import heapq
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import NoReturn

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.cables.path import (
    CellPoint,
    EdgePoint,
    Path,
    SurfacePoint,
    VertexPoint,
    without_backtracking,
)
from crms_fenicsx.errors import PathError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# A point in space counts as lying on the surface up to this part of the local mesh size: a
# faceted dome of three cells per radius is nowhere farther from the smooth one.
ON_SURFACE = 0.1

# Cells whose projection keeps less than this part of their area are walls.
WALL = 1e-6

# A fraction that rounding has put on a vertex, where the signs say that it is not, goes here.
LEAST, MOST = float(np.finfo(float).tiny), float(1.0 - np.finfo(float).epsneg)

# Nodes of a section: (vertex,), (smaller, larger) for an edge, and the two ends of a leg where
# they are neither.
Node = tuple[int, ...]
START: Node = (-1,)
END: Node = (-2,)


def trace(
    vertices: ArrayLike,
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    snap: float = 1e-3,
) -> Path:
    """Return the path that a cable takes over the surface along a route.

    Parameters
    ----------
    vertices
        (n,) global ids of the vertices, each once.
    points
        (n, 3) their current positions (length).
    cells
        (m, 3) rows of `points` that make up each triangle. For a route in space all cells are
        oriented alike.
    route
        (k, 2) points in plan: legs are the surface's sections with vertical planes, and points
        lie on the uppermost sheet. Or (k, 3) points in space: points go to the nearest place of
        the surface, and the plane of a leg holds both its ends and the mean of the surface's
        normals there, so that a turned surface has the same path, turned.
        In space, a first or last point beyond the boundary is an anchor: the path begins where
        the leg's section first meets the boundary, seen from the anchor.
    snap
        Vertices nearer to a section than this part of the smallest altitude of the cells around
        them count as lying in it; route points as near to a vertex or an edge lie on it.

    Returns
    -------
    A valid path. Corners of the route that lie inside cells are cut off: the points where it
    enters and leaves such a cell are linked, or cancel where it leaves as it came.

    Raises
    ------
    PathError
        The input is no surface or no route, the route leaves the membrane, or its legs have no
        section; the message names the place.
    """
    surface = _Surface.checked(vertices, points, cells)
    course = _checked_route(route, snap)
    if course.shape[1] == 2:
        places = [_place_in_plan(surface, xy, i, snap) for i, xy in enumerate(_vectors(course))]
    else:
        places = _places_in_space(surface, course, snap)
    found: list[SurfacePoint] = []
    for i, (first, last) in enumerate(pairwise(places)):
        leg = _leg_points(surface, first, last, f"leg {i} of the route", snap)
        if found and isinstance(found[-1], CellPoint):  # a corner inside a cell is cut off
            found, leg = found[:-1], leg[1:]
        found += leg
    kept = without_backtracking(found, surface.ids[surface.cells])
    if len(kept) < 2:
        raise PathError(
            f"a route with {len(course)} points meets the membrane in one place only, or turns "
            f"back on itself until nothing is left (near {_text(places[0].position)}); "
            "move its points apart"
        )
    path = Path(
        kept,
        start_anchor=places[0].anchor,
        end_anchor=places[-1].anchor,
    )
    path.links(surface.ids[surface.cells])
    return path


def near_section(
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    snap: float = 1e-3,
    comm: MPI.Intracomm | None = None,
) -> Bools:
    """Mark the cells that `trace` needs: it finds the same path on them as on the whole mesh.

    Parameters
    ----------
    points
        (n, 3) current positions (length).
    cells
        (m, 3) rows of `points` that make up each triangle; with `comm` the cells that this rank
        owns, none or some.
    route, snap
        As for `trace`.
    comm
        The ranks among which the mesh is divided; then the call is collective and all give
        the same route.

    Returns
    -------
    (m,) mask. A strip along every leg's plane, across the whole mesh, and the cells nearest to
    each route point.

    Raises
    ------
    PathError
        As `trace`, for a bad route; on all ranks.
    """
    course = _checked_route(route, snap)
    x = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    rows = np.asarray(cells, dtype=np.int64).reshape(-1, 3)
    size = float(np.max(_longest(x[rows]), initial=0.0))
    if comm is not None:
        size = comm.allreduce(size, op=MPI.MAX)
    mask = np.zeros(len(rows), dtype=np.bool_)
    up = np.array([0.0, 0.0, 1.0])
    if course.shape[1] == 2:
        ends = np.column_stack([course, np.zeros(len(course))])
        for a, b in pairwise(_vectors(ends)):
            mask |= _strip(_Plane.of(a, b, up, up), x, rows, snap * size)
        flat = _flattened(x[rows])
        centre, radius = _balls(flat)
        for target in _vectors(ends):  # what trace names when the route leaves the membrane
            least = float(np.min(_norm(flat - target), initial=np.inf))
            if comm is not None:
                least = comm.allreduce(least, op=MPI.MIN)
            mask |= _norm(centre - target) - radius <= least * (1.0 + 1e-9)
        return mask
    feet = [_foot(x, rows, target, comm) for target in _vectors(course)]
    for target, foot in zip(_vectors(course), feet, strict=True):
        centre, radius = _balls(x[rows])
        nearest = _norm(centre - target) - radius
        # all around the vertices of the nearest cell, which make the normal
        mask |= nearest <= (foot.distance + foot.size) * (1.0 + 1e-9) + 2.0 * snap * size
    for i in range(len(course) - 1):
        # whether an end is an anchor depends on the boundary, which one rank may not see
        starts = [feet[i].position] + ([course[i]] if i == 0 else [])
        stops = [feet[i + 1].position] + ([course[i + 1]] if i == len(course) - 2 else [])
        for a in starts:
            for b in stops:
                if _norm(b - a) == 0.0:
                    continue
                with suppress(PathError):  # if this is the leg, trace says so
                    plane = _Plane.of(a, b, feet[i].normal, feet[i + 1].normal)
                    mask |= _strip(plane, x, rows, snap * size)
    return mask


# ---- input ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Surface:
    """A triangulated surface: global ids (n,), positions (n, 3), rows of both (m, 3)."""

    ids: Ints
    points: Floats
    cells: Ints
    size: float  # its longest edge

    @classmethod
    def checked(cls, vertices: ArrayLike, points: ArrayLike, cells: ArrayLike) -> _Surface:
        ids = np.asarray(vertices, dtype=np.int64)
        x = np.asarray(points, dtype=np.float64)
        rows = np.asarray(cells, dtype=np.int64)
        if ids.ndim != 1 or x.shape != (len(ids), 3):
            raise PathError(
                f"vertices of shape {ids.shape} with points of shape {x.shape}: give (n,) ids "
                "and (n, 3) positions"
            )
        if len(np.unique(ids)) != len(ids) or np.min(ids, initial=0) < 0:
            raise PathError("the vertices' global ids must not repeat or be negative")
        if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) == 0:
            raise PathError(f"cells of shape {rows.shape}: give (m, 3) rows of points, m > 0")
        if rows.min() < 0 or rows.max() >= len(ids):
            raise PathError(
                f"cells name rows {rows.min()} to {rows.max()} of {len(ids)} points; they index "
                "the arrays given, not the global ids"
            )
        bad = ~np.isfinite(x).all(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            raise PathError(f"vertex {ids[i]} is at {_text(x[i])}; positions must be finite")
        return cls(ids, x, rows, float(_longest(x[rows]).max()))


def _checked_route(route: ArrayLike, snap: float) -> Floats:
    if not 0.0 < snap <= 0.1:
        raise PathError(f"snap {snap} of a route: give a part of the mesh size, 0 < snap <= 0.1")
    try:
        course = np.asarray(route, dtype=np.float64)
    except (TypeError, ValueError):
        raise PathError(f"route {route!r}: give points (x, y) or (x, y, z), all alike") from None
    if course.ndim != 2 or course.shape[1] not in (2, 3) or len(course) < 2:
        raise PathError(
            f"a route of shape {course.shape}: give two or more points (x, y) or (x, y, z)"
        )
    for i, point in enumerate(_vectors(course)):
        if not np.isfinite(point).all():
            raise PathError(f"route point {i} is {_text(point)}; give finite coordinates")
        if i and np.array_equal(point, course[i - 1]):
            raise PathError(f"route points {i - 1} and {i} are both {_text(point)}; drop one")
    return course


def _text(position: Floats) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in position) + ")"


# ---- geometry of many triangles; elementwise, so that a part of a mesh rounds as the whole ------


def _vectors(rows: Floats) -> list[Floats]:
    return [rows[i] for i in range(len(rows))]


def _lists(rows: Ints) -> list[list[int]]:
    return [[int(v) for v in rows[i]] for i in range(len(rows))]


def _norm(a: Floats) -> Floats:
    return np.asarray(np.sqrt(_dot(a, a)), dtype=np.float64)


def _cross(a: Floats, b: Floats) -> Floats:
    # by components: the library's cross product takes longer to set up than to compute
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


def _dot(a: Floats, b: Floats) -> Floats:
    total = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return np.asarray(total, dtype=np.float64)


def _sides(triangles: Floats) -> Floats:
    """Return (m, 3) lengths of the sides of (m, 3, 3) triangles."""
    return _norm(triangles[:, [1, 2, 0]] - triangles)


def _longest(triangles: Floats) -> Floats:
    return np.asarray(np.max(_sides(triangles), axis=1, initial=0.0))


def _double_areas(triangles: Floats) -> Floats:
    """Return (m, 3) normals, as long as twice the area."""
    return _cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _altitudes(triangles: Floats) -> Floats:
    """Return (m,) smallest altitudes."""
    longest = _longest(triangles)
    quotient = _norm(_double_areas(triangles)) / np.where(longest > 0.0, longest, 1.0)
    return np.asarray(quotient, dtype=np.float64)


def _balls(triangles: Floats) -> tuple[Floats, Floats]:
    """Return (m, 3) centres and (m,) radii of balls around the triangles."""
    centre = np.asarray(triangles.sum(axis=1) / 3.0, dtype=np.float64)
    return centre, np.asarray(np.max(_norm(triangles - centre[:, None]), axis=1, initial=0.0))


def _closest(triangles: Floats, target: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the places nearest to `target` in each of (m, 3, 3) triangles.

    As (m, 3) weights of the corners, (m, 3) positions and (m,) distances. In slivers the weights
    are badly conditioned, the positions and distances are not.
    """
    every = np.arange(len(triangles))
    sides = triangles[:, [1, 2, 0]] - triangles
    square = _dot(sides, sides)
    t = _dot(target - triangles, sides) / np.where(square > 0.0, square, 1.0)
    t = np.clip(t, 0.0, 1.0)
    on_sides = triangles + t[..., None] * sides
    to_sides = _norm(on_sides - target)
    side = np.argmin(to_sides, axis=1)
    gaps, places, t = to_sides[every, side], on_sides[every, side], t[every, side]
    weights = np.zeros((len(triangles), 3))
    weights[every, side], weights[every, (side + 1) % 3] = 1.0 - t, t

    normal = _double_areas(triangles)
    square = _dot(normal, normal)
    to_corners = triangles - target
    opposite = _cross(to_corners[:, [1, 2, 0]], to_corners[:, [2, 0, 1]])
    inner = _dot(opposite, normal[:, None]) / np.where(square > 0.0, square, 1.0)[:, None]
    inside = (inner >= 0.0).all(axis=1) & (square > 0.0)
    weights[inside] = inner[inside] / inner[inside].sum(axis=1)[:, None]
    height = _dot(triangles[inside, 0] - target, normal[inside]) / square[inside]
    places[inside] = target + height[:, None] * normal[inside]
    gaps[inside] = _norm(places[inside] - target)
    return weights, places, gaps


def _mix(weights: Floats, triangles: Floats) -> Floats:
    """Return (m, 3) positions from (m, 3) weights of the corners of (m, 3, 3) triangles."""
    product = weights[:, :, None] * triangles
    mixed: Floats = product[:, 0] + product[:, 1] + product[:, 2]
    return mixed


# ---- places of the route on the surface ---------------------------------------------------------


@dataclass(frozen=True)
class _Place:
    """A route point: on the surface, or an anchor (then `point` is None)."""

    point: SurfacePoint | None
    position: Floats
    normal: Floats

    @property
    def anchor(self) -> tuple[float, float, float] | None:
        x, y, z = (float(c) for c in self.position)
        return None if self.point is not None else (x, y, z)


@dataclass(frozen=True)
class _Foot:
    """The place of a surface nearest to a point in space, in a cell of a certain size."""

    position: Floats
    distance: float
    normal: Floats
    size: float


def _place_in_plan(surface: _Surface, xy: Floats, index: int, snap: float) -> _Place:
    corners = surface.points[surface.cells][:, :, :2]
    reach = snap * surface.size
    near = np.flatnonzero(
        ((corners.min(axis=1) <= xy + reach) & (corners.max(axis=1) >= xy - reach)).all(axis=1)
    )
    triangles = surface.points[surface.cells[near]]
    flat, target = _flattened(triangles), np.array([xy[0], xy[1], 0.0])
    weights, _, gap = _closest(flat, target)
    floor = _norm(_double_areas(flat)) > WALL * _norm(_double_areas(triangles))
    holds = floor & (gap <= snap * _altitudes(flat))
    if not holds.any():
        _raise_outside(surface, xy, index)
    near, weights, triangles = near[holds], weights[holds], triangles[holds]
    heights = _mix(weights, triangles)[:, 2]
    top = surface.cells[near[np.argmax(heights)]]
    sheet = np.isin(surface.cells[near], top).any(axis=1)
    point, position = _locate(surface, near[sheet], _flattened(triangles[sheet]), target, snap)
    return _Place(point, position, np.array([0.0, 0.0, 1.0]))


def _flattened(triangles: Floats) -> Floats:
    flat = triangles.copy()
    flat[..., 2] = 0.0
    return flat


def _raise_outside(surface: _Surface, xy: Floats, index: int) -> NoReturn:
    triangles = surface.points[surface.cells]
    flat, target = _flattened(triangles), np.array([xy[0], xy[1], 0.0])
    weights, _, gap = _closest(flat, target)
    nearest = int(np.argmin(gap))
    place = _mix(weights[[nearest]], triangles[[nearest]])[0]
    raise PathError(
        f"route point {index} at {_text(xy)} leaves the membrane: it is {gap[nearest]:.6g} "
        f"outside of it in plan, nearest to {_text(place)}; move it there, or give the route in "
        "space to make its first or last point an anchor"
    )


def _locate(
    surface: _Surface, rows: Ints, triangles: Floats, target: Floats, snap: float
) -> tuple[SurfacePoint, Floats]:
    """Return the point of the surface at `target`, which all the cells `rows` hold or touch."""
    corners = surface.cells[rows]
    reach = snap * _altitudes(triangles)
    to_corner = _norm(triangles - target)
    to_corner = np.where(to_corner <= reach[:, None], to_corner, np.inf)
    if np.isfinite(to_corner).any():
        row = corners.ravel()[np.argmin(to_corner)]
        return VertexPoint(int(surface.ids[row])), surface.points[row].copy()
    best: tuple[float, Node, float, Floats] | None = None
    for cell, triangle, near in zip(_lists(corners), _vectors(triangles), reach, strict=True):
        for i, j in ((0, 1), (1, 2), (2, 0)):
            if surface.ids[cell[i]] > surface.ids[cell[j]]:
                i, j = j, i
            side = triangle[j] - triangle[i]
            t = float(_dot(target - triangle[i], side) / max(float(_dot(side, side)), 1e-300))
            gap = float(_norm(triangle[i] + t * side - target))
            edge = (int(surface.ids[cell[i]]), int(surface.ids[cell[j]]))
            if gap <= near and 0.0 < t < 1.0 and (best is None or (gap, edge) < best[:2]):
                ends = surface.points[[cell[i], cell[j]]]
                best = gap, edge, t, (1.0 - t) * ends[0] + t * ends[1]
    if best is not None:
        return EdgePoint((best[1][0], best[1][1]), best[2]), best[3]
    weights, _, gaps = _closest(triangles, target)
    nearest = int(np.argmin(gaps))
    position = _mix(weights[[nearest]], surface.points[corners[[nearest]]])[0]
    a, b, c = surface.ids[corners[nearest]].tolist()
    u, v, w = weights[nearest].tolist()
    return CellPoint((a, b, c), (u, v, w)), position


def _foot(points: Floats, cells: Ints, target: Floats, comm: MPI.Intracomm | None = None) -> _Foot:
    """Return the nearest place of the surface, the same on all ranks of `comm`."""
    triangles = points[cells]
    centre, radius = _balls(triangles)
    least = np.min(_norm(triangles - target), initial=np.inf)
    near = _norm(centre - target) - radius <= least * (1.0 + 1e-9)
    triangles = triangles[near]
    weights, places, gaps = _closest(triangles, target)
    held = (float("inf"), 0)
    found = (np.zeros(3), np.zeros(3), np.zeros((3, 3)))
    if len(gaps):
        i = int(np.argmin(gaps))
        held = (float(gaps[i]), 0)
        found = (places[i], weights[i], triangles[i])
    if comm is not None:
        held = comm.allreduce((held[0], comm.rank), op=MPI.MINLOC)
        found = comm.bcast(found, root=held[1])
    position, share, corners = found
    size = float(_longest(corners[None])[0])
    # interpolated from the vertices: the facets' own normals are off by the angle between them;
    # vertices are known by their place, as ranks share no other name for them here
    around = points[cells]
    area = _double_areas(around)
    normals = np.zeros((3, 3))
    for i, corner in enumerate(_vectors(corners)):
        fan = (_norm(around - corner) <= 1e-9 * size).any(axis=1)
        normals[i] = area[fan].sum(axis=0)
    if comm is not None:
        normals = comm.allreduce(normals, op=MPI.SUM)
    lengths = _norm(normals)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    normal = _mix(share[None], normals[None])[0]
    return _Foot(position, held[0], normal / max(float(_norm(normal)), 1e-300), size)


def _touching(points: Floats, cells: Ints, position: Floats, snap: float) -> Ints:
    """Return the rows of the cells that hold or touch a place of the surface."""
    triangles = points[cells]
    centre, radius = _balls(triangles)
    near = np.flatnonzero(_norm(centre - position) <= radius * (1.0 + snap))
    triangles = triangles[near]
    _, _, gap = _closest(triangles, position)
    scale = float(np.max(np.abs(position)))
    return near[gap <= snap * _altitudes(triangles) + 1e-14 * scale]


def _places_in_space(surface: _Surface, course: Floats, snap: float) -> list[_Place]:
    places = []
    for i, target in enumerate(_vectors(course)):
        foot = _foot(surface.points, surface.cells, target)
        rows = _touching(surface.points, surface.cells, foot.position, snap)
        triangles = surface.points[surface.cells[rows]]
        point, position = _locate(surface, rows, triangles, foot.position, snap)
        offset = target - foot.position
        height = abs(float(_dot(offset, foot.normal)))
        aside = float(_norm(offset - float(_dot(offset, foot.normal)) * foot.normal))
        rim = _on_boundary(surface, point)
        # an offset along the normal is that of a faceted surface from a smooth one
        beyond = rim and aside > max(snap * float(_altitudes(triangles).max()), 0.5 * height)
        off = foot.distance > ON_SURFACE * float(_longest(triangles).max())
        where = f"route point {i} at {_text(target)}"
        if not off and not beyond:
            places.append(_Place(point, position, foot.normal))
        elif i not in (0, len(course) - 1):
            raise PathError(
                f"{where} leaves the membrane: it is {foot.distance:.6g} from its nearest place "
                f"{_text(foot.position)}; move it there, only a first or last point may be off"
            )
        elif not rim:
            raise PathError(
                f"{where} is {foot.distance:.6g} off the membrane's interior at "
                f"{_text(foot.position)}; begin or end the route where the cable meets the "
                "membrane and add this point to the path with Path.with_anchors"
            )
        else:
            places.append(_Place(None, target, foot.normal))
    return places


def _on_boundary(surface: _Surface, point: SurfacePoint) -> bool:
    support = np.flatnonzero(np.isin(surface.ids, point.support))
    around = surface.cells[np.isin(surface.cells, support).any(axis=1)]
    count = _edge_count(_lists(surface.ids[around]))
    if isinstance(point, EdgePoint):
        return count[point.edge] == 1
    if isinstance(point, VertexPoint):
        return any(n == 1 and point.vertex in edge for edge, n in count.items())
    return False


def _edge_count(cells: list[list[int]]) -> Counter[Node]:
    """Count the cells at each edge (smaller, larger)."""
    return Counter((min(a, b), max(a, b)) for u, v, w in cells for a, b in ((u, v), (v, w), (w, u)))


# ---- one leg: the section with a plane ----------------------------------------------------------


@dataclass(frozen=True)
class _Plane:
    """The plane of a leg: an origin and unit vectors along the leg and across the plane."""

    origin: Floats
    along: Floats
    across: Floats
    length: float

    @classmethod
    def of(cls, a: Floats, b: Floats, normal_a: Floats, normal_b: Floats) -> _Plane:
        """Return the plane through two points and the mean of two directions."""
        length = float(_norm(b - a))
        along: Floats = np.asarray((b - a) / length, dtype=np.float64)
        across: Floats = _cross(normal_a + normal_b, along)
        size = float(_norm(across))
        if size < 1e-6:
            raise PathError(
                f"the leg from {_text(a)} to {_text(b)} has no section plane, as the surface's "
                "normals there are opposite or point along it; put a route point between them"
            )
        return cls(a, along, np.asarray(across / size, dtype=np.float64), length)

    def offsets(self, points: Floats) -> Floats:
        """Return the distances (n,) of (n, 3) points from the plane, with sign."""
        return _dot(points - self.origin, self.across)

    def advances(self, points: Floats) -> Floats:
        """Return how far (n,) along the leg (n, 3) points are."""
        return _dot(points - self.origin, self.along)

    def altitudes(self, triangles: Floats) -> Floats:
        """Return the smallest altitudes (m,) of the projections of (m, 3, 3) triangles.

        A wall has none: it counts with its true one, if it is not parallel to the plane.
        """
        flat = np.zeros_like(triangles)
        flat[..., 0], flat[..., 1] = self.advances(triangles), self.offsets(triangles)
        wall = _norm(_double_areas(flat)) <= WALL * _norm(_double_areas(triangles))
        spread = flat[..., 1].max(axis=1) - flat[..., 1].min(axis=1)
        upright = np.minimum(_altitudes(triangles), spread)
        return np.where(wall, upright, _altitudes(flat))


def _strip(plane: _Plane, points: Floats, cells: Ints, reach: float) -> Bools:
    """Mark the cells that the plane crosses or passes within `reach`.

    `reach` covers what the ends may be moved when they snap, and grows beyond the ends, where
    that turns the plane farther away.
    """
    offset = plane.offsets(points)
    advance = plane.advances(points)
    beyond = np.maximum(np.maximum(-advance, advance - plane.length), 0.0) / plane.length
    rounding = 1e-14 * float(np.max(np.abs(points), initial=0.0))
    margin = 2.0 * reach * (1.0 + 2.0 * beyond) + rounding
    near = (np.abs(offset) <= margin)[cells].any(axis=1)
    positive = (offset > 0.0)[cells]
    return np.asarray(near | (positive.any(axis=1) & ~positive.all(axis=1)))


@dataclass(frozen=True)
class _Section:
    """The section of a surface with a plane, as a graph of the points it meets."""

    points: dict[Node, SurfacePoint]
    positions: dict[Node, Floats]
    arcs: dict[Node, dict[Node, float]]
    rim: set[Node]

    def join(self, a: Node, b: Node) -> None:
        length = float(_norm(self.positions[a] - self.positions[b]))
        self.arcs[a][b] = self.arcs[b][a] = length


def _leg_points(
    surface: _Surface, first: _Place, last: _Place, name: str, snap: float
) -> list[SurfacePoint]:
    """Return the points of the surface on one leg, its ends (if no anchors) among them."""
    if np.array_equal(first.position, last.position):
        raise PathError(
            f"{name} has no length: both its ends lie at {_text(first.position)} of the membrane;"
            " move them apart"
        )
    if first.point is not None and last.point is not None:
        both = np.isin(surface.ids, [*first.point.support, *last.point.support])
        if (both[surface.cells].sum(axis=1) == both.sum()).any():
            return [first.point, last.point]
    plane = _Plane.of(first.position, last.position, first.normal, last.normal)
    section, (start, end) = _section(surface, plane, (first, last), name, snap)
    advance = {node: float(plane.advances(x)) for node, x in section.positions.items()}
    if start is None or end is None:
        # seen from an anchor, only what lies between the leg's ends
        seen = sorted(
            (advance[node], node)
            for node in section.rim
            if (section.arcs[node] or node in (start, end))
            and -1e-9 <= advance[node] / plane.length <= 1.0 + 1e-9
        )
        if not seen:
            raise PathError(
                f"{name} from {_text(first.position)} to {_text(last.position)} never meets the "
                "membrane's boundary; move its anchor"
            )
        start = seen[0][1] if start is None else start
        end = seen[-1][1] if end is None else end
    reached, before = _shortest(section, start)
    if end not in reached:
        _raise_leaves(section, reached, start, advance, name)
    nodes = [end]
    while nodes[-1] != start:
        nodes.append(before[nodes[-1]])
    return [section.points[node] for node in reversed(nodes)]


def _section(
    surface: _Surface,
    plane: _Plane,
    ends: tuple[_Place, _Place],
    name: str,
    snap: float,
) -> tuple[_Section, tuple[Node | None, Node | None]]:
    """Return the section as a graph, and its nodes at the leg's two ends."""
    strip = surface.cells[_strip(plane, surface.points, surface.cells, snap * surface.size)]
    offset = plane.offsets(surface.points)
    tolerance = np.full(len(surface.ids), np.inf)
    np.minimum.at(
        tolerance, strip, snap * plane.altitudes(surface.points[strip])[:, None].repeat(3, axis=1)
    )
    sign = np.where(np.abs(offset) <= tolerance, 0, np.sign(offset)).astype(np.int64)
    for place in ends:
        if isinstance(place.point, VertexPoint):
            sign[surface.ids == place.point.vertex] = 0

    section = _Section({}, {}, {}, set())
    strip = strip[np.abs(sign[strip].sum(axis=1)) < 3]
    rows = {int(surface.ids[row]): int(row) for row in np.unique(strip)}
    ids = _lists(surface.ids[strip])
    count = _edge_count(ids)
    rim_vertices = {v for edge, n in count.items() if n == 1 for v in edge}
    on_cell: dict[Node, list[Node]] = {}
    for corners, signs in zip(ids, _lists(sign[strip]), strict=True):
        nodes: list[Node] = [(v,) for v, s in zip(corners, signs, strict=True) if s == 0]
        for i, j in ((0, 1), (1, 2), (2, 0)):
            if signs[i] * signs[j] < 0:
                nodes.append((min(corners[i], corners[j]), max(corners[i], corners[j])))
        for node in nodes:
            if node in section.points:
                continue
            section.arcs[node] = {}
            here = [rows[v] for v in node]
            x = surface.points[here]
            if len(node) == 1:
                section.points[node], section.positions[node] = VertexPoint(node[0]), x[0]
                on_rim = node[0] in rim_vertices
            else:
                t = float(offset[here[0]] / (offset[here[0]] - offset[here[1]]))
                t = min(max(t, LEAST), MOST)
                section.points[node] = EdgePoint((node[0], node[1]), t)
                section.positions[node] = (1.0 - t) * x[0] + t * x[1]
                on_rim = count[node] == 1
            if on_rim:
                section.rim.add(node)
        if len(nodes) == 3:
            raise PathError(
                f"{name} runs in the plane of cell {tuple(corners)} near "
                f"{_text(section.positions[nodes[0]])}, a wall or a cell without area; "
                "turn the leg a little or put a route point beside it"
            )
        if len(nodes) == 2:
            section.join(nodes[0], nodes[1])
        on_cell[tuple(corners)] = nodes

    found: list[Node | None] = []
    for place, own in zip(ends, (START, END), strict=True):
        found.append(_end_node(section, place, own, on_cell, count))
    return section, (found[0], found[1])


def _end_node(
    section: _Section,
    place: _Place,
    own: Node,
    on_cell: dict[Node, list[Node]],
    count: Counter[Node],
) -> Node | None:
    """Return the section's node at an end of the leg, put in where it has none there."""
    if place.point is None:
        return None
    support = place.point.support
    known = not isinstance(place.point, CellPoint) and support in section.points
    node = support if known else own
    section.points[node], section.positions[node] = place.point, place.position
    if known:
        for other in list(section.arcs[node]):
            section.join(node, other)
        return node
    section.arcs[node] = {}
    for corners, nodes in on_cell.items():
        if set(support) <= set(corners):
            for other in nodes:
                section.join(node, other)
    if count.get(support) == 1:
        section.rim.add(node)
    return node


def _shortest(section: _Section, start: Node) -> tuple[dict[Node, float], dict[Node, Node]]:
    """Return lengths from `start` to all that hangs together with it, and the node before."""
    reached: dict[Node, float] = {}
    before: dict[Node, Node] = {}
    queue: list[tuple[float, Node, Node]] = [(0.0, start, start)]
    while queue:
        length, node, previous = heapq.heappop(queue)
        if node in reached:
            continue
        reached[node] = length
        before[node] = previous
        for other, step in section.arcs[node].items():
            if other not in reached:
                heapq.heappush(queue, (length + step, other, node))
    return reached, before


def _raise_leaves(
    section: _Section,
    reached: dict[Node, float],
    start: Node,
    advance: dict[Node, float],
    name: str,
) -> NoReturn:
    exits = [node for node in reached if node in section.rim and node != start] or list(reached)
    node = max(exits, key=lambda node: (advance[node], node))
    raise PathError(
        f"{name} leaves the membrane at {_text(section.positions[node])} ({section.points[node]})"
        " before its end; lead the route around, through points on the membrane"
    )
