"""Routes from anchors over a membrane, and legs whose direct way is interrupted by an opening."""

from __future__ import annotations

import numpy as np
import pytest
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

from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.closest_point import feet_of
from crms_fenicsx.foundation.surface.points import CellPoint
from crms_fenicsx.foundation.surface.trace import near_section, trace

pytestmark = pytest.mark.ranks

SNAP = 1e-3  # the default of `trace`


def normal_of_leg(points, cells, a, b):
    """Return the unit normal of the plane of the leg from a to b."""
    up = sum(foot.normal for foot in feet_of(points, cells, np.array([a, b])))
    across = np.cross(up, b - a)
    return across / np.linalg.norm(across)


def distance_in_plane(points, cells, target, across):
    """Cut every cell with the plane through `target`, one by one: the slow twin."""
    least = np.inf
    for cell in cells:
        corners = points[cell] - target
        h = corners @ across
        cut = [corners[i] for i in range(3) if h[i] == 0.0]
        for i, j in ((0, 1), (1, 2), (2, 0)):
            if h[i] * h[j] < 0.0:
                cut.append((h[j] * corners[i] - h[i] * corners[j]) / (h[j] - h[i]))
        if len(cut) == 2:
            a, d = cut[0], cut[1] - cut[0]
            t = np.clip(-(a @ d) / max(d @ d, 1e-300), 0.0, 1.0)
            least = min(least, float(np.linalg.norm(a + t * d)))
    return least


def squashed(angle=1.0):
    """Return half an ellipsoid's top: its normals do not meet in one point."""
    points, cells = cap(angle)
    return points * [1.0, 0.6, 0.8], cells


@pytest.mark.parametrize("surface", ["ellipsoid", "hall"])
def test_path_begins_in_the_plane_of_the_leg_under_the_anchor(surface):
    rng = np.random.default_rng(1)
    points, cells = squashed() if surface == "ellipsoid" else hall(1.5)
    ids = numbered(rng, points)
    size = 3.0
    assert size > np.linalg.norm(points[cells] - points[cells[:, [1, 2, 0]]], axis=2).max()
    centre = points.mean(axis=0)
    inner = np.flatnonzero(np.linalg.norm(points - centre, axis=1) < 7.0)
    kinds, beside = set(), []
    for _ in range(30):
        below, b = points[rng.choice(inner, 2, replace=False)]
        a = below + 10.0 ** rng.uniform(0, 1.5) * feet_of(points, cells, below[None])[0].normal
        across = normal_of_leg(points, cells, a, b)
        path = trace(ids, points, cells, [a, b])
        path.links(ids[cells])
        assert path.start_anchor == tuple(a) and path.end_anchor is None
        x = path.positions(ids, points)
        # vertices as near to the plane as this count as lying in it; on a slope of up to 60 degrees
        # that changes heights by twice as much
        assert np.abs((x - a) @ across).max() <= SNAP * size
        nearest = distance_in_plane(points, cells, a, across)
        assert nearest == pytest.approx(np.linalg.norm(x[0] - a), abs=2 * SNAP * size)
        beside.append(abs((feet_of(points, cells, a[None])[0].position - a) @ across))
        kinds.add(type(path.points[0]))

        assert trace(*part(ids, points, cells, near_section(points, cells, [a, b])), [a, b]) == path
        back = trace(ids, points, cells, [b, a])
        assert back.end_anchor == tuple(a)
        same_points(back.points[::-1], path.points, 1e-8)
        turn = rotation(rng)
        turned = trace(ids, points @ turn.T, cells, [turn @ a, turn @ b])
        same_points(turned.points, path.points, 1e-8)
        mirror = np.array([1.0, -1.0, 1.0])
        mirrored = trace(ids, points * mirror, cells[:, ::-1], [a * mirror, b * mirror])
        same_points(mirrored.points, path.points, 1e-8)
    assert max(beside) > 0.1 * size  # the nearest place of all would not do
    assert CellPoint in kinds


