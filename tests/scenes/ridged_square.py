"""A square that is also held along a line, and a cable's way over its boundary."""

from __future__ import annotations

import numpy as np
from cabled_square import clamped
from mpi4py import MPI
from term_scene import ISOTROPIC

from crms_fenicsx import Cable, Scene, Solver, meshes
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

OBLIQUE = [(-40.0, 15.0, -25.0), (140.0, 71.0, -25.0)]
"""Anchored off both sides of the square, so low that it bends over its boundary."""


def ridged(comm: MPI.Intracomm, size: float = 20.0) -> Scene:
    """A square that is held around and along the line x = 50."""
    mesh = meshes.rectangle(MPI.COMM_SELF, 50.0, 100.0, size).mesh
    half, cells = mesh.geometry.x.copy(), geometry_dofmap(mesh).astype(np.int64)
    # the other half is the mirror image, which shares the vertices of the line
    at_line = np.isclose(half[:, 0], 50.0)
    number = np.where(at_line, np.arange(len(half)), len(half) + np.cumsum(~at_line) - 1)
    other = (half * [-1, 1, 1] + [100, 0, 0])[~at_line]
    line = np.flatnonzero(at_line)
    line = line[np.argsort(half[line, 1])]
    square = meshes.from_arrays(
        comm,
        np.concatenate([half, other]),
        np.concatenate([cells, number[cells][:, ::-1]]),
        edges={"ridge": np.stack([line[:-1], line[1:]], axis=1)},
    )
    scene = clamped(square, ISOTROPIC)
    scene.fix("ridge")
    return scene


def preconditioners(comm: MPI.Intracomm) -> list[str]:
    """PETSc's preconditioners of H0 for that square, before it has a cable and then."""
    scene, kinds = ridged(comm), []
    solver = Solver(scene)
    for cables in (0, 1):
        for _ in range(cables):
            scene.lay_cable(Cable(EA=3200.0), path=OBLIQUE)
        solver.advance(pressure=0.01)
        kinds.append(solver.system.minimizer.h0.pc.getType())
    return kinds
