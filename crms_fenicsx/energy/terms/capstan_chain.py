"""Distribution of a cable's unstressed length over its spans, with friction along the axis.

A cable is a chain of m spans with friction at the m - 1 nodes between them. Span k has the current
length l_k and the unstressed length

    d_k = rest_k + s_k - rest_(k-1) - s_(k-1),

with the unstressed arc length rest_k that would lie at node k without slip, and the slip s_k; at
the ends 0 and L0 take their place. The slips minimise one of two convex functions,

    ENERGY   sum EA/2 <l_k - d_k>^2 / d_k  +  sum B_k eps_k f(s_k/eps_k)
    LAW      sum (d_k ln d_k + (l_k - d_k) ln(l_k - d_k))  +  sum m_k eps_k f(s_k/eps_k)

with f as in `energy.terms.lateral_friction`. ENERGY is the potential for given friction
bounds B_k. LAW is Coulomb's law itself: the derivative of its first sum by d_k is minus the
logarithm of the span's strain, so at the minimum ``ln(T_(k+1)/T_k) = -m_k f'(s_k/eps_k)``, with m_k
the coefficient of friction times the wrap angle: a sliding node has exactly the capstan ratio
exp(m_k), a sticking one less.

Both are solved by Newton's method with a line search, to rounding; the Hessian is tridiagonal. The
unknowns are the slips rather than arc lengths, as slips of sticking nodes are far below the
rounding of arc lengths.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from crms_fenicsx.energy.terms.lateral_friction import friction_force
from crms_fenicsx.foundation.runtime.arrays import EPSILON

ENERGY, LAW = 0, 1
MAX_ITERATIONS = 1000
ROUNDING = 32 * EPSILON
"""Force residual at convergence, relative to the stiffness of the spans."""
INSIDE = 0.9
"""Largest step, relative to the one that makes a span's unstressed length or strain vanish."""
LEAST = 1e-9
"""Stiffness of a slack span, relative to that of a taut one; it only limits the steps."""


@numba.njit(cache=True, inline="always")
def _force(kind, span, d):  # type: ignore[no-untyped-def]
    """Minus the derivative of a span's function by d, relative to EA."""
    if kind == LAW:
        return math.log((span - d) / d)
    if d >= span:
        return 0.0
    e = (span - d) / d
    return e + 0.5 * e * e


@numba.njit(cache=True, inline="always")
def _stiffness(kind, span, d):  # type: ignore[no-untyped-def]
    if kind == LAW:
        return span / (d * (span - d))
    if d >= span:
        return LEAST / span
    return span * span / (d * d * d)


@numba.njit(cache=True)
def _slope(kind, span, d, change, s, p, t, bound, eps):  # type: ignore[no-untyped-def]
    """Directional derivative along a step p of the slips, with change `change` of d, at t p."""
    total = 0.0
    for k in range(span.shape[0]):
        total -= _force(kind, span[k], d[k] + t * change[k]) * change[k]
    for k in range(s.shape[0]):
        total += friction_force(s[k] + t * p[k], bound[k], eps[k]) * p[k]
    return total


@numba.njit(cache=True)
def spread_evenly(span, rest, L0, s):  # type: ignore[no-untyped-def]
    """Slips (m - 1,) with which all spans have the same strain."""
    total, passed = span.sum(), 0.0
    for k in range(s.shape[0]):
        passed += span[k]
        s[k] = L0 * passed / total - rest[k]


@numba.njit(cache=True)
def unstressed(rest, L0, s, d):  # type: ignore[no-untyped-def]
    """Put the spans' unstressed lengths into d (m,); return the smallest."""
    m = d.shape[0]
    least = np.inf
    for k in range(m):
        d[k] = rest[k] - rest[k - 1] if 0 < k < m - 1 else L0
        if k == m - 1 and k > 0:
            d[k] -= rest[k - 1]
        elif k == 0 and m > 1:
            d[k] = rest[0]
        if k < m - 1:
            d[k] += s[k]
        if k > 0:
            d[k] -= s[k - 1]
        least = min(least, d[k])
    return least


