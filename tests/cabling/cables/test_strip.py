"""The strip of cells around cables: against the whole mesh, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI
from table_twins import cells_around
from term_scene import ISOTROPIC, irregular_square

from crms_fenicsx import Cable, Scene
from crms_fenicsx.cabling.cables.strip import EMPTY, Strip, StripShape, cells_at
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap


def scene_of(comm: MPI.Intracomm) -> Scene:
    """A dome that is held around and stands a little beside its stress-free place."""
    scene = clamped(irregular_square(comm, 20.0), ISOTROPIC)
    X = scene.V.tabulate_dof_coordinates()
    scene.u.x.array.reshape(-1, 3)[:] = 0.01 * X[:, [1, 2, 0]]
    return scene


def whole_mesh(scene: Scene) -> tuple[Integers, Integers, Integers]:
    """Ids of all cells' vertices, their owners, and their numbers there, on all ranks."""
    mesh = scene.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    ids = np.asarray(mesh.geometry.input_global_indices)[geometry_dofmap(mesh)[:owned]]
    parts = scene.comm.allgather(ids)
    owners = [np.full(len(part), rank) for rank, part in enumerate(parts)]
    numbers = [np.arange(len(part)) for part in parts]
    return np.concatenate(parts), np.concatenate(owners), np.concatenate(numbers)


def places(scene: Scene) -> dict[int, Array]:
    """Stress-free positions of all vertices, by id."""
    mesh = scene.mesh.mesh
    ids = mesh.geometry.input_global_indices
    own = {int(i): x for i, x in zip(ids, mesh.geometry.x, strict=True)}
    return {i: x for part in scene.comm.allgather(own) for i, x in part.items()}


def rows_of(strip: Strip) -> set[tuple[int, ...]]:
    table = np.column_stack([strip.cells, strip.owner, strip.local])
    return {tuple(int(x) for x in row) for row in table}


def expected(scene: Scene, vertices: set[int]) -> set[tuple[int, ...]]:
    """Cells with one of these vertices, one by one."""
    return {
        (*(int(v) for v in cell), int(owner), int(number))
        for cell, owner, number in zip(*whole_mesh(scene), strict=True)
        if vertices & {int(v) for v in cell}
    }


def some_vertices(scene: Scene) -> list[int]:
    """Inside, at a corner, and a neighbour of the first."""
    where = places(scene)
    wanted = [(50.0, 50.0), (0.0, 0.0), (65.0, 50.0)]
    return [
        min(where, key=lambda i: float(np.linalg.norm(where[i][:2] - place))) for place in wanted
    ]


@pytest.mark.ranks
def test_cells_around_vertices(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm)
    vertices = some_vertices(scene)
    strip = cells_at(scene.membrane, vertices)
    assert rows_of(strip) == expected(scene, set(vertices))
    assert len(strip.cells) == len(rows_of(strip))
    assert strip.complete == set(vertices)
    assert len(cells_at(scene.membrane, []).cells) == 0


@pytest.mark.ranks
@pytest.mark.parametrize("rings", [1, 2, 3])
def test_it_grows_ring_by_ring(comm: MPI.Intracomm, rings: int) -> None:
    scene = scene_of(comm)
    first, *_ = vertices = some_vertices(scene)
    scene.net.grow_strip([first], rings)
    wanted = {first}
    for ring in range(rings):
        cells = expected(scene, wanted)
        if ring < rings - 1:
            wanted |= {v for *cell, _, _ in cells for v in cell}
    assert scene.net.strip is not None
    assert rows_of(scene.net.strip) == cells
    assert scene.net.strip.complete == wanted
    before = rows_of(scene.net.strip)
    scene.net.grow_strip(vertices[1:])
    assert rows_of(scene.net.strip) == before | expected(scene, set(vertices[1:]))
    assert scene.net.strip.complete == wanted | set(vertices)
    same = scene.net.strip
    scene.net.grow_strip(vertices)  # nothing is lacking
    assert scene.net.strip is same


def test_merging_keeps_each_cell_once(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm)
    a, b, c = some_vertices(scene)
    one, other = cells_at(scene.membrane, [a, b]), cells_at(scene.membrane, [a, c])
    both = one.merged(other)
    assert len(both.cells) == len(rows_of(both)) < len(one.cells) + len(other.cells)
    assert rows_of(both) == expected(scene, {a, b, c})
    assert rows_of(EMPTY.merged(one)) == rows_of(one)


