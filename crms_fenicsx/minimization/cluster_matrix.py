"""Dense stiffness matrices of clusters of blocks, factorised one by one."""

from __future__ import annotations

import numba
import numpy as np
from scipy.linalg import lapack

from crms_fenicsx.dofs.block_patterns import BlockPattern
from crms_fenicsx.dofs.cluster_layout import ClusterLayout
from crms_fenicsx.minimization.membrane_multigrid import EXACT_SHIFT, SHIFT
from crms_fenicsx.runtime.arrays import Array, Indices, Integers


class ClusterMatrix:
    """Stiffness of clusters, which terms add to as to a PETSc matrix."""

    def __init__(self, layout: ClusterLayout) -> None:
        self.layout = layout
        self._sizes = 3 * np.diff(layout.starts)
        self._offsets = np.append(0, np.cumsum(self._sizes**2))
        self._values = np.zeros(self._offsets[-1])
        self._local = np.arange(len(layout.blocks)) - layout.starts[layout.cluster]
        row = 3 * self._local[:, None] + np.arange(3)
        size, offset = self._sizes[layout.cluster], self._offsets[layout.cluster]
        self._diagonal = offset[:, None] + row * (size[:, None] + 1)
        self._places: dict[BlockPattern, tuple[Indices, Array, Integers, Integers]] = {}

    def of(self, cluster: int) -> Array:
        """Matrix of one cluster, (3 k, 3 k), to be changed in place."""
        n = self._sizes[cluster]
        return self._values[self._offsets[cluster] : self._offsets[cluster + 1]].reshape(n, n)

    def clear(self) -> None:
        """Set all entries to zero."""
        self._values[:] = 0.0

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's values; blocks of what is held are left out."""
        if pattern not in self._places:
            self._places[pattern] = self._find(pattern)
        sources, weights, starts, strides = self._places[pattern]
        _scatter(pattern.values, sources, weights, starts, strides, self._values)

    def _find(self, pattern: BlockPattern) -> tuple[Indices, Array, Integers, Integers]:
        """Which of a pattern's blocks go where, and what part of them."""
        layout = self.layout
        (rows, cols), sources, weights = layout.whole.spread(pattern.rows, pattern.cols)
        i, j = layout.number[rows], layout.number[cols]
        kept = np.flatnonzero((i >= 0) & (j >= 0))
        i, j, sources, weights = i[kept], j[kept], sources[kept], weights[kept]
        cluster = layout.cluster[i]
        strides = self._sizes[cluster]
        starts = self._offsets[cluster] + 3 * (self._local[i] * strides + self._local[j])
        return sources, weights, starts, strides

    def close(self, exact: bool = False) -> None:
        """Shift the diagonal a little, and decouple what is not free to move.

        A cluster's shift is from its own stiffness, whichever others are here; it is less for
        second derivatives.
        """
        layout, n = self.layout, self.layout.n_clusters
        traces = np.maximum(self._values[self._diagonal].sum(axis=1), 0.0)
        stiff = traces > 0.0
        logs = np.bincount(layout.cluster[stiff], np.log(traces[stiff]), n)
        count = np.bincount(layout.cluster[stiff], minlength=n)
        means = np.exp(logs / np.maximum(count, 1))[layout.cluster]
        part = EXACT_SHIFT if exact else SHIFT
        self._values[self._diagonal] += part * (traces + means)[:, None]
        for block, component in np.argwhere(layout.held):
            K, at = self._matrix_at(block)
            K[at + component] = K[:, at + component] = 0.0
            K[at + component, at + component] = means[block]
        for block, d, mean in zip(
            layout.rails, layout.directions, means[layout.rails], strict=True
        ):
            K, at = self._matrix_at(block)
            along = np.outer(d, d)
            K[at : at + 3] = along @ K[at : at + 3]
            K[:, at : at + 3] = K[:, at : at + 3] @ along
            K[at : at + 3, at : at + 3] += mean * (np.eye(3) - along)

    def _matrix_at(self, block: int) -> tuple[Array, int]:
        """Matrix of a block's cluster, and where the block begins in it."""
        return self.of(int(self.layout.cluster[block])), 3 * int(self._local[block])

    def solve(self, cluster: int, b: Array) -> Array | None:
        """Solve ``K y = b``, (3 k,), and leave K's factor; None if K is not definite."""
        factor, info = lapack.dpotrf(self.of(cluster).T, lower=1, overwrite_a=1)
        if info != 0:
            return None
        y: Array = lapack.dpotrs(factor, b, lower=1)[0]
        return y


@numba.njit(cache=True)
def _scatter(values, sources, weights, starts, strides, out):  # type: ignore[no-untyped-def]
    """Add blocks (n, 3, 3) times their weights at their starts, rows a stride apart."""
    for k in range(len(sources)):
        v, w = values[sources[k]], weights[k]
        for i in range(3):
            for j in range(3):
                out[starts[k] + i * strides[k] + j] += w * v[i, j]
