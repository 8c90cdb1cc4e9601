"""The sparse stiffness matrix of a layout, and the (3, 3) element blocks it is assembled from.

Many elements contribute to the same block. The position of each contribution is computed once per
layout; assembly then adds to the matrix's value array. As the stiffness is symmetric, only blocks
on and above the diagonal are added, and mirrored in the end. On several processes the array belongs
to a local matrix with ghost rows, which PETSc adds to their owners' rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numba
import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


class BlockSink(Protocol):
    """A stiffness matrix that element blocks are added to."""

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's `values`."""


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


Places = tuple[Indices, Array, Indices, Indices]
"""Of a pattern: indices of its values, weights, positions in the matrix, row strides there."""


class StiffnessMatrix:
    """Sparse matrix of all blocks of a layout. Collective.

    Attributes: `petsc`: the matrix, complete after `assemble`.
    """

    def __init__(self, unknowns: Unknowns, patterns: Sequence[BlockPattern]) -> None:
        self.unknowns = unknowns
        owned = np.arange(unknowns.n_owned, dtype=np.int32)
        self._rides = np.full(unknowns.n_local, -1, dtype=np.int32)
        self._rides[unknowns.tied_points] = np.arange(unknowns.n_tied_points)
        found = [self._spread(pattern) for pattern in patterns]
        rows, cols = (np.concatenate([owned, *(part[k] for part in found)]) for k in (0, 1))
        first, self._rows, self._cols, block = distinct_pairs(rows, cols, unknowns.n_local)
        begins, starts, strides = _mirrored(first, self._rows, self._cols)
        # (2, n): of the blocks and of their mirror images
        self._starts, self._strides = starts.astype(PETSc.IntType), strides.astype(PETSc.IntType)
        self._values = np.zeros(9 * begins[-1])
        self._places: dict[BlockPattern, Places] = {}
        start = len(owned)
        for pattern, (_, _, sources, weights) in zip(patterns, found, strict=True):
            own = block[start : start + len(sources)]
            self._places[pattern] = sources, weights, self._starts[0, own], self._strides[0, own]
            start += len(sources)
        sliding = np.zeros(unknowns.n_local, dtype=bool)
        sliding[unknowns.sliders] = True
        self._sliding = np.flatnonzero(sliding[self._rows] | sliding[self._cols])
        self.petsc = self._create(3 * np.diff(begins))

    def _create(self, widths: Integers) -> PETSc.Mat:
        """Create the PETSc matrix; on one process it uses `_values` as its memory."""
        unknowns, n = self.unknowns, 3 * self.unknowns.n_owned
        self._pointers = np.append(0, np.cumsum(np.repeat(widths, 3))).astype(PETSc.IntType)
        self._columns = np.empty(len(self._values), dtype=PETSc.IntType)
        _expand(self._cols, self._starts[0], self._strides[0], self._columns)
        _expand(self._rows, self._starts[1], self._strides[1], self._columns)
        if unknowns.comm.size == 1:
            csr = (self._pointers[: n + 1], self._columns, self._values)
            A = PETSc.Mat().createAIJWithArrays((n, n), csr, comm=unknowns.comm)
            A.setBlockSize(3)
        else:
            A = PETSc.Mat().create(unknowns.comm)
            A.setSizes(((n, 3 * unknowns.n_global),) * 2)
            A.setBlockSize(3)
            A.setType(PETSc.Mat.Type.AIJ)
        numbers = unknowns.numbers().astype(PETSc.IntType)
        lgmap = PETSc.LGMap().create(numbers, bsize=3, comm=unknowns.comm)
        A.setLGMap(lgmap, lgmap)
        lgmap.destroy()
        if unknowns.comm.size > 1:
            self._allocate(A)
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return A

    def _allocate(self, A: PETSc.Mat) -> None:
        """Preallocate a matrix on several processes."""
        n = self.unknowns.n_owned
        vector, counts = self.unknowns.vector()
        # Columns: number of blocks in each row, and of those that may belong to another rank.
        counts[:, 0] = np.diff(self._pointers[::3]) // 9
        rows, cols = self._rows, self._cols
        foreign = cols >= n
        counts[:, 1] = np.bincount(rows, foreign, len(counts))
        counts[:, 1] += np.bincount(cols, foreign & (rows != cols), len(counts))
        self.unknowns.add_ghosts(vector)
        own, others = counts[:n, :2].astype(PETSc.IntType).T
        own, others = np.minimum(own, n), np.minimum(others, self.unknowns.n_global - n)
        A.setPreallocationNNZ((np.repeat(3 * own, 3), np.repeat(3 * others, 3)))
        # PETSc does this by itself, but not on ranks without rows, which would hang the others.
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        vector.destroy()
        self._all_rows = np.arange(len(self._pointers) - 1, dtype=PETSc.IntType)

    def destroy(self) -> None:
        self.petsc.destroy()

    def clear(self) -> None:
        self._values[:] = 0.0

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's values; tied points pass theirs on to their vertices."""
        scatter_blocks(pattern.values, *self._places[pattern], self._values)

    def _spread(self, pattern: BlockPattern) -> tuple[Indices, Indices, Indices, Array]:
        """Rows and columns (m,) of a pattern's blocks in this matrix, their values and weights."""
        unknowns = self.unknowns
        rows, cols, blocks, weights = _spread(
            pattern.rows, pattern.cols, self._rides, unknowns.interpolation, unknowns.weights
        )  # fmt: skip
        return rows, cols, *pattern.parts(blocks, weights)

    def assemble(self) -> None:
        """Assemble the matrix, with the sliders' blocks projected. Collective."""
        if len(self._sliding):
            self._project()
        _mirror(self._starts, self._strides, self._values)
        if self.unknowns.comm.size == 1:
            self.petsc.stateIncrease()
        else:
            self.petsc.zeroEntries()
            self.petsc.setValuesLocalIJV(
                self._pointers, self._columns, self._values, PETSc.InsertMode.ADD, self._all_rows
            )
        self.petsc.assemble()

    def _project(self) -> None:
        """Project the sliders' blocks."""
        own = self._sliding
        at = self._starts[0, own][:, None, None] + np.arange(3)
        at = at + np.arange(3)[:, None] * self._strides[0, own][:, None, None]
        blocks = self._values[at]
        self._values[at] = self.unknowns.project_blocks(self._rows[own], self._cols[own], blocks)


