"""Numbered edges of a triangulation, the cells at each, and seams: edges of three or more cells.

The cells at a seam divide the space around it into sectors. Cables lie on the outer side of the
membrane, so they pass a seam through sectors that are outside of both bounding cells: over the
roof, not along the wall that hangs below it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints
from crms_fenicsx.foundation.runtime.errors import PathError


def edge_keys(pairs: NDArray[np.integer]) -> Integers:
    """Return for each vertex pair, shape (k, 2), an integer that does not depend on its order."""
    p, q = pairs.astype(np.int64).reshape(-1, 2).T
    return (np.minimum(p, q) << 32) | np.maximum(p, q)


def edges_of(keys: Integers) -> list[tuple[int, int]]:
    """Edges from their `edge_keys` (k,)."""
    return [(key >> 32, key & 0xFFFFFFFF) for key in ints(keys)]


def line_of(pairs: Iterable[tuple[int, int]]) -> tuple[list[int], int]:
    """Order the vertices along distinct edges, given as pairs, and count the line's ends. The line
    starts at the smallest end, or for a loop at the smallest vertex, and stops at a branch. The
    edges form one line if there is one vertex more."""
    beside: dict[int, list[int]] = {}
    for a, b in pairs:
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    ends = sorted(vertex for vertex, others in beside.items() if len(others) == 1)
    line = ends[:1] or sorted(beside)[:1]
    while line and (onward := [one for one in beside[line[-1]] if one not in line[-2:]]):
        line.append(onward[0])
        if len(beside[line[-1]]) != 2 or line[-1] == line[0]:
            break
    return line, len(ends)


def whole_line(
    call: str, group: str, pairs: Collection[tuple[int, int]], *, closed: bool = False
) -> list[int]:
    """Order the vertices of a group of edges, which must be one line and may be `closed` if so."""
    line, ends = line_of(pairs)
    single = len(line) == len(pairs) + 1
    if not single or (ends != 2 and not closed):
        what = "closed" if single else f"not a single line: it branches or has gaps ({ends} ends)"
        like = "one line" if closed else "one open line"
        raise PathError(f"{call}: the group of edges {group!r} is {what}; pass {like}.")
    return line


@dataclass(frozen=True)
class EdgeTable:
    """Edges of a triangulation; side 3 c + k runs from vertex k of cell c to the next one."""

    keys: Integers  # sorted `edge_keys` of the edges, shape (e,)
    vertices: Integers  # their vertices, the smaller one first, shape (e, 2)
    counts: NDArray[np.intp]  # number of cells on each edge, shape (e,)
    ascending: Booleans  # whether a side runs from its smaller to its larger vertex, shape (3 m,)
    order: NDArray[np.intp]  # sides sorted by edge, shape (3 m,)

    @classmethod
    def of(cls, cells: Integers) -> EdgeTable:
        """Build the table of cells, shape (m, 3)."""
        sides = cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        side_keys = edge_keys(sides)
        order = np.argsort(side_keys, kind="stable")
        sorted_keys = side_keys[order]
        first = np.flatnonzero(np.diff(sorted_keys, prepend=-1))  # of each edge's sides
        keys, counts = sorted_keys[first], np.diff(first, append=len(order))
        vertices = np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1)
        return cls(keys, vertices, counts, sides[:, 0] < sides[:, 1], order)

    def linked_sides(self, edges: Booleans) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of sides that link all cells at each marked edge (e,)."""
        before_last = np.repeat(edges, self.counts)
        before_last[np.cumsum(self.counts) - 1] = False
        at = np.flatnonzero(before_last)
        return self.order[at], self.order[at + 1]

    def seam_links(self) -> Integers:
        """Pairs of cells (k, 2) that link all cells of each seam."""
        return np.stack(self.linked_sides(self.counts > 2), axis=1) // 3


def hidden_cells(points: Array, cells: Integers, piece: Integers) -> Integers:
    """Sorted cells of the pieces (m,) that lie behind a seam, where no cable can reach them."""
    table = EdgeTable.of(cells)
    on_seam = np.repeat(table.counts > 2, table.counts)
    sides = table.order[on_seam]
    if not len(sides):
        return np.zeros(0, dtype=np.int64)
    edge = np.repeat(np.arange(len(table.counts)), table.counts)[on_seam]
    first = np.searchsorted(edge, edge)  # first side at the same edge
    low, high = points[table.vertices[edge]].transpose(1, 0, 2)
    axis = (high - low) / np.linalg.norm(high - low, axis=1)[:, None]
    ray = points[cells[sides // 3, (sides + 2) % 3]] - low
    ray -= np.sum(ray * axis, axis=1)[:, None] * axis
    across = np.cross(axis, ray[first])
    angle = np.arctan2(np.sum(ray * across, axis=1), np.sum(ray * ray[first], axis=1))
    # The outer side of a cell that runs along the axis faces growing angles.
    order = np.lexsort((angle, edge))
    sides, along = sides[order], table.ascending[sides[order]]
    count = table.counts[edge]
    place = np.arange(len(edge)) - first
    after = first + (place + 1) % count
    before = first + (place - 1) % count
    passed = np.where(along, ~along[after], along[before])
    behind = np.unique(piece[sides[~passed] // 3])
    return np.flatnonzero(np.isin(piece, behind))
