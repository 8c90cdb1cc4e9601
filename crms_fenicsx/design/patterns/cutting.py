"""Cells divided along seams, so that all seams are mesh edges; vertices near seams moved there."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.design.patterns.pattern_surface import PatternSurface
from crms_fenicsx.design.patterns.seams import Seam
from crms_fenicsx.foundation.meshes.cutting.division import CutNodes, chords_of, course, divided
from crms_fenicsx.foundation.meshes.edge_table import edge_keys, edges_of
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.meshes.surface import BOUNDARY, CheckedSurface, check_shapes
from crms_fenicsx.foundation.meshes.triangles import dot, double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.points import (
    Edge,
    EdgePoint,
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


@dataclass(frozen=True)
class Origin:
    """The mesh of which pieces were cut, and where its cells and edges are in the cut surface; its
    vertices keep their numbers."""

    mesh: MembraneMesh
    surface: PatternSurface
    parents: Integers  # (m,) the cell of the mesh from which each cell was cut
    cuts: Mapping[Edge, tuple[int, ...]]  # new vertices inside its edges, in order

    def chain(self, a: int, b: int) -> list[int]:
        """The vertices along one of its edges, from a to b."""
        inner = self.cuts.get(edge_of(a, b), ())
        return [a, *(inner if a < b else inner[::-1]), b]


def cut_along(
    surface: PatternSurface, mesh: MembraneMesh, seams: Sequence[Seam]
) -> tuple[CheckedSurface, dict[str, Integers], Origin]:
    """The surface of a mesh with all groups whose cells are divided where seams cross them, the
    vertices (k,) along each seam by name, and what was cut."""
    _check_ends(surface, seams)
    points, lines = _snapped(surface, seams)
    nodes = CutNodes(surface.points, points, SAME_POINT)
    legs = nodes.legs({seam.name: line for seam, line in zip(seams, lines, strict=True)})
    ordered = {name: course(own) for name, own in legs.items()}
    cells, parents = divided(surface.cells, nodes, chords_of(legs))
    new = np.array(nodes.places).reshape(-1, 3)
    check_shapes(new, cells)
    edges = {name: nodes.divided(keys) for name, keys in surface.edges.items()}
    edges |= {
        name: edge_keys(np.stack([line[:-1], line[1:]], axis=1))
        for name, line in ordered.items()
        if name not in edges
    }
    cuts = {edge: tuple(node for _, node in on) for edge, on in nodes.on.items()}
    origin = Origin(mesh, surface, parents, cuts)
    return surface.divided(new, cells, parents, edges), ordered, origin


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
