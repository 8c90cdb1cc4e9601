"""Surfaces given as arrays: what is refused, orientation, distribution, groups."""

import dolfinx.fem
import numpy as np
import pytest
import ufl
from grids import grid
from mesh_measures import (
    area,
    cell_corners,
    edge_ends,
    input_cells,
    is_consistently_oriented,
    point_places,
    total_area_vector,
)

from crms_fenicsx.foundation.meshes import AwayFrom, from_arrays
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.membrane_mesh import vertex_nodes
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap, interpolation_points
from crms_fenicsx.foundation.runtime.errors import MeshError

SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
HALVES = np.array([(0, 1, 2), (0, 2, 3)])


def unit_square(n, lift=lambda x, y: 0.0 * x):
    """An n x n grid over the unit square, its points lifted, its cells all upward."""
    line = np.linspace(0.0, 1.0, n + 1)
    return grid(line, line, lift, by_rows=True)


def octahedron():
    """A closed surface, its cells turned at random."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    cells = np.array([(x, y, z) for x in (0, 3) for y in (1, 4) for z in (2, 5)])
    flips = np.array([0, 1, 0, 0, 1, 1, 0, 1], dtype=bool)
    cells[flips] = cells[flips][:, [1, 0, 2]]
    return axes, cells


def strip(n, half_turns):
    """A closed band of 2 n triangles with the given number of half turns."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    tilt = half_turns * angle / 2.0
    center = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    across = np.column_stack(
        [np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)]
    )
    points = np.vstack([center - 0.3 * across, center + 0.3 * across])
    cells = []
    for k in range(n):
        a, b = k, n + k
        c, d = (k + 1) % n, n + (k + 1) % n
        if k == n - 1 and half_turns % 2:
            c, d = d, c
        cells += [(a, c, d), (a, d, b)]
    return points, np.array(cells)


def shuffled(points, cells, seed):
    """The same surface with its vertices and cells renumbered and its cells turned at random."""
    rng = np.random.default_rng(seed)
    new = rng.permutation(len(points))
    moved = np.empty_like(points)
    moved[new] = points
    cells = new[cells][rng.permutation(len(cells))]
    return moved, np.array([rng.permutation(cell) for cell in cells])


# --- geometry and distribution ---------------------------------------------------------------


@pytest.mark.ranks
def test_cells_keep_their_vertex_order(comm):
    points, cells = unit_square(7, lambda x, y: x * y)
    cells = cells[:, [2, 0, 1]]  # not sorted, all upward
    membrane = from_arrays(comm, points, cells)
    assert np.array_equal(input_cells(membrane), cells)
    mesh = membrane.mesh
    assert (mesh.topology.dim, mesh.geometry.dim) == (2, 3)
    assert mesh.ufl_domain().ufl_coordinate_element().reference_value_shape == (3,)
    x = mesh.geometry.x[:, :3]
    assert np.array_equal(x, points[mesh.geometry.input_global_indices])


@pytest.mark.ranks
def test_other_ranks_need_no_arrays(comm):
    points, cells = (SQUARE, HALVES) if comm.rank == 0 else (None, None)
    outside = (0.0, 0.0, 1.0) if comm.rank == 0 else None
    assert area(from_arrays(comm, points, cells, outside=outside)) == pytest.approx(1.0)


@pytest.mark.ranks
def test_one_cell_on_any_number_of_ranks(comm):
    membrane = from_arrays(
        comm, SQUARE[:3], [(0, 1, 2)], parts={"all": [0]}, point_groups={"tip": [2]}
    )
    assert area(membrane, "all") == pytest.approx(0.5)
    assert len(edge_ends(membrane, "boundary")) == 3
    assert point_places(membrane, "tip").tolist() == [[1.0, 1.0, 0.0]]


@pytest.mark.ranks
def test_vertex_nodes_agree_cell_by_cell(comm):
    mesh = from_arrays(comm, *unit_square(4)).mesh
    nodes = vertex_nodes(mesh)
    for cell, of_cell in enumerate(geometry_dofmap(mesh)):
        assert nodes[mesh.topology.connectivity(2, 0).links(cell)].tolist() == of_cell.tolist()


