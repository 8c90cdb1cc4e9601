"""How many entries the rows of the stiffness have, which PETSc wants to know beforehand.

If it does not it collects the places of the first values in a hash table, which takes five times as
long as an assembly.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.runtime.arrays import Indices


class RowSizes:
    """Upper bounds of the number of blocks in each row of the stiffness, diagonal included."""

    def __init__(self, unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        self._vector, self._counts = unknowns.vector()
        # Columns: all blocks, and those that may belong to another rank.
        self._counts[: unknowns.n_owned, 0] = 1.0

    def add(self, rows: Indices, cols: Indices) -> None:
        """Count blocks of one term beside the diagonal, each once.

        Shapes: rows, cols (n,).
        """
        n = self.unknowns.n_owned
        beside = rows != cols
        rows, elsewhere = rows[beside], ((rows >= n) | (cols >= n))[beside]
        size = self.unknowns.n_local
        self._counts[:, 0] += np.bincount(rows, minlength=size)
        self._counts[:, 1] += np.bincount(rows, weights=elsewhere, minlength=size)

    def allocate(self, A: PETSc.Mat) -> None:
        """Give a matrix of all blocks, or of the vertices, its memory.

        Collective, and the last call.
        """
        self.unknowns.add_ghosts(self._vector)
        rows, all_rows = (size // 3 for size in A.getSizes()[0])
        own, others = self._counts[:rows, :2].astype(PETSc.IntType).T
        own = np.minimum(own, rows)
        others = np.minimum(others, all_rows - rows)
        A.setPreallocationNNZ((np.repeat(3 * own, 3), np.repeat(3 * others, 3)))
        # PETSc does this by itself, but not on ranks without rows, which would hang the others.
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)
        self._vector.destroy()
