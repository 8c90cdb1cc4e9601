"""A sphere sewn of gores and inflated, for tests and benchmarks."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from pattern_surfaces import quarter_sphere

from crms_fenicsx import IsotropicMembrane, Solver, patterns
from crms_fenicsx.foundation.runtime.arrays import Array


def inflated_sphere(
    comm: MPI.Intracomm, gores: int, wrinkling: bool, extra: float = 1.0
) -> tuple[Solver, patterns.Pattern, Array]:
    """A quarter of a sphere of radius 10 cut for section forces of 1.5, stretched more by a factor,
    under the pressure .3, and the radii of its vertices."""
    film = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, wrinkling=wrinkling)
    mesh = quarter_sphere(comm, gores, 8)
    seams = [patterns.edge_line(mesh, name) for name in mesh.edges if name.startswith("seam")]
    pattern = patterns.flatten(
        patterns.cut(mesh, seams), film, shrink=patterns.shrink_for(film, 1.5)
    ).adjusted({f"piece {k + 1}": (extra, extra) for k in range(gores // 4)})
    scene = patterns.sew(pattern)
    scene.fix("x0", "x")
    scene.fix("y0", "y")
    scene.fix(lambda x: np.abs(x[2]) < 1e-9, "z")
    solver = Solver(scene)
    solver.advance(pressure=0.3)
    own = scene.V.dofmap.index_map.size_local
    radii = comm.allgather(np.linalg.norm(scene.positions()[:own], axis=1))
    return solver, pattern, np.concatenate(radii)
