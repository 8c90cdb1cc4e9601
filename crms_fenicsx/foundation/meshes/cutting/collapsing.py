"""Short edges of a cut mesh collapsed: vertices near a row go, and rows keep fewer vertices."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import CutMesh, Stars, around
from crms_fenicsx.foundation.meshes.cutting.feature_edges import ASIDE, SHORT
from crms_fenicsx.foundation.meshes.edge_table import edge_keys
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE
from crms_fenicsx.foundation.meshes.triangles import dot, norm, shapes
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints
from crms_fenicsx.foundation.surface.closest_point import SNAP


def collapse(mesh: CutMesh) -> None:
    """Collapse the short edges near rows, of those close to each other the shortest first."""
    near = mesh.band(1)
    lines, active, count = _LineEnds(mesh), near, len(near)
    gone = np.zeros(count, dtype=bool)
    while active.any():
        edges = _ShortEdges(mesh, lines, near, active)
        v, r = edges.allowed()
        first = edges.first_of_neighbours(v, r)
        active = np.zeros(count, dtype=bool)
        active[v[~first]] = active[r[~first]] = True
        v, r = v[first], r[first]
        mesh.features.skip(ints(v))
        lines.skip(v)
        gone[v] = True
        stays = np.arange(count)
        stays[v] = r
        mesh.cells = stays[mesh.cells]
        a, b, c = mesh.cells.T
        kept = (a != b) & (b != c) & (c != a)
        mesh.cells, mesh.parents = mesh.cells[kept], mesh.parents[kept]
        changed = np.zeros(count, dtype=bool)
        changed[r] = True
        active[mesh.cells[around(mesh.cells, changed)]] = True
    for row in mesh.rows.values():
        stay = ~gone[row.vertices]
        row.vertices, row.at, row.pinned = row.vertices[stay], row.at[stay], row.pinned[stay]


class _LineEnds:
    """Where feature lines lead from their vertices, as arrays over all vertices (n,)."""

    def __init__(self, mesh: CutMesh) -> None:
        features, n = mesh.features, len(mesh.points)
        on = [v for v, others in features.beside.items() if others]
        self.on = np.zeros(n, dtype=bool)
        self.on[[*features.fixed, *on]] = True
        self.ends = np.full((n, 2), -1)  # vertices beside, where the line leads on
        self.in_row = np.zeros(n, dtype=bool)
        for v in on:
            ends = features.neighbours(v)
            if ends is not None:
                self.ends[v] = ends
                self.in_row[v] = not mesh.rows.keys().isdisjoint(features.beside[v][ends[0]])

    def skip(self, v: Integers) -> None:
        """Take vertices (k,), none of them neighbours, out of their lines."""
        v = v[self.ends[v, 0] >= 0]
        a, b = self.ends[v].T
        for end, other in ((a, b), (b, a)):
            own = self.ends[end]
            self.ends[end] = np.where(own == v[:, None], other[:, None], own)


class _ShortEdges:
    """Short edges between near vertices, one of each active, the shortest first."""

    def __init__(self, mesh: CutMesh, lines: _LineEnds, near: Booleans, active: Booleans) -> None:
        self.x, self.size, self.features = mesh.points, mesh.size, mesh.features
        self.lines = lines
        sides = _sides(mesh.cells[around(mesh.cells, active)])
        p, q = sides.T
        sides = sides[near[p] & near[q] & (active[p] | active[q])]
        keys = np.unique(edge_keys(sides[self.ratio(*sides.T) < SHORT]))
        p, q = keys >> 32, keys & 0xFFFFFFFF
        order = np.argsort(self.ratio(p, q).round(6), kind="stable")
        self.p, self.q = p[order], q[order]
        ends = np.zeros(len(near), dtype=bool)
        ends[p] = ends[q] = True
        self.cells = mesh.cells[around(mesh.cells, ends)]
        self.normals, self.sines = shapes(self.x[self.cells])
        self.stars = Stars(self.cells, len(near))
        self.keys = np.sort(edge_keys(_sides(self.cells)))

    def ratio(self, p: Integers, q: Integers) -> Array:
        """Lengths of edges relative to the cells."""
        return np.asarray(norm(self.x[q] - self.x[p]) / (0.5 * (self.size[p] + self.size[q])))

    def allowed(self) -> tuple[Integers, Integers]:
        """The vertices (k,) that can go, and those into which they are collapsed."""
        on = self.lines.on
        q_first = on[self.p] | ~on[self.q]  # one off the feature lines rather than one on them
        v, r = np.where(q_first, (self.q, self.p), (self.p, self.q))
        fits = self._may_go(v, r)
        v, r = np.where(fits, (v, r), (r, v))
        fits[~fits] = self._may_go(v[~fits], r[~fits])
        return v[fits], r[fits]

    def first_of_neighbours(self, v: Integers, r: Integers) -> Booleans:
        """Which of edges (k,) come before all that share a cell around their vertices."""
        edge, cell = (
            np.concatenate(two) for two in zip(self.stars.of(v), self.stars.of(r), strict=True)
        )
        least = np.full(len(self.cells), len(v))
        np.minimum.at(least, cell, edge)
        first = np.ones(len(v), dtype=bool)
        first[edge[least[cell] < edge]] = False
        return first

    def _may_go(self, v: Integers, r: Integers) -> Booleans:
        """Whether vertices (k,) can be collapsed into others."""
        a, b = self.lines.ends[v].T
        fits, lined = ~self.lines.on[v], np.flatnonzero((a == r) | (b == r))
        own, a, b = v[lined], a[lined], b[lined]
        beside = zip(ints(a), ints(b), strict=True)
        joined = np.array([q in self.features.beside[p] for p, q in beside], dtype=bool)
        fits[lined] = (self._bends(own, a, b) <= ASIDE * self.size[own]) & ~joined
        tested = np.flatnonzero(fits)
        fits[tested] = self._keeps_shapes(v[tested], r[tested])
        tested = np.flatnonzero(fits)
        fits[tested] = self._stays_a_surface(v[tested], r[tested])
        return fits

    def _joined(self, p: Integers, q: Integers) -> Booleans:
        """Whether there are edges between vertices."""
        keys = edge_keys(np.stack([p, q], axis=1))
        return np.asarray(self.keys[np.searchsorted(self.keys[:-1], keys)] == keys)

    def _keeps_shapes(self, v: Integers, r: Integers) -> Booleans:
        """Whether no cell turns or becomes too slim where vertices are collapsed into others."""
        edge, cell = self.stars.of(v)
        # the shorter the edge, the more urgent
        least = np.full(len(v), np.inf)
        np.minimum.at(least, edge, self.sines[cell])
        least *= self.ratio(v, r) / SHORT
        corners, v, r = self.cells[cell], v[edge, None], r[edge, None]
        moves = ~(corners == r).any(axis=1)
        edge, cell = edge[moves], cell[moves]
        normals, sines = shapes(self.x[np.where(corners == v, r, corners)[moves]])
        fits = np.ones(len(least), dtype=bool)
        fits[edge[(sines < least[edge]) | (dot(normals, self.normals[cell]) <= 0.5)]] = False
        return fits

    def _stays_a_surface(self, v: Integers, r: Integers) -> Booleans:
        """Whether vertices beside both ends of an edge are those of cells at it."""
        edge, cell = self.stars.of(v)
        corners = self.cells[cell]
        other = (corners != v[edge, None]) & (corners != r[edge, None])
        cells = np.bincount(edge[np.count_nonzero(other, axis=1) == 1], minlength=len(v))
        edge, w = edge.repeat(3)[other.ravel()], corners[other]
        both = self._joined(r[edge], w)
        found = np.unique((edge[both] << 32) | w[both]) >> 32
        return np.asarray(np.bincount(found, minlength=len(v)) == cells)

    def _bends(self, v: Integers, a: Integers, b: Integers) -> Array:
        """Distances of vertices from the chords between their neighbours along feature lines,
        sideways in rows; infinite at corners."""
        x, p, q = self.x[v], self.x[a], self.x[b]
        one, other, side = x - p, q - x, q - p
        squares = dot(one, one), dot(other, other)
        # not at a node of another line beside it
        corner = np.minimum(*squares) > (4.0 * SNAP * self.size[v]) ** 2
        corner &= dot(one, other) < CREASE * np.sqrt(squares[0] * squares[1])
        away = one - (dot(one, side) / dot(side, side))[:, None] * side
        normals = np.zeros((len(v), 3))
        where, cell = self.stars.of(v)
        np.add.at(normals, where, self.normals[cell])
        across = np.where(self.lines.in_row[v], dot(away, normals) / norm(normals), 0.0)
        return np.where(corner, np.inf, np.sqrt(np.maximum(dot(away, away) - across**2, 0.0)))


def _sides(cells: Integers) -> Integers:
    """Sides (3 m, 2) of cells."""
    a, b, c = cells.T
    return np.concatenate([np.stack(two, axis=1) for two in ((a, b), (b, c), (c, a))])
