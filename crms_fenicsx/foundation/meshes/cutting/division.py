"""Cells divided along chords, so that lines across them become edges of the mesh."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np

from crms_fenicsx.foundation.meshes.edge_table import edge_keys, edges_of
from crms_fenicsx.foundation.meshes.triangles import dot, double_areas, shapes, vectors
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, ints
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    Edge,
    Support,
    SurfacePoint,
    VertexPoint,
    edge_of,
)

Leg = tuple[Support, list[int]]
"""A line from one of its points to the next: the vertices of the edge or cell, and the nodes."""

Chords = dict[Support, list[tuple[str, list[int]]]]
"""Lines through each cell, by its sorted vertices: names, and nodes from side to side."""


class CutNodes:
    """Vertices of the cut surface: mesh vertices, and points of lines, few of them in cells."""

    def __init__(self, corners: Array, points: Array, within: float) -> None:
        """For lines over a surface with corners (n, 3), whose vertices are at `points` (n, 3) when
        it has been cut; crossings of an edge `within` a fraction of it are one."""
        self.corners, self.within = corners, within
        self.places = vectors(points)
        self.on: dict[Edge, list[tuple[float, int]]] = {}
        self.inside: dict[Support, list[tuple[CellPoint, int]]] = {}

    def node(self, p: SurfacePoint) -> int:
        """The node at a point of a line, new if it is the first there."""
        if isinstance(p, VertexPoint):
            return p.vertex
        if isinstance(p, CellPoint):
            for known, node in (own := self.inside.setdefault(p.cell, [])):
                if np.abs(np.subtract(p.weights, known.weights)).max() <= self.within:
                    return node
            own.append((p, self.new(np.array(p.weights) @ self.corners[list(p.cell)])))
            return own[-1][1]
        there, t = self.on.setdefault(p.edge, []), p.fraction
        for other, node in there:
            if abs(other - t) <= self.within:
                return node
        node = self.new(np.array(p.weights) @ self.corners[list(p.edge)])
        there.append((t, node))
        there.sort()
        return node

    def new(self, place: Array) -> int:
        """A node at a place (3,)."""
        self.places.append(place)
        return len(self.places) - 1

    def legs(self, lines: Mapping[str, Sequence[SurfacePoint]]) -> dict[str, list[Leg]]:
        """Lines from point to point, through the nodes of all of them."""
        for line in lines.values():
            for point in line:
                self.node(point)
        return {name: self._legs(line) for name, line in lines.items()}

    def _legs(self, line: Sequence[SurfacePoint]) -> list[Leg]:
        """A line from point to point, through the nodes of all lines."""
        found: list[Leg] = []
        for (p, u), (q, v) in pairwise((p, self.node(p)) for p in line):
            support = tuple(sorted({*p.support, *q.support}))
            if u != v and len(support) == 2:  # along an edge, through other lines' nodes on it
                found.append((support, [u, *self.between((support[0], support[1]), u, v)]))
            elif u != v:
                found.append((support, [u, v]))
        return found

    def along(self, a: int, b: int) -> list[int]:
        """The nodes inside an edge, from a to b."""
        found = [node for _, node in self.on.get(edge_of(a, b), [])]
        return found if a < b else found[::-1]

    def between(self, edge: Edge, u: int, v: int) -> list[int]:
        """The nodes of an edge behind u, up to v."""
        whole = [edge[0], *self.along(*edge), edge[1]]
        i, j = whole.index(u), whole.index(v)
        return whole[i + 1 : j + 1] if i < j else whole[j:i][::-1]

    def divided(self, keys: Integers) -> Integers:
        """Segments (n,) of divided edges (k,), all as `edge_keys`."""
        pairs = []
        for a, b in edges_of(keys):
            pairs += list(pairwise([a, *self.along(a, b), b]))
        return np.unique(edge_keys(np.array(pairs, dtype=np.int64).reshape(-1, 2)))


def chords_of(lines: Mapping[str, Iterable[Leg]]) -> Chords:
    """The legs of lines that lead through cells; the lists of nodes are shared."""
    chords: Chords = {}
    for name, legs in lines.items():
        for support, nodes in legs:
            if len(support) == 3:
                chords.setdefault(support, []).append((name, nodes))
    return chords


def course(legs: Sequence[Leg]) -> Integers:
    """The nodes (k,) along a line."""
    return np.array([*legs[0][1][:1], *(v for _, nodes in legs for v in nodes[1:])], dtype=np.int64)


def divided(cells: Integers, nodes: CutNodes, chords: Chords) -> tuple[Integers, Integers]:
    """The triangles (m, 3) after division by chords, and their parent cells (m,)."""
    sides = edge_keys(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)).reshape(-1, 3)
    ends = np.array(sorted({v for cell in chords for v in cell}), dtype=np.int64)
    cut = edge_keys(np.array([*nodes.on], dtype=np.int64))
    on_sides, of_cells = np.isin(sides, cut), np.isin(cells, ends)
    near = np.asarray(on_sides.any(axis=1) | of_cells.all(axis=1))
    polygons: dict[int, list[list[int]]] = {}  # by their number of corners
    owners: dict[int, list[int]] = {}
    for row in ints(np.flatnonzero(near)):
        cell = ints(cells[row])
        for polygon in _split(cell, nodes, chords.get(tuple(sorted(cell)), [])):
            polygons.setdefault(len(polygon), []).append(polygon)
            owners.setdefault(len(polygon), []).append(row)
    points = np.array(nodes.places)
    children, parents = [cells[~near]], [np.flatnonzero(~near)]
    for n, own in polygons.items():
        rows = np.array(owners[n])
        corners, normals = np.array(own), double_areas(points[cells[rows]])
        new = corners[
            np.arange(len(rows))[:, None, None], _triangulations(points[corners], normals)
        ]
        children.append(new.reshape(-1, 3))
        parents.append(rows.repeat(n - 2))
    order = np.argsort(np.concatenate(parents), kind="stable")
    return np.concatenate(children)[order], np.concatenate(parents)[order]


def _split(
    cell: list[int], nodes: CutNodes, chords: list[tuple[str, list[int]]]
) -> list[list[int]]:
    """The polygons of a cell divided by chords, with nodes on its sides."""
    a, b, c = cell
    rim = [a, *nodes.along(a, b), b, *nodes.along(b, c), c, *nodes.along(c, a)]
    places = nodes.places
    polygons, pending = [rim], _joined(rim, chords) if len(chords) > 1 else list(chords)
    while pending:
        known = {v for polygon in polygons for v in polygon}
        # next one that ends at others, not before them
        k = next((k for k, (_, own) in enumerate(pending) if {own[0], own[-1]} <= known), 0)
        name, chord = pending.pop(k)
        stops = [k for k, v in enumerate(chord) if v in known]
        for first, last in pairwise(stops):
            u, v, inner = chord[first], chord[last], chord[first + 1 : last]
            own = next((p for p in polygons if u in p and v in p), None)
            if own is None:
                others = ", ".join(repr(other) for other, _ in chords if other != name)
                raise PathError(
                    f"the line {name!r} crosses another one ({others}) inside a cell, near "
                    f"{as_text(places[u])}; lead both through one vertex of the mesh, or apart."
                )
            i, j = own.index(u), own.index(v)
            if i > j:
                i, j, inner = j, i, inner[::-1]
            if not inner and j - i in (1, len(own) - 1):
                continue
            polygons.remove(own)
            polygons += [own[i : j + 1] + inner[::-1], own[j:] + own[: i + 1] + inner]
    return polygons


def _joined(rim: list[int], chords: list[tuple[str, list[int]]]) -> list[tuple[str, list[int]]]:
    """The chords of a cell, one instead of each two that end at one node inside it."""
    found: list[tuple[str, list[int]]] = []
    for name, chord in chords:
        for k, (other, own) in enumerate(found):
            inner = {chord[0], chord[-1]} & {own[0], own[-1]} - {*rim}
            if inner:
                first = own if own[-1] in inner else own[::-1]
                second = chord if chord[0] in inner else chord[::-1]
                found[k] = other, first + second[1:]
                break
        else:
            found.append((name, chord))
    return found


def _triangulations(x: Array, normals: Array) -> Integers:
    """The corners (q, n - 2, 3) of the triangles into which polygons (q, n, 3) in planes with
    normals (q, 3) are divided so that the worst is best."""
    count, n, _ = x.shape
    # qualities of the parts from corner i to j when divided best, and their triangles
    best = {(i, i + 1): np.full(count, np.inf) for i in range(n - 1)}
    parts = {(i, i + 1): np.zeros((count, 0, 3), dtype=np.int64) for i in range(n - 1)}
    for i, j in sorted(combinations(range(n), 2), key=lambda ends: ends[1] - ends[0])[n - 1 :]:
        best[i, j] = np.full(count, -np.inf)
        parts[i, j] = np.zeros((count, j - i - 1, 3), dtype=np.int64)
        for k in range(i + 1, j):  # of equal ones the first
            own, sines = shapes(x[:, [i, k, j]])
            outside = dot(own, normals) < 0.0
            least = np.minimum(np.where(outside, -1.0, sines), best[i, k])
            least = np.minimum(least, best[k, j])
            better = least > best[i, j]
            best[i, j][better] = least[better]
            triangle = np.broadcast_to([[[i, k, j]]], (count, 1, 3))
            new = np.concatenate([parts[i, k], triangle, parts[k, j]], axis=1)
            parts[i, j][better] = new[better]
    return parts[0, n - 1]
