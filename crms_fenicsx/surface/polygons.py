"""Polygons that a surface is cut into, and triangles that they are split into."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from crms_fenicsx.runtime.arrays import Array, Indices, Integers


class Polygons(NamedTuple):
    """Polygons that some cells are cut into.

    Attributes
    ----------
    starts : (n + 1,), corners : (m,)
        Their corners in CSR form.
    cell : (n,)
        Which cell each is a part of.
    """

    starts: Integers
    corners: Integers
    cell: Integers


def fan_facets(starts: Integers, corners: Integers) -> tuple[Indices, Array]:
    """Facets (n, 3) of the mean over the fans from every corner of polygons, with weights (n,).

    The polygons' corners are in CSR form.
    """
    sizes = np.diff(starts)
    numbers: list[Integers] = []
    facets: list[Indices] = [np.zeros((0, 3), dtype=np.int32)]
    weights: list[Array] = [np.zeros(0)]
    for n in np.unique(sizes):
        own = np.flatnonzero(sizes == n)
        fans = _fans(int(n))
        table = corners[starts[own][:, None] + np.arange(n)].astype(np.int32)
        numbers.append(np.repeat(own, len(fans)))
        facets.append(table[:, np.array(list(fans))].reshape(-1, 3))
        weights.append(np.tile(list(fans.values()), len(own)))
    order = np.argsort(np.concatenate(numbers), kind="stable") if numbers else slice(0)
    return np.concatenate(facets)[order], np.concatenate(weights)[order]


@cache
def _fans(n: int) -> dict[tuple[int, int, int], float]:
    """Facets and weights of a polygon whose corners are 0 ... n - 1."""
    facets: dict[tuple[int, int, int], float] = defaultdict(float)
    for first in range(n):
        for i in range(1, n - 1):
            a, b, c = sorted((first, (first + i) % n, (first + i + 1) % n))
            facets[a, b, c] += 1.0 / n
    return facets


def split_polygons(
    rims: tuple[Integers, Integers], chords_of: Integers, chords: tuple[Integers, Integers]
) -> Polygons:
    """Cut cells along chords.

    Parameters
    ----------
    rims
        Corners around the n cells in CSR form.
    chords_of : (n + 1,)
        Where the chords of each cell begin.
    chords
        Points of the chords in CSR form: from one corner to another those inside, which are shared
        by the chords that cross there. A chord's end that is neither a corner nor shared is left
        out.
    """
    return Polygons(*_split_polygons(*rims, chords_of, *chords))


@numba.njit(cache=True)
def _split_polygons(rim_starts, rims, chords_of, chord_starts, chords):  # type: ignore[no-untyped-def]
    """Polygons of all cells: pointers, corners, cells."""
    # Each chord adds at most itself, once in each direction.
    corners = np.empty(len(rims) + 2 * len(chords), dtype=np.int64)
    starts = np.zeros(len(rim_starts) + len(chords), dtype=np.int64)
    cell = np.empty(len(starts), dtype=np.int64)
    n = 0
    for c in range(len(rim_starts) - 1):
        rim = rims[rim_starts[c] : rim_starts[c + 1]]
        own = starts[n:]  # where the parts of this cell begin, and their end
        own[1] = own[0] + len(rim)
        corners[own[0] : own[1]] = rim
        parts = 1
        for chord in range(chords_of[c], chords_of[c + 1]):
            begin, end = chord_starts[chord], chord_starts[chord + 1]
            last = -1
            for k in range(begin, end):
                if _place(corners[own[0] : own[parts]], chords[k]) >= 0:
                    if last >= 0:
                        parts += _split(own, corners, parts, chords[last : k + 1])
                    last = k
        cell[n : n + parts] = c
        n += parts
    return starts[: n + 1].copy(), corners[: starts[n]].copy(), cell[:n].copy()


@numba.njit(cache=True)
def _place(part, point):  # type: ignore[no-untyped-def]
    """Where a point is among corners, or -1."""
    for k in range(len(part)):
        if part[k] == point:
            return k
    return -1


@numba.njit(cache=True)
def _split(starts, corners, parts, line):  # type: ignore[no-untyped-def]
    """Cut the one part that holds both ends of a line along it; return how many that adds."""
    for n in range(parts):
        part = corners[starts[n] : starts[n + 1]].copy()
        i, j = _place(part, line[0]), _place(part, line[-1])
        if i < 0 or j < 0:
            continue
        inner = line[1:-1].copy()
        if i > j:
            i, j, inner = j, i, inner[::-1].copy()
        if len(inner) == 0 and (j - i == 1 or (i == 0 and j == len(part) - 1)):
            continue  # a side of it
        after = corners[starts[n + 1] : starts[parts]].copy()
        first = np.concatenate((part[i : j + 1], inner[::-1]))
        second = np.concatenate((part[j:], part[: i + 1], inner))
        both = np.concatenate((first, second, after))
        corners[starts[n] : starts[n] + len(both)] = both
        more = len(first) + len(second) - len(part)
        for m in range(parts, n, -1):
            starts[m + 1] = starts[m] + more
        starts[n + 1] = starts[n] + len(first)
        return 1
    return 0


def best_fan(points: Array, corners: list[int]) -> Integers:
    """Triangles of a polygon, all from the corner whose smallest triangle is largest, (n, 3).

    A fan from a corner whose neighbour lies on a straight side has a triangle without area.
    """
    rings = [corners[k:] + corners[:k] for k in range(len(corners))]
    fans = np.array(
        [[(r[0], r[i], r[i + 1]) for i in range(1, len(r) - 1)] for r in rings], dtype=np.int64
    )
    sides = points[fans[..., 1:]] - points[fans[..., :1]]
    areas = np.linalg.norm(np.cross(sides[..., 0, :], sides[..., 1, :]), axis=-1)
    best: Integers = fans[np.argmax(areas.min(axis=1))]
    return best
