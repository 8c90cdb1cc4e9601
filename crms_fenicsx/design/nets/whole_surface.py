"""The membrane's current shape on all ranks, and steps of given length across its triangles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from crms_fenicsx.cabling.cables.strip import Strip, StripShape, whole
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface
from crms_fenicsx.foundation.meshes.triangles import (
    balls,
    closest,
    cross,
    dot,
    double_areas,
    mix,
    norm,
)
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import TargetSurface, feet_of, places_in_plan
from crms_fenicsx.model.membrane import Membrane

ON_CELL = 1e-9
"""Distance outside a triangle, relative to its size, within which a point counts as inside."""

SAME_POINT = 1e-6
"""Distance, relative to the step, below which two points are the same."""


@dataclass(frozen=True)
class WholeSurface:
    """The cells on which cables can lie, the same on all ranks."""

    membrane: Membrane
    strip: Strip
    points: Array  # (n, 3) current positions of the vertices `strip.vertices` (length)
    cells: Integers  # (m, 3) rows of `points`

    @classmethod
    def of(cls, membrane: Membrane) -> WholeSurface:
        """Gather the current shape. Collective."""
        strip = whole(membrane)
        shape = StripShape.of(membrane, strip)
        rows = np.searchsorted(strip.vertices, strip.outer_cells)
        return cls(membrane, strip, shape.current, rows)

    @cached_property
    def smooth(self) -> SmoothSurface:
        """The smooth surface through the vertices."""
        return SmoothSurface.of(self.points, self.cells)

    @cached_property
    def _corners(self) -> Array:
        """Cell corners (m, 3, 3)."""
        return self.points[self.cells]

    @cached_property
    def _tree(self) -> tuple[cKDTree, float]:
        """Tree of the cells' centres, and the largest distance of a corner from its centre."""
        centres, radii = balls(self._corners)
        return cKDTree(centres), float(radii.max())

    @cached_property
    def size(self) -> float:
        """Mean cell size (length)."""
        return float(np.sqrt(norm(double_areas(self._corners)).mean()))

    def _near(self, point: Array, reach: float) -> Integers:
        """Rows of the cells possibly within reach of a point."""
        tree, radius = self._tree
        found = tree.query_ball_point(point, reach + radius, return_sorted=True)
        return np.array(found, dtype=np.int64)

    def place(self, point: Array) -> Array:
        """Point on the surface (3,) for a point in plan (2,) or in space (3,)."""
        if len(point) == 3:
            foot = feet_of(self.points, self.cells, point[None])[0]
            if foot.distance > foot.size:
                raise PathError(
                    f"{as_text(point)} is {foot.distance:.6g} from the membrane, nearest to "
                    f"{as_text(foot.position)}; give a point on the membrane"
                )
            return foot.position
        target = TargetSurface.of(self.strip.vertices, self.points, self.cells)
        return places_in_plan(target, point[None], 1e-3)[0].position

    def normal(self, point: Array) -> Array:
        """Unit normal (3,) of the smooth surface at a point; at creases the facet's."""
        tree, radius = self._tree
        near = self._near(point, float(tree.query(point)[0]) + radius)
        weights, _, gaps = closest(self._corners[near], point)
        k = int(np.argmin(gaps))
        of_corners = self.smooth.normals[self.cells[near[k]]]
        facet = double_areas(self._corners[near[[k]]])[0]
        missing = ~of_corners.any(axis=1)
        of_corners[missing] = facet / norm(facet)
        normal = mix(weights[[k]], of_corners[None])[0]
        return np.asarray(normal / norm(normal))

    def tangent(self, point: Array, direction: Array) -> Array:
        """Unit tangent (3,) at a point, along a direction in plan (2,) or in space (3,)."""
        normal = self.normal(point)
        way = np.append(direction, 0.0)[:3]
        if len(direction) == 2:
            if abs(normal[2]) < 1e-6:
                raise PathError(
                    f"the membrane is vertical at {as_text(point)}, so that a direction in plan "
                    "has no meaning there; give it in space"
                )
            way[2] = -(way @ normal) / normal[2]
        way = way - (way @ normal) * normal
        if norm(way) < 1e-6 * np.linalg.norm(direction):
            raise PathError(
                f"direction {as_text(direction)} is normal to the membrane at {as_text(point)}; "
                "give one along it"
            )
        return np.asarray(way / norm(way))

    def compass(self, a: Array, b: Array, reach: float) -> Array:
        """All points of the surface at distance `reach` from two of its points, (k, 3)."""
        near = np.intersect1d(self._near(a, reach), self._near(b, reach))
        x, middle, across = self._corners[near], (a + b) / 2, b - a
        normals = double_areas(x)
        # The points lie on a circle around the middle, which meets a cell's plane in two points.
        line = cross(normals, across)
        square = np.maximum(dot(line, line), 1e-300)
        height = dot(normals, x[:, 0] - middle)
        foot = height[:, None] * cross(across, line) / square[:, None]
        left = reach**2 - across @ across / 4 - dot(foot, foot)
        found = [
            self._inside(near, middle + foot + sign * root[:, None] * line)
            for root in [np.sqrt(np.maximum(left, 0.0) / square)]
            for sign in (-1.0, 1.0)
        ]
        hits = np.concatenate([y[holds & (left >= 0.0)] for y, holds in found])
        return _distinct(hits, SAME_POINT * reach)

    def _inside(self, rows: Integers, y: Array) -> tuple[Array, Booleans]:
        """Points (k, 3) in the planes of cells, and whether each lies in its cell, (k,)."""
        x = self._corners[rows]
        normals = double_areas(x)
        opposite = cross(x[:, [1, 2, 0]] - y[:, None], x[:, [2, 0, 1]] - y[:, None])
        weights = dot(opposite, normals[:, None]) / dot(normals, normals)[:, None]
        return y, np.all(weights >= -ON_CELL, axis=1)

    def step(self, point: Array, way: Array, length: float) -> Array | None:
        """The point straight ahead at a distance; None if the surface ends before."""
        across = cross(self.normal(point), way)
        starts, sides = self._section(self._corners[self._near(point, length)], point, across)
        from_start = starts - point
        a, b = dot(sides, sides), dot(sides, from_start)
        left = b**2 - a * (dot(from_start, from_start) - length**2)
        meets = (left >= 0.0) & (a > 0.0)
        starts, sides, a, b, left = (v[meets] for v in (starts, sides, a, b, left))
        ends = [(-b + sign * np.sqrt(left)) / a for sign in (-1.0, 1.0)]
        inside = [(-ON_CELL <= s) & (s <= 1 + ON_CELL) for s in ends]
        found = np.concatenate([
            (starts + s[:, None] * sides)[on] for s, on in zip(ends, inside, strict=True)
        ])  # fmt: skip
        ahead = dot(found - point, way)
        return found[np.argmax(ahead)] if np.any(ahead > 0.0) else None

    @staticmethod
    def _section(x: Array, origin: Array, across: Array) -> tuple[Array, Array]:
        """Segments of triangles (k, 3, 3) cut by a plane: start points and vectors to the ends."""
        height = dot(x - origin, across)
        above = height >= 0.0
        cut = above.any(axis=1) & ~above.all(axis=1)
        x, height, above = x[cut], height[cut], above[cut]
        every = np.arange(len(x))
        alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
        ends = []
        for k in (1, 2):
            other = (alone + k) % 3
            first, second = height[every, alone], height[every, other]
            t = first / (first - second)
            ends.append(x[every, alone] + t[:, None] * (x[every, other] - x[every, alone]))
        return ends[0], ends[1] - ends[0]

    @cached_property
    def _rim(self) -> tuple[Array, cKDTree, float]:
        """Boundary edges (e, 2, 3), a tree of their midpoints, and half the longest edge."""
        table = EdgeTable.of(self.cells)
        ends = self.points[table.vertices[table.counts == 1]]
        half = float(norm(ends[:, 1] - ends[:, 0]).max(initial=0.0)) / 2
        return ends, cKDTree(ends.mean(axis=1)), half

    def rim_ahead(self, point: Array, way: Array, reach: float) -> Array | None:
        """First crossing of the rim straight ahead, within reach; None if there is none."""
        ends, tree, half = self._rim
        ends = ends[np.array(tree.query_ball_point(point, reach + half), dtype=np.int64)]
        height = dot(ends - point, cross(self.normal(point), way))
        cut = (height[:, 0] >= 0.0) != (height[:, 1] >= 0.0)
        ends, height = ends[cut], height[cut]
        t = height[:, 0] / (height[:, 0] - height[:, 1])
        found = ends[:, 0] + t[:, None] * (ends[:, 1] - ends[:, 0])
        away = norm(found - point)
        ahead = (dot(found - point, way) > SAME_POINT * reach) & (away <= reach * (1 + ON_CELL))
        return found[ahead][np.argmin(away[ahead])] if ahead.any() else None

    def to_rim(self, line: list[Array], length: float) -> list[Array]:
        """Extend a line of at least two points straight by steps, to the rim or until it closes."""
        line = list(line)
        while True:
            last = line[-1]
            way = (last - line[-2]) / norm(last - line[-2])
            new = self.step(last, way, length)
            if new is None:
                end = self.rim_ahead(last, way, length)
                return line if end is None else [*line, end]
            if (norm(np.array(line[:-1]) - new) < length * (1 - SAME_POINT)).any():
                return line
            line.append(new)


def _distinct(points: Array, apart: float) -> Array:
    """Points (k, 3), each farther than `apart` from all earlier ones."""
    kept: list[Array] = []
    for point in points:
        if all(norm(point - other) > apart for other in kept):
            kept.append(point)
    return np.array(kept).reshape(-1, 3)
