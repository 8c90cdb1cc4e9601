"""Add (3, 3) blocks of cable elements to the global stiffness: pairs, row sizes, insertion.

Many elements give something to the same block, and petsc4py hands over blocks one by one. So those
of equal place are summed first, and handed over in whole rows; which those are is found once for a
layout.

If it does not it collects the places of the first values in a hash table, which takes five times as
long as an assembly.
"""

from __future__ import annotations

from typing import Protocol

import numba
import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.runtime.arrays import Array, Indices, Integers


def unique_pairs(rows: Indices, cols: Indices, size: int) -> tuple[Integers, Integers, Integers]:
    """Sort pairs of numbers (n,) from 0 to `size` - 1 by rows, then by columns. By counting, as
    there are many more pairs than numbers: several times as fast as `np.unique`. Returns rows,
    cols: the m different pairs; place (n,): which of them each pair is."""
    found: tuple[Integers, Integers, Integers] = _unique_pairs(
        rows.astype(np.int64), cols.astype(np.int64), np.arange(len(rows)), size
    )
    return found


@numba.njit(cache=True)
def _by(keys, order, size):  # type: ignore[no-untyped-def]
    """The pairs in `order` sorted by keys (n,), those with equal keys left in their order."""
    starts = np.zeros(size + 1, dtype=np.int64)
    for n in range(len(keys)):
        starts[keys[n] + 1] += 1
    for k in range(size):
        starts[k + 1] += starts[k]
    found = np.empty(len(order), dtype=np.int64)
    for n in order:
        found[starts[keys[n]]] = n
        starts[keys[n]] += 1
    return found


@numba.njit(cache=True)
def _unique_pairs(rows, cols, every, size):  # type: ignore[no-untyped-def]
    """As `unique_pairs`; `every` are the numbers 0 ... n - 1."""
    order = _by(rows, _by(cols, every, size), size)
    place = np.empty(len(rows), dtype=np.int64)
    m = 0
    for i in range(len(order)):
        n, before = order[i], order[i - 1]
        m += i == 0 or rows[n] != rows[before] or cols[n] != cols[before]
        place[n] = m - 1
    found = np.empty((2, m), dtype=np.int64)
    for n in range(len(rows)):
        found[0, place[n]], found[1, place[n]] = rows[n], cols[n]
    return found[0], found[1], place


