"""The nearest places of a surface: against each target and each cell on its own."""

from __future__ import annotations

import numpy as np
import pytest
from trace_surfaces import cap, hall, scattered, squares

from crms_fenicsx.foundation.meshes.triangles import closest, double_areas, longest_sides
from crms_fenicsx.foundation.surface import plane_section
from crms_fenicsx.foundation.surface.closest_point import Balls, feet_of
from crms_fenicsx.foundation.surface.plane_section import Plane, strips

pytestmark = pytest.mark.ranks

SURFACES = {
    "cap": lambda rng: cap(2.9),
    "tube": lambda rng: hall(np.pi),
    "scattered": lambda rng: scattered(rng),
}


def foot_of(points, cells, target):
    """The nearest place, its distance, the normal and the cell's size: the slow twin."""
    weights, places, gaps = closest(points[cells], target)
    nearest = int(np.argmin(gaps))
    corners = points[cells[nearest]]
    size = float(longest_sides(corners[None])[0])
    normal = np.zeros(3)
    for weight, corner in zip(weights[nearest], corners, strict=True):
        area = np.zeros(3)
        for cell, own in zip(cells, double_areas(points[cells]), strict=True):
            if min(np.linalg.norm(points[v] - corner) for v in cell) <= 1e-9 * size:
                area += own
        normal += weight * area / np.linalg.norm(area)
    return places[nearest], gaps[nearest], normal / np.linalg.norm(normal), size


def targets_near(rng, points, cells):
    """Anywhere, on vertices, in the middle of edges, and in cells."""
    scale = np.abs(points).max()
    corners = points[cells]
    return np.concatenate(
        [
            rng.normal(size=(8, 3)) * scale,
            points[:3],
            corners[:3, :2].mean(axis=1),
            corners[3:6].mean(axis=1) + 1e-3 * scale,
        ]
    )


@pytest.mark.parametrize("surface", SURFACES)
def test_feet_are_the_nearest_places(surface):
    rng = np.random.default_rng(4)
    points, cells = SURFACES[surface](rng)
    targets = targets_near(rng, points, cells)
    for target, found in zip(targets, feet_of(points, cells, targets), strict=True):
        place, distance, normal, size = foot_of(points, cells, target)
        np.testing.assert_array_equal(found.position, place)
        assert (found.distance, found.size) == (distance, size)
        np.testing.assert_allclose(found.normal, normal, atol=1e-12)


def test_feet_on_a_mesh_divided_among_ranks(comm):
    rng = np.random.default_rng(5)
    points, cells = cap(1.9)
    targets = targets_near(rng, points, cells)
    own = cells[np.arange(len(cells)) % max(comm.size - 1, 1) == comm.rank]  # the last one has none
    due = feet_of(points, cells, targets)
    for one, other in zip(feet_of(points, own, targets, comm), due, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-12)
        np.testing.assert_allclose(one.normal, other.normal, atol=1e-12)
        assert one.distance == pytest.approx(other.distance, abs=1e-12)
        assert one.size in longest_sides(points[cells])  # of one of those that are equally near
    assert comm.allreduce(len(own)) == len(cells)


def test_pairs_within_reach():
    rng = np.random.default_rng(6)
    centre, targets = rng.normal(size=(200, 3)) + 1e3, rng.normal(size=(9, 3)) + 1e3
    reach = rng.uniform(0.1, 2.0, 9)
    radius = rng.uniform(0.0, 0.2, 200)
    apart = np.linalg.norm(centre - targets[:, None], axis=2)
    found = Balls(centre, radius).within(targets, reach)
    np.testing.assert_array_equal(
        np.transpose(found), np.argwhere(apart - radius <= reach[:, None])
    )
    least = Balls(centre, radius).least_reach(targets)
    assert (apart.min(axis=1) <= least).all()
    np.testing.assert_allclose(least, apart.min(axis=1), atol=1e-5)


@pytest.mark.parametrize("block", [1, 10**7])
def test_strips_along_planes(monkeypatch, block):
    """Cell by cell, with and without a margin."""
    monkeypatch.setattr(plane_section, "PAIRS", block)
    rng = np.random.default_rng(7)
    points, cells = squares(12)
    up = np.array([0.0, 0.0, 1.0])
    ends = rng.uniform(1.0, 11.0, (6, 2, 3)) * (1.0, 1.0, 0.0)
    planes = [Plane.of(a, b, up, up) for a, b in ends]
    for margin in (np.inf, 1.5):
        due = []
        for k, plane in enumerate(planes):
            for row, cell in enumerate(cells):
                h, s = ((points[cell] - plane.origin) @ way for way in (plane.across, plane.ahead))
                past = np.maximum(np.maximum(-s, s - plane.length), 0.0) / plane.length
                cut = h.min() <= 0.0 < h.max() or (abs(h) <= 0.2 * (1.0 + 2.0 * past)).any()
                if cut and ((-margin < s) & (s < plane.length + margin)).any():
                    due.append((k, row))
        found = strips(planes, points, cells, 0.1, margin)
        np.testing.assert_array_equal(np.transpose(found), due)
