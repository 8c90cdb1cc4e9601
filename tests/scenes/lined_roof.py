"""A roof on a square whose mesh has lines for cables: two families that cross at vertices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from grids import Floats, alternating, grid, numbered
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.cable import Net, NetLine

SIDE, RISE, CELLS = 8.0, 1.2, 8
LINES = {"A1": (0, 3), "A2": (0, 5), "B1": (1, 2)}
"""Family along y (0) or x (1) and number of the grid line, by name."""
STEEL = Cable(EA=2e3)


def rise(x: Floats, y: Floats) -> Floats:
    """Height of the roof over its plan."""
    return np.asarray(RISE * np.sin(np.pi * x / SIDE) * np.sin(np.pi * y / SIDE))


def lined_roof(
    comm: MPI.Intracomm,
    edges: Mapping[str, Sequence[tuple[int, int]]] | None = None,
    scale: float = 1.0,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> MembraneMesh:
    """The mesh, `scale` times as large and moved to an origin, with `LINES` and other groups."""
    at = np.linspace(0.0, SIDE, CELLS + 1)
    points, cells = grid(at, at, rise, alternating(CELLS, CELLS))
    numbers = numbered(CELLS + 1, CELLS + 1)
    rows = {name: (numbers[k], numbers[:, k])[family] for name, (family, k) in LINES.items()}
    lines = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    return meshes.from_arrays(
        comm, scale * points + origin, cells, edges={**lines, **(edges or {})}
    )


def path_along(name: str) -> Floats:
    """A path along a line, through its vertices."""
    family, k = LINES[name]
    along, across = np.linspace(0.0, SIDE, CELLS + 1), np.full(CELLS + 1, k * SIDE / CELLS)
    x, y = (across, along) if family == 0 else (along, across)
    return np.stack([x, y, rise(x, y)], axis=1)


def net_of_lines(names: Sequence[str] = tuple(LINES)) -> Net:
    """The net of the roof's lines."""
    return Net(tuple(NetLine(name, path_along(name), SIDE) for name in names), ())


def bare_scene(mesh: MembraneMesh) -> Scene:
    """The roof, held at its rim, without cables."""
    scene = Scene(mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))
    scene.fix("boundary")
    return scene


def lined_scene(
    mesh: MembraneMesh, on_lines: bool, cable: Cable = STEEL, **options: Any
) -> tuple[Scene, tuple[LaidCable, ...]]:
    """The roof with a cable on each line, laid along it, or by path."""
    scene = bare_scene(mesh)
    given: dict[str, Any] = {"hold": "pocket", "tension": 2.0, **options}
    cables = [
        scene.lay_cable(cable, along=name, **given)
        if on_lines
        else scene.lay_cable(cable, path_along(name), name=name, **given)
        for name in LINES
    ]
    return scene, tuple(cables)
