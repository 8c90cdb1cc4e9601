"""Sections of a surface with planes: the cells they cut, and the points met as a graph.

The edges and vertices met are determined once, from the signs of the vertices' distances to the
plane, with distances below a tolerance counted as zero; coordinates cannot contradict this later.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, cast

import numpy as np

from crms_fenicsx.foundation.meshes.triangles import (
    WALL,
    altitudes,
    closest_on_segments,
    cross,
    dot,
    double_areas,
    norm,
)
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import Place, TargetSurface
from crms_fenicsx.foundation.surface.points import (
    LEAST,
    MOST,
    CellPoint,
    EdgePoint,
    SurfacePoint,
    VertexPoint,
    edge_of,
)

FIRST, SECOND = np.array([0, 1, 2]), np.array([1, 2, 0])
"""Corners at the ends of a cell's sides."""
PAIRS = 1_000_000
"""Number of plane-vertex distances held in memory at a time."""


@dataclass(frozen=True)
class Plane:
    """Section plane of a leg, through both ends and the mean surface normal there."""

    origin: Array
    ahead: Array  # unit vector in the plane, orthogonal to the mean normal
    across: Array  # unit normal of the plane
    length: float  # length of the leg in the projection along the mean normal

    @classmethod
    def of(cls, a: Array, b: Array, normal_a: Array, normal_b: Array) -> Plane:
        """The plane through two points and the mean of two directions."""
        (plane,) = cls.of_legs(a[None], b[None], normal_a[None], normal_b[None])
        if plane is None:
            raise PathError(
                f"the leg from {as_text(a)} to {as_text(b)} has no section plane, as the surface's "
                "normals there are opposite or point along it; put a route point between them."
            )
        return plane

    @classmethod
    def of_legs(cls, a: Array, b: Array, normals_a: Array, normals_b: Array) -> list[Plane | None]:
        """The planes of legs between points (n, 3), as `of`; None for legs that have none."""
        up, leg = normals_a + normals_b, b - a
        across = cross(up, leg / norm(leg)[:, None])
        size = norm(across)
        sound = size >= 1e-6
        across = across / np.where(sound, size, 1.0)[:, None]
        ahead = cross(across, up) / np.where(sound, norm(up), 1.0)[:, None]
        length = dot(leg, ahead)
        return [
            cls(a[i], ahead[i], across[i], float(length[i])) if sound[i] else None
            for i in range(len(a))
        ]

    @staticmethod
    def arrays(planes: Sequence[Plane]) -> tuple[Array, Array, Array, Array]:
        """Origins, directions ahead and across (n, 3), and lengths (n, 1) of n planes."""
        return (
            np.array([plane.origin for plane in planes]),
            np.array([plane.ahead for plane in planes]),
            np.array([plane.across for plane in planes]),
            np.array([plane.length for plane in planes])[:, None],
        )


@dataclass(frozen=True)
class Cut:
    """The cells that a plane cuts or touches, and its intersections with corners and sides."""

    ids: list[list[int]]  # (q, 3) ids of the corners
    # meets, places: (q, 6), (q, 6, 3) whether each corner lies in the plane and each side crosses
    # it, and the intersections
    meets: list[list[bool]]
    fractions: list[list[float]]  # (q, 3) intersections on sides, from the vertex of lower id
    places: Array
    lengths: list[float]  # (q,) distance of the first two intersections


