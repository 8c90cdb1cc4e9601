"""Adaptive mesh refinement by the estimated error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from crms_fenicsx.design.study.values import Build, built
from crms_fenicsx.foundation.meshes.cell_division import refine
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.runtime.arguments import Count, Positive, collective
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.solver import Solver

SAME = 1e-4
"""Relative difference below which shares are equal, such as those of mirrored cells: solver
tolerance and summation order on several ranks cause such differences."""


@collective
def adapt(
    build: Build,
    mesh: MembraneMesh,
    *,
    tolerance: Positive = 0.01,
    levels: Count = 8,
    share: float = 0.5,
    project: Callable[[Array], Array] | None = None,
) -> Solver:
    """Refine a mesh where its estimated error is large, down to a tolerance. Collective.

    The user's function builds and solves each level anew, on the mesh of the level before with the
    cells of `marked_cells` bisected.

    Parameters
    ----------
    build
        As for `convergence`.
    mesh
        The first mesh.
    tolerance
        Estimated relative error of the energy at which to stop; see `Solver.estimate_error`.
    levels
        Largest number of meshes, this one included.
    share, project
        As for `marked_cells` and `meshes.refine`.

    Returns
    -------
    Solver
        Solver of the last level; its mesh is ``solver.scene.mesh``.

    Raises
    ------
    InputError
        On all ranks: no such function, an invalid share, tolerance or number of levels, an
        estimated error of zero, or a scene on another mesh than the given one.
    ConvergenceError, PathError
        From `build` on one of the meshes.

    Examples
    --------
    >>> mesh = meshes.spherical_cap(MPI.COMM_WORLD, 20.0, 10.0, size=8.0)
    >>> solver = study.adapt(build, mesh, tolerance=0.05)
    >>> solver.estimate_error().relative
    """
    solver = built("adapt", build, mesh)
    for _ in range(levels - 1):
        if solver.estimate_error().relative <= tolerance:
            break
        cells = marked_cells(solver, share)
        own, there = (one.mesh.topology.index_map(2) for one in (mesh, solver.scene.mesh))
        with raised_together(mesh.comm):
            if own.size_local != there.size_local:
                raise InputError(
                    f"adapt: build made a scene of {there.size_global} cells on a mesh of "
                    f"{own.size_global}; use the mesh passed to it."
                )
        mesh = refine(mesh, cells, project=project)
        solver = built("adapt", build, mesh)
    return solver


@collective
def marked_cells(solver: Solver, share: Positive = 0.5) -> Indices:
    """Find the fewest cells that have a given share of the estimated error. Collective.

    Cells are marked by decreasing error in `Solver.estimate_error`, equal ones together
    (W. Doerfler, A convergent adaptive algorithm for Poisson's equation, 1996).

    Parameters
    ----------
    solver
        A solver in equilibrium.
    share
        Share of the estimated error, more than 0 and up to 1, which marks nearly all cells.

    Returns
    -------
    ndarray
        Local numbers of this rank's marked cells (n,), the same cells on any number of ranks.

    Raises
    ------
    InputError
        On all ranks: an invalid share, or an estimated error of zero.

    Examples
    --------
    >>> finer = meshes.refine(solver.scene.mesh, study.marked_cells(solver))
    """
    if share > 1.0:
        raise InputError(f"marked_cells: share = {share} is more than 1, all of the error.")
    return _fewest(solver.comm, solver.estimate_error().cells, share)


def _fewest(comm: MPI.Intracomm, shares: Array, share: float) -> Indices:
    """Local indices of the fewest cells (n,) with a share of the sum of `shares` (m,)."""
    gathered = comm.gather(shares)
    least = 0.0
    if gathered is not None:
        falling = -np.sort(-np.concatenate(gathered))
        sums = np.cumsum(falling)
        if sums[-1] > 0.0:
            enough = int(np.argmax(sums >= (1.0 - SAME) * share * sums[-1]))
            least = (1.0 - SAME) * float(falling[enough])
    least = comm.bcast(least)
    if least == 0.0:
        raise InputError(
            "marked_cells: the estimated error is zero; load the scene, or use meshes.refine."
        )
    return np.flatnonzero(shares >= least).astype(np.int32)
