"""Dyads of cables made sparse for CHOLMOD, by "stretching" their dense columns.

A column g with parts g_i at m blocks couples all of these, as a cable's length does. A tree joins
them along entries of K, and an unknown w for each of its branches counts at both ends:

    (g^T y)^2 = minimum over w of  m sum_i (g_i . y_i + sum of w that end at i - that begin at i)^2,

as the terms have the sum g^T y for any w, and are equal for some w. The matrix of y and w is nearly
as sparse as K. It is positive definite if and only if its Schur complement K + G G^T is.
"""

from __future__ import annotations

import numba
import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.stiffness_matrix import StiffnessMatrix
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers, pointers, runs

UPPER = np.triu_indices(3)
"""Rows and columns of the upper triangle of a block."""


class StretchedStiffness:
    """Stiffness of a layout on one process and dyads, as a matrix of y and w.

    Attributes: `petsc`: the matrix, with its upper triangle only, which is what CHOLMOD reads.
    """

    def __init__(self, stiffness: StiffnessMatrix) -> None:
        self._pointers, self._indices, self._values = stiffness.csr
        self._diagonal = stiffness.diagonal()
        self.petsc: PETSc.Mat | None = None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self.petsc is not None:
            for petsc in (*self._vectors, self.petsc):
                petsc.destroy()

    def assemble(self, dyads: Array, columns: Array) -> bool:
        """Assemble K and dyads (m,) of columns (n, m). Returns whether `petsc` is a new matrix, for
        columns with entries at other blocks."""
        g = columns.T.reshape(len(dyads), len(columns) // 3, 3)
        used = g != 0.0
        new = self.petsc is None or len(g) != len(self._counts)
        new = new or np.count_nonzero(used) != np.count_nonzero(used[self._column, self._block])
        if new:
            self.destroy()
            self._create(used[:, :, 0] | used[:, :, 1] | used[:, :, 2])
        assert self.petsc is not None
        sizes = np.sqrt(self._counts * dyads)[self._column]
        parts = sizes[:, None] * g[self._column, self._block]
        copy_upper(self._pointers, self._diagonal, self._values, self._starts, self._stretched)
        squares = parts[:, UPPER[0]] * parts[:, UPPER[1]]
        np.add.at(self._stretched, self._squares, squares.ravel())  # slower on two axes
        self._stretched[self._border] = self._signs[:, None] * parts[self._of]
        self.petsc.stateIncrease()
        return new

    def _create(self, used: Booleans) -> None:
        """Create the matrix for columns with entries at the `used` blocks, (m, n_blocks)."""
        self._counts, (self._column, self._block) = used.sum(axis=1), np.nonzero(used)
        before = tree(self._pointers, self._indices, pointers(self._counts), self._block)
        (after,) = np.nonzero(before >= 0)
        n, m = len(self._pointers) - 1, len(after)
        # Both ends of each branch, sorted by the columns' entries that it joins.
        ends = np.concatenate([after, before[after]])
        order = np.argsort(ends, kind="stable")
        self._of: Integers = ends[order]
        self._signs: Array = np.where(order < m, 1.0, -1.0)
        branch = order % max(m, 1)
        rows = [(3 * self._block[self._of][:, None] + np.arange(3)).ravel(), n + np.arange(m)]
        cols = [np.repeat(branch, 3), np.arange(m)]
        products: list[Array] = [np.full(m, 2.0)]
        for k in range(1, int(np.bincount(self._of).max(initial=0))):
            (same,) = np.nonzero(self._of[k:] == self._of[:-k])
            pair = np.sort([branch[same], branch[same + k]], axis=0)
            rows.append(n + pair[0])
            cols.append(pair[1])
            products.append(self._signs[same] * self._signs[same + k])
        self._lay_out(np.concatenate(rows), n + np.concatenate(cols), np.concatenate(products))
        starts = self._starts[3 * self._block[:, None] + UPPER[0]]
        self._squares: Integers = (starts + UPPER[1] - UPPER[0]).ravel()

    def _lay_out(self, rows: Integers, cols: Integers, products: Array) -> None:
        """Create the matrix with entries of the branches, of which the last are `products`."""
        n, first = len(self._pointers) - 1, len(rows) - len(products)
        size = int(rows.max(initial=n - 1)) + 1
        more, upper = np.bincount(rows, minlength=size), self._pointers[1:] - self._diagonal
        self._starts = pointers(more + np.pad(upper, (0, size - n)))
        order, place = np.lexsort((cols, rows)), np.empty_like(rows)
        place[order] = runs(self._starts[1:] - more, more)
        self._border, self._stretched = place[:first].reshape(-1, 3), np.empty(self._starts[-1])
        self._stretched[place[first:]] = products
        indices = np.empty(self._starts[-1], dtype=PETSc.IntType)
        copy_upper(self._pointers, self._diagonal, self._indices, self._starts, indices)
        indices[place] = cols
        csr = self._starts.astype(PETSc.IntType), indices, self._stretched
        self.petsc = PETSc.Mat().createAIJWithArrays((size, size), csr, comm=PETSc.COMM_SELF)
        self.petsc.setOption(PETSc.Mat.Option.SPD, True)
        self._vectors: tuple[PETSc.Vec, PETSc.Vec] = self.petsc.createVecs()

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply a preconditioner of `petsc` to b, without the branches' values."""
        (right, left), n = self._vectors, b.getLocalSize()
        right.array[:n] = b.array_r
        pc.apply(right, left)
        y.array[:] = left.array_r[:n]


@numba.njit(cache=True)
def copy_upper(pointers, diagonal, values, starts, out):  # type: ignore[no-untyped-def]
    """Copy the upper triangle of a matrix in CSR form to rows that begin at `starts`."""
    for row in range(len(diagonal)):
        for k in range(pointers[row + 1] - diagonal[row]):
            out[starts[row] + k] = values[diagonal[row] + k]


@numba.njit(cache=True)
def tree(pointers, indices, columns, block):  # type: ignore[no-untyped-def]
    """A tree for each column's entries, which begin at `columns`, depth first along the entries of
    a matrix in CSR form: what each entry is joined to (n,), -1 for the first of a column."""
    entry = np.full((len(pointers) - 1) // 3, -1, dtype=np.int64)
    before, path = np.full(len(block), -2, dtype=np.int64), np.empty(len(block), dtype=np.int64)
    for c in range(len(columns) - 1):
        first, last = columns[c], columns[c + 1]
        for e in range(first, last):
            entry[block[e]] = e
        for e in range(first, last):  # more than the first one only for separate parts
            if before[e] > -2:
                continue
            before[e], path[0], depth = e - 1 if e > first else -1, e, 0
            while depth >= 0:
                row = 3 * block[path[depth]]
                for k in range(pointers[row], pointers[row + 1], 3):
                    found = entry[indices[k] // 3]
                    if found >= first and before[found] == -2:
                        before[found] = path[depth]
                        depth += 1
                        path[depth] = found
                        break
                else:
                    depth -= 1
    return before
