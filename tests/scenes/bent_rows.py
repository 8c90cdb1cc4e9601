"""Sheets with a line that bows sideways, for cables that pull it straight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from grids import Floats, alternating, grid, numbered
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh

LONG, WIDE, RISE = 8.0, 4.0, 1.0


def bent_mesh(
    comm: MPI.Intracomm, cells: int = 8, bow: float = 0.2, wide: Sequence[int] = (2,)
) -> MembraneMesh:
    """A vault over a rectangle of `cells` by half as many cells, whose rows `wide` are lines "A2",
    ..., and bow sideways with the rest of the mesh."""

    def place(x: Floats, y: Floats) -> Floats:
        return np.asarray(RISE * np.sin(np.pi * x / LONG) + 0.0 * y)

    across = cells // 2
    points, triangles = grid(
        np.linspace(0.0, LONG, cells + 1), np.linspace(0.0, WIDE, across + 1), place,
        alternating(cells, across),
    )  # fmt: skip
    aside = np.sin(np.pi * points[:, 0] / LONG) * np.sin(np.pi * points[:, 1] / WIDE)
    points[:, 1] += bow * aside
    numbers = numbered(cells + 1, across + 1)
    lines = {f"A{k}": np.stack([numbers[:-1, k], numbers[1:, k]], axis=1) for k in wide}
    return meshes.from_arrays(comm, points, triangles, edges=lines)


def bent_row(
    comm: MPI.Intracomm, *, rigid: bool, cells: int = 8, bow: float = 0.2, prestress: float = 0.0
) -> tuple[Scene, LaidCable]:
    """The vault, held everywhere or at its rim, with a cable along its line that is 1 % short."""
    material = IsotropicMembrane(
        E=800.0, nu=0.3, thickness=1.0, prestress=prestress, wrinkling=False
    )
    scene = Scene(bent_mesh(comm, cells, bow), material)
    scene.fix("boundary")
    if rigid:
        scene.fix(lambda x: np.full(x.shape[1], True))
    cable = scene.lay_cable(Cable(EA=500.0), along="A2")
    cable.update(L0=0.99 * cable.L0)
    return scene, cable
