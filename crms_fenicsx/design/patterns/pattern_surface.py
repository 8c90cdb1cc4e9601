"""The surface to be cut, whole on every rank, so that all ranks lay the same seams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush

import numba
import numpy as np

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edges_of, whole_line
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, gathered
from crms_fenicsx.foundation.meshes.surface import CheckedSurface
from crms_fenicsx.foundation.meshes.triangles import closest, lists
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, pointers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import TargetSurface
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    Edge,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
    edge_of,
)
from crms_fenicsx.foundation.surface.vertex_flip import Ring, ring_of
from crms_fenicsx.model.tolerances import LEAST_WEIGHT

ON_VERTEX = 1e-3
"""Fraction of an edge within which a line passes through its vertex."""


@dataclass(frozen=True)
class PatternSurface(CheckedSurface):
    """A surface with its groups, for geodesics, sections and distances."""

    @classmethod
    def of(cls, mesh: MembraneMesh) -> PatternSurface:
        """The whole surface of a mesh. Collective."""
        return cls(**vars(mesh.comm.bcast(gathered(mesh)[0])))

    @cached_property
    def table(self) -> EdgeTable:
        """Its edges."""
        return EdgeTable.of(self.cells)

    @cached_property
    def target(self) -> TargetSurface:
        """The surface for tracing routes."""
        return TargetSurface.of(np.arange(len(self.points)), self.points, self.cells)

    def length(self, edge: Edge) -> float:
        """Length of an edge, as `IntrinsicSurface`."""
        return float(np.linalg.norm(self.points[edge[1]] - self.points[edge[0]]))

    def opposite_vertices(self, edge: Edge) -> tuple[int, ...]:
        """Vertices opposite to an edge, as `IntrinsicSurface`."""
        rows = sorted(self.target.cells_with(edge))
        return tuple(v for cell in lists(self.cells[rows]) for v in cell if v not in edge)

    def ring(self, vertex: int) -> Ring:
        """The neighbours around a vertex in order, as `IntrinsicSurface`."""
        return ring_of(vertex, lists(self.cells[sorted(self.target.around[vertex])]))

    def places(self, points: tuple[SurfacePoint, ...]) -> Array:
        """Coordinates (k, 3) of surface points."""
        rows = [np.array(p.weights) @ self.points[list(p.support)] for p in points]
        return np.array(rows).reshape(-1, 3)

    def on_rim(self, point: SurfacePoint) -> bool:
        """Whether a point lies on the boundary or on a branching edge (three or more cells)."""
        branches = isinstance(point, EdgePoint) and len(self.target.cells_with(point.edge)) > 2
        return branches or self.target.on_boundary(point)

    def line_of_group(self, call: str, group: str) -> tuple[SurfacePoint, ...]:
        """The vertices of an edge group from end to end, or around to the first again."""
        edges = edges_of(checks.named("group of edges", self.edges, group))
        return tuple(map(VertexPoint, whole_line(call, group, edges, closed=True)))

    def distances(self, line: tuple[SurfacePoint, ...]) -> Array:
        """Geodesic distances (n,) of the vertices from a line (length).

        Exact in the cells along the line, continued by fast marching (R. Kimmel and J. A. Sethian,
        Computing geodesic paths on manifolds, 1998), which is exact for straight fronts.
        """
        places, n = self.places(line), len(self.points)
        known = np.full(n, np.inf)
        for p, q, x, y in zip(line[:-1], line[1:], places[:-1], places[1:], strict=True):
            corners = self.cells[list(self.target.cells_with(p.support, q.support))].ravel()
            flat = np.broadcast_to(np.stack([x, y, y]), (len(corners), 3, 3))
            np.minimum.at(known, corners, closest(flat, self.points[corners])[2])
        order = np.argsort(self.cells.ravel(), kind="stable")
        starts = pointers(np.bincount(self.cells.ravel(), minlength=n))
        _march(self.points, self.cells, starts, order // 3, known)
        return known

    def crossings(self, values: Array) -> list[tuple[SurfacePoint, ...]]:
        """The zero lines of vertex values (n,), linear in between, in cells where all are finite.

        From end to end; a closed line ends at its first point.
        """
        arcs: dict[SurfacePoint, list[SurfacePoint]] = {}
        known = np.isfinite(values)
        pairs = self.table.vertices[known[self.table.vertices].all(axis=1)]
        change = np.abs(values[pairs[:, 0]] - values[pairs[:, 1]])
        reach = np.zeros(len(values))
        np.maximum.at(reach, pairs, np.repeat(change[:, None], 2, axis=1))
        near = ~known | (np.abs(values) <= ON_VERTEX * reach)
        sign = np.where(near, 0, np.sign(values)).astype(int)
        met = (np.abs(sign[self.cells].sum(axis=1)) < 3) & known[self.cells].all(axis=1)
        for cell in lists(self.cells[met & (np.count_nonzero(sign[self.cells], axis=1) > 0)]):
            nodes: list[SurfacePoint] = [VertexPoint(v) for v in cell if sign[v] == 0]
            for a, b in ((cell[0], cell[1]), (cell[1], cell[2]), (cell[2], cell[0])):
                if sign[a] * sign[b] < 0:
                    i, j = edge_of(a, b)
                    nodes.append(EdgePoint((i, j), values[i] / (values[i] - values[j])))
            if len(nodes) == 2:
                for p, q in (nodes, nodes[::-1]):
                    if q not in arcs.setdefault(p, []):
                        arcs[p].append(q)
        return _chains(arcs)


def _chains(arcs: dict[SurfacePoint, list[SurfacePoint]]) -> list[tuple[SurfacePoint, ...]]:
    """The lines of a graph of points, in the order of their first points."""
    found: list[tuple[SurfacePoint, ...]] = []
    ends = [p for p, others in arcs.items() if len(others) != 2]
    seen: set[frozenset[SurfacePoint]] = set()
    for start in (*ends, *arcs):
        for first in arcs[start]:
            if frozenset((start, first)) in seen:
                continue
            line = [start, first]
            seen.add(frozenset(line))
            while len(arcs[line[-1]]) == 2 and line[-1] != start:
                (onward,) = (p for p in arcs[line[-1]] if p != line[-2])
                seen.add(frozenset((line[-1], onward)))
                line.append(onward)
            found.append(tuple(line))
    return found


@numba.njit(cache=True)
def _march(x, cells, starts, cells_at, d):  # type: ignore[no-untyped-def]
    """March distances d (n,), finite where known; `cells_at[starts[v] : starts[v + 1]]` are v's
    cells."""
    n = len(d)
    done = np.zeros(n, dtype=np.bool_)
    heap = [(0.0, 0)]
    heap.pop()
    for v in range(n):
        if d[v] < np.inf:
            heap.append((d[v], v))
    heap.sort()
    while len(heap) > 0:
        least, v = heappop(heap)
        if done[v] or least > d[v]:
            continue
        done[v] = True
        for q in range(starts[v], starts[v + 1]):
            c = cells_at[q]
            for k in range(3):
                w = cells[c, k]
                if done[w]:
                    continue
                a, b = cells[c, (k + 1) % 3], cells[c, (k + 2) % 3]
                best = min(
                    d[a] + np.linalg.norm(x[a] - x[w]), d[b] + np.linalg.norm(x[b] - x[w])
                )  # fmt: skip
                if d[a] < np.inf and d[b] < np.inf:
                    best = min(best, _front(x[a] - x[w], x[b] - x[w], d[a], d[b]))
                if best < d[w] * (1.0 - 1e-15):
                    d[w] = best
                    heappush(heap, (best, w))


@numba.njit(cache=True)
def _front(p, q, da, db):  # type: ignore[no-untyped-def]
    """Distance of a straight front at a cell's corner, or inf if it does not cross the cell; p
    and q are the sides to the corners at distances da and db."""
    pp, pq, qq = np.dot(p, p), np.dot(p, q), np.dot(q, q)
    det = pp * qq - pq * pq
    s = (pp - 2 * pq + qq) / det
    r = (da * (qq - pq) + db * (pp - pq)) / det
    t = (da * da * qq - 2 * da * db * pq + db * db * pp) / det - 1.0
    root = r * r - s * t
    if root < 0.0:
        return np.inf
    d = (r + np.sqrt(root)) / s
    u, v = da - d, db - d
    inside = qq * u - pq * v <= 0.0 and pp * v - pq * u <= 0.0
    return d if inside else np.inf


Way = Array | Callable[[Array], Array]
"""A direction (3,), or a function that returns that at a point (3,)."""


def straight_line(surface: PatternSurface, point: SurfacePoint, way: Way) -> list[SurfacePoint]:
    """The line through a point from rim to rim, straight on or along directions."""
    back, ahead = (_walk(surface, point, way, sense) for sense in (-1.0, 1.0))
    return [*back[::-1], *([] if isinstance(point, CellPoint) else [point]), *ahead]


def _walk(
    surface: PatternSurface, start: SurfacePoint, way: Way, sense: float
) -> list[SurfacePoint]:
    """Edge crossings from a point to the rim along a direction, or against it if `sense` is -1;
    none if it leaves the surface. A function sets the direction in each cell."""
    x, at = surface.points, surface.places((start,))[0]
    direction = sense * (way(at) if callable(way) else way)
    for row in sorted(surface.target.cells_with(start.support)):
        cell: Support = tuple(surface.cells[row].tolist())
        normal, along = _normal(surface, cell), _within(surface, cell, direction)
        # on the inner side of the cell's sides at the point
        sides = [(cell[k], cell[(k + 1) % 3]) for k in range(3)]
        met = [(a, b) for a, b in sides if {*start.support} <= {a, b}]
        if all(np.cross(normal, x[b] - x[a]) @ along >= 0.0 for a, b in met):
            break
    else:
        return []
    points: list[SurfacePoint] = []
    entered: Support = start.support if len(start.support) < 3 else ()
    for _ in range(4 * len(surface.cells)):
        edge, fraction = _exit(surface, cell, at, along, entered)
        points.append(EdgePoint(edge, fraction))
        at = surface.places((points[-1],))[0]
        if surface.on_rim(points[-1]):
            return points
        beyond = [v for v in surface.opposite_vertices(edge) if v not in cell]
        ahead = (*edge, beyond[0])
        if callable(way):
            along = _within(surface, ahead, sense * way(x[list(ahead)].mean(axis=0)))
        else:
            along = _unfolded(surface, cell, edge, beyond[0], along)
        cell, entered = ahead, edge
    raise PathError(
        f"the line straight on from {as_text(surface.places((start,))[0])} does not reach a rim; "
        "use another direction."
    )


def _normal(surface: PatternSurface, cell: Support) -> Array:
    """Unit normal of a cell."""
    a, b, c = surface.points[list(cell)]
    normal = np.cross(b - a, c - a)
    return np.asarray(normal / np.linalg.norm(normal))


def _within(surface: PatternSurface, cell: Support, direction: Array) -> Array:
    """Unit projection of a direction into a cell's plane."""
    normal = _normal(surface, cell)
    along = direction - (direction @ normal) * normal
    size = np.linalg.norm(along)
    if size <= 1e-6 * np.linalg.norm(direction):
        raise PathError(
            f"the direction {as_text(direction)} of a seam is normal to the surface near "
            f"{as_text(surface.points[list(cell)].mean(axis=0))}."
        )
    return np.asarray(along / size)


