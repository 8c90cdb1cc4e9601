"""Adding (3, 3) blocks of cable elements to the global stiffness."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from crms_fenicsx.unknowns import Unknowns

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]


def add_blocks(
    A: PETSc.Mat, unknowns: Unknowns, rows: Indices, cols: Indices, values: Array
) -> None:
    """Add blocks (n, 3, 3) at local block rows and columns (n,).

    Points that ride on vertices hand their part on to them; of rails the part along their lines
    counts.
    """
    if unknowns.n_riders:
        rows, cols, values = unknowns.spread(rows, cols, values)
    if unknowns.n_rails:
        values = unknowns.project_blocks(rows, cols, values)
    A.setValuesBlockedLocalRCV(
        unknowns.matrix_numbers[rows][:, None],
        unknowns.matrix_numbers[cols][:, None],
        values.reshape(len(rows), 9),
        PETSc.InsertMode.ADD,
    )


class SegmentPattern:
    """Blocks of segments (n, 2): plus their value on the diagonal, minus off it."""

    def __init__(self, segments: Indices) -> None:
        a, b = segments[:, 0], segments[:, 1]
        self.rows = np.concatenate([a, b, a, b])
        self.cols = np.concatenate([a, b, b, a])
        self.values = np.zeros((len(segments), 3, 3))

    def add(self, A: PETSc.Mat, unknowns: Unknowns) -> None:
        """Add what `values` holds."""
        v = self.values
        add_blocks(A, unknowns, self.rows, self.cols, np.concatenate([v, v, -v, -v]))


class ElementPattern:
    """Dense blocks of elements whose blocks are listed in CSR form (pointers, blocks)."""

    def __init__(self, pointers: Indices, blocks: Indices) -> None:
        sizes = np.diff(pointers)
        self.offsets = np.concatenate([[0], np.cumsum(sizes**2)]).astype(np.int64)
        rows, cols = [], []
        for start, size in zip(pointers[:-1], sizes, strict=True):
            own = blocks[start : start + size]
            rows.append(np.repeat(own, size))
            cols.append(np.tile(own, size))
        empty = np.zeros(0, dtype=np.int32)
        self.rows = np.concatenate([empty, *rows]).astype(np.int32)
        self.cols = np.concatenate([empty, *cols]).astype(np.int32)
        self.values = np.zeros((len(self.rows), 3, 3))

    def add(self, A: PETSc.Mat, unknowns: Unknowns) -> None:
        """Add what `values` holds."""
        add_blocks(A, unknowns, self.rows, self.cols, self.values)
