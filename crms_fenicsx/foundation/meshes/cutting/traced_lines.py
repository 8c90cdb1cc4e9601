"""Lines traced over a surface, whose ends lie at rims, at groups or on each other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.division import CutNodes, Leg
from crms_fenicsx.foundation.meshes.cutting.feature_edges import SHORT, FeatureEdges
from crms_fenicsx.foundation.meshes.edge_table import edges_of
from crms_fenicsx.foundation.meshes.plan_lines import APART, MEETS
from crms_fenicsx.foundation.meshes.surface import CheckedSurface
from crms_fenicsx.foundation.meshes.triangles import (
    closest_on_segments,
    flattened,
    longest_sides,
    norm,
    vectors,
)
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, runs
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import SNAP, Balls
from crms_fenicsx.foundation.surface.points import Support, SurfacePoint
from crms_fenicsx.foundation.surface.trace import IndirectLeg, near_section, trace

REACH = 3.0
"""Length, relative to the cells, over which a line leads to an end that was moved."""


@dataclass
class TracedLine:
    """A line over the surface."""

    name: str
    route: Array = field(repr=False)  # (k, 2) or (k, 3)
    points: Sequence[SurfacePoint] = field(repr=False)
    places: Array = field(repr=False)  # (n, 3) of the points
    sizes: tuple[float, float]  # of the cells at both ends


class Tracer:
    """Traces lines over the cells of a surface that are not hidden."""

    def __init__(self, surface: CheckedSurface) -> None:
        self.surface, self.points = surface, surface.points
        self.cells = np.delete(surface.cells, surface.hidden, axis=0)
        self.longest = longest_sides(self.points[self.cells])

    def lines(self, routes: Iterable[tuple[str, Array]]) -> list[TracedLine]:
        """The lines along named routes."""
        return [self.line(name, route) for name, route in routes]

    def line(self, name: str, route: Array) -> TracedLine:
        """The line along a route."""
        try:
            try:
                return self._traced(name, route, along_legs=True)
            except (IndirectLeg, PathError):
                return self._traced(name, route, along_legs=False)
        except PathError as error:
            raise PathError(f"along: the line {name!r}: {error}") from None

    def _near(self, route: Array, along_legs: bool) -> Integers:
        """The cells on which the path of a route is found, as `near_section` says, but if legs
        are direct from a tree that serves all lines."""
        if not along_legs:
            return np.flatnonzero(near_section(self.points, self.cells, route))
        flat = route.shape[1] == 2
        course = np.pad(route, ((0, 0), (0, 1))) if flat else route
        balls = self.flat_balls if flat else self.balls
        size, legs = float(self.longest.max()), np.diff(course, axis=0)
        steps = np.ceil(norm(legs) / size).astype(np.int64)
        part = runs(np.zeros_like(steps), steps) / steps.repeat(steps)
        at = course[:-1].repeat(steps, axis=0) + part[:, None] * legs.repeat(steps, axis=0)
        at = np.concatenate([at, course[-1:]])
        return np.unique(balls.within(at, np.full(len(at), size))[1])

    @cached_property
    def balls(self) -> Balls:
        """Around the cells."""
        return Balls.of(self.points[self.cells])

    @cached_property
    def flat_balls(self) -> Balls:
        """Around the cells in plan."""
        return Balls.of(flattened(self.points[self.cells]))

    def _traced(self, name: str, route: Array, *, along_legs: bool) -> TracedLine:
        near = self._near(route, along_legs)
        near = near if len(near) else np.arange(len(self.cells))  # far off: `trace` names the place
        cells, longest = self.cells[near], self.longest[near]
        ids = np.unique(cells)
        rows, x = np.searchsorted(ids, cells), self.points[ids]
        path = trace(ids, x, rows, route, along_legs=along_legs)
        sizes = []
        for end in (path.points[0], path.points[-1]):
            own = np.isin(cells, end.support).sum(axis=1) == len(end.support)
            sizes.append(float(longest[own].mean()))
        places = path.positions(ids, x)
        return TracedLine(name, route, path.points, places, (sizes[0], sizes[1]))


def with_merged_ends(
    tracer: Tracer, features: FeatureEdges, traced: Sequence[TracedLine]
) -> list[TracedLine]:
    """Lines with ends that nearly meet merged."""
    lines = list(traced)
    kept = _segments(tracer.points, features.keys())
    # each place where ends meet, and where a line from there ends: nowhere from corners
    corners = tracer.points[features.corners(tracer.points)]
    settled = [(corner, np.full(3, np.inf)) for corner in vectors(corners)]
    for k, line in enumerate(lines):
        for end, far in ((0, -1), (-1, 0)):
            others = [other.places for other in lines if other is not line]
            target = _target(line, end, features, settled, kept, others)
            if target is not None:
                line = lines[k] = tracer.line(line.name, _led_to(line, end, target))
            settled.append((line.places[end], line.places[far]))
    return lines


def _segments(points: Array, keys: Integers) -> Array:
    """Ends (k, 2, 3) of edges."""
    return points[np.array(edges_of(keys), dtype=np.int64).reshape(-1, 2)]


def _target(
    line: TracedLine,
    end: int,
    features: FeatureEdges,
    settled: Sequence[tuple[Array, Array]],
    kept: Array,
    others: Sequence[Array],
) -> Array | None:
    """The place to which an end of a line moves; None if it stays."""
    place, reach = line.places[end], MEETS * line.sizes[end]
    ends = np.array(settled).reshape(-1, 2, 3)
    gaps = norm(ends[:, 0] - place)
    gaps[norm(ends[:, 1] - line.places[-1 - end]) <= reach] = np.inf  # lines side by side
    if len(ends) and gaps.min() <= reach:
        found: Array = ends[int(np.argmin(gaps)), 0]
        return None if gaps.min() <= SNAP * line.sizes[end] else found
    if features.on(line.points[end]):
        return None
    other_ends = np.array([x[k] for x in others for k in (0, -1)]).reshape(-1, 3)
    if len(other_ends) and norm(other_ends - place).min() <= reach:
        return None  # the other one moves here
    segments = np.concatenate([kept, *(np.stack([x[:-1], x[1:]], axis=1) for x in others)], axis=0)
    nearest, gap = _closest_on(segments, place)
    if gap <= reach:
        return None if gap <= SNAP * line.sizes[end] else nearest
    raise PathError(
        f"along: the line {line.name!r} ends inside the surface at {as_text(place)}, {gap:.6g} "
        f"from the nearest place where it may end, {as_text(nearest)}; lead it to the rim, to a "
        "named group of edges or points, or to another of the lines."
    )


def _closest_on(segments: Array, place: Array) -> tuple[Array, float]:
    """The closest point (3,) of segments (k, 2, 3), and its distance."""
    _, on, gaps = closest_on_segments(segments[:, 0], segments[:, 1] - segments[:, 0], place)
    nearest = int(np.argmin(gaps))
    return on[nearest], float(gaps[nearest])


def _led_to(line: TracedLine, end: int, target: Array) -> Array:
    """A line's route that ends elsewhere, straight over the last cells."""
    size = line.route.shape[1]
    route = line.route if end == -1 else line.route[::-1]
    away = norm(np.pad(route - target[:size], ((0, 0), (0, 3 - size))))
    kept = route[(away > REACH * line.sizes[end]) & (np.arange(len(route)) < len(route) - 1)]
    if not len(kept):
        kept = route[:1]
    led = np.concatenate([kept, target[None, :size]])
    return led if end == -1 else led[::-1]


