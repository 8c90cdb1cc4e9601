"""Meshes of which some cells are divided."""

import numpy as np
import pytest

from crms_fenicsx import InputError, meshes
from crms_fenicsx.meshes.cell_geometry import area_vectors
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.adaptive_refinement import AdaptiveRefinement
from crms_fenicsx.surface.points import CellPoint, EdgePoint, VertexPoint


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
        mesh = AdaptiveRefinement.of(mesh, near(mesh, place, distance), project).finer
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
    x = np.stack(np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)), axis=-1).reshape(-1, 2)
    n = np.arange(25).reshape(5, 5)
    a, b, c, d = n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]
    cells = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    left = x[cells].mean(axis=1)[:, 0] < 0
    return meshes.from_arrays(
        comm, x, cells, edges={"line": np.column_stack([n[:-1, 2], n[1:, 2]])},
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


def test_cells_stay_on_the_rank_of_their_parents(comm):
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


SHAPES = {
    "grid": lambda comm: meshes.rectangle(comm, 2.0, 2.0, 0.25, structured=True),
    "free": lambda comm: meshes.rectangle(comm, 2.0, 2.0, 0.25),
    "cap": lambda comm: meshes.spherical_cap(comm, 2.0, 1.0, 0.4),
}


@pytest.mark.parametrize("name", SHAPES)
def test_cells_keep_their_shape(comm, name):
    """After 3 divisions no angle is less than half of the least one, as Rivara's theorem says.

    New vertices of the cap move to the sphere, which takes little off. Aspect ratios (longest side
    over least height; 1.15 for equilateral triangles) are 2.0, 3.5 and 3.5, from 2.0, 2.2 and 2.1.
    """
    mesh = SHAPES[name](comm)
    angle, ratio = quality(comm, mesh)
    least, most = quality(comm, adapted(mesh, 3, (0.7, 0.6, 0.8 * (name == "cap")), 0.6))
    assert least >= 0.5 * angle * (0.98 if name == "cap" else 1.0 - 1e-12)
    assert most <= 1.8 * ratio
    assert (least < 0.99 * angle) == (name != "grid")  # halved squares stay halved squares


def test_new_vertices_lie_on_the_surface(comm):
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


def test_places_and_fields_are_where_they_were(comm):
    """On divided edges and others, in divided cells and others."""
    coarse = two_parts(comm)
    refinement = AdaptiveRefinement.of(coarse, near(coarse, (0.0, 0.0, 0.0), 0.3))

    def table(mesh):
        ids, x = canonical(comm, mesh)
        return dict(zip(ids.ravel().tolist(), x.reshape(-1, 3), strict=True))

    old, new = table(coarse), table(refinement.finer)
    rng = np.random.default_rng(5)
    places = []
    for cell in canonical(comm, coarse)[0].tolist():
        a, b, c = sorted(cell)
        places += [VertexPoint(a), EdgePoint((a, b), 0.2), EdgePoint((b, c), 0.5)]
        places += [CellPoint((a, b, c), tuple(w)) for w in rng.dirichlet((1, 1, 1), 4)]
    cells = {frozenset(cell) for cell in canonical(comm, refinement.finer)[0].tolist()}
    for before, after in zip(places, refinement.places(places), strict=True):
        was = sum(w * old[v] for v, w in zip(before.support, before.weights, strict=True))
        now = sum(w * new[v] for v, w in zip(after.support, after.weights, strict=True))
        assert np.allclose(was, now, atol=1e-14)
        assert any(cell.issuperset(after.support) for cell in cells)
    row = [VertexPoint(v) for v in range(10, 15)]  # the middle line, from side to side
    along = refinement.along_edges(row)
    assert all(isinstance(point, VertexPoint) for point in along)
    assert np.allclose([new[p.vertex][0] for p in along], [-1, -0.5, -0.25, 0, 0.25, 0.5, 1])

    mine, ids = np.array(sorted(old)), np.array(sorted(new))
    values = np.array([old[int(v)] * (2.0, -3.0, 1.0) for v in mine])
    bends = {(11, 12): np.array([0.0, 0.0, 7.0]), (0, 1): np.array([0.0, 0.0, 9.0])}
    carried = refinement.carried(mine, values, ids, bends)
    expected = np.array([new[int(v)] * (2.0, -3.0, 1.0) for v in ids])
    expected[ids == along[2].vertex, 2] += 7.0  # and nothing of an edge that is not divided
    assert np.allclose(carried, expected, atol=1e-13)
