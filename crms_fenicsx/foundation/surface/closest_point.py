"""Closest points of a triangulated surface, and the location of route points on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.triangles import (
    WALL,
    altitudes,
    closest,
    dot,
    double_areas,
    flattened,
    lists,
    longest_sides,
    mix,
    norm,
)
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, flags, ints
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
)


@dataclass(frozen=True)
class Balls:
    """Balls around triangles, or points, among which near ones are found."""

    centre: Array  # (m, 3)
    radius: Array  # (m,)

    @classmethod
    def of(cls, triangles: Array) -> Balls:
        """Balls around triangles (m, 3, 3)."""
        centre = np.asarray(triangles.sum(axis=1) / 3.0, dtype=np.float64)
        return cls(centre, np.max(norm(triangles - centre[:, None]), axis=1, initial=0.0))

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree  # takes longer to import than scripts without cables need

        return cKDTree(self.centre)

    def within(self, targets: Array, reach: Array) -> tuple[Integers, Integers]:
        """Indices (p,) of all pairs of targets (k, 3) and balls within `reach` (k,), up to
        rounding, sorted by targets and then balls."""
        widest = self.radius.max(initial=0.0)
        found = self._tree.query_ball_point(targets, reach + widest, return_sorted=True)
        target = np.repeat(np.arange(len(targets)), [len(own) for own in found])
        ball = np.fromiter(chain.from_iterable(found), dtype=np.int64)
        near = norm(self.centre[ball] - targets[target]) - self.radius[ball] <= reach[target]
        return target[near], ball[near]

    def least_reach(self, targets: Array) -> Array:
        """Upper bound of the distance from each target to the nearest triangle, (k,)."""
        # the nearest centre is a point of the surface
        return np.asarray(self._tree.query(targets)[0] * (1.0 + 1e-9))

    def nearest(self, targets: Array) -> tuple[Integers, Integers]:
        """Pairs of targets and triangles that may be the closest, in the form of `within`."""
        return self.within(targets, self.least_reach(targets) + 1e-9 * self.radius.max())


@dataclass(frozen=True)
class _Foot:
    """Closest point of a surface to a point in space, and the size of its cell."""

    position: Array
    distance: float
    normal: Array
    size: float


def feet_of(
    points: Array, cells: Integers, targets: Array, comm: MPI.Intracomm | None = None
) -> list[_Foot]:
    """Closest points of a surface to targets (k, 3), the same on all ranks of `comm`."""
    triangles = points[cells]
    balls = Balls.of(triangles)
    held, position, share, corners = _nearest(triangles, balls, targets)
    if comm is not None:
        every = np.array(comm.allgather(held))
        mine = every.argmin(axis=0) == comm.rank
        held = every.min(axis=0)
        given = np.concatenate([position, share, corners.reshape(-1, 9)], axis=1)
        found = np.zeros_like(given)
        comm.Allreduce(np.where(mine[:, None], given, 0.0), found)
        position, share, corners = found[:, :3], found[:, 3:6], found[:, 6:].reshape(-1, 3, 3)
    size = longest_sides(corners)
    # normals are interpolated from the vertices, as facet normals differ by the angle between
    # facets; vertices are identified by position, as ranks share no other key here
    normals = np.zeros((len(targets), 3, 3))
    target, cell = balls.within(position, size * (1.0 + 1e-6))
    area, around = double_areas(triangles[cell]), triangles[cell]
    for i in range(3):
        apart = norm(around - corners[target, i][:, None])
        fan = (apart <= 1e-9 * size[target, None]).any(axis=1)
        np.add.at(normals[:, i], target[fan], area[fan])
    if comm is not None:
        normals = comm.allreduce(normals, op=MPI.SUM)
    lengths = norm(normals)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    normal = mix(share, normals)
    normal /= np.maximum(norm(normal), 1e-300)[:, None]
    return [
        _Foot(position[k], float(held[k]), normal[k], float(size[k])) for k in range(len(targets))
    ]


def _nearest(triangles: Array, balls: Balls, targets: Array) -> tuple[Array, Array, Array, Array]:
    """Distances (k,), closest points (k, 3), weights (k, 3) and cell corners (k, 3, 3)."""
    k = len(targets)
    held = np.full(k, np.inf)
    position, share, corners = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3, 3))
    if len(triangles):
        target, cell = balls.nearest(targets)
        weights, places, gaps = closest(triangles[cell], targets[target])
        order = np.lexsort((gaps, target))  # of equally close cells the first
        best = order[np.unique(target[order], return_index=True)[1]]
        held, position, share = gaps[best], places[best], weights[best]
        corners = triangles[cell[best]]
    return held, position, share, corners


SNAP = 1e-3
"""Distance, relative to the mesh size, within which points snap to vertices and edges."""

# Distance from the surface, relative to the local mesh size, up to which a point in space lies on
# it: a faceted dome of three cells per radius is nowhere farther from the smooth one.
ON_SURFACE = 0.1

# Distance outside, relative to the mesh size, up to which a route point in plan is moved to the
# rim: the circle through the vertices of a disc of 20 edges is nowhere farther from them.
RIM = 0.05


@dataclass(frozen=True)
class TargetSurface:
    """A triangulated surface: global ids (n,), positions (n, 3), cells as rows of both (m, 3)."""

    ids: Integers
    points: Array
    cells: Integers
    size: float  # length of its longest edge
    snap = SNAP

    @classmethod
    def of(cls, vertices: ArrayLike, points: ArrayLike, cells: ArrayLike) -> TargetSurface:
        """The surface of these vertices."""
        ids, x = np.asarray(vertices, dtype=np.int64), np.asarray(points, dtype=np.float64)
        rows = np.asarray(cells, dtype=np.int64)
        return cls(ids, x, rows, float(longest_sides(x[rows]).max()))

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Row of each vertex id."""
        return {int(vertex): row for row, vertex in enumerate(self.ids)}

    @cached_property
    def around(self) -> dict[int, set[int]]:
        """Rows of the cells around each vertex."""
        found: dict[int, set[int]] = {int(vertex): set() for vertex in self.ids}
        for row, corners in enumerate(lists(self.ids[self.cells])):
            for vertex in corners:
                found[vertex].add(row)
        return found

    def cells_with(self, *points: Support) -> set[int]:
        """Rows of the cells that have all vertices of the points, given by their supports."""
        return set.intersection(*(self.around[v] for support in points for v in support))

    def on_boundary(self, point: SurfacePoint) -> bool:
        """Whether a point of the surface lies on its boundary."""
        rows = sorted(self.cells_with(point.support))
        if isinstance(point, VertexPoint):  # as many cells at an edge as have its other vertex
            return 1 in Counter(ints(self.cells[rows].ravel())).values()
        return isinstance(point, EdgePoint) and len(rows) == 1