def test_cells_around_vertices_edges_and_cells(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm)
    strip = cells_at(scene.membrane, some_vertices(scene)[:1])
    for row, cell in enumerate(strip.cells.tolist()):
        assert strip.rows(tuple(cell)) == strip.rows(tuple(cell[::-1])) == [row]
        for support in ((cell[0],), (cell[1], cell[2]), (cell[2], cell[2], cell[0])):
            around = [k for k, other in enumerate(strip.cells) if set(support) <= set(other)]
            assert strip.rows(support) == around
    assert strip.rows((10**6,)) == []
    np.testing.assert_array_equal(strip.vertices, sorted(set(strip.cells.ravel().tolist())))
    assert [strip.row_of[int(v)] for v in strip.vertices] == list(range(len(strip.vertices)))


@pytest.mark.ranks
def test_held_edges_are_those_of_held_groups(comm: MPI.Intracomm) -> None:
    """The boundary's edges near the vertices, and no edge between two held vertices inside."""
    scene = scene_of(comm)
    vertices = some_vertices(scene)
    strip = cells_at(scene.membrane, vertices)
    cells = whole_mesh(scene)[0]
    sides = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    boundary = {(int(a), int(b)) for a, b in edges[count == 1]}
    known = {
        (min(a, b), max(a, b))
        for a, b, c in strip.cells.tolist()
        for a, b in ((a, b), (b, c), (a, c))
    }
    assert strip.held_edges == boundary & known
    assert len(strip.held_edges) >= 2
    free = Scene(irregular_square(comm), ISOTROPIC)
    free.fix(lambda x: np.full(x.shape[1], True))  # vertices alone
    assert cells_at(free.membrane, vertices).held_edges == frozenset()


@pytest.mark.ranks
def test_its_shape_is_the_scenes(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm)
    strip = cells_at(scene.membrane, some_vertices(scene))
    shape = StripShape.of(scene.membrane, strip)
    X = places(scene)
    for vertex, x0, x in zip(strip.vertices, shape.stress_free, shape.current, strict=True):
        np.testing.assert_allclose(x0, X[int(vertex)], rtol=0, atol=1e-12)
        np.testing.assert_allclose(x, x0 + 0.01 * x0[[1, 2, 0]], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(shape.at(int(vertex)), x)


def test_its_normals_are_those_of_the_cells(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm)
    inside, *_ = some_vertices(scene)
    strip = cells_at(scene.membrane, [inside])
    shape = StripShape.of(scene.membrane, strip)
    total = np.zeros(3)
    for row, (a, b, c) in enumerate(strip.cells.tolist()):
        normal = np.cross(shape.at(b) - shape.at(a), shape.at(c) - shape.at(a))
        np.testing.assert_allclose(shape.normals[row], normal, atol=1e-11)
        np.testing.assert_allclose(
            shape.normal((a, b, c)), normal / np.linalg.norm(normal), atol=1e-14
        )
        total += normal
    np.testing.assert_allclose(shape.normal((inside,)), total / np.linalg.norm(total), atol=1e-14)
    assert shape.normal((inside,))[2] > 0.5
    supports = sorted(cells_around(strip))
    normals, sizes = shape.normals_and_sizes(supports)
    for support, unit, size in zip(supports, normals, sizes, strict=True):
        own = shape.normals[strip.rows(support)]
        total = own.sum(axis=0)
        np.testing.assert_allclose(unit, total / np.linalg.norm(total), atol=1e-14)
        assert size == pytest.approx(np.linalg.norm(own, axis=1).mean() ** 0.5)


@pytest.mark.ranks
def test_laying_a_cable_gathers_the_cells_around_its_points(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm)
    cable = scene.lay_cable(Cable(32000.0), [(0.0, 31.0), (100.0, 52.0)])
    wanted = {v for point in cable.path.points for v in point.support}
    assert scene.net.strip is not None
    assert scene.net.strip.complete == wanted
    assert rows_of(scene.net.strip) == expected(scene, wanted)
    assert len(scene.net.strip.cells) < len(whole_mesh(scene)[0])
