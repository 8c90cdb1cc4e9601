"""Triangles of grids of vertices, of which most surfaces of the tests are made."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

WAVES = ((1, 1), (3, 2))
"""Half waves along x and y of hills."""


def triangles(numbers: ArrayLike, other: ArrayLike = False) -> Ints:
    """Two cells for each square of a grid, one after the other, (2 n m, 3), upward if the first
    index goes along x and the second along y.

    Parameters
    ----------
    numbers
        (n + 1, m + 1) vertices; those of a ring are given once more at its end.
    other
        Which squares (n, m) are cut from (1, 0) to (0, 1), the others from (0, 0) to (1, 1).
    """
    k = np.asarray(numbers, dtype=np.int64)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    turned = np.broadcast_to(other, a.shape)[..., None]
    first = np.where(turned, np.stack([a, b, d], -1), np.stack([a, b, c], -1))
    second = np.where(turned, np.stack([b, c, d], -1), np.stack([a, c, d], -1))
    return np.stack([first, second], axis=-2).reshape(-1, 3)


def numbered(n: int, m: int, *, by_rows: bool = False) -> Ints:
    """Numbers of a grid's n x m vertices, those along y one after the other, or those along x."""
    return np.arange(n * m).reshape(m, n).T if by_rows else np.arange(n * m).reshape(n, m)


def alternating(n: int, m: int) -> NDArray[np.bool_]:
    """Every other one of n x m squares, beginning with the second."""
    return np.asarray(np.indices((n, m)).sum(axis=0) % 2 == 1)


def grid(
    x: ArrayLike,
    y: ArrayLike,
    z: Callable[[Floats, Floats], Floats] = lambda x, y: 0.0 * x,
    other: ArrayLike = False,
    *,
    by_rows: bool = False,
) -> tuple[Floats, Ints]:
    """Points (n m, 3) over lines at n places x and m places y, and `triangles` of them."""
    X, Y = np.meshgrid(x, y, indexing="ij")
    numbers = numbered(*X.shape, by_rows=by_rows)
    points = np.empty((X.size, 3))
    points[numbers] = np.stack([X, Y, z(X, Y)], axis=-1)
    return points, triangles(numbers, other)


def hills(n: int, draws: np.random.Generator) -> tuple[Floats, Ints]:
    """A square of 100 on hills, of n by n squares cut by one diagonal and the other in turn, whose
    inner vertices are moved at random."""

    def height(x: Floats, y: Floats) -> Floats:
        a, b = (np.sin(k * np.pi * x / 100) * np.sin(m * np.pi * y / 100) for k, m in WAVES)
        return np.asarray(12 * a + 3 * b)

    line = np.linspace(0.0, 100.0, n + 1)
    points, cells = grid(line, line, height, ~alternating(n, n), by_rows=True)
    inner = (np.abs(points[:, :2] - 50) < 49).all(axis=1)
    points[inner, :2] += draws.uniform(-1, 1, (inner.sum(), 2)) * 20 / n
    return points, cells
