"""Finer meshes: all cells divided into four, or some of them bisected."""

import numpy as np
import pytest
from grids import grid

from crms_fenicsx import InputError, MeshError, meshes
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.meshes.triangles import area_vectors
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

TENT = np.array([(0, 0, 0), (1, 0, 1), (2, 0, 0), (0, 1, 0), (1, 1, 1), (2, 1, 0)], dtype=float)
TENT_CELLS = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)]


def refined(mesh, times=1, project=None):
    for _ in range(times):
        mesh = meshes.refine(mesh, project=project)
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


@pytest.mark.ranks
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


@pytest.mark.ranks
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


@pytest.mark.ranks
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
        meshes.refine(flat, project=project)
    assert isinstance(error.value, MeshError) == ("area" in message)


@pytest.mark.ranks
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


def corners(mesh):
    """Corners of this rank's own cells, (n, 3, 3)."""
    own = mesh.mesh.topology.index_map(2).size_local
    return mesh.mesh.geometry.x[geometry_dofmap(mesh.mesh)[:own]]


def near(mesh, place, distance):
    """Own cells whose midpoints are near a place."""
    gaps = np.linalg.norm(corners(mesh).mean(axis=1) - place, axis=1)
    return np.flatnonzero(gaps < distance).astype(np.int32)


def adapted(mesh, times=1, place=(0.0, 0.0, 0.0), distance=0.3, project=None):
    for _ in range(times):
        mesh = meshes.refine(mesh, near(mesh, place, distance), project=project)
    return mesh


def area(comm, mesh, cells):
    own = cells[cells < mesh.mesh.topology.index_map(2).size_local]
    return comm.allreduce(np.linalg.norm(area_vectors(mesh.mesh)[own], axis=1).sum())


def length(comm, mesh, name):
    """Length of a group of edges, each on the rank that owns it."""
    topology, own = mesh.mesh.topology, mesh.edges[name]
    own = own[own < topology.index_map(1).size_local]
    ends = topology.connectivity(1, 0).array.reshape(-1, 2)[own]
    nodes = np.empty(topology.index_map(0).size_local + topology.index_map(0).num_ghosts, int)
    nodes[topology.connectivity(2, 0).array] = geometry_dofmap(mesh.mesh).ravel()
    x = mesh.mesh.geometry.x[nodes[ends]]
    return comm.allreduce(np.linalg.norm(x[:, 1] - x[:, 0], axis=1).sum())


def two_parts(comm, **how):
    """A square of two parts with a named line between them and a named corner."""
    x, cells = grid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5))
    left, line = x[cells].mean(axis=1)[:, 0] < 0, np.arange(10, 15)
    return meshes.from_arrays(
        comm, x, cells, edges={"line": np.column_stack([line[:-1], line[1:]])},
        parts={"left": np.flatnonzero(left), "right": np.flatnonzero(~left)},
        point_groups={"corner": [0]}, **how,
    )  # fmt: skip


def test_groups_keep_their_areas_and_lengths(comm):
    fine = adapted(two_parts(comm), 3)
    assert fine.mesh.topology.index_map(2).size_global > 100
    for part in ("left", "right"):
        assert area(comm, fine, fine.parts[part]) == pytest.approx(2.0, rel=1e-12)
    assert length(comm, fine, "line") == pytest.approx(2.0, rel=1e-12)
    assert length(comm, fine, "boundary") == pytest.approx(8.0, rel=1e-12)
    assert np.all(area_vectors(fine.mesh)[:, 2] > 0.0)  # the same side is outside
    assert comm.allreduce(len(fine.points["corner"])) >= 1
    n = [fine.mesh.topology.index_map(k).size_global for k in (0, 1, 2)]
    assert n[0] - n[1] + n[2] == 1  # no hole, no vertex on a side


def canonical(comm, mesh):
    """All cells by their vertices' ids in the order of the mesh, and the places of these."""
    own = mesh.mesh.topology.index_map(2).size_local
    rows = comm.allgather((
        np.asarray(mesh.mesh.topology.original_cell_index)[:own],
        np.asarray(cell_vertex_ids(mesh.mesh))[:own],
        corners(mesh),
    ))  # fmt: skip
    numbers, ids, x = (np.concatenate([row[k] for row in rows]) for k in range(3))
    order = np.argsort(numbers)
    return ids[order], x[order]


@pytest.mark.ranks
@pytest.mark.parametrize("shape", ["grid", "equilateral", "cap"])
def test_mesh_is_the_same_however_it_is_shared_out(comm, shape):
    """Also where sides of cells are equally long; and with a rank that has no cell."""
    from mpi4py import MPI

    def make(comm, **how):
        if shape == "grid":
            return two_parts(comm, **how)
        if shape == "cap":
            return meshes.spherical_cap(comm, 1.0, 0.4, 0.2, **how)
        rows = np.arange(-4, 5)
        x = np.array([(i + j / 2, j * np.sqrt(0.75)) for j in rows for i in rows]) / 4
        n = np.arange(81).reshape(9, 9)
        a, b, c, d = n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]
        cells = np.stack([a, b, d, b, c, d], axis=-1).reshape(-1, 3)
        return meshes.from_arrays(comm, x, cells, **how)

    def scattered(midpoints):
        return np.random.default_rng(1).integers(0, max(comm.size - 1, 1), len(midpoints))

    ids, x = canonical(MPI.COMM_SELF, adapted(make(MPI.COMM_SELF), 3))
    assert len(ids) > 100
    for how in ({}, {"ranks": scattered}):
        theirs, places = canonical(comm, adapted(make(comm, **how), 3))
        assert np.array_equal(theirs, ids)
        assert np.array_equal(places, x)


