"""Meshes of DOLFINx become membranes, and their tags groups, which become tags again; the same mesh
with its vertices elsewhere."""

from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from cabled_square import clamped
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, MeshError, Solver, meshes
from crms_fenicsx.foundation.dofs.layout import vertex_places
from crms_fenicsx.foundation.meshes.membrane_mesh import moved, vertex_ids

pytestmark = pytest.mark.ranks

NAMES = {"left half": (2, 4), "front": (1, 7), "corner": (0, 2)}


def tagged(comm: MPI.Intracomm) -> tuple[dolfinx.mesh.Mesh, list[dolfinx.mesh.MeshTags]]:
    """A rectangle, 4 x 3, with its left half, its front and back edge and one corner tagged."""
    mesh = dolfinx.mesh.create_rectangle(comm, [(0.0, 0.0), (4.0, 3.0)], (8, 6))
    marks: list[list[tuple[int, Any]]] = [
        [(2, lambda x: np.isclose(x[0], 4.0) & np.isclose(x[1], 3.0))],
        [(7, lambda x: np.isclose(x[1], 0.0)), (9, lambda x: np.isclose(x[1], 3.0))],
        [(4, lambda x: x[0] <= 2.0 + 1e-9), (5, lambda x: x[0] >= 2.0 - 1e-9)],
    ]
    tags = []
    for dim, of_dim in enumerate(marks):
        mesh.topology.create_entities(dim)
        found = [dolfinx.mesh.locate_entities(mesh, dim, where) for _, where in of_dim]
        values = np.repeat([value for value, _ in of_dim], [len(f) for f in found])
        indices = np.concatenate(found)
        order = np.argsort(indices)
        tags.append(
            dolfinx.mesh.meshtags(mesh, dim, indices[order], values[order].astype(np.int32))
        )
    return mesh, tags


def places(mesh: dolfinx.mesh.Mesh, tags: dolfinx.mesh.MeshTags) -> dict[int, Any]:
    """Midpoints of the tagged entities of all ranks, sorted, by tag."""
    owned = tags.indices < mesh.topology.index_map(tags.dim).size_local
    mesh.topology.create_connectivity(tags.dim, 2)
    middles = dolfinx.mesh.compute_midpoints(mesh, tags.dim, tags.indices[owned])
    values = tags.values[owned]
    whole = mesh.comm.allgather((middles.reshape(-1, 3), values))
    middles, values = (np.concatenate(arrays) for arrays in zip(*whole, strict=True))
    return {
        int(v): np.array(sorted(np.round(middles[values == v], 9).tolist()))
        for v in np.unique(values)
    }


def test_tags_go_in_and_come_out(comm: MPI.Intracomm) -> None:
    mesh, (vertex_tags, facet_tags, cell_tags) = tagged(comm)
    membrane = meshes.from_dolfinx(mesh, cell_tags, facet_tags, vertex_tags, names=NAMES)
    assert set(membrane.parts) == {"left half", "5"}
    assert set(membrane.edges) == {"boundary", "front", "9"}
    assert set(membrane.points) == {"corner"}
    names = NAMES | {"5": (2, 5), "9": (1, 9)}
    for dim, given in enumerate((vertex_tags, facet_tags, cell_tags)):
        back = meshes.mesh_tags(membrane, dim, names)
        there, here = places(mesh, given), places(membrane.mesh, back)
        assert there.keys() == here.keys()
        for tag, middles in there.items():
            np.testing.assert_array_equal(middles, here[tag])
    assert set(meshes.mesh_tags(membrane, 2).values) <= {5}  # those named by numbers


def test_cells_stay_on_their_ranks_with_their_numbers(comm: MPI.Intracomm) -> None:
    mesh, _ = tagged(comm)
    membrane = meshes.from_dolfinx(mesh).mesh
    own, imap = membrane.topology.index_map(2).size_local, mesh.topology.index_map(2)
    numbers = np.asarray(membrane.topology.original_cell_index[:own])
    np.testing.assert_array_equal(
        np.sort(numbers), np.arange(*imap.local_range)
    )  # none went to another rank
    local = (numbers - imap.local_range[0]).astype(np.int32)
    theirs = dolfinx.mesh.compute_midpoints(mesh, 2, local)
    ours = dolfinx.mesh.compute_midpoints(membrane, 2, np.arange(own, dtype=np.int32))
    np.testing.assert_allclose(ours, theirs, atol=1e-14)


def test_a_roof_of_such_a_mesh(comm: MPI.Intracomm) -> None:
    """The same answer as that of the package's own mesh of the same triangles."""
    mesh, (_, facet_tags, _) = tagged(comm)
    own = meshes.rectangle(comm, width=4.0, depth=3.0, size=0.5, structured=True)
    energies = []
    for membrane, where in ((meshes.from_dolfinx(mesh, None, facet_tags), "9"), (own, "back")):
        scene = clamped(membrane, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
        solver = Solver(scene)
        energies.append(solver.advance(pressure=0.1).energy)
        assert solver.reactions(where).total[1] > 0.0
    np.testing.assert_allclose(energies[0], energies[1], rtol=1e-9)


def test_what_is_refused(comm: MPI.Intracomm) -> None:
    mesh, (vertex_tags, facet_tags, cell_tags) = tagged(comm)
    with pytest.raises(MeshError, match="facet_tags are of dimension 2"):
        meshes.from_dolfinx(mesh, facet_tags=cell_tags)
    with pytest.raises(MeshError, match="'ring' to tag 3 of dimension 1, but there are no facet"):
        meshes.from_dolfinx(mesh, cell_tags, names={"ring": (1, 3)})
    with pytest.raises(MeshError, match="'ring' to tag 3 of dimension 1, which no entity"):
        meshes.from_dolfinx(mesh, facet_tags=facet_tags, names={"ring": (1, 3)})
    squares = dolfinx.mesh.create_rectangle(
        comm, [(0.0, 0.0), (1.0, 1.0)], (4, 4), dolfinx.mesh.CellType.quadrilateral
    )
    with pytest.raises(MeshError, match="type quadrilateral and degree 1; pass straight"):
        meshes.from_dolfinx(squares)
    membrane = meshes.from_dolfinx(mesh, cell_tags, facet_tags, vertex_tags)
    with pytest.raises(InputError, match="there is no group 'ring'"):
        meshes.mesh_tags(membrane, 1, {"ring": (1, 3)})
    with pytest.raises(MeshError, match=r"'boundary' and '7' have members in common"):
        meshes.mesh_tags(membrane, 1, {"boundary": (1, 1), "7": (1, 7)})


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
