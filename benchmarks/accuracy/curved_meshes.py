"""Meshes of hemispheres, spherical caps and half-cylinders with lines in chosen directions."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.meshes import MembraneMesh, from_arrays
from crms_fenicsx.foundation.runtime.arrays import Array, Integers


def rings(n: int) -> tuple[Array, Integers]:
    """Triangles of a circle of radius 1 in `n` hexagonal rings; a line of the mesh is y = 0."""
    points, start = [np.zeros((1, 2))], [0]
    for k in range(1, n + 1):
        angle = 2 * np.pi * np.arange(6 * k) / (6 * k)
        start.append(start[-1] + max(6 * (k - 1), 1))
        points.append(k / n * np.column_stack([np.cos(angle), np.sin(angle)]))
    cells = []
    for k in range(1, n + 1):
        for side in range(6):
            inner = [
                start[k - 1] + (side * (k - 1) + i) % max(6 * (k - 1), 1) for i in range(k + 1)
            ]
            outer = [start[k] + (side * k + i) % (6 * k) for i in range(k + 1)]
            cells += [(outer[i], outer[i + 1], inner[i]) for i in range(k)]
            cells += [(inner[i], outer[i + 1], inner[i + 1]) for i in range(k - 1)]
    return np.concatenate(points), np.array(cells)


def cap(n: int, rim: float, height: float, turn: float = 0.0, out: float = 0.0) -> MembraneMesh:
    """A spherical cap of `rings`, turned about z and grown about the rim's centre.

    Parameters
    ----------
    n
        Number of rings.
    rim, height
        Radius of the rim and height of the top (length).
    turn
        Angle of the line of the mesh from the x axis (rad).
    out
        Share by which all vertices are moved away from the rim's centre.
    """
    flat, cells = rings(n)
    diameter = (rim**2 + height**2) / height
    c, s = np.cos(turn), np.sin(turn)
    flat = diameter * height / rim * flat @ np.array([[c, s], [-s, c]])
    shrink = 1 / (1 + (flat**2).sum(axis=1) / diameter**2)
    points = np.column_stack([flat * shrink[:, None], height - diameter * (1 - shrink)])
    points[-6 * n :, 2] = 0.0
    return from_arrays(MPI.COMM_WORLD, points * (1 + out), cells)


def half_cylinder(
    n: int, radius: float, length: float, share: float, shifted: bool
) -> MembraneMesh:
    """A half-cylinder about the x axis, over z = 0, from x = -length to length.

    Parameters
    ----------
    n
        Number of cells around it.
    radius, length
        Radius and half the length (length).
    share
        Where between two rows of vertices x = 0 lies, from 0 to 1.
    shifted
        Whether every second row is turned by half a cell, so that triangles are equilateral;
        otherwise they are halves of squares.
    """
    h = np.pi * radius / n * (np.sqrt(0.75) if shifted else 1.0)
    m = round(2 * length / h)
    x = -length + 2 * length / m * np.arange(m + 1)
    x -= (x[m // 2] + share * 2 * length / m) * (1 - (x / length) ** 2)
    even, points, rows = np.pi * np.arange(n + 1) / n, [], []
    odd = np.concatenate([[0.0], even[:-1] + even[1] / 2, [np.pi]])
    count = 0
    for i, place in enumerate(x):
        t = odd if shifted and i % 2 else even
        points.append(
            np.column_stack([np.full(len(t), place), radius * np.cos(t), radius * np.sin(t)])
        )
        rows.append(np.arange(len(t)) + count)
        count += len(t)
    cells: list[tuple[int, int, int]] = []
    for i in range(m):
        a, b = rows[i], rows[i + 1]
        if not shifted:
            cells += zip(a[:-1], a[1:], b[1:], strict=True)
            cells += zip(a[:-1], b[1:], b[:-1], strict=True)
            continue
        a, b = (a, b) if i % 2 == 0 else (b, a)
        cells += zip(a[:-1], a[1:], b[1:-1], strict=True)
        cells += zip(b[:-1], b[1:], a, strict=True)
    places = np.concatenate(points)
    places[np.abs(places[:, 2]) < 1e-9 * radius, 2] = 0.0
    return from_arrays(MPI.COMM_WORLD, places, np.array(cells))