def test_path_between_the_feet_of_two_anchors_over_a_plane_is_that_in_plan():
    rng = np.random.default_rng(4)
    lengths = set()
    for case in range(100):
        points, cells = squares(5) if case % 2 else scattered(rng)
        ids = numbered(rng, points)
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        plan = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (2, 2))
        if case % 3 == 0:  # near or in the same cell
            plan[1] = plan[0] + 0.02 * (high - low)
        elif case % 3 == 1 and case % 2:  # over a vertex and an edge, and along edges
            plan = np.array([[1.0, 1.0], [4.0, 2.5]])[:: rng.choice([-1, 1])]
            plan[1, 1] = rng.choice([plan[0, 1], plan[1, 1]])
        heights = 10.0 ** rng.uniform(0, 3, (2, 1)) * (high - low).max() / 5.0
        path = trace(ids, points, cells, np.hstack([plan, heights]))
        expected = trace(ids, points, cells, plan)
        path.links(ids[cells])
        # feet along edges are in a cell of the edge, of which there are two; ends in one cell are
        # linked in plan, where the section may pass through a vertex as near as `snap`
        x, y = (p.positions(ids, points) for p in (path, expected))
        assert np.allclose(x, y, rtol=0, atol=SNAP * (high - low).max())
        same_points(path.points[1:-1], expected.points[1:-1])
        assert path.start_anchor is not None and path.end_anchor is not None
        lengths.add(len(path.points))
    assert min(lengths) == 2 and max(lengths) > 8


@pytest.mark.parametrize("degrees", [60, 85, 115])
def test_masts_over_a_dome(degrees):
    rng = np.random.default_rng(degrees)
    angle = np.deg2rad(degrees)
    points, cells = cap(angle)
    ids = np.arange(len(points))
    for _ in range(10):
        phi = rng.uniform(0, 6.3) + np.array([0, rng.uniform(0.3, 2.8)])
        polar = np.sqrt(rng.uniform(0, 0.8, 2))[:, None]
        u, v = on_sphere(polar * np.column_stack([np.cos(phi), np.sin(phi)]), angle)
        route = np.array([10.0 + rng.uniform(1, 8), 10.0 + rng.uniform(1, 8)])[:, None] * [u, v]
        path = trace(ids, points, cells, route)
        x = path.positions(ids, points)
        arc = 10.0 * np.arccos(np.clip(u @ v, -1, 1))
        # a high anchor's nearest place is up to half a cell off that of the sphere
        cell = 10.0 * angle / 9
        assert length_of(x) == pytest.approx(arc, rel=0.03, abs=cell)
        assert np.linalg.norm(x[[0, -1]] - 10.0 * np.array([u, v]), axis=1).max() < 0.6 * cell
        assert np.abs(x @ np.cross(u, v)).max() < 0.5 * np.linalg.norm(np.cross(u, v))


def test_a_route_may_name_the_foot_of_its_anchor():
    points, cells = squares(4)
    ids = np.arange(len(points))
    path = trace(ids, points, cells, [(2, 2, 3), (4, 2, 0)])
    assert path.start_anchor == (2.0, 2.0, 3.0)
    assert [p.support for p in path.points] == [(12,), (17,), (22,)]
    assert trace(ids, points, cells, [(2, 2, 3), (2, 2, 0), (4, 2, 0)]) == path
    both = trace(ids, points, cells, [(2, 2, 3), (2, 2, 0), (4, 2, 0), (4, 2, 3)])
    assert both.points == path.points and both.end_anchor == (4.0, 2.0, 3.0)
    with pytest.raises(PathError, match="one place only"):
        trace(ids, points, cells, [(2, 2, 3), (2, 2, 0)])
    with pytest.raises(PathError, match="no section plane"):
        trace(ids, points, cells, [(2, 2, 3), (2, 2, 5)])
    with pytest.raises(PathError, match="only the first or last"):
        trace(ids, points, cells, [(0, 2, 0), (2, 2, 3), (4, 2, 0)])