def _exit(
    surface: PatternSurface, cell: Support, at: Array, along: Array, entered: Support
) -> tuple[Edge, float]:
    """The edge, and fraction along it, at which a straight line leaves a cell."""
    normal, found = _normal(surface, cell), list[tuple[float, Edge, float]]()
    for k in range(3):
        a, b = edge_of(cell[k], cell[(k + 1) % 3])
        if entered and {*entered} <= {a, b}:
            continue  # the side or vertex at which the line entered
        side = surface.points[b] - surface.points[a]
        across = np.cross(normal, side)
        speed = along @ across
        if speed != 0.0:
            s = (surface.points[a] - at) @ across / speed
            t = (at + s * along - surface.points[a]) @ side / (side @ side)
            found.append((max(-t, t - 1.0, 0.0) + (s < 0.0), (a, b), t))
    _, edge, t = min(found, key=lambda one: one[0])
    return edge, float(np.clip(t, LEAST_WEIGHT, 1.0 - LEAST_WEIGHT))


def _unfolded(
    surface: PatternSurface, cell: Support, edge: Edge, beyond: int, along: Array
) -> Array:
    """A direction in a cell, rotated about an edge into the next cell's plane."""
    a, b = surface.points[list(edge)]
    axis = (b - a) / np.linalg.norm(b - a)
    (behind,) = set(cell) - set(edge)
    out, on = a - surface.points[behind], surface.points[beyond] - a
    out, on = out - (out @ axis) * axis, on - (on @ axis) * axis
    ahead = along @ out / np.linalg.norm(out)
    return np.asarray((along @ axis) * axis + ahead * on / np.linalg.norm(on))
