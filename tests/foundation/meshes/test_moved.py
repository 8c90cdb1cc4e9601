"""The same mesh with its vertices elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx import meshes
from crms_fenicsx.foundation.dofs.layout import vertex_places
from crms_fenicsx.foundation.meshes.membrane_mesh import moved, vertex_ids


@pytest.mark.ranks
def test_moved(comm: MPI.Intracomm) -> None:
    """Groups, numbers and distribution stay, and so does the first mesh."""
    mesh = meshes.rectangle(comm, 3.0, 2.0, 0.5)
    V = fem.functionspace(mesh.mesh, ("Lagrange", 1, (3,)))
    before = vertex_places(V)
    after = before @ np.array([[1.0, 0.2, 0.0], [0.0, 1.5, 0.0], [0.3, 0.0, 1.0]]).T
    other = moved(mesh, V, after)
    W = fem.functionspace(other.mesh, ("Lagrange", 1, (3,)))
    np.testing.assert_array_equal(vertex_places(W), after)
    np.testing.assert_array_equal(vertex_places(V), before)
    np.testing.assert_array_equal(vertex_ids(other.mesh), vertex_ids(mesh.mesh))
    for name, members in mesh.edges.items():
        dofs = fem.locate_dofs_topological(W, 1, other.edges[name])
        np.testing.assert_array_equal(dofs, fem.locate_dofs_topological(V, 1, members))
    dx = fem.form(fem.Constant(other.mesh, 1.0) * ufl.dx(other.mesh))
    area = comm.allreduce(fem.assemble_scalar(dx))
    exact = 6.0 * np.linalg.norm(np.cross([1.0, 0.0, 0.3], [0.2, 1.5, 0.0]))
    np.testing.assert_allclose(area, exact, rtol=1e-12)
