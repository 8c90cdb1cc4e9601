"""The section of a surface with a plane, as a graph of the points that it meets.

Which edges and vertices it meets is decided once, by the sign of every vertex's distance to the
plane, with a small neighbourhood of the plane counted as zero; after that no coordinate can
contradict it.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.runtime.errors import PathError, as_text
from crms_fenicsx.surface.closest_point import Node, Place, Surface, edge_count
from crms_fenicsx.surface.points import (
    LEAST,
    MOST,
    CellPoint,
    EdgePoint,
    SurfacePoint,
    VertexPoint,
)
from crms_fenicsx.surface.triangles import WALL, altitudes, cross, dot, double_areas, lists, norm

# Nodes of a section: (vertex,), (smaller, larger) for an edge, and the two ends of a leg where
# they are neither.
START: Node = (-1,)
END: Node = (-2,)


# The rims of an opening face each other when both look along the line between them, within this
# cosine: domes narrow towards the ground less than that, up to three quarters of a circle.
FACING = float(np.sqrt(0.5))


@dataclass(frozen=True)
class Plane:
    """The plane of a leg, through both ends and the mean normal of the surface there.

    `ahead` and `across`, unit vectors, lie across the mean normal, in the plane and athwart it;
    `length` is that of the leg seen along the normal.
    """

    origin: Array
    ahead: Array
    across: Array
    length: float

    @classmethod
    def of(cls, a: Array, b: Array, normal_a: Array, normal_b: Array) -> Plane:
        """Return the plane through two points and the mean of two directions."""
        up = normal_a + normal_b
        across = cross(up, (b - a) / norm(b - a))
        size = float(norm(across))
        if size < 1e-6:
            raise PathError(
                f"the leg from {as_text(a)} to {as_text(b)} has no section plane, as the surface's "
                "normals there are opposite or point along it; put a route point between them"
            )
        across = np.asarray(across / size, dtype=np.float64)
        ahead = np.asarray(cross(across, up) / norm(up), dtype=np.float64)
        return cls(a, ahead, across, float(dot(b - a, ahead)))

    def offsets(self, points: Array) -> Array:
        """Return the distances (n,) of (n, 3) points from the plane, with sign."""
        return dot(points - self.origin, self.across)

    def advances(self, points: Array) -> Array:
        """Return how far (n,) along the leg (n, 3) points are, seen along its mean normal."""
        return dot(points - self.origin, self.ahead)

    def altitudes(self, triangles: Array) -> Array:
        """Return the smallest altitudes (m,) of the projections of (m, 3, 3) triangles.

        A wall has none: it counts with its true one, if it is not parallel to the plane.
        """
        flat = np.zeros_like(triangles)
        flat[..., 0], flat[..., 1] = self.advances(triangles), self.offsets(triangles)
        wall = norm(double_areas(flat)) <= WALL * norm(double_areas(triangles))
        spread = flat[..., 1].max(axis=1) - flat[..., 1].min(axis=1)
        upright = np.minimum(altitudes(triangles), spread)
        return np.where(wall, upright, altitudes(flat))


def in_strip(plane: Plane, points: Array, cells: Integers, reach: float) -> Booleans:
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
    """The section of a surface with a plane, as a graph of the points it meets.

    Parameters
    ----------
    points, positions
        Each node's point of the surface and its position (length).
    arcs
        Each node's neighbours, with the lengths to them.
    rim
        The nodes on the surface's boundary.
    cells
        The nodes of each cell (its vertices' ids, in any order) that the section meets.
    edges
        How many of these cells have each edge (smaller, larger).
    """

    points: dict[Node, SurfacePoint]
    positions: dict[Node, Array]
    arcs: dict[Node, dict[Node, float]]
    rim: set[Node]
    cells: dict[Node, list[Node]]
    edges: Counter[Node]

    def join(self, a: Node, b: Node) -> None:
        """Put in the arc between two nodes."""
        length = float(norm(self.positions[a] - self.positions[b]))
        self.arcs[a][b] = self.arcs[b][a] = length

    def put(self, point: SurfacePoint, position: Array, own: Node) -> Node:
        """Return the node of a point, which is `own`, put in, where there is none yet."""
        known = not isinstance(point, CellPoint) and point.support in self.points
        node = point.support if known else own
        self.points[node], self.positions[node] = point, position
        if known:
            for other in list(self.arcs[node]):
                self.join(node, other)
            return node
        self.arcs[node] = {}
        for corners, nodes in self.cells.items():
            if set(point.support) <= set(corners):
                for other in nodes:
                    self.join(node, other)
        if self.edges.get(point.support) == 1:
            self.rim.add(node)
        return node

    def nearest(
        self, target: Array, surface: Surface, snap: float
    ) -> tuple[SurfacePoint, Array] | None:
        """Return the section's place nearest to a point of its plane; None if it is empty.

        It is a node where it is as near to one as `snap` says.
        """
        chords = sorted(
            (nodes[0], nodes[1], corners)
            for corners, nodes in self.cells.items()
            if len(nodes) == 2
        )
        if not chords:
            return None
        start = np.array([self.positions[a] for a, _, _ in chords])
        side = np.array([self.positions[b] for _, b, _ in chords]) - start
        t = np.clip(dot(target - start, side) / np.maximum(dot(side, side), 1e-300), 0.0, 1.0)
        places = start + t[:, None] * side
        i = int(np.argmin(norm(places - target)))
        a, b, corners = chords[i]
        reach = snap * float(altitudes(surface.points[[[surface.row_of[v] for v in corners]]])[0])
        closer = min((a, b), key=lambda node: float(norm(self.positions[node] - places[i])))
        if norm(self.positions[closer] - places[i]) <= reach:
            return self.points[closer], self.positions[closer]
        weights = dict.fromkeys(corners, 0.0)
        for node, part in ((a, 1.0 - float(t[i])), (b, float(t[i]))):
            point = self.points[node]
            f = point.fraction if isinstance(point, EdgePoint) else 0.0
            for vertex, weight in zip(node, (1.0 - f, f), strict=False):
                weights[vertex] += part * weight
        (u, v, w), (x, y, z) = corners, weights.values()
        return CellPoint((u, v, w), (x, y, z)), places[i]

    def gaps(self) -> dict[tuple[Node, Node], float]:
        """Return the openings in the section, with their widths along the arc over them.

        An opening is where the section ends at the boundary and would go on at another end of it
        that faces it. The outside of a dome or of a hall is none: what lies below the ground turns
        away from the membrane there.
        """
        ends: list[Node] = []
        looks: list[Array] = []
        for node in sorted(self.rim):
            if len(self.arcs[node]) == 1:
                (inner,) = self.arcs[node]
                outward = self.positions[node] - self.positions[inner]
                ends.append(node)
                looks.append(np.asarray(outward / max(float(norm(outward)), 1e-300)))
        found: dict[tuple[Node, Node], float] = {}
        for (a, out), (b, back) in combinations(zip(ends, looks, strict=True), 2):
            between = self.positions[b] - self.positions[a]
            width = float(norm(between))
            if min(float(dot(between, out)), -float(dot(between, back))) >= FACING * width:
                half = 0.5 * float(np.arccos(np.clip(-dot(out, back), -1.0, 1.0)))
                found[a, b] = width / float(np.sinc(half / np.pi))
        return found


def section_with(
    surface: Surface, plane: Plane, ends: tuple[Place, Place], name: str, snap: float
) -> Section:
    """Return the section with the plane of a leg; of its ends, those on vertices lie in it."""
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

    strip = strip[np.abs(sign[strip].sum(axis=1)) < 3]
    rows = {int(surface.ids[row]): int(row) for row in np.unique(strip)}
    ids = lists(surface.ids[strip])
    count = edge_count(ids)
    rim_vertices = {v for edge, n in count.items() if n == 1 for v in edge}
    section = Section({}, {}, {}, set(), {}, count)
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
                t = min(max(t, LEAST), MOST)  # rounding must not undo what the signs say
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
        section.cells[tuple(corners)] = nodes
    return section


def shortest(
    arcs: dict[Node, dict[Node, float]], start: Node
) -> tuple[dict[Node, float], dict[Node, Node]]:
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
        for other, step in arcs[node].items():
            if other not in reached:
                heapq.heappush(queue, (length + step, other, node))
    return reached, before


def way_back(before: dict[Node, Node], end: Node) -> list[Node]:
    """Return the nodes from the start of the shortest ways to `end`."""
    nodes = [end]
    while before[nodes[-1]] != nodes[-1]:
        nodes.append(before[nodes[-1]])
    return nodes[::-1]
