"""Moving blocks of this process in clusters not joined by any element; all others are fixed."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


class ClusterLayout:
    """Some blocks of a layout, sorted into clusters.

    Attributes: `blocks` (n,): the blocks, cluster by cluster, in an order of small bandwidth;
    `starts` (n_clusters + 1,): first entry of each cluster in `blocks`; `cluster` (n,): cluster of
    each; `number` (n_local,): index of the layout's blocks in `blocks`, or -1; `groups` (n_local,):
    cluster with which each block of the layout moves, or -1; `projectors`: indices (k,) of the
    blocks with held components and the edge sliders, and projectors (k, 3, 3) on their free
    directions. Shapes: blocks (n,).
    """

    comm = MPI.COMM_SELF

    def __init__(
        self, whole: LocalBlocks, blocks: Indices, elements: Sequence[tuple[Indices, Indices]]
    ) -> None:
        self.whole, self.X, self.n_local = whole, whole.X, whole.n_local
        self.number = np.full(whole.n_local, -1)
        self.number[blocks] = np.arange(len(blocks))
        order, self.cluster = self._connect(len(blocks), elements)
        self.blocks = blocks[order]
        self.n_clusters = int(self.cluster.max(initial=-1)) + 1
        self.starts = np.searchsorted(self.cluster, np.arange(self.n_clusters + 1))
        self.number[self.blocks] = np.arange(len(blocks))
        self.groups: Integers = np.append(self.cluster, -1)[self.number]
        self.groups[whole.tied_points] = self.groups[whole.interpolation].max(axis=1)
        edge_sliders = self.number[whole.edge_sliders]
        lines = whole.directions[edge_sliders >= 0]
        edge_sliders = edge_sliders[edge_sliders >= 0]
        held = whole.held[self.blocks]
        bound = np.union1d(edge_sliders, np.nonzero(held)[0])
        P = np.eye(3) * ~held[bound, None]
        P[np.searchsorted(bound, edge_sliders)] = lines[:, :, None] * lines[:, None, :]
        self.projectors = bound, P

    def _moved(self) -> Integers:
        """Indices of the free blocks that carry each block: (n_local, 1), or 3 with tied points."""
        whole = self.whole
        if whole.n_tied_points == 0:
            return self.number[:, None]
        moved = np.full((whole.n_local, 3), -1)
        moved[:, 0] = self.number
        moved[whole.tied_points] = self.number[whole.interpolation]
        return moved

    def _connect(
        self, n: int, elements: Sequence[tuple[Indices, Indices]]
    ) -> tuple[Integers, Integers]:
        """Sort n free blocks into clusters; return their order, and clusters in that order."""
        ends = [0, *(int(pointers[-1]) for pointers, _ in elements)]
        first = [own[:-1] + end for (own, _), end in zip(elements, np.cumsum(ends), strict=False)]
        pointers = np.concatenate([*first, [sum(ends)]]).astype(np.int64)
        members = np.concatenate([np.zeros(0, dtype=np.int32), *(own for _, own in elements)])
        found: tuple[Integers, Integers] = _sweep(pointers, members, self._moved(), n)
        return found

    def clusters_of(self, pointers: Indices, members: Indices) -> Integers:
        """Cluster (n,) of each element in CSR form; -1 if it does not move."""
        if len(pointers) == 1:
            return np.zeros(0, dtype=np.int64)
        return np.asarray(np.maximum.reduceat(self.groups[members], pointers[:-1]), dtype=np.int64)

    def project(self, values: Array) -> None:
        """Project block vectors (n, 3) on the free directions, in place."""
        bound, P = self.projectors
        values[bound] = np.einsum("nij,nj->ni", P, values[bound])


@numba.njit(cache=True)
def _sweep(pointers, members, moved, n):  # type: ignore[no-untyped-def]
    """Order n blocks cluster by cluster (reverse Cuthill-McKee), and number the clusters. Elements
    are in CSR form; `moved` (n_local, k): blocks that a member moves with, or -1."""
    starts = np.zeros(n + 1, dtype=np.int64)
    for q in range(len(members)):
        for m in range(moved.shape[1]):
            starts[moved[members[q], m] + 1] += moved[members[q], m] >= 0
    for b in range(n):
        starts[b + 1] += starts[b]
    own, filled = np.empty(starts[n], dtype=np.int64), starts.copy()
    for e in range(len(pointers) - 1):
        for q in range(pointers[e], pointers[e + 1]):
            for m in range(moved.shape[1]):
                b = moved[members[q], m]
                if b >= 0:
                    own[filled[b]] = e
                    filled[b] += 1
    order, cluster = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    found, used = np.zeros(n, dtype=np.int64), np.zeros(len(pointers), dtype=np.int64)
    count = begin = 0
    for seed in range(n):
        if found[seed] > 0:
            continue
        end, order[begin] = begin, seed
        for sweep in range(2 * count + 1, 2 * count + 3):
            order[begin] = order[max(begin, end - 1)]  # second sweep: start at the far end
            found[order[begin]], at, end = sweep, begin, begin + 1
            while at < end:
                for k in range(starts[order[at]], starts[order[at] + 1]):
                    e = own[k]
                    if used[e] == sweep:
                        continue
                    used[e] = sweep
                    for q in range(pointers[e], pointers[e + 1]):
                        for m in range(moved.shape[1]):
                            b = moved[members[q], m]
                            if b >= 0 and found[b] != sweep:
                                found[b], order[end] = sweep, b
                                end += 1
                at += 1
        for k in range((end - begin) // 2):  # the reverse order has a smaller envelope
            a, b = begin + k, end - 1 - k
            order[a], order[b] = order[b], order[a]
        for k in range(begin, end):
            cluster[k] = count
        begin, count = end, count + 1
    return order, cluster
