"""Straight lines and polylines in space, in compiled loops: gaps between them, and pulls."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def passed(line, start, end, normal, margin, reach):  # type: ignore[no-untyped-def]
    """Lowest point at which a span passes a line (m, 3): a vertex, or an edge with its fold points.
    Returns the height of the span above it along the normal, the fraction of the line's length or
    NaN, the point, the span's point above it, whether both lie within their ends, for the line up
    to `margin` beyond, and the line's end, 0 or 1, beyond which the span passes by less than
    `reach` (relative to a segment), or -1."""
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
        s, t = _apparent_crossing(line[k], line[k + 1], start, end, normal)
        first, last = before == 0.0, before + size >= total * (1 - 1e-12)
        inside = (s > -margin or not first) and (s < 1 + margin or not last) and 0.0 < t < 1.0
        other = (s < 0.0 and not first) or (s > 1.0 and not last)  # it passes another segment
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
def passed_by_spans(points, first, ends, normals, margin, reach):  # type: ignore[no-untyped-def]
    """`passed` of n lines, concatenated in `points` (m, 3) from `first` (n + 1,) on, by the spans
    between `ends` (n, 2, 3), with normals (n, 3)."""
    n = len(ends)
    gaps, fractions, inside = np.empty(n), np.empty(n), np.empty(n, dtype=np.bool_)
    places, above, end = np.empty((n, 3)), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    for i in range(n):
        line, span = points[first[i] : first[i + 1]], ends[i]
        found = passed(line, span[0], span[1], normals[i], margin, reach)
        gaps[i], fractions[i], places[i], above[i], inside[i], end[i] = found
    return gaps, fractions, places, above, inside, end


@numba.njit(cache=True)
def gaps(lower, upper, normals):  # type: ignore[no-untyped-def]
    """Gaps (n,) between segments (n, 2, 3), one above the other along normals (n, 3), where they
    cross or come closest to that."""
    found = np.empty(len(lower))
    for n in range(len(lower)):
        (a, b), (c, d) = lower[n], upper[n]
        s, t = _apparent_crossing(a, b, c, d, normals[n])
        s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
        found[n] = _dot(c + t * (d - c) - a - s * (b - a), normals[n])
    return found


@numba.njit(cache=True)
def gaps_of_polylines(x, first, last, normals):  # type: ignore[no-untyped-def]
    """Smallest gaps (n,) of n pairs of polylines where these cross in the projection along normals
    (n, 3), of the second one above the first; inf where they do not cross. Shapes: x (m, 3): all
    points; first, last (n, 2): of each polyline."""
    found = np.full(len(first), np.inf)
    for n in range(len(first)):
        for i in range(first[n, 0], last[n, 0]):
            for k in range(first[n, 1], last[n, 1]):
                a, b, c, d = x[i], x[i + 1], x[k], x[k + 1]
                if _parallel(b - a, d - c, normals[n]):
                    continue
                s, t = _apparent_crossing(a, b, c, d, normals[n])
                if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                    gap = _dot(c + t * (d - c) - a - s * (b - a), normals[n])
                    found[n] = min(found[n], gap)
    return found


@numba.njit(cache=True)
def _apparent_crossing(a, b, c, d, normal):  # type: ignore[no-untyped-def]
    """Parameters of the crossing of lines ab and cd in the projection along the normal."""
    u, v, w = _flat(b - a, normal), _flat(d - c, normal), _flat(c - a, normal)
    if _parallel(u, v, normal):
        return 0.5, 0.5  # the span runs along the edge
    area = _triple(u, v, normal)
    return _triple(w, v, normal) / area, _triple(w, u, normal) / area


@numba.njit(cache=True)
def _parallel(u, v, normal):  # type: ignore[no-untyped-def]
    """Whether two vectors are parallel in the projection along a normal, or one is zero there."""
    return abs(_triple(u, v, normal)) <= 1e-12 * (_size(u) * _size(v))


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _size(a):  # type: ignore[no-untyped-def]
    return math.sqrt(_dot(a, a))


@numba.njit(cache=True)
def _flat(a, normal):  # type: ignore[no-untyped-def]
    """Component of a vector orthogonal to the normal."""
    return a - _dot(a, normal) * normal


@numba.njit(cache=True)
def _triple(a, b, c):  # type: ignore[no-untyped-def]
    """Triple product (a x b) . c."""
    x, y = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
    return x * c[0] + y * c[1] + (a[0] * b[1] - a[1] * b[0]) * c[2]


@numba.njit(cache=True)
def arc_lengths(x, starts):  # type: ignore[no-untyped-def]
    """Arc lengths (n,) of the points of consecutive polylines, from each one's first point."""
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
    """Unit pulls (n,) of polylines on some of their points along normals (n, 3): from the point to
    the polyline's points at the arc lengths `reaches` (n,) before and behind, but not beyond
    `stops` (m,); -1 if one of these is not farther than the fraction `least` of its length. Shapes:
    x (m, 3), arc (m,): all points, with arc lengths; ends (n, 2): range of each point's polyline;
    at (n,): the points."""
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
