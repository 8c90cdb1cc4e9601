"""Motion of a stress-free mesh that follows rows of its vertices.

Where rows have shifted within the surface, the other vertices follow, so that cells keep their
shape: first along the rows, then between them. The stress-free places depend on the rows' only and
not on the way there: they are found from the first mesh. The current place of a vertex whose
stress-free place moves by dX moves by F dX, with the mean deformation gradient F of its cells: the
vertex becomes another point of the same deformed material.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numba
import numpy as np
from dolfinx import fem, la

from crms_fenicsx.foundation.meshes.first_surface import FirstSurface
from crms_fenicsx.foundation.meshes.harmonic_extension import HarmonicExtension
from crms_fenicsx.foundation.meshes.orientation import connected_labels
from crms_fenicsx.foundation.meshes.row_pieces import RowPieces, mixed
from crms_fenicsx.foundation.meshes.triangles import (
    arc_lengths,
    closest_on_segments,
    cross,
    dot,
    double_areas,
    norm,
    shapes,
)
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints

Span = tuple[int, Integers, Array, Array]
"""A row, the numbers of its vertices under a span, in order, and the places (3,) of its ends."""
Worst = tuple[float, Array, list[int]]
"""A cell's value, its place (3,), and the rows within two cells of it, the nearest first."""

ROOM = 0.25
"""Share of its first area to which a cell may shrink as vertices move below spans."""


