"""The section of a surface with a plane, as a graph of the points that it meets.

Which edges and vertices it meets is decided once, by the sign of every vertex's distance to the
plane, with a small neighbourhood of the plane counted as zero; after that no coordinate can
contradict it.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cables.locate import Node, Place, Surface, as_text, edge_count
from crms_fenicsx.cables.path import CellPoint, EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.cables.triangles import (
    WALL,
    Bools,
    Floats,
    Ints,
    altitudes,
    cross,
    dot,
    double_areas,
    lists,
    norm,
)
from crms_fenicsx.errors import PathError

# A fraction that rounding has put on a vertex, where the signs say that it is not, goes here.
LEAST, MOST = float(np.finfo(float).tiny), float(1.0 - np.finfo(float).epsneg)

# Nodes of a section: (vertex,), (smaller, larger) for an edge, and the two ends of a leg where
# they are neither.
START: Node = (-1,)
END: Node = (-2,)


@dataclass(frozen=True)
class Plane:
    """The plane of a leg: an origin and unit vectors along the leg and across the plane."""

    origin: Floats
    along: Floats
    across: Floats
    length: float

    @classmethod
    def of(cls, a: Floats, b: Floats, normal_a: Floats, normal_b: Floats) -> Plane:
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


def in_strip(plane: Plane, points: Floats, cells: Ints, reach: float) -> Bools:
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
class Section:
    """The section of a surface with a plane, as a graph of the points it meets."""

    points: dict[Node, SurfacePoint]
    positions: dict[Node, Floats]
    arcs: dict[Node, dict[Node, float]]
    rim: set[Node]

    def join(self, a: Node, b: Node) -> None:
        length = float(norm(self.positions[a] - self.positions[b]))
        self.arcs[a][b] = self.arcs[b][a] = length


def section_with(
    surface: Surface,
    plane: Plane,
    ends: tuple[Place, Place],
    name: str,
    snap: float,
) -> tuple[Section, tuple[Node | None, Node | None]]:
    """Return the section as a graph, and its nodes at the leg's two ends."""
    strip = surface.cells[in_strip(plane, surface.points, surface.cells, snap * surface.size)]
    offset = plane.offsets(surface.points)
    tolerance = np.full(len(surface.ids), np.inf)
    np.minimum.at(
        tolerance, strip, snap * plane.altitudes(surface.points[strip])[:, None].repeat(3, axis=1)
    )
    sign = np.where(np.abs(offset) <= tolerance, 0, np.sign(offset)).astype(np.int64)
    for place in ends:
        if isinstance(place.point, VertexPoint):
            sign[surface.ids == place.point.vertex] = 0

    section = Section({}, {}, {}, set())
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
    section: Section,
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


def shortest(section: Section, start: Node) -> tuple[dict[Node, float], dict[Node, Node]]:
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