class RowSizes:
    """Upper bounds of the number of blocks in each row of the stiffness, diagonal included."""

    def __init__(self, unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        self._vector, self._counts = unknowns.vector()
        # Columns: all blocks, and those that may belong to another rank.
        self._counts[: unknowns.n_owned, 0] = 1.0

    def add(self, rows: Indices, cols: Indices) -> None:
        """Count blocks of one term beside the diagonal, each once. Shapes: rows, cols (n,)."""
        n = self.unknowns.n_owned
        beside = rows != cols
        rows, elsewhere = rows[beside], ((rows >= n) | (cols >= n))[beside]
        size = self.unknowns.n_local
        self._counts[:, 0] += np.bincount(rows, minlength=size)
        self._counts[:, 1] += np.bincount(rows, weights=elsewhere, minlength=size)

    def allocate(self, A: PETSc.Mat) -> None:
        """Give a matrix of all blocks, or of the vertices, its memory. Collective, and the last
        call."""
        self.unknowns.add_ghosts(self._vector)
        rows, all_rows = (size // 3 for size in A.getSizes()[0])
        own, others = self._counts[:rows, :2].astype(PETSc.IntType).T
        own = np.minimum(own, rows)
        others = np.minimum(others, all_rows - rows)
        A.setPreallocationNNZ((np.repeat(3 * own, 3), np.repeat(3 * others, 3)))
        # PETSc does this by itself, but not on ranks without rows, which would hang the others.
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        self._vector.destroy()


class BlockSink(Protocol):
    """What takes blocks in the place of a PETSc matrix."""

    def take(self, pattern: BlockPattern) -> None:
        """Add what a pattern's `values` hold."""


def rows_of(table: Indices) -> tuple[Indices, Indices]:
    """Rows of a table (n, k) in CSR form: pointers, entries."""
    n, k = table.shape
    return np.arange(0, k * n + 1, k, dtype=np.int32), table.reshape(-1)


class BlockPattern:
    """Blocks at fixed places.

    Attributes: `values` (n, 3, 3): what `add` adds there. Shapes: rows, cols (n,).
    """

    def __init__(self, rows: Indices, cols: Indices) -> None:
        self.rows, self.cols = rows, cols
        self.values = np.zeros((len(rows), 3, 3))
        self._unknowns: Unknowns | None = None

    def _arrange(self, unknowns: Unknowns) -> None:
        """Find which blocks have the same place, in the matrix's numbers."""
        self._unknowns = unknowns
        self._places, self._sources, self._weights = unknowns.spread(self.rows, self.cols)
        rows, cols = unknowns.matrix_numbers[self._places]
        rows, cols, block = unique_pairs(rows, cols, unknowns.n_local)
        self._numbers = np.stack([rows, cols])
        starts, strides = np.empty((2, len(cols)), dtype=np.int64)
        self._cols = np.empty(9 * len(cols), dtype=PETSc.IntType)
        _arrange_rows(rows, cols, self._cols, starts, strides)
        # A row of m blocks becomes three rows of 3 m numbers, handed over one after the other.
        first = np.flatnonzero(np.diff(rows, prepend=-1))
        self._rows = (3 * rows[first, None] + np.arange(3)).ravel().astype(PETSc.IntType)
        sizes = np.repeat(strides[first], 3)
        self._pointers = np.append(0, np.cumsum(sizes)).astype(PETSc.IntType)
        self._row_values = np.zeros(9 * len(cols))
        self._starts, self._strides = starts[block], strides[block]

    def count(self, sizes: RowSizes, known: int = 0) -> None:
        """Count the blocks that `add` fills, but those among the first `known` of matrices."""
        if self._unknowns is not sizes.unknowns:
            self._arrange(sizes.unknowns)
        new = (self._numbers >= known).any(axis=0)
        sizes.add(*sizes.unknowns.matrix_order()[self._numbers[:, new]])

    def add(self, A: PETSc.Mat | BlockSink, unknowns: Unknowns) -> None:
        """Add what `values` holds. Points that ride on vertices hand their part on to them; of edge
        sliders the part along their lines counts."""
        if not isinstance(A, PETSc.Mat):
            A.take(self)
            return
        if self._unknowns is not unknowns:
            self._arrange(unknowns)
        if len(self._places[0]) == 0:
            return
        values: Array = self.values
        sources, weights = self._sources, self._weights
        if unknowns.n_edge_sliders:
            rows, cols = self._places
            values = weights[:, None, None] * values[sources]
            values = unknowns.project_blocks(rows, cols, values)
            sources, weights = np.arange(len(values), dtype=np.int32), np.ones(len(values))
        _sum_blocks(values, sources, weights, self._starts, self._strides, self._row_values)
        A.setValuesLocalIJV(
            self._pointers, self._cols, self._row_values, PETSc.InsertMode.ADD, self._rows
        )


@numba.njit(cache=True)
def _arrange_rows(rows, cols, numbers, starts, strides):  # type: ignore[no-untyped-def]
    """Where sorted blocks (n,) begin in rows of numbers, the step from each of their three rows to
    the next, and the numbers of the columns there (9 n,)."""
    first = 0
    while first < len(rows):
        last = first
        while last < len(rows) and rows[last] == rows[first]:
            last += 1
        for k in range(first, last):
            starts[k], strides[k] = 9 * first + 3 * (k - first), 3 * (last - first)
            for i in range(3):
                for j in range(3):
                    numbers[starts[k] + i * strides[k] + j] = 3 * cols[k] + j
        first = last


@numba.njit(cache=True)
def _sum_blocks(values, sources, weights, starts, strides, out):  # type: ignore[no-untyped-def]
    """Add up blocks (n, 3, 3) times their weights in rows of numbers. Block ``sources[k]`` goes to
    ``starts[k]``, its three rows ``strides[k]`` apart."""
    out[:] = 0.0
    for k in range(len(sources)):
        v, w, start = values[sources[k]], weights[k], starts[k]
        for i in range(3):
            for j in range(3):
                out[start + i * strides[k] + j] += w * v[i, j]


class SegmentPattern(BlockPattern):
    """Blocks of segments (n, 2): plus their value on the diagonal, minus off it."""

    def __init__(self, segments: Indices) -> None:
        a, b = segments[:, 0], segments[:, 1]
        super().__init__(np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a]))
        self.own_values = np.zeros((len(segments), 3, 3))
        """Value of each segment."""

    def add(self, A: PETSc.Mat | BlockSink, unknowns: Unknowns) -> None:
        """Add what `own_values` holds."""
        v = self.own_values
        np.concatenate([v, v, -v, -v], out=self.values)
        super().add(A, unknowns)


class ElementPattern(BlockPattern):
    """Dense blocks of elements whose blocks are listed in CSR form (pointers, blocks)."""

    def __init__(self, pointers: Indices, blocks: Indices) -> None:
        sizes = np.diff(pointers)
        self.offsets = np.concatenate([[0], np.cumsum(sizes**2)]).astype(np.int64)
        element = np.repeat(np.arange(len(sizes)), sizes**2)
        place = np.arange(self.offsets[-1]) - self.offsets[element]
        row, col = np.divmod(place, sizes[element])
        first = np.asarray(pointers)[element]
        self.entries = first + row, first + col
        """Rows of `blocks` that each of the values belongs to."""
        super().__init__(blocks[first + row], blocks[first + col])
