"""Where points are on a triangulated surface: the places that a route's points take on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.errors import PathError, as_text
from crms_fenicsx.surface.points import CellPoint, EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.surface.triangles import (
    WALL,
    altitudes,
    balls,
    closest,
    dot,
    double_areas,
    flattened,
    lists,
    longest_sides,
    mix,
    norm,
    vectors,
)

# A point in space counts as lying on the surface up to this part of the local mesh size: a
# faceted dome of three cells per radius is nowhere farther from the smooth one.
ON_SURFACE = 0.1

# A route point in plan that lies outside by up to this part of the mesh size is meant to lie on the
# rim: the circle through the vertices of a disc of 20 edges is nowhere farther from them.
RIM = 0.05

# A vertex (id,) or an edge (smaller, larger).
Node = tuple[int, ...]


@dataclass(frozen=True)
class Surface:
    """A triangulated surface: global ids (n,), positions (n, 3), rows of both (m, 3)."""

    ids: Integers
    points: Array
    cells: Integers
    size: float  # its longest edge

    @classmethod
    def checked(cls, vertices: ArrayLike, points: ArrayLike, cells: ArrayLike) -> Surface:
        """Return the surface of these arrays; raise PathError if they are none."""
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
            raise PathError(f"vertex {ids[i]} is at {as_text(x[i])}; positions must be finite")
        return cls(ids, x, rows, float(longest_sides(x[rows]).max()))

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Place of each vertex in `ids`."""
        return {int(vertex): row for row, vertex in enumerate(self.ids)}

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """Least and greatest coordinates of the cells in plan, (m, 2) each."""
        corners = self.points[self.cells][:, :, :2]
        return corners.min(axis=1), corners.max(axis=1)


@dataclass(frozen=True)
class Foot:
    """The place of a surface nearest to a point in space, in a cell of a certain size."""

    position: Array
    distance: float
    normal: Array
    size: float


@dataclass(frozen=True)
class Place:
    """A route point: on the surface, or an anchor (then `point` is None), over it or beyond it.

    Anchors have a foot, the nearest place of the surface.
    """

    point: SurfacePoint | None
    position: Array
    normal: Array
    foot: Foot | None = None
    beyond: bool = False

    @property
    def anchor(self) -> tuple[float, float, float] | None:
        """Its position if it is an anchor."""
        x, y, z = (float(c) for c in self.position)
        return None if self.point is not None else (x, y, z)

    def is_straight_over(self, position: Array, snap: float) -> bool:
        """Say whether it is an anchor with its foot at a place of the surface."""
        return self.foot is not None and bool(
            norm(self.foot.position - position) <= snap * self.foot.size
        )


def place_in_plan(surface: Surface, xy: Array, index: int, snap: float) -> Place:
    """Return the place of a route point given in plan, on the uppermost sheet there.

    A point outside by less than `RIM` of the cell there is meant to lie on the rim.
    """
    least, most = surface.boxes
    reach = snap * surface.size
    near = np.flatnonzero(((least <= xy + reach) & (most >= xy - reach)).all(axis=1))
    triangles = surface.points[surface.cells[near]]
    flat, target = flattened(triangles), np.array([xy[0], xy[1], 0.0])
    weights, _, gap = closest(flat, target)
    floor = norm(double_areas(flat)) > WALL * norm(double_areas(triangles))
    holds = floor & (gap <= snap * altitudes(flat))
    if not holds.any():
        return place_in_plan(surface, _on_the_rim(surface, xy, index), index, snap)
    near, weights, triangles = near[holds], weights[holds], triangles[holds]
    heights = mix(weights, triangles)[:, 2]
    top = surface.cells[near[np.argmax(heights)]]
    sheet = np.isin(surface.cells[near], top).any(axis=1)
    point, position = locate(surface, near[sheet], flattened(triangles[sheet]), target, snap)
    return Place(point, position, np.array([0.0, 0.0, 1.0]))


def _on_the_rim(surface: Surface, xy: Array, index: int) -> Array:
    """Return the nearest place in plan to a point just outside, as a curved rim's points are."""
    triangles = surface.points[surface.cells]
    flat, target = flattened(triangles), np.array([xy[0], xy[1], 0.0])
    weights, _, gap = closest(flat, target)
    nearest = int(np.argmin(gap))
    place = mix(weights[[nearest]], triangles[[nearest]])[0]
    if gap[nearest] > RIM * float(longest_sides(flat[[nearest]])[0]):
        raise PathError(
            f"route point {index} at {as_text(xy)} leaves the membrane: it is "
            f"{gap[nearest]:.6g} outside of it in plan, nearest to {as_text(place)}; move it "
            "there, or give the route in space to make its first or last point an anchor"
        )
    return place[:2]


