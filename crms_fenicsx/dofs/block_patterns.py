"""Places of the (3, 3) blocks that elements add to a stiffness: of all unknowns, or of clusters."""

from __future__ import annotations

from typing import Protocol

import numba
import numpy as np
from dolfinx import fem

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.runtime.arrays import Array, Indices, Integers


class BlockSink(Protocol):
    """A stiffness that blocks are added to."""

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
        self.values: Array = np.zeros((len(rows), 3, 3))

    def add(self, A: BlockSink) -> None:
        """Add what `values` holds."""
        A.take(self)


@numba.njit(cache=True)
def scatter_blocks(values, sources, weights, starts, strides, out):  # type: ignore[no-untyped-def]
    """Add blocks (n, 3, 3) times their weights to rows of numbers. Block ``sources[k]`` goes to
    ``starts[k]``, its three rows ``strides[k]`` apart."""
    for k in range(len(sources)):
        v, w, start = values[sources[k]], weights[k], starts[k]
        for i in range(3):
            for j in range(3):
                out[start + i * strides[k] + j] += w * v[i, j]


class FormPattern(BlockPattern):
    """Blocks of vertices that a bilinear form of DOLFINx makes. It is for one layout after the
    other: those of the cables' points beside the vertices differ."""

    def __init__(self, form: fem.Form, V: fem.FunctionSpace) -> None:
        self._form, self._matrix = form, fem.create_matrix(form)
        rows = np.repeat(np.arange(len(self._matrix.indptr) - 1), np.diff(self._matrix.indptr))
        cols = np.array(self._matrix.indices[: len(rows)])
        # There are places of other ranks' cells, too, which this one leaves empty.
        cells = V.dofmap.list[: V.mesh.topology.index_map(2).size_local].astype(np.int64)
        size = int(cols.max(initial=0)) + 1
        own = cells[:, :, None] * size + cells[:, None, :]
        self._known = np.flatnonzero(np.isin(rows * size + cols, own))
        self._rows, self._cols = rows[self._known], cols[self._known]

    def attach(self, unknowns: Unknowns) -> None:
        """Number the vertices as in a layout."""
        blocks = unknowns.vertex_blocks()
        self.rows, self.cols = blocks[self._rows], blocks[self._cols]

    def add(self, A: BlockSink) -> None:
        """Add the form at the current state of its functions."""
        self._matrix.data[:] = 0.0
        fem.assemble_matrix(self._matrix, self._form)  # type: ignore[arg-type]
        self.values = np.asarray(self._matrix.data).reshape(-1, 3, 3)[self._known]
        super().add(A)


class SegmentPattern(BlockPattern):
    """Blocks of segments (n, 2): plus their value on the diagonal, minus off it."""

    def __init__(self, segments: Indices) -> None:
        a, b = segments[:, 0], segments[:, 1]
        super().__init__(np.concatenate([a, b, a, b]), np.concatenate([a, b, b, a]))
        self.own_values = np.zeros((len(segments), 3, 3))
        """Value of each segment."""

    def add(self, A: BlockSink) -> None:
        """Add what `own_values` holds."""
        values = self.values.reshape(4, *self.own_values.shape)
        values[:2] = self.own_values
        np.negative(self.own_values, out=values[2:])
        super().add(A)


class ElementPattern(BlockPattern):
    """Dense blocks of elements whose blocks are listed in CSR form (pointers, blocks)."""

    def __init__(self, pointers: Indices, blocks: Indices) -> None:
        self.offsets = np.append(0, np.cumsum(np.diff(pointers) ** 2)).astype(np.int64)
        super().__init__(*_pairs(pointers, blocks, self.offsets[-1]))


@numba.njit(cache=True)
def _pairs(pointers, blocks, size):  # type: ignore[no-untyped-def]
    """Rows and columns of the dense blocks of elements in CSR form, by rows."""
    rows, cols, n = np.empty(size, np.int32), np.empty(size, np.int32), 0
    for e in range(len(pointers) - 1):
        for i in range(pointers[e], pointers[e + 1]):
            for j in range(pointers[e], pointers[e + 1]):
                rows[n], cols[n] = blocks[i], blocks[j]
                n += 1
    return rows, cols


class ColumnPattern:
    """Columns c of dyads c c^T, at fixed places: c has entries at some blocks.

    Attributes: `values` (n, 3): the entries. Shapes: columns, blocks (n,).
    """

    def __init__(self, columns: Integers, blocks: Indices) -> None:
        self.columns, self.blocks = columns, blocks
        self.values: Array = np.zeros((len(blocks), 3))
