"""Polygons that a surface is cut into, and triangles that they are split into."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import cache

import numpy as np

from crms_fenicsx.runtime.arrays import Array, Indices, Integers


def fan_facets(polygons: Sequence[Sequence[int]]) -> tuple[Indices, Array]:
    """Facets (n, 3) of the mean over the fans from every corner of polygons, with weights (n,)."""
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    numbers: list[Integers] = []
    corners: list[Indices] = [np.zeros((0, 3), dtype=np.int32)]
    weights: list[Array] = [np.zeros(0)]
    for n in np.unique(sizes):
        own = np.flatnonzero(sizes == n)
        fans = _fans(int(n))
        table = np.array([polygons[number] for number in own], dtype=np.int32)
        numbers.append(np.repeat(own, len(fans)))
        corners.append(table[:, np.array(list(fans))].reshape(-1, 3))
        weights.append(np.tile(list(fans.values()), len(own)))
    order = np.argsort(np.concatenate(numbers), kind="stable") if numbers else slice(0)
    return np.concatenate(corners)[order], np.concatenate(weights)[order]


@cache
def _fans(n: int) -> dict[tuple[int, int, int], float]:
    """Facets and weights of a polygon whose corners are 0 ... n - 1."""
    facets: dict[tuple[int, int, int], float] = defaultdict(float)
    for first in range(n):
        for i in range(1, n - 1):
            a, b, c = sorted((first, (first + i) % n, (first + i + 1) % n))
            facets[a, b, c] += 1.0 / n
    return facets


def split_polygon(polygon: list[int], chords: Sequence[Sequence[int]]) -> list[list[int]]:
    """Cut a polygon along chords.

    Parameters
    ----------
    polygon
        Its corners.
    chords
        Points from one corner to another; those between are inside, and shared by the chords that
        cross there. A chord's end that is neither a corner nor shared is left out.
    """
    parts = [polygon]
    for chord in chords:
        line: list[int] = []
        for point in chord:
            if any(point in part for part in parts):
                if line:
                    _split(parts, [*line, point])
                line = [point]
            elif line:
                line.append(point)
    return parts


def _split(parts: list[list[int]], line: list[int]) -> None:
    """Cut the one part that holds both ends of a line along it."""
    a, b, inner = line[0], line[-1], line[1:-1]
    for n, part in enumerate(parts):
        if a in part and b in part:
            i, j = part.index(a), part.index(b)
            if i > j:
                i, j, inner = j, i, inner[::-1]
            if not inner and (j - i == 1 or (i, j) == (0, len(part) - 1)):
                continue  # a side of it
            parts[n : n + 1] = [
                [*part[i : j + 1], *inner[::-1]],
                [*part[j:], *part[: i + 1], *inner],
            ]
            return


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