def check_apart(nodes: CutNodes, legs: Mapping[str, Sequence[Leg]]) -> None:
    """Refuse lines that run side by side, or back along themselves."""
    there: dict[Support, list[tuple[str, int, int]]] = {}
    for name, own in legs.items():
        for support, way in own:
            there.setdefault(support, []).append((name, way[0], way[-1]))
    cells = [support for support in there if len(support) == 3]
    for cell in cells:  # with lines along their sides
        for edge in ((cell[0], cell[1]), (cell[0], cell[2]), (cell[1], cell[2])):
            there[cell] += there.get(edge, ())
    x = nodes.places
    for support, ways in there.items():
        if len(ways) == 1:
            continue
        pairs = np.array(list(combinations(support, 2)))
        size = float(norm(nodes.corners[pairs[:, 1]] - nodes.corners[pairs[:, 0]]).max())
        for (one, a, b), (other, c, d) in combinations(ways, 2):
            if norm(x[a] - x[b]) > norm(x[c] - x[d]):
                one, a, b, other, c, d = other, c, d, one, a, b
            if norm(x[a] - x[b]) < SHORT * size:
                continue
            along = np.array([[x[c], x[d]]])
            gap = max(_closest_on(along, x[v])[1] for v in (a, b))
            if gap <= APART * size:
                what = f"runs back along itself, {gap:.3g} apart,"
                if one != other:
                    what = f"and the line {other!r} run side by side, {gap:.3g} apart,"
                raise PathError(
                    f"along: the line {one!r} {what} at {as_text(x[a])}, where cells are "
                    f"{size:.3g} long; leave one out, lead them apart, or refine the mesh."
                )
