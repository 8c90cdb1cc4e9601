"""The inflated square with cables, as its reference figures were computed. Units: kgf, cm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from reference_meshes import SIDE, square

from crms_fenicsx import Cable, IsotropicMembrane, Scene
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial

FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
LINEAR = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
CABLE = Cable(EA=32000.0)
PRESSURE = 0.01
KINDS = ("structured", "unstructured", "rotated")


def clamped(mesh: MembraneMesh, material: MembraneMaterial = FOIL, **laws: Any) -> Scene:
    """A stress-free sheet, held all around."""
    scene = Scene(mesh, material, **laws)
    scene.fix("boundary")
    return scene


def sheet(
    comm: MPI.Intracomm, n: int, kind: str = "structured", material: MembraneMaterial = FOIL,
    *, side: float = SIDE, **laws: Any,
) -> Scene:  # fmt: skip
    """A flat square with n cells a side, stress-free but for its prestress, held all around."""
    return clamped(square(comm, n, kind, side), material, **laws)


def place(cable: LaidCable, at: float, axis: int = 0) -> np.ndarray:
    """Where a cable passes a plane x = at (or another axis), (3,)."""
    x = cable.line
    x = x if x[0, axis] < x[-1, axis] else x[::-1]
    return np.array([np.interp(at, x[:, axis], x[:, i]) for i in range(3)])


def order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Order of convergence with the mesh size, by a fit."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])
