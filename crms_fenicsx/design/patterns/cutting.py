"""Cells divided along seams, so that all seams are mesh edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from crms_fenicsx.design.patterns.pattern_surface import PatternSurface, edges_of, integers
from crms_fenicsx.design.patterns.seams import Seam
from crms_fenicsx.design.patterns.snapping import snapped
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.surface import BOUNDARY, CheckedSurface, check_shapes
from crms_fenicsx.foundation.meshes.triangles import lists
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.points import Edge, Support, SurfacePoint, VertexPoint, edge_of

SAME = 1e-6
"""Crossings of an edge by two seams closer than this fraction of the edge are one point."""


@dataclass(frozen=True)
class CutSurface:
    """A surface whose seams are mesh edges."""

    surface: CheckedSurface  # with all groups of the original surface
    lines: dict[str, Integers]  # vertices (k,) along each seam, by seam name

    @cached_property
    def seam_of(self) -> dict[Edge, str]:
        """The seam's name by edge."""
        found: dict[Edge, str] = {}
        for name, line in self.lines.items():
            for a, b in pairwise(integers(line)):
                if found.setdefault(edge_of(a, b), name) != name:
                    place = as_text(self.surface.points[a])
                    raise PathError(
                        f"the seams {found[edge_of(a, b)]!r} and {name!r} run along one edge at "
                        f"{place}; move one of them, or end it there."
                    )
        return found


def cut_along(surface: PatternSurface, seams: list[Seam]) -> CutSurface:
    """Divide the cells that seams cross; existing vertices keep their numbers."""
    _check_ends(surface, seams)
    points, lines = snapped(surface, seams)
    nodes = _CutNodes(surface, points)
    courses = [nodes.course(line) for line in lines]
    chords: dict[Support, list[tuple[int, int, str]]] = {}
    ordered: dict[str, Integers] = {}
    for seam, line, course in zip(seams, lines, courses, strict=True):
        whole = [course[0]]
        for (p, u), (q, v) in pairwise(zip(line, course, strict=True)):
            support = tuple(sorted({*p.support, *q.support}))
            if len(support) == 3:
                chords.setdefault(support, []).append((u, v, seam.name))
                whole.append(v)
            else:  # along an edge, through other seams' nodes on it
                whole += nodes.between((support[0], support[1]), u, v)
        ordered[seam.name] = np.array(whole, dtype=np.int64)
    cells, parents = _divided(surface, nodes, chords)
    new = np.array(nodes.places).reshape(-1, 3)
    check_shapes(new, cells)
    old = surface.checked
    edges = {name: nodes.divided(keys) for name, keys in old.edges.items()}
    edges |= {
        name: edge_keys(np.stack([line[:-1], line[1:]], axis=1))
        for name, line in ordered.items()
        if name not in edges
    }
    table = EdgeTable.of(cells)
    edges[BOUNDARY] = table.keys[table.counts == 1]
    cut = replace(
        old, points=new, cells=cells, edges=edges,
        parts={name: np.flatnonzero(np.isin(parents, own)) for name, own in old.parts.items()},
        hidden=np.flatnonzero(np.isin(parents, old.hidden)), seam_links=table.seam_links(),
    )  # fmt: skip
    return CutSurface(cut, ordered)


def _check_ends(surface: PatternSurface, seams: Sequence[Seam]) -> None:
    """Raise an error for seams that end inside the surface."""
    for seam in seams:
        others = {p for other in seams if other is not seam for p in other.points}
        for end, place in ((seam.points[0], seam.path[0]), (seam.points[-1], seam.path[-1])):
            if seam.closed or surface.on_rim(end) or end in others:
                continue
            raise PathError(
                f"the seam {seam.name!r} does not cut the surface: it ends inside it, at "
                f"{as_text(place)}; lead it to the rim, or to a vertex of another seam."
            )


