"""Penalty that keeps unfolded cells triangular: straight sides at the fold points (section 2.5).

Where a chord of a cable meets a side at p, the two angles between the side's halves and the chord
q - p add up to pi in the unfolded cell:

    r = angle(previous, p, q) + angle(next, p, q) - pi                              (2.5-1)

The paper's penalty is ``mu r^2``. By default mu is proportional to the cell's stiffness, mu = c E t
A, and r is weighted with w = 4 a b / (a + b)^2, with the distances a and b to the neighbouring
points on the side, so that a fold point near a vertex, where the angle is ill-defined, does not
lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, BlockSink
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Indices


@dataclass(frozen=True)
class FoldAngles(ElementTable):
    """Intersections of this rank's chords with sides."""

    # (n, 4) blocks: previous point on the side, fold point p, next point on the side, other end q
    # of the chord
    points: Indices
    coefficients: Array  # (n,) mu (force x length)
    weighted: bool  # whether r is weighted with w; False is the paper's penalty
    addresses = ("points",)


@numba.njit(cache=True)
def _unit(X, x, a, b, r):  # type: ignore[no-untyped-def]
    """Unit vector from block a to b into r; returns the distance."""
    d2 = 0.0
    for i in range(3):
        r[i] = X[b, i] - X[a, i] + (x[b, i] - x[a, i])
        d2 += r[i] * r[i]
    d = math.sqrt(d2)
    if d > 0.0:
        for i in range(3):
            r[i] /= d
    return d


@numba.njit(cache=True)
def _cosine_sine(a, b):  # type: ignore[no-untyped-def]
    """Cosine and sine of the angle between two unit vectors; 0, 0 if one vanishes."""
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    c0, c1, c2 = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return cosine, math.sqrt(c0 * c0 + c1 * c1 + c2 * c2)


@numba.njit(cache=True)
def residual(X, x, points, weighted, last, r, dr):  # type: ignore[no-untyped-def]
    """Weighted residuals w r (n,) and their derivatives by the four points, (n, 4, 3), updated
    where the displacements differ from `last` (n, 4, 3)."""
    ra, rb, rq = np.empty(3), np.empty(3), np.empty(3)
    for k in range(points.shape[0]):
        moved = False
        for m in range(4):
            for i in range(3):
                moved |= last[k, m, i] != x[points[k, m], i]
                last[k, m, i] = x[points[k, m], i]
        if not moved:
            continue
        previous, p, following, q = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        a = _unit(X, x, p, previous, ra)
        b = _unit(X, x, p, following, rb)
        d = _unit(X, x, p, q, rq)
        ca, sa = _cosine_sine(ra, rq)
        cb, sb = _cosine_sine(rb, rq)
        # alpha + beta - pi by one arc tangent, as these take long
        value = math.atan2(-sa * cb - ca * sb, sa * sb - ca * cb)
        w, wa, wb = 1.0, 0.0, 0.0
        total = a + b
        if weighted and total > 0.0:
            w = 4 * a * b / total**2
            wa, wb = 4 * b * (b - a) / total**3, 4 * a * (a - b) / total**3
        r[k] = w * value
        # A vanishing length or sine has no direction, hence no force.
        fa = w / (a * sa) if a * sa > 0.0 else 0.0
        fb = w / (b * sb) if b * sb > 0.0 else 0.0
        fqa = w / (d * sa) if d * sa > 0.0 else 0.0
        fqb = w / (d * sb) if d * sb > 0.0 else 0.0
        for i in range(3):
            da = fa * (ca * ra[i] - rq[i]) + value * wa * ra[i]
            db = fb * (cb * rb[i] - rq[i]) + value * wb * rb[i]
            dq = fqa * (ca * rq[i] - ra[i]) + fqb * (cb * rq[i] - rb[i])
            dr[k, 0, i], dr[k, 2, i], dr[k, 3, i] = da, db, dq
            dr[k, 1, i] = -(da + db + dq)


