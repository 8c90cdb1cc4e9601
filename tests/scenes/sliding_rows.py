"""The inflated square with a cable along a row of its mesh that slides, as its reference figures
were computed (kgf, cm), in any units and place; and two oblique rows that cross."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from cabled_square import SIDE, clamped
from grids import Floats, alternating, grid, numbered
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh

PRESSURE, EA = 0.01, 32000.0
OBLIQUE = {"a": ((0.0, 20.0), (100.0, 75.0)), "b": ((0.0, 85.0), (100.0, 35.0))}
Place = Callable[[Floats], Floats]


def rowed_mesh(
    comm: MPI.Intracomm,
    k: int,
    bow: float = 0.0,
    across: float | None = None,
    place: Place = lambda p: p,
) -> MembraneMesh:
    """k by k squares with the row "A" at y = 30, its middle at 30 + `bow`, and "B" at x = `across`,
    placed anywhere."""
    at, numbers = np.linspace(0.0, SIDE, k + 1), numbered(k + 1, k + 1)
    points, cells = grid(at, at, other=alternating(k, k))
    j = round(0.3 * k)
    for i, x in enumerate(at):
        y = 0.3 * SIDE + bow * np.sin(np.pi * x / SIDE)
        points[numbers[i], 1] = np.interp(np.arange(k + 1), [0, j, k], [0.0, y, SIDE])
    rows = {"A": numbers[:, j]}
    if across is not None:
        rows["B"] = numbers[round(across / SIDE * k)]
    edges = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    return meshes.from_arrays(comm, place(points), cells, edges=edges)


def rowed(
    mesh: MembraneMesh, length: float = SIDE, *, hold: str = "outside", **options: Any
) -> tuple[Solver, LaidCable]:
    """The cable on "A", in kgf and cm."""
    scene = clamped(mesh)
    cable = scene.lay_cable(Cable(EA), along="A", L0=length, hold=hold)
    return Solver(scene, **{"rtol": 1e-10, **options}), cable


def oblique(comm: MPI.Intracomm, k: int) -> tuple[Solver, list[LaidCable]]:
    """Two rows that cross, each with a cable of its first length."""
    scene = clamped(meshes.rectangle(comm, SIDE, SIDE, SIDE / k, lines=dict(OBLIQUE)))
    cables = [scene.lay_cable(Cable(EA), along=name) for name in OBLIQUE]
    return Solver(scene, rtol=1e-10), cables


def in_units(mesh: MembraneMesh, length: float, force: float) -> tuple[Solver, LaidCable, float]:
    """The cable on "A" of a mesh in a unit of which `length` are a cm, `force` a kgf; its solver
    and the pressure."""
    area = force / length**2
    fabric = IsotropicMembrane(E=300.0 * area, nu=0.25, thickness=0.08 * length)
    scene = Scene(mesh, fabric)
    scene.fix("boundary")
    cable = scene.lay_cable(Cable(EA * force), along="A", L0=SIDE * length)
    return Solver(scene, rtol=1e-10), cable, PRESSURE * area


def row_places(cable: LaidCable) -> Floats:
    """Stress-free places of the cable's inner vertices in order, (n, 3)."""
    places = cable.reference_positions
    return np.asarray(places[np.isfinite(places[:, 0])])


def tensions(cables: Mapping[str, LaidCable] | list[LaidCable]) -> list[float]:
    """Tensions in order."""
    return [c.tension for c in (cables.values() if isinstance(cables, Mapping) else cables)]
