"""Projections of spans: the cells under a lifted cable, where it may touch down.

The path under a straight span is the section of the membrane with the plane of the span and the
membrane's normal, traced from cell to cell by the vertices' signed distances from that plane.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from itertools import pairwise

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.foundation.meshes.triangles import cross
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    Edge,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
    edge_of,
)
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, TOL

Cell = tuple[int, int, int]
"""Vertices of a cell of the membrane, by id."""


class _Plane(dict[int, float]):
    """The plane of a span, with the end where tracing starts: signed distances of vertices from it,
    computed when they are asked for."""

    def __init__(self, shape: StripShape, start: Array, end: Array, normal: Array) -> None:
        super().__init__()
        self.shape, self.start = shape, start
        # Along the membrane only, as what has passed below a high end is a small part of a steep
        # span. To an end below the membrane the cable goes over the boundary, farther away.
        self.along = end - start - max(float((end - start) @ normal), 0.0) * normal
        across = cross(normal, end - start)
        self.across = across / max(float(np.linalg.norm(across)), 1e-300)
        self._places, self._row_of = shape.current, shape.strip.row_of

    def __missing__(self, vertex: int) -> float:
        away = self._places[self._row_of[vertex]] - self.start
        side = self[vertex] = float(away @ self.across)
        return side

    def crosses(self, a: int, b: int) -> bool:
        """Whether an edge crosses the plane; a vertex in it counts as on the positive side."""
        return (self[a] >= 0.0) != (self[b] >= 0.0)

    def point(self, a: int, b: int) -> tuple[float, float]:
        """Intersection with the edge from a to b: fractions along the edge and along the span."""
        s = self[a] / (self[a] - self[b])
        first, last = self._places[self._row_of[a]], self._places[self._row_of[b]]
        place = first + s * (last - first)
        along = max(float(self.along @ self.along), 1e-300)
        return s, float((place - self.start) @ self.along) / along


def project_span(
    shape: StripShape, first: CableNode, start: Array, last: CableNode, end: Array
) -> list[SurfacePoint] | None:
    """Edge points of the membrane under a span, in order, excluding its ends; None if the section
    from the first does not reach the last."""
    assert first.point is not None
    plane = _Plane(shape, start, end, shape.normal(first.point.support))
    goal = set() if last.point is None else set(last.point.support)
    found = _first_edge(plane, first.point.support)
    if found is None:
        return None
    edge, cell = found
    points: list[SurfacePoint] = []
    for _ in range(BUDGET.cells_below):
        if goal and goal <= set(cell):
            return points
        a, b = edge
        s, t = plane.point(a, b)
        if not goal and t >= 1.0:
            return [*points, _anchor_foot(shape, cell, end)]  # an anchor above the membrane
        points.append(EdgePoint(edge, min(max(s, 1e-9), 1 - 1e-9)))
        beyond = [c for c in _cells(shape, edge) if set(c) != set(cell)]
        if not beyond:
            return None if goal else points
        cell = beyond[0]
        (third,) = set(cell) - {a, b}
        edge = edge_of(a, third) if plane.crosses(a, third) else edge_of(b, third)
    return None


def _first_edge(plane: _Plane, support: tuple[int, ...]) -> tuple[Edge, Cell] | None:
    """First edge that the plane crosses beyond a support, and the cell before it."""
    best: tuple[float, Edge, Cell] | None = None
    for cell in _cells(plane.shape, support):
        for k in range(3):
            a, b = edge_of(cell[k], cell[k - 1])
            if set(support) <= {a, b} or (len(support) == 1 and support[0] in (a, b)):
                continue
            if plane.crosses(a, b):
                _, t = plane.point(a, b)
                if t > 0.0 and (best is None or t > best[0]):
                    best = (t, (a, b), cell)
    return None if best is None else best[1:]


def _cells(shape: StripShape, support: tuple[int, ...]) -> list[Cell]:
    missing = [v for v in support if v not in shape.strip.complete]
    if len(missing) == len(support):
        raise MissingCells(missing)
    corners = shape.strip.corners
    return [(a, b, c) for a, b, c in [corners[k] for k in shape.strip.outer_rows(support)]]


def _anchor_foot(shape: StripShape, cell: Cell, place: Array) -> CellPoint:
    """Cell point below an anchor, inside the cell even if the anchor is beyond it."""
    weights = np.clip(_weights(shape, cell, place), 1e-9, 1.0)
    x, y, z = (float(w) for w in weights / weights.sum())
    return CellPoint(cell, (x, y, z))


def _weights(shape: StripShape, cell: Cell, place: Array) -> Array:
    """Barycentric weights (3,) of a position in a cell's plane."""
    a, b, c = (shape.at(v) for v in cell)
    u, v = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), place - a, rcond=None)[0]
    return np.array([1 - u - v, u, v])


Projected = tuple[list[SurfacePoint], list[bool]]
"""Points of a path, and whether each is lifted."""


def loose_crossings(cables: Sequence[LaidCable]) -> set[int]:
    """Numbers of the crossings beside lifted nodes of either cable: nothing keeps them in their
    cells."""
    return {
        node.crossing
        for cable in cables
        if cable.taut and cable.state.lifted.any()
        for k, node in enumerate(cable.state.nodes)
        if node.kind == "crossing" and node.crossing is not None
        if np.any(cable.state.lifted[k - 1 : k + 2])
    }


