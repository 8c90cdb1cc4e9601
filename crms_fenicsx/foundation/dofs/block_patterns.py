"""Positions of the (3, 3) element blocks in a stiffness matrix: of all unknowns, or of clusters."""

from __future__ import annotations

from typing import Protocol

import numba
import numpy as np
from dolfinx import fem

from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


class BlockSink(Protocol):
    """A stiffness matrix that element blocks are added to."""

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's `values`."""


def rows_of(table: Indices) -> tuple[Indices, Indices]:
    """Rows of a table (n, k) in CSR form: pointers, entries."""
    n, k = table.shape
    return np.arange(0, k * n + 1, k, dtype=np.int32), table.reshape(-1)


class BlockPattern:
    """Blocks at fixed positions in the matrix.

    With `factors` (n, k) each value is for k blocks in a row, multiplied by these. Attributes:
    `values` (n, 3, 3): values that `add` adds. Shapes: rows, cols (n,) or (n k,).
    """

    _factors: Array | None = None

    def __init__(self, rows: Indices, cols: Indices, factors: Array | None = None) -> None:
        self.rows, self.cols, self._factors = rows, cols, factors
        self.values: Array = np.zeros((len(rows if factors is None else factors), 3, 3))

    def parts(self, blocks: Indices, weights: Array) -> tuple[Indices, Array]:
        """Indices of the values of blocks (m,), and the `weights` (m,) times their factors."""
        if self._factors is None:
            return blocks, weights
        size = self._factors.shape[1]
        return (blocks // size).astype(np.int32), weights * self._factors.reshape(-1)[blocks]

    def blocks(self) -> Array:
        """All blocks, (n, 3, 3) or (n k, 3, 3)."""
        n = len(self.rows)
        sources, factors = self.parts(np.arange(n, dtype=np.int32), np.ones(n))
        blocks: Array = factors[:, None, None] * self.values[sources]
        return blocks

    def add(self, A: BlockSink) -> None:
        A.take(self)


@numba.njit(cache=True)
def scatter_blocks(values, sources, weights, starts, strides, out):  # type: ignore[no-untyped-def]
    """Add weighted blocks (n, 3, 3) to a flat array of matrix entries: block ``sources[k]`` at
    ``starts[k]``, its three rows ``strides[k]`` apart."""
    for k in range(len(sources)):
        v, w, start = values[sources[k]], weights[k], starts[k]
        for i in range(3):
            for j in range(3):
                out[start + i * strides[k] + j] += w * v[i, j]


class FormPattern(BlockPattern):
    """Vertex blocks of a DOLFINx bilinear form. It serves successive layouts, whose vertices are
    the same but whose cable points differ.

    Attributes: `form`: the form; one over fewer cells may replace it.
    """

    def __init__(self, form: fem.Form, V: fem.FunctionSpace) -> None:
        self.form, self._matrix = form, fem.create_matrix(form)
        rows = np.repeat(np.arange(len(self._matrix.indptr) - 1), np.diff(self._matrix.indptr))
        cols = np.array(self._matrix.indices[: len(rows)])
        # The pattern includes entries of other ranks' cells, which stay zero here.
        cells = V.dofmap.list[: V.mesh.topology.index_map(2).size_local].astype(np.int64)
        size = int(cols.max(initial=0)) + 1
        own = cells[:, :, None] * size + cells[:, None, :]
        known = np.flatnonzero(np.isin(rows * size + cols, own))
        self._known = slice(None) if len(known) == len(rows) else known
        self._rows, self._cols = rows[self._known], cols[self._known]

    def attach(self, unknowns: Unknowns) -> None:
        """Use the block numbers of a layout."""
        blocks = unknowns.vertex_blocks()
        self.rows, self.cols = blocks[self._rows], blocks[self._cols]

    def add(self, A: BlockSink) -> None:
        """Assemble the form at the current state of its functions and add it."""
        self._matrix.data[:] = 0.0
        fem.assemble_matrix(self._matrix, self.form)  # type: ignore[arg-type]
        self.values = np.asarray(self._matrix.data).reshape(-1, 3, 3)[self._known]
        super().add(A)


class SegmentPattern(BlockPattern):
    """Blocks of segments (n, 2): plus their value on the diagonal, minus off it."""

    def __init__(self, segments: Indices) -> None:
        rows, cols = segments[:, [0, 1, 0, 1]], segments[:, [0, 1, 1, 0]]
        signs = np.tile([1.0, 1.0, -1.0, -1.0], (len(segments), 1))
        super().__init__(rows.ravel(), cols.ravel(), signs)


class ElementPattern(BlockPattern):
    """Dense blocks of elements whose blocks are listed in CSR form (pointers, blocks)."""

    def __init__(self, pointers: Indices, blocks: Indices) -> None:
        self.offsets = np.append(0, np.cumsum(np.diff(pointers) ** 2)).astype(np.int64)
        super().__init__(*_pairs(pointers, blocks, self.offsets[-1]))


@numba.njit(cache=True)
def _pairs(pointers, blocks, size):  # type: ignore[no-untyped-def]
    """Rows and columns of the dense blocks of elements in CSR form, row by row."""
    rows, cols, n = np.empty(size, np.int32), np.empty(size, np.int32), 0
    for e in range(len(pointers) - 1):
        for i in range(pointers[e], pointers[e + 1]):
            for j in range(pointers[e], pointers[e + 1]):
                rows[n], cols[n] = blocks[i], blocks[j]
                n += 1
    return rows, cols


class ColumnPattern:
    """Columns c of dyads c c^T, with nonzero entries at fixed blocks.

    Attributes: `values` (n, 3): entries of c. Shapes: columns, blocks (n,).
    """

    def __init__(self, columns: Integers, blocks: Indices) -> None:
        self.columns, self.blocks = columns, blocks
        self.values: Array = np.zeros((len(blocks), 3))
