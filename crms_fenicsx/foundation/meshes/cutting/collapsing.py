"""Short edges of a cut mesh collapsed: vertices near a row go, and rows keep fewer vertices."""

from __future__ import annotations

from heapq import heapify, heappop, heappush
from math import fsum, inf, sqrt

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import CutMesh
from crms_fenicsx.foundation.meshes.cutting.division import Point, dot, minus, shape
from crms_fenicsx.foundation.meshes.cutting.feature_edges import ASIDE, SHORT
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE
from crms_fenicsx.foundation.meshes.triangles import lists, norm, vectors
from crms_fenicsx.foundation.runtime.arrays import floats, ints
from crms_fenicsx.foundation.surface.closest_point import SNAP


def collapse(mesh: CutMesh) -> None:
    """Collapse the short edges near rows, the shortest first."""
    _Collapses(mesh).run()


class _Collapses:
    """The cells near rows as Python objects."""

    def __init__(self, mesh: CutMesh) -> None:
        self.mesh, self.features = mesh, mesh.features
        self.near = mesh.band(1)
        rows = np.flatnonzero(self.near[mesh.cells].any(axis=1))
        self.cell = dict(zip(ints(rows), lists(mesh.cells[rows]), strict=True))
        self.around: dict[int, set[int]] = {}
        for c, corners in self.cell.items():
            for v in corners:
                self.around.setdefault(v, set()).add(c)
        own = np.unique(mesh.cells[rows])
        places = [(x, y, z) for x, y, z in map(floats, vectors(mesh.points[own]))]
        self.x: dict[int, Point] = dict(zip(ints(own), places, strict=True))
        self.size = dict(zip(ints(own), floats(mesh.size[own]), strict=True))
        self.gone: set[int] = set()
        self.shapes: dict[int, tuple[Point, float]] = {}  # of unchanged cells

    def run(self) -> None:
        table = EdgeTable.of(np.array(list(self.cell.values()), dtype=np.int64))
        pairs = table.vertices[self.near[table.vertices].all(axis=1)]
        length = norm(self.mesh.points[pairs[:, 1]] - self.mesh.points[pairs[:, 0]])
        ratio = length / self.mesh.size[pairs].mean(axis=1)
        heap = [
            (round(part, 6), p, q)
            for part, (p, q) in zip(floats(ratio), lists(pairs), strict=True)
            if part < SHORT
        ]
        heapify(heap)
        refused: dict[int, set[int]] = {}  # edges that a change beside them may free
        while heap:
            _, p, q = heappop(heap)
            if p in self.gone or q in self.gone:
                continue
            for v, r in self.orders(p, q):
                if self.may_go(v, r):
                    new = {(r, w) for w in self.beside(v) - self.beside(r) if w != r}
                    self.go(v, r)
                    new |= {(w, u) for w in (r, *self.beside(r)) for u in refused.pop(w, ())}
                    for a, b in {(min(edge), max(edge)) for edge in new}:
                        if {a, b}.isdisjoint(self.gone) and self.near[a] and self.near[b]:
                            if (part := self.ratio(a, b)) < SHORT:
                                heappush(heap, (round(part, 6), a, b))
                    break
            else:
                refused.setdefault(p, set()).add(q)
                refused.setdefault(q, set()).add(p)
        self.write()

    def write(self) -> None:
        """Put the remaining cells into the mesh."""
        mesh = self.mesh
        kept = np.ones(len(mesh.cells), dtype=bool)
        for c, corners in self.cell.items():
            kept[c] = bool(corners)
            if corners:
                mesh.cells[c] = corners
        mesh.cells, mesh.parents = mesh.cells[kept], mesh.parents[kept]
        gone = np.zeros(len(mesh.points), dtype=bool)
        gone[list(self.gone)] = True
        for row in mesh.rows.values():
            stays = ~gone[row.vertices]
            row.vertices, row.at = row.vertices[stays], row.at[stays]
            row.pinned = row.pinned[stays]

    def ratio(self, p: int, q: int) -> float:
        """Length of an edge relative to the cells."""
        (a, b, c), (d, e, f) = self.x[p], self.x[q]
        length = sqrt((a - d) ** 2 + (b - e) ** 2 + (c - f) ** 2)
        return length / (0.5 * (self.size[p] + self.size[q]))

    def beside(self, v: int) -> set[int]:
        """The vertices beside one."""
        return {w for c in self.around[v] for w in self.cell[c]} - {v}

    def orders(self, p: int, q: int) -> list[tuple[int, int]]:
        """The vertex that goes, and the one that stays, in order of preference."""
        free = [not self.features.beside.get(v) and v not in self.features.fixed for v in (p, q)]
        return [(p, q), (q, p)] if free[0] and not free[1] else [(q, p), (p, q)]

    def may_go(self, v: int, r: int) -> bool:
        """Whether a vertex can be collapsed into another one."""
        if v in self.features.fixed:
            return False
        if self.features.beside.get(v):
            ends = self.features.neighbours(v)
            if ends is None or r not in ends or ends[1] in self.features.beside[ends[0]]:
                return False
            if self.bend(v, *ends) > ASIDE * self.size[v]:
                return False
        own = self.around[v]
        at_edge = [c for c in own if r in self.cell[c]]
        if len(self.beside(v) & self.beside(r)) != len(at_edge):
            return False
        # the shorter the edge, the more urgent
        least = min(self.shape(c)[1] for c in own) * self.ratio(v, r) / SHORT
        for c in own:
            if c not in at_edge:
                normal, sine = shape(*(self.x[r if w == v else w] for w in self.cell[c]))
                if sine < least or dot(normal, self.shape(c)[0]) <= 0.5:
                    return False
        return True

    def shape(self, c: int) -> tuple[Point, float]:
        """Normal of a cell, and sine of its smallest angle."""
        if c not in self.shapes:
            p, q, r = self.cell[c]
            self.shapes[c] = shape(self.x[p], self.x[q], self.x[r])
        return self.shapes[c]

    def bend(self, v: int, a: int, b: int) -> float:
        """Distance of a vertex from the chord between its neighbours along a feature line, sideways
        if it is a row; infinite at corners."""
        x, p, q = self.x[v], self.x[a], self.x[b]
        one, other, side = minus(x, p), minus(q, x), minus(q, p)
        least = min(dot(one, one), dot(other, other))
        tiny = least <= (4.0 * SNAP * self.size[v]) ** 2  # to a node of another line beside it
        if not tiny and dot(one, other) < CREASE * sqrt(dot(one, one) * dot(other, other)):
            return inf
        part = dot(one, side) / dot(side, side)
        away = minus(one, (part * side[0], part * side[1], part * side[2]))
        across = 0.0
        if not self.mesh.rows.keys().isdisjoint(self.features.beside[v][a]):
            shapes = [self.shape(c) for c in self.around[v]]
            nx, ny, nz = (fsum(normal[k] for normal, _ in shapes) for k in range(3))
            across = dot(away, (nx, ny, nz)) / sqrt(dot((nx, ny, nz), (nx, ny, nz)))
        return sqrt(max(dot(away, away) - across**2, 0.0))

    def go(self, v: int, r: int) -> None:
        """Collapse a vertex into another one."""
        self.features.skip(v)
        for c in self.around.pop(v):
            corners = self.cell[c]
            if r in corners:
                for w in corners:
                    if w != v:
                        self.around[w].discard(c)
                self.cell[c] = []
            else:
                corners[corners.index(v)] = r
                self.shapes.pop(c, None)
                self.around[r].add(c)
        self.gone.add(v)