@pytest.mark.ranks
def test_bisected_cells_stay_on_the_rank_of_their_parents(comm):
    mesh = meshes.circle(comm, 1.0, 0.5, ranks=lambda x: np.full(len(x), comm.size - 1))
    fine = adapted(mesh)
    own = fine.mesh.topology.index_map(2)
    assert own.size_local == (own.size_global if comm.rank == comm.size - 1 else 0)


def quality(comm, mesh):
    """The least angle (rad), and the greatest ratio of longest side to least height."""
    x = corners(mesh)
    sides = np.roll(x, -1, axis=1) - x
    lengths = np.linalg.norm(sides, axis=2)
    angles = np.pi - np.arccos(
        (sides * np.roll(sides, 1, axis=1)).sum(axis=2) / (lengths * np.roll(lengths, 1, axis=1))
    )
    doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    ratios = lengths.max(axis=1) ** 2 / doubled
    every = comm.allgather((angles.min(initial=9.0), ratios.max(initial=0.0)))
    return min(one[0] for one in every), max(one[1] for one in every)


BISECTED = {
    "grid": lambda comm: meshes.rectangle(comm, 2.0, 2.0, 0.25, structured=True),
    "free": lambda comm: meshes.rectangle(comm, 2.0, 2.0, 0.25),
    "cap": lambda comm: meshes.spherical_cap(comm, 2.0, 1.0, 0.4),
}


@pytest.mark.parametrize("name", BISECTED)
def test_cells_keep_their_shape(comm, name):
    """After 3 divisions no angle is less than half of the least one, as Rivara's theorem says.

    New vertices of the cap move to the sphere, which takes little off. Aspect ratios (longest side
    over least height; 1.15 for equilateral triangles) are 2.0, 3.5 and 3.5, from 2.0, 2.2 and 2.1.
    """
    mesh = BISECTED[name](comm)
    angle, ratio = quality(comm, mesh)
    least, most = quality(comm, adapted(mesh, 3, (0.7, 0.6, 0.8 * (name == "cap")), 0.6))
    assert least >= 0.5 * angle * (0.98 if name == "cap" else 1.0 - 1e-12)
    assert most <= 1.8 * ratio
    assert (least < 0.99 * angle) == (name != "grid")  # halved squares stay halved squares


def test_new_vertices_of_bisected_cells_lie_on_the_surface(comm):
    x = adapted(meshes.spherical_cap(comm, 4.0, 2.0, 1.5), 2, (4.0, 0.0, 0.0), 2.0)
    x = x.mesh.geometry.x
    assert np.abs(np.linalg.norm(x - (0.0, 0.0, -3.0), axis=1) - 5.0).max(initial=0.0) < 1e-12
    fine = adapted(two_parts(comm), project=lambda x: np.stack([x[0], x[1], 0.1 + 0 * x[2]]))
    x = fine.mesh.geometry.x
    new = (np.abs(x[:, :2] * 2 % 1.0) > 1e-9).any(axis=1)
    assert np.allclose(x[:, 2], np.where(new, 0.1, 0.0))
    assert comm.allreduce(int(new.sum())) > 0
    with pytest.raises(InputError, match=r"project returned an array of shape \(2, "):
        adapted(two_parts(comm), project=lambda x: x[:2])


def test_seams_are_not_torn(comm):
    """A wall below a roof, cut in two by it; the cells of the wall are marked."""
    x = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0), (1, 0, -1), (1, 1, -1)]
    cells = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (1, 6, 7), (1, 7, 4)]
    mesh = meshes.from_arrays(
        comm, x, cells, parts={"roof": [0, 1, 2, 3], "wall": [4, 5]}, edges={"seam": [(1, 4)]},
        outside={"wall": (1, 0, 0)},
    )  # fmt: skip
    fine = adapted(mesh, 2, (1.0, 0.5, -0.5), 0.4)
    assert area(comm, fine, fine.parts["wall"]) == pytest.approx(1.0)
    assert area(comm, fine, fine.hidden) == pytest.approx(1.0)
    assert length(comm, fine, "seam") == pytest.approx(1.0)
    n = [fine.mesh.topology.index_map(k).size_global for k in (0, 1, 2)]
    assert n[0] - n[1] + n[2] == 1


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("cells", "message"),
    [([-1], "names -1, but"), ([10**6], "names 1000000, but"), ([0.5], "whole numbers"),
     ([[0, 1]], r"shape \(1, 2\)")],
)  # fmt: skip
def test_cells_that_are_not_there_are_refused(comm, cells, message):
    with pytest.raises(InputError, match=message):
        meshes.refine(two_parts(comm), cells)
