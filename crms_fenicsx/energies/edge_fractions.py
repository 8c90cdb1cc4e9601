"""Places of cables' points along edges."""

from __future__ import annotations

import numba

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
