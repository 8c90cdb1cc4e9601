"""Contact of cables that lie side by side: no vertex of one comes nearer to another than both
radii.

A vertex v faces some vertices c of the other cable in a row. Its distance d is that to the smooth
curve through them, as corners would let the force jump:

    p(s) = sum N(s) c,    d = |w|,  w = v - p(s),  w . p'(s) = 0,

with the weights N of Catmull and Rom (Computer Aided Geometric Design, 1974). With the least
distance D and the stiffness k the energy is k/2 <D - d>^2, a function of places in space only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from crms_fenicsx.energy.terms.segments import BlockLists
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array


@dataclass(frozen=True)
class Facing(BlockLists):
    """This rank's vertices that face other cables: each the first of its blocks, then the chain."""

    least: Array  # (n,) distance D from which on they touch (length)
    stiffness: Array  # (n,) k (force/length)


@numba.njit(cache=True)
def _spline_weights(s: float, m: int, N, slopes, bends) -> None:  # type: ignore[no-untyped-def]
    """Weights (m,) of a row's points at s from 0 to m - 1, and their derivatives. The row is
    continued straight beyond its ends."""
    N[:] = slopes[:] = bends[:] = 0.0
    k = min(max(int(s), 0), m - 2)
    u = s - k
    for i in range(-1, 3):
        if i == -1:
            n, t, c = u * (-1.0 + u * (2.0 - u)), -1.0 + u * (4.0 - 3.0 * u), 4.0 - 6.0 * u
        elif i == 0:
            n, t, c = 2.0 + u * u * (3.0 * u - 5.0), u * (9.0 * u - 10.0), 18.0 * u - 10.0
        elif i == 1:
            n, t, c = u * (1.0 + u * (4.0 - 3.0 * u)), 1.0 + u * (8.0 - 9.0 * u), 8.0 - 18.0 * u
        else:
            n, t, c = u * u * (u - 1.0), u * (3.0 * u - 2.0), 6.0 * u - 2.0
        j = k + i
        if 0 <= j < m:
            N[j] += n / 2
            slopes[j] += t / 2
            bends[j] += c / 2
            continue
        end, inner = (0, 1) if j < 0 else (m - 1, m - 2)
        N[end] += n
        slopes[end] += t
        bends[end] += c
        N[inner] -= n / 2
        slopes[inner] -= t / 2
        bends[inner] -= c / 2


@numba.njit(cache=True)
def _slope(P, v, s, N, slopes, bends, ways) -> float:  # type: ignore[no-untyped-def]
    """-w . p' at s, for points P (m, 3) of a row and a place v (3,); w, p', p'' in `ways`."""
    _spline_weights(s, len(P), N, slopes, bends)
    ways[0], ways[1:] = v, 0.0
    for j in range(len(P)):
        for i in range(3):
            ways[0, i] -= N[j] * P[j, i]
            ways[1, i] += slopes[j] * P[j, i]
            ways[2, i] += bends[j] * P[j, i]
    return -(ways[0] * ways[1]).sum()


@numba.njit(cache=True)
def _closest(P, v, N, slopes, bends, ways) -> float:  # type: ignore[no-untyped-def]
    """Place s of the curve through P (m, 3) that is closest to v (3,), and what `_slope` sets."""
    best, least = 0.0, np.inf
    for k in range(len(P) - 1):
        side, to = P[k + 1] - P[k], v - P[k]
        t = min(max((to * side).sum() / max((side * side).sum(), 1e-300), 0.0), 1.0)
        d = ((to - t * side) ** 2).sum()
        if d < least:
            best, least = k + t, d
    low, high = max(best - 1.0, 0.0), min(best + 1.0, len(P) - 1.0)
    for end, sign in ((low, 1.0), (high, -1.0)):  # beyond an end it is the closest point
        if sign * _slope(P, v, end, N, slopes, bends, ways) >= 0.0:
            return end
    s = best
    for _ in range(60):
        slope = _slope(P, v, s, N, slopes, bends, ways)
        if slope > 0.0:
            high = s
        else:
            low = s
        curve = (ways[1] ** 2).sum() - (ways[0] * ways[2]).sum()
        new = s - slope / curve if curve > 0.0 else -1.0
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - s) <= 1e-15 * len(P):
            break
        s = new
    return s


