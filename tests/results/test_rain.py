"""Hollows of surfaces, by hand, by a slow twin and on any number of processes; and rain that fills
them: closed forms, limits, and what stays as it was."""

from __future__ import annotations

import heapq

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from grids import grid
from mpi4py import MPI
from scipy.special import j0

from crms_fenicsx import Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.results.hollows import _hollows_of
from crms_fenicsx.results.rain import NAME

RADIUS, WEIGHT = 3.0, 10.0


def drum(comm: MPI.Intracomm, k: float, size: float, load: float) -> Solver:
    """A membrane whose tension stays as it is, with k R as given, under a small load."""
    tension = WEIGHT * (RADIUS / k) ** 2
    soft = IsotropicMembrane(E=1e-6, nu=0.3, thickness=1.0, prestress=tension, wrinkling=False)
    scene = clamped(meshes.ellipse(comm, RADIUS, RADIUS, size), soft)
    scene.put_load((0.0, 0.0, -load), name="weight", per="plan")
    return advanced(Solver(scene), load=1.0)


@pytest.mark.ranks
@pytest.mark.parametrize("k", [1.0, 1.5], ids=str)
def test_water_up_to_the_rim_of_a_drum(comm: MPI.Intracomm, k: float) -> None:
    """It sinks by g/w (1/J0(kR) - 1) under a load g and the water up to its rim."""
    load, errors = 0.01, []
    for size in (0.6, 0.3):
        solver = drum(comm, k, size, load)
        scene, u = solver.scene, solver.scene.u.x.array.copy()
        check = solver.check_ponding(rain=1.0)
        assert check.settled and not check.dry, check
        errors.append(check.depth / (load / WEIGHT * (1 / j0(k) - 1)) - 1)
        assert np.array_equal(scene.u.x.array, u)  # and all is as before
        assert scene.factors == {"weight": 1.0}
        assert solver.case == ""
    assert abs(errors[1]) < 0.01
    assert abs(errors[1]) < abs(errors[0])
    lift = solver.reactions("boundary").total[2]
    solver.restore(check.snapshot)
    water = solver.reactions("boundary").total[2] - lift
    assert water == pytest.approx(WEIGHT * check.volumes[-1], rel=1e-3)
    assert scene.factors[NAME] == 1.0
    assert check.hollows[0].volume == pytest.approx(check.volumes[-1], rel=1e-3)


@pytest.mark.ranks
def test_water_that_gathers(comm: MPI.Intracomm) -> None:
    """Beyond k R = 2.4048 the rain alone is the limit: what does not settle is told soon."""
    solver = drum(comm, 2.6, 0.6, 0.01)
    check = solver.check_ponding(rain=10.0)
    assert not check.settled and not check.dry
    assert check.verdict.startswith("under weight 1: water of the volume ")
    assert "gathers in 1 hollow, up to" in check.verdict
    assert len(check.volumes) < 60
    little = solver.check_ponding(rain=1e-5)
    assert little.settled and not little.dry
    assert "takes all the rain" in little.verdict and "design it for this load" in little.verdict
    volume = little.volumes[-1]
    for words in (
        f"volume {volume:.4g}, weight {WEIGHT * volume:.4g},",
        f"up to {little.depth:.3g} deep at {as_text(little.hollows[0].at)},",
    ):
        assert words in little.verdict
    plan = np.pi * RADIUS**2
    assert little.volumes[-1] == pytest.approx(1e-5 * plan, rel=0.02)


@pytest.mark.ranks
def test_a_roof_that_sheds_water(comm: MPI.Intracomm) -> None:
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
    scene = clamped(meshes.spherical_cap(comm, radius=5.0, height=1.0, size=1.0), foil)
    solver = advanced(Solver(scene), pressure=0.5)
    with solver.branch("storm"):
        check = solver.check_ponding(rain=0.1)
    assert (check.dry, check.settled, check.depth) == (True, True, 0.0)
    assert check.verdict == "storm, under pressure 0.5: no water stands on the roof"
    assert len(solver.steps) == 1


def squares(n: int) -> tuple[Array, Integers]:
    """n x n squares of the size 1, each in two triangles that face up."""
    return grid(np.arange(n + 1.0), np.arange(n + 1.0), by_rows=True)


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
    points, triangles = squares(2)
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
    points, triangles = squares(8)
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
    random, (points, triangles) = np.random.default_rng(3), squares(12)
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
    domed = advanced(Solver(cap), pressure=0.5)
    assert domed.summary().hollows == ()