@numba.njit(cache=True)
def _expand(cols, starts, strides, columns):  # type: ignore[no-untyped-def]
    """Column numbers of the entries of blocks (n,)."""
    for k in range(len(cols)):
        for i in range(3):
            for j in range(3):
                columns[starts[k] + i * strides[k] + j] = 3 * cols[k] + j


@numba.njit(cache=True)
def _spread(rows, cols, rides, interpolation, weights):  # type: ignore[no-untyped-def]
    """`LocalBlocks.spread` for the blocks on and above the diagonal; `rides`: indices of tied
    points, or -1."""
    m = 0
    for k in range(len(rows)):
        tied = (rides[rows[k]] >= 0) + (rides[cols[k]] >= 0)
        m += 1 if tied == 0 else 3 if tied == 1 else 9
    places, sources = np.empty((2, m), dtype=np.int32), np.empty(m, dtype=np.int32)
    shares = np.empty(m)
    m = 0
    for k in range(len(rows)):
        a, b = rides[rows[k]], rides[cols[k]]
        for i in range(1 if a < 0 else 3):
            for j in range(1 if b < 0 else 3):
                row, row_share = (rows[k], 1.0) if a < 0 else (interpolation[a, i], weights[a, i])
                col, col_share = (cols[k], 1.0) if b < 0 else (interpolation[b, j], weights[b, j])
                if row <= col and row_share * col_share != 0.0:
                    places[0, m], places[1, m] = row, col
                    sources[m], shares[m] = k, row_share * col_share
                    m += 1
    return places[0, :m], places[1, :m], sources[:m], shares[:m]


