"""Meshes each of whose cells is divided into four."""

import numpy as np
import pytest

from crms_fenicsx import InputError, MeshError, meshes
from crms_fenicsx.meshes.cell_geometry import area_vectors
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.points import CellPoint, EdgePoint, VertexPoint
from crms_fenicsx.surface.uniform_refinement import UniformRefinement

TENT = np.array([(0, 0, 0), (1, 0, 1), (2, 0, 0), (0, 1, 0), (1, 1, 1), (2, 1, 0)], dtype=float)
TENT_CELLS = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)]


def refined(mesh, times=1, project=None):
    for _ in range(times):
        mesh = UniformRefinement.of(mesh, project).finer
        project = None
    return mesh


def nodes(mesh):
    """The vertices of the cells of this rank, (n, 3)."""
    return mesh.mesh.geometry.x


def count(mesh, dim):
    return mesh.mesh.topology.index_map(dim).size_global


def total(comm, mesh, cells=None):
    own = mesh.mesh.topology.index_map(2).size_local
    areas = np.linalg.norm(area_vectors(mesh.mesh), axis=1)
    cells = np.arange(own) if cells is None else cells[cells < own]
    return comm.allreduce(areas[cells].sum())


def test_rectangle_is_the_structured_one_of_half_the_size(comm):
    coarse = meshes.rectangle(comm, 4.0, 2.0, 1.0, structured=True)
    fine = refined(coarse)
    assert (count(fine, 0), count(fine, 1), count(fine, 2)) == (45, 108, 64)
    assert np.allclose(total(comm, fine), 8.0, rtol=1e-12)
    for name, length in (("boundary", 24), ("left", 4), ("front", 8)):
        own = fine.edges[name]
        own = own[own < fine.mesh.topology.index_map(1).size_local]
        assert comm.allreduce(len(own)) == length, name
    normals = area_vectors(fine.mesh)
    assert (normals[:, 2] > 0).all()  # the same side is outside
    assert set(fine.points) == set(coarse.points)


def test_cells_stay_on_the_rank_of_their_parents(comm):
    def all_on_the_last(midpoints):
        return np.full(len(midpoints), comm.size - 1)

    fine = refined(meshes.circle(comm, 1.0, 0.5, ranks=all_on_the_last))
    own = fine.mesh.topology.index_map(2).size_local
    assert own == (count(fine, 2) if comm.rank == comm.size - 1 else 0)


SHAPES = {
    "circle": (lambda comm: meshes.circle(comm, 2.0, 1.0, center=(1.0, 3.0)), np.pi * 4.0),
    "ellipse": (lambda comm: meshes.ellipse(comm, 2.0, 1.0, 0.7), np.pi * 2.0),
    "cap": (lambda comm: meshes.spherical_cap(comm, 4.0, 2.0, 1.5), np.pi * 20.0),
    "bubble": (lambda comm: meshes.spherical_cap(comm, 3.0, 4.0, 1.5), np.pi * 25.0),
}


@pytest.mark.parametrize("name", SHAPES)
def test_new_vertices_lie_on_the_surface_that_the_generator_knows(comm, name):
    """The missing area goes with the square of the size."""
    make, area = SHAPES[name]
    mesh, missing = make(comm), []
    for _ in range(3):
        missing.append(area - total(comm, mesh))
        mesh = refined(mesh)
    rates = np.log2(np.divide(missing[:-1], missing[1:]))
    assert np.all(np.abs(rates - 2.0) < 0.15), rates
    if name == "cap":
        x = nodes(mesh)
        assert np.abs(np.linalg.norm(x - (0.0, 0.0, -3.0), axis=1) - 5.0).max(initial=0.0) < 1e-12


def test_hall_stays_a_hall(comm):
    x = nodes(refined(meshes.air_hall(comm, 4.0, 6.0, 1.5, 1.3), 2))

    def rise(s):
        return np.sqrt(1 - np.maximum(1 - s / 2.0, 0.0) ** 2)

    u, v = np.minimum(x[:, 0], 4.0 - x[:, 0]), np.minimum(x[:, 1], 6.0 - x[:, 1])
    assert np.abs(x[:, 2] - 1.5 * rise(u) * rise(v)).max(initial=0.0) < 1e-9


def arrays_of(comm, mesh, **more):
    """A mesh as arrays, so that nothing is known of its surface; on one process only."""
    return meshes.from_arrays(comm, nodes(mesh), geometry_dofmap(mesh.mesh), **more)


def test_mesh_of_arrays_follows_the_smooth_surface_behind_it():
    from mpi4py import MPI

    comm = MPI.COMM_SELF
    coarse = arrays_of(comm, meshes.spherical_cap(comm, 4.0, 2.0, 0.8))
    x = nodes(refined(coarse))
    off = np.abs(np.linalg.norm(x - (0.0, 0.0, -3.0), axis=1) - 5.0)
    rim = np.hypot(x[:, 0], x[:, 1]) > 3.9
    assert off[~rim].max() < 1e-3  # the facets are 16e-3 inside
    assert np.allclose(off[rim & (off > 1e-9)], 0.016, atol=0.006)  # chords of the boundary


