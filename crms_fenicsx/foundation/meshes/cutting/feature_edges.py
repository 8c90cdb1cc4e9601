"""Edges whose places a mesh keeps: rims, seams, groups, borders of parts, creases and rows."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.division import CutNodes
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys, edges_of
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE
from crms_fenicsx.foundation.meshes.surface import BOUNDARY, CheckedSurface
from crms_fenicsx.foundation.meshes.triangles import dot, double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.surface.points import CellPoint, Edge, SurfacePoint, VertexPoint

SHORT = 0.5
"""Length, relative to the cells, below which an edge, or a line beside another, is short."""
ASIDE = 0.02
"""Distance, relative to the cells, by which a row or a rim may leave out a bend."""
KEPT = ""
"""Name of edges that are kept without being a group."""


def labels_of(surface: CheckedSurface) -> Integers:
    """A number (m,) of each cell, the same for cells of the same parts."""
    groups = [*surface.parts.values(), surface.hidden]
    inside = np.zeros((len(surface.cells), len(groups)), dtype=np.int64)
    for k, members in enumerate(groups):
        inside[members, k] = 1
    return np.asarray(np.unique(inside, axis=0, return_inverse=True)[1]).ravel()


class FeatureEdges:
    """Names of kept edges, by their vertices."""

    def __init__(self, surface: CheckedSurface) -> None:
        self.beside: dict[int, dict[int, frozenset[str]]] = {}
        self.fixed = {int(v) for ids in surface.point_groups.values() for v in ids}
        table, label = EdgeTable.of(surface.cells), labels_of(surface)
        self.label = label  # (m,) of the cells
        normals = double_areas(surface.points[surface.cells])
        normals /= norm(normals)[:, None]
        kept = [table.keys[table.counts != 2]]
        first, second = (side // 3 for side in table.linked_sides(table.counts == 2))
        apart = label[first] != label[second]
        apart |= dot(normals[first], normals[second]) < 2.0 * CREASE**2 - 1.0
        kept.append(table.keys[table.counts == 2][apart])
        for keys in kept:
            self.add(edges_of(keys), KEPT)
        for name, keys in surface.edges.items():
            if name != BOUNDARY:
                self.add(edges_of(keys), name)

    def add(self, edges: Iterable[Edge], name: str) -> None:
        """Keep edges under a name."""
        for a, b in edges:
            for v, w in ((a, b), (b, a)):
                own = self.beside.setdefault(v, {})
                own[w] = own.get(w, frozenset()) | {name}

    def divide(self, nodes: CutNodes) -> None:
        """Replace kept edges by their parts between the nodes on them."""
        for a, b in nodes.on:
            names = self.beside.get(a, {}).pop(b, None)
            if names is not None:
                del self.beside[b][a]
                for name in names:
                    self.add(pairwise([a, *nodes.along(a, b), b]), name)

    def groups(self) -> dict[str, Integers]:
        """The `edge_keys` of named edges."""
        pairs: dict[str, list[Edge]] = {}
        for v, others in self.beside.items():
            for w, names in others.items():
                if v < w:
                    for name in names - {KEPT}:
                        pairs.setdefault(name, []).append((v, w))
        return {name: np.unique(edge_keys(np.array(own))) for name, own in pairs.items()}

    def keys(self) -> Integers:
        """Sorted `edge_keys` of all kept edges."""
        pairs = [(v, w) for v, others in self.beside.items() for w in others if v < w]
        return np.sort(edge_keys(np.array(pairs, dtype=np.int64)))

    def on(self, point: SurfacePoint) -> bool:
        """Whether a point of the surface lies on a kept edge, or at a named or kept vertex."""
        if isinstance(point, CellPoint):
            return False
        if isinstance(point, VertexPoint):
            return bool(self.beside.get(point.vertex)) or point.vertex in self.fixed
        return point.edge[1] in self.beside.get(point.edge[0], {})

    def neighbours(self, v: int) -> tuple[int, int] | None:
        """The two vertices beside one along its feature line; None at ends and junctions."""
        own = self.beside.get(v, {})
        if len(own) != 2 or v in self.fixed:
            return None
        (a, one), (b, other) = own.items()
        return (a, b) if one == other else None

    def corners(self, points: Array) -> Integers:
        """Vertices, at points (n, 3), where feature lines end, join or bend, and named ones."""
        found = set(self.fixed)
        for v, others in self.beside.items():
            ends = self.neighbours(v)
            if ends is None and others:
                found.add(v)
            elif ends is not None:
                one, other = points[v] - points[ends[0]], points[ends[1]] - points[v]
                if one @ other < CREASE * np.linalg.norm(one) * np.linalg.norm(other):
                    found.add(v)
        return np.array(sorted(found), dtype=np.int64)

    def skip(self, vertices: Iterable[int]) -> None:
        """Take vertices out of their feature lines, which lead on from neighbour to neighbour."""
        for v in vertices:
            own = self.beside.pop(v, {})
            for w in own:
                del self.beside[w][v]
            if own:
                (a, names), (b, _) = own.items()
                for name in names:
                    self.add([(a, b)], name)