@numba.njit(cache=True)
def _mirrored(first, rows, cols):  # type: ignore[no-untyped-def]
    """First block of each row (size + 1,) of a symmetric matrix, whose blocks (n,) on and above the
    diagonal are given as by `distinct_pairs`; places (2, n) of these blocks and of their mirror
    images in the values, and strides (2, n) of their rows."""
    n, size = len(rows), len(first) - 1
    begins, below = np.zeros(size + 1, dtype=np.int64), np.zeros(size, dtype=np.int64)
    for k in range(n):
        below[cols[k]] += rows[k] < cols[k]
    for row in range(size):
        begins[row + 1] = begins[row] + below[row] + first[row + 1] - first[row]
    starts, strides = np.empty((2, n), dtype=np.int64), np.empty((2, n), dtype=np.int64)
    used = np.zeros(size, dtype=np.int64)
    for k in range(n):
        row, col = rows[k], cols[k]
        starts[0, k] = starts[1, k] = 9 * begins[row] + 3 * (below[row] + k - first[row])
        if row < col:
            starts[1, k] = 9 * begins[col] + 3 * used[col]
            used[col] += 1
        strides[0, k] = 3 * (begins[row + 1] - begins[row])
        strides[1, k] = 3 * (begins[col + 1] - begins[col])
    return begins, starts, strides


@numba.njit(cache=True)
def _mirror(starts, strides, values):  # type: ignore[no-untyped-def]
    """Copy the blocks above the diagonal to their mirror images."""
    for k in range(starts.shape[1]):
        if starts[0, k] != starts[1, k]:
            for i in range(3):
                for j in range(3):
                    own = starts[0, k] + i * strides[0, k] + j
                    values[starts[1, k] + j * strides[1, k] + i] = values[own]


@numba.njit(cache=True)
def distinct_pairs(rows, cols, size):  # type: ignore[no-untyped-def]
    """Sort pairs of numbers (n,) in [0, size) by rows, then columns, without duplicates. Duplicates
    are removed first, as rows have many pairs but few distinct ones. Returns the start of each row
    (size + 1,), rows and columns of the distinct pairs, and the index of each pair among them
    (n,)."""
    begins = np.zeros(size + 1, dtype=np.int64)
    for n in range(len(rows)):
        begins[rows[n] + 1] += 1
    for row in range(size):
        begins[row + 1] += begins[row]
    found, ends = np.empty(len(rows), dtype=np.int32), begins[:-1].copy()
    place = np.empty(len(rows), dtype=np.int64)
    for n in range(len(rows)):
        row, k = rows[n], begins[rows[n]]
        while k < ends[row] and found[k] != cols[n]:
            k += 1
        if k == ends[row]:
            found[k] = cols[n]
            ends[row] += 1
        place[n] = k
    first = np.zeros(size + 1, dtype=np.int64)
    first[1:] = np.cumsum(ends - begins[:-1])
    different = np.empty((2, first[size]), dtype=np.int32)
    number, order = np.empty(len(rows), dtype=np.int32), np.empty(size, dtype=np.int64)
    for row in range(size):
        start, m = begins[row], ends[row] - begins[row]
        for i in range(m):  # insertion sort
            j = i
            while j > 0 and found[start + order[j - 1]] > found[start + i]:
                order[j] = order[j - 1]
                j -= 1
            order[j] = i
        for i in range(m):
            k = start + order[i]
            number[k] = first[row] + i
            different[0, number[k]], different[1, number[k]] = row, found[k]
    for n in range(len(rows)):
        place[n] = number[place[n]]
    return first, different[0], different[1], place
