"""Tracing a route over a surface, against exact rational arithmetic and on hard places."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import Delaunay
from trace_surfaces import (
    assert_divided_mesh_is_enough,
    assert_part_is_enough,
    cap,
    hall,
    length_of,
    numbered,
    on_sphere,
    part,
    rotation,
    same_points,
    scattered,
    squares,
)

from crms_fenicsx.foundation.meshes.triangles import longest_sides
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.closest_point import TargetSurface
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, VertexPoint
from crms_fenicsx.foundation.surface.trace import IndirectLeg, _direct_way, near_section, trace

pytestmark = pytest.mark.ranks


def sheared(points, a, b):
    """Map integer points to others, so that their triangles become slivers."""
    x, y, z = points.T
    return np.column_stack([x + a * y, y + b * (x + a * y), z])


def random_place(rng, points, cells):
    """Return an exact place (x, y): a vertex, inside an edge, or inside a cell."""
    cell = cells[rng.integers(len(cells))]
    corners = [[Fraction(int(x)) for x in points[v, :2]] for v in cell]
    weights = {
        0: (1, 0, 0),
        1: (int(rng.integers(1, 6)), int(rng.integers(1, 6)), 0),
        2: tuple(int(w) for w in rng.integers(1, 6, 3)),
    }[int(rng.integers(3))]
    total = sum(weights)
    return tuple(
        sum(Fraction(w, total) * c[k] for w, c in zip(weights, corners, strict=True))
        for k in range(2)
    )


def exact_section(ids, points, cells, a, b):
    """Cut every edge with the line from a to b in rational arithmetic: the slow twin."""
    d = (b[0] - a[0], b[1] - a[1])
    f, s = [], []
    for x, y, _ in points:
        p = (Fraction(int(x)) - a[0], Fraction(int(y)) - a[1])
        f.append(d[0] * p[1] - d[1] * p[0])
        s.append(d[0] * p[0] + d[1] * p[1])
    length = d[0] ** 2 + d[1] ** 2
    met = [
        (s[v], VertexPoint(int(ids[v])))
        for v in np.unique(cells)
        if f[v] == 0 and 0 <= s[v] <= length
    ]
    for v, w in {tuple(sorted((c[i], c[j]))) for c in cells for i, j in ((0, 1), (1, 2), (2, 0))}:
        if f[v] * f[w] < 0:
            if ids[v] > ids[w]:
                v, w = w, v
            t = f[v] / (f[v] - f[w])
            where = (1 - t) * s[v] + t * s[w]
            if 0 <= where <= length:
                met.append((where, EdgePoint((int(ids[v]), int(ids[w])), float(t))))
    return [point for _, point in sorted(met, key=lambda item: item[0])]


@pytest.mark.parametrize("kind", ["scattered", "grid", "slivers"])
def test_straight_leg_agrees_with_exact_arithmetic(kind, monkeypatch):
    monkeypatch.setattr(TargetSurface, "snap", 1e-9)
    rng = np.random.default_rng(["scattered", "grid", "slivers"].index(kind))
    seen = set()
    for _ in range(100):
        if kind == "scattered":
            points, cells = scattered(rng)
        else:
            points, cells = squares(6, 5)
            if kind == "slivers":
                points = sheared(points, int(rng.integers(-100, 101)), int(rng.integers(-9, 10)))
        ids = numbered(rng, points)
        a, b = random_place(rng, points, cells), random_place(rng, points, cells)
        if a == b:
            continue
        curved = points + np.array([0, 0, 1]) * np.sin(points[:, :1] + points[:, 1:2] ** 2)
        route = np.array([[float(x) for x in a], [float(x) for x in b]])
        path = trace(ids, curved, cells, route)
        links = path.links(ids[cells])
        crossings = [p for p in path.points if not isinstance(p, CellPoint)]
        same_points(crossings, exact_section(ids, points, cells, a, b), 1e-7)
        plan = path.positions(ids, points)
        assert np.allclose(plan[[0, -1], :2], route, rtol=0, atol=1e-9 * np.abs(points).max())
        assert length_of(plan) == pytest.approx(np.linalg.norm(route[1] - route[0]), rel=1e-9)
        seen |= {len(x) for x in links} | {type(p) for p in path.points}
    assert len(seen) == 5  # all kinds of points and links came up


OFFSETS = (0.0, 1e-16, 1e-14, 1e-9, 1e-5, 0.9e-3)


def special_lines(n):
    """Return lines of an n x n grid along edges, diagonals and the boundary, whole and halved."""
    lines = []
    for k in range(n + 1):
        lines += [((0, k), (n, k)), ((k, 0), (k, n)), ((0, k), (n - 0.5, k))]
    for k in range(n - 1):
        lines += [((k, 0), (n, n - k)), ((0, k), (n - k, n))]
        lines += [((k + 0.5, 0.5), (n - 0.5, n - k - 0.5))]
    return [np.array(line, dtype=float) for line in lines]


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.234])
@pytest.mark.parametrize("stretch", [1.0, 1e-4])
def test_lines_on_and_just_off_vertices_and_edges(turn, stretch):
    points, cells = squares(5)
    ids = np.arange(len(points)) * 3 + 1
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, s], [-s, c]])
    placed = points.copy()
    placed[:, :2] = (points[:, :2] * [1.0, stretch]) @ turned + 17.0
    rng = np.random.default_rng(5)
    for line in special_lines(5):
        exact = trace(ids, points, cells, line)
        smallest = min(1.0, stretch) / np.hypot(1.0, stretch)
        for offset in OFFSETS:
            shift = rng.uniform(-1.0, 1.0, (2, 2)) / np.sqrt(2.0) * offset * smallest
            shift[:, 0] *= offset < 1e-5 or stretch == 1.0
            route = (line * [1.0, stretch]) @ turned + 17.0 + shift @ turned
            path = trace(ids, placed, cells, route)
            path.links(ids[cells])
            assert [p.support for p in path.points] == [p.support for p in exact.points]


def test_two_thousand_random_legs_are_valid_and_straight():
    rng = np.random.default_rng(2026)
    refused = 0
    for case in range(2000):
        if case % 50 == 0:
            points, cells = (scattered(rng), squares(7))[case // 50 % 2]
            if case // 50 % 4 > 1:
                points = points * [1.0, 10.0 ** -rng.integers(1, 5), 1.0]
            angle = rng.uniform(0, 6)
            c, s = np.cos(angle), np.sin(angle)
            points = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            ids = numbered(rng, points)
            corners = points[cells]
            sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
            area = np.linalg.norm(
                np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
            )
            altitude = area / sides.max(axis=1)
        ends = []
        for cell in rng.integers(len(cells), size=2):
            weights = [[1, 0, 0], [0.5, 0.5, 0], rng.dirichlet([1, 1, 1])][rng.integers(3)]
            off = rng.choice([0, 1e-15, 1e-9, 1e-4, 5e-4]) * rng.uniform(-0.7, 0.7, 2)
            ends.append(weights @ points[cells[cell]][:, :2] + off * altitude[cell])
        try:
            path = trace(ids, points, cells, ends)
        except PathError as error:
            assert np.linalg.norm(ends[1] - ends[0]) < 2e-3 * altitude.max(), str(error)
            refused += 1
            continue
        path.links(ids[cells])
        x = path.positions(ids, points)[:, :2]
        reach = 4e-3 * altitude.max()
        d = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        aside = (x - ends[0]) @ [-d[1], d[0]]
        assert np.abs(aside).max() <= reach
        assert length_of(x) == pytest.approx(np.linalg.norm(ends[1] - ends[0]), abs=reach)
        assert (np.diff((x - ends[0]) @ d) > -reach).all()
    assert refused < 60


def passes(way, route, reach):
    """Say whether a polyline comes within `reach` of all points of a route, in order."""
    samples = np.vstack([np.linspace(a, b, 200) for a, b in pairwise(way)])
    k = 0
    for point in route:
        near = np.linalg.norm(samples[k:] - point, axis=1) <= reach
        if not near.any():
            return False
        k += int(np.argmax(near))
    return True


def test_random_routes_with_corners_give_valid_paths():
    rng = np.random.default_rng(7)
    refused = cut_off = 0
    for _ in range(250):
        points, cells = squares(5) if rng.random() < 0.5 else scattered(rng, 25, 5)
        ids = numbered(rng, points)
        k = int(rng.integers(3, 7))
        route = rng.integers(0, 6, (k, 2)) if rng.random() < 0.4 else rng.uniform(0, 5, (k, 2))
        if (np.diff(route, axis=0) == 0).all(axis=1).any():
            continue
        try:
            path = trace(ids, points, cells, route)
        except PathError as error:
            # a random route over five cells has many a way out and back
            hairpin = "would be cut off" in str(error)
            refused, cut_off = refused + (not hairpin), cut_off + hairpin
            assert hairpin or "turns back on itself" in str(error)
            continue
        path.links(ids[cells])
        x = path.positions(ids, points)[:, :2]
        assert np.allclose(x[[0, -1]], route[[0, -1]], atol=1e-2)
        assert length_of(x) <= length_of(route) + 1e-2
        assert passes(x, route, longest_sides(points[cells]).max() * 1.01)
    assert refused < 12 and cut_off < 70


HAIRPINS = (
    [(0.0, 5.0), (7.0, 5.3), (0.0, 5.5)],
    [(0.0, 3.0), (9.0, 3.0), (9.0, 3.4), (0.0, 3.4)],
    [(0.0, 5.0), (9.9, 5.0), (5.0, 5.0), (10.0, 5.2)],
    [(0.0, 5.1), (8.0, 5.2), (4.0, 5.3), (10.0, 5.4)],
)


@pytest.mark.parametrize("route", HAIRPINS)
def test_a_way_out_and_back_within_a_row_of_cells_is_refused(route):
    points, cells = squares(8)
    points *= 1.25
    ids = np.arange(len(points))
    with pytest.raises(PathError, match=r"route point [12] at .* cut off.* two cables") as caught:
        trace(ids, points, cells, route)
    mask = near_section(points, cells, route)
    assert_part_is_enough(ids, points, cells, mask, route)
    with pytest.raises(PathError) as in_space:
        trace(ids, points, cells, np.pad(route, ((0, 0), (0, 1))))
    assert str(in_space.value).split("would")[1] == str(caught.value).split("would")[1]


def test_routes_that_only_wind_are_laid():
    points, cells = squares(8)
    ids = np.arange(len(points))
    for route in (
        [(0.0, 4.1), (2.0, 4.4), (4.0, 3.7), (6.0, 4.4), (8.0, 4.0)],  # within a row
        [(0.0, 0.5), (5.0, 1.3), (0.0, 2.5)],  # out by one row and back by another
        [(0.0, 4.0), (4.2, 4.1), (4.1, 4.2), (8.0, 4.0)],  # a small step back
        [(1.5, 1.5), (6.5, 1.5), (6.5, 6.5), (1.5, 6.5), (1.5, 1.5)],  # a ring
        [(0.5, 0.5), (7.5, 7.5), (7.5, 0.5), (0.5, 7.5)],
        [(0.0, 3.2), (7.0, 3.2), (7.0, 5.4), (0.0, 5.4)],  # there and back with two rows between
    ):
        x = trace(ids, points, cells, route).positions(ids, points)[:, :2]
        assert passes(x, route, 1.42)


def test_corner_inside_a_cell_is_cut_and_a_hairpin_cancels():
    points, cells = squares(4)
    ids = np.arange(len(points))
    blunt = trace(ids, points, cells, [(0, 0.5), (2.3, 0.6), (4, 1.5)])
    assert not any(isinstance(p, CellPoint) for p in blunt.points)
    # in through the diagonal of a square and out of it again: the square's half is not needed
    hairpin = trace(ids, points, cells, [(0.0, 0.5), (0.7, 0.5), (0.1, 0.9)])
    assert [p.support for p in hairpin.points] == [(0, 1), (0, 1, 6)]
    with pytest.raises(PathError, match="turns back on itself"):
        trace(ids, points, cells, [(0, 0.5), (3, 0.5), (0, 0.5)])
    corner = trace(ids, points, cells, [(0, 2), (2, 2), (2, 4)])
    assert VertexPoint(12) in corner.points and len(corner.points) == 5


def test_numbering_orientation_and_mirror_do_not_matter():
    rng = np.random.default_rng(3)
    for _ in range(40):
        points, cells = scattered(rng)
        route = rng.uniform(1, 59, (2, 2))
        ids = np.arange(len(points))
        path = trace(ids, points, cells, route)
        x = path.positions(ids, points)
        order = rng.permutation(len(points))
        place = np.argsort(order)
        shuffled = rng.permuted(place[cells], axis=1)[rng.permutation(len(cells))]
        other_ids = numbered(rng, points)
        other = trace(other_ids, points[order], shuffled, route)
        assert np.allclose(other.positions(other_ids, points[order]), x, atol=1e-10)
        mirrored = trace(ids, points * [-1, 1, 1], cells, route * [-1, 1])
        same_points(mirrored.points, path.points)
        back = trace(ids, points, cells, route[::-1])
        same_points(back.points[::-1], path.points)


def notched(n=8):
    points, cells = squares(n)
    centre = points[cells].mean(axis=1)
    return points, cells[~((centre[:, :2] > n / 2).all(axis=1))]


def test_a_leg_over_a_notch_is_refused_where_it_leaves():
    points, cells = notched()
    ids = np.arange(len(points))
    rng = np.random.default_rng(11)
    outcomes = set()
    for _ in range(150):
        a, b = rng.uniform(0.1, 7.9, (2, 2))
        if 0 < min(a.min() - 4, b.min() - 4) < 0.1 or 0 < max(a.min() - 4, b.min() - 4) < 0.1:
            continue  # so near to the rim that it is meant to lie on it
        if (a > 4).all() or (b > 4).all():
            with pytest.raises(PathError, match="leaves the membrane"):
                trace(ids, points, cells, [a, b])
            continue
        t = np.linspace(0, 1, 4001)[:, None]
        depth = np.minimum(*((1 - t) * a + t * b - 4.0).T).max()
        if abs(depth) < 0.02:
            continue  # touches the corner
        outcomes.add(bool(depth > 0))
        if depth > 0:
            with pytest.raises(PathError, match="leaves the membrane at") as caught:
                trace(ids, points, cells, [a, b])
            x, y = (float(v) for v in str(caught.value).split("(")[1].split(",")[:2])
            assert min(abs(x - 4), abs(y - 4)) < 1e-5 and min(x, y) > 4 - 1e-5
        else:
            trace(ids, points, cells, [a, b]).links(cells)
    assert outcomes == {True, False}
    # through the notch's corner, and along its rim
    assert VertexPoint(4 * 9 + 4) in trace(ids, points, cells, [(2, 6), (6, 2)]).points
    assert len(trace(ids, points, cells, [(0, 4), (8, 4)]).points) == 9


def test_a_hole_is_refused():
    points, cells = squares(6)
    centre = points[cells].mean(axis=1)
    cells = cells[(np.abs(centre[:, :2] - 3) > 1).any(axis=1)]
    ids = np.arange(len(points))
    with pytest.raises(PathError, match=r"leaves the membrane at \(2, 3.1"):
        trace(ids, points, cells, [(0, 3.1), (6, 3.1)])
    around = trace(ids, points, cells, [(0, 3.1), (1.5, 4.6), (4.5, 4.6), (6, 3.1)])
    around.links(cells)


@pytest.mark.parametrize("degrees", [60, 85, 115])
def test_route_in_space_follows_great_circles_and_turns_with_the_dome(degrees):
    rng = np.random.default_rng(degrees)
    angle = np.deg2rad(degrees)
    points, cells = cap(angle)
    ids = numbered(rng, points)
    for _ in range(15):
        polar = np.sqrt(rng.uniform(0, 0.9, 2))[:, None] * 0.95
        phi = rng.uniform(0, 6.3) + np.array([0, rng.uniform(0.3, 2.8)])
        a, b = 10.0 * on_sphere(polar * np.column_stack([np.cos(phi), np.sin(phi)]), angle)
        arc = 10.0 * np.arccos(np.clip(a @ b / 100.0, -1, 1))
        path = trace(ids, points, cells, [a, b])
        path.links(ids[cells])
        x = path.positions(ids, points)
        assert length_of(x) == pytest.approx(arc, rel=0.03, abs=0.05)
        across = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
        assert np.abs(x @ across).max() < 0.15  # the facets tilt the plane a little
        turn = rotation(rng)
        turned = trace(ids, points @ turn.T, cells, [turn @ a, turn @ b])
        same_points(turned.points, path.points, 1e-7)
        inside_out = trace(ids, points, cells[:, ::-1], [a, b])
        same_points(inside_out.points, path.points, 1e-9)


def test_anchors_on_both_ends_of_a_turned_dome():
    points, cells = cap(np.deg2rad(70))
    ids = np.arange(len(points))
    ground = points[:, 2].min()
    a, b = np.array([-13.0, 0.0, ground]), np.array([12.5, 0.0, ground])
    path = trace(ids, points, cells, [a, b])
    assert path.start_anchor == tuple(a) and path.end_anchor == tuple(b)
    x = path.positions(ids, points)
    assert np.allclose(x[:, 1], 0.0, atol=0.1)
    assert x[0, 0] < -9 and x[-1, 0] > 9 and x[:, 2].max() > 9.8
    assert np.allclose(x[[0, -1], 2], ground, atol=1e-9)
    path.links(cells)
    turn = rotation(np.random.default_rng(1))
    turned = trace(ids, points @ turn.T, cells, [turn @ a, turn @ b])
    same_points(turned.points, path.points, 1e-9)
    one = trace(ids, points, cells, [a, (0.0, 0.0, 10.0)])
    assert one.end_anchor is None and one.points[-1] == VertexPoint(0)
    three = trace(ids, points, cells, [a, (0.0, 0.1, 10.0), b])
    assert np.allclose(three.positions(ids, points)[[0, -1]], x[[0, -1]], atol=0.2)


def test_points_off_the_membrane():
    points, cells = squares(4)
    ids = np.arange(len(points))
    with pytest.raises(PathError, match=r"outside of it in plan.*in space to make"):
        trace(ids, points, cells, [(-1, 2), (3, 2)])
    with pytest.raises(PathError, match=r"route point 1 .* leaves the membrane"):
        trace(ids, points, cells, [(0, 2), (3, 5), (4, 2)])
    with pytest.raises(PathError, match="only the first or last"):
        trace(ids, points, cells, [(0, 2, 0), (2, 5, 0), (4, 2, 0)])
    path = trace(ids, points, cells, [(-1, 2, 0.5), (3.0, 2.0, 0.0)])
    assert path.start_anchor == (-1.0, 2.0, 0.5)
    assert [p.support for p in path.points] == [(2,), (7,), (12,), (17,)]
    above = trace(ids, points, cells, [(0, 2, 3), (3, 2, 0)])  # a mast at the boundary
    assert above.start_anchor == (0.0, 2.0, 3.0) and above.points == path.points
    near = trace(ids, points, cells, [(-1e-14, 2, 0), (3, 2, 1e-3)])
    assert near.start_anchor is None and near.points == path.points


def test_anchor_in_a_hole_sees_only_the_side_of_its_leg():
    points, cells = squares(6)
    centre = points[cells].mean(axis=1)
    cells = cells[(np.abs(centre[:, :2] - 3) > 1).any(axis=1)]
    ids = np.arange(len(points))
    path = trace(ids, points, cells, [(3.4, 3.1, 1.0), (6, 3.1, 0)])
    assert path.start_anchor == (3.4, 3.1, 1.0)
    assert np.allclose(path.positions(ids, points)[0], [4, 3.1, 0])


def stepped():
    """Return a sheet with a vertical wall of height 1 at x = 2."""
    points, cells = squares(5, 3)
    x = points[:, 0].copy()
    points[:, 2] = x >= 3
    points[:, 0] = np.where(x >= 3, x - 1, x)
    return points, cells


def test_a_section_follows_a_wall():
    points, cells = stepped()
    ids = np.arange(len(points))
    path = trace(ids, points, cells, [(0, 0.3), (4, 2.2)])
    path.links(cells)
    x = path.positions(ids, points)
    assert length_of(x[:, :2]) == pytest.approx(np.hypot(4, 1.9), abs=1e-9)
    on_wall = np.abs(x[:, 0] - 2) < 1e-12
    assert on_wall.sum() >= 3 and set(x[on_wall, 2][[0, -1]]) == {0.0, 1.0}
    straight = trace(ids, points, cells, [(0, 1), (4, 1)])
    assert len(straight.points) == 6
    with pytest.raises(PathError, match="wall"):
        trace(ids, points, cells, [(2, 0), (2, 3)])


def test_overlapping_sheets_use_the_upper_one():
    low, cells = squares(4)
    points = np.vstack([low + np.array([0, 0, 5]), low])
    both = np.vstack([cells, cells + len(low)])
    for x in (points, points[::-1].copy()):
        path = trace(np.arange(len(x)), x, both, [(0.2, 0.3), (3.1, 2.5)])
        assert np.allclose(path.positions(np.arange(len(x)), x)[:, 2], 5)


def test_what_is_around_a_leg_gives_the_same_way_as_all_of_the_section(monkeypatch):
    """Also through places where the section goes on far beyond the leg, or is interrupted."""
    rng = np.random.default_rng(12)
    cases = []
    for case in range(40):
        points, cells = (scattered(rng, 150), cap(1.9), hall(1.8), notched())[case % 4]
        ids = numbered(rng, points)
        near = points[rng.permutation(len(points))[: 2 + case % 3]]
        near += rng.normal(size=near.shape) * 0.05 * (near - near.mean(axis=0))
        route = near if case % 4 in (1, 2) else near[:, :2]
        cases.append((ids, points, cells, route[np.argsort(route[:, 1])]))
    points, cells = hall(2.9)  # all of its section is around a leg past its opening
    ends = [10.0 * np.array([0.6, np.sin(angle), np.cos(angle)]) for angle in (-2.5, 2.5)]
    route = [points[np.argmin(np.linalg.norm(points - end, axis=1))] for end in ends]
    cases.append((np.arange(len(points)), points, cells, np.array(route)))

    def outcome(case):
        try:
            return trace(*case)
        except PathError as error:
            return str(error)

    taken = []

    def direct(*arguments):
        taken.append(_direct_way(*arguments))
        return taken[-1]

    monkeypatch.setattr("crms_fenicsx.foundation.surface.trace._direct_way", direct)
    found = [outcome(case) for case in cases]
    assert sum(way is not None for way in taken) > 20 < len(found)
    monkeypatch.setattr("crms_fenicsx.foundation.surface.trace._direct_way", lambda *_: None)
    assert found == [outcome(case) for case in cases]
    assert len({type(one) for one in found}) == 2


def test_strip_gives_the_same_path_as_the_whole_mesh():
    rng, taken = np.random.default_rng(21), 0
    for case in range(120):
        points, cells = (scattered(rng, 150), squares(14), cap(1.9))[case % 3]
        if case % 3 == 1:  # graded: the cells' sizes differ a thousandfold
            points = points * [1, 0, 0] + np.array([0, 1, 0]) * 2.0 ** points[:, 1:2] / 100
        ids = numbered(rng, points)
        if case % 3 == 2:
            route = points[rng.choice(len(points), 2, replace=False)] * rng.uniform(1, 1.002)
        else:
            low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
            route = rng.uniform(low, high, (2 + case % 2, 2))
            if case % 5 == 0:
                route[0] = points[rng.integers(len(points)), :2]
            if case % 7 == 0:
                route[1] += high - low  # outside: the same error
        mask = near_section(points, cells, route)
        assert_part_is_enough(ids, points, cells, mask, route)
        along = near_section(points, cells, route, along_legs=True)
        assert (along <= mask).all()
        taken += assert_along_legs_is_enough(ids, points, cells, along, route)
    assert 40 < taken < 110
    points, cells = squares(60)
    assert near_section(points, cells, [(0, 7.3), (60, 31.1)]).mean() < 0.1


def assert_along_legs_is_enough(ids, points, cells, mask, route):
    """On the cells along the legs a route has the same path as on all, if all go straight on."""
    try:
        found = trace(*part(ids, points, cells, mask), route, along_legs=True)
    except IndirectLeg:
        return False
    except PathError as error:
        with pytest.raises(PathError) as caught:
            trace(ids, points, cells, route)
        assert str(caught.value) == str(error)
        return False
    assert found == trace(ids, points, cells, route)
    return True


@pytest.mark.parametrize("space", [False, True])
def test_strip_of_a_mesh_divided_among_ranks(comm, space):
    points, cells = cap(1.2)
    route = np.array([[-20.0, 1.0, 3.0], [1.0, -0.3, 10.0], [8.0, 4.0, 4.5]])
    if not space:
        route = np.array([[-7.0, 1.0], [1.0, -0.3], [6.0, 4.0]])
    _, mask = assert_divided_mesh_is_enough(comm, points, cells, route)
    assert mask.mean() < 0.8
    assert (mask >= near_section(points, cells, route)).all()
    assert not near_section(points, np.zeros((0, 3), dtype=int), route[:, :2]).size


@pytest.mark.parametrize(
    ("route", "words"),
    [
        ([(0, 0), (np.nan, 1)], "finite"),
        ([(0, 0)], "two or more"),
        ([(0, 0), (0, 0)], "remove one"),
        ([(1, 1), (1 + 1e-9, 1)], "move them apart"),
        ([(0, 0), (1, 1, 0)], "of one dimension"),
        ([(0, 0, 0, 0), (1, 1, 0, 0)], "shape"),
        ([(-1, 2, 0), (-2, 2, 0)], "never meets"),
    ],
)
def test_bad_routes_are_refused(route, words):
    points, cells = squares(3)
    with pytest.raises(PathError, match=words):
        trace(np.arange(len(points)), points, cells, route)


def test_a_plan_does_not_tell_a_height_on_a_wall():
    points, cells = squares(3)
    upright = points[:, [0, 2, 1]]
    with pytest.raises(PathError, match=r"route point 0 at .* lies on a wall"):
        trace(np.arange(len(points)), upright, cells, [(1.2, 0.0), (2.0, 0.0)])


def test_ends_on_the_true_rim_of_a_faceted_disc_lie_on_its_boundary():
    """A point of the circle lies outside the polygon that the mesh makes of it."""
    points, cells = disc(rings=8)
    circle = np.array([[-0.8, -0.6], [0.28, 0.96]])
    path = trace(np.arange(len(points)), points, cells, circle)
    strip = near_section(points, cells, circle)
    assert trace(np.arange(len(points)), points, cells[strip], circle) == path
    rim = np.linalg.norm(points[:, :2], axis=1) > 0.999
    for end in (path.points[0], path.points[-1]):
        assert all(rim[vertex] for vertex in end.support)
    with pytest.raises(PathError, match="leaves the membrane"):
        trace(np.arange(len(points)), points, cells, 1.05 * circle)


def disc(rings):
    """A disc of radius 1 by Delaunay triangulation of concentric rings."""
    places = [(0.0, 0.0)]
    for k in range(1, rings + 1):
        turn = 2 * np.pi * (np.arange(6 * k) + 0.2 * k) / (6 * k)
        places += list(zip(k / rings * np.cos(turn), k / rings * np.sin(turn), strict=True))
    plan = np.array(places)
    cells = Delaunay(plan).simplices
    return np.column_stack([plan, np.zeros(len(plan))]), cells