class _CutNodes:
    """Vertices of the cut surface: mesh vertices, and crossings of seams with edges."""

    def __init__(self, surface: PatternSurface, points: Array) -> None:
        self.surface = surface
        self.places = list(points)
        self.on: dict[Edge, list[tuple[float, int]]] = {}

    def course(self, line: tuple[SurfacePoint, ...]) -> list[int]:
        """The nodes along a seam."""
        return [self._node(p) for p in line]

    def _node(self, p: SurfacePoint) -> int:
        if isinstance(p, VertexPoint):
            return p.vertex
        a, b = p.support
        there, t = self.on.setdefault((a, b), []), p.weights[1]
        for other, node in there:
            if abs(other - t) <= SAME:
                return node
        node = len(self.places)
        self.places.append(self.surface.places((p,))[0])
        there.append((t, node))
        there.sort()
        return node

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


def _divided(
    surface: PatternSurface, nodes: _CutNodes, chords: dict[Support, list[tuple[int, int, str]]]
) -> tuple[Integers, Integers]:
    """The triangles (m, 3) after division by chords, and their parent cells (m,)."""
    touched = {v for edge in nodes.on for v in edge} | {v for cell in chords for v in cell}
    cells: list[tuple[int, ...]] = []
    parents: list[int] = []
    places = np.array(nodes.places)
    near = np.isin(surface.cells, np.array(sorted(touched), dtype=np.int64)).sum(axis=1) > 1
    for row, cell in enumerate(lists(surface.cells)):
        parts = [tuple(cell)]
        if near[row]:
            a, b, c = cell
            rim = [a, *nodes.along(a, b), b, *nodes.along(b, c), c, *nodes.along(c, a)]
            parts = _split(rim, chords.get(tuple(sorted(cell)), []), places)
        cells += parts
        parents += [row] * len(parts)
    return np.array(cells, dtype=np.int64), np.array(parents, dtype=np.int64)


def _split(
    rim: list[int], chords: list[tuple[int, int, str]], places: Array
) -> list[tuple[int, ...]]:
    """The triangles of a cell, with nodes around its boundary, divided by chords."""
    polygons = [rim]
    for u, v, name in chords:
        own = next((p for p in polygons if u in p and v in p), None)
        if own is None:
            others = ", ".join(repr(other) for *_, other in chords if other != name)
            raise PathError(
                f"the seam {name!r} crosses another one ({others}) inside a cell, near "
                f"{as_text(places[u])}; lead both through one vertex of the mesh, or apart."
            )
        i, j = sorted((own.index(u), own.index(v)))
        if j - i in (1, len(own) - 1):
            continue
        polygons.remove(own)
        polygons += [own[i : j + 1], own[j:] + own[: i + 1]]
    return [triangle for polygon in polygons for triangle in _triangulated(polygon, places)]


def _triangulated(polygon: list[int], places: Array) -> list[tuple[int, ...]]:
    """Triangulation of a flat convex polygon whose worst triangle is best."""
    n = len(polygon)
    if n == 3:
        return [tuple(polygon)]
    x = places[polygon]
    best: dict[tuple[int, int], tuple[float, int]] = {}
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            best[i, j] = max(
                (
                    min(
                        _least_sine(x[[i, k, j]]),
                        best.get((i, k), (np.inf, 0))[0],
                        best.get((k, j), (np.inf, 0))[0],
                    ),
                    -k,
                )
                for k in range(i + 1, j)
            )

    def triangles(i: int, j: int) -> list[tuple[int, ...]]:
        if j - i < 2:
            return []
        k = -best[i, j][1]
        own = (polygon[i], polygon[k], polygon[j])
        return [*triangles(i, k), own, *triangles(k, j)]

    return triangles(0, n - 1)


def _least_sine(corners: Array) -> float:
    """Squared sine of a triangle's smallest angle, from its area and two longest sides."""
    p, q, r = corners[1] - corners[0], corners[2] - corners[1], corners[0] - corners[2]
    area = np.cross(p, q)
    sides = sorted((p @ p, q @ q, r @ r))
    return float((area @ area) / max(sides[1] * sides[2], 1e-300))
