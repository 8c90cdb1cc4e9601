"""Measure distributed membranes, and collect them on all ranks to look at them as a whole."""

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.membrane_mesh import vertex_nodes
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap


def cell_corners(membrane: MembraneMesh) -> NDArray[np.float64]:
    """Corner coordinates of the owned cells, shape (owned cells, 3, 3)."""
    mesh = membrane.mesh
    owned = mesh.topology.index_map(2).size_local
    return np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[:owned]], dtype=np.float64)


def area_vectors(membrane: MembraneMesh) -> NDArray[np.float64]:
    x = cell_corners(membrane)
    return 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])


def area(membrane: MembraneMesh, part: str | None = None) -> float:
    areas = np.linalg.norm(area_vectors(membrane), axis=1)
    if part is not None:
        areas = areas[membrane.parts[part]]
    return membrane.comm.allreduce(float(areas.sum()))


def total_area_vector(membrane: MembraneMesh) -> NDArray[np.float64]:
    return membrane.comm.allreduce(area_vectors(membrane).sum(axis=0))


def edge_ends(membrane: MembraneMesh, group: str) -> NDArray[np.float64]:
    """End coordinates of the owned edges of a group on all ranks, shape (k, 2, 3)."""
    topology = membrane.mesh.topology
    edges = membrane.edges[group]
    edges = edges[edges < topology.index_map(1).size_local]
    vertices = topology.connectivity(1, 0).array.reshape(-1, 2)[edges]
    ends = membrane.mesh.geometry.x[vertex_nodes(membrane.mesh)[vertices]]
    return np.concatenate(membrane.comm.allgather(ends))


def length(membrane: MembraneMesh, group: str) -> float:
    ends = edge_ends(membrane, group)
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())


def point_places(membrane: MembraneMesh, group: str) -> NDArray[np.float64]:
    """Coordinates of the owned vertices of a group on all ranks, shape (k, 3)."""
    vertices = membrane.points[group]
    vertices = vertices[vertices < membrane.mesh.topology.index_map(0).size_local]
    places = membrane.mesh.geometry.x[vertex_nodes(membrane.mesh)[vertices]]
    return np.concatenate(membrane.comm.allgather(places))


def least_angle(membrane: MembraneMesh) -> float:
    """Smallest angle of all triangles, in degrees."""
    least = 180.0
    for triangle in cell_corners(membrane):
        for k in range(3):
            u = triangle[(k + 1) % 3] - triangle[k]
            v = triangle[(k + 2) % 3] - triangle[k]
            angle = np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)
            least = min(least, float(np.degrees(angle)))
    return membrane.comm.allreduce(least, op=MPI.MIN)


def input_cells(membrane: MembraneMesh) -> NDArray[np.int64]:
    """All cells by the vertex numbers of the input, in the order of the input, on all ranks."""
    mesh = membrane.mesh
    owned = mesh.topology.index_map(2).size_local
    cells = mesh.geometry.input_global_indices[geometry_dofmap(mesh)[:owned]]
    cells = np.concatenate(membrane.comm.allgather(cells))
    origin = mesh.topology.original_cell_index[:owned]
    origin = np.concatenate(membrane.comm.allgather(origin))
    assert np.array_equal(np.sort(origin), np.arange(len(cells)))
    return cells[np.argsort(origin)]


def is_consistently_oriented(cells: NDArray[np.int64]) -> bool:
    """Whether no edge is run through twice in the same direction."""
    seen = set()
    for cell in cells:
        for k in range(3):
            side = (int(cell[k]), int(cell[(k + 1) % 3]))
            if side in seen:
                return False
            seen.add(side)
    return True
