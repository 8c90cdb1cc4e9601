"""Tracing: the path of a cable from a route given in plan or in space.

Each leg of a route is the shortest way from its start to its end within the section of the surface
with one plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import NoReturn

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.runtime.errors import PathError, as_text
from crms_fenicsx.surface.closest_point import (
    RIM,
    Node,
    Place,
    Surface,
    foot_of,
    place_in_plan,
    places_in_space,
)
from crms_fenicsx.surface.path import Path, without_backtracking
from crms_fenicsx.surface.plane_section import (
    END,
    START,
    Plane,
    Section,
    in_strip,
    section_with,
    shortest,
    way_back,
)
from crms_fenicsx.surface.points import CellPoint, SurfacePoint
from crms_fenicsx.surface.triangles import balls, dot, flattened, longest_sides, norm, vectors

# The direct way is shorter than one around the back by more than this: two ways around a tube that
# are about as long are as good as each other.
DETOUR = 0.95


def trace(
    vertices: ArrayLike,
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    snap: float = 1e-3,
    known: Mapping[int, SurfacePoint] = MappingProxyType({}),
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
        In space, a first or last point off the membrane is an anchor. Beyond the boundary, the
        path begins where the leg's section first meets the boundary, seen from the anchor; over
        the membrane, at the section's place nearest to the anchor.
    snap
        Vertices nearer to a section than this part of the smallest altitude of the cells around
        them count as lying in it; route points as near to a vertex or an edge lie on it.
    known
        Places on the surface of points of a route in space, by their numbers; others are found.

    Returns
    -------
    A valid path, which passes every point of the route on the surface, in order. Corners of the
    route that lie inside cells are cut off: the points where it enters and leaves such a cell are
    linked, or cancel where it leaves as it came; by no more than a cell's size.

    Raises
    ------
    PathError
        The input is no surface or no route, the route leaves the membrane or could only go around
        its back, an anchor lies inside, a leg has no section, or the route comes back through the
        cells that it went out by; the message names the place.
    """
    surface = Surface.checked(vertices, points, cells)
    course = _checked_route(route, snap)
    if course.shape[1] == 2:
        places = [place_in_plan(surface, xy, i, snap) for i, xy in enumerate(vectors(course))]
    else:
        places = places_in_space(surface, course, snap, known)
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
            f"back on itself until nothing is left (near {as_text(places[0].position)}); "
            "move its points apart"
        )
    path = Path(
        kept,
        start_anchor=places[0].anchor,
        end_anchor=places[-1].anchor,
    )
    path.links(surface.ids[surface.cells])
    _refuse_shortcuts(surface, path, course, places)
    return path


def near_section(
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    snap: float = 1e-3,
    comm: MPI.Intracomm | None = None,
) -> Booleans:
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
    size = float(np.max(longest_sides(x[rows]), initial=0.0))
    if comm is not None:
        size = comm.allreduce(size, op=MPI.MAX)
    mask = np.zeros(len(rows), dtype=np.bool_)
    up = np.array([0.0, 0.0, 1.0])
    if course.shape[1] == 2:
        ends = np.column_stack([course, np.zeros(len(course))])
        for a, b in pairwise(vectors(ends)):  # trace may move ends to the rim, and the plane along
            mask |= in_strip(Plane.of(a, b, up, up), x, rows, (RIM + snap) * size)
        flat = flattened(x[rows])
        centre, radius = balls(flat)
        for target in vectors(ends):  # what trace names when the route leaves the membrane
            least = float(np.min(norm(flat - target), initial=np.inf))
            if comm is not None:
                least = comm.allreduce(least, op=MPI.MIN)
            mask |= norm(centre - target) - radius <= least * (1.0 + 1e-9)
        return mask
    feet = [foot_of(x, rows, target, comm) for target in vectors(course)]
    centre, radius = balls(x[rows])
    for foot in feet:
        # all around the vertices of the nearest cell, which make the normal
        mask |= norm(centre - foot.position) - radius <= foot.size * (1.0 + 1e-9) + snap * size
    for i in range(len(course) - 1):
        # whether an end is an anchor depends on the boundary, which one rank may not see
        starts = [feet[i].position] + ([course[i]] if i == 0 else [])
        stops = [feet[i + 1].position] + ([course[i + 1]] if i == len(course) - 2 else [])
        for a in starts:
            for b in stops:
                if norm(b - a) == 0.0:
                    continue
                with suppress(PathError):  # if this is the leg, trace says so
                    plane = Plane.of(a, b, feet[i].normal, feet[i + 1].normal)
                    mask |= in_strip(plane, x, rows, snap * size)
    return mask


def _refuse_shortcuts(surface: Surface, path: Path, course: Array, places: list[Place]) -> None:
    """Refuse a path that does not pass the route's places in order, within the size of their cells.

    A route that comes back through the cells that it went out by cannot be held by their edges:
    both ways cancel, which is right at a corner inside a cell, but not of a whole part of a route.
    """
    x = path.positions(surface.ids, surface.points)
    start, side = x[:-1], np.diff(x, axis=0)
    square = np.maximum(dot(side, side), 1e-300)
    passed = 0.0  # segments of the path that lie behind, with the part of the last one
    for i, place in enumerate(places):
        if place.point is None:
            continue
        rows = [surface.row_of[vertex] for vertex in place.point.support]
        around = np.isin(surface.cells, rows).sum(axis=1) == len(rows)
        reach = float(longest_sides(surface.points[surface.cells[around]]).max())
        middle = dot(place.position - start, side) / square
        aside = norm(start + middle[:, None] * side - place.position)
        half = np.sqrt(np.maximum(reach**2 - aside**2, 0.0) / square)
        first = np.maximum(middle - half, np.maximum(passed - np.arange(len(side)), 0.0))
        near = (aside <= reach) & (first <= np.minimum(middle + half, 1.0))
        if not near.any():
            raise PathError(
                f"route point {i} at {as_text(course[i])} would be cut off, as the route comes "
                "back through the cells that it went out by; lead it around a bend wider than a "
                "cell, refine the mesh, or lay two cables"
            )
        k = int(np.argmax(near))
        passed = k + float(first[k])


