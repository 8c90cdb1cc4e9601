"""Paths pulled taut into geodesics: flat, curved, pierced, mirrored and renumbered surfaces."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from curved_surfaces import (
    ArraySurface,
    along_mesh_lines,
    geodesic_length,
    length,
    nearest,
    positions,
    sphere,
    structured,
    torus,
    unstructured,
)

from crms_fenicsx.foundation.runtime.errors import InputError, MeshError, PathError
from crms_fenicsx.foundation.surface.corridor import (
    corridor,
    snap_ends,
    why_invalid,
    without_detours,
)
from crms_fenicsx.foundation.surface.flip_geodesic import STRAIGHT, shorten
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, VertexPoint, edge_of
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells, Ring, ring_of

ROUNDING = 1e-11  # relative; of paths through some 100 cells, and of coordinates near 100
V = VertexPoint


def shortened(mesh, path, **options):
    """Shorten, and check what must hold for every result."""
    cells, points = mesh
    surface = ArraySurface(cells, points)
    result = shorten(path, surface, **options)
    assert result.length == pytest.approx(length(result.points, points), rel=ROUNDING)
    assert result.length <= result.before * (1 + ROUNDING)
    assert (result.flips == ()) == (corridor(result.points) == corridor(path))
    Path(result.points).links(cells)
    if not options:
        again = shorten(result.points, surface)
        assert again.flips == () and corridor(again.points) == corridor(result.points)
        assert again.length == pytest.approx(result.length, rel=ROUNDING)
    return result


def turned(mesh, seed=5):
    """The mesh turned in space."""
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return mesh[0], mesh[1] @ matrix.T


def bulge(mesh, dy, start=(0, 50), end=(100, 50)):
    """A path along mesh lines that passes the middle dy away."""
    stops = [nearest(mesh, *xy) for xy in (start, (50, 50 + dy), end)]
    return along_mesh_lines(mesh, stops)


# --- flat membranes ----------------------------------------------------------------------------

FLAT = {
    "structured": structured(10),
    "unstructured": unstructured(12, np.random.default_rng(1)),
    "thin cells": unstructured(9, np.random.default_rng(2), width=1000.0),
}


@pytest.mark.parametrize("name", FLAT)
@pytest.mark.parametrize("dy", [-30, -15, 15, 30])
def test_a_bulging_path_on_a_flat_mesh_becomes_straight(name, dy):
    cells, points = FLAT[name]
    width = points[:, 0].max()
    stops = [nearest((cells, points), *xy) for xy in ((0, 50), (width / 2, 50 + dy), (width, 50))]
    path = along_mesh_lines((cells, points), stops)
    result = shortened(turned((cells, points)), path)
    assert result.flips
    direct = points[stops[2]] - points[stops[0]]
    assert result.length == pytest.approx(np.linalg.norm(direct), rel=ROUNDING)
    way = positions(result.points, points)
    across = np.cross(direct, way - way[0])[:, 2] / width
    assert np.abs(across).max() < 1e-9 * width  # a fraction is rounded to 1e-12, seen at an angle


def random_end(rng, mesh, near):
    """A place in, on an edge of, or at a corner of a cell, and a vertex to go on to."""
    cells, points = mesh
    middle = points[cells].mean(axis=1)[:, :2]
    cell = rng.permutation(cells[np.argmin(np.linalg.norm(middle - near, axis=1))])
    a, b, c = (int(v) for v in cell)
    return [
        (V(a), a),
        (EdgePoint(edge_of(a, b), rng.uniform(0.02, 0.98)), c),
        (EdgePoint(edge_of(a, b), 1e-300), c),  # at a vertex to all accuracy
        (CellPoint((a, b, c), tuple(rng.dirichlet([1, 1, 1]))), c),
        (CellPoint((a, b, c), (0.0, 0.4, 0.6)), a),
        (CellPoint((a, b, c), (0.0, 1.0, 0.0)), a),
    ][rng.integers(6)]


@pytest.mark.parametrize("name", ["structured", "unstructured"])
def test_ends_of_all_kinds_stay_where_they_are(name):
    mesh = FLAT[name]
    surface, points = ArraySurface(*mesh), mesh[1]
    rng = np.random.default_rng(7)
    done = 0
    while done < 50:
        (start, a), (end, b) = (random_end(rng, mesh, (x, rng.uniform(20, 80))) for x in (15, 85))
        path = along_mesh_lines(mesh, [a, nearest(mesh, 50, rng.uniform(5, 95)), b])
        path = [*[start] * (start != path[0]), *path, *[end] * (end != path[-1])]
        given = corridor(path)
        if why_invalid(given, surface.opposite_vertices) or without_detours(given) != given:
            continue  # it comes back to the cell of its start, or to itself
        # from there on with points inside edges too
        halfway = shorten(path, surface, max_flips=int(rng.integers(0, 12))).points
        result = shortened(mesh, halfway)
        p, q = positions([start, end], points)
        assert result.length == pytest.approx(np.linalg.norm(q - p), rel=ROUNDING)
        way = positions(result.points, points)
        np.testing.assert_allclose(way[[0, -1]], [p, q], atol=1e-12)
        done += 1


def test_a_path_bends_at_a_hole_and_stays_on_its_side():
    cells, points = structured(10)
    inside = np.all((points[cells].mean(1)[:, :2] > 30) & (points[cells].mean(1)[:, :2] < 70), 1)
    mesh = cells[~inside], points
    for dy, corner in ((40, 70), (-40, 30)):
        result = shortened(mesh, bulge(mesh, dy))
        corners = [(0, 50), (30, corner), (70, corner), (100, 50)]
        expected = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
        assert result.length == pytest.approx(expected, rel=ROUNDING)
        assert result.flips and result.before > 1.05 * expected


def test_a_path_along_the_boundary_leaves_it_inwards_only():
    """An L-shaped sheet: around its inner corner the path is taut, around an outer one not."""
    cells, points = structured(4)
    mid = points[cells].mean(1)
    mesh = cells[~((mid[:, 0] > 50) & (mid[:, 1] > 50))], points
    path = along_mesh_lines(mesh, [nearest(mesh, *xy) for xy in ((50, 100), (50, 50), (100, 50))])
    result = shortened(mesh, path)
    assert result.flips == () and result.length == pytest.approx(100, rel=ROUNDING)
    path = along_mesh_lines(mesh, [nearest(mesh, *xy) for xy in ((0, 50), (0, 0), (50, 0))])
    result = shortened(mesh, path)
    assert V(0) not in result.points
    assert result.length == pytest.approx(50 * math.sqrt(2), rel=ROUNDING)


def test_lengths_count_and_coordinates_do_not():
    """A sheet that is told its lengths, in another unit, gives the same path wherever it lies."""
    mesh = cells, points = FLAT["unstructured"]
    path = bulge(mesh, 30)
    straight = ArraySurface(cells, points)
    expected = shorten(path, straight)
    for unit in (1e-6, 1.0, 1e6):
        edges = {
            edge_of(int(a), int(b)) for cell in cells for a, b in itertools.combinations(cell, 2)
        }
        lengths = {edge: unit * straight.length(edge) for edge in edges}
        result = shorten(path, ArraySurface(cells, np.zeros_like(points), lengths))
        assert result.flips == expected.flips
        assert result.length == pytest.approx(unit * expected.length, rel=ROUNDING)


# --- curved membranes --------------------------------------------------------------------------


def order(sizes, errors):
    """Fitted order of errors (levels, cases) by their mean."""
    return np.polyfit(np.log(sizes), np.log(np.mean(errors, axis=1)), 1)[0]


def geodesic_errors(mesh, ends, exact):
    """Relative errors of the lengths of shortened paths."""
    errors = []
    for start, end in ends:
        path = along_mesh_lines(mesh, [nearest(mesh, *start), nearest(mesh, *end)])
        result = shortened(mesh, path)
        reference = exact(positions(result.points, mesh[1]))
        assert result.before > result.length
        errors.append(abs(result.length / reference - 1))
    return errors


def test_great_circles():
    rng = np.random.default_rng(11)
    ends = rng.normal(size=(8, 2, 3))
    ends /= np.linalg.norm(ends, axis=2)[..., None]
    ends = [(a, b) for a, b in ends if a @ b > -0.7]  # opposite ends have many geodesics
    assert len(ends) > 4
    sizes = [300, 1000, 3000]
    errors = [
        geodesic_errors(sphere(n, rng), ends, lambda way: np.arccos(way[0] @ way[-1]))
        for n in sizes
    ]
    assert order(np.array(sizes) ** -0.5, errors) > 1.8
    assert np.max(errors[-1]) < 2e-3


def test_helices():
    rng = np.random.default_rng(12)
    R = 100 / np.pi  # half a cylinder
    plan = [((10, 20), (90, 80)), ((20, 90), (95, 10)), ((5, 50), (90, 60)), ((15, 10), (80, 30))]
    sizes = [8, 16, 32]
    errors = []
    for n in sizes:
        cells, sheet = unstructured(n, rng)
        t = sheet[:, 0] / R
        mesh = cells, np.column_stack([R * np.cos(t), sheet[:, 1], R * np.sin(t)])
        ends = [
            [mesh[1][nearest((cells, sheet), *xy)] for xy in pair]
            for pair in plan
        ]  # fmt: skip

        def exact(way):
            turn = np.arctan2(way[:, 2], way[:, 0])
            return math.hypot(R * (turn[-1] - turn[0]), way[-1, 1] - way[0, 1])

        errors.append(geodesic_errors(mesh, ends, exact))
    assert order(1 / np.array(sizes), errors) > 1.8
    assert np.max(errors[-1]) < 2e-3


def test_geodesics_of_an_ellipsoid():
    rng = np.random.default_rng(13)
    axes = np.array([1.0, 1.4, 0.7])

    def exact(way):
        return geodesic_length(way, lambda x: x / axes**2, lambda x, v: np.sum((v / axes) ** 2))

    ends = [((1, 0.1, 0), (-0.2, 1.3, 0.2)), ((0.3, 0, 0.7), (0, 1.3, -0.2)),
            ((0, -1.4, 0), (0.2, 0.3, 0.65)), ((-1, 0, 0.1), (0.1, 0.2, -0.7))]  # fmt: skip
    sizes = [300, 1000, 3000]
    errors = []
    for n in sizes:
        cells, points = sphere(n, rng)
        errors.append(geodesic_errors((cells, points * axes), ends, exact))
    assert order(np.array(sizes) ** -0.5, errors) > 1.8


def test_geodesics_of_a_torus():
    rng = np.random.default_rng(14)
    R, r = 2.0, 0.8

    def gradient(x):
        rho = math.hypot(x[0], x[1])
        return np.array([x[0] * (1 - R / rho), x[1] * (1 - R / rho), x[2]])

    def hessian(x, v):
        rho = math.hypot(x[0], x[1])
        radial = (x[0] * v[0] + x[1] * v[1]) / rho
        return v @ v - R / rho * (v[0] ** 2 + v[1] ** 2 - radial**2)

    def place(u, v):
        out = R + r * math.cos(v)
        return out * math.cos(u), out * math.sin(u), r * math.sin(v)

    ends = [
        (place(u, v), place(u + rng.uniform(0.6, 1.2), v + rng.uniform(-1.2, 1.2)))
        for u, v in rng.uniform(0, 2 * np.pi, (20, 2))
    ]
    sizes = [16, 32, 64]
    errors = [
        geodesic_errors(
            torus(n, R, r, rng), ends, lambda way: geodesic_length(way, gradient, hessian)
        )
        for n in sizes
    ]
    assert order(1 / np.array(sizes), errors) > 1.8


@pytest.mark.parametrize(("shape", "part"), [("ellipsoid", 0.8), ("torus", 0.95)])
def test_the_same_geodesics_as_by_flipping_edges(shape, part):
    """Against potpourri3d, which shortens by flipping edges of the mesh itself.

    Where the surface curves outward there is a geodesic on each side of a vertex, and the two
    methods may end in different ones; all others agree to rounding.
    """
    potpourri3d = pytest.importorskip("potpourri3d")
    rng = np.random.default_rng(15)
    if shape == "torus":
        mesh = torus(24, 2.0, 0.7, rng)
    else:
        mesh = sphere(800, rng)
        mesh = mesh[0], mesh[1] * (1.0, 1.5, 0.6)
    solver = potpourri3d.EdgeFlipGeodesicSolver(mesh[1], mesh[0])
    differences = []
    for start, end in rng.integers(len(mesh[1]), size=(40, 2)):
        path = along_mesh_lines(mesh, [int(start), int(end)])
        if len(path) < 5:
            continue
        result = shortened(mesh, path)
        other = solver.find_geodesic_path_poly([point.vertex for point in path])
        theirs = np.linalg.norm(np.diff(other, axis=0), axis=1).sum()
        differences.append(abs(result.length / theirs - 1))
    assert np.max(differences) < 1e-3
    assert np.mean(np.array(differences) < 1e-8) > part


# --- single vertices ---------------------------------------------------------------------------


def fan(angles):
    """A vertex 0 with a closed ring of neighbours 1, 2, ... at these angles (rad), as lengths."""
    n = len(angles)
    cells = np.array([[0, 1 + i, 1 + (i + 1) % n] for i in range(n)])
    lengths = {(0, 1 + i): 1.0 for i in range(n)}
    for i, angle in enumerate(angles):
        lengths[edge_of(1 + i, 1 + (i + 1) % n)] = 2 * math.sin(angle / 2)
    return ArraySurface(cells, np.zeros((n + 1, 3)), lengths)


def test_a_path_over_a_peak_leaves_it_to_the_shorter_side():
    surface = fan([0.7] * 7)  # 4.9 in all
    result = shorten([V(1), V(0), V(4)], surface)  # 2.1 to one side, 2.8 to the other
    assert result.flips == (0,)
    assert corridor(result.points) == ((1,), (0, 2), (0, 3), (4,))
    assert result.before == pytest.approx(2.0, rel=1e-15)
    assert result.length == pytest.approx(2 * math.sin(1.05), rel=1e-14)
    # the shorter side refused: the other is shorter than the way over the peak, too
    result = shorten([V(1), V(0), V(4)], surface, refused={corridor(result.points)})
    assert corridor(result.points) == ((1,), (0, 7), (0, 6), (0, 5), (4,))
    assert result.length == pytest.approx(2 * math.sin(1.4), rel=1e-14)
    # a string there is straight, so it stays
    assert shorten(result.points, surface).flips == ()


def test_a_symmetric_tie_on_a_ridge_stays():
    surface = fan([0.7] * 8)  # 2.8 to either side
    result = shorten([V(1), V(0), V(5)], surface)
    assert result.flips == () and result.length == result.before
    uneven = fan([0.7] * 4 + [0.7 - 1e-5] * 4)
    result = shorten([V(1), V(0), V(5)], uneven)
    assert corridor(result.points) == ((1,), (0, 8), (0, 7), (0, 6), (5,))
    solved = fan([0.7] * 4 + [0.7 - 1e-8] * 4)
    assert shorten([V(1), V(0), V(5)], solved).flips == ()


def test_a_saddle_holds_the_string():
    surface = fan([1.0] * 8)  # 8 in all: 4 > pi to either side
    result = shorten([V(1), V(0), V(5)], surface)
    assert result.flips == () and result.points == (V(1), V(0), V(5))
    beside = [V(1), *(EdgePoint((0, i), 0.5) for i in (2, 3, 4)), V(5)]
    result = shorten(beside, surface)
    assert result.flips == () and result.length == pytest.approx(2.0, rel=1e-15)
    # 3 to one side, 5 to the other
    result = shorten([V(1), V(0), V(4)], surface)
    assert corridor(result.points) == ((1,), (0, 2), (0, 3), (4,))
    around = [V(1), *(EdgePoint((0, i), 0.5) for i in (8, 7, 6, 5)), V(4)]
    assert corridor(shorten(around, surface).points) == corridor(result.points)


@pytest.mark.parametrize("by", [-2, 2])
def test_how_far_from_straight_a_flip_needs(by):
    part = (math.pi - by * STRAIGHT) / 4
    surface = fan([part] * 4 + [1.0] * 4)
    path = [V(1), *(EdgePoint((0, i), 0.5) for i in (8, 7, 6)), V(5)]
    assert bool(shorten(path, surface).flips) == (by > 0)


def test_an_end_on_a_spoke_of_the_vertex():
    """The run of crossed edges starts after it, and so does that on the other side."""
    surface = fan([math.pi / 4] * 8)
    start = EdgePoint((0, 1), 0.25)
    around = [start, *(EdgePoint((0, i), 0.5) for i in (2, 3, 4, 5, 6)), V(7)]
    result = shorten(around, surface)
    assert corridor(result.points) == ((0, 1), (0, 8), (7,))
    assert result.length == pytest.approx(math.hypot(0.25, 1.0), rel=1e-14)


@pytest.mark.parametrize("near", [1e-6, 1e-12, 1e-16, 1e-300])
def test_an_end_however_near_to_a_vertex_flips_over_it(near):
    rng = np.random.default_rng(6)
    for _ in range(10):
        angles = rng.uniform(0.7, 0.9, 8)
        surface = fan(angles * 2 * math.pi / angles.sum())
        path = [EdgePoint((0, 1), near), *(EdgePoint((0, i), 0.5) for i in range(2, 7)), V(7)]
        for way in (path, path[::-1]):
            result = shorten(way, surface)
            assert set(corridor(result.points)) == {(0, 1), (0, 8), (7,)}
            assert abs(result.length - 1.0) <= near + 1e-14


def test_an_end_inside_an_edge_that_the_path_follows_becomes_a_place_in_a_cell():
    """From an end on edge (0, 1) around vertex 2 to the saddle 0, which holds the string."""
    surface = fan([1.0] * 8)
    start = EdgePoint((0, 1), 0.25)
    for path in ([start, V(2), V(0), V(5)], [V(5), V(0), V(2), start]):
        result = shorten(path, surface)
        tied_end, *rest = result.points if path[0] == start else result.points[::-1]
        assert tied_end == CellPoint((0, 1, 2), (0.75, 0.25, 0.0)) and rest == [V(0), V(5)]
        assert result.length == pytest.approx(1.25, rel=1e-15)
        assert result.flips == (2,)
        other = shorten(path, surface, refused={corridor(result.points)})
        assert other.flips != (2,) and corridor(other.points) != corridor(result.points)


# --- what must not matter ----------------------------------------------------------------------


def bumpy(mesh):
    """The square with hills and hollows."""
    cells, points = mesh
    x, y = points[:, 0] / 100, points[:, 1] / 100
    z = 15 * np.sin(5 * x + 1) * np.cos(4 * y) + 6 * np.sin(11 * x * y)
    return cells, np.column_stack([points[:, :2], z])


def renumbered(mesh, path, numbers):
    """The mesh and the path with vertex v called numbers[v], cells in another order."""
    cells, points = mesh
    moved = np.empty_like(points)
    moved[numbers] = points
    new = [V(int(numbers[point.vertex])) for point in path]
    rng = np.random.default_rng(3)
    return (rng.permuted(numbers[rng.permutation(cells)], axis=1), moved), new


@pytest.mark.parametrize("shape", [bumpy, lambda mesh: mesh], ids=["bumpy", "flat"])
@pytest.mark.parametrize("name", ["structured", "unstructured"])
@pytest.mark.parametrize("dy", [-30, 20])
def test_neither_numbers_nor_handedness_matter(name, dy, shape):
    mesh = shape(FLAT[name])
    path = bulge(mesh, dy)
    result = shortened(mesh, path)
    assert len(result.flips) > 10
    way = positions(result.points, mesh[1])
    rng = np.random.default_rng(9)
    for mirror in (1, -1):
        numbers = rng.permutation(len(mesh[1]))
        image = mesh[0], mesh[1] * (1, mirror, 1)
        other_mesh, other_path = renumbered(image, path, numbers)
        other = shortened(other_mesh, other_path)
        back = positions(other.points, other_mesh[1]) * (1, mirror, 1)
        np.testing.assert_allclose(back, way, atol=1e-12 * 100)
        assert other.length == pytest.approx(result.length, rel=1e-12)
        assert other.flips == tuple(int(numbers[v]) for v in result.flips)


def test_a_symmetric_surface_gives_symmetric_paths():
    """A path and its mirror image, where rounding differs: the plane of symmetry is y = -10 / 3."""
    cells, points = structured(10)
    x, y = points[:, 0] / 100, points[:, 1] / 100
    points[:, 2] = 20 * np.sin(4 * x) * np.cos(3 * y)
    path = bulge((cells, points), 30)
    mirrored = points * (1, -1, 1) - (0, 20 / 3, 0)
    one = shorten(path, ArraySurface(cells, points))
    two = shorten(path, ArraySurface(cells, mirrored))
    assert one.flips == two.flips
    way, image = positions(one.points, points), positions(two.points, mirrored)
    np.testing.assert_allclose(image, way * (1, -1, 1) - (0, 20 / 3, 0), atol=1e-12 * 100)


# --- limits ------------------------------------------------------------------------------------


def test_max_flips_gives_the_way_there():
    mesh = bumpy(FLAT["unstructured"])
    path = bulge(mesh, 30)
    full = shortened(mesh, path)
    before = full.before
    for k in range(0, len(full.flips) + 1, 7):
        part = shortened(mesh, path, max_flips=k)
        assert part.flips == full.flips[:k]
        assert part.length <= before * (1 + ROUNDING)
        before = part.length
    assert shorten(path, ArraySurface(*mesh), max_flips=0).points == tuple(path)


def test_refused_corridors_are_not_taken():
    mesh = FLAT["unstructured"]
    path = bulge(mesh, 30)
    straight = shortened(mesh, path)
    refused = {corridor(straight.points)}
    for _ in range(5):
        result = shortened(mesh, path, refused=refused)
        assert corridor(result.points) not in refused
        assert result.length > straight.length and result.flips
        refused.add(corridor(result.points))


def test_missing_stars_are_asked_for_until_all_are_known():
    mesh = FLAT["unstructured"]
    path = bulge(mesh, 30)
    known: set[int] = set()
    for _ in range(100):
        try:
            result = shorten(path, ArraySurface(*mesh, complete=known))
            break
        except MissingCells as missing:
            assert missing.vertices and known.isdisjoint(missing.vertices)
            assert list(missing.vertices) == sorted(missing.vertices)
            if not known:  # all that hold the string are asked for at once
                assert missing.vertices == tuple(sorted(p.vertex for p in path[1:-1]))
            known |= set(missing.vertices)
    assert result.points == shortened(mesh, path).points
    assert len(known) < len(mesh[1])


def test_lengths_that_make_no_triangles():
    """No geometry at all: nothing is tried for ever, and nothing longer is taken."""
    cells, points = structured(6)
    edges = np.unique(np.sort(cells[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)), axis=0)
    for seed in range(20):
        lengths = np.random.default_rng(seed).uniform(0.2, 3.0, len(edges))
        table = {(int(a), int(b)): float(x) for (a, b), x in zip(edges, lengths, strict=True)}
        result = shorten(bulge((cells, points), 30), ArraySurface(cells, points, table))
        assert result.length <= result.before * (1 + ROUNDING)


def test_a_path_wound_around_its_end_unwinds():
    mesh = structured(6, 60.0)  # vertex (i, j) is 7 i + j
    end = CellPoint((24, 25, 32), (0.3, 0.3, 0.4))
    around = [V(v) for v in (22, 15, 16, 17, 18, 26, 33, 40, 39, 38, 37, 30, 23, 24)]
    result = shortened(mesh, [*around, end])
    p, q = positions([around[0], end], mesh[1])
    assert result.length == pytest.approx(np.linalg.norm(q - p), rel=ROUNDING)


def test_a_flip_that_would_use_a_cell_twice_is_rejected():
    """The end is at vertex 23 of its cell, where nothing can flip; 16 would, through that cell."""
    mesh = structured(6, 60.0)
    crossed = [
        (9, 17),
        (9, 16),
        (8, 16),
        (15, 16),
        (15, 23),
        (22, 23),
        (23, 30),
        (23, 31),
        (23, 24),
    ]
    path = [V(10), *(EdgePoint(edge, 0.5) for edge in crossed), CellPoint((16, 23, 24), (0, 1, 0))]
    result = shortened(mesh, path)
    assert result.flips == ()
    via = mesh[1][[10, 16, 23]]
    assert result.length == pytest.approx(np.linalg.norm(np.diff(via, axis=0), axis=1).sum())
    assert result.length > 1.05 * np.linalg.norm(via[2] - via[0])


def test_a_flip_that_would_leave_nothing_is_rejected():
    """A hoop around a peak slides up to it, and stays there."""
    surface = fan([0.7] * 7)
    start = EdgePoint((0, 1), 0.25)
    hoop = [start, *(EdgePoint((0, i), 0.5) for i in range(2, 8)), start]
    result = shorten(hoop, surface)
    assert result.flips == () and result.length == pytest.approx(0.5, rel=1e-14)


# --- combinatorics -----------------------------------------------------------------------------


def test_detours():
    assert without_detours([(0,), (1, 2), (1, 2), (3,)]) == ((0,), (3,))
    assert without_detours([(0,), (1, 2), (2, 3), (2, 3), (1, 2), (4,)]) == ((0,), (4,))
    assert without_detours([(0,), (1,), (0,), (2,)]) == ((0,), (2,))
    assert without_detours([(0,), (0, 1), (0, 2), (3,)]) == ((0,), (3,))
    assert without_detours([(3,), (0, 1), (0, 2), (0,), (5,)]) == ((3,), (0,), (5,))
    assert without_detours([(0, 1), (0, 1), (1, 2), (3,)]) == ((0, 1), (1, 2), (3,))
    assert without_detours([(3,), (1, 2), (0, 1), (0, 1)]) == ((3,), (1, 2), (0, 1))
    assert without_detours([(3,), (1, 2), (0,), (1, 2), (4,)]) == ((3,), (4,))
    assert without_detours([(0, 1), (0,), (0, 2), (1, 2), (4,)]) == ((0, 1), (1, 2), (4,))
    assert without_detours([(4,), (1, 2), (0,), (0, 1)]) == ((4,), (1, 2), (0, 1))
    assert without_detours([(0, 1, 2), (1, 2), (1, 2), (0, 1, 2)]) == ((0, 1, 2), (0, 1, 2))
    taut = ((0,), (1, 2), (2, 3), (4,))
    assert without_detours(taut) == taut


@pytest.mark.parametrize(
    ("supports", "text"),
    [
        (((0,), (1, 4), (4, 5), (5, 8), (4, 8), (4, 7), (3, 4), (1, 4), (2,)), "(1, 4) twice"),
        (((0,), (1,), (0,)), "(0, 1) twice"),
        (((0, 1, 4), (1, 4), (4, 5), (4, 8), (4, 7), (3, 4), (0, 4), (0, 1)), "(0, 1, 4) twice"),
        (((3,), (0,), (4,), (0,), (1,)), "(0,) twice"),
        (((0, 4), (3, 4), (4, 7), (4, 8), (4, 5), (1, 4), (0, 1)), "all edges of cell (0, 1, 4)"),
        (((0, 1), (0, 1)), "both of its ends"),
        (((3,),), "nothing of it is left"),
    ],
)
def test_flaws_of_corridors(supports, text):
    """On the 3 by 3 vertices 0 1 2 / 3 4 5 / 6 7 8, cut from the lower left."""
    cells = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6], [4, 5, 8], [4, 8, 7]]
    surface = ArraySurface(cells, np.zeros((9, 3)))
    assert text in (why_invalid(supports, surface.opposite_vertices) or "")


def test_hoops_may_close():
    cells, points = sphere(60, np.random.default_rng(1))
    surface = ArraySurface(cells, points)
    ring = surface.ring(7).neighbours
    hoop = [V(v) for v in (*ring, ring[0])]
    result = shorten(hoop, surface)
    assert result.points[0] == result.points[-1] == V(ring[0])
    assert 0 < result.length < result.before or result.flips == ()


def test_ends_are_tied_to_the_cell_that_the_path_does_not_use():
    def opposite_vertices(edge):
        return {(0, 1): (5, 3)}[edge]

    assert snap_ends(((0, 1), (0,), (9,)), opposite_vertices) == ((0, 1, 3), (0,), (9,))
    assert snap_ends(((0, 1), (0,), (1, 3), (9,)), opposite_vertices) == (
        (0, 1, 5),
        (0,),
        (1, 3),
        (9,),
    )
    assert snap_ends(((9,), (0,), (0, 1)), opposite_vertices) == ((9,), (0,), (0, 1, 3))
    assert snap_ends(((0, 1), (0, 3), (9,)), opposite_vertices) == ((0, 1), (0, 3), (9,))


def test_rings():
    assert ring_of(0, [(2, 3), (1, 2)]) == Ring((1, 2, 3), closed=False)
    assert ring_of(0, [(2, 3), (3, 1), (1, 2)]) == Ring((1, 3, 2), closed=True)
    for link in ([(1, 2), (3, 4)], [(1, 2), (2, 3), (2, 4)], [(1, 2), (2, 3), (3, 1), (4, 5)], []):
        with pytest.raises(MeshError, match="around vertex 0 do not form one fan"):
            ring_of(0, link)


def test_surfaces_from_arrays():
    cells, points = structured(3)
    surface = ArraySurface(cells, points, {(5, 6): 7.5})
    assert surface.length((5, 6)) == 7.5
    assert surface.length((0, 1)) == pytest.approx(100 / 3, rel=1e-15)
    assert sorted(surface.opposite_vertices((0, 5))) == [1, 4]
    assert surface.opposite_vertices((0, 1)) == (5,)
    assert surface.opposite_vertices((0, 2)) == surface.opposite_vertices((0, 99)) == ()
    assert surface.ring(5).closed and set(surface.ring(5).neighbours) == {0, 1, 4, 6, 9, 10}
    assert surface.ring(0) == Ring((1, 5, 4), closed=False)


# --- bad input ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ([V(0)], "a path of 1 points"),
        ([V(0), V(2)], "cannot go from vertex 0 to vertex 2"),
        ([V(0), EdgePoint((1, 5), 0.5), V(3)], "cannot go from edge"),
        ([V(0), EdgePoint((2, 3), 0.5)], "no cell of the surface has both"),
        ([V(0), EdgePoint((1, 5), 0.5), V(0)], "turn|twice"),
        ([V(0), V(1), V(2), V(1)], "uses .* twice"),
        ([V(0), V(5), V(1), V(5)], "twice"),
        ([V(0), EdgePoint((0, 5), 0.5), V(4)], "turns back|cannot"),
        ([V(1), CellPoint((0, 1, 5), (0.2, 0.3, 0.5)), V(0)], "only its ends may lie inside"),
    ],
)
def test_bad_paths(path, text):
    cells, points = structured(3)
    with pytest.raises(PathError, match=text):
        shorten(path, ArraySurface(cells, points))


def test_bad_numbers():
    cells, points = structured(3)
    path = [V(0), V(5), V(10)]
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(PathError, match=r"edge \(0, 5\) near a path has length"):
            shorten(path, ArraySurface(cells, points, {(0, 5): wrong}))
    for limit in (-1, 2.5, True):
        with pytest.raises(InputError, match="max_flips"):
            shorten(path, ArraySurface(cells, points), max_flips=limit)
    with pytest.raises(InputError, match="cells of a surface have shape"):
        ArraySurface([[0, 1]], points)
    with pytest.raises(InputError, match="points of a surface have shape"):
        ArraySurface(cells, points[:, :1])
    with pytest.raises(InputError, match="ids from 0 to 99"):
        ArraySurface([[0, 1, 99]], points)


def test_only_vertices_that_hold_a_path_are_slid_over():
    mesh = unstructured(9, np.random.default_rng(4))
    surface = ArraySurface(*mesh)
    path = bulge(mesh, 15)
    free = shorten(path, surface)
    assert len(free.flips) > 3
    assert shorten(path, surface, held_at=set()).flips == ()
    for vertex in free.flips[:3]:
        flips = shorten(path, surface, held_at={vertex}).flips
        assert set(flips) <= {vertex}
    some = set(free.flips[:2])
    assert shorten(path, surface, held_at=some).flips[:1] == free.flips[:1]
    assert shorten(path, surface, held_at=set(free.flips)).flips == free.flips
