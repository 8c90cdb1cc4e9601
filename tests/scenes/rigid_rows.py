"""Meshes of rigid surfaces with a line along a curve, for cables that take their lines along."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from rigid_surfaces import Curve, resampled

from crms_fenicsx import Cable, Friction, IsotropicMembrane, LaidCable, Scene, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh


def row_mesh(
    comm: MPI.Intracomm,
    way: Curve,
    h: float,
    *,
    seed: int = 0,
    diagonals: str = "alternating",
    width: float = 2.0,
    scale: float = 1.0,
) -> MembraneMesh:
    """Two lines of cells on each side of the line "A1", cells `width` h wide and about h long, with
    "alternating" diagonals or all "one way"; with a seed the vertices of the line are uneven."""
    n = round(way.length / h)
    at = np.arange(n + 1.0)
    if seed:
        at[1:-1] += np.random.default_rng(seed).uniform(-0.2, 0.2, n - 1)
    u, v = way.surface.parameters(resampled(way.points, 20 * n + 1))
    u, v = (np.interp(at, np.linspace(0.0, n, len(u)), values) for values in (u, v))
    e = 1e-6
    sides = way.surface.place(u, v + e) - way.surface.place(u, v)
    step = width * h * e / np.linalg.norm(sides, axis=1)
    lines = np.arange(-2.0, 3.0)
    points = way.surface.place(
        np.repeat(u[:, None], 5, axis=1), v[:, None] + step[:, None] * lines
    ).reshape(-1, 3)
    number = np.arange(5 * (n + 1)).reshape(n + 1, 5)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    i, j = np.indices((n, 4)).reshape(2, -1)
    up = ((i + j) % 2 == 0)[:, None] if diagonals == "alternating" else np.ones((4 * n, 1), bool)
    first = np.where(up, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(up, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    row = number[:, 2]
    outside = way.surface.gradient(way.points[len(way.points) // 2])
    return meshes.from_arrays(
        comm, scale * points, np.concatenate([first, second]),
        edges={"A1": np.stack([row[:-1], row[1:]], axis=1)},
        outside=tuple(float(x) for x in outside),
    )  # fmt: skip


def rigid_row(
    comm: MPI.Intracomm,
    way: Curve,
    friction: float | Friction,
    h: float,
    *,
    EA: float = 1.0,
    units: tuple[float, float] = (1.0, 1.0),
    **choices: Any,
) -> tuple[Scene, LaidCable]:
    """A rigid surface with a cable along the line of such a mesh; `units`: of length and force."""
    length, force = units
    E = 1e3 * force / length**2
    membrane = IsotropicMembrane(E=E, nu=0.3, thickness=length, wrinkling=False)
    scene = Scene(row_mesh(comm, way, h, scale=length, **choices), membrane)
    scene.fix(lambda x: np.full(x.shape[1], True))
    return scene, scene.lay_cable(Cable(EA=EA, friction=friction), along="A1")