def locate(
    surface: Surface, rows: Integers, triangles: Array, target: Array, snap: float
) -> tuple[SurfacePoint, Array]:
    """Return the point of the surface at `target`, which all the cells `rows` hold or touch."""
    corners = surface.cells[rows]
    reach = snap * altitudes(triangles)
    to_corner = norm(triangles - target)
    to_corner = np.where(to_corner <= reach[:, None], to_corner, np.inf)
    if np.isfinite(to_corner).any():
        row = corners.ravel()[np.argmin(to_corner)]
        return VertexPoint(int(surface.ids[row])), surface.points[row].copy()
    best: tuple[float, Node, float, Array] | None = None
    for cell, triangle, near in zip(lists(corners), vectors(triangles), reach, strict=True):
        for i, j in ((0, 1), (1, 2), (2, 0)):
            if surface.ids[cell[i]] > surface.ids[cell[j]]:
                i, j = j, i
            side = triangle[j] - triangle[i]
            t = float(dot(target - triangle[i], side) / max(float(dot(side, side)), 1e-300))
            gap = float(norm(triangle[i] + t * side - target))
            edge = (int(surface.ids[cell[i]]), int(surface.ids[cell[j]]))
            if gap <= near and 0.0 < t < 1.0 and (best is None or (gap, edge) < best[:2]):
                ends = surface.points[[cell[i], cell[j]]]
                best = gap, edge, t, (1.0 - t) * ends[0] + t * ends[1]
    if best is not None:
        return EdgePoint((best[1][0], best[1][1]), best[2]), best[3]
    weights, _, gaps = closest(triangles, target)
    nearest = int(np.argmin(gaps))
    position = mix(weights[[nearest]], surface.points[corners[[nearest]]])[0]
    a, b, c = surface.ids[corners[nearest]].tolist()
    u, v, w = weights[nearest].tolist()
    return CellPoint((a, b, c), (u, v, w)), position


def foot_of(
    points: Array, cells: Integers, target: Array, comm: MPI.Intracomm | None = None
) -> Foot:
    """Return the nearest place of the surface, the same on all ranks of `comm`."""
    triangles = points[cells]
    centre, radius = balls(triangles)
    least = np.min(norm(triangles - target), initial=np.inf)
    near = norm(centre - target) - radius <= least * (1.0 + 1e-9)
    triangles = triangles[near]
    weights, places, gaps = closest(triangles, target)
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
    size = float(longest_sides(corners[None])[0])
    # interpolated from the vertices: the facets' own normals are off by the angle between them;
    # vertices are known by their place, as ranks share no other name for them here
    around = points[cells]
    area = double_areas(around)
    normals = np.zeros((3, 3))
    for i, corner in enumerate(vectors(corners)):
        fan = (norm(around - corner) <= 1e-9 * size).any(axis=1)
        normals[i] = area[fan].sum(axis=0)
    if comm is not None:
        normals = comm.allreduce(normals, op=MPI.SUM)
    lengths = norm(normals)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    normal = mix(share[None], normals[None])[0]
    return Foot(position, held[0], normal / max(float(norm(normal)), 1e-300), size)


def touching(points: Array, cells: Integers, position: Array, snap: float) -> Integers:
    """Return the rows of the cells that hold or touch a place of the surface."""
    triangles = points[cells]
    centre, radius = balls(triangles)
    near = np.flatnonzero(norm(centre - position) <= radius * (1.0 + snap))
    triangles = triangles[near]
    _, _, gap = closest(triangles, position)
    scale = float(np.max(np.abs(position)))
    return near[gap <= snap * altitudes(triangles) + 1e-14 * scale]


def places_in_space(
    surface: Surface, course: Array, snap: float, known: Mapping[int, SurfacePoint]
) -> list[Place]:
    """Return the places of route points given in space; the first and last may be anchors.

    Of those that are known only the normal is found.
    """
    places = []
    for i, target in enumerate(vectors(course)):
        foot = foot_of(surface.points, surface.cells, target)
        if i in known:
            places.append(Place(known[i], target, foot.normal))
            continue
        rows = touching(surface.points, surface.cells, foot.position, snap)
        triangles = surface.points[surface.cells[rows]]
        point, position = locate(surface, rows, triangles, foot.position, snap)
        offset = target - foot.position
        height = float(dot(offset, foot.normal))
        aside = float(norm(offset - height * foot.normal))
        rim = on_boundary(surface, point)
        # an offset along the normal is that of a faceted surface from a smooth one
        beyond = rim and aside > max(snap * float(altitudes(triangles).max()), 0.5 * abs(height))
        off = foot.distance > ON_SURFACE * float(longest_sides(triangles).max())
        if not off and not beyond:
            places.append(Place(point, position, foot.normal))
        elif i not in (0, len(course) - 1):
            raise PathError(
                f"route point {i} at {as_text(target)} leaves the membrane: it is "
                f"{foot.distance:.6g} from its nearest place {as_text(foot.position)}; move it "
                "there, only a first or last point may be off"
            )
        elif height < 0.0 and not rim:
            raise PathError(
                f"route point {i} at {as_text(target)} lies {foot.distance:.6g} inside the "
                f"membrane, behind {as_text(foot.position)}, and a cable lies on the outside, "
                "where the normals point; move this anchor outside or beyond the boundary, or "
                "turn the membrane with the `outside` of its mesh"
            )
        else:
            places.append(Place(None, target, foot.normal, foot, beyond=rim))
    return places


def on_boundary(surface: Surface, point: SurfacePoint) -> bool:
    """Say whether a point of the surface lies on its boundary."""
    support = np.flatnonzero(np.isin(surface.ids, point.support))
    around = surface.cells[np.isin(surface.cells, support).any(axis=1)]
    count = edge_count(lists(surface.ids[around]))
    if isinstance(point, EdgePoint):
        return count[point.edge] == 1
    if isinstance(point, VertexPoint):
        return any(n == 1 and point.vertex in edge for edge, n in count.items())
    return False


def edge_count(cells: list[list[int]]) -> Counter[Node]:
    """Count the cells at each edge (smaller, larger)."""
    return Counter((min(a, b), max(a, b)) for u, v, w in cells for a, b in ((u, v), (v, w), (w, u)))