@pytest.mark.ranks
def test_mesh_carries_forms(comm):
    mesh = from_arrays(comm, *unit_square(4, lambda x, y: 2.0 * x)).mesh
    one = dolfinx.fem.Constant(mesh, 1.0)
    value = comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(one * ufl.dx)))
    assert value == pytest.approx(np.sqrt(5.0), rel=1e-12)
    space = dolfinx.fem.functionspace(mesh, ("DG", 0))
    assert interpolation_points(space.element) == pytest.approx(np.full((1, 2), 1 / 3))


def test_slivers_pass_and_scale_does_not_matter(comm):
    for scale in (1e-6, 1.0, 1e6):
        thin = scale * np.array([(0.0, 0.0), (1.0, 0.0), (0.5, 1e-4)])
        assert area(from_arrays(comm, thin, [(0, 1, 2)])) == pytest.approx(0.5e-4 * scale**2)


# --- orientation -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_turned_cells_are_turned_back(comm, seed):
    points, cells = shuffled(*unit_square(6, lambda x, y: np.sin(3.0 * x) * y), seed)
    assert not is_consistently_oriented(cells)
    up = from_arrays(comm, points, cells)
    oriented = input_cells(up)
    assert is_consistently_oriented(oriented)
    assert np.array_equal(np.sort(oriented), np.sort(cells))  # the same triangles
    assert total_area_vector(up)[2] == pytest.approx(1.0)
    down = from_arrays(comm, points, cells, outside=(0.0, 0.0, -0.1))
    assert total_area_vector(down)[2] == pytest.approx(-1.0)
    by_parts = from_arrays(comm, points, cells, outside={})  # that of no part: upward
    assert total_area_vector(by_parts)[2] == pytest.approx(1.0)


@pytest.mark.ranks
def test_pieces_are_oriented_one_by_one(comm):
    points, cells = unit_square(3)
    both = np.vstack([points, points + np.array([2.0, 0.0, 0.0])])
    membrane = from_arrays(comm, both, np.vstack([cells, cells[:, ::-1] + len(points)]))
    assert total_area_vector(membrane)[2] == pytest.approx(2.0)


def test_closed_surface_needs_a_point(comm):
    points, cells = octahedron()
    with pytest.raises(MeshError, match=r"does not tell the two sides.*AwayFrom"):
        from_arrays(comm, points, cells)
    for inside in ((0.1, -0.2, 0.1), (9.1, -0.2, 0.1)):  # where it is plays no role here
        membrane = from_arrays(comm, points, cells, outside=AwayFrom(inside))
        corners = points[input_cells(membrane)]
        assert np.linalg.det(corners).sum() / 6.0 == pytest.approx(4.0 / 3.0)
    assert len(edge_ends(membrane, "boundary")) == 0


def test_vertical_band(comm):
    points, cells = strip(12, 0)
    points[:12] = points[12:] + np.array([0.0, 0.0, 1.0])  # a cylinder
    with pytest.raises(MeshError, match="another direction"):
        from_arrays(comm, points, cells)
    membrane = from_arrays(comm, points, cells, outside=AwayFrom((0.0, 0.0, 0.5)))
    corners = points[input_cells(membrane)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1) - (0.0, 0.0, 0.5)) > 0).all()


def test_one_sided_surface_is_refused(comm):
    for turns in (1, 3):
        with pytest.raises(MeshError, match="Moebius"):
            from_arrays(comm, *strip(24, turns))
    from_arrays(comm, *strip(24, 2), outside=(0.3, 0.1, 1.0))  # two-sided


@pytest.mark.parametrize("outside", [(0, 0, 0), (1, 2), "up", (0, 0, np.nan), AwayFrom((1, 2))])
def test_bad_outside(comm, outside):
    with pytest.raises(MeshError, match="outside"):
        from_arrays(comm, SQUARE, HALVES, outside=outside)


# --- groups ----------------------------------------------------------------------------------


