"""An eighth of a sphere, held in its planes of symmetry."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, Scene, meshes

RADIUS, ET, NU = 5.0, 100.0, 0.3


def octant(comm: MPI.Intracomm, n: int) -> Scene:
    """With n cells on each side; its vertices lie on the sphere."""
    number, points = {}, []
    for i in range(n + 1):
        for j in range(n + 1 - i):
            number[i, j] = len(points)
            place = np.array([i, j, n - i - j], dtype=float)
            points.append(RADIUS * place / np.linalg.norm(place))
    cells = []
    for i in range(n):
        for j in range(n - i):
            cells.append((number[i, j], number[i + 1, j], number[i, j + 1]))
            if i + j < n - 1:
                cells.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    edges = {
        "x": [(number[0, j], number[0, j + 1]) for j in range(n)],
        "y": [(number[j, 0], number[j + 1, 0]) for j in range(n)],
        "z": [(number[j, n - j], number[j + 1, n - j - 1]) for j in range(n)],
    }
    mesh = meshes.from_arrays(comm, np.array(points), np.array(cells), edges=edges)
    scene = Scene(mesh, IsotropicMembrane(E=ET, nu=NU, thickness=1.0))
    for direction in "xyz":
        scene.fix(direction, direction)
    return scene


def stretch(scene: Scene) -> float:
    """Third root of its volume, relative to the stress-free one."""
    cells = scene.V.dofmap.list[: scene.mesh.mesh.topology.index_map(2).size_local]
    corners = scene.membrane.stress_free[cells].reshape(-1, 3, 3)
    volume = abs(scene.comm.allreduce(float(np.linalg.det(corners).sum()))) / 6
    return float((1 + scene.volume / volume) ** (1 / 3))