@numba.njit(cache=True)
def find_slips(kind, span, rest, L0, bound, eps, s, d):  # type: ignore[no-untyped-def]
    """Find the slips that minimise one of the functions. Shapes and units: span (m,) (length), rest
    (m - 1,) (length), L0 (length), bound (m - 1,), eps (m - 1,) (length), s (m - 1,) (length), d
    (m,) (length). Returns the number of iterations, -1 if there were too many."""
    m = span.shape[0]
    bad = unstressed(rest, L0, s, d) <= 0.0
    for k in range(m):
        # The gradient of a slack span vanishes; a span without unstressed length is so stiff that
        # the others are lost in rounding beside it.
        bad = bad or d[k] >= span[k] or d[k] < (1.0 - INSIDE) * span[k]
    if bad:
        spread_evenly(span, rest, L0, s)
        unstressed(rest, L0, s, d)
    n = m - 1
    if n == 0:
        return 0
    g, p, diagonal, upper = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    change = np.zeros(m)
    best, stalled = np.inf, 0
    for iteration in range(MAX_ITERATIONS):
        residual = 0.0
        size = 0.0
        for k in range(n):
            left, right = _stiffness(kind, span[k], d[k]), _stiffness(kind, span[k + 1], d[k + 1])
            before, after = _force(kind, span[k], d[k]), _force(kind, span[k + 1], d[k + 1])
            g[k] = after - before + friction_force(s[k], bound[k], eps[k])
            diagonal[k], upper[k] = left + right, -right
            if bound[k] > 0.0:
                y = abs(s[k]) / eps[k]
                if kind == ENERGY and y > 0.0 and (d[k] >= span[k] or d[k + 1] >= span[k + 1]):
                    # beside a slack span friction is what moves the node, back by its whole slip
                    diagonal[k] += friction_force(s[k], bound[k], eps[k]) / s[k]
                else:
                    diagonal[k] += 2.0 * bound[k] / eps[k] * max(1.0 - y, 0.0)
            residual = max(residual, abs(g[k]))
            # rounding errors of span and d in the forces
            size = max(size, 1.0 if kind == ENERGY else max(left * d[k], right * d[k + 1]))
        if residual <= ROUNDING * size:
            # a further step would only change the last digits
            return iteration
        stalled = stalled + 1 if residual >= best and residual < 1e3 * ROUNDING * size else 0
        best = min(best, residual)
        if stalled > 2:
            return iteration
        # diagonally dominant: no pivoting
        p[0] = -g[0]
        for k in range(1, n):
            ratio = upper[k - 1] / diagonal[k - 1]
            diagonal[k] -= ratio * upper[k - 1]
            p[k] = -g[k] - ratio * p[k - 1]
        p[n - 1] /= diagonal[n - 1]
        for k in range(n - 2, -1, -1):
            p[k] = (p[k] - upper[k] * p[k + 1]) / diagonal[k]
        change[0], change[n] = p[0], -p[n - 1]
        for k in range(1, n):
            change[k] = p[k] - p[k - 1]
        top = 1.0
        for k in range(m):
            if d[k] + top * change[k] <= (1.0 - INSIDE) * d[k]:
                top = -INSIDE * d[k] / change[k]
            if kind == LAW and d[k] + top * change[k] >= span[k] - (1.0 - INSIDE) * (
                span[k] - d[k]
            ):
                top = INSIDE * (span[k] - d[k]) / change[k]
        t, low, high = top, 0.0, top
        begin = 0.0
        for k in range(n):
            begin += g[k] * p[k]
        for _ in range(60):
            here = _slope(kind, span, d, change, s, p, t, bound, eps)
            if abs(here) <= 0.1 * abs(begin) or (t == top and here <= 0.0):
                break
            if here > 0.0:
                high = t
            else:
                low = t
            t = 0.5 * (low + high)
        for k in range(n):
            s[k] += t * p[k]
        unstressed(rest, L0, s, d)
    return -1
