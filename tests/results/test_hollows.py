"""Hollows of surfaces: by hand, by a slow twin, and on any number of processes."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from cabled_square import clamped, sheet
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.results.hollows import _hollows_of


def grid(n: int) -> tuple[Array, Integers]:
    """n x n squares of the size 1, each in two triangles that face up."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (one.ravel() for one in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), triangles


def rim(points: Array) -> Booleans:
    half = points[:, :2].max() / 2
    return np.asarray(np.abs(points[:, :2] - half).max(axis=1) == half)


def filled_slowly(z: Array, triangles: Integers, outlets: list[int]) -> Array:
    """Water that rises from the outlets inward, always at the lowest place next."""
    near: dict[int, set[int]] = {}
    for triangle in triangles.tolist():
        for point in triangle:
            near.setdefault(point, set()).update(triangle)
    fill = np.array(z)
    queue = [(float(z[k]), k) for k in outlets]
    heapq.heapify(queue)
    known = set(outlets)
    while queue:
        level, k = heapq.heappop(queue)
        fill[k] = level
        for other in near[k] - known:
            known.add(other)
            heapq.heappush(queue, (max(level, float(z[other])), other))
    return fill


def test_one_point_that_is_low() -> None:
    """Depth 2 at the middle of six triangles: a third of that over their area, 3."""
    points, triangles = grid(2)
    points[:, 2] = 5.0
    points[4, 2] = 3.0
    (hollow,) = _hollows_of(points, triangles, rim(points), 1e-6).hollows
    assert (hollow.at, hollow.depth, hollow.level) == ((1.0, 1.0, 3.0), 2.0, 5.0)
    assert hollow.volume == pytest.approx(2.0)
    assert hollow.area == pytest.approx(3.0)
    turned = _hollows_of(
        points, triangles[:, ::-1], rim(points), 1e-6
    ).hollows  # its outside faces down
    assert turned == (hollow,)


def test_a_way_out_and_two_hollows_that_are_one() -> None:
    """A channel lets the water out at its highest place; hollows that meet below the rim fill to
    one level."""
    points, triangles = grid(8)
    z = points[:, 2] = 3.0 + 0 * points[:, 0]
    row = points[:, 1] == 4.0
    points[row & (np.abs(points[:, 0] - 4.0) < 3.5), 2] = 0.0
    points[row & (points[:, 0] == 8.0), 2] = 1.0
    (hollow,) = _hollows_of(points, triangles, rim(points), 1e-6).hollows
    assert (hollow.level, hollow.depth) == (1.0, 1.0)
    points[row & (points[:, 0] == 4.0), 2] = 0.5  # a sill below the way out
    assert len(_hollows_of(points, triangles, rim(points), 1e-6).hollows) == 1
    points[row & (points[:, 0] == 4.0), 2] = 2.0  # one above it
    found = _hollows_of(points, triangles, rim(points), 1e-6).hollows
    assert [(one.level, one.at[0] < 4.0) for one in found] == [(2.0, True), (1.0, False)]
    points[row & (points[:, 0] == 4.0), 2] = 0.0
    points[row & (points[:, 0] == 8.0), 2] = 0.0
    assert _hollows_of(points, triangles, rim(points), 1e-6).hollows == ()
    assert len(z) == len(points)


def test_random_surfaces_by_the_slow_twin() -> None:
    random, (points, triangles) = np.random.default_rng(3), grid(12)
    edge = np.flatnonzero(rim(points))
    for _ in range(5):
        points[:, 2] = random.normal(size=len(points))
        found = _hollows_of(points, triangles, rim(points), 1e-9)
        levels = np.array([hollow.level for hollow in found.hollows])
        fill = np.where(found.of_points >= 0, levels[found.of_points], points[:, 2])
        expected = filled_slowly(points[:, 2], triangles, edge.tolist())
        np.testing.assert_array_equal(fill, expected)
        assert [one.depth for one in found.hollows] == sorted(
            (one.depth for one in found.hollows), reverse=True
        )


@pytest.mark.ranks
def test_the_summary_tells_where_water_stands(comm: MPI.Intracomm) -> None:
    """A flat sheet that sags; with a cable pulled down across it, also along that; a dome none."""
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=1.0)
    scene = sheet(comm, 8, material=foil, side=8.0)
    scene.put_load((0.0, 0.0, -0.2), name="weight")
    solver = Solver(scene)
    assert solver.summary().hollows == ()
    solver.advance(load=1.0)
    (hollow,) = solver.summary().hollows
    lowest = float(scene.positions()[:, 2].min(initial=0.0))
    assert hollow.depth == pytest.approx(-comm.allreduce(lowest, op=MPI.MIN), rel=1e-9)
    assert hollow.level == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(hollow.at[:2], 4.0, atol=0.05)
    assert any(
        line.startswith("rain stands") and line.endswith(repr(hollow))
        for line in repr(solver.summary()).splitlines()
    )
    cable = scene.lay_cable(Cable(1e4), [(-4.0, 3.3, 0.0), (12.0, 4.2, 0.0)], name="ridge")
    solver.advance(move={cable: (0.0, 0.0, -1.5)})
    (deeper,) = solver.summary().hollows
    assert deeper.depth > hollow.depth
    cap = clamped(meshes.spherical_cap(comm, radius=5.0, height=1.0, size=1.0), foil)
    domed = Solver(cap)
    domed.advance(pressure=0.5)
    assert domed.summary().hollows == ()