@numba.njit(cache=True)
def _add_angle(ru, rc, u, c, w, out, i, eu, ec):  # type: ignore[no-untyped-def]
    """Add w times the second derivatives of the angle between two vectors to blocks of `out`.

    `ru`, `rc` are their unit vectors, u and c their lengths; the first is vector i of `out`,
    (3, 3, 3, 3), the second vector 2. With the unit vector e orthogonal to r in their plane and the
    plane's normal n, the angle's gradient is e / u and its second derivatives are
    ``(cot n n^T - r e^T - e r^T) / u^2`` and, mixed, ``-n n^T / (u c sin)``. The gradients by both
    vectors are put into eu and ec.
    """
    cosine, sine = _cosine_sine(ru, rc)
    eu[:] = ec[:] = 0.0
    if u * sine == 0.0 or c * sine == 0.0:
        return
    n = (
        (ru[1] * rc[2] - ru[2] * rc[1]) / sine,
        (ru[2] * rc[0] - ru[0] * rc[2]) / sine,
        (ru[0] * rc[1] - ru[1] * rc[0]) / sine,
    )
    for a in range(3):
        eu[a], ec[a] = (cosine * ru[a] - rc[a]) / sine, (cosine * rc[a] - ru[a]) / sine
    cot, uu, cc, uc = cosine / sine, w / u**2, w / c**2, w / (u * c * sine)
    for a in range(3):
        for b in range(3):
            nn = n[a] * n[b]
            out[i, i, a, b] += uu * (cot * nn - ru[a] * eu[b] - eu[a] * ru[b])
            out[2, 2, a, b] += cc * (cot * nn - rc[a] * ec[b] - ec[a] * rc[b])
            out[i, 2, a, b] -= uc * nn
    for a in range(3):
        eu[a] /= u
        ec[a] /= c


@numba.njit(cache=True)
def add_curvature(X, x, points, coefficients, weighted, r, blocks):  # type: ignore[no-untyped-def]
    """Add ``2 mu w r Hessian(w r)`` to blocks (n, 4, 4, 3, 3) of intersections. Vectors 0, 1 and
    2 lead from p to the previous and next point on the side, and along the chord."""
    at = (0, 2, 3)
    unit, H = np.empty((3, 3)), np.empty((3, 3, 3, 3))
    sides, chords = np.empty((2, 3)), np.empty((2, 3))  # gradients of both angles by their vectors
    for k in range(len(r)):
        p = points[k, 1]
        a = _unit(X, x, p, points[k, 0], unit[0])
        b = _unit(X, x, p, points[k, 2], unit[1])
        d = _unit(X, x, p, points[k, 3], unit[2])
        w, wa, wb, waa, wbb, wab = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        s = a + b
        if weighted and s > 0.0:
            w = 4 * a * b / s**2
            wa, wb = 4 * b * (b - a) / s**3, 4 * a * (a - b) / s**3
            waa, wbb = 8 * b * (a - 2 * b) / s**4, 8 * a * (b - 2 * a) / s**4
            wab = 4 * (4 * a * b - a * a - b * b) / s**4
        H[:] = 0.0
        for m in range(2):  # a loop, as each call with a constant would be compiled separately
            _add_angle(unit[m], unit[2], a if m == 0 else b, d, w, H, m, sides[m], chords[m])
        value = r[k] / w if w > 0.0 else 0.0
        fa, fb = value * wa / a if a > 0.0 else 0.0, value * wb / b if b > 0.0 else 0.0
        ra, rb, ga, gb = unit[0], unit[1], sides[0], sides[1]
        for i in range(3):
            for j in range(3):
                same = 1.0 if i == j else 0.0
                H[0, 0, i, j] += fa * (same - ra[i] * ra[j])
                H[1, 1, i, j] += fb * (same - rb[i] * rb[j])
                H[0, 0, i, j] += value * waa * ra[i] * ra[j] + wa * (ra[i] * ga[j] + ga[i] * ra[j])
                H[1, 1, i, j] += value * wbb * rb[i] * rb[j] + wb * (rb[i] * gb[j] + gb[i] * rb[j])
                H[0, 1, i, j] += (
                    value * wab * ra[i] * rb[j] + wa * ra[i] * gb[j] + wb * ga[i] * rb[j]
                )
                gc_j = chords[0, j] + chords[1, j]
                H[0, 2, i, j] += wa * ra[i] * gc_j
                H[1, 2, i, j] += wb * rb[i] * gc_j
        factor = 2 * coefficients[k] * r[k]
        for n in range(3):
            for i in range(3):
                for j in range(3):
                    total = 0.0  # minus the derivative by p, with which all vectors turn
                    for m in range(3):
                        h = factor * (H[m, n, i, j] if m <= n else H[n, m, j, i])
                        blocks[k, at[m], at[n], i, j] += h
                        total += h
                    blocks[k, 1, at[n], i, j] -= total
                    blocks[k, at[n], 1, j, i] -= total
                    blocks[k, 1, 1, i, j] += total


