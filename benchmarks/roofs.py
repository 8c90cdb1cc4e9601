"""Roofs of the demos on which several benchmarks run, and the wind on them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx import IsotropicMembrane, Scene, meshes, nets

RADIUS, HEIGHT, SPACING = 100.0, 28.0, 8.5


def cap(
    unknowns: float, lines: dict[str, NDArray[np.float64]] | None = None
) -> meshes.MembraneMesh:
    """The mesh of the dome of `demos/air_dome.py`, with lines in it if there are any."""
    area = np.pi * (RADIUS**2 + HEIGHT**2)
    size = float(np.sqrt(2 / np.sqrt(3) * area * 3 / unknowns))
    return meshes.spherical_cap(MPI.COMM_WORLD, RADIUS, HEIGHT, size, lines=lines)


def covered(mesh: meshes.MembraneMesh) -> Scene:
    """The dome without cables."""
    scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    scene.fix("boundary")
    return scene


def great_circles(cables: int) -> dict[str, NDArray[np.float64]]:
    """The lines of the dome's cables, as many in each of two families."""
    offsets = SPACING * (np.arange(cables) - (cables - 1) / 2)
    return {
        f"{family}{k + 1}": nets.great_circle(RADIUS, HEIGHT, angle, offset)
        for family, angle in (("A", np.pi / 4), ("B", -np.pi / 4))
        for k, offset in enumerate(offsets)
    }


def suction(away: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pressure coefficients where normals have the component `away` against the wind."""
    return np.interp(away, [-0.9, -0.45, -0.2, 0.2, 0.5, 1.0], [0.7, 0.0, -1.0, -1.0, -0.4, -0.4])