def with_span_projections(cable: LaidCable, shape: StripShape, loose: Set[int]) -> Projected | None:
    """Path of a cable with updated span projections; None if unchanged. Crossings that are `loose`,
    by number, may have slid into other cells."""
    nodes, contacts = [*cable.state.nodes], cable.contacts()
    moved = {k for k in contacts if nodes[k].kind == "crossing" and nodes[k].crossing in loose}
    for k in sorted(moved):
        cell = cell_under(shape, nodes[k].support, cable.state.positions[k])
        if cell is None or set(cell) == set(nodes[k].support):
            moved.discard(k)
        else:
            nodes[k] = replace(nodes[k], point=_anchor_foot(shape, cell, cable.state.positions[k]))
    renewed: dict[int, list[SurfacePoint]] = {}  # by the preceding contact
    changed = False
    for a, b in pairwise(contacts):
        old = [nodes[k].support for k in _between(nodes, a, b)]
        new = _renewed(cable, nodes, a, b, shape) if old or {a, b} & moved else None
        if new is None and {a, b} & moved:
            new = _over_edge(cable, nodes, a, b, shape)
            if new is None:
                return None
        if new is not None:
            renewed[a] = new
            changed |= [point.support for point in new] != old
    if not changed:
        return None
    points: list[SurfacePoint] = []
    lifted: list[bool] = []
    along_edges: list[tuple[int, SurfacePoint]] = []
    for a, b in zip(contacts, [*contacts[1:], len(nodes)], strict=True):
        if _is_on_path(nodes[a]) or _at_vertex(nodes[a]):
            points.append(cable.point(a))
            lifted.append(_at_vertex(nodes[a]))
        elif isinstance(crossing := nodes[a].point, EdgePoint):
            along_edges.append((len(points), crossing))
        points += renewed[a] if a in renewed else cable.points(_between(nodes, a, b))
        lifted += [True] * (len(points) - len(lifted))
    for n, crossing in reversed(along_edges):  # of an edge that the path followed and now crosses
        if not _share_cell(shape, points[n - 1 : n + 1]):
            points.insert(n, crossing)
            lifted.insert(n, False)
    if not all(_share_cell(shape, pair) for pair in pairwise(points)):
        return None
    return points, lifted


def _share_cell(shape: StripShape, points: Sequence[SurfacePoint]) -> bool:
    """Whether some cell has all the points."""
    return len(shape.strip.rows(tuple(v for point in points for v in point.support))) > 0


def cell_under(shape: StripShape, support: Support, place: Array) -> Cell | None:
    """The cell under a position, found from a cell nearby; None beyond the membrane's boundary, and
    above a ridge, where each cell has the position beyond the other."""
    if len(support) != 3:
        return None
    (cell,) = _cells(shape, support)
    passed = set[Cell]()
    while cell not in passed:
        passed.add(cell)
        weights = _weights(shape, cell, place)
        if weights.min() >= -TOL.inside:
            return cell
        corner = cell[int(np.argmin(weights))]
        a, b = (v for v in cell if v != corner)
        beyond = [c for c in _cells(shape, (a, b)) if corner not in c]
        if not beyond:
            return None
        cell = beyond[0]
    return None


def _is_on_path(node: CableNode) -> bool:
    return node.point is not None and node.kind != "crossing"


def _at_vertex(node: CableNode) -> bool:
    """Whether a node is a free crossing above a common vertex, which is on the path for it."""
    return node.kind == "crossing" and isinstance(node.point, VertexPoint)


def _between(nodes: Sequence[CableNode], a: int, b: int) -> list[int]:
    """Nodes of the path between two contacts, without the vertex of a crossing above it."""
    last = b - 1 if b < len(nodes) and _at_vertex(nodes[b]) else b
    return [k for k in range(a + 1, last) if _is_on_path(nodes[k])]


def _over_edge(
    cable: LaidCable, nodes: Sequence[CableNode], a: int, b: int, shape: StripShape
) -> list[SurfacePoint] | None:
    """The edge that a crossing has slid over, between its old cell and the contact on that cell,
    which the section misses if the cable has pulled the contact's edge aside."""
    (k, other), *more = [(k, a + b - k) for k in (a, b) if nodes[k] is not cable.state.nodes[k]]
    if more or nodes[other].point is None:
        return None
    cell, last = set(nodes[k].support), set(cable.state.nodes[k].support)
    edge = sorted(cell & last)
    if len(edge) != 2 or not set(nodes[other].support) <= last:
        return None
    u, v = edge
    start, end = cable.state.positions[[a, b]]
    plane = _Plane(shape, start, end, shape.normal((u, v)))
    p, q = plane[u], plane[v]
    s = p / (p - q) if p * q < 0.0 else float(abs(p) > abs(q))
    return [EdgePoint((u, v), min(max(s, 1e-9), 1 - 1e-9))]


def _renewed(
    cable: LaidCable, nodes: Sequence[CableNode], a: int, b: int, shape: StripShape
) -> list[SurfacePoint] | None:
    """Projection of the span between two contacts."""
    ends = [(nodes[k], cable.state.positions[k]) for k in (a, b)]
    # From one end a section may pass a vertex on the side that misses the other end's support.
    for start, end in (ends, ends[::-1]):
        if start[0].point is not None:
            found = project_span(shape, *start, *end)
            if found is not None:
                return found if start is ends[0] else found[::-1]
    if any(node.point is not None for node, _ in ends):
        return None
    # Neither end is on the membrane: trace both ways from the middle of the old projection.
    own = [k for k in range(a + 1, b) if cable.state.nodes[k].point is not None]
    middle = own[len(own) // 2]
    node = cable.state.nodes[middle]
    assert node.point is not None
    if isinstance(node.point, CellPoint):
        return None
    at = cable.state.positions[middle]
    back = project_span(shape, node, at, *ends[0])
    onward = project_span(shape, node, at, *ends[1])
    if back is None or onward is None:
        return None
    return [*back[::-1], node.point, *onward]