@numba.njit(cache=True)
def _square_slopes(coefficients, dr, blocks):  # type: ignore[no-untyped-def]
    """Put ``2 mu grad(w r) grad(w r)^T`` into blocks (n, 4, 4, 3, 3)."""
    for k in range(len(coefficients)):
        for m in range(4):
            for n in range(4):
                for i in range(3):
                    for j in range(3):
                        blocks[k, m, n, i, j] = 2 * coefficients[k] * dr[k, m, i] * dr[k, n, j]


@numba.njit(cache=True)
def _add_forces(points, coefficients, r, dr, g):  # type: ignore[no-untyped-def]
    for k in range(points.shape[0]):
        factor = 2 * coefficients[k] * r[k]
        for m in range(4):
            for i in range(3):
                g[points[k, m], i] += factor * dr[k, m, i]


class FoldPenalty(ElementTerm):
    """``sum mu (w r)^2`` over the intersections of chords and sides, (2.5-1)."""

    name = "penalty"
    exact_hessian = True
    of_cables = True

    def __init__(self, table: FoldAngles) -> None:
        super().__init__(table)
        n = len(table.points)
        self.residuals, self._dr, self._last = np.zeros(n), np.zeros((n, 4, 3)), np.empty((n, 4, 3))
        """``w r`` at the last sums (rad)."""
        rows, cols = np.repeat(table.points, 4, axis=1), np.tile(table.points, 4)
        self.pattern = BlockPattern(rows.ravel(), cols.ravel())
        self.patterns = (self.pattern,)

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        self._last[:] = np.nan

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the penalty; keeps residuals for the gradient."""
        t = self.table
        residual(self.unknowns.X, x, t.points, t.weighted, self._last, self.residuals, self._dr)
        out[0] = np.dot(t.coefficients, self.residuals * self.residuals)

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        _add_forces(self.table.points, self.table.coefficients, self.residuals, self._dr, g)

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the rounding errors of the forces: those of angle sums near pi."""
        slopes = np.sum(self._dr**2, axis=(1, 2))
        return float(np.sum((2 * self.table.coefficients * EPSILON * np.pi) ** 2 * slopes))

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the Gauss-Newton stiffness ``2 mu grad(w r) grad(w r)^T``."""
        self._slopes_squared()
        self.pattern.add(A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the second derivatives: Gauss-Newton stiffness and ``2 mu w r Hessian(w r)``."""
        t, blocks = self.table, self._slopes_squared()
        add_curvature(
            self.unknowns.X, x, t.points, t.coefficients, t.weighted, self.residuals, blocks
        )
        self.pattern.add(A)

    def _slopes_squared(self) -> Array:
        """Put the Gauss-Newton stiffness, (n, 4, 4, 3, 3), into the pattern's values."""
        blocks = self.pattern.values.reshape(-1, 4, 4, 3, 3)
        _square_slopes(self.table.coefficients, self._dr, blocks)
        return blocks
