"""The surface of a mesh before its vertices moved, known as a whole on each process: places on it
for vertices that have moved within it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from dolfinx import fem

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE, SmoothSurface
from crms_fenicsx.foundation.meshes.triangles import (
    closest,
    cross,
    dot,
    double_areas,
    lists,
    mix,
    norm,
)
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans, Integers, ints


class FirstSurface:
    """Vertices by their number in the mesh as given, and cells in its order, on all ranks.

    Attributes: `smooth`: the surface through the vertices; `cells` (m, 3); `edges`
    (e, 2), and their `lengths`; `rim` (n,): vertices at
    edges that do not have two cells; `rims` (k, 2): these edges; `size` (n,): mean length of the
    edges around each vertex; `flat`: whether all cells lie in one plane; `least` (n,): lengths by
    which nothing has moved.
    """

    def __init__(self, V: fem.FunctionSpace, ids: Integers, places: Array) -> None:
        """Gather places (n, 3) of the local vertices, with numbers `ids` (n,). Collective."""
        mesh, own = V.mesh, V.dofmap.index_map.size_local
        count = mesh.topology.index_map(2).size_local
        numbers = np.asarray(mesh.topology.original_cell_index[:count], dtype=np.int64)
        corners = cell_vertex_ids(mesh)[:count]
        points = np.zeros((V.dofmap.index_map.size_global, 3))
        self.cells = np.zeros((mesh.topology.index_map(2).size_global, 3), dtype=np.int64)
        for part in mesh.comm.allgather((ids[:own], places[:own], numbers, corners)):
            points[part[0]], self.cells[part[2]] = part[1], part[3]
        self.smooth = SmoothSurface.of(points, self.cells)
        table = EdgeTable.of(self.cells)
        self.rims = table.vertices[table.counts != 2]
        self.rim = np.zeros(len(points), dtype=bool)
        self.rim[self.rims] = True
        self.edges = table.vertices
        self.lengths = norm(points[self.edges[:, 1]] - points[self.edges[:, 0]])
        total, degree = (
            np.bincount(self.edges.ravel(), weights, len(points))
            for weights in (np.repeat(self.lengths, 2), None)
        )
        self.size = total / np.maximum(degree, 1)
        self.least = 1e-12 * self.size + 8 * EPSILON * np.abs(points).max(initial=0.0)
        one, two = table.linked_sides(table.counts == 2)
        beside = np.full(3 * len(self.cells), -1)
        beside[one], beside[two] = two // 3, one // 3
        self._beside = beside.reshape(-1, 3)  # side k of a cell leaves its corner k
        self._home = np.zeros(len(points), dtype=np.int64)  # a cell of each vertex
        self._home[self.cells] = np.arange(len(self.cells))[:, None]

    @cached_property
    def facets(self) -> Array:
        """Unit normals (m, 3) of the cells."""
        normals = double_areas(self.smooth.points[self.cells])
        return normals / norm(normals)[:, None]

    @cached_property
    def flat(self) -> bool:
        return bool(norm(self.facets - self.facets[:1]).max(initial=0.0) < 1e-9)

    def onto(self, vertices: Integers, places: Array) -> tuple[Array, Array]:
        """Places (k, 3) on the smooth surface for vertices (k,) at places nearby, and its unit
        normals there.

        A place moves along the smooth normal, interpolated in the cell where the normal meets it,
        so that one on the surface stays where it is, and that nearby places stay nearby. The cell
        is looked for from the vertex's first one, across the edges on the way: the result depends
        on nothing else. A place beyond the rim comes onto the rim.
        """
        if self.flat:
            return places, np.broadcast_to(self.facets[:1], places.shape)
        cells = self._home[vertices]
        weights, left = np.zeros((len(cells), 3)), np.arange(len(cells))
        for _ in range(100 + int(np.sqrt(len(self.cells)))):  # until all have arrived
            at = self._weights(cells[left], places[left])
            weights[left] = at
            low = np.argmin(at, axis=1)
            onward = self._beside[cells[left], (low + 1) % 3]
            goes = (at[np.arange(len(left)), low] < -1e-9) & (onward >= 0)
            cells[left[goes]] = onward[goes]
            left = left[goes]
            if not len(left):
                break
        inside = np.clip(weights, 0.0, 1.0)
        inside /= inside.sum(axis=1)[:, None]
        beyond = np.flatnonzero(weights.min(axis=1, initial=1.0) < -1e-9)
        for k in beyond:
            corners = self.smooth.points[self.cells[cells[k]]]
            inside[k] = closest(corners[None], places[k])[0][0]
        corners = self.cells[cells]
        offsets, normals = self.smooth.raised(corners, inside)
        unknown = norm(normals) == 0.0
        normals = np.where(unknown[:, None], self.facets[cells], normals)
        return mix(inside, self.smooth.points[corners]) + offsets, normals

    def _weights(self, cells: Integers, places: Array) -> Array:
        """Weights (k, 3) of the corners of cells (k,) where the normals through places meet their
        planes."""
        corners, facets = self.smooth.points[self.cells[cells]], self.facets[cells]
        normals = self.smooth.normals[self.cells[cells]]
        sides = corners[:, [1, 2, 0]] - corners
        double = dot(facets, cross(sides[:, 0], sides[:, 1]))
        height = dot(places - corners[:, 0], facets)
        weights: Array = np.full((len(cells), 3), 1 / 3)
        for _ in range(30):
            inside = np.clip(weights, 0.0, 1.0)
            mean = mix(inside / inside.sum(axis=1)[:, None], normals)
            along = dot(mean, facets)
            steep = along < 0.5 * norm(mean)
            mean = np.where((steep | (along <= 0.0))[:, None], facets, mean)
            foot = places - (height / dot(mean, facets))[:, None] * mean
            ways = foot[:, None] - corners
            last = weights
            weights = dot(facets[:, None], cross(sides, ways))[:, [1, 2, 0]] / double[:, None]
            if np.abs(weights - last).max(initial=0.0) < 1e-13:
                break
        return weights

    def rim_lines(self, sliding: Integers, stops: Booleans) -> list[Integers]:
        """Lines of vertices along the rim on which sliding vertices lie, between vertices that
        stay: those among `stops` (n,), corners and branches; on a smooth rim without any, the
        vertex furthest from those that slide."""
        beside: dict[int, list[int]] = {}
        for a, b in lists(self.rims):
            beside.setdefault(a, []).append(b)
            beside.setdefault(b, []).append(a)
        lines: dict[tuple[int, ...], Integers] = {}
        for start in ints(sliding):
            line = [start]
            for onward in beside[start][:2]:
                line.reverse()
                line.append(onward)
                while not (line[-1] in (line[0], start) or self._ends_at(line[-1], stops, beside)):
                    line.append(next(v for v in beside[line[-1]] if v != line[-2]))
                if line[-1] == start:
                    line = _opened(line[:-1], set(ints(sliding)))
                    break
            if line[0] > line[-1] or (line[0] == line[-1] and line[1] > line[-2]):
                line.reverse()
            lines[tuple(line)] = np.array(line)
        return list(lines.values())

    def _ends_at(self, vertex: int, stops: Booleans, beside: dict[int, list[int]]) -> bool:
        """Whether a vertex stays, or the rim branches or turns there as a crease does."""
        others = beside[vertex]
        if stops[vertex] or len(others) != 2:
            return True
        steps = np.diff(self.smooth.points[[others[0], vertex, others[1]]], axis=0)
        return bool(dot(steps[0], steps[1]) < CREASE * np.prod(norm(steps)))


def _opened(loop: list[int], sliding: set[int]) -> list[int]:
    """A loop of vertices as a line that begins and ends at one far from those that slide."""
    n, found = len(loop), [k for k, v in enumerate(loop) if v in sliding]
    ways = [min(min((k - f) % n, (f - k) % n) for f in found) for k in range(n)]
    first = max(range(n), key=lambda k: (ways[k], -loop[k]))
    return [*loop[first:], *loop[: first + 1]]
