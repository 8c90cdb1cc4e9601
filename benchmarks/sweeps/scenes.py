"""Shared scene of the sweeps: the inflated square, its meshes and its cables.

100 cm wide, clamped, E t = 24 kgf/cm, nu = 0.25, 0.01 kgf/cm2, cables of EA = 32000 kgf.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial

COMM = MPI.COMM_SELF
SIDE, MODULUS, PRESSURE, ROPE = 100.0, 24.0, 0.01, 32000.0
FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)


def square(n: int) -> MembraneMesh:
    """n x n squares, each cut by its diagonal; turned by half it is the same mesh."""
    return meshes.rectangle(COMM, SIDE, SIDE, SIDE / n, structured=True)


def grid(x: Sequence[float] | Array, y: Sequence[float] | Array) -> MembraneMesh:
    """Rectangles between lines at x and y, each cut by its diagonal."""
    X, Y = np.meshgrid(x, y)
    m, n = len(x), len(y)
    a = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).ravel()
    b, c, d = a + 1, a + m + 1, a + m
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return meshes.from_arrays(COMM, np.stack([X.ravel(), Y.ravel()], axis=1), cells)


def clamped(mesh: MembraneMesh, material: MembraneMaterial = FOIL, **how: float) -> Scene:
    """A sheet that is held all around."""
    scene = Scene(mesh, material, **how)  # type: ignore[arg-type]
    scene.fix("boundary")
    return scene


def crossed(
    mesh: MembraneMesh,
    path: Sequence[Sequence[float]],
    *,
    L0: float | None = SIDE,
    EA: float = ROPE,
    pressure: float = PRESSURE,
    steps: int = 1,
    **how: float,
) -> tuple[Solver, LaidCable]:
    """A cable over the square, inflated with it."""
    scene = clamped(mesh, **how)
    cable = scene.lay_cable(Cable(EA), path, L0=L0)
    solver = Solver(scene)
    solver.advance(pressure=pressure, steps=steps)
    return solver, cable


def across(y: float, end: float | None = None) -> list[tuple[float, float]]:
    """A path from the left to the right side."""
    return [(0.0, y), (SIDE, y if end is None else end)]


def top(scene: Scene) -> float:
    """Height of the highest vertex (length)."""
    return float(scene.positions()[:, 2].max())


def heights(scene: Scene) -> Array:
    """Heights of the vertices in the order of their places in plan."""
    x = np.round(scene.V.tabulate_dof_coordinates(), 9)
    return np.asarray(scene.positions()[np.lexsort((x[:, 0], x[:, 1])), 2])
