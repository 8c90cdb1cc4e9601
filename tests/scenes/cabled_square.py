"""Clamped membranes and their load steps; the inflated square with cables, as its reference figures
were computed. Units: kgf, cm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import Delaunay

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.model.materials import MembraneMaterial

SIDE = 100.0
FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
LINEAR = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
CABLE = Cable(EA=32000.0)
PRESSURE = 0.01
KINDS = ("structured", "unstructured", "rotated")


def square(
    comm: MPI.Intracomm, n: int, kind: str = "structured", side: float = SIDE
) -> MembraneMesh:
    """The square with n cells a side: "structured", "unstructured" or a "rotated" lattice."""
    if kind == "rotated":
        return meshes.from_arrays(comm, *rotated_lattice(n))
    return meshes.rectangle(comm, side, side, side / n, structured=kind == "structured")


def rotated_lattice(n: int, angle: float = 0.3) -> tuple[Array, Integers]:
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


def clamped(
    mesh: MembraneMesh, material: MembraneMaterial | Mapping[str, MembraneMaterial] = FOIL,
    **laws: Any,
) -> Scene:  # fmt: skip
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


def advanced(solver: Solver, **loads: Any) -> Solver:
    """The solver, after a load step."""
    solver.advance(**loads)
    return solver


def place(cable: LaidCable, at: float, axis: int = 0) -> Array:
    """Where a cable passes a plane x = at (or another axis), (3,)."""
    x = cable.line
    x = x if x[0, axis] < x[-1, axis] else x[::-1]
    return np.array([np.interp(at, x[:, axis], x[:, i]) for i in range(3)])


def order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Order of convergence with the mesh size, by a fit."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def put(cable: LaidCable, name: str, where: Any, value: Any) -> None:
    """Replace an array of the cable's state, which is read-only, by one with a value somewhere."""
    array = getattr(cable.state, name).copy()
    array[where] = value
    cable.update(**{name: array})
