"""Straight lines and polylines in space, in compiled loops: gaps between them, and pulls."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def passed(line, start, end, normal, margin, reach):  # type: ignore[no-untyped-def]
    """The place of a line (m, 3), a vertex or an edge with what bends it, that a span passes; the
    lowest one where there are several. Returns the height of the span above it along the normal,
    the fraction of the line's length or NaN, the place, the point of the span, whether both are
    within their ends, the place also by the part `margin` beyond, and the line's end, 0 or 1,
    beyond which the span passes by less than the part `reach`, or -1."""
    span, total, before = end - start, 0.0, 0.0
    if len(line) == 1:
        t = _dot(line[0] - start, span) / _dot(span, span)
        above = start + min(max(t, 0.0), 1.0) * span
        return _dot(above - line[0], normal), np.nan, line[0], above, 0.0 < t < 1.0, -1
    for k in range(len(line) - 1):
        total += _size(line[k + 1] - line[k])
    gap, fraction, found, over, is_inside, passed = np.inf, 0.0, line[0], start, False, -1
    is_other = True
    for k in range(len(line) - 1):
        side = line[k + 1] - line[k]
        size = _size(side)
        s, t = apparent_crossing(line[k], line[k + 1], start, end, normal)
        first, last = before == 0.0, before + size >= total * (1 - 1e-12)
        inside = (s > -margin or not first) and (s < 1 + margin or not last) and 0.0 < t < 1.0
        other = (s < 0.0 and not first) or (s > 1.0 and not last)  # it passes another part
        past = -1
        if 0.0 < t < 1.0 and not inside:
            past = 0 if first and -reach < s < 0.0 else past
            past = 1 if last and 1.0 < s < 1 + reach else past
        s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
        place, above = line[k] + s * side, start + t * span
        height = _dot(above - place, normal)
        if (other < is_other) or (other == is_other and height < gap) or k == 0:
            is_other, gap, fraction = other, height, (before + s * size) / total
            found, over, is_inside, passed = place, above, inside, past
        before += size
    return gap, fraction, found, over, is_inside, passed


@numba.njit(cache=True)
def apparent_crossing(a, b, c, d, normal):  # type: ignore[no-untyped-def]
    """Where the lines ab and cd cross, seen along the normal: their parameters."""
    u, v, w = _flat(b - a, normal), _flat(d - c, normal), _flat(c - a, normal)
    area = _triple(u, v, normal)
    if abs(area) <= 1e-12 * (_size(u) * _size(v)):
        return 0.5, 0.5  # the span runs along the edge
    return _triple(w, v, normal) / area, _triple(w, u, normal) / area


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _size(a):  # type: ignore[no-untyped-def]
    return math.sqrt(_dot(a, a))


@numba.njit(cache=True)
def _flat(a, normal):  # type: ignore[no-untyped-def]
    """The part of a vector square to the normal."""
    return a - _dot(a, normal) * normal


@numba.njit(cache=True)
def _triple(a, b, c):  # type: ignore[no-untyped-def]
    """The product of a x b with c."""
    x, y = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
    return x * c[0] + y * c[1] + (a[0] * b[1] - a[1] * b[0]) * c[2]


@numba.njit(cache=True)
def arc_lengths(x, starts):  # type: ignore[no-untyped-def]
    """Lengths of polylines one after the other, from their first points to each one, (n,)."""
    arc = np.zeros(len(x))
    for c in range(len(starts) - 1):
        for k in range(starts[c] + 1, starts[c + 1]):
            square = 0.0
            for i in range(3):
                square += (x[k, i] - x[k - 1, i]) ** 2
            arc[k] = arc[k - 1] + math.sqrt(square)
    return arc


@numba.njit(cache=True)
def pulls(x, arc, ends, stops, at, normals, reaches, least):  # type: ignore[no-untyped-def]
    """Unit pulls of polylines along the normals (n, 3) at some of their points, (n,). A pull is to
    where the polyline is at the distance `reaches` (n,) before and after the point, but not beyond
    `stops` (m,); -1 where that is not farther than the part `least` of its length. Shapes: x
    (m, 3), arc (m,): all points, with lengths up to them; ends (n, 2): where the polylines of the
    points begin and end; at (n,): the points."""
    found = np.full(len(at), -1.0)
    for n in range(len(at)):
        k, first, last = at[n], ends[n, 0], ends[n, 1] - 1
        pull, free = 0.0, True
        if not first < k < last:
            continue
        for step in (-1, 1):
            far = arc[k] + step * reaches[n]
            m = k + step
            while first < m < last and not stops[m] and step * (far - arc[m]) > 0.0:
                m += step
            at_m = step * (far - arc[m]) >= 0.0
            way = abs((arc[m] if at_m else far) - arc[k])
            free = free and way > least * arc[last]
            size, part = 0.0, 0.0
            for i in range(3):
                low = min(m, m - step)
                slope = 0.0 if at_m else (x[low + 1, i] - x[low, i]) / (arc[low + 1] - arc[low])
                place = x[m, i] if at_m else slope * (far - arc[low]) + x[low, i]
                size += (place - x[k, i]) ** 2
                part += (place - x[k, i]) * normals[n, i]
            pull += part / math.sqrt(size) if size > 0.0 else 0.0
        if free:
            found[n] = pull
    return found