@pytest.mark.parametrize("degrees", [60, 90, 115])
def test_anchors_inside_are_refused(degrees):
    rng = np.random.default_rng(degrees)
    points, cells = cap(np.deg2rad(degrees))
    ids = np.arange(len(points))
    turn = rotation(rng)
    for _ in range(20):
        a, b = on_sphere(rng.uniform(-0.6, 0.6, (2, 2)), np.deg2rad(degrees)) * 10.0
        a *= rng.uniform(0.85, 0.95)
        for route in ([a, b], [b, a]):
            with pytest.raises(PathError, match=r"inside the membrane.*outside"):
                trace(ids, points, cells, route)
            with pytest.raises(PathError, match="inside the membrane"):
                trace(ids, points @ turn.T, cells, route @ turn.T)
            trace(ids, points, cells[:, ::-1], route)  # inside out, it is outside
    with pytest.raises(PathError, match="inside the membrane"):
        trace(ids, points, cells, [0.9 * points[0], points[0], points[30]])


def test_ground_anchors_lower_than_the_boundary_are_not_inside():
    points, cells = cap(1.0)
    ids = np.arange(len(points))
    for low in (0.0, -5.0):
        path = trace(ids, points, cells, [(-11.0, 0.0, low), (0.0, 0.0, 10.0), (11.0, 0.0, low)])
        assert path.start_anchor is not None and path.end_anchor is not None
        x = path.positions(ids, points)
        assert np.allclose(x[[0, -1], 2], points[:, 2].min(), rtol=0, atol=1e-9)


def test_strip_holds_all_that_a_steep_leg_needs():
    """The plane of a leg that goes down steeply turns with the smallest move of its end."""
    rng = np.random.default_rng(8)
    for case in range(60):
        points, cells = (squares(20), squashed(1.2), hall(1.5))[case % 3]
        ids = numbered(rng, points)
        top = points[rng.choice(np.flatnonzero(points[:, 2] >= 0.7 * points[:, 2].max()))]
        a = top + 30.0 * feet_of(points, cells, top[None])[0].normal + rng.uniform(-0.4, 0.4, 3)
        b = top + rng.uniform(-2e-4, 2e-4, 3)  # it snaps
        far = points[rng.integers(len(points))]
        route = np.array([a, b, far]) if case % 2 else np.array([a, b])
        mask = near_section(points, cells, route)
        assert_part_is_enough(ids, points, cells, mask, route)


def test_anchors_over_a_mesh_divided_among_ranks(comm):
    points, cells = cap(1.2)
    route = np.array([[-4.0, 1.0, 14.0], [1.0, -0.3, 10.0], [8.0, 4.0, 9.5]])
    whole, mask = assert_divided_mesh_is_enough(comm, points, cells, route)
    assert mask.mean() < 0.6
    assert isinstance(whole.points[0], CellPoint) and whole.end_anchor == tuple(route[-1])


