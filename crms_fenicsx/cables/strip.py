"""The strip of cells around the cables, known to all ranks.

Its size is that of the cables, not of the mesh: each rank selects among its own cells, and only
those are gathered. It grows as cables slide.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from crms_fenicsx.cables.simplices import Simplices
from crms_fenicsx.runtime.arrays import Integers
from crms_fenicsx.surface.points import Edge


@dataclass(frozen=True)
class Strip:
    """Cells with the ids of their vertices, their owners and their numbers there."""

    # (n, 3) vertex ids (numbers in the mesh as it was given), each cell's in its own order; the
    # cells as `ascending` orders them, so that sums over cells round alike on any number of ranks
    cells: Integers
    owner: Integers  # owner, local: (n,) owning rank and the cell's local number on it
    local: Integers
    complete: frozenset[int] = frozenset()  # ids of the vertices all of whose cells are here
    # edges (a, b), a < b, of these cells that are held over their whole length
    held_edges: frozenset[tuple[int, int]] = frozenset()
    # cells (a, b, c), a < b < c, behind a seam: cables fold them at the seam, but do not lie on
    # them
    hidden: frozenset[tuple[int, int, int]] = frozenset()

    @cached_property
    def around(self) -> dict[tuple[int, ...], list[int]]:
        """Rows of the cells around each vertex (a,), edge (a, b) and cell (a, b, c), sorted."""
        return _around(self.corners, frozenset())

    @cached_property
    def outer_around(self) -> dict[tuple[int, ...], list[int]]:
        """`around`, without the cells behind seams."""
        return _around(self.corners, self.hidden) if self.hidden else self.around

    @cached_property
    def outer_cells(self) -> Integers:
        """`cells`, without those behind seams, (n, 3)."""
        if not self.hidden:
            return self.cells
        return self.cells[[tuple(sorted(cell)) not in self.hidden for cell in self.corners]]

    @cached_property
    def simplices(self) -> Simplices:
        """The vertices, edges and cells by number, with the cells around them."""
        return Simplices(self.cells, self.owner)

    @cached_property
    def corners(self) -> list[list[int]]:
        """`cells` as lists of numbers, which loops read faster."""
        return [[int(vertex) for vertex in cell] for cell in self.cells]

    @cached_property
    def owners(self) -> list[int]:
        """`owner` as a list of numbers."""
        return [int(rank) for rank in self.owner]

    @cached_property
    def sides(self) -> list[list[tuple[Edge, bool]]]:
        """Sides of each cell: the ids ascending, and whether that is the cell's own direction."""
        return [
            [((a, b), True) if a < b else ((b, a), False) for a, b in pairwise((*cell, cell[0]))]
            for cell in self.corners
        ]

    @cached_property
    def vertices(self) -> Integers:
        """Ids of all vertices, ascending, (k,)."""
        return np.unique(self.cells)

    @cached_property
    def givers(self) -> Integers:
        """Where each of `vertices` is in the flat `cells`: in a cell of the lowest rank, (k,)."""
        order = np.argsort(np.repeat(self.owner, 3), kind="stable")
        _, first = np.unique(self.cells.ravel()[order], return_index=True)
        return order[first]

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Place of each vertex in `vertices`."""
        return {int(vertex): row for row, vertex in enumerate(self.vertices)}

    def rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells that hold all these vertices."""
        return _rows(self.around, vertices)

    def outer_rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells that hold all these vertices and that cables can lie on."""
        return _rows(self.outer_around, vertices)

    def owner_of(self, vertices: tuple[int, ...]) -> int:
        """The rank that owns what lies on these vertices: the lowest one with a cell there."""
        if vertices not in self._owner_of:
            self._owner_of[vertices] = min(self.owners[row] for row in self.rows(vertices))
        return self._owner_of[vertices]

    @cached_property
    def _owner_of(self) -> dict[tuple[int, ...], int]:
        """What `owner_of` has found."""
        return {}

    def merged(self, other: Strip) -> Strip:
        """Cells of both."""
        cells = np.concatenate([self.cells, other.cells])
        rows = ascending(cells)
        repeated = (np.diff(np.sort(cells[rows], axis=1), axis=0) == 0).all(axis=1)
        rows = rows[np.concatenate([[True], ~repeated])] if len(rows) else rows
        return Strip(
            cells[rows],
            np.concatenate([self.owner, other.owner])[rows],
            np.concatenate([self.local, other.local])[rows],
            self.complete | other.complete,
            self.held_edges | other.held_edges,
            self.hidden | other.hidden,
        )


def ascending(cells: Integers) -> Integers:
    """Rows of the cells (n, 3) by their lowest vertex ids, then by their middle ones, and so on."""
    low, middle, high = np.sort(cells, axis=1).T
    return np.lexsort((high, middle, low))


def _around(
    cells: list[list[int]], but: frozenset[tuple[int, int, int]]
) -> dict[tuple[int, ...], list[int]]:
    """Rows of the cells around each vertex, edge and cell, without some cells."""
    table: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for row, cell in enumerate(cells):
        a, b, c = sorted(cell)
        if (a, b, c) not in but:
            for key in ((a,), (b,), (c,), (a, b), (a, c), (b, c), (a, b, c)):
                table[key].append(row)
    return dict(table)


def _rows(around: dict[tuple[int, ...], list[int]], vertices: tuple[int, ...]) -> list[int]:
    """What is at vertices in any order, also repeated; most often they are in order."""
    found = around.get(vertices)
    return around.get(tuple(sorted(set(vertices))), []) if found is None else found


EMPTY = Strip(np.zeros((0, 3), dtype=np.int64), *(np.zeros(0, dtype=np.int64),) * 2)