@numba.njit(cache=True)
def _touch(  # type: ignore[no-untyped-def]
    X, x, pointers, blocks, least, stiffness, weights, slopes, ways, gaps, force
):
    """Energy of all contacts; their forces (n,) and distances. Of vertices that touch the weights
    of their blocks and slopes (m,) in w and p', and w / d, p', and the second derivative of
    |w|^2/2 by s in `ways` (n, 3, 3)."""
    energy = 0.0
    for e in range(len(force)):
        first, m = pointers[e], pointers[e + 1] - pointers[e] - 1
        at = blocks[first : first + m + 1]
        P = X[at[1:]] + x[at[1:]]
        v = X[at[0]] + x[at[0]]
        force[e], gaps[e] = 0.0, np.inf
        reach = least[e]
        for k in range(m - 1):
            reach = max(reach, least[e] + math.sqrt(((P[k + 1] - P[k]) ** 2).sum()))
        near = False
        for k in range(m):
            near |= ((P[k] - v) ** 2).sum() < reach * reach
        if not near:
            continue
        own = slice(first + 1, first + 1 + m)
        curves = np.empty(m)
        s = _closest(P, v, weights[own], slopes[own], curves, ways[e])
        d = math.sqrt((ways[e, 0] ** 2).sum())
        gaps[e] = d
        if not 0.0 < d < least[e]:
            continue
        force[e] = stiffness[e] * (least[e] - d)
        energy += 0.5 * force[e] * (least[e] - d)
        curve = (ways[e, 1] ** 2).sum() - (ways[e, 0] * ways[e, 2]).sum()
        ways[e, 2, 0] = curve if 0.0 < s < m - 1.0 else np.inf
        ways[e, 0] /= d
        weights[first], slopes[first] = 1.0, 0.0
        for q in range(first + 1, first + 1 + m):
            weights[q] = -weights[q]
    return energy


@numba.njit(cache=True)
def _add_forces(pointers, blocks, weights, ways, force, g):  # type: ignore[no-untyped-def]
    for e in range(len(force)):
        if force[e] != 0.0:
            for q in range(pointers[e], pointers[e + 1]):
                for i in range(3):
                    g[blocks[q], i] -= force[e] * weights[q] * ways[e, 0, i]


@numba.njit(cache=True)
def _stiffen(  # type: ignore[no-untyped-def]
    pointers, offsets, stiffness, weights, slopes, ways, gaps, force, exact, values
):
    """Second derivatives of the energies, without the parts of the forces unless `exact`."""
    values[:] = 0.0
    for e in range(len(force)):
        if force[e] == 0.0:
            continue
        n, tangent, curve, d = ways[e, 0], ways[e, 1], ways[e, 2, 0], gaps[e]
        f, pair = (force[e] / d if exact else 0.0), offsets[e]
        for p in range(pointers[e], pointers[e + 1]):
            for q in range(pointers[e], pointers[e + 1]):
                both = weights[p] * weights[q]
                for i in range(3):
                    left = weights[p] * tangent[i] + d * slopes[p] * n[i]
                    for j in range(3):
                        right = weights[q] * tangent[j] + d * slopes[q] * n[j]
                        turn = both * ((1.0 if i == j else 0.0) - n[i] * n[j])
                        turn -= left * right / curve
                        values[pair, i, j] = stiffness[e] * both * n[i] * n[j] - f * turn
                pair += 1


class SideContact(ElementTerm):
    """Contact of cables side by side."""

    name = "side contact"
    exact_hessian = True
    of_cables = True

    def __init__(self, table: Facing) -> None:
        super().__init__(table)
        n, m = len(table.least), len(table.blocks)
        self._weights, self._slopes = np.zeros(m), np.zeros(m)
        self._ways, self._gaps, self._force = np.zeros((n, 3, 3)), np.zeros(n), np.zeros(n)
        self.pattern = ElementPattern(table.pointers, table.blocks)
        self.patterns = (self.pattern,)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the energy; keeps what the gradient needs."""
        t = self.table
        out[0] = _touch(
            self.unknowns.X, x, t.pointers, t.blocks, t.least, t.stiffness, self._weights,
            self._slopes, self._ways, self._gaps, self._force,
        )  # fmt: skip

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        t = self.table
        _add_forces(t.pointers, t.blocks, self._weights, self._ways, self._force, g)

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the rounding errors of this rank's forces, due to the coordinates."""
        t = self.table
        vertices = t.blocks[t.pointers[:-1]]
        far = np.linalg.norm(self.unknowns.X[vertices] + x[vertices], axis=1)
        return float(np.sum((EPSILON * t.stiffness * far)[self._force != 0.0] ** 2))

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the stiffness of what touches, without the geometric part of the forces."""
        self._add(A, exact=False)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        self._add(A, exact=True)

    def _add(self, A: BlockSink, exact: bool) -> None:
        t = self.table
        _stiffen(
            t.pointers, self.pattern.offsets, t.stiffness, self._weights, self._slopes, self._ways,
            self._gaps, self._force, exact, self.pattern.values,
        )  # fmt: skip
        self.pattern.add(A)
