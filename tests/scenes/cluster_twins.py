"""Slow, readable twins of what sorts blocks into clusters and solves in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from crms_fenicsx.energy.minimization.cluster_matrix import ClusterMatrix

Array = npt.NDArray[Any]


def dense_cluster(matrix: ClusterMatrix, cluster: int) -> Array:
    """Matrix of a cluster, (3 k, 3 k), the dyads of the columns that border it included."""
    start, end = matrix.rows[cluster : cluster + 2]
    K = np.zeros((end - start, end - start))
    for row in range(start, end):
        for col in range(matrix.first[row], row + 1):
            K[row - start, col - start] = K[col - start, row - start] = matrix.values[
                matrix.at[row] + col
            ]
    n = 3 * int(np.diff(matrix.layout.starts)[cluster])
    return K[:n, :n] + K[:n, n:] @ K[n:, :n]


def closed(K: Array, part: float, held: Array, lines: dict[int, Array]) -> Array:
    """A dense matrix with its diagonal shifted by a part, without what is not free to move. Shapes:
    held (k, 3); lines are directions of blocks that move along them."""
    traces = np.maximum(np.diag(K).reshape(-1, 3).sum(axis=1), 0.0)
    mean = float(np.exp(np.mean(np.log(traces[traces > 0.0]))))
    P, rest = np.eye(len(K)), np.zeros_like(K)
    for block, components in enumerate(held):
        own = np.diag(~components).astype(float)
        if block in lines:
            own = np.outer(lines[block], lines[block])
        at = slice(3 * block, 3 * block + 3)
        P[at, at], rest[at, at] = own, mean * (np.eye(3) - own)
    return P @ (K + np.diag(np.repeat(part * (traces + mean), 3))) @ P + rest


def connected(elements: Sequence[Sequence[int]], blocks: Sequence[int]) -> set[frozenset[int]]:
    """Sets of blocks that elements join."""
    sets = [{block} for block in blocks]
    for element in elements:
        own = [some for some in sets if some & set(element)]
        sets = [some for some in sets if some not in own]
        sets += [set().union(*own)] if own else []
    return {frozenset(some) for some in sets}
