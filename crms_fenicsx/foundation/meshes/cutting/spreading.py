"""Vertices of a cut mesh spread: along rows and straight rims, and between them on the given
surface; and raised to the surface that this approximates."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import LEAST, CutMesh, Row
from crms_fenicsx.foundation.meshes.cutting.feature_edges import ASIDE
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE
from crms_fenicsx.foundation.meshes.surface import Projection
from crms_fenicsx.foundation.meshes.triangles import closest, dot, double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, pointers, runs


class Spreading:
    """Places for the vertices near rows."""

    def __init__(self, mesh: CutMesh) -> None:
        self.mesh = mesh
        self.near = mesh.band(2)
        features = mesh.features
        free = self.near.copy()
        free[list(features.fixed)] = False
        free[[v for v, others in features.beside.items() if others]] = False
        used = np.zeros(len(free), dtype=bool)
        used[mesh.cells] = True
        self.free = np.flatnonzero(free & used)
        on_row = np.zeros(len(free), dtype=bool)
        for row in mesh.rows.values():
            on_row[row.vertices] = True
        self.slides = self._sliding(on_row)
        self.rows = [(row, self._may_slide(row)) for row in mesh.rows.values()]
        given = mesh.surface.cells
        order = np.argsort(given.ravel(), kind="stable")
        counts = np.bincount(given.ravel(), minlength=len(mesh.surface.points))[self.free]
        first = pointers(np.bincount(given.ravel(), minlength=len(mesh.surface.points)))[self.free]
        self.owner = np.repeat(np.arange(len(self.free)), counts)
        self.star = given[order[runs(first, counts)] // 3]

    def _sliding(self, on_row: Booleans) -> Integers:
        """Vertices near rows on other feature lines, with their neighbours along these, (k, 3)."""
        found = []
        for v in self.mesh.features.beside:
            if self.near[v] and not on_row[v]:
                ends = self.mesh.features.neighbours(v)
                if ends is not None:
                    found.append((v, *ends))
        return np.array(sorted(found), dtype=np.int64).reshape(-1, 3)

    def _may_slide(self, row: Row) -> Booleans:
        """Whether each vertex of a row may slide along it."""
        ends = [self.mesh.features.neighbours(int(v)) for v in row.vertices]
        return np.array([pair is not None for pair in ends]) & ~row.pinned

    def step(self, *, last: bool) -> None:
        """Move each vertex half the way to the middle of its neighbours; in the `last` step of some
        those between rows onto the given surface."""
        mesh = self.mesh
        x, new = mesh.points, mesh.points.copy()
        rows = np.flatnonzero(self.near[mesh.cells].any(axis=1))
        cells = mesh.cells[rows]
        n = len(x)
        total, count = np.zeros((n, 3)), np.zeros(n)
        for a, b in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
            count += np.bincount(cells[:, a], minlength=n)
            for k in range(3):
                total[:, k] += np.bincount(cells[:, a], x[cells[:, b], k], minlength=n)
        f = self.free
        new[f] = 0.5 * (x[f] + total[f] / count[f, None])
        if last:
            new[f] = self._on_surface(new[f])
        self._slide(new)
        arcs = []
        for row, may in self.rows:
            at = row.at.copy()
            inner = np.flatnonzero(may)
            at[inner] = 0.5 * at[inner] + 0.25 * (at[inner - 1] + at[inner + 1])
            new[row.vertices[inner]] = row.on(at[inner])
            arcs.append(at)
        self._keep_cells(cells, new)
        for (row, may), at in zip(self.rows, arcs, strict=True):
            moved = may & (new[row.vertices] != x[row.vertices]).any(axis=1)
            row.at[moved] = at[moved]
        mesh.points = new

    def _on_surface(self, places: Array) -> Array:
        """The closest points of the given cells around each free vertex (k, 3)."""
        _, found, gaps = closest(self.mesh.surface.points[self.star], places[self.owner])
        order = np.lexsort((gaps, self.owner))
        best = order[np.unique(self.owner[order], return_index=True)[1]]
        return found[best]

    def _slide(self, new: Array) -> None:
        """Move vertices of other feature lines along these, where they are nearly straight."""
        if not len(self.slides):
            return
        v, a, b = self.slides.T
        x = self.mesh.points
        back, ahead = norm(x[v] - x[a]), norm(x[b] - x[v])
        way = 0.25 * (ahead - back)
        forward = way > 0.0
        side = np.where(forward[:, None], x[b] - x[v], x[a] - x[v])
        place = x[v] + (np.abs(way) / np.where(forward, ahead, back))[:, None] * side
        chord = np.where(forward[:, None], place - x[a], place - x[b])
        start = np.where(forward[:, None], x[a], x[b])
        t = dot(x[v] - start, chord) / dot(chord, chord)
        off = norm(x[v] - start - t[:, None] * chord)
        fits = (off <= ASIDE * self.mesh.size[v]) & (
            dot(x[v] - x[a], x[b] - x[v]) >= CREASE * back * ahead
        )
        new[v[fits]] = place[fits]

    def _keep_cells(self, cells: Integers, new: Array) -> None:
        """Take back moves after which a cell's smallest angle is too small and smaller."""
        x = self.mesh.points
        normals, before = shapes(x[cells])
        least = np.sin(np.radians(LEAST[1]))
        for _ in range(20):
            turned, after = shapes(new[cells])
            bad = (dot(turned, normals) <= 0.5) | ((after < before) & (after < least))
            if not bad.any():
                return
            back = np.unique(cells[bad])
            new[back] = x[back]
        new[:] = x


def shapes(corners: Array) -> tuple[Array, Array]:
    """Unit normals (m, 3) and sines (m,) of the smallest angles of triangles (m, 3, 3)."""
    normals = double_areas(corners)
    area = norm(normals)
    sides = np.sort(norm(corners[:, [1, 2, 0]] - corners), axis=1)
    sines = area / np.maximum(sides[:, 1] * sides[:, 2], 1e-300)
    return normals / np.maximum(area, 1e-300)[:, None], sines


def raise_vertices(mesh: CutMesh, onto: Projection) -> None:
    """Move all vertices but those where the given mesh has one from its facets and rims to the
    surface and rims that these approximate."""
    table, given, x = EdgeTable.of(mesh.cells), mesh.surface.points, mesh.points
    moved, on_rim = np.zeros((2, len(x)), dtype=bool)
    moved[mesh.cells] = True
    moved[: len(given)] &= (x[: len(given)] != given).any(axis=1)
    on_rim[table.vertices[table.counts == 1]] = True
    new = x.copy()
    new[moved] = onto(x[moved].T, on_rim[moved]).T
    turned = dot(double_areas(new[mesh.cells]), double_areas(x[mesh.cells])) <= 0.0
    new[mesh.cells[turned]] = x[mesh.cells[turned]]
    mesh.points = new
