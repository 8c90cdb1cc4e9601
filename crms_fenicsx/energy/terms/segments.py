"""Length of a straight segment, smoothed where its ends come together.

All effects of a cable on the membrane depend on lengths of segments between points. The distance d
of two points is not differentiable at d = 0, where a fold point meets a mesh vertex. Below a small
length eps it is replaced by a twice continuously differentiable function that is exact from eps on:

    l(d) = eps (3/8 + 3/4 u^2 - 1/8 u^4),   u = d/eps < 1.

A negative eps means the distance itself, with zero gradient below |eps|, for segments whose ends
are prescribed and may coincide.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, fields
from typing import Self

import numba
import numpy as np

from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


@numba.njit(cache=True, inline="always")
def smoothed_length(d: float, eps: float) -> float:
    """l(d) (length)."""
    if d >= eps:
        return d
    u2 = (d / eps) ** 2
    return eps * (0.375 + u2 * (0.75 - 0.125 * u2))


@numba.njit(cache=True, inline="always")
def slope_over_distance(d: float, eps: float) -> float:
    """l'(d) / d (1/length): times the difference of the points, it is the gradient."""
    if d >= abs(eps):
        return 1.0 / d if d > 0.0 else 0.0
    if eps < 0.0:
        return 0.0
    return (1.5 - 0.5 * (d / eps) ** 2) / eps


@numba.njit(cache=True, inline="always")
def turn_coefficient(d: float, eps: float) -> float:
    """k in the Hessian ``l'(d)/d I - k r r^T`` of l, with the difference r of the points."""
    if d >= abs(eps):
        return 1.0 / d**3 if d > 0.0 else 0.0
    if eps < 0.0:
        return 0.0
    return 1.0 / eps**3


@numba.njit(cache=True, inline="always")
def difference(X, x, a, b):  # type: ignore[no-untyped-def]
    """Current position of block b minus that of block a, and the distance."""
    r0 = X[b, 0] - X[a, 0] + (x[b, 0] - x[a, 0])
    r1 = X[b, 1] - X[a, 1] + (x[b, 1] - x[a, 1])
    r2 = X[b, 2] - X[a, 2] + (x[b, 2] - x[a, 2])
    return r0, r1, r2, math.sqrt(r0 * r0 + r1 * r1 + r2 * r2)


@numba.njit(cache=True)
def segment_lengths(X, x, segments, eps, lengths):  # type: ignore[no-untyped-def]
    """Smoothed lengths of segments (n, 2) of blocks, into `lengths` (n,)."""
    for s in range(segments.shape[0]):
        _, _, _, d = difference(X, x, segments[s, 0], segments[s, 1])
        lengths[s] = smoothed_length(d, eps[s])


@numba.njit(cache=True)
def add_segment_forces(X, x, segments, eps, forces, g):  # type: ignore[no-untyped-def]
    """Add ``sum forces * d(lengths)/dx`` to g, (n_blocks, 3)."""
    for s in range(segments.shape[0]):
        a, b = segments[s, 0], segments[s, 1]
        r0, r1, r2, d = difference(X, x, a, b)
        c = forces[s] * slope_over_distance(d, eps[s])
        g[a, 0] -= c * r0
        g[a, 1] -= c * r1
        g[a, 2] -= c * r2
        g[b, 0] += c * r0
        g[b, 1] += c * r1
        g[b, 2] += c * r2


@numba.njit(cache=True)
def segment_stiffness(X, x, segments, eps, forces, blocks):  # type: ignore[no-untyped-def]
    """``force * Hessian(length)`` of segments, (n, 3, 3): the block with + on the diagonal."""
    for s in range(segments.shape[0]):
        r0, r1, r2, d = difference(X, x, segments[s, 0], segments[s, 1])
        r = (r0, r1, r2)
        c = forces[s] * slope_over_distance(d, eps[s])
        k = forces[s] * turn_coefficient(d, eps[s])
        for i in range(3):
            for j in range(3):
                blocks[s, i, j] = -k * r[i] * r[j]
            blocks[s, i, i] += c


@dataclass(frozen=True)
class BlockLists(ElementTable):
    """Elements of several blocks each."""

    # pointers, blocks: blocks of each element in CSR form
    pointers: Indices
    blocks: Indices
    addresses = ("blocks",)

    @property
    def element_blocks(self) -> tuple[Indices, Indices]:
        """Blocks of the elements."""
        return self.pointers, self.blocks

    def some(self, rows: Integers) -> Self:
        """Subset of the elements, with their blocks."""
        counts = np.diff(self.pointers)[rows]
        pointers = np.append(0, np.cumsum(counts))
        own = np.repeat(self.pointers[rows] - pointers[:-1], counts) + np.arange(pointers[-1])
        others = [getattr(self, field.name)[rows] for field in fields(self)[2:]]
        return type(self)(pointers.astype(np.int32), self.blocks[own], *others)


@dataclass(frozen=True)
class EdgePoints(BlockLists):
    """This rank's points on edges, each with the blocks along its edge: its first vertex, the
    points on it, its last vertex."""

    place: Indices  # (n,) which of them the point is


@numba.njit(cache=True)
def edge_fractions(X, x, pointers, blocks, place, fractions, gradients):  # type: ignore[no-untyped-def]
    """Positions on edges as fractions of their lengths (n,), and derivatives by all blocks."""
    gradients[:] = 0.0
    for k in range(place.shape[0]):
        start, end, at = pointers[k], pointers[k + 1], pointers[k] + place[k]
        before = total = 0.0
        for q in range(start, end - 1):
            _, _, _, d = difference(X, x, blocks[q], blocks[q + 1])
            total += d
            if q < at:
                before += d
        s = before / total if total > 0.0 else 0.0
        fractions[k] = s
        for q in range(start, end - 1):
            r0, r1, r2, d = difference(X, x, blocks[q], blocks[q + 1])
            if d == 0.0:
                continue  # no direction, no force
            weight = ((1.0 - s) if q < at else -s) / (total * d)
            for i, r in enumerate((r0, r1, r2)):
                gradients[q, i] -= weight * r
                gradients[q + 1, i] += weight * r


