"""A surface divided along lines, in work: cells, kept edges, and rows of vertices on the lines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.feature_edges import FeatureEdges
from crms_fenicsx.foundation.meshes.surface import CheckedSurface
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, runs

LEAST = 10.0, 15.0
"""Smallest angles (degrees), of all cells and of all but a hundredth, that are told if smaller; and
no vertex is moved so that one falls below the second."""


@dataclass
class Row:
    """The vertices along a line."""

    vertices: Integers  # (k,)
    places: Array  # (n, 3) of the line's points on the given surface
    turns: Array  # (n,) angles by which the line turns sideways there
    at: Array  # (k,) arc lengths of the vertices
    pinned: Booleans  # (k,) vertices at bends of the line

    def on(self, arcs: Array) -> Array:
        """Places at arc lengths (k,)."""
        known = arc_lengths(self.places)
        return np.stack([np.interp(arcs, known, x) for x in self.places.T], axis=1)


@dataclass
class CutMesh:
    """The divided surface."""

    surface: CheckedSurface  # as given
    points: Array  # (n, 3)
    cells: Integers  # (m, 3)
    parents: Integers  # (m,) a cell of the given surface, of the same parts, for each cell
    features: FeatureEdges
    rows: dict[str, Row]
    size: Array  # (n,) mean length of the edges around each vertex of the given surface
    home: Integers  # (n,) for vertices off feature lines one of the given surface, at it or nearby

    def band(self, rings: int) -> Booleans:
        """Vertices (n,) within that many edges of a row."""
        near = np.zeros(len(self.points), dtype=bool)
        for row in self.rows.values():
            near[row.vertices] = True
        for _ in range(rings):
            near[self.cells[around(self.cells, near)]] = True
        return near

    def finished(self) -> CheckedSurface:
        """The surface without the vertices that were left out, with all groups."""
        used = np.zeros(len(self.points), dtype=bool)
        used[self.cells] = True
        number = np.cumsum(used) - 1
        groups = self.features.groups()
        edges = {
            name: np.unique((number[keys >> 32] << 32) | number[keys & 0xFFFFFFFF])
            for name, keys in groups.items()
        }
        new = self.surface.divided(self.points[used], number[self.cells], self.parents, edges)
        points = {name: number[ids] for name, ids in self.surface.point_groups.items()}
        return replace(new, point_groups=points)


def around(cells: Integers, vertices: Booleans) -> Booleans:
    """Which of the cells (m, 3) have one or more of some vertices (n,)."""
    a, b, c = cells.T
    return np.asarray(vertices[a] | vertices[b] | vertices[c])


class Stars:
    """The cells around each vertex."""

    def __init__(self, cells: Integers, count: int) -> None:
        """Of cells (m, 3) with so many vertices."""
        from scipy.sparse import csr_array  # takes longer to import than scripts without lines need

        m = len(cells)
        corners = csr_array(
            (np.ones(3 * m, dtype=bool), cells.ravel(), np.arange(0, 3 * m + 1, 3)), (m, count)
        ).tocsc()
        self.first, self.cells = corners.indptr, corners.indices

    def of(self, vertices: Integers) -> tuple[Integers, Integers]:
        """Pairs (p,) of places in a list of vertices (k,) and the cells around these."""
        first = self.first[vertices]
        counts = self.first[vertices + 1] - first
        return np.repeat(np.arange(len(vertices)), counts), self.cells[runs(first, counts)]