@dataclass(frozen=True)
class Place:
    """A route point on the surface, or an anchor above it or beyond its boundary."""

    point: SurfacePoint | None  # None for an anchor
    position: Array
    normal: Array
    foot: _Foot | None = None  # closest point of the surface to an anchor
    beyond: bool = False  # whether an anchor lies beyond the boundary

    @property
    def anchor(self) -> tuple[float, float, float] | None:
        """Its position if it is an anchor."""
        x, y, z = (float(c) for c in self.position)
        return None if self.point is not None else (x, y, z)


def places_in_plan(surface: TargetSurface, course: Array) -> list[Place]:
    """Locate route points (k, 2) given in plan, on the uppermost sheet or on the rim."""
    found = _held_in_plan(surface, course)
    outside = [i for i, place in enumerate(found) if place is None]
    on_rim = np.array([_on_the_rim(surface, course[i], i) for i in outside]).reshape(-1, 2)
    for i, place in zip(outside, _held_in_plan(surface, on_rim), strict=True):
        found[i] = place
    lacking = [i for i, place in enumerate(found) if place is None]
    if lacking:
        raise PathError(
            f"route point {lacking[0]} at {as_text(course[lacking[0]])} lies on a wall, where a "
            "plan does not define the height; pass the route in space."
        )
    return [place for place in found if place is not None]


