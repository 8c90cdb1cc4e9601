"""A roof on a square whose mesh has lines for cables: two families that cross at vertices."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, meshes
from crms_fenicsx.model.cable import Hold, Net, NetLine
from tests.scenes.grids import alternating, grid, numbered

SIDE, RISE, CELLS = 8.0, 1.2, 8
LINES = {"A1": (0, 3), "A2": (0, 5), "B1": (1, 2)}
"""Family along y (0) or x (1) and number of the grid line, by name."""


def rise(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the roof over its plan."""
    return RISE * np.sin(np.pi * x / SIDE) * np.sin(np.pi * y / SIDE)


def lined_roof(
    comm: MPI.Intracomm = MPI.COMM_WORLD, size: float = 1.0, **groups: list[tuple[int, int]]
) -> meshes.MembraneMesh:
    """The mesh, `size` times as large, with `LINES` and other groups of edges."""
    at = np.linspace(0.0, SIDE, CELLS + 1)
    points, cells = grid(at, at, rise, alternating(CELLS, CELLS))
    numbers = numbered(CELLS + 1, CELLS + 1)
    edges = {
        name: np.stack([row[:-1], row[1:]], axis=1)
        for name, (family, k) in LINES.items()
        for row in [numbers[k] if family == 0 else numbers[:, k]]
    }
    return meshes.from_arrays(comm, size * points, cells, edges={**edges, **groups})


def path_along(name: str, size: float = 1.0) -> NDArray[np.float64]:
    """A path along a line, through its vertices."""
    family, k = LINES[name]
    along, across = np.linspace(0.0, SIDE, CELLS + 1), np.full(CELLS + 1, k * SIDE / CELLS)
    x, y = (across, along) if family == 0 else (along, across)
    return np.asarray(size * np.stack([x, y, rise(x, y)], axis=1))


def net_of_lines(size: float = 1.0) -> Net:
    """The net of the roof's lines."""
    paths = {name: path_along(name, size) for name in LINES}
    lengths = {name: np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for name, x in paths.items()}
    return Net(tuple(NetLine(name, paths[name], float(lengths[name])) for name in LINES), ())


def lined_scene(
    mesh: meshes.MembraneMesh | None = None, *, on_lines: bool, hold: Hold = "pocket",
    cable: Cable | None = None, tension: float = 2.0,
) -> tuple[Scene, tuple[LaidCable, ...]]:  # fmt: skip
    """The roof with a cable on each line, laid along it or by the same path."""
    scene = Scene(
        lined_roof() if mesh is None else mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)
    )
    scene.fix("boundary")
    kind = Cable(EA=2e3) if cable is None else cable
    cables = [
        scene.lay_cable(kind, along=name, hold=hold, tension=tension)
        if on_lines
        else scene.lay_cable(kind, path_along(name), hold=hold, tension=tension, name=name)
        for name in LINES
    ]
    return scene, tuple(cables)
