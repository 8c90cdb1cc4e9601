"""Geometry of triangles and lines: side turns and closest points against definitions."""

from __future__ import annotations

import numpy as np
import pytest

from crms_fenicsx.foundation.meshes.triangles import (
    closest_on_segments,
    side_turns,
    vertex_normals,
)


def test_side_turns_of_a_circle_on_a_sphere() -> None:
    """On a great circle 0, on a parallel sin(latitude) of the angle."""
    for latitude in (0.0, 0.5, 1.1):
        t = np.linspace(0.0, 1.0, 101)
        x = np.stack([np.cos(latitude) * np.cos(t), np.cos(latitude) * np.sin(t)], axis=1)
        places = np.column_stack([x, np.full(101, np.sin(latitude))])
        turns = side_turns(places, places)
        np.testing.assert_allclose(turns[1:-1], 0.01 * np.sin(latitude), atol=1e-6)


def test_side_turns_halve_the_angle_of_the_two_sides() -> None:
    """Of the cells around a vertex, also where these are bent or unequal."""
    draws = np.random.default_rng(4)
    for bend in (0.0, 0.02, 0.05):
        angles = np.sort(draws.uniform(0.0, 1.0, 7) + np.arange(7)) * 2 * np.pi / 8
        sizes = draws.uniform(0.7, 1.4, 7)
        ring = sizes[:, None] * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        ring[:, 2] = bend * ring[:, :2] @ [1.0, 0.5] + bend * sizes**2
        points = np.concatenate([np.zeros((1, 3)), ring])
        cells = np.array([(0, k + 1, (k + 1) % 7 + 1) for k in range(7)])
        row = np.array([1, 0, 4])
        found = side_turns(points[row], vertex_normals(points, cells)[row])[1]
        ways = ring / np.linalg.norm(ring, axis=1)[:, None]
        between = np.arccos(np.sum(ways * np.roll(ways, -1, axis=0), axis=1))
        half = (between[:3].sum() - between[3:].sum()) / 2
        assert found == pytest.approx(half, abs=bend**2 + 1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_closest_on_segments_is_no_farther_than_any_point(d: int) -> None:
    """Also of segments without length."""
    draws = np.random.default_rng(d)
    start, way = draws.normal(size=(2, 40, d))
    way[::10] = 0.0
    places = draws.normal(size=(30, 1, d))
    share, found, gaps = closest_on_segments(start, way, places)
    assert share.shape == gaps.shape == (30, 40) and ((share >= 0.0) & (share <= 1.0)).all()
    np.testing.assert_allclose(found, start + share[..., None] * way)
    np.testing.assert_allclose(gaps, np.linalg.norm(found - places, axis=-1))
    for other in np.linspace(0.0, 1.0, 101):
        assert (gaps <= np.linalg.norm(start + other * way - places, axis=-1) + 1e-12).all()
