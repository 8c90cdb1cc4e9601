"""The calls that differ between DOLFINx 0.9, 0.10 and 0.11.

Each tests for the feature rather than the version, so that development versions work as well.
"""

from __future__ import annotations

from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx.cpp.graph import AdjacencyList_int32
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers
from crms_fenicsx.foundation.runtime.errors import InputError


def create_mesh(
    comm: MPI.Intracomm,
    cells: Integers,
    points: Array,
    ranks: Indices | None = None,
) -> dolfinx.mesh.Mesh:
    """Create a distributed triangulated surface in space, with P1 geometry and no ghost cells.
    Shapes: cells (m, 3), points (n, 3), ranks (m,)."""
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,), dtype=np.float64)
    # 0.9 takes (comm, cells, x, e), later versions (comm, cells, e, x); the names are the same.
    partitioner = None if ranks is None else lambda *_: AdjacencyList_int32(ranks[:, None])
    return dolfinx.mesh.create_mesh(comm, cells=cells, x=points, e=element, partitioner=partitioner)


def with_nodes(mesh: dolfinx.mesh.Mesh, nodes: Array) -> dolfinx.mesh.Mesh:
    """Return a mesh of the same topology and distribution with coordinates `nodes` (n, 3)."""
    old: Any = mesh._cpp_object
    given = old.geometry
    cmap = given.cmap if hasattr(given, "cmap") else given.cmaps[0]  # several since 0.11
    geometry = type(given)(
        given.index_map(), geometry_dofmap(mesh), cmap, nodes, given.input_global_indices
    )
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,), dtype=np.float64)
    return dolfinx.mesh.Mesh(type(old)(mesh.comm, old.topology, geometry), ufl.Mesh(element))


def default_ranks(comm: MPI.Intracomm, cells: Integers) -> Indices:
    """Return the ranks (m,) to which DOLFINx would send this rank's cells (m, 3). Collective."""
    mode = dolfinx.mesh.GhostMode.none
    try:
        partitioner = dolfinx.mesh.create_cell_partitioner(mode)
    except TypeError:  # newer versions also ask for the most cells per edge: unlimited here
        partitioner = dolfinx.mesh.create_cell_partitioner(mode, None)
    triangles: Any = [dolfinx.mesh.CellType.triangle]
    found = partitioner(comm, comm.size, triangles, [cells.ravel()])
    return np.array(found.array, dtype=np.int32)


def geometry_dofmap(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return the geometry nodes of each local cell, shape (cells on this rank, 3)."""
    geometry: Any = mesh.geometry
    dofmap: Indices = geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap
    return dofmap


def interpolation_points(element: Any) -> NDArray[np.floating]:
    """Return an element's reference points (points, topological dimension), for
    `dolfinx.fem.Expression`. A method in 0.9, a property since 0.10."""
    points: Any = element.interpolation_points
    points = points() if callable(points) else points
    return np.asarray(points)


def direct_solver(comm: MPI.Intracomm) -> str:
    """Default package for factorising a matrix: the fastest that this PETSc has."""
    has = PETSc.Sys.hasExternalPackage
    if comm.size == 1 and (has("cholmod") or has("suitesparse")):
        return "cholmod"
    return "mumps" if has("mumps") else "petsc"


def require_real() -> None:
    """Refuse a DOLFINx whose PETSc scalars are not 64-bit reals."""
    kind = np.dtype(PETSc.ScalarType)
    if kind != np.float64:
        raise InputError(
            f"DOLFINx and PETSc work with numbers of type {kind} here (petsc4py.PETSc.ScalarType), "
            "and crms_fenicsx needs float64; use a build with real numbers: petsc=*=real* of "
            "conda-forge, `source dolfinx-real-mode` in the Docker image dolfinx/dolfinx, "
            "python3-dolfinx-real of Debian and Ubuntu."
        )
