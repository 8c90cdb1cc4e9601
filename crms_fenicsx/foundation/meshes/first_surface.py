"""The surface of a mesh before its vertices moved, known as a whole on each process: places on it
for vertices that have moved within it."""

from __future__ import annotations

from functools import cached_property

import numba
import numpy as np
from dolfinx import fem

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE, SmoothSurface
from crms_fenicsx.foundation.meshes.triangles import closest, dot, double_areas, lists, mix, norm
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans, Integers, ints


class FirstSurface:
    """Vertices by their number in the mesh as given, and cells in its order, on all ranks.

    Attributes: `ids` (l,): numbers of the local vertices; `smooth`: the surface through the
    vertices; `cells` (m, 3); `edges` (e, 2), and their `lengths`; `rim` (n,): vertices at edges
    that do not have two cells; `rims` (k, 2): these edges; `size` (n,): mean length of the edges
    around each vertex; `flat`: whether all cells lie in one plane; `least` (n,): lengths by which
    nothing has moved.
    """

    def __init__(self, V: fem.FunctionSpace, ids: Integers, places: Array) -> None:
        """Gather places (n, 3) of the local vertices, with numbers `ids` (n,). Collective."""
        self.ids = ids
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
        cells, inside = self.cells_at(self._home[vertices], places)
        corners = self.cells[cells]
        offsets, normals = self.smooth.raised(corners, inside)
        unknown = norm(normals) == 0.0
        normals = np.where(unknown[:, None], self.facets[cells], normals)
        return mix(inside, self.smooth.points[corners]) + offsets, normals

    def cells_at(self, start: Integers, places: Array) -> tuple[Integers, Array]:
        """The cells (k,) at places (k, 3), looked for from some (k,), and weights (k, 3) of their
        corners: see `onto`."""
        weights, cells, smooth = np.empty((len(places), 3)), start.copy(), self.smooth
        walk(
            np.ascontiguousarray(places), smooth.points, smooth.normals, self.cells, self.facets,
            self._beside, cells, weights,
        )  # fmt: skip
        inside = np.clip(weights, 0.0, 1.0)
        inside /= inside.sum(axis=1)[:, None]
        for k in np.flatnonzero(weights.min(axis=1, initial=1.0) < -1e-9):
            inside[k] = closest(smooth.points[self.cells[cells[k]]][None], places[k])[0][0]
        return cells, inside

    def rim_lines(
        self, wanted: Integers, stays: Booleans, stops: Booleans
    ) -> tuple[Integers, list[Integers]]:
        """Those of some vertices that can slide along the rim, and the lines of vertices on which
        they do, between vertices that stay.

        Corners and branches of the rim stay, and those among `stays` (n,); of vertices that do not
        slide also those among `stops` (n,). On a rim without any, the vertex furthest from those
        that slide does."""
        beside: dict[int, list[int]] = {}
        for a, b in lists(self.rims):
            beside.setdefault(a, []).append(b)
            beside.setdefault(b, []).append(a)
        sliding = [v for v in ints(wanted) if not (stays[v] or self._turns_at(v, beside))]
        lines: dict[tuple[int, ...], Integers] = {}
        for start in sliding:
            line = [start]
            for onward in beside[start]:
                line.reverse()
                line.append(onward)
                while line[-1] in sliding or not (
                    stops[line[-1]] or self._turns_at(line[-1], beside)
                ):
                    if line[-1] == start:
                        break
                    line.append(next(v for v in beside[line[-1]] if v != line[-2]))
                if line[-1] == start:
                    line = _opened(line[:-1], sliding)
                    break
            if line[0] > line[-1] or (line[0] == line[-1] and line[1] > line[-2]):
                line.reverse()
            lines[tuple(line)] = np.array(line)
        return np.array(sliding, dtype=np.int64), list(lines.values())

    def _turns_at(self, vertex: int, beside: dict[int, list[int]]) -> bool:
        """Whether the rim, if it is there at all, branches at a vertex or turns as a crease."""
        others = beside.get(vertex, [])
        if len(others) != 2:
            return True
        steps = np.diff(self.smooth.points[[others[0], vertex, others[1]]], axis=0)
        return bool(dot(steps[0], steps[1]) < CREASE * np.prod(norm(steps)))


@numba.njit(cache=True)
def walk(places, points, normals, corners, facets, beside, cells, weights):  # type: ignore[no-untyped-def]
    """Walk for each place (k, 3) from a cell (k,) to that in whose plane the interpolated normal
    through the place meets it, and write this cell and the weights (k, 3) of its corners. Where
    the rim is in the way, the walk ends with a negative weight."""
    to, foot, at, last = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(places)):
        for _ in range(len(corners)):
            c = cells[k]
            one, two, three = points[corners[c, 0]], points[corners[c, 1]], points[corners[c, 2]]
            f = facets[c]
            double, height = 0.0, 0.0
            for i in range(3):
                p, q = (i + 1) % 3, (i + 2) % 3
                double += f[i] * (
                    (two[p] - one[p]) * (three[q] - one[q])
                    - (two[q] - one[q]) * (three[p] - one[p])
                )
                height += f[i] * (places[k, i] - one[i])
            low, at[:] = 0, 1.0 / 3.0
            for _ in range(30):
                along, size, total = 0.0, 0.0, 0.0
                for i in range(3):
                    total += min(max(at[i], 0.0), 1.0)
                for i in range(3):
                    to[i] = 0.0
                    for j in range(3):
                        to[i] += min(max(at[j], 0.0), 1.0) / total * normals[corners[c, j], i]
                    along += to[i] * f[i]
                    size += to[i] ** 2
                if along <= 0.5 * np.sqrt(size):  # no normals, or far from the cell's
                    to[:] = f
                    along = 1.0
                for i in range(3):
                    foot[i] = places[k, i] - height / along * to[i]
                last[:] = at
                change = 0.0
                for j in range(3):
                    a, b = points[corners[c, (j + 1) % 3]], points[corners[c, (j + 2) % 3]]
                    at[j] = 0.0
                    for i in range(3):
                        p, q = (i + 1) % 3, (i + 2) % 3
                        at[j] += f[i] * (
                            (b[p] - a[p]) * (foot[q] - a[q]) - (b[q] - a[q]) * (foot[p] - a[p])
                        )
                    at[j] /= double
                    change = max(change, abs(at[j] - last[j]))
                low = int(np.argmin(at))
                if change < 1e-13 or at[low] < -0.5:  # known well enough
                    break
            onward = beside[c, (low + 1) % 3]
            if at[low] >= -1e-9 or onward < 0:
                break
            cells[k] = onward
        weights[k] = at


def _opened(loop: list[int], sliding: list[int]) -> list[int]:
    """A loop of vertices as a line that begins and ends at one far from those that slide."""
    n, found = len(loop), [k for k, v in enumerate(loop) if v in sliding]
    ways = [min(min((k - f) % n, (f - k) % n) for f in found) for k in range(n)]
    first = max(range(n), key=lambda k: (ways[k], -loop[k]))
    return [*loop[first:], *loop[: first + 1]]
