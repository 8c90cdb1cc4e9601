"""Blocks of this process that move, in clusters that no element joins; all others are held."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components

from crms_fenicsx.dofs.local_blocks import LocalBlocks
from crms_fenicsx.runtime.arrays import Array, Indices, Integers


class ClusterLayout:
    """Some blocks of a layout, sorted into clusters.

    Attributes: `blocks` (n,): the blocks, cluster by cluster; `starts` (n_clusters + 1,): where
    each cluster begins among them; `cluster` (n,): number of each block's cluster; `number`
    (n_local,): place of the layout's blocks among `blocks`, -1 for others; `groups` (n_local,):
    cluster that each block of the layout moves with, or -1; `edge_sliders`, `directions`: places of
    those that are displaced along a line only, and these lines, (k, 3); `held` (n, 3): components
    with a prescribed value. Shapes: blocks (n,).
    """

    comm = MPI.COMM_SELF

    def __init__(
        self, whole: LocalBlocks, blocks: Indices, elements: Sequence[tuple[Indices, Indices]]
    ) -> None:
        self.whole, self.X, self.n_local = whole, whole.X, whole.n_local
        self.number = np.full(whole.n_local, -1)
        self.number[blocks] = np.arange(len(blocks))
        cluster = self._connect(len(blocks), elements)
        order = np.argsort(cluster, kind="stable")
        self.blocks, self.cluster = blocks[order], cluster[order]
        self.n_clusters = int(cluster.max(initial=-1)) + 1
        self.starts = np.searchsorted(self.cluster, np.arange(self.n_clusters + 1))
        self.number[self.blocks] = np.arange(len(blocks))
        moved = self._moved_by(np.arange(self.n_local, dtype=np.int32))
        self.groups: Integers = np.append(self.cluster, -1)[moved.max(axis=1)]
        self.held = whole.held[self.blocks]
        edge_sliders = self.number[whole.edge_sliders]
        self.edge_sliders, self.directions = (
            edge_sliders[edge_sliders >= 0],
            whole.directions[edge_sliders >= 0],
        )

    def _moved_by(self, blocks: Indices) -> Integers:
        """Free blocks that blocks (m,) move with, by number: (m, 1); of tied points (m, 3)."""
        whole = self.whole
        if whole.n_tied_points == 0:
            return self.number[blocks][:, None]
        moved = np.full((whole.n_local, 3), -1)
        moved[:, 0] = self.number
        moved[whole.tied_points] = self.number[whole.interpolation]
        return moved[blocks]

    def _connect(self, n: int, elements: Sequence[tuple[Indices, Indices]]) -> Integers:
        """Sort n free blocks into clusters: number of the cluster of each."""
        rows, cols, size = [], [], n
        for pointers, members in elements:
            element = size + np.repeat(np.arange(len(pointers) - 1), np.diff(pointers))
            size += len(pointers) - 1
            for moved in self._moved_by(members).T:
                rows.append(element[moved >= 0])
                cols.append(moved[moved >= 0])
        if not rows:
            return np.arange(n)
        row, col = np.concatenate(rows), np.concatenate(cols)
        graph = sp.csr_matrix((np.ones(len(row), dtype=np.int8), (row, col)), shape=(size, size))
        labels = connected_components(graph, directed=False)[1][:n]
        return np.asarray(np.unique(labels, return_inverse=True)[1], dtype=np.int64)

    def clusters_of(self, pointers: Indices, members: Indices) -> Integers:
        """Cluster of each of some elements in CSR form, (n,); -1 of those that do not move."""
        if len(pointers) == 1:
            return np.zeros(0, dtype=np.int64)
        return np.asarray(np.maximum.reduceat(self.groups[members], pointers[:-1]), dtype=np.int64)

    def project(self, values: Array) -> None:
        """Leave of vectors of the blocks, (n, 3), what they are free to move by."""
        np.copyto(values, 0.0, where=self.held)
        along = np.sum(values[self.edge_sliders] * self.directions, axis=1)
        values[self.edge_sliders] = along[:, None] * self.directions
