"""Meshes of the reference square: on lines, anyhow, and on a turned lattice."""

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
