"""Vertices of a cut mesh spread: along rows and straight rims, and between them on the given
surface; and raised to the surface that this approximates."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import LEAST, CutMesh, Row, Stars, around
from crms_fenicsx.foundation.meshes.cutting.feature_edges import ASIDE
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE
from crms_fenicsx.foundation.meshes.surface import Projection
from crms_fenicsx.foundation.meshes.triangles import closest, dot, double_areas, norm, shapes
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers


class Spreading:
    """Places for the vertices near rows."""

    def __init__(self, mesh: CutMesh) -> None:
        from scipy.sparse import csr_array  # takes longer to import than scripts without lines need

        self.mesh = mesh
        self.near = mesh.band(2)
        self.cells = mesh.cells[around(mesh.cells, self.near)]
        self.shapes = shapes(mesh.points[self.cells])
        n, (a, b, c) = len(self.near), self.cells.T
        sides = np.concatenate([a, b, c, b, c, a]), np.concatenate([b, c, a, a, b, c])
        counts = np.bincount(sides[0], minlength=n)
        self.means = csr_array((1.0 / counts[sides[0]], sides), (n, n))  # of neighbours
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
        given = mesh.surface
        self.owner, cells = Stars(given.cells, len(given.points)).of(mesh.home[self.free])
        self.star = given.points[given.cells[cells]]

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
        f = self.free
        new[f] = 0.5 * (x[f] + (self.means @ x)[f])
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
        self._keep_cells(new)
        for (row, may), at in zip(self.rows, arcs, strict=True):
            moved = may & (new[row.vertices] != x[row.vertices]).any(axis=1)
            row.at[moved] = at[moved]
        mesh.points = new

    def _on_surface(self, places: Array) -> Array:
        """The closest points of the given cells around each free vertex (k, 3)."""
        _, found, gaps = closest(self.star, places[self.owner])
        least = np.minimum.reduceat(gaps, np.flatnonzero(np.diff(self.owner, prepend=-1)))
        best = np.flatnonzero(gaps == least[self.owner])
        return found[best[np.diff(self.owner[best], prepend=-1) > 0]]

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

    def _keep_cells(self, new: Array) -> None:
        """Take back moves after which a cell's smallest angle is too small and smaller."""
        x, (normals, before) = self.mesh.points, self.shapes
        least = np.sin(np.radians(LEAST[1]))
        for _ in range(20):
            self.shapes = turned, after = shapes(new[self.cells])
            bad = (dot(turned, normals) <= 0.5) | ((after < before) & (after < least))
            if not bad.any():
                return
            back = np.unique(self.cells[bad])
            new[back] = x[back]
        new[:], self.shapes = x, (normals, before)


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
