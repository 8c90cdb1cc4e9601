"""Places of cables' points along edges."""

from __future__ import annotations

import numba
import numpy as np

from crms_fenicsx.energies.segments import difference


@numba.njit(cache=True)
def edge_fractions(X, x, pointers, blocks, place, fractions, gradients):  # type: ignore[no-untyped-def]
    """Places on edges, as shares of their lengths (n,), and their derivatives by all blocks."""
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


@numba.njit(cache=True)
def add_slip_forces(pointers, blocks, gradients, force, slope, g):  # type: ignore[no-untyped-def]
    """Add ``sum force * slope * d(fractions)/dx`` to g, (n_blocks, 3)."""
    for k in range(force.shape[0]):
        for q in range(pointers[k], pointers[k + 1]):
            for i in range(3):
                g[blocks[q], i] += force[k] * slope[k] * gradients[q, i]


@numba.njit(cache=True)
def slip_stiffness(pointers, blocks, gradients, stiffness, values):  # type: ignore[no-untyped-def]
    """Put ``stiffness * grad(fraction) grad(fraction)^T`` into `values`, pairs of blocks (m, 3, 3).

    The pairs are those of one node after the other, by rows.
    """
    pair = 0
    for k in range(stiffness.shape[0]):
        for q in range(pointers[k], pointers[k + 1]):
            for p in range(pointers[k], pointers[k + 1]):
                for i in range(3):
                    for j in range(3):
                        values[pair, i, j] = stiffness[k] * gradients[q, i] * gradients[p, j]
                pair += 1


@numba.njit(cache=True)
def add_slip_curvature(X, x, pointers, blocks, place, fractions, gradients, force, values):  # type: ignore[no-untyped-def]
    """Add ``force * Hessian(fraction)`` to such `values`.

    With total the edge's length, u_q its derivatives and s the fraction, the second derivatives are
    ``(sum_q c_q Hessian(d_q) - grad(s) u^T - u grad(s)^T) / total``, c_q = 1 - s before the node
    and -s behind it.
    """
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