def strips(
    planes: Sequence[Plane], points: Array, cells: Integers, reach: float, margin: float
) -> tuple[Integers, Integers]:
    """Pairs (p,), ascending, of planes and cells that they cross or pass within `reach`, by which
    ends may be moved, and at most about `margin` beyond both ends of the leg."""
    none: Integers = np.zeros(0, dtype=np.int64)
    legs, rows = [none], [none]
    if not len(points):
        return none, none
    middle = points.mean(axis=0)
    x = points - middle
    rounding = 1e-12 * float(np.abs(x).max() + np.abs(middle).max())
    step = max(1, PAIRS // len(points))
    for first in range(0, len(planes), step):
        origin, ahead, across, length = Plane.arrays(planes[first : first + step])
        offset = across @ x.T - dot(origin - middle, across)[:, None]
        advance = ahead @ x.T - dot(origin - middle, ahead)[:, None]
        near = np.abs(offset) <= _width(advance, length, reach) + rounding
        positive = offset > 0.0
        mask = _any(near, cells) | (_any(positive, cells) & _any(~positive, cells))
        if np.isfinite(margin):
            mask &= _any((-margin < advance) & (advance < length + margin), cells)
        leg, row = np.nonzero(mask)
        legs.append(leg + first)
        rows.append(row)
    return np.concatenate(legs), np.concatenate(rows)


def _width(advance: Array, length: Array, reach: float) -> Array:
    """Half-width of a leg's strip, growing beyond its ends, where moving these has more effect."""
    beyond = np.maximum(np.maximum(-advance, advance - length), 0.0) / length
    return np.asarray(2.0 * reach * (1.0 + 2.0 * beyond))


def _any(marks: Booleans, cells: Integers) -> Booleans:
    """Which cells have a marked corner, for each row of marks."""
    return np.asarray(marks[:, cells[:, 0]] | marks[:, cells[:, 1]] | marks[:, cells[:, 2]])


def cuts(
    surface: TargetSurface,
    planes: Sequence[Plane],
    ends: Sequence[tuple[Place, Place]],
    margin: float = np.inf,
) -> list[Cut]:
    """Cut the surface with the planes of legs, up to `margin` (length) beyond both ends; end
    vertices lie exactly in the plane."""
    if not planes:
        return []
    points, reach = surface.points, surface.snap * surface.size
    leg, cell = strips(planes, points, surface.cells, reach, margin)
    corners = points[surface.cells[cell]]
    origin, ahead, across, length = (values[leg] for values in Plane.arrays(planes))
    away = corners - origin[:, None]
    offset, advance = dot(away, across[:, None]), dot(away, ahead[:, None])
    near = np.abs(offset) <= _width(advance, length, reach) + 1e-14 * np.abs(points).max()
    positive = (offset > 0.0).sum(axis=1)
    within = ((-margin < advance) & (advance < length + margin)).any(axis=1)
    kept = within & (near.any(axis=1) | ((positive > 0) & (positive < 3)))
    leg, cell, corners, offset = leg[kept], cell[kept], corners[kept], offset[kept]
    rows = surface.cells[cell]
    tolerance = np.full((len(planes), len(points)), np.inf)
    least = surface.snap * _altitudes(advance[kept], offset, corners)
    np.minimum.at(tolerance, (leg[:, None], rows), least[:, None].repeat(3, axis=1))
    ids, fixed = surface.ids[rows], np.array([[_vertex(end) for end in both] for both in ends])
    touched = np.abs(offset) <= tolerance[leg[:, None], rows]
    touched |= (ids[..., None] == fixed[leg][:, None]).any(axis=2)
    sign = np.where(touched, 0, np.sign(offset)).astype(np.int64)
    met = np.abs(sign.sum(axis=1)) < 3
    return _split(leg[met], len(planes), ids[met], sign[met], offset[met], corners[met])


def _vertex(place: Place) -> int:
    """Id of the vertex on which a place lies; -1 if there is none."""
    return place.point.vertex if isinstance(place.point, VertexPoint) else -1


def _split(
    leg: Integers, count: int, ids: Integers, sign: Integers, offset: Array, corners: Array
) -> list[Cut]:
    """Intersect the planes with the sides of cells, and assign the cells to the legs."""
    turned = ids[:, FIRST] > ids[:, SECOND]
    i, j = np.where(turned, SECOND, FIRST), np.where(turned, FIRST, SECOND)
    every = np.arange(len(ids))[:, None]
    crossed = sign[:, FIRST] * sign[:, SECOND] < 0
    start, difference = offset[every, i], offset[every, i] - offset[every, j]
    t = np.clip(start / np.where(crossed, difference, 1.0), LEAST, MOST)
    crossings = (1.0 - t)[..., None] * corners[every, i] + t[..., None] * corners[every, j]
    places = np.concatenate([corners, crossings], axis=1)
    meets = np.concatenate([sign == 0, crossed], axis=1)
    slots = np.argsort(~meets, axis=1, kind="stable")[:, :2]
    lengths = norm(places[every[:, 0], slots[:, 0]] - places[every[:, 0], slots[:, 1]])
    keys, hits, fractions, arcs = (cast(Any, a.tolist()) for a in (ids, meets, t, lengths))
    ends = [int(end) for end in np.searchsorted(leg, np.arange(count + 1))]
    return [
        Cut(keys[a:b], hits[a:b], fractions[a:b], places[a:b], arcs[a:b]) for a, b in pairwise(ends)
    ]


def _altitudes(advance: Array, offset: Array, triangles: Array) -> Array:
    """Smallest altitudes (m,) of the projections of triangles (m, 3, 3); for a wall, whose
    projection is degenerate, the true one, if it is not parallel to the plane."""
    flat = np.zeros_like(triangles)
    flat[..., 0], flat[..., 1] = advance, offset
    wall = norm(double_areas(flat)) <= WALL * norm(double_areas(triangles))
    upright = np.minimum(altitudes(triangles), offset.max(axis=1) - offset.min(axis=1))
    return np.where(wall, upright, altitudes(flat))


Node = tuple[int, ...]
"""A vertex (id,), an edge (smaller, larger), or an end of a leg that is neither."""
START: Node = (-1,)
END: Node = (-2,)


# Cosine within which both rims of an opening must look along the line between them to face each
# other: domes narrow less towards the ground, up to three quarters of a circle.
FACING = float(np.sqrt(0.5))


@dataclass(frozen=True)
class Section:
    """Section of a surface with a plane, as a graph of the points met."""

    points: dict[Node, SurfacePoint]
    positions: dict[Node, Array]
    arcs: dict[Node, dict[Node, float]]
    cells: dict[Node, list[Node]]

    @property
    def rim(self) -> set[Node]:
        """Nodes on the surface's boundary: edges with one cell, and their vertices."""
        count: Counter[Node] = Counter(
            edge_of(a, b) for u, v, w in self.cells for a, b in ((u, v), (v, w), (w, u))
        )
        vertices = {v for edge, n in count.items() if n == 1 for v in edge}
        return {
            node
            for node, point in self.points.items()
            if count[point.support] == 1 or (len(node) == 1 and node[0] in vertices)
        }

    def join(self, a: Node, b: Node) -> None:
        """Add the arc between two nodes."""
        length = float(norm(self.positions[a] - self.positions[b]))
        self.arcs[a][b] = self.arcs[b][a] = length

    def put(self, point: SurfacePoint, position: Array, own: Node) -> Node:
        """Return the node of a point; a point without one is added as node `own`."""
        known = not isinstance(point, CellPoint) and point.support in self.points
        node = point.support if known else own
        self.points[node], self.positions[node] = point, position
        if known:
            for other in list(self.arcs[node]):
                self.join(node, other)
            return node
        self.arcs[node] = {}
        support = set(point.support)
        for corners, nodes in self.cells.items():
            if support.issubset(corners):
                for other in nodes:
                    self.join(node, other)
        return node

    def nearest(self, target: Array, surface: TargetSurface) -> tuple[SurfacePoint, Array] | None:
        """Closest point of the section to a point in its plane, preferably a node, or None."""
        chords = sorted(
            (nodes[0], nodes[1], corners)
            for corners, nodes in self.cells.items()
            if len(nodes) == 2
        )
        if not chords:
            return None
        start = np.array([self.positions[a] for a, _, _ in chords])
        side = np.array([self.positions[b] for _, b, _ in chords]) - start
        t, places, gaps = closest_on_segments(start, side, target)
        i = int(np.argmin(gaps))
        a, b, corners = chords[i]
        rows = [[surface.row_of[v] for v in corners]]
        reach = surface.snap * float(altitudes(surface.points[rows])[0])
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
        """Arc lengths over openings between section ends that face each other, unlike the outer
        sides of a dome at the ground."""
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


def section_of(cut: Cut, name: str) -> Section:
    """Section of a surface with a plane, from the cells that it cuts."""
    section = Section({}, {}, {}, {})
    points, arcs = section.points, section.arcs
    for row, ((u, v, w), meets) in enumerate(zip(cut.ids, cut.meets, strict=True)):
        keys: list[Node] = [(u,), (v,), (w,), edge_of(u, v), edge_of(v, w), edge_of(w, u)]
        nodes: list[Node] = []
        for k, node in enumerate(keys):
            if not meets[k]:
                continue
            nodes.append(node)
            if node not in points:
                arcs[node], section.positions[node] = {}, cut.places[row, k]
                if k < 3:
                    points[node] = VertexPoint(node[0])
                else:
                    points[node] = EdgePoint((node[0], node[1]), cut.fractions[row][k - 3])
        if len(nodes) == 3:
            raise PathError(
                f"{name} runs in the plane of cell {(u, v, w)} near "
                f"{as_text(section.positions[nodes[0]])}, a wall or a cell without area; "
                "turn the leg a little or put a route point beside it."
            )
        if len(nodes) == 2:
            a, b = nodes
            arcs[a][b] = arcs[b][a] = cut.lengths[row]
        section.cells[u, v, w] = nodes
    return section


def shortest(
    arcs: dict[Node, dict[Node, float]], start: Node
) -> tuple[dict[Node, float], dict[Node, Node]]:
    """Dijkstra distances from `start` to all connected nodes, and the predecessor of each."""
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
    """Nodes of the shortest path from the start to `end`."""
    nodes = [end]
    while before[nodes[-1]] != nodes[-1]:
        nodes.append(before[nodes[-1]])
    return nodes[::-1]
