"""Normals, edges and lengths on the smooth surface through the vertices of a triangulation."""

from __future__ import annotations

import numpy as np
import pytest
from grids import grid

from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface, arc_lengths_on

RADIUS = 5.0


def surface_over(n: int, height) -> tuple[np.ndarray, np.ndarray]:
    """A grid of n x n squares over [-1, 1]^2, each cut in two, with irregular vertices."""
    line = np.linspace(-1.0, 1.0, n + 1)
    points, cells = grid(line, line, by_rows=True)
    plan = points[:, :2]
    inside = np.abs(plan).max(axis=1) < 1.0
    plan[inside] += np.random.default_rng(1).uniform(-0.3, 0.3, (inside.sum(), 2)) / n
    return np.column_stack([plan, height(*plan.T)]), cells


def ball(x, y):
    return np.sqrt(RADIUS**2 - x**2 - y**2)


def inner_edges(cells: np.ndarray, surface: SmoothSurface) -> np.ndarray:
    """Edges with a normal at both ends, (k, 2)."""
    pairs = np.unique(np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return pairs[(surface.normals[pairs] != 0.0).any(axis=2).all(axis=1)]


def middles(pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners and weights of the middles of edges."""
    corners = np.column_stack([pairs, np.zeros(len(pairs), dtype=int)])
    return corners, np.tile([0.5, 0.5, 0.0], (len(pairs), 1))


def test_normals_of_a_sphere() -> None:
    points, cells = surface_over(8, ball)
    surface = SmoothSurface.of(points, cells)
    known = (surface.normals != 0.0).any(axis=1)
    np.testing.assert_array_equal(known, np.abs(points[:, :2]).max(axis=1) < 1.0)
    np.testing.assert_allclose(surface.normals[known], points[known] / RADIUS, atol=1e-13)


@pytest.mark.parametrize("n", [8, 16])
def test_raised_places_are_on_a_sphere(n: int) -> None:
    """Off it by the fourth power of the size of the cells, facets by the second."""
    points, cells = surface_over(n, ball)
    surface = SmoothSurface.of(points, cells)
    corners, weights = middles(inner_edges(cells, surface))
    offsets, normals = surface.raised(corners, weights)
    flat = points[corners[:, :2]].mean(axis=1)
    h = 2.0 * np.sqrt(2.0) / n
    assert np.abs(np.linalg.norm(flat + offsets, axis=1) - RADIUS).max() < h**4 / RADIUS**3 / 8
    np.testing.assert_allclose(normals, flat / np.linalg.norm(flat, axis=1)[:, None], atol=1e-3)


def test_inside_of_cells() -> None:
    points, cells = surface_over(8, ball)
    surface = SmoothSurface.of(points, cells)
    inner = cells[(surface.normals[cells] != 0.0).any(axis=2).all(axis=1)]
    weights = np.random.default_rng(2).dirichlet(np.ones(3), len(inner))
    offsets, _ = surface.raised(inner, weights)
    places = np.einsum("kc,kcx->kx", weights, points[inner]) + offsets
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), RADIUS, rtol=1e-5)


def test_a_plane_stays_flat() -> None:
    points, cells = surface_over(6, lambda x, y: 0.3 * x - 0.2 * y)
    surface = SmoothSurface.of(points, cells)
    corners, weights = middles(np.sort(cells[:, :2], axis=1))
    offsets, _ = surface.raised(corners, weights)
    np.testing.assert_allclose(offsets, 0.0, atol=1e-15)


def test_one_end_without_a_normal() -> None:
    """Edges to the boundary of a sphere's mesh are arcs of the circle that the inner end tells."""
    points, cells = surface_over(8, ball)
    surface = SmoothSurface.of(points, cells)
    pairs = np.unique(np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    known = (surface.normals[pairs] != 0.0).any(axis=2)
    corners, weights = middles(pairs[known.sum(axis=1) == 1])
    offsets, _ = surface.raised(corners, weights)
    places = points[corners[:, :2]].mean(axis=1) + offsets
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), RADIUS, rtol=1e-4)


def test_creases_stay() -> None:
    """Vertices of a ridge of 90 degrees have no normal; those of a slight fold have."""
    for slope, sharp in ((1.0, True), (0.1, False)):
        points, cells = surface_over(6, lambda x, y, slope=slope: -slope * np.abs(x))
        points[np.abs(points[:, 0]) < 0.1, ::2] = 0.0
        surface = SmoothSurface.of(points, cells)
        ridge = (points[:, 0] == 0.0) & (np.abs(points[:, 1]) < 1.0)
        assert ridge.sum() == 5
        assert (surface.normals[ridge] == 0.0).all() == sharp


def test_length_of_an_arc() -> None:
    """By the fourth power of the chords' length; straight parts have their chords'."""
    errors = []
    for n in (4, 8):
        t = np.linspace(0.0, 1.0, n + 1)
        normals = np.column_stack([np.cos(t), np.sin(t), 0 * t])
        points, flags = RADIUS * normals, np.zeros(n, dtype=bool)
        errors.append(abs(arc_lengths_on(points, normals, flags).sum() - RADIUS))
        chords = 2 * RADIUS * n * np.sin(0.5 / n)
        assert arc_lengths_on(points, normals, ~flags).sum() == pytest.approx(chords, rel=1e-14)
        normals[[0, -1]] = 0.0  # ends at a boundary
        assert arc_lengths_on(points, normals, flags).sum() == pytest.approx(RADIUS, rel=1e-4)
    assert errors[1] < errors[0] / 12 and errors[0] < 1e-4 * RADIUS
