"""Penalty that keeps an unfolded cell a triangle: straight sides at the fold points (section 2.5).

Where a chord of a cable meets a side at p, the two angles between the side's halves and the chord
q - p add up to pi once the cell is unfolded:

    r = angle(previous, p, q) + angle(next, p, q) - pi                              (2.5-1)

The literal penalty is ``mu r^2``. By default mu grows with the cell's stiffness, mu = c E t A, and
r is weighted with w = 4 a b / (a + b)^2, a and b the distances to the side's neighbouring points,
so that a fold point near a vertex, where the angle is ill-defined, does not lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.block_patterns import ElementPattern
from crms_fenicsx.dofs.preallocation import RowSizes
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime.arrays import Array, Indices

EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True)
class FoldAngles:
    """Where this rank's chords meet sides.

    Attributes
    ----------
    points : (n, 4)
        Blocks: previous point on the side, fold point p, next point on the side, other end q of
        the chord.
    coefficients : (n,)
        mu (force x length).
    weighted
        Whether r is weighted with w; False is the paper's literal penalty.
    """

    points: Indices
    coefficients: Array
    weighted: bool


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
def _angle(a, b):  # type: ignore[no-untyped-def]
    """Angle between two unit vectors and its cosine and sine."""
    cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    c0, c1, c2 = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    sine = math.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    return math.atan2(sine, cosine), cosine, sine


@numba.njit(cache=True)
def residual(X, x, points, weighted, r, dr):  # type: ignore[no-untyped-def]
    """Weighted residuals w r (n,) and their derivatives by the four points, (n, 4, 3)."""
    ra, rb, rq = np.empty(3), np.empty(3), np.empty(3)
    for k in range(points.shape[0]):
        previous, p, following, q = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        a = _unit(X, x, p, previous, ra)
        b = _unit(X, x, p, following, rb)
        d = _unit(X, x, p, q, rq)
        alpha, ca, sa = _angle(ra, rq)
        beta, cb, sb = _angle(rb, rq)
        value = alpha + beta - math.pi
        w, wa, wb = 1.0, 0.0, 0.0
        total = a + b
        if weighted and total > 0.0:
            w = 4 * a * b / total**2
            wa, wb = 4 * b * (b - a) / total**3, 4 * a * (a - b) / total**3
        r[k] = w * value
        # A vanishing length or sine leaves no direction: no force then.
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
def _add_forces(points, coefficients, r, dr, g):  # type: ignore[no-untyped-def]
    for k in range(points.shape[0]):
        factor = 2 * coefficients[k] * r[k]
        for m in range(4):
            for i in range(3):
                g[points[k, m], i] += factor * dr[k, m, i]


class FoldPenalty(EnergyTerm):
    """``sum mu (w r)^2`` over the places where a chord meets a side, (2.5-1).

    Parameters
    ----------
    table
        This rank's places.
    """

    name = "penalty"
    of_cables = True

    def __init__(self, table: FoldAngles) -> None:
        self.table = table
        n = len(table.points)
        self.residuals, self._dr = np.zeros(n), np.zeros((n, 4, 3))
        """``w r`` of each place at the last sums (rad)."""
        pointers = np.arange(0, 4 * n + 1, 4, dtype=np.int32)
        self.pattern = ElementPattern(pointers, table.points.reshape(-1))

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the penalty; keeps residuals for the gradient."""
        t = self.table
        residual(self.unknowns.X, x, t.points, t.weighted, self.residuals, self._dr)
        out[0] = np.dot(t.coefficients, self.residuals * self.residuals)

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the penalty's nodal forces."""
        _add_forces(self.table.points, self.table.coefficients, self.residuals, self._dr, g)

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the forces that rounding leaves: angles sum up to pi, less pi."""
        slopes = np.sum(self._dr**2, axis=(1, 2))
        return float(np.sum((2 * self.table.coefficients * EPSILON * np.pi) ** 2 * slopes))

    def count_stiffness(self, sizes: RowSizes) -> None:
        """Count the blocks of the stiffness."""
        self.pattern.count(sizes)

    def add_stiffness(self, x: Array, sums: Array, A: PETSc.Mat) -> None:
        """Add the Gauss-Newton stiffness ``2 mu grad(w r) grad(w r)^T``."""
        scaled = self._dr * np.sqrt(2 * self.table.coefficients)[:, None, None]
        np.einsum(
            "kma,knb->kmnab", scaled, scaled,
            out=self.pattern.values.reshape(len(scaled), 4, 4, 3, 3),
        )  # fmt: skip
        self.pattern.add(A, self.unknowns)