def test_ridges_and_planes_keep_their_shape(comm):
    fine = refined(meshes.from_arrays(comm, TENT, TENT_CELLS), 2)
    x = nodes(fine)
    assert np.abs(x[:, 2] - (1 - np.abs(x[:, 0] - 1))).max(initial=0.0) < 1e-14


def test_a_function_says_where_new_vertices_belong(comm):
    flat = meshes.rectangle(comm, 1.0, 1.0, 0.5, structured=True)
    fine = refined(flat, 2, project=lambda x: np.stack([x[0], x[1], 0.1 * x[0] * (1 - x[0])]))
    x = nodes(fine)
    new = ~np.isclose(x[:, 0] % 0.5, 0.0) | ~np.isclose(x[:, 1] % 0.5, 0.0)
    height = 0.1 * x[:, 0] * (1 - x[:, 0])
    assert np.allclose(x[new, 2], height[new], atol=1e-14)
    assert np.allclose(x[~new, 2], 0.0)  # vertices stay


@pytest.mark.parametrize(
    ("project", "message"),
    [
        (lambda x: x[:2], r"project returned an array of shape \(2, 16\).*\(3, 16\)"),
        (lambda x: x * np.nan, "project returned .*nan"),
        (lambda x: 0 * x, "has no area"),
    ],
)
def test_refused_functions(comm, project, message):
    flat = meshes.rectangle(comm, 1.0, 1.0, 0.5, structured=True)
    with pytest.raises(InputError, match=message) as error:
        UniformRefinement.of(flat, project)
    assert isinstance(error.value, MeshError) == ("area" in message)


def test_seams_parts_and_hidden_cells(comm):
    """A wall below a roof, cut in two by it."""
    x = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0), (1, 0, -1), (1, 1, -1)]
    cells = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (1, 6, 7), (1, 7, 4)]
    coarse = meshes.from_arrays(
        comm, x, cells, parts={"roof": [0, 1, 2, 3], "wall": [4, 5]}, edges={"seam": [(1, 4)]},
        outside={"wall": (1, 0, 0)},
    )  # fmt: skip
    fine = refined(coarse)
    assert np.isclose(total(comm, fine, fine.parts["wall"]), 1.0)
    assert np.isclose(total(comm, fine, fine.hidden), 1.0)
    vertices = count(fine, 0)
    assert vertices == 8 + 13  # the seam is not torn: 13 edges
    assert comm.allreduce(len(fine.edges["seam"])) == 2


def test_places_and_fields_are_where_they_were(comm):
    """On a flat mesh a linear field is carried over exactly, and so are places."""
    coarse = meshes.rectangle(comm, 1.0, 1.0, 0.5)
    refinement = UniformRefinement.of(coarse)
    corners = comm.bcast(cell_vertex_ids(coarse.mesh)[:1].tolist())[0]
    rng = np.random.default_rng(5)
    a, b, c = sorted(corners)
    places = [
        VertexPoint(a),
        EdgePoint((a, b), 0.2),
        EdgePoint((b, c), 0.5),
        EdgePoint((a, c), 0.7),
    ]
    places += [CellPoint((a, b, c), tuple(w)) for w in rng.dirichlet((1, 1, 1), 6)]
    found = refinement.places(places)
    assert isinstance(found[2], VertexPoint)

    def table(mesh):
        every = comm.allgather((np.asarray(cell_vertex_ids(mesh.mesh)).ravel(),
                                nodes(mesh)[geometry_dofmap(mesh.mesh).ravel()]))  # fmt: skip
        return {int(v): x for ids, xs in every for v, x in zip(ids, xs, strict=True)}

    old, new = table(coarse), table(refinement.finer)
    for before, after in zip(places, found, strict=True):
        was = sum(w * old[v] for v, w in zip(before.support, before.weights, strict=True))
        now = sum(w * new[v] for v, w in zip(after.support, after.weights, strict=True))
        assert np.allclose(was, now, atol=1e-14)
    along = refinement.along_edges([VertexPoint(a), VertexPoint(b)])
    assert len(along) == 3
    assert np.allclose(new[along[1].vertex], (old[a] + old[b]) / 2)

    ids = np.array(sorted(new), dtype=np.int64)
    mine = np.array(sorted(old), dtype=np.int64)
    values = np.array([old[int(v)] @ np.diag((2.0, -3.0, 1.0)) for v in mine])
    edge = (a, b)
    carried = refinement.carried(mine, values, ids, {edge: np.array([0.0, 0.0, 7.0])})
    expected = np.array([new[int(v)] @ np.diag((2.0, -3.0, 1.0)) for v in ids])
    expected[ids == along[1].vertex, 2] += 7.0
    assert np.allclose(carried, expected, atol=1e-13)
