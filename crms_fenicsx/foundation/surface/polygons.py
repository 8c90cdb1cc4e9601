"""Polygons that cut cells consist of, and their triangulations."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from typing import NamedTuple

import numba
import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


class Polygons(NamedTuple):
    """Polygons that cells are cut into."""

    starts: Integers  # starts (n + 1,), corners (m,): corners in CSR form
    corners: Integers
    cell: Integers  # (n,) cell of each polygon


def fan_facets(starts: Integers, corners: Integers) -> tuple[Indices, Array]:
    """Facets (n, 3) and weights (n,) of the mean over the fans from all corners of polygons."""
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


def fan_owners(starts: Integers) -> Integers:
    """Polygon of each of the facets of `fan_facets`, (n,)."""
    sizes = np.diff(starts)
    counts = [len(_fans(int(n))) for n in sizes]
    return np.repeat(np.arange(len(sizes)), np.array(counts, dtype=np.int64))


@cache
def _fans(n: int) -> dict[tuple[int, int, int], float]:
    """Facets and weights of a polygon with corners 0 ... n - 1."""
    facets: dict[tuple[int, int, int], float] = defaultdict(float)
    for first in range(n):
        for i in range(1, n - 1):
            a, b, c = sorted((first, (first + i) % n, (first + i + 1) % n))
            facets[a, b, c] += 1.0 / n
    return facets


def split_polygons(
    rims: tuple[Integers, Integers], chords_of: Integers, chords: tuple[Integers, Integers]
) -> Polygons:
    """Cut cells, given by their rims, along chords; those of cell c begin at `chords_of[c]`."""
    n, starts, corners, cell = _split_polygons(*rims, chords_of, *chords)
    return Polygons(starts[: n + 1], corners[: starts[n]], cell[:n])


# Plain loops instead of slices in the functions below, as they compile several times as fast.


@numba.njit(cache=True)
def _split_polygons(rim_starts, rims, chords_of, chord_starts, chords):  # type: ignore[no-untyped-def]
    """Polygons of all cells: number, pointers, corners, cells; the arrays may be longer."""
    # Each chord adds at most its own points, once in each direction.
    corners = np.empty(len(rims) + 2 * len(chords), dtype=np.int64)
    part = np.empty(len(corners), dtype=np.int64)
    starts = np.zeros(len(rim_starts) + len(chords), dtype=np.int64)
    cell = np.empty(len(starts), dtype=np.int64)
    n = np.int64(0)  # a constant would make numba compile the callees twice
    for c in range(len(rim_starts) - 1):
        first = n
        starts[n + 1] = starts[n] + rim_starts[c + 1] - rim_starts[c]
        for k in range(starts[n], starts[n + 1]):
            corners[k] = rims[rim_starts[c] + k - starts[n]]
        n += 1
        for chord in range(chords_of[c], chords_of[c + 1]):
            last: int | np.int64 = np.int64(-1)
            for k in range(chord_starts[chord], chord_starts[chord + 1]):
                if _place(corners, starts[first], starts[n], chords[k]) >= 0:
                    if last >= 0 and _split(starts, corners, first, n, chords, last, k, part):
                        n += 1
                    last = k
        for m in range(first, n):
            cell[m] = c
    return n, starts, corners, cell


@numba.njit(cache=True)
def _place(corners, begin, end, point):  # type: ignore[no-untyped-def]
    """Position of a point among corners `begin` ... `end` - 1, relative to `begin`, or -1."""
    for k in range(begin, end):
        if corners[k] == point:
            return k - begin
    return -1


@numba.njit(cache=True)
def _split(starts, corners, first, n, points, begin, end, part):  # type: ignore[no-untyped-def]
    """Cut the polygon among `first` ... n - 1 that contains both ends of the line of points `begin`
    ... `end`, with `part` as workspace; return whether there is one."""
    inner = end - begin - 1
    for m in range(first, n):
        start, stop = starts[m], starts[m + 1]
        i = _place(corners, start, stop, points[begin])
        j = _place(corners, start, stop, points[end])
        if i < 0 or j < 0:
            continue
        if inner == 0 and (abs(j - i) == 1 or abs(j - i) == stop - start - 1):
            continue  # the line is a side of the polygon
        head, step = begin + 1, 1  # inner points of the line, from corner i to corner j
        if i > j:
            i, j, head, step = j, i, end - 1, -1
        for k in range(start, stop):
            part[k - start] = corners[k]
        more = 2 * inner + 2
        for k in range(starts[n] - 1, stop - 1, -1):
            corners[k + more] = corners[k]
        at = start
        for k in range(i, j + 1):
            corners[at] = part[k]
            at += 1
        for k in range(inner - 1, -1, -1):
            corners[at] = points[head + step * k]
            at += 1
        middle = at
        for k in range(j, stop - start + i + 1):
            corners[at] = part[k % (stop - start)]
            at += 1
        for k in range(inner):
            corners[at] = points[head + step * k]
            at += 1
        for k in range(n, m, -1):
            starts[k + 1] = starts[k] + more
        starts[m + 1] = middle
        return True
    return False


def best_fans(points: Array, starts: Integers, corners: Integers) -> tuple[Integers, Integers]:
    """Fan triangulations (n, 3) of polygons, each from the corner that maximises the smallest area,
    and the polygon of each triangle (n,)."""
    # a fan from a corner beside a straight angle has a degenerate triangle
    sizes = np.diff(starts)
    triangles: list[Integers] = [np.zeros((0, 3), dtype=np.int64)]
    polygons: list[Integers] = [np.zeros(0, dtype=np.int64)]
    for n in np.unique(sizes):
        own, turns = np.flatnonzero(sizes == n), np.arange(n)
        rings = corners[starts[own][:, None, None] + (turns[:, None] + turns) % n]
        apex = np.broadcast_to(rings[..., :1], rings[..., 2:].shape)
        fans = np.stack([apex, rings[..., 1:-1], rings[..., 2:]], axis=-1)  # (p, n, n - 2, 3)
        sides = points[fans[..., 1:]] - points[fans[..., :1]]
        areas = np.linalg.norm(np.cross(sides[..., 0, :], sides[..., 1, :]), axis=-1)
        best = areas.min(axis=2).argmax(axis=1)
        triangles.append(fans[np.arange(len(own)), best].reshape(-1, 3))
        polygons.append(np.repeat(own, n - 2))
    order = np.argsort(np.concatenate(polygons), kind="stable")
    return np.concatenate(triangles)[order], np.concatenate(polygons)[order]
