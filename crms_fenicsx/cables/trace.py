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

from crms_fenicsx.cables.locate import (
    RIM,
    WALL,
    Floats,
    Ints,
    Node,
    Place,
    Surface,
    altitudes,
    as_text,
    balls,
    cross,
    dot,
    double_areas,
    edge_count,
    flattened,
    foot_of,
    lists,
    longest_sides,
    norm,
    place_in_plan,
    places_in_space,
    vectors,
)
from crms_fenicsx.cables.path import (
    CellPoint,
    EdgePoint,
    Path,
    SurfacePoint,
    VertexPoint,
    without_backtracking,
)
from crms_fenicsx.errors import PathError

Bools = NDArray[np.bool_]

# A fraction that rounding has put on a vertex, where the signs say that it is not, goes here.
LEAST, MOST = float(np.finfo(float).tiny), float(1.0 - np.finfo(float).epsneg)

# Nodes of a section: (vertex,), (smaller, larger) for an edge, and the two ends of a leg where
# they are neither.
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
    surface = Surface.checked(vertices, points, cells)
    course = _checked_route(route, snap)
    if course.shape[1] == 2:
        places = [place_in_plan(surface, xy, i, snap) for i, xy in enumerate(vectors(course))]
    else:
        places = places_in_space(surface, course, snap)
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
    size = float(np.max(longest_sides(x[rows]), initial=0.0))
    if comm is not None:
        size = comm.allreduce(size, op=MPI.MAX)
    mask = np.zeros(len(rows), dtype=np.bool_)
    up = np.array([0.0, 0.0, 1.0])
    if course.shape[1] == 2:
        ends = np.column_stack([course, np.zeros(len(course))])
        for a, b in pairwise(vectors(ends)):  # trace may move ends to the rim, and the plane along
            mask |= _strip(_Plane.of(a, b, up, up), x, rows, (RIM + snap) * size)
        flat = flattened(x[rows])
        centre, radius = balls(flat)
        for target in vectors(ends):  # what trace names when the route leaves the membrane
            least = float(np.min(norm(flat - target), initial=np.inf))
            if comm is not None:
                least = comm.allreduce(least, op=MPI.MIN)
            mask |= norm(centre - target) - radius <= least * (1.0 + 1e-9)
        return mask
    feet = [foot_of(x, rows, target, comm) for target in vectors(course)]
    for target, foot in zip(vectors(course), feet, strict=True):
        centre, radius = balls(x[rows])
        nearest = norm(centre - target) - radius
        # all around the vertices of the nearest cell, which make the normal
        mask |= nearest <= (foot.distance + foot.size) * (1.0 + 1e-9) + 2.0 * snap * size
    for i in range(len(course) - 1):
        # whether an end is an anchor depends on the boundary, which one rank may not see
        starts = [feet[i].position] + ([course[i]] if i == 0 else [])
        stops = [feet[i + 1].position] + ([course[i + 1]] if i == len(course) - 2 else [])
        for a in starts:
            for b in stops:
                if norm(b - a) == 0.0:
                    continue
                with suppress(PathError):  # if this is the leg, trace says so
                    plane = _Plane.of(a, b, feet[i].normal, feet[i + 1].normal)
                    mask |= _strip(plane, x, rows, snap * size)
    return mask


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
    for i, point in enumerate(vectors(course)):
        if not np.isfinite(point).all():
            raise PathError(f"route point {i} is {as_text(point)}; give finite coordinates")
        if i and np.array_equal(point, course[i - 1]):
            raise PathError(f"route points {i - 1} and {i} are both {as_text(point)}; drop one")
    return course


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
        length = float(norm(b - a))
        along: Floats = np.asarray((b - a) / length, dtype=np.float64)
        across: Floats = cross(normal_a + normal_b, along)
        size = float(norm(across))
        if size < 1e-6:
            raise PathError(
                f"the leg from {as_text(a)} to {as_text(b)} has no section plane, as the surface's "
                "normals there are opposite or point along it; put a route point between them"
            )
        return cls(a, along, np.asarray(across / size, dtype=np.float64), length)

    def offsets(self, points: Floats) -> Floats:
        """Return the distances (n,) of (n, 3) points from the plane, with sign."""
        return dot(points - self.origin, self.across)

    def advances(self, points: Floats) -> Floats:
        """Return how far (n,) along the leg (n, 3) points are."""
        return dot(points - self.origin, self.along)

    def altitudes(self, triangles: Floats) -> Floats:
        """Return the smallest altitudes (m,) of the projections of (m, 3, 3) triangles.

        A wall has none: it counts with its true one, if it is not parallel to the plane.
        """
        flat = np.zeros_like(triangles)
        flat[..., 0], flat[..., 1] = self.advances(triangles), self.offsets(triangles)
        wall = norm(double_areas(flat)) <= WALL * norm(double_areas(triangles))
        spread = flat[..., 1].max(axis=1) - flat[..., 1].min(axis=1)
        upright = np.minimum(altitudes(triangles), spread)
        return np.where(wall, upright, altitudes(flat))


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
        length = float(norm(self.positions[a] - self.positions[b]))
        self.arcs[a][b] = self.arcs[b][a] = length


def _leg_points(
    surface: Surface, first: Place, last: Place, name: str, snap: float
) -> list[SurfacePoint]:
    """Return the points of the surface on one leg, its ends (if no anchors) among them."""
    if np.array_equal(first.position, last.position):
        raise PathError(
            f"{name} has no length: both its ends lie at {as_text(first.position)} of the membrane;"
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
                f"{name} from {as_text(first.position)} to {as_text(last.position)} never meets "
                "the membrane's boundary; move its anchor"
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
    surface: Surface,
    plane: _Plane,
    ends: tuple[Place, Place],
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
    ids = lists(surface.ids[strip])
    count = edge_count(ids)
    rim_vertices = {v for edge, n in count.items() if n == 1 for v in edge}
    on_cell: dict[Node, list[Node]] = {}
    for corners, signs in zip(ids, lists(sign[strip]), strict=True):
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
                f"{as_text(section.positions[nodes[0]])}, a wall or a cell without area; "
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
    place: Place,
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
        f"{name} leaves the membrane at {as_text(section.positions[node])} ({section.points[node]})"
        " before its end; lead the route around, through points on the membrane"
    )
