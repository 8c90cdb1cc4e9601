"""The membrane's current shape on all ranks, and steps of given length across its triangles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.strip import Strip, StripShape, whole
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface
from crms_fenicsx.foundation.meshes.triangles import closest, cross, dot, double_areas, mix, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import (
    Balls,
    TargetSurface,
    feet_of,
    places_in_plan,
)
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE, SAME_POINT


@dataclass(frozen=True)
class WholeSurface:
    """The cells on which cables can lie, the same on all ranks."""

    membrane: Membrane
    strip: Strip
    points: Array  # (n, 3) current positions of the vertices `strip.vertices` (length)
    cells: Integers  # (m, 3) rows of `points`

    @classmethod
    def of(cls, call: str, scene: Scene) -> WholeSurface:
        """The current shape. Collective."""
        scene.membrane.check_finite(call)
        membrane = scene.membrane
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
    def _balls(self) -> Balls:
        return Balls.of(self._corners)

    @cached_property
    def size(self) -> float:
        """Mean cell size (length)."""
        return float(np.sqrt(norm(double_areas(self._corners)).mean()))

    def _near(self, point: Array, reach: float) -> Integers:
        """Rows of the cells possibly within reach of a point."""
        return self._balls.within(point[None], np.array([reach * (1 + SAME_POINT)]))[1]

    def place(self, point: Array) -> Array:
        """Point on the surface (3,) for a point in plan (2,) or in space (3,)."""
        if len(point) == 3:
            foot = feet_of(self.points, self.cells, point[None])[0]
            if foot.distance > foot.size:
                raise PathError(
                    f"{as_text(point)} is {foot.distance:.6g} from the membrane, nearest to "
                    f"{as_text(foot.position)}."
                )
            return foot.position
        target = TargetSurface.of(self.strip.vertices, self.points, self.cells)
        return places_in_plan(target, point[None])[0].position

    def normal(self, point: Array) -> Array:
        """Unit normal (3,) of the smooth surface at a point; at creases the facet's."""
        near = self._balls.nearest(point[None])[1]
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
                    "has no meaning there; use one in space."
                )
            way[2] = -(way @ normal) / normal[2]
        way = way - (way @ normal) * normal
        if norm(way) < 1e-6 * np.linalg.norm(direction):
            raise PathError(
                f"direction {as_text(direction)} is normal to the membrane at {as_text(point)}."
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
        root = np.sqrt(np.maximum(left, 0.0) / square)
        kept: list[Array] = []
        for sign in (-1.0, 1.0):
            y = middle + foot + sign * root[:, None] * line
            opposite = cross(x[:, [1, 2, 0]] - y[:, None], x[:, [2, 0, 1]] - y[:, None])
            weights = dot(opposite, normals[:, None]) / dot(normals, normals)[:, None]
            for point in y[np.all(weights >= -SAME_PLACE, axis=1) & (left >= 0.0)]:
                if all(norm(point - other) > SAME_POINT * reach for other in kept):
                    kept.append(point)
        return np.array(kept).reshape(-1, 3)

    def step(self, point: Array, way: Array, length: float) -> Array | None:
        """The point straight ahead at a distance; None if the surface ends before."""
        across = cross(self.normal(point), way)
        x = self._corners[self._near(point, length)]
        height = dot(x - point, across)
        above = height >= 0.0
        cut = above.any(axis=1) & ~above.all(axis=1)
        x, height, above = x[cut], height[cut], above[cut]
        every = np.arange(len(x))
        alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
        starts, ends = (
            _crossing(x[every, alone], x[every, k], height[every, alone], height[every, k])
            for k in ((alone + 1) % 3, (alone + 2) % 3)
        )
        sides = ends - starts
        from_start = starts - point
        a, b = dot(sides, sides), dot(sides, from_start)
        left = b**2 - a * (dot(from_start, from_start) - length**2)
        meets = (left >= 0.0) & (a > 0.0)
        starts, sides, a, b, left = (v[meets] for v in (starts, sides, a, b, left))
        roots = [(-b + sign * np.sqrt(left)) / a for sign in (-1.0, 1.0)]
        low, high = -SAME_PLACE, 1 + SAME_PLACE
        found = np.concatenate(
            [(starts + s[:, None] * sides)[(low <= s) & (s <= high)] for s in roots]
        )
        ahead = dot(found - point, way)
        return found[np.argmax(ahead)] if np.any(ahead > 0.0) else None

    @cached_property
    def rim(self) -> Array:
        """Boundary edges (e, 2, 3)."""
        table = EdgeTable.of(self.cells)
        return self.points[table.vertices[table.counts == 1]]

    def rim_ahead(self, point: Array, way: Array, reach: float) -> Array | None:
        """First crossing of the rim straight ahead, within reach; None if there is none."""
        found = crossed(self.rim, dot(self.rim - point, cross(self.normal(point), way)))
        away = norm(found - point)
        ahead = (dot(found - point, way) > SAME_POINT * reach) & (away <= reach * (1 + SAME_PLACE))
        return found[ahead][np.argmin(away[ahead])] if ahead.any() else None

    def to_rim(self, line: list[Array], length: float, way: Array | None = None) -> list[Array]:
        """Extend a line straight by steps, one of a single point along `way`, to the rim or until
        it closes."""
        line = list(line)
        if way is None:
            way = (line[-1] - line[-2]) / norm(line[-1] - line[-2])
        while True:
            last = line[-1]
            new = self.step(last, way, length)
            if new is None:
                end = self.rim_ahead(last, way, length)
                return line if end is None else [*line, end]
            before = np.array(line[:-1]).reshape(-1, 3)
            if (norm(before - new) < length * (1 - SAME_POINT)).any():
                return line
            line.append(new)
            way = (new - last) / norm(new - last)


def _crossing(a: Array, b: Array, height_a: Array, height_b: Array) -> Array:
    """Points (k, d) where edges from a to b (k, d) have the height zero."""
    return a + (height_a / (height_a - height_b))[:, None] * (b - a)


def crossed(edges: Array, heights: Array) -> Array:
    """Points (k, d) of the edges (e, 2, d) between whose ends the heights (e, 2) change sign."""
    cut = (heights[:, 0] >= 0.0) != (heights[:, 1] >= 0.0)
    return _crossing(edges[cut, 0], edges[cut, 1], heights[cut, 0], heights[cut, 1])
