"""Trace the path of a cable along a route given in plan or in space.

Each leg of a route is the shortest path from its start to its end within the section of the surface
with a plane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.triangles import dot, flattened, longest_sides, norm, vectors
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, floats
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import (
    RIM,
    SNAP,
    Balls,
    Place,
    TargetSurface,
    feet_of,
    places_in_plan,
    places_in_space,
)
from crms_fenicsx.foundation.surface.path import Path, without_backtracking
from crms_fenicsx.foundation.surface.plane_section import (
    END,
    START,
    Cut,
    Node,
    Plane,
    Section,
    cuts,
    section_of,
    shortest,
    strips,
    way_back,
)
from crms_fenicsx.foundation.surface.points import CellPoint, SurfacePoint

# Ratio of direct to actual length below which a path is a detour around the back: two ways around a
# tube of nearly the same length are equally good.
DETOUR = 0.95


def route_points(route: object) -> Array:
    """The points of a route or of a cable's path, (k, 2) or (k, 3)."""
    try:
        course = np.array(route, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise PathError(
            f"path: {route!r} must be a list of points of one dimension: all in plan, (x, y), or "
            "all in space, (x, y, z), as a joint is."
        ) from None
    if course.ndim != 2 or course.shape[1] not in (2, 3) or len(course) < 2:
        raise PathError(
            f"path: an array of shape {course.shape}; pass two or more points in plan, (k, 2), or "
            "in space, (k, 3)."
        )
    bad = np.flatnonzero(~np.isfinite(course).all(axis=1))
    if len(bad):
        i = int(bad[0])
        raise PathError(f"path: point {i} is {course[i].tolist()}, which is not finite.")
    return course


def checked_route(route: object) -> Array:
    """The points of a route on which a path can be traced, (k, 2) or (k, 3)."""
    course = route_points(route)
    same = np.flatnonzero((course[1:] == course[:-1]).all(axis=1))
    if len(same):
        i = int(same[0])
        raise PathError(f"route points {i} and {i + 1} are both {as_text(course[i])}; remove one.")
    return course


def near_section(
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    comm: MPI.Intracomm | None = None,
    along_legs: bool = False,
) -> Booleans:
    """Mask (m,) of cells on which `trace` finds the same path as on the whole mesh; with
    `along_legs`, of fewer cells, which suffice if the legs without an anchor are direct."""
    course = checked_route(route)
    x = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    rows = np.asarray(cells, dtype=np.int64).reshape(-1, 3)
    size = float(np.max(longest_sides(x[rows]), initial=0.0))
    if comm is not None:
        size = comm.allreduce(size, op=MPI.MAX)
    mask = np.zeros(len(rows), dtype=np.bool_)
    if course.shape[1] == 2:
        ends = np.column_stack([course, np.zeros(len(course))])
        up, margin = np.array([0.0, 0.0, 1.0]), 3.0 * size if along_legs else np.inf
        # trace may move ends to the rim, and the plane along
        ups = np.broadcast_to(up, ends[1:].shape)
        planes = [plane for plane in Plane.of_legs(ends[:-1], ends[1:], ups, ups) if plane]
        mask[strips(planes, x, rows, (RIM + SNAP) * size, margin)[1]] = True
        balls = Balls.of(flattened(x[rows]))
        least = balls.least_reach(ends)
        if comm is not None:
            comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
        # cells that trace names when the route leaves the membrane
        mask[balls.within(ends, least)[1]] = True
        return mask
    feet = feet_of(x, rows, course, comm)
    balls = Balls.of(x[rows])
    # cells around the vertices of the nearest cell, which determine the normal
    places = np.array([foot.position for foot in feet])
    sizes = np.array([foot.size for foot in feet])
    mask[balls.within(places, sizes * (1.0 + 1e-9) + SNAP * size)[1]] = True
    legs, straight = [], []
    for i in range(len(course) - 1):
        # an end is an anchor depending on the boundary, which a single rank may not see
        starts = [places[i]] + ([course[i]] if i == 0 else [])
        stops = [places[i + 1]] + ([course[i + 1]] if i == len(course) - 2 else [])
        if along_legs and all(np.array_equal(own[0], own[-1]) for own in (starts, stops)):
            straight.append(i)
            continue
        for a in starts:
            for b in stops:
                if norm(b - a) > 0.0:
                    legs.append((a, b, feet[i].normal, feet[i + 1].normal))
    planes = []
    if legs:  # of one without a plane trace says so
        planes = [plane for plane in Plane.of_legs(*np.array(legs).swapaxes(0, 1)) if plane]
    mask[strips(planes, x, rows, SNAP * size, np.inf)[1]] = True
    if straight:  # no point of a path is farther from the leg's middle than half the path's length
        a, b = places[straight], places[np.array(straight) + 1]
        reach = 0.5 * norm(b - a) / DETOUR + 2.0 * size
        mask[balls.within(0.5 * (a + b), reach)[1]] = True
    return mask


class IndirectLeg(LookupError):  # noqa: N818 - no error: a request for data
    """A leg is not direct: the cells along it do not suffice to find its path."""


def trace(
    vertices: ArrayLike,
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    known: Mapping[int, SurfacePoint] = MappingProxyType({}),
    along_legs: bool = False,
    covers: ArrayLike = (),
) -> Path:
    """Path of a cable over a surface along a route (k, 2) or (k, 3). Route corners inside cells are
    cut off, by at most a cell's size. Legs may cross `covers` (q, 3), more cells over holes."""
    surface = TargetSurface.of(vertices, points, cells)
    course = checked_route(route)
    if course.shape[1] == 2:
        places = places_in_plan(surface, course)
    else:
        places = places_in_space(surface, course, known)
    more = np.asarray(covers, dtype=np.int64).reshape(-1, 3)
    if len(more):
        surface = replace(surface, cells=np.concatenate([surface.cells, more]))
    found: list[SurfacePoint] = []
    ways = _direct_ways(surface, places)
    for i, (first, last) in enumerate(pairwise(places)):
        leg = ways[i]
        if leg is None:
            if along_legs and first.point is not None and last.point is not None:
                raise IndirectLeg
            leg = _leg_points(surface, first, last, f"leg {i} of the route")
        if found and isinstance(found[-1], CellPoint):  # cut off a corner inside a cell
            found, leg = found[:-1], leg[1:]
        found += leg
    kept = without_backtracking(found, surface.ids[surface.cells])
    if len(kept) < 2:
        raise PathError(
            f"a route with {len(course)} points meets the membrane in one place only, or turns "
            f"back on itself until nothing is left (near {as_text(places[0].position)}); "
            "move its points apart."
        )
    path = Path(kept, start_anchor=places[0].anchor, end_anchor=places[-1].anchor)
    path.links(surface.ids[surface.cells])
    _refuse_shortcuts(surface, path, course, places)
    return path


def _refuse_shortcuts(
    surface: TargetSurface, path: Path, course: Array, places: list[Place]
) -> None:
    """Refuse a path that does not pass the route points in order, within a cell's size."""
    # A route that returns through the same cells cannot be represented by edge crossings: both
    # ways cancel, which is right at a corner inside a cell, but not for a longer part of a route.
    x = path.positions(surface.ids, surface.points)
    starts, sides = (list(map(floats, vectors(rows))) for rows in (x[:-1], np.diff(x, axis=0)))
    longest = floats(longest_sides(surface.points[surface.cells]))
    k, passed = 0, 0.0  # the path's segment that is reached, and the fraction passed of it
    for i, place in enumerate(places):
        if place.point is None:
            continue
        reach = max(longest[row] for row in surface.cells_with(place.point.support))
        while k < len(sides):
            found = _passes(starts[k], sides[k], floats(place.position), reach)
            if found is not None and max(found[0], passed) <= min(found[1], 1.0):
                passed = max(found[0], passed)
                break
            k, passed = k + 1, 0.0
        else:
            raise PathError(
                f"route point {i} at {as_text(course[i])} would be cut off, as the route comes "
                "back through the cells it came from; lead it around a bend wider than a "
                "cell, refine the mesh, or lay two cables."
            )


def _passes(
    start: list[float], side: list[float], place: list[float], reach: float
) -> tuple[float, float] | None:
    """Fractions of a segment between which it is within `reach` of a place."""
    (a, b, c), (u, v, w) = (p - q for p, q in zip(place, start, strict=True)), side
    square = max(u * u + v * v + w * w, 1e-300)
    middle = (a * u + b * v + c * w) / square
    left = reach**2 - (a - middle * u) ** 2 - (b - middle * v) ** 2 - (c - middle * w) ** 2
    if left < 0.0:
        return None
    half = math.sqrt(left / square)
    return middle - half, middle + half


def _leg_points(surface: TargetSurface, first: Place, last: Place, name: str) -> list[SurfacePoint]:
    """Surface points of one leg, including its ends unless they are anchors."""
    if np.array_equal(first.position, last.position):
        raise PathError(
            f"{name} has no length: both its ends lie at {as_text(first.position)} of the membrane;"
            " move them apart."
        )
    for anchor, other in ((first, last), (last, first)):
        if other.point is not None and anchor.foot is not None:
            if norm(anchor.foot.position - other.position) <= surface.snap * anchor.foot.size:
                return [other.point]  # directly below the anchor
    plane = Plane.of(first.position, last.position, first.normal, last.normal)
    section = section_of(cuts(surface, [plane], [(first, last)])[0], name)
    gaps = section.gaps()
    start = _end_node(section, first, START, surface)
    end = _end_node(section, last, END, surface)
    if start is not None and end is not None:
        points = [section.points[node] for node in dict.fromkeys((start, end))]
        if surface.cells_with(*(point.support for point in points)):
            return points
    advance = {
        node: float(dot(x - plane.origin, plane.ahead)) for node, x in section.positions.items()
    }
    if start is None or end is None:
        # from an anchor, only the part between the leg's ends is visible
        seen = sorted(
            (advance[node], node)
            for node in section.rim
            if (section.arcs[node] or node in (start, end))
            and -1e-9 <= advance[node] / plane.length <= 1.0 + 1e-9
        )
        if not seen:
            raise PathError(
                f"{name} from {as_text(first.position)} to {as_text(last.position)} never meets "
                "the membrane's boundary; move its anchor."
            )
        start = seen[0][1] if start is None else start
        end = seen[-1][1] if end is None else end
    reached, before = shortest(section.arcs, start)
    if end not in reached:
        exits = [node for node in reached if node in section.rim and node != start] or list(reached)
        node = max(exits, key=lambda node: (advance[node], node))
        raise PathError(
            f"{name} leaves the membrane at {as_text(section.positions[node])} "
            f"({section.points[node]}) before its end; lead the route around, through points on "
            "the membrane."
        )
    _refuse_detour(section, gaps, start, end, reached[end], name)
    return [section.points[node] for node in way_back(before, end)]


def _direct_ways(surface: TargetSurface, places: list[Place]) -> list[list[SurfacePoint] | None]:
    """Points of the direct legs; None for others."""
    ways: list[list[SurfacePoint] | None] = [None] * (len(places) - 1)
    others: list[tuple[int, Place, Place]] = []
    for i, (first, last) in enumerate(pairwise(places)):
        if first.point is None or last.point is None:
            continue
        if np.array_equal(first.position, last.position):
            continue
        if surface.cells_with(first.point.support, last.point.support):
            ways[i] = [first.point, last.point]
        else:
            others.append((i, first, last))
    if not others:
        return ways
    ends = [(first, last) for _, first, last in others]
    a, b = (np.array([both[k].position for both in ends]) for k in (0, 1))
    normals = (np.array([both[k].normal for both in ends]) for k in (0, 1))
    # An error of a leg without a plane is raised when it is its turn.
    legs = [
        (*o, plane) for o, plane in zip(others, Plane.of_legs(a, b, *normals), strict=True) if plane
    ]
    along = cuts(surface, [leg[3] for leg in legs], [leg[1:3] for leg in legs], 2.0 * surface.size)
    for (i, first, last, plane), cut in zip(legs, along, strict=True):
        ways[i] = _direct_way(surface, plane, first, last, cut)
    return ways


def _direct_way(
    surface: TargetSurface, plane: Plane, first: Place, last: Place, cut: Cut
) -> list[SurfacePoint] | None:
    """Points of a leg that is the shortest path on the whole surface, from the cells around it."""
    # A path that leaves these cells is longer than the leg by twice a cell's size, and one across
    # an opening is no shorter than the straight line.
    assert first.point is not None and last.point is not None
    try:
        section = section_of(cut, "a leg")
    except PathError:  # possibly in cells at the end of the strip
        return None
    start = section.put(first.point, first.position, START)
    end = section.put(last.point, last.position, END)
    reached, before = shortest(section.arcs, start)
    straight = float(norm(last.position - first.position))
    longest = min(straight / DETOUR, plane.length + 2.0 * surface.size)
    if reached.get(end, np.inf) > longest:
        return None
    points = [section.points[node] for node in dict.fromkeys((start, end))]
    if surface.cells_with(*(point.support for point in points)):
        return points
    return [section.points[node] for node in way_back(before, end)]


def _end_node(section: Section, place: Place, own: Node, surface: TargetSurface) -> Node | None:
    """The section's node at an end of the leg; None for an anchor beyond the boundary."""
    if place.point is not None:
        return section.put(place.point, place.position, own)
    if place.beyond:
        return None
    # not at the foot itself, which generally lies beside the plane: spans hanging from the anchor
    # shall be above the path
    found = section.nearest(place.position, surface)
    return None if found is None else section.put(*found, own)


def _refuse_detour(
    section: Section,
    gaps: dict[tuple[Node, Node], float],
    start: Node,
    end: Node,
    length: float,
    name: str,
) -> None:
    """Refuse a path around the back if the direct one is interrupted by an opening."""
    if not gaps:
        return
    arcs = {node: dict(others) for node, others in section.arcs.items()}
    for (a, b), width in gaps.items():
        arcs[a][b] = arcs[b][a] = width
    reached, before = shortest(arcs, start)
    if reached[end] >= DETOUR * length:
        return
    for a, b in pairwise(way_back(before, end)):
        if (a, b) in gaps or (b, a) in gaps:
            raise PathError(
                f"{name} leaves the membrane at {as_text(section.positions[a])} "
                f"({section.points[a]}) before its end, comes back at "
                f"{as_text(section.positions[b])} and could only go around the back, "
                f"{length:.6g} long instead of {reached[end]:.6g}; lead the route around the "
                "opening, or the back, through points on the membrane."
            )
