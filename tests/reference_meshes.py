"""Meshes of the reference problems: a clamped square and a clamped disc."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from scipy.spatial import Delaunay

from crms_fenicsx import meshes

SIDE = 100.0


def square(comm: MPI.Intracomm, n: int, kind: str = "structured") -> meshes.MembraneMesh:
    """The square with n cells a side: "structured", "unstructured" or a "rotated" lattice."""
    if kind == "structured":
        return meshes.rectangle(comm, SIDE, SIDE, SIDE / n, structured=True)
    if kind == "unstructured":
        return meshes.rectangle(comm, SIDE, SIDE, SIDE / n)
    return meshes.from_arrays(comm, *rotated_lattice(n))


def rotated_lattice(n: int, angle: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """A triangular lattice, turned, in a square whose sides are cut into n edges each."""
    h = SIDE / n
    i, j = np.meshgrid(np.arange(-2 * n, 2 * n + 1), np.arange(-2 * n, 2 * n + 1))
    lattice = h * np.stack([i + 0.5 * j, np.sqrt(0.75) * j], axis=-1).reshape(-1, 2)
    c, s = np.cos(angle), np.sin(angle)
    lattice = lattice @ np.array([[c, s], [-s, c]]) + 0.5 * SIDE
    inside = np.all((lattice > 0.6 * h) & (lattice < SIDE - 0.6 * h), axis=1)
    run = np.linspace(0, SIDE, n + 1)[:-1]
    zero, full = np.zeros(n), np.full(n, SIDE)
    sides = [(run, zero), (full, run), (SIDE - run, full), (zero, SIDE - run)]
    boundary = np.concatenate([np.stack(side, axis=1) for side in sides])
    points = np.concatenate([boundary, lattice[inside]])
    return points, Delaunay(points).simplices


def disc(comm: MPI.Intracomm, rings: int, radius: float = 100.0) -> meshes.MembraneMesh:
    """A disc of concentric rings of 6, 12, 18 ... vertices around one in the middle."""
    points, cells = [(0.0, 0.0)], []
    starts = [0]
    for k in range(1, rings + 1):
        starts.append(len(points))
        turn = 2 * np.pi * np.arange(6 * k) / (6 * k)
        points += list(zip(radius * k / rings * np.cos(turn), radius * k / rings * np.sin(turn)))
        for sector in range(6):
            for m in range(k):
                outer = starts[k] + np.array([sector * k + m, (sector * k + m + 1) % (6 * k)])
                n_inner = max(6 * (k - 1), 1)
                inner = starts[k - 1] + np.array(
                    [(sector * (k - 1) + m) % n_inner, (sector * (k - 1) + m + 1) % n_inner]
                )
                cells.append((inner[0], outer[0], outer[1]))
                if m < k - 1:
                    cells.append((inner[0], outer[1], inner[1]))
    return meshes.from_arrays(comm, np.array(points), np.array(cells))
