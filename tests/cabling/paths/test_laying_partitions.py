"""A cable is laid to the last digit alike, however the mesh is ordered and shared out."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI
from term_scene import ISOTROPIC, irregular_square

from crms_fenicsx import Cable, Scene
from crms_fenicsx.foundation.meshes import from_arrays
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids, vertex_ids, vertex_nodes
from crms_fenicsx.foundation.runtime.arrays import Array, Integers

ROUTES = {
    "in plan": [(0.0, 33.0), (100.0, 41.0)],
    "around corners": [(0.0, 13.0), (40.0, 91.0), (71.0, 55.0), (100.0, 37.0)],
    "in space": [(0.0, 33.0, 0.0), (43.4, 60.3, 18.2), (100.0, 71.0, 0.0)],
    "between anchors": [(-20.0, 33.0, -5.0), (51.0, 49.0, 40.0)],
}


def whole_mesh() -> tuple[Array, Integers]:
    """Points and cells of a dome, as they are given to make a mesh."""
    mesh = irregular_square(MPI.COMM_SELF, 20.0).mesh
    points = np.zeros((mesh.topology.index_map(0).size_local, 3))
    points[vertex_ids(mesh)] = mesh.geometry.x[vertex_nodes(mesh)]
    return points, cell_vertex_ids(mesh)


def scene_of(comm: MPI.Intracomm, deformed: bool, seed: int) -> Scene:
    """The dome; seeds give its cells another order, and share them out in another way."""
    points, cells = whole_mesh()
    rng = np.random.default_rng(seed)
    ranks = rng.integers(comm.size, size=len(cells)) if seed else None
    scene = clamped(from_arrays(comm, points, rng.permutation(cells), ranks=ranks), ISOTROPIC)
    if deformed:
        bump = np.random.default_rng(7).normal(size=points.shape) * (0.3, 0.3, 1.0)
        scene.u.x.array[:] = bump[scene.membrane.vertex_ids].ravel()
    return scene


@pytest.mark.ranks
@pytest.mark.parametrize("deformed", [False, True])
@pytest.mark.parametrize("route", ROUTES)
def test_on_any_partition(comm: MPI.Intracomm, route: str, deformed: bool) -> None:
    due = scene_of(MPI.COMM_SELF, deformed, 0).lay_cable(Cable(9000.0), ROUTES[route], tension=15.0)
    for seed in range(5):
        cable = scene_of(comm, deformed, seed).lay_cable(Cable(9000.0), ROUTES[route], tension=15.0)
        assert cable.state.nodes == due.state.nodes
        np.testing.assert_array_equal(cable.state.positions, due.state.positions)
        np.testing.assert_array_equal(cable.state.fractions, due.state.fractions)
        np.testing.assert_array_equal(cable.state.lifted, due.state.lifted)
        assert (cable.L0, cable.length) == (due.L0, due.length)