def shift_fractions(
    x: Array, pointers: Indices, blocks: Indices, by_shift: Array, fractions: Array,
    gradients: Array,
) -> None:  # fmt: skip
    """The same for points with a single block, the shift of a vertex, times `by_shift` (n, 3)."""
    (shifted,) = np.nonzero(np.diff(pointers) == 1)
    at = pointers[shifted]
    gradients[at] = by_shift[shifted]
    fractions[shifted] = np.sum(gradients[at] * x[blocks[at]], axis=1)


@numba.njit(cache=True)
def add_slip_forces(pointers, blocks, gradients, force, g):  # type: ignore[no-untyped-def]
    """Add ``sum force * d(fractions)/dx`` to g, (n_blocks, 3)."""
    for k in range(force.shape[0]):
        for q in range(pointers[k], pointers[k + 1]):
            for i in range(3):
                g[blocks[q], i] += force[k] * gradients[q, i]


@numba.njit(cache=True)
def slip_stiffness(pointers, blocks, gradients, stiffness, values):  # type: ignore[no-untyped-def]
    """Put ``stiffness * grad(fraction) grad(fraction)^T`` into `values` (m, 3, 3), for all pairs of
    blocks of one node after the other, by rows."""
    pair = 0
    for k in range(stiffness.shape[0]):
        for q in range(pointers[k], pointers[k + 1]):
            for p in range(pointers[k], pointers[k + 1]):
                for i in range(3):
                    for j in range(3):
                        values[pair, i, j] = stiffness[k] * gradients[q, i] * gradients[p, j]
                pair += 1


@numba.njit(cache=True)
def _add_slip_curvature(X, x, pointers, blocks, place, fractions, gradients, force, values):  # type: ignore[no-untyped-def]
    """Add ``force * Hessian(fraction)`` to such `values`. With the edge's length `total`, its
    derivatives u_q and the fraction s, the second derivatives are
    ``(sum_q c_q Hessian(d_q) - grad(s) u^T - u grad(s)^T) / total``, with c_q = 1 - s before the
    node and -s behind it."""
    start = 0
    for k in range(force.shape[0]):
        first, n = pointers[k], pointers[k + 1] - pointers[k]
        lengthening = np.zeros((n, 3))
        total = 0.0
        for q in range(n - 1):
            r0, r1, r2, d = difference(X, x, blocks[first + q], blocks[first + q + 1])
            total += d
            if d > 0.0:
                for i, r in enumerate((r0, r1, r2)):
                    lengthening[q, i] -= r / d
                    lengthening[q + 1, i] += r / d
        if total > 0.0:
            scale, s = force[k] / total, fractions[k]
            for q in range(n):
                for p in range(n):
                    for i in range(3):
                        for j in range(3):
                            values[start + q * n + p, i, j] -= scale * (
                                gradients[first + q, i] * lengthening[p, j]
                                + lengthening[q, i] * gradients[first + p, j]
                            )
            for q in range(n - 1):
                r0, r1, r2, d = difference(X, x, blocks[first + q], blocks[first + q + 1])
                if d == 0.0:
                    continue
                r = (r0 / d, r1 / d, r2 / d)
                c = scale * ((1.0 - s) if q < place[k] else -s) / d
                for i in range(3):
                    for j in range(3):
                        own = c * ((1.0 if i == j else 0.0) - r[i] * r[j])
                        values[start + q * n + q, i, j] += own
                        values[start + (q + 1) * n + q + 1, i, j] += own
                        values[start + q * n + q + 1, i, j] -= own
                        values[start + (q + 1) * n + q, i, j] -= own
        start += n * n


class EdgePointTerm(ElementTerm):
    """Energy of points that depends on their fractions of their edges only."""

    of_cables = True

    def __init__(self, table: EdgePoints) -> None:
        super().__init__(table)
        self._fractions, self._pull = np.zeros((2, len(table.place)))
        self._gradients = np.zeros((len(table.blocks), 3))
        self.pattern = ElementPattern(table.pointers, table.blocks)
        self.patterns = (self.pattern,)

    @abstractmethod
    def evaluate(self) -> float:
        """Energy at the fractions; its derivatives by them into `_pull` (force x length)."""

    @abstractmethod
    def stiffnesses(self, exact: bool) -> Array:
        """Second derivatives by the fractions if `exact`, else a bound of them, (n,) (force x
        length)."""

    def locate(self, x: Array) -> None:
        """Find the fractions and their derivatives."""
        t = self.table
        edge_fractions(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients
        )

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the energy; keeps what the gradient needs."""
        self.locate(x)
        out[0] = self.evaluate()

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        add_slip_forces(self.table.pointers, self.table.blocks, self._gradients, self._pull, g)

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the stiffness, without the geometric part of the forces."""
        self._stiffen(exact=False)
        self.pattern.add(A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        t = self.table
        self._stiffen(exact=True)
        _add_slip_curvature(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients,
            self._pull, self.pattern.values,
        )  # fmt: skip
        self.pattern.add(A)

    def _stiffen(self, exact: bool) -> None:
        """Put the stiffness along the edges into the pattern's values."""
        t, stiffness = self.table, self.stiffnesses(exact)
        slip_stiffness(t.pointers, t.blocks, self._gradients, stiffness, self.pattern.values)
