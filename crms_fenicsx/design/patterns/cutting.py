"""Cells divided along seams, so that all seams are mesh edges; vertices near seams moved there."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from crms_fenicsx.design.patterns.pattern_surface import PatternSurface, edges_of
from crms_fenicsx.design.patterns.seams import Seam
from crms_fenicsx.foundation.meshes.edge_table import edge_keys
from crms_fenicsx.foundation.meshes.surface import BOUNDARY, CheckedSurface, check_shapes
from crms_fenicsx.foundation.meshes.triangles import dot, double_areas, lists, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.points import (
    Edge,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
    edge_of,
)
from crms_fenicsx.model.tolerances import SAME_POINT

NEAR = 0.2
"""Fraction of an edge within which a vertex is moved to a seam's crossing of the edge. The smallest
angle of random cells falls from 26 to 11 degrees, and to 1.4 without moving."""
STRAIGHT = np.cos(np.radians(15.0))
"""Cosine of the largest turn of a rim or edge group at a vertex that may be moved along it."""
LEAST_AREA = 0.3
"""Fraction of a cell's area that must remain."""


def cut_along(
    surface: PatternSurface, seams: Sequence[Seam]
) -> tuple[CheckedSurface, dict[str, Integers]]:
    """The surface with all groups whose cells are divided where seams cross them, and the vertices
    (k,) along each seam by name; existing vertices keep their numbers."""
    _check_ends(surface, seams)
    points, lines = _snapped(surface, seams)
    nodes = _CutNodes(surface, points)
    courses = [[nodes.node(p) for p in line] for line in lines]
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
    edges = {name: nodes.divided(keys) for name, keys in surface.edges.items()}
    edges |= {
        name: edge_keys(np.stack([line[:-1], line[1:]], axis=1))
        for name, line in ordered.items()
        if name not in edges
    }
    return surface.divided(new, cells, parents, edges), ordered


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

    def node(self, p: SurfacePoint) -> int:
        """The node at a point of a seam, new if it is the first there."""
        if isinstance(p, VertexPoint):
            return p.vertex
        a, b = p.support
        there, t = self.on.setdefault((a, b), []), p.weights[1]
        for other, node in there:
            if abs(other - t) <= SAME_POINT:
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

    @cache
    def best(i: int, j: int) -> tuple[float, int, list[tuple[int, ...]]]:
        """Quality and triangles of the part from i to j; of equal ones that of the least k."""
        found: list[tuple[float, int, list[tuple[int, ...]]]] = []
        for k in range(i + 1, j):
            (before, _, left), (after, _, right) = best(i, k), best(k, j)
            quality = min(_least_sine(x[[i, k, j]]), before, after)
            found.append((quality, -k, [*left, (polygon[i], polygon[k], polygon[j]), *right]))
        return max(found, default=(np.inf, 0, []))

    return best(0, n - 1)[2]


def _least_sine(corners: Array) -> float:
    """Squared sine of a triangle's smallest angle, from its area and two longest sides."""
    p, q, r = corners[1] - corners[0], corners[2] - corners[1], corners[0] - corners[2]
    area = np.cross(p, q)
    sides = sorted((p @ p, q @ q, r @ r))
    return float((area @ area) / max(sides[1] * sides[2], 1e-300))


def _snapped(
    surface: PatternSurface, seams: Sequence[Seam]
) -> tuple[Array, list[tuple[SurfacePoint, ...]]]:
    """Coordinates (n, 3) of the vertices after moving those near seams, and the seams' points."""
    points, lines = surface.points.copy(), [list(seam.points) for seam in seams]
    fixed = {p.vertex for line in lines for p in line if isinstance(p, VertexPoint)}
    fixed |= {int(v) for ids in surface.point_groups.values() for v in ids}
    bound = _FeatureLines(surface)
    found: list[tuple[float, int, int, EdgePoint]] = []
    for k, line in enumerate(lines):
        for p in line:
            if isinstance(p, EdgePoint):
                for v, part in zip(p.edge, (p.fraction, 1.0 - p.fraction), strict=True):
                    if part < NEAR and v not in fixed and bound.allow(v, p.edge):
                        found.append((part, v, k, p))
    for _, v, k, p in sorted(found, key=lambda one: one[:3]):
        if v in fixed or p not in lines[k]:
            continue
        place = surface.places((p,))[0]
        if _keeps_cells(surface, points, v, place):
            points[v] = place
            fixed.add(v)
            for line in lines:
                _lead_through(line, v, p)
    return points, [tuple(line) for line in lines]


def _lead_through(line: list[SurfacePoint], v: int, p: EdgePoint) -> None:
    """Replace a line's crossings of a vertex's edges, including point p, by the vertex."""
    if p not in line:
        return
    beside = [isinstance(q, EdgePoint) and v in q.edge for q in line]
    first = last = line.index(p)
    while first > 0 and beside[first - 1]:
        first -= 1
    while last + 1 < len(line) and beside[last + 1]:
        last += 1
    line[first : last + 1] = [VertexPoint(v)]


def _keeps_cells(surface: PatternSurface, points: Array, v: int, place: Array) -> bool:
    """Whether the cells around a vertex stay valid when it is moved."""
    cells = surface.cells[sorted(surface.target.around[v])]
    before = double_areas(points[cells])
    corners = points[cells]
    corners[cells == v] = place
    after = double_areas(corners)
    kept = (dot(after, before) >= LEAST_AREA * dot(before, before)) & (norm(after) > 0.0)
    return bool(kept.all())


class _FeatureLines:
    """Rims and edge groups, along which their vertices must stay."""

    def __init__(self, surface: PatternSurface) -> None:
        self.surface, table = surface, surface.table
        rims = table.keys[table.counts != 2]
        self.of: dict[Edge, set[str]] = defaultdict(set)
        self.at: dict[int, set[Edge]] = defaultdict(set)
        for name, keys in (surface.edges | {BOUNDARY: rims}).items():
            for edge in edges_of(keys):
                self.of[edge].add(name)
                for v in edge:
                    self.at[v].add(edge)

    def allow(self, v: int, edge: Edge) -> bool:
        """Whether a vertex may be moved along an edge."""
        own = sorted(self.at[v])
        if not own:
            return True
        if edge not in own or len(own) != 2 or self.of[own[0]] != self.of[own[1]]:
            return False
        a, b = ((set(e) - {v}).pop() for e in own)
        x = self.surface.points
        p, q = x[v] - x[a], x[b] - x[v]
        return bool(p @ q >= STRAIGHT * np.linalg.norm(p) * np.linalg.norm(q))