def _held_in_plan(surface: TargetSurface, course: Array) -> list[Place | None]:
    """Locate points in plan; None for those outside the surface."""
    corners = surface.points[surface.cells][:, :, :2]
    least, most, reach = corners.min(axis=1), corners.max(axis=1), surface.snap * surface.size
    inside = (least <= course[:, None] + reach) & (most >= course[:, None] - reach)
    target, near = np.nonzero(inside.all(axis=2))
    triangles = surface.points[surface.cells[near]]
    flat, targets = flattened(triangles), np.pad(course, ((0, 0), (0, 1)))
    weights, _, gap = closest(flat, targets[target])
    floor = norm(double_areas(flat)) > WALL * norm(double_areas(triangles))
    holds = floor & (gap <= surface.snap * altitudes(flat))
    held = np.flatnonzero(holds)
    heights = mix(weights[held], triangles[held])[:, 2]
    top = near[held[_least_of(target[held], len(course), -heights)[target[held]]]]
    with_top = surface.cells[near[held]][:, :, None] == surface.cells[top][:, None]
    sheet = held[with_top.any(axis=(1, 2))]
    places = _located(surface, targets, target[sheet], near[sheet], flat[sheet])
    up = np.array([0.0, 0.0, 1.0])
    return [None if place is None else Place(*place, up) for place in places]


def _least_of(target: Integers, count: int, *keys: Array | Integers) -> Integers:
    """The row (count,) of the least keys of each target, the first of equal ones; -1 without."""
    order = np.lexsort((*keys[::-1], target))
    found = np.full(count, -1)
    found[target[order[::-1]]] = order[::-1]
    return found


def _on_the_rim(surface: TargetSurface, xy: Array, index: int) -> Array:
    """Closest point in plan to a route point just outside, as next to a curved rim."""
    triangles = surface.points[surface.cells]
    flat, target = flattened(triangles), np.array([xy[0], xy[1], 0.0])
    weights, _, gap = closest(flat, target)
    nearest = int(np.argmin(gap))
    place = mix(weights[[nearest]], triangles[[nearest]])[0]
    if gap[nearest] > RIM * float(longest_sides(flat[[nearest]])[0]):
        raise PathError(
            f"route point {index} at {as_text(xy)} leaves the membrane: it is "
            f"{gap[nearest]:.6g} outside of it in plan, nearest to {as_text(place)}; move it "
            "there, or pass the route in space to make its first or last point an anchor."
        )
    return place[:2]


def _located(
    surface: TargetSurface, targets: Array, target: Integers, rows: Integers, triangles: Array
) -> list[tuple[SurfacePoint, Array] | None]:
    """Surface points at targets (k, 3), with positions: a vertex if one is near, else an edge, else
    a point in the closest of the cells given by pairs `target`, `rows` (p,)."""
    corners, at = surface.cells[rows], targets[target]
    reach = surface.snap * altitudes(triangles)
    ids, (i, j) = surface.ids[corners], np.array([[0, 1, 2], [1, 2, 0]])
    turned = ids[:, i] > ids[:, j]
    i, j = np.where(turned, j, i), np.where(turned, i, j)
    every = np.arange(len(rows))[:, None]
    side = triangles[every, j] - triangles[every, i]
    t = dot(at[:, None] - triangles[every, i], side) / np.maximum(dot(side, side), 1e-300)
    gap = norm(triangles[every, i] + t[..., None] * side - at[:, None])
    on_edge = np.nonzero((gap <= reach[:, None]) & (0.0 < t) & (t < 1.0))
    start, end = corners[every, i][on_edge], corners[every, j][on_edge]
    weights, _, gaps = closest(triangles, at)
    positions = mix(weights, surface.points[corners])
    to_corner = norm(triangles - at[:, None])
    at_corner = np.nonzero(to_corner <= reach[:, None])
    count = len(targets)
    corner = _least_of(target[at_corner[0]], count, to_corner[at_corner])
    a, b, fraction = surface.ids[start], surface.ids[end], t[on_edge]
    edge = _least_of(target[on_edge[0]], count, gap[on_edge], a, b)
    found: list[tuple[SurfacePoint, Array] | None] = []
    for k, n in enumerate(_least_of(target, count, gaps)):
        if n < 0:
            found.append(None)
        elif corner[k] >= 0:
            row = corners[at_corner][corner[k]]
            found.append((VertexPoint(int(surface.ids[row])), surface.points[row].copy()))
        elif edge[k] >= 0:
            q, s = edge[k], float(fraction[edge[k]])
            position = (1.0 - s) * surface.points[start[q]] + s * surface.points[end[q]]
            found.append((EdgePoint((int(a[q]), int(b[q])), s), position))
        else:
            (u, v, w), (x, y, z) = map(int, ids[n]), map(float, weights[n])
            found.append((CellPoint((u, v, w), (x, y, z)), positions[n]))
    return found


