"""The path of a cable over vertices and edges of the mesh; its two ends may lie inside cells.

Vertices are identified by global ids, so that a path is the same on every rank and stays valid when
the mesh is redistributed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.triangles import lists
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, pointers
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.corridor import cell_between
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
)


@dataclass(frozen=True)
class Path:
    """Path of a cable over the membrane, with the positions (length) of anchors off it."""

    points: tuple[SurfacePoint, ...]
    start_anchor: tuple[float, float, float] | None = None
    end_anchor: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(self.points))
        if len(self.points) < 2:
            raise PathError(f"a path of {len(self.points)} points; a cable needs two or more.")
        for i, point in enumerate(self.points[1:-1], start=1):
            if isinstance(point, CellPoint):
                raise PathError(
                    f"point {i} of a path is {point}; only its ends may lie inside a cell."
                )
        for name in ("start_anchor", "end_anchor"):
            anchor = getattr(self, name)
            if anchor is None:
                continue
            position = tuple(float(x) for x in anchor)
            if len(position) != 3 or not np.all(np.isfinite(position)):
                raise PathError(f"{name} {position} of a path; pass three finite coordinates.")
            object.__setattr__(self, name, position)

    def positions(self, vertices: Integers, points: Array) -> Array:
        """Positions (k, 3) of the path's k points, from vertex ids (n,) and positions (n, 3)."""
        vertices, points = np.asarray(vertices), np.asarray(points)
        order = np.argsort(vertices, kind="stable")
        wanted = np.array([v for point in self.points for v in point.support])
        found = np.searchsorted(vertices, wanted, sorter=order)
        rows = order[np.minimum(found, len(vertices) - 1)] if len(vertices) else found
        missing = wanted[vertices[rows] != wanted] if len(vertices) else wanted
        if len(missing):
            raise PathError(f"vertex {missing[0]} of a path is not in this mesh.")
        weights = np.concatenate([point.weights for point in self.points])
        first = pointers(np.array([len(point.support) for point in self.points]))[:-1]
        return np.asarray(np.add.reduceat(weights[:, None] * points[rows], first))

    def links(self, cells: Integers) -> tuple[Support, ...]:
        """Vertices of the edge or cell (m, 3) through which each point leads to the next."""
        surroundings = _Surroundings(cells, self.points)
        links: list[Support] = []
        for i, (a, b) in enumerate(pairwise(self.points)):
            link = surroundings.link(a, b)
            if link is None:
                raise PathError(f"a path cannot go from {a} to {b}: {_why_not(a, b)} (link {i}).")
            if links and link == links[-1]:
                raise PathError(
                    f"a path turns back at {a} (point {i}), into the cell or edge it came from."
                )
            links.append(link)
        return tuple(links)


def _on_one_edge(a: SurfacePoint, b: SurfacePoint) -> bool:
    """Whether two points lie on one edge and are not both vertices."""
    both_vertices = isinstance(a, VertexPoint) and isinstance(b, VertexPoint)
    return not both_vertices and len({*a.support, *b.support}) == 2


def _why_not(a: SurfacePoint, b: SurfacePoint) -> str:
    if a == b:
        return "they are the same point"
    if _on_one_edge(a, b):
        return "both lie on one edge, so the points between its vertices are superfluous"
    return "no cell of the mesh has both"


class _Surroundings:
    """Cells and edges available for links between some points."""

    def __init__(self, cells: ArrayLike, points: Sequence[SurfacePoint]) -> None:
        rows = np.asarray(cells, dtype=np.int64).reshape(-1, 3)
        support = np.array(sorted({v for point in points for v in point.support}), dtype=np.int64)
        near = np.sort(rows[np.isin(rows, support).sum(axis=1) >= 2], axis=1)
        sides = near[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2)
        self.cells = [(a, b, c) for a, b, c in lists(near)]
        self.simplices: set[Support] = {*self.cells, *((a, b) for a, b in lists(sides))}

    def link(self, a: SurfacePoint, b: SurfacePoint) -> Support | None:
        """Vertices of the edge or cell that leads from a to b; None if there is none."""
        both = cell_between(a.support, b.support)
        return both if both in self.simplices and a != b and not _on_one_edge(a, b) else None


def without_backtracking(
    points: Sequence[SurfacePoint], cells: Integers
) -> tuple[SurfacePoint, ...]:
    """Remove points where a polyline turns back into its last cell; fewer than two may remain."""
    kept = list(points)
    surroundings = _Surroundings(cells, kept)
    _cancel(kept, surroundings)
    for _ in range(2):  # both ends: one inside an edge that the cable follows moves into a cell
        if len(kept) > 1 and _on_one_edge(kept[0], kept[1]):
            _tie_ends_in_cells(kept, surroundings)
            _cancel(kept, surroundings)
        kept.reverse()
    return tuple(kept)


def _cancel(kept: list[SurfacePoint], surroundings: _Surroundings) -> None:
    i = 0
    while i < len(kept) - 1:
        drop = _superfluous(kept, i, surroundings)
        if drop is None:
            i += 1
        else:
            del kept[drop]
            i = max(i - 2, 0)


def _superfluous(kept: list[SurfacePoint], i: int, surroundings: _Surroundings) -> int | None:
    """Index of a redundant point among the three from i on, or None."""
    a, b, last = kept[i], kept[i + 1], len(kept) - 1
    if a == b:
        return i if i + 1 == last else i + 1
    if _on_one_edge(a, b):
        if isinstance(b, EdgePoint) and i + 1 != last:
            return i + 1
        return i if isinstance(a, EdgePoint) and i != 0 else None
    if i + 2 <= last:
        link = surroundings.link(a, b)
        if link is not None and link == surroundings.link(b, kept[i + 2]):
            return i + 1
    return None


def _tie_ends_in_cells(kept: list[SurfacePoint], surroundings: _Surroundings) -> None:
    """Move the first point, on one edge with the second, into a cell of that edge."""
    edges = [point.edge for point in kept[:2] if isinstance(point, EdgePoint)]
    cells = sorted(cell for cell in surroundings.cells if {*edges[0]} <= {*cell})
    if len(kept) > 2:  # the cell through which the path continues would make it turn back
        onward = surroundings.link(kept[1], kept[2])
        cells.sort(key=lambda cell: onward == cell)
    for i, point in enumerate(kept[:2]):
        if isinstance(point, EdgePoint):
            a, b = point.edge
            (c,) = set(cells[0]) - {a, b}
            kept[i] = CellPoint((a, b, c), (1.0 - point.fraction, point.fraction, 0.0))