@pytest.mark.ranks
def test_groups_survive_distribution(comm):
    n = 8
    points, cells = shuffled(*unit_square(n), seed=5)
    middle = points[cells].mean(axis=1)
    line = np.flatnonzero(points[:, 0] == 0.5)
    line = line[np.argsort(points[line, 1])]
    corner = np.flatnonzero((points[:, :2] == 0).all(axis=1))
    membrane = from_arrays(
        comm,
        points,
        cells,
        edges={"ridge": np.column_stack([line[1:], line[:-1]]), "boundary ridge": [line[:2]]},
        parts={"left": np.flatnonzero(middle[:, 0] < 0.5), "all": np.arange(len(cells))},
        point_groups={"origin": corner, "ridge": np.repeat(line, 2)},
    )
    assert set(membrane.edges) == {"boundary", "ridge", "boundary ridge"}
    assert area(membrane, "left") == pytest.approx(0.5)
    assert (cell_corners(membrane)[membrane.parts["left"]].mean(axis=1)[:, 0] < 0.5).all()
    assert area(membrane, "all") == pytest.approx(1.0)
    ridge = edge_ends(membrane, "ridge")
    assert ridge.shape == (n, 2, 3)
    assert (ridge[..., 0] == 0.5).all()
    assert np.sort(ridge.mean(axis=1)[:, 1]) == pytest.approx((np.arange(n) + 0.5) / n)
    assert len(edge_ends(membrane, "boundary ridge")) == 1
    boundary = edge_ends(membrane, "boundary")
    assert len(boundary) == 4 * n
    assert (np.abs(boundary.mean(axis=1)[:, :2] - 0.5).max(axis=1) == 0.5).all()
    assert point_places(membrane, "origin").tolist() == [[0.0, 0.0, 0.0]]
    assert len(point_places(membrane, "ridge")) == n + 1


@pytest.mark.ranks
def test_ghosts_belong_to_groups(comm):
    """Each rank finds exactly those of its vertices, ghosts too, that lie where the group is."""
    points, cells = unit_square(8)
    group = np.flatnonzero(points[:, 0] == 0.5)
    membrane = from_arrays(comm, points, cells, point_groups={"ridge": group})
    places = membrane.mesh.geometry.x[vertex_nodes(membrane.mesh)]
    assert membrane.points["ridge"].tolist() == np.flatnonzero(places[:, 0] == 0.5).tolist()


def test_groups_are_read_only(comm):
    membrane = from_arrays(comm, SQUARE, HALVES)
    with pytest.raises(TypeError):
        membrane.edges["new"] = membrane.edges["boundary"]
    with pytest.raises(ValueError, match="read-only"):
        membrane.edges["boundary"][:] = 0


def test_boundary_may_be_named_if_it_is_the_boundary(comm):
    rim = [(0, 1), (2, 1), (2, 3), (3, 0)]
    assert len(edge_ends(from_arrays(comm, SQUARE, HALVES, edges={"boundary": rim}), "boundary"))
    with pytest.raises(MeshError, match="reserved"):
        from_arrays(comm, SQUARE, HALVES, edges={"boundary": rim[:3]})


def test_edge_table_against_a_dictionary():
    _, cells = shuffled(*unit_square(5), seed=1)
    sides = {}
    for cell, corners in enumerate(cells.tolist()):
        for k in range(3):
            edge = tuple(sorted((corners[k], corners[(k + 1) % 3])))
            sides.setdefault(edge, set()).add(3 * cell + k)
    table = EdgeTable.of(cells)
    edges = [tuple(pair) for pair in table.vertices.tolist()]
    found = np.split(table.order, np.cumsum(table.counts)[:-1])
    assert dict(zip(edges, map(set, found), strict=True)) == sides
    inner = {frozenset(pair) for pair in zip(*table.linked_sides(table.counts == 2), strict=True)}
    assert inner == {frozenset(pair) for pair in sides.values() if len(pair) == 2}
    outer = {tuple(pair) for pair in table.vertices[table.counts == 1].tolist()}
    assert outer == {edge for edge, pair in sides.items() if len(pair) == 1}


# --- what is refused -------------------------------------------------------------------------