def places_in_space(
    surface: TargetSurface, course: Array, known: Mapping[int, SurfacePoint]
) -> list[Place]:
    """Locate route points (k, 3); the first and last may be anchors, `known` ones are kept."""
    feet = feet_of(surface.points, surface.cells, course)
    positions = np.array([foot.position for foot in feet])
    target, rows = _touching(surface, positions)
    triangles = surface.points[surface.cells[rows]]
    points = _located(surface, positions, target, rows, triangles)
    # of the cells at each place
    first = np.searchsorted(target, np.arange(len(course)))
    altitude = np.maximum.reduceat(altitudes(triangles), first)
    longest = np.maximum.reduceat(longest_sides(triangles), first)
    distance, normals = np.array([foot.distance for foot in feet]), [foot.normal for foot in feet]
    offset = course - positions
    heights = dot(offset, np.array(normals))
    aside = norm(offset - heights[:, None] * normals)
    # facets deviate from a smooth surface along its normal
    is_aside = flags(aside > np.maximum(surface.snap * altitude, 0.5 * np.abs(heights)))
    is_off = flags(distance > ON_SURFACE * longest)
    places = []
    for i, (foot, height, off) in enumerate(zip(feet, heights, is_off, strict=True)):
        if i in known:
            places.append(Place(known[i], course[i], foot.normal))
            continue
        found = points[i]
        assert found is not None
        point, position = found
        rim = (is_aside[i] or off) and surface.on_boundary(point)
        if not off and not (rim and is_aside[i]):
            places.append(Place(point, position, foot.normal))
        elif i not in (0, len(course) - 1):
            raise PathError(
                f"route point {i} at {as_text(course[i])} leaves the membrane: it is "
                f"{foot.distance:.6g} from its nearest place {as_text(foot.position)}; move it "
                "there, only the first or last point may be off it."
            )
        elif height < 0.0 and not rim:
            raise PathError(
                f"route point {i} at {as_text(course[i])} lies {foot.distance:.6g} inside the "
                f"membrane, behind {as_text(foot.position)}, and a cable lies on the outside, "
                "where the normals point; move this anchor outside or beyond the boundary, or "
                "turn the membrane with the `outside` of its mesh."
            )
        else:
            places.append(Place(None, course[i], foot.normal, foot, beyond=rim))
    return places


def _touching(surface: TargetSurface, positions: Array) -> tuple[Integers, Integers]:
    """Pairs (p,) of surface positions (k, 3) and the cells that contain or touch them."""
    triangles = surface.points[surface.cells]
    balls = Balls.of(triangles)
    reach = np.full(len(positions), 2.0 * surface.snap * float(balls.radius.max()))
    target, near = balls.within(positions, reach)
    _, _, gap = closest(triangles[near], positions[target])
    scale = np.abs(positions).max(axis=1)[target]
    touches = gap <= surface.snap * altitudes(triangles[near]) + 1e-14 * scale
    return target[touches], near[touches]
