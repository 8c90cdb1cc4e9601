"""Polygons as lists of their corners: what the package's kernels do, and slow twins of them; and a
twin of what closes the stiffness of a patch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from crms_fenicsx.foundation.runtime.arrays import pointers
from crms_fenicsx.foundation.surface.polygons import fan_facets, split_polygons

Array = npt.NDArray[Any]
Lists = Sequence[Sequence[int]]


def joined(lists: Lists) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Lists in CSR form: pointers, members."""
    sizes = np.array([len(own) for own in lists], dtype=np.int64)
    return pointers(sizes), np.array([k for own in lists for k in own], dtype=np.int64)


def split_cells(rims: Lists, chords: Sequence[Lists]) -> list[list[list[int]]]:
    """Cut polygons along the chords of each; the parts of each."""
    of = pointers(np.array([len(own) for own in chords], dtype=np.int64))
    found = split_polygons(joined(rims), of, joined([chord for own in chords for chord in own]))
    parts: list[list[list[int]]] = [[] for _ in rims]
    for part, cell in zip(np.split(found.corners, found.starts[1:-1]), found.cell, strict=True):
        parts[cell].append(part.tolist())
    return parts


def split_polygon(polygon: Sequence[int], chords: Lists) -> list[list[int]]:
    """Cut one polygon."""
    return split_cells([polygon], [chords])[0]


def facets_of(polygons: Lists) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """The facets of polygons, and their weights."""
    return fan_facets(*joined(polygons))


def split_slowly(polygon: Sequence[int], chords: Lists) -> list[list[int]]:
    """Cut one polygon, chord by chord and from shared point to shared point."""
    parts = [list(polygon)]
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


def closed(K: Array, part: float, held: Array, sliders: dict[int, Array]) -> Array:
    """A dense matrix with its diagonal shifted by a part, without what is not free to move. Shapes:
    held (k, 3); `sliders`: projectors (3, 3) of those in K."""
    traces = np.maximum(np.diag(K).reshape(-1, 3).sum(axis=1), 0.0)
    mean = float(np.exp(np.mean(np.log(traces[traces > 0.0]))))
    P, rest = np.eye(len(K)), np.zeros_like(K)
    for block, components in enumerate(held):
        own = sliders.get(block, np.diag(~components).astype(float))
        at = slice(3 * block, 3 * block + 3)
        P[at, at], rest[at, at] = own, mean * (np.eye(3) - own)
    return P @ (K + np.diag(np.repeat(part * (traces + mean), 3))) @ P + rest