FAN = np.vstack([SQUARE, [(2.0, 2.0), (3.0, 1.0), (0.5, 0.2)]])
DOUBLE_CONE = np.array(
    [(0, 0, 0), (1, 0, 1), (-1, 1, 1), (-1, -1, 1), (1, 0, -1), (-1, 1, -1), (-1, -1, -1.0)]
)
DOUBLE_CONE_CELLS = [(0, 1, 2), (0, 2, 3), (0, 3, 1), (0, 4, 5), (0, 5, 6), (0, 6, 4)]


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("points", "cells", "message"),
    [
        (SQUARE, [(0, 1, 2, 3)], r"shape \(1, 4\); pass triangles"),
        (SQUARE, [], "no cells"),
        (SQUARE, np.empty((0, 3), dtype=int), "no cells"),
        (SQUARE, [(0, 1, 2), (0, 1)], "not an array"),
        (SQUARE, [(0.0, 1.0, 2.0)], "type float64"),
        (SQUARE, [(0, 1, 2), (0, 2, 4)], r"cell 1 has the vertices \[0, 2, 4\].*0 to 3"),
        (SQUARE, [(0, 1, 2), (0, 2, -1)], r"cell 1 has the vertices \[0, 2, -1\]"),
        (np.column_stack([SQUARE, SQUARE]), HALVES, r"shape \(4, 4\)"),
        (None, HALVES, "shape"),
        ([("a", "b")], HALVES, "not an array of numbers"),
        (np.where(SQUARE == 1.0, np.nan, SQUARE), HALVES, r"vertex 1 .*nan.*finite"),
        (np.where(SQUARE == 1.0, np.inf, SQUARE), HALVES, r"vertex 1 .*inf.*finite"),
        (SQUARE[:3], [(0, 1, 2), (1, 2, 0)], "cells 0 and 1 have the same vertices"),
        (SQUARE[:3], [(0, 1, 1), (0, 1, 2)], "cell 0 has no area"),
        ([(0, 0), (1, 1), (3, 3 + 1e-11)], [(0, 1, 2)], r"no area.*vertex 1 at \(1, 1, 0\)"),
        (FAN[:5], HALVES, r"vertex 4 at \(2, 2, 0\) belongs to no cell"),
        (FAN[:6], [*HALVES, (2, 4, 5)], r"vertex 2 at \(1, 1, 0\) 2 separate parts"),
        (DOUBLE_CONE, DOUBLE_CONE_CELLS, r"vertex 0 at \(0, 0, 0\) 2 separate parts"),
    ],
)
def test_bad_surfaces(comm, points, cells, message):
    with pytest.raises(MeshError, match=message):
        from_arrays(comm, points, cells)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ({"edges": {"seam": [(1, 3)]}}, r"'seam' .*not an edge.*vertex 1 at \(1, 0, 0\), vertex 3"),
        ({"edges": {"seam": [(0, 4)]}}, "'seam' names 4"),
        ({"edges": {"seam": []}}, "'seam' is empty"),
        ({"edges": {"seam": [0, 1, 2]}}, r"'seam' has shape \(3,\)"),
        ({"edges": {"seam": [(0.0, 1.0)]}}, "'seam' have the type float64"),
        ({"edges": {"": [(0, 1)]}}, "no name"),
        ({"parts": {"roof": [2]}}, "part 'roof' names 2.*cells 0 to 1"),
        ({"parts": {"roof": [-1]}}, "part 'roof' names -1"),
        ({"parts": {"roof": []}}, "part 'roof' is empty"),
        ({"parts": {"roof": [[0, 1]]}}, r"part 'roof' has shape \(1, 2\)"),
        ({"parts": {"roof": [True, False]}}, "'roof' have the type bool"),
        ({"parts": {7: [0]}}, "part 7 has no name"),
        ({"point_groups": {"mast": [4]}}, "point group 'mast' names 4.*vertices 0 to 3"),
        ({"point_groups": {"mast": []}}, "point group 'mast' is empty"),
    ],
)
def test_bad_groups(comm, groups, message):
    with pytest.raises(MeshError, match=message):
        from_arrays(comm, SQUARE, HALVES, **groups)
