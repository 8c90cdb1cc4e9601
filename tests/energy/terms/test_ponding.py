"""The energy of water on facets: a readable twin, Taylor tests, its level and its forces."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from mpi4py import MPI
from taylor import gradient_order, stiffness_error, stiffness_order
from term_scene import cable_square, directions, displaced

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads
from crms_fenicsx.energy.terms.ponding import Ponding, water_sums

Array = npt.NDArray[np.float64]


def wet_polygon(triangle: Array, level: float) -> Array:
    """The part of a triangle below a level, cut side by side, (n, 3)."""
    found = []
    for a, b in pairwise([*triangle, triangle[0]]):
        if a[2] < level:
            found.append(a)
        if (a[2] < level) != (b[2] < level):
            found.append(a + (level - a[2]) / (b[2] - a[2]) * (b - a))
    return np.array(found).reshape(-1, 3)


def twin_sums(triangle: Array, level: float) -> Array:
    """Integrals of depth squared, depth and 1 over the plan, by the midpoints of sides: exact."""
    sums, corners = np.zeros(3), wet_polygon(triangle, level)
    for k in range(1, len(corners) - 1):
        fan = corners[[0, k, k + 1]]
        area = np.cross(fan[1] - fan[0], fan[2] - fan[0])[2] / 2
        depths = level - (fan + np.roll(fan, 1, axis=0))[:, 2] / 2
        sums += area * np.array([(depths**2).mean(), depths.mean(), 1.0])
    return sums


def test_the_wet_part_of_triangles() -> None:
    """Of any number of wet corners, of those at the level, and seen from below."""
    rng, none, seen = np.random.default_rng(3), np.zeros((3, 3)), set()
    corners, out = np.arange(3, dtype=np.int32)[None], np.zeros(3)
    for turn in range(200):
        triangle = rng.normal(size=(3, 3))
        level = triangle[turn % 3, 2] if turn < 20 else rng.normal()
        water_sums(triangle, none, corners, np.array([0.7]), level, out)
        expected = 0.7 * twin_sums(triangle, level)
        np.testing.assert_allclose(out, expected, rtol=1e-10, atol=1e-14)
        seen.add(int(np.sum(triangle[:, 2] < level)))
    assert seen == {0, 1, 2, 3}


def ponds(comm: MPI.Intracomm, **given: float) -> tuple[Scene, System, Ponding]:
    """A pond on the square with folded cells."""
    scene = cable_square(comm).scene
    scene.put_pond(0.3, **given)
    scene.loads.replace_each(lambda pond: replace(pond, factor=1.3))
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    assert system.ponds is not None
    return scene, system, system.ponds.ponds[0]


@pytest.mark.ranks
@pytest.mark.parametrize("given", [{"level": 0.4}, {"volume": 4000.0}], ids=["level", "volume"])
def test_taylor_with_folded_cells(comm: MPI.Intracomm, given: dict[str, float]) -> None:
    """On both sides of the water's line; a given volume has its dyad beside the same Hessian."""
    scene, system, term = ponds(comm, **given)
    f = TermsWithDyads(system.unknowns, scene.u, [term], exact=True)
    x = displaced(f.unknowns, 1.5, stretch=1.02)
    f.value(x)
    wet = f.potential.sums_of(term).copy()
    assert 0.2 * 100.0**2 < wet[2] < 0.95 * 102.0**2
    if "volume" in given:
        assert wet[1] == pytest.approx(given["volume"], rel=1e-12)
    for d in directions(f.unknowns).values():
        steps = 1e-3 * 0.5 ** np.arange(6)
        assert gradient_order(f, x, d, steps) == pytest.approx(2, abs=0.1)
        assert stiffness_error(f, x, d, h=1e-5) < 2e-5
    assert stiffness_order(f, x, d, 0.1 * 0.5 ** np.arange(6)) > 2.8


def test_its_forces_are_normal(comm: MPI.Intracomm) -> None:
    """At free points the gradient's, from other formulas; all under water, of Archimedes' size."""
    scene, system, term = ponds(comm, level=30.0)
    f = TermsWithDyads(system.unknowns, scene.u, [term], exact=True)
    x = displaced(f.unknowns, 1.5, stretch=1.02)
    _, g = f.value(x)
    n, forces = f.unknowns.n_owned, np.zeros_like(f.potential.g)
    term.add_pressure(f.potential.x, forces, 1.0)
    vector, local = f.unknowns.vector()
    local[:] = forces
    f.unknowns.gather_forces(vector, local)
    total = comm.allreduce(local[:n].sum(axis=0))
    inside = ~f.unknowns.held[:n].any(axis=1)
    np.testing.assert_allclose(local[:n][inside], -g[inside], atol=1e-9 * abs(total[2]))
    assert total[2] == pytest.approx(-1.3 * 0.3 * f.potential.sums_of(term)[1], rel=1e-12)
    vector.destroy()


@pytest.mark.ranks
@pytest.mark.parametrize("volume", [1e-3, 40.0, 4e3, 1e7])
def test_any_volume_finds_its_level(comm: MPI.Intracomm, volume: float) -> None:
    """From far below or above, in few drops as in a flood."""
    scene, system, term = ponds(comm, volume=volume)
    f = TermsWithDyads(system.unknowns, scene.u, [term])
    x = displaced(f.unknowns, 1.5)
    for start in (-1e4, 0.0, 1e4):
        term.level = start
        f.value(x)
        assert f.potential.sums_of(term)[1] == pytest.approx(volume, rel=1e-12)