def _checked_route(route: ArrayLike, snap: float) -> Array:
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
    for i, point in enumerate(vectors(course)):
        if not np.isfinite(point).all():
            raise PathError(f"route point {i} is {as_text(point)}; give finite coordinates")
        if i and np.array_equal(point, course[i - 1]):
            raise PathError(f"route points {i - 1} and {i} are both {as_text(point)}; drop one")
    return course


def _leg_points(
    surface: Surface, first: Place, last: Place, name: str, snap: float
) -> list[SurfacePoint]:
    """Return the points of the surface on one leg, its ends (if no anchors) among them."""
    if np.array_equal(first.position, last.position):
        raise PathError(
            f"{name} has no length: both its ends lie at {as_text(first.position)} of the membrane;"
            " move them apart"
        )
    known = [place.point for place in (first, last) if place.point is not None]
    if len(known) == 2 and _in_one_cell(surface, known):
        return known
    for anchor, other in ((first, last), (last, first)):
        if other.point is not None and anchor.is_straight_over(other.position, snap):
            return [other.point]
    plane = Plane.of(first.position, last.position, first.normal, last.normal)
    direct = _direct_way(surface, plane, first, last, name, snap)
    if direct is not None:
        return direct
    section = section_with(surface, plane, (first, last), name, snap)
    gaps = section.gaps()
    start = _end_node(section, first, START, surface, snap)
    end = _end_node(section, last, END, surface, snap)
    if start is not None and end is not None:
        points = [section.points[node] for node in dict.fromkeys((start, end))]
        if _in_one_cell(surface, points):
            return points
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
                f"{name} from {as_text(first.position)} to {as_text(last.position)} never meets "
                "the membrane's boundary; move its anchor"
            )
        start = seen[0][1] if start is None else start
        end = seen[-1][1] if end is None else end
    reached, before = shortest(section.arcs, start)
    if end not in reached:
        _raise_leaves(section, reached, start, advance, name)
    _refuse_detour(section, gaps, start, end, reached[end], name)
    return [section.points[node] for node in way_back(before, end)]


def _direct_way(
    surface: Surface, plane: Plane, first: Place, last: Place, name: str, snap: float
) -> list[SurfacePoint] | None:
    """Return the points of a leg that goes straight on, found in the cells around it alone.

    None unless it is the shortest way on the whole surface: one that leaves these cells is longer
    than the leg by twice a cell's size, and one over an opening is no shorter than straight on.
    """
    if first.point is None or last.point is None:
        return None
    advance, margin = plane.advances(surface.points), 2.0 * surface.size
    near = (-margin < advance) & (advance < plane.length + margin)
    around = replace(surface, cells=surface.cells[near[surface.cells].any(axis=1)])
    try:
        section = section_with(around, plane, (first, last), name, snap)
    except PathError:  # perhaps of cells at the end of what is seen here
        return None
    start = section.put(first.point, first.position, START)
    end = section.put(last.point, last.position, END)
    reached, before = shortest(section.arcs, start)
    straight = float(norm(last.position - first.position))
    longest = min(straight / DETOUR, plane.length + 2.0 * surface.size)
    if reached.get(end, np.inf) > longest:
        return None
    points = [section.points[node] for node in dict.fromkeys((start, end))]
    if _in_one_cell(surface, points):
        return points
    return [section.points[node] for node in way_back(before, end)]


def _in_one_cell(surface: Surface, points: list[SurfacePoint]) -> bool:
    """Say whether a cell holds all the points."""
    held = np.zeros(len(surface.ids), dtype=np.bool_)
    held[[surface.row_of[vertex] for point in points for vertex in point.support]] = True
    return bool((held[surface.cells].sum(axis=1) == held.sum()).any())


def _end_node(
    section: Section, place: Place, own: Node, surface: Surface, snap: float
) -> Node | None:
    """Return the section's node at an end of the leg; None for an anchor beyond the boundary."""
    if place.point is not None:
        return section.put(place.point, place.position, own)
    if place.beyond:
        return None
    # not at the foot itself, which in general lies beside the plane: what hangs straight from the
    # anchor shall hang over the path
    found = section.nearest(place.position, surface, snap)
    return None if found is None else section.put(*found, own)


def _raise_leaves(
    section: Section,
    reached: dict[Node, float],
    start: Node,
    advance: dict[Node, float],
    name: str,
) -> NoReturn:
    exits = [node for node in reached if node in section.rim and node != start] or list(reached)
    node = max(exits, key=lambda node: (advance[node], node))
    raise PathError(
        f"{name} leaves the membrane at {as_text(section.positions[node])} ({section.points[node]})"
        " before its end; lead the route around, through points on the membrane"
    )


def _refuse_detour(
    section: Section,
    gaps: dict[tuple[Node, Node], float],
    start: Node,
    end: Node,
    length: float,
    name: str,
) -> None:
    """Refuse a way around the back, where the direct one is interrupted by an opening."""
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
                "opening, or the back, through points on the membrane"
            )
