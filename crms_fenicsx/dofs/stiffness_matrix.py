"""The sparse stiffness of a layout, which terms add blocks of three to.

Many elements give something to the same block. Where in the matrix each of theirs goes is found
once for a layout; then all are added up in the matrix's own values. On several processes these are
those of a local matrix with the rows of ghosts, which PETSc adds to their owners' rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.block_patterns import BlockPattern, scatter_blocks, unique_pairs
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers

Places = tuple[Indices, Array, Integers, Integers]
"""Blocks of a pattern, what part of each counts, where it begins among the matrix's values, and how
far apart its rows are there."""


class StiffnessMatrix:
    """Sparse matrix of all blocks of a layout, or of the vertices alone. Collective.

    Attributes: `petsc`: the matrix, complete from `assemble` on.
    """

    def __init__(
        self, unknowns: Unknowns, patterns: Sequence[BlockPattern], of_vertices: bool = False
    ) -> None:
        self.unknowns = unknowns
        numbers = unknowns.vertex_numbers() if of_vertices else unknowns.numbers()
        self._kept: Booleans = numbers >= 0
        owned = np.arange(unknowns.n_vertices if of_vertices else unknowns.n_owned)
        found = [self._spread(pattern) for pattern in patterns]
        rows, cols = (np.concatenate([owned, *(part[0][k] for part in found)]) for k in (0, 1))
        self._rows, self._cols, block = unique_pairs(rows, cols, unknowns.n_local)
        first = np.searchsorted(self._rows, np.arange(unknowns.n_local + 1))
        width = np.diff(first)[self._rows]
        self._strides = 3 * width
        self._starts = 9 * first[self._rows] + 3 * (np.arange(len(width)) - first[self._rows])
        self._values = np.zeros(9 * len(width))
        self._places: dict[BlockPattern, Places] = {}
        start = len(owned)
        for pattern, (_, sources, weights) in zip(patterns, found, strict=True):
            own = block[start : start + len(sources)]
            self._places[pattern] = sources, weights, self._starts[own], self._strides[own]
            start += len(sources)
        sliding = np.zeros(unknowns.n_local, dtype=bool)
        sliding[unknowns.edge_sliders] = True
        self._sliding = np.flatnonzero(sliding[self._rows] | sliding[self._cols])
        self.petsc = self._create(numbers, len(owned), 3 * np.diff(first))

    def _create(self, numbers: Integers, n_owned: int, widths: Integers) -> PETSc.Mat:
        """The matrix, and on one process its memory: the values are its own."""
        unknowns = self.unknowns
        self._pointers = np.append(0, np.cumsum(np.repeat(widths, 3))).astype(PETSc.IntType)
        self._columns = np.empty(len(self._values), dtype=PETSc.IntType)
        _expand(self._cols, self._starts, self._strides, self._columns)
        if unknowns.comm.size == 1:
            n = 3 * n_owned
            csr = (self._pointers[: n + 1], self._columns, self._values)
            A = PETSc.Mat().createAIJWithArrays((n, n), csr, comm=unknowns.comm)
            A.setBlockSize(3)
        else:
            A = PETSc.Mat().create(unknowns.comm)
            A.setSizes(((3 * n_owned, 3 * unknowns.comm.allreduce(n_owned)),) * 2)
            A.setBlockSize(3)
            A.setType(PETSc.Mat.Type.AIJ)
        lgmap = PETSc.LGMap().create(numbers.astype(PETSc.IntType), bsize=3, comm=unknowns.comm)
        A.setLGMap(lgmap, lgmap)
        lgmap.destroy()
        if unknowns.comm.size > 1:
            self._allocate(A, n_owned)
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return A

    def _allocate(self, A: PETSc.Mat, n_owned: int) -> None:
        """Give a matrix on several processes its memory."""
        n = self.unknowns.n_owned
        vector, counts = self.unknowns.vector()
        # Columns: all blocks, and those that may belong to another rank.
        counts[:, 0] = np.bincount(self._rows, minlength=len(counts))
        elsewhere = (self._rows >= n) | (self._cols >= n)
        counts[:, 1] = np.bincount(self._rows, weights=elsewhere, minlength=len(counts))
        self.unknowns.add_ghosts(vector)
        own, others = counts[:n_owned, :2].astype(PETSc.IntType).T
        all_blocks = A.getSize()[0] // 3
        own, others = np.minimum(own, n_owned), np.minimum(others, all_blocks - n_owned)
        A.setPreallocationNNZ((np.repeat(3 * own, 3), np.repeat(3 * others, 3)))
        # PETSc does this by itself, but not on ranks without rows, which would hang the others.
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        vector.destroy()
        self._all_rows = np.arange(len(self._pointers) - 1, dtype=PETSc.IntType)

    def destroy(self) -> None:
        """Free the PETSc matrix."""
        self.petsc.destroy()

    def clear(self) -> None:
        """Set all entries to zero."""
        self._values[:] = 0.0

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's values. Points that ride on vertices hand their part on to them."""
        if pattern not in self._places:
            self._places[pattern] = self._find(pattern)
        scatter_blocks(pattern.values, *self._places[pattern], self._values)

    def _spread(self, pattern: BlockPattern) -> tuple[Indices, Indices, Array]:
        """Places (2, m), sources and weights of a pattern's blocks in this matrix."""
        places, sources, weights = self.unknowns.spread(pattern.rows, pattern.cols)
        kept = self._kept[places].all(axis=0)
        if kept.all():
            return places, sources, weights
        return places[:, kept], sources[kept], weights[kept]

    def _find(self, pattern: BlockPattern) -> Places:
        """Where a pattern's blocks go that has not been named, all of which others have filled."""
        (rows, cols), sources, weights = self._spread(pattern)
        size = self.unknowns.n_local
        keys, wanted = self._rows * size + self._cols, rows.astype(np.int64) * size + cols
        block = np.searchsorted(keys, wanted)
        assert np.array_equal(keys[np.minimum(block, len(keys) - 1)], wanted)
        return sources, weights, self._starts[block], self._strides[block]

    def assemble(self) -> None:
        """Complete the matrix with what has been added. Of edge sliders the part along their lines
        counts. Collective."""
        if len(self._sliding):
            self._project()
        if self.unknowns.comm.size == 1:
            self.petsc.stateIncrease()
        else:
            self.petsc.zeroEntries()
            self.petsc.setValuesLocalIJV(
                self._pointers, self._columns, self._values, PETSc.InsertMode.ADD, self._all_rows
            )
        self.petsc.assemble()

    def _project(self) -> None:
        """Project the blocks of edge sliders."""
        own = self._sliding
        at = self._starts[own][:, None, None] + np.arange(3)
        at = at + np.arange(3)[:, None] * self._strides[own][:, None, None]
        blocks = self._values[at]
        self._values[at] = self.unknowns.project_blocks(self._rows[own], self._cols[own], blocks)


@numba.njit(cache=True)
def _expand(cols, starts, strides, columns):  # type: ignore[no-untyped-def]
    """Columns of the entries of blocks (n,)."""
    for k in range(len(cols)):
        for i in range(3):
            for j in range(3):
                columns[starts[k] + i * strides[k] + j] = 3 * cols[k] + j
