"""Covers of holes: which parts of a boundary they close, and that they close them once."""

from __future__ import annotations

import numpy as np
import pytest
from grids import grid

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.triangles import double_areas
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.surface.holes import covers


def sheet(n: int, open_at: set[tuple[int, int]]) -> tuple[Array, Integers]:
    """A plane sheet of n x n squares of two triangles, some of them left out."""
    points, cells = grid(np.arange(n + 1.0), np.arange(n + 1.0), by_rows=True)
    there = [(i, j) not in open_at for i, j in np.ndindex(n, n)]
    return points, cells[np.repeat(there, 2)]


def covers_of(points: Array, cells: Integers) -> list[Integers]:
    """The covers of a surface."""
    table = EdgeTable.of(cells)
    counts = np.empty(3 * len(cells), dtype=np.int64)
    counts[table.order] = np.repeat(table.counts, table.counts)
    cell, k = np.divmod(np.flatnonzero(counts == 1), 3)
    sides = np.stack([cells[cell, k], cells[cell, (k + 1) % 3]], axis=1)
    opposite = cells[cell, (k + 2) % 3]
    vertices = np.unique(np.concatenate([sides.ravel(), opposite]))
    return covers(sides, opposite, vertices, points[vertices])


def areas(points: Array, cells: Integers) -> Array:
    """Signed areas of triangles in plan."""
    return np.asarray(double_areas(points[cells])[:, 2] / 2)


@pytest.mark.parametrize("turned", [0.0, 0.7])
def test_a_hole_is_closed_by_triangles_of_its_area_with_the_cells_orientation(
    turned: float,
) -> None:
    points, cells = sheet(7, {(2, 3), (3, 3), (4, 3), (4, 4), (2, 4)})  # a U
    c, s = np.cos(turned), np.sin(turned)
    (found,) = covers_of(points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), cells)
    assert areas(points, found).min() > 0.1
    assert areas(points, found).sum() == pytest.approx(5.0, rel=1e-12)
    # with the cells every edge of the rim has two triangles
    assert not covers_of(points, np.concatenate([cells, found]))


def test_a_concave_part_of_the_outer_boundary_is_closed_to_its_convex_hull() -> None:
    corner = {(i, j) for i in range(3, 6) for j in range(2, 6)}
    points, cells = sheet(6, corner)
    (found,) = covers_of(points, cells)
    assert areas(points, found).min() > 0.0
    assert areas(points, found).sum() == pytest.approx(3.0 * 4.0 / 2, rel=1e-12)
    assert not covers_of(*sheet(4, set()))


def test_an_opening_at_the_crown_is_a_hole_and_the_edge_on_the_ground_is_not() -> None:
    angles, heights = np.linspace(0, 2 * np.pi, 12, endpoint=False), np.arange(0.0, 1.3, 0.3)
    rings = [
        (np.cos(h) * np.cos(a), np.cos(h) * np.sin(a), np.sin(h)) for h in heights for a in angles
    ]
    cells = []
    for k in range(len(heights) - 1):
        for i in range(12):
            a, b = 12 * k + i, 12 * k + (i + 1) % 12
            cells += [(a, b, b + 12), (a, b + 12, a + 12)]
    (found,) = covers_of(np.array(rings), np.array(cells))
    assert set(found.ravel().tolist()) == set(range(48, 60))
    assert areas(np.array(rings), found).min() > 0.0


def test_a_hole_around_another_part_stays_open() -> None:
    around = {(i, j) for i in range(1, 6) for j in range(1, 6)} - {(3, 3)}
    assert not covers_of(*sheet(7, around))
