"""Layout of some blocks of this process, with all others held where they are.

It has the blocks' own numbers, 0 ... n - 1, in its vectors and matrices; positions and
displacements remain those of the whole layout, so terms read them by the numbers that they know.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.runtime.arrays import Array, Indices


class LocalLayout(Unknowns):
    """Some blocks of a layout, as a layout of this process alone.

    Parameters
    ----------
    whole
        The layout.
    blocks
        Owned blocks of it that are free to move, without riders, (n,), ascending.
    """

    def __init__(self, whole: Unknowns, blocks: Indices) -> None:
        self.comm, self.whole, self.blocks = MPI.COMM_SELF, whole, blocks
        self.n_owned = self.n_local = self.n_global = self.n_points = len(blocks)
        self.n_vertices = self.n_ghost_vertices = self.start = 0
        self.ghosts = np.zeros(0, dtype=PETSc.IntType)
        self.X, self.bounds, self.held = whole.X, None, whole.held[blocks]
        self.matrix_numbers = np.full(whole.n_local, -1, dtype=PETSc.IntType)
        self.matrix_numbers[blocks] = np.arange(len(blocks))
        rails = self.matrix_numbers[whole.rails]
        self.set_rails(rails[rails >= 0], whole.directions[rails >= 0])

    def matrix_order(self) -> Indices:
        """Blocks in the order that matrices count them: their own."""
        return np.arange(self.n_owned, dtype=np.int32)

    def matrix_rows(self, blocks: Indices) -> Indices:
        """Numbers of blocks, by their own numbers, in matrices: the same."""
        return blocks

    def spread(self, rows: Indices, cols: Indices) -> tuple[Indices, Indices, Array]:
        """As `Unknowns.spread`; blocks in rows and columns of others are left out."""
        if self.whole.n_riders == 0:
            kept = np.flatnonzero((self.matrix_numbers[rows] >= 0) & (self.matrix_numbers[cols] >= 0))
            return np.stack([rows[kept], cols[kept]]), kept.astype(np.int32), np.ones(len(kept))
        places, sources, weights = self.whole.spread(rows, cols)
        kept = (self.matrix_numbers[places] >= 0).all(axis=0)
        return places[:, kept], sources[kept], weights[kept]

    def project_blocks(self, rows: Indices, cols: Indices, values: Array) -> Array:
        """As `Unknowns.project_blocks`."""
        return self.whole.project_blocks(rows, cols, values)