class MeshMotion:
    """Moves the vertices of a mesh with rows of vertices that the caller shifts.

    Vertices have their numbers in the mesh as given, the same on all ranks; arrays (n, 3) are by
    local degree of freedom, with ghosts. All methods are collective.

    Attributes: `sliding` (k,): the vertices that slide along the rim; `size` (n,): mean length of
    the first edges around each vertex.
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        surface: FirstSurface,
        rows: Sequence[Integers],
        fixed: Booleans,
        sliding: Integers,
    ) -> None:
        """Take the surface of the first mesh; the vertices along each row, where crossing rows
        share one; vertices `fixed` (n,) that never move, beside those of rims, seams and creases,
        which the surface knows; and the rows' ends that slide along the rim, if they do not lie at
        a corner of it."""
        self._V, self._surface = V, surface
        self._ids, self._first = surface.ids, surface.smooth.points[surface.ids]
        self._own = V.dofmap.index_map.size_local
        stays = np.zeros(len(surface.rim), dtype=bool)
        for some in V.mesh.comm.allgather(self._ids[: self._own][fixed[: self._own]]):
            stays[some] = True
        count = np.zeros(len(stays), dtype=np.int64)
        for row in rows:
            count[np.unique(row)] += 1
        stops = stays | surface.rim | (count > 1)
        self.sliding, self._rims = surface.rim_lines(sliding, stays, stays | (count > 0))
        self._slides = np.zeros(len(stays), dtype=bool)
        self._slides[self.sliding] = True
        lines = np.concatenate([np.zeros(0, dtype=np.int64), *rows, *self._rims])
        self._numbers = np.unique(lines)
        self._rows = [np.searchsorted(self._numbers, row) for row in rows]
        self._pieces = RowPieces(
            [
                np.searchsorted(self._numbers, piece)
                for row in rows
                for piece in _pieces(row, stops)
            ],
            surface.smooth.points[self._numbers],
            surface.least[self._numbers],
        )
        self._local = np.flatnonzero(np.isin(self._ids, self._numbers))
        self._place = np.searchsorted(self._numbers, self._ids[self._local])
        self._here = np.full(len(self._numbers), -1)  # local degrees of freedom of rows, or -1
        self._here[self._place] = self._local
        free = ~(stays | surface.rim)
        count = count[self._numbers]
        self._within, self._shared = free[self._numbers], count == 2
        self._movable = self._within & (count < 3)
        known = stays | (norm(surface.smooth.normals) == 0.0)
        known[self._numbers] = True
        label = connected_labels(len(known), *surface.edges.T)
        known |= np.bincount(label, known)[label] == 0.0  # closed parts without rows stay
        self._others = np.flatnonzero(~known[self._ids])
        stiffness = surface.lengths**-2.0  # small cells change less
        self._extension = HarmonicExtension(V, self._ids, surface.edges, stiffness, known)
        self.size, self._least = surface.size[self._ids], surface.least[self._ids]
        self._stars = la.vector(V.dofmap.index_map, 16, dtype=np.float64)

    def destroy(self) -> None:
        self._extension.destroy()

    def move(
        self, X: Array, x: Array, further: tuple[Integers, Array] | None = None
    ) -> tuple[Array, Array]:
        """Stress-free and current places (n, 3) after a motion, from those after a solve, which
        differ from the last motion's in rows only, or from the first mesh's. `further`: vertices
        (m,) and how far beyond they go (m, 3), except at the rim.

        The vertices of rows are spread again between ends and crossings in the proportions of the
        first mesh, those of the rim beside sliding ends as well. The others move as a harmonic
        extension from the first mesh tells, onto its smooth surface.
        """
        X, x = X.copy(), x.copy()
        at, now = self._gathered(X), self._gathered(x)
        for line in self._rims:
            self._slide(line, at, now)
        final, numbers, within = at.copy(), self._numbers, self._within
        if further is not None:
            beyond = np.zeros_like(final)
            beyond[np.searchsorted(numbers, further[0])] = further[1]
            final[within] += beyond[within]
        final[within] = self._on_surface(final[within], numbers[within])
        k, found, before, after, shares = self._pieces.spread(
            final, lambda k, p: self._surface.onto(numbers[k], p)[0]
        )
        final[k] = found
        for places in (at, now):
            places[k] = mixed(places, before, after, shares)
        X[self._local], x[self._local] = at[self._place], now[self._place]
        moved = np.zeros_like(self._surface.smooth.points)
        moved[numbers] = final - self._surface.smooth.points[numbers]
        new = self._first + self._extension.of(moved)
        others = self._others
        new[others] = self._on_surface(new[others], self._ids[others])
        new[self._local] = final[self._place]
        step = new - X
        moves = np.flatnonzero(norm(step) > self._least)
        gradients = self._mean_gradients(X, x)[0][moves]
        x[moves] += (gradients * step[moves, None]).sum(axis=2)
        X[moves] = new[moves]
        return X, x

    def under(self, X: Array, x: Array, spans: Sequence[Span]) -> tuple[Array, Array]:
        """Places (n, 3) of both kinds after vertices of rows below lifted spans have moved within
        the deformed surface until they lie under them: sideways, or along the other row that shares
        them. They move by at most half a cell; shared ones as far as cells keep half of their areas
        and `ROOM` of their first ones. The rest of the mesh does not follow yet."""
        gradients, normals, current = self._mean_gradients(X, x)
        at, ways, carried = self._gathered(X), np.zeros_like(X), np.zeros_like(X)
        tangents = [np.gradient(at[row], axis=0) for row in self._rows]
        both = np.zeros_like(at)
        for row, along in zip(self._rows, tangents, strict=True):
            both[row] += along
        for own, vertices, start, end in spans:
            chord = (end - start) / norm(end - start)
            row, along = self._rows[own], tangents[own]
            of = np.isin(self._numbers[row], vertices) & (self._here[row] >= 0)
            of &= self._movable[row]
            k, along, local = row[of], along[of], self._here[row[of]]
            shared = self._shared[k][:, None]
            across = _unit(np.where(shared, both[k] - along, cross(normals[local], along)))
            side = _unit(cross(current[local], np.broadcast_to(chord, across.shape)))
            taken = (gradients[local] * across[:, None]).sum(axis=2)
            off = dot(start - x[local] - carried[local], side)
            ratio = dot(taken, side)
            ok = np.abs(ratio) > 0.1 * norm(taken)
            way = np.where(ok, off / np.where(ok, ratio, 1.0), 0.0)
            most = 0.5 * self.size[local]
            way = np.clip(way, -most, most)[:, None]
            ways[local] += way * across
            carried[local] += way * taken
        parts = self._with_room(X, ways)[:, None]
        return X + parts * ways, x + parts * carried

    def _with_room(self, X: Array, ways: Array) -> Array:
        """The parts (n,) of the ways (n, 3) of vertices that rows share which leave cells half of
        their areas and `ROOM`; 1 for others."""
        parts, total = np.ones(len(X)), self._stars.array.reshape(-1, 16)
        moved = np.zeros(len(X), dtype=bool)
        moved[self._here[self._shared & (self._here >= 0)]] = True
        moved &= norm(ways) > 0.0
        cells = self._V.dofmap.list[: self._V.mesh.topology.index_map(2).size_local]
        cells = cells[moved[cells].any(axis=1)]
        now, first = double_areas(X[cells]), norm(double_areas(self._first[cells]))
        for _ in range(10):
            new = double_areas((X + parts[:, None] * ways)[cells])
            share = dot(new, now) / dot(now, now)
            tight = (share < 0.5) | (share < 1.0) & (norm(new) < ROOM * first)
            total[:] = 0.0
            total[cells[tight]] = 1.0
            self._stars.scatter_reverse(la.InsertMode.add)
            self._stars.scatter_forward()
            parts[moved & (total[:, 0] > 0.0)] *= 0.5
        return parts

    def quality(self, X: Array) -> tuple[Worst, Worst]:
        """The smallest ratio of a cell's area to its first one, and the smallest angle (degrees);
        both are negative where a cell is turned over."""
        surface, topology = self._surface, self._V.mesh.topology
        own = topology.index_map(2).size_local
        cells = self._V.dofmap.list[:own]
        corners, upward = X[cells], surface.facets[topology.original_cell_index[:own]].copy()
        areas, first = double_areas(corners), norm(double_areas(self._first[cells]))
        turned = np.flatnonzero(dot(areas, upward) < 0.5 * norm(areas))
        vertices = cells[turned].ravel()
        normals = surface.onto(self._ids[vertices], X[vertices])[1]
        upward[turned] = normals.reshape(-1, 3, 3).sum(axis=1)
        signs = np.sign(dot(areas, upward))
        angles = np.degrees(np.arcsin(shapes(corners)[1]))
        at, size = self._gathered(X), self._surface.size[self._numbers]
        worst: list[Worst] = []
        for values in (signs * norm(areas) / first, signs * angles):
            values[np.isnan(values)] = -np.inf
            k = int(np.argmin(values)) if own else -1
            mine = (float(values[k]), corners[k].mean(axis=0)) if own else (np.inf, np.zeros(3))
            every = self._V.mesh.comm.allgather(mine)
            value, place = min(every, key=lambda one: one[0])
            gaps = norm(at - place) / size
            near = [float(gaps[row].min()) for row in self._rows]
            rows = sorted((gap, k) for k, gap in enumerate(near) if gap < 2.0)
            worst.append((value, place, [k for _, k in rows]))
        return worst[0], worst[1]

    def _gathered(self, places: Array) -> Array:
        """Places (k, 3) of the vertices of rows, on all ranks, in the order of their numbers."""
        mine = self._local < self._own
        k, found = self._place[mine], np.zeros((len(self._numbers), 3))
        for part in self._V.mesh.comm.allgather((k, places[self._local[mine]])):
            found[part[0]] = part[1]
        return found

    def _slide(self, line: Integers, at: Array, now: Array) -> None:
        """Spread the vertices of a line of the rim along its first shape beside those that have
        slid, in place; they keep the displacements of where they come to lie."""
        first, slides = self._surface.smooth.points[line], self._slides[line]
        known, k = arc_lengths(first), np.searchsorted(self._numbers, line)
        arcs = np.array([_arc_at(place, first, known) for place in at[k]])
        arcs[[0, -1]] = known[[0, -1]]
        ends = slides.copy()
        ends[[0, -1]] = True
        wanted = np.interp(known, known[ends], arcs[ends])
        places, moved = _between(wanted, known, first), now[k] - at[k]
        if norm(places - at[k]).max() > self._surface.least[line].max():
            moved[~ends] = _between(wanted[~ends], arcs[~slides], moved[~slides])
            at[k], now[k] = places, places + moved

    def _on_surface(self, places: Array, vertices: Integers) -> Array:
        """Places (k, 3) of vertices (k,), on the surface where they are not their first ones."""
        new = self._surface.smooth.points[vertices]
        away = np.flatnonzero(norm(places - new) > self._surface.least[vertices])
        new[away] = self._surface.onto(vertices[away], places[away])[0]
        return new

    def _mean_gradients(self, X: Array, x: Array) -> tuple[Array, Array, Array]:
        """Deformation gradients (n, 3, 3) at the vertices, means of the cells around by area, which
        take normals to normals, and the normals (n, 3) of both surfaces."""
        total = self._stars.array.reshape(-1, 16)
        total[:] = 0.0
        own = self._V.mesh.topology.index_map(2).size_local
        add_stars(self._V.dofmap.list[:own], X, x, total)
        self._stars.scatter_reverse(la.InsertMode.add)
        self._stars.scatter_forward()
        means = total[:, :9] / total[:, 15:]
        return means.reshape(-1, 3, 3), _unit(total[:, 9:12]), _unit(total[:, 12:15])


@numba.njit(cache=True)
def add_stars(cells, X, x, total):  # type: ignore[no-untyped-def]
    """Add to each corner's row (16,) of all cells: the deformation gradient, which takes the normal
    to the normal, times the area twice; the area vectors of both shapes twice; and the area."""
    share = np.empty(16)
    for c in range(len(cells)):
        i, j, k = cells[c]
        A, B, a, b = X[j] - X[i], X[k] - X[i], x[j] - x[i], x[k] - x[i]
        D, d = cross_product(A, B), cross_product(a, b)
        area, size = np.sqrt((D**2).sum()), np.sqrt((d**2).sum())
        N, n = D / max(area, 1e-300), d / max(size, 1e-300)
        first, second = cross_product(B, N), cross_product(N, A)
        for p in range(3):
            for q in range(3):
                share[3 * p + q] = a[p] * first[q] + b[p] * second[q] + area * n[p] * N[q]
        share[9:12], share[12:15], share[15] = D, d, area
        for vertex in (i, j, k):
            for p in range(16):
                total[vertex, p] += share[p]


@numba.njit(cache=True)
def cross_product(a, b):  # type: ignore[no-untyped-def]
    """The cross product of two vectors (3,)."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _pieces(row: Integers, stops: Booleans) -> list[Integers]:
    """Parts of a row between its ends and vertices that do not move along it, with others in
    between."""
    k = np.unique([0, *np.flatnonzero(stops[row]), len(row) - 1])
    return [row[i : j + 1] for i, j in pairwise(ints(k)) if j > i + 1]


def _unit(vectors: Array) -> Array:
    """Unit vectors (k, 3), zero for zero."""
    return np.asarray(vectors / np.maximum(norm(vectors), 1e-300)[:, None])


def _between(wanted: Array, arcs: Array, values: Array) -> Array:
    """Vectors (k, 3) at arc lengths (k,) of a line with values (n, 3) at arc lengths (n,)."""
    return np.stack([np.interp(wanted, arcs, column) for column in values.T], axis=1)


def _arc_at(place: Array, line: Array, arcs: Array) -> float:
    """Arc length of a line's point (n, 3) closest to a place."""
    t, _, gaps = closest_on_segments(line[:-1], np.diff(line, axis=0), place)
    k = int(np.argmin(gaps))
    return float(arcs[k] + t[k] * (arcs[k + 1] - arcs[k]))