def test_way_around_the_back_of_a_tube_is_refused_where_the_front_has_a_hole():
    rng = np.random.default_rng(12)
    points, cells = hall(np.pi, n=(8, 36))
    ids = numbered(rng, points)
    around = np.arctan2(*points[cells].mean(axis=1)[:, 1:].T)
    refused = []
    for case in range(100):
        if case % 10 == 0:
            centre, half = rng.uniform(-np.pi, np.pi), np.deg2rad(rng.uniform(12, 38))
            off = np.abs(np.angle(np.exp(1j * (around - centre))))
            kept = cells[(off > half) | (np.abs(points[cells].mean(axis=1)[:, 0] - 6) > 4)]
        # the hole is as much as a cell smaller or wider than `half`
        spread = rng.uniform(0.0, rng.choice([0.5, 2.9 - half]), 2)
        angles = centre + rng.choice([-1, 1], 2) * (half + 0.18 + spread)
        turned = np.angle(np.exp(1j * (angles - centre)))
        way = np.angle(np.exp(1j * (angles[1] - angles[0])))
        route = np.column_stack([[6.1, 6.1], 10 * np.sin(angles), 10 * np.cos(angles)])
        over = abs(turned[0] + way) < np.pi and turned[0] * turned[1] < 0.0
        if not 0.2 < abs(way) < (0.94 if over else 0.98) * np.pi:  # no length, or about half around
            continue
        mask = near_section(points, kept, route)
        if over:
            with pytest.raises(PathError, match="around the back") as caught:
                trace(ids, points, kept, route)
            with pytest.raises(PathError) as again:
                trace(*part(ids, points, kept, mask), route)
            assert str(again.value) == str(caught.value)
        else:
            path = trace(ids, points, kept, route)
            assert path == trace(ids, points, cells, route)
            assert path == trace(*part(ids, points, kept, mask), route)
        refused.append(over)
    assert 10 < sum(refused) < len(refused) - 10
    below = cells[np.abs(around) < np.deg2rad(150)]
    ends = 0.485 * np.pi * np.array([-1, 1])  # the way below is 6 % longer: none is direct
    route = np.column_stack([[6.1, 6.1], 10 * np.sin(ends), 10 * np.cos(ends)])
    assert trace(ids, points, below, route) == trace(ids, points, cells, route)


def test_a_leg_behind_the_door_of_a_dome_is_refused():
    points, cells = cap(np.deg2rad(115))
    ids = np.arange(len(points))
    x, y, z = points[cells].mean(axis=1).T
    cells = cells[(z > 3.0) | (np.abs(np.arctan2(y, x)) > 0.35)]

    def places(polar, azimuth):
        plan = polar / 115.0 * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        return 10.0 * on_sphere(plan, np.deg2rad(115))

    with pytest.raises(PathError, match=r"leaves the membrane at .* around the back"):
        trace(ids, points, cells, places(85.0, np.array([-0.8, 0.8])))
    above = places(40.0, np.array([-0.8, 0.8]))
    assert length_of(trace(ids, points, cells, above).positions(ids, points)) < 10.0
    led = trace(ids, points, cells, [*places(85.0, np.array([-0.8])), above[1], (0.0, 0.0, 10.0)])
    assert len(led.points) > 5


@pytest.mark.parametrize("degrees", [60, 90, 115, 130])
def test_legs_from_ground_to_ground_over_the_top_are_not_refused(degrees):
    rng = np.random.default_rng(degrees)
    half = np.deg2rad(degrees)
    dome, dome_cells = cap(half)
    barrel, barrel_cells = hall(half)
    for _ in range(15):
        turn = rotation(rng)
        azimuth = rng.uniform(0, 6.3) + np.array([0.0, np.pi + rng.uniform(-0.1, 0.1)])
        part_of = rng.uniform(0.85, 1.0, 2)
        plan = part_of[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        route = 10.0 * on_sphere(plan, half)
        path = trace(np.arange(len(dome)), dome @ turn.T, dome_cells, route @ turn.T)
        long = 10.0 * half * part_of.sum()
        assert length_of(path.positions(np.arange(len(dome)), dome)) == pytest.approx(long, rel=0.1)

        angles = half * part_of * [-1, 1]
        x = rng.uniform(1, 11) + rng.choice([0.0, rng.uniform(-1, 1)]) * np.array([-1, 1])
        route = np.column_stack([x, 10 * np.sin(angles), 10 * np.cos(angles)])
        path = trace(np.arange(len(barrel)), barrel @ turn.T, barrel_cells, route @ turn.T)
        found = length_of(path.positions(np.arange(len(barrel)), barrel))
        assert found == pytest.approx(np.hypot(long, np.diff(x)[0]), rel=0.1)
