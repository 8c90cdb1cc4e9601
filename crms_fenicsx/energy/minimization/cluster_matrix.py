"""Stiffness of clusters of blocks, factorised cluster by cluster.

Each row is stored as an envelope, from its first entry to the diagonal, which elimination fills.
It is narrow because `ClusterLayout` numbers neighbouring blocks consecutively. Dyads c c^T would
fill it, so their columns border the stiffness:

    [K    c]
    [c^T -1]

Eliminating the border leaves K + c c^T, which is definite if and only if the bordered matrix has as
many negative pivots as columns (Sylvester's law of inertia).
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.minimization.initial_hessian import EXACT_SHIFT, SHIFT
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, ColumnPattern, scatter_blocks
from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers, pointers


class ClusterLayout:
    """Some blocks of a layout, sorted into clusters.

    Attributes: `blocks` (n,): the blocks, cluster by cluster, in an order of small bandwidth;
    `starts` (n_clusters + 1,): first entry of each cluster in `blocks`; `cluster` (n,): cluster of
    each; `number` (n_local,): index of the layout's blocks in `blocks`, or -1; `groups` (n_local,):
    cluster with which each block of the layout moves, or -1; `projectors`: indices (k,) of the
    blocks with held components and the sliders, and projectors (k, 3, 3) on their free
    directions. Shapes: blocks (n,).
    """

    comm = MPI.COMM_SELF

    def __init__(
        self, whole: LocalBlocks, blocks: Indices, elements: Sequence[tuple[Indices, Indices]]
    ) -> None:
        self.whole, self.X, self.n_local = whole, whole.X, whole.n_local
        self.number = np.full(whole.n_local, -1)
        self.number[blocks] = np.arange(len(blocks))
        ends = [0, *(int(pointers[-1]) for pointers, _ in elements)]
        first = [own[:-1] + end for (own, _), end in zip(elements, np.cumsum(ends), strict=False)]
        starts = np.concatenate([*first, [sum(ends)]]).astype(np.int64)
        members = np.concatenate([np.zeros(0, dtype=np.int32), *(own for _, own in elements)])
        order, self.cluster = _sweep(starts, members, self._moved(), len(blocks))
        self.blocks = blocks[order]
        self.n_clusters = int(self.cluster.max(initial=-1)) + 1
        self.starts = np.searchsorted(self.cluster, np.arange(self.n_clusters + 1))
        self.number[self.blocks] = np.arange(len(blocks))
        self.groups: Integers = np.append(self.cluster, -1)[self.number]
        self.groups[whole.tied_points] = self.groups[whole.interpolation].max(axis=1)
        sliders = self.number[whole.sliders]
        own = sliders >= 0
        held = whole.held[self.blocks]
        bound = np.union1d(sliders[own], np.nonzero(held)[0])
        P = np.eye(3) * ~held[bound, None]
        P[np.searchsorted(bound, sliders[own])] = whole.projectors[own]
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


NO_COLUMNS = ColumnPattern(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int32))
"""Pattern of clusters without dyads."""


class ClusterMatrix:
    """Stiffness of clusters, to which terms add as to a PETSc matrix.

    Entry (i, j) of the lower triangle is ``values[at[i] + j]``, for ``first[i] <= j <= i``. The
    rows of cluster c start at ``rows[c]``: three for each block, then one for each column.
    """

    def __init__(
        self,
        layout: ClusterLayout,
        patterns: Sequence[BlockPattern],
        columns: ColumnPattern = NO_COLUMNS,
    ) -> None:
        self.layout, n = layout, len(layout.blocks)
        places = {pattern: self._find(pattern) for pattern in patterns}
        column, at, self._sources, self._weights = self._find_columns(columns)
        owners = np.zeros(int(columns.columns.max(initial=-1)) + 1, dtype=np.int64)
        np.maximum.at(owners, columns.columns, layout.groups[columns.blocks])
        before = np.searchsorted(owners, np.arange(layout.n_clusters + 1))
        self.rows = 3 * layout.starts + before
        row, nearest = 3 * np.arange(n) + before[layout.cluster], np.arange(n)
        for i, j, _, _ in places.values():
            np.minimum.at(nearest, i, j)
        self.first = np.arange(self.rows[-1])
        ends = self.first + 1
        for k in range(3):  # all three rows of a block have the same columns
            self.first[row + k], ends[row + k] = row[nearest], row + 3
        column += 3 * layout.starts[owners[column] + 1]
        np.minimum.at(self.first, column, row[at])
        offsets = pointers(ends - self.first)
        self.at, self.values = offsets[:-1] - self.first, np.zeros(offsets[-1])
        self._columns = (self.at[column] + row[at])[:, None] + np.arange(3)
        self._places = {
            pattern: (sources, weights, *_places(i, j, row, nearest, self.at))
            for pattern, (i, j, sources, weights) in places.items()
        }

    def _find(self, pattern: BlockPattern) -> tuple[Integers, Integers, Indices, Array]:
        """Rows, columns, source blocks and weights of a pattern's blocks in the lower triangle."""
        whole, number = self.layout.whole, self.layout.number
        if whole.n_tied_points == 0:
            i, j, kept = _lower_half(pattern.rows, pattern.cols, number)
            return i, j, *pattern.parts(kept, np.ones(len(kept)))
        (rows, cols), sources, weights = whole.spread(pattern.rows, pattern.cols)
        i, j, kept = _lower_half(rows, cols, number)
        return i, j, *pattern.parts(sources[kept], weights[kept])

    def _find_columns(self, of: ColumnPattern) -> tuple[Integers, Integers, Integers, Array]:
        """Column and block of the dyads' entries at moving blocks, with sources and weights."""
        tie_weights, shares = self.layout.whole.tie_weights()
        number, weights = self.layout.number[tie_weights[of.blocks]], shares[of.blocks]
        sources, k = np.nonzero((number >= 0) & (weights != 0.0))
        return of.columns[sources], number[sources, k], sources, weights[sources, k]

    def clear(self) -> None:
        """Set all entries to zero."""
        self.values[:] = 0.0

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's values, except those of held blocks."""
        scatter_blocks(pattern.values, *self._places[pattern], self.values)

    def take_columns(self, pattern: ColumnPattern) -> None:
        """Add the dyads' columns."""
        values = self._weights[:, None] * pattern.values[self._sources]
        np.add.at(self.values, self._columns, values)

    def close(self, exact: bool = False) -> None:
        """Shift the diagonal slightly and decouple constrained components. Each cluster's shift
        depends on its own stiffness only; it is smaller for second derivatives (`exact`)."""
        layout, part = self.layout, EXACT_SHIFT if exact else SHIFT
        blocks, projectors = layout.projectors
        _close(self.values, self.first, self.at, self.rows, layout.starts, part, blocks, projectors)

    def solve(self, wanted: Booleans, b: Array, y: Array) -> Booleans:
        """Solve ``K y = b`` in the `wanted` clusters (n_clusters,), b and y (n, 3), factorising in
        place; y must be contiguous. Returns the clusters where K is definite; others keep y."""
        layout = self.layout
        definite: Booleans = _solve(
            self.values, self.first, self.at, self.rows, layout.starts, wanted, b.ravel(), y.ravel()
        )
        return definite


@numba.njit(cache=True)
def _lower_half(rows, cols, number):  # type: ignore[no-untyped-def]
    """Pairs of numbers (n,) in the lower triangle without negative ones, and their indices."""
    found, kept, m = np.empty((2, len(rows)), np.int64), np.empty(len(rows), np.int32), 0
    for k in range(len(rows)):
        i, j = number[rows[k]], number[cols[k]]
        if i >= j >= 0:
            found[0, m], found[1, m], kept[m] = i, j, k
            m += 1
    return found[0, :m], found[1, :m], kept[:m]


@numba.njit(cache=True)
def _places(i, j, row, nearest, at):  # type: ignore[no-untyped-def]
    """Offset of each block (n,) in the values, and the stride between its rows."""
    starts, strides = np.empty((2, len(i)), np.int64)
    for k in range(len(i)):
        starts[k] = at[row[i[k]]] + row[j[k]]
        strides[k] = row[i[k]] + 3 - row[nearest[i[k]]]
    return starts, strides


@numba.njit(cache=True)
def _close(values, first, at, rows, starts, part, blocks, projectors):  # type: ignore[no-untyped-def]
    """`ClusterMatrix.close` with explicit arrays; `blocks` are those with projectors."""
    bound = 0
    for c in range(len(starts) - 1):
        start, end, columns = rows[c], rows[c + 1], rows[c] + 3 * (starts[c + 1] - starts[c])
        traces, logs, count = np.zeros((columns - start) // 3), 0.0, 0
        for row in range(start, columns):
            traces[(row - start) // 3] += values[at[row] + row]
        for row in range(columns, end):
            values[at[row] + row] = -1.0
            for col in range(first[row], columns):
                traces[(col - start) // 3] += values[at[row] + col] ** 2
        for trace in traces:
            if trace > 0.0:
                logs += np.log(trace)
                count += 1
        mean = np.exp(logs / max(count, 1))
        for row in range(start, columns):
            values[at[row] + row] += part * (max(traces[(row - start) // 3], 0.0) + mean)
        while bound < len(blocks) and blocks[bound] < starts[c + 1]:
            row, P = start + 3 * (blocks[bound] - starts[c]), projectors[bound]
            _project(values, first, at, row, end, P)
            for i in range(3):
                for j in range(3):
                    values[at[row + i] + row + j] += mean * ((i == j) - P[i, j])
            bound += 1


@numba.njit(cache=True)
def _project(values, first, at, row, end, P):  # type: ignore[no-untyped-def]
    """Multiply the three rows from `row` on, and their columns, by a matrix (3, 3)."""
    for col in range(first[row], row + 3):
        a, b, c = values[at[row] + col], values[at[row + 1] + col], values[at[row + 2] + col]
        for i in range(3):
            values[at[row + i] + col] = P[i, 0] * a + P[i, 1] * b + P[i, 2] * c
    for below in range(row, end):
        if first[below] <= row:
            own = values[at[below] + row : at[below] + row + 3]
            a, b, c = own
            for j in range(3):
                own[j] = a * P[0, j] + b * P[1, j] + c * P[2, j]


@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _solve(values, first, at, rows, starts, wanted, b, y):  # type: ignore[no-untyped-def]
    """`ClusterMatrix.solve` with explicit arrays: L D L^T factors, then the solutions."""
    definite = np.zeros(len(wanted), dtype=np.bool_)
    for c in range(len(wanted)):
        if not wanted[c]:
            continue
        start, end, before = rows[c], rows[c + 1], rows[c] - 3 * starts[c]
        to_come = end - before - 3 * starts[c + 1]  # negative pivots still due
        for row in range(start, end):
            own = at[row]
            pivot = values[own + row]
            for col in range(first[row], row):
                value, other = values[own + col], at[col]
                for k in range(max(first[row], first[col]), col):
                    value -= values[own + k] * values[other + k]
                values[own + col] = value
            for col in range(first[row], row):
                value = values[own + col]
                values[own + col] = value / values[at[col] + col]
                pivot -= value * values[own + col]
            values[own + row] = pivot
            to_come -= pivot < 0.0
            if to_come < 0 or not abs(pivot) > 0.0:
                to_come = -1
                break
        definite[c] = to_come == 0
        if not definite[c]:
            continue
        z = np.zeros(end - start)
        for k in range(3 * starts[c], 3 * starts[c + 1]):
            z[k + before - start] = b[k]
        for row in range(start, end):
            for col in range(first[row], row):
                z[row - start] -= values[at[row] + col] * z[col - start]
        for row in range(end - 1, start - 1, -1):
            z[row - start] /= values[at[row] + row]
        for row in range(end - 1, start - 1, -1):
            for col in range(first[row], row):
                z[col - start] -= values[at[row] + col] * z[row - start]
        for k in range(3 * starts[c], 3 * starts[c + 1]):
            y[k] = z[k + before - start]
    return definite
