"""Derivatives of cables with parts that are slack, or about to become taut or slack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Joint, PlacedBar, Scene, Solver, meshes
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.cable import Hold
from crms_fenicsx.results.taut_parts import _strains_of

UNITS = [(1.0, 1.0), (1e3, 1e3)]  # of m and kN
IDS = ["kN, m", "N, mm"]


def sheet(
    comm: MPI.Intracomm,
    size: float,
    unit: float = 1.0,
    force: float = 1.0,
    pressure: float = 0.0,
    structured: bool = False,
) -> tuple[Scene, Solver]:
    """A square of 6 m held all around, under a pressure in kN/m2."""
    stress = force / unit
    side = 6.0 * unit
    mesh = meshes.rectangle(comm, side, side, size * unit, structured=structured)
    scene = clamped(mesh, IsotropicMembrane(200.0 * stress, 0.3, 1.0, prestress=2.0 * stress))
    solver = advanced(Solver(scene, rtol=1e-12), pressure=pressure * stress / unit)
    return scene, solver


def mesh_line(scene: Scene, at: float, axis: int) -> Array:
    """Places of the vertices on a line of a structured mesh, in order."""
    owned = scene.V.dofmap.index_map.size_local
    rows = np.hstack([scene.membrane.stress_free[:owned], scene.positions()[:owned]])
    every = np.concatenate(scene.comm.allgather(rows))
    line = every[np.abs(every[:, 1 - axis] - at) < 1e-6 * at]
    return np.asarray(line[np.argsort(line[:, axis]), 3:])


def sides(
    solver: Solver, read: Callable[[], Sequence[float]], change: Callable[[float], object], h: float
) -> Array:
    """Derivatives of results for a growing and a falling parameter by load steps, (2, n), without
    the term of second order."""
    base, start = solver.snapshot(), np.array(read())
    found = []
    for sign in (1.0, -1.0):
        slopes = []
        for step in (sign * h, sign * h / 2):
            solver.restore(base)
            change(step)
            slopes.append((np.array(read()) - start) / step)
        found.append(2 * slopes[1] - slopes[0])
    solver.restore(base)
    return np.array(found)


@pytest.mark.ranks
@pytest.mark.parametrize(("unit", "force"), UNITS, ids=IDS)
@pytest.mark.parametrize(("hold", "size"), [*product(("bonded", "pocket"), (2.0, 1.4, 1.0))])
def test_a_straight_belt_without_force(
    comm: MPI.Intracomm, hold: Hold, size: float, unit: float, force: float
) -> None:
    """Shortened, its parts become taut alike and nothing moves: dT/dL0 = -EA/L0; lengthened, it is
    slack. The work of its tension is of second order."""
    scene, solver = sheet(comm, size, unit, force)
    ends = [(0.0, 1.3 * unit), (6.0 * unit, 4.1 * unit)]
    belt = scene.lay_cable(Cable(500.0 * force), ends, hold=hold)
    solver.advance()
    assert not belt.taut
    found = solver.sensitivities([belt, belt.end, "energy"], [belt])
    exact = -500.0 * force / belt.L0
    np.testing.assert_allclose(found.decreasing[:2, 0], exact, rtol=1e-6)
    np.testing.assert_allclose(found.increasing[:2, 0], 0.0, atol=1e-9 * abs(exact))
    assert found[belt, belt] == pytest.approx(exact / 2, rel=1e-6)
    assert abs(found.values[2, 0]) < 1e-3 * force and found.one_sided == ("cable 1",)
    assert solver.sensitivities(["energy"], [belt]).one_sided == (), "both are zero"
    assert not belt.taut and belt.tension == 0.0


@pytest.mark.ranks
@pytest.mark.parametrize(("unit", "force"), UNITS, ids=IDS)
@pytest.mark.parametrize(("size", "flat"), [(2.0, False), (1.5, True), (1.2, False), (1.1, True)])
def test_fresh_belts(
    comm: MPI.Intracomm, size: float, flat: bool, unit: float, force: float
) -> None:
    """Without force, crossing each other: load steps in both directions. Inflated, along lines of
    the mesh; flat, across its cells: there, on some versions of gmsh's meshes, 2e-4 of the largest
    derivative where the load step has none."""
    scene, solver = sheet(comm, size, unit, force, pressure=0.4 * (not flat), structured=not flat)
    places = np.array([[0.0, 2.3], [6.0, 3.4]]) * unit
    paths = (
        [places, places[:, ::-1]] if flat else [mesh_line(scene, size * unit, k) for k in (0, 1)]
    )
    scene.put_load((0.1 * force / unit**2, 0.0, -0.2 * force / unit**2), name="storm")
    a, b = (
        scene.lay_cable(Cable(700.0 * force), path, hold="bonded", measured_on="facets", name=name)
        for name, path in zip("ab", paths, strict=True)
    )
    solver.advance()
    assert max(np.abs(_strains_of(cable)).max() for cable in (a, b)) < 1e-10
    found = solver.sensitivities([a, b, a.start], [a, "storm"])
    assert found.one_sided == ("a", "b")

    def read() -> list[float]:
        return [a.tension, b.tension, float(np.linalg.norm(a.start.reaction))]

    L0 = a.L0
    shorter = sides(solver, read, lambda h: solver.advance(L0={a: L0 + h}), 1e-5 * unit)
    loaded = sides(solver, read, lambda h: solver.advance(load=h), 1e-3)
    for j, exact in enumerate((shorter, loaded)):
        both = np.array([found.increasing[:, j], found.decreasing[:, j]])
        np.testing.assert_allclose(both, exact, rtol=1e-3, atol=4e-4 * np.abs(exact).max())


@pytest.mark.ranks
@pytest.mark.parametrize(("unit", "force"), UNITS, ids=IDS)
@pytest.mark.parametrize("size", [1.5, 1.1, 0.8])
def test_a_belt_with_slack_parts(
    comm: MPI.Intracomm, size: float, unit: float, force: float
) -> None:
    """Slack parts have no stiffness, however little they are slack; both sides are equal."""
    scene, solver = sheet(comm, size, unit, force, pressure=0.4)
    ends = [(0.0, 2.3 * unit), (6.0 * unit, 3.4 * unit)]
    belt = scene.lay_cable(Cable(700.0 * force), ends, hold="bonded", tension=3.0 * force)
    scene.put_load((0.5 * force / unit**2, 0.0, -0.1 * force / unit**2), name="storm")
    solver.advance(load=1.0)
    middle = len(belt.part_lengths) // 2

    def slack(L0: float) -> float:
        solver.advance(L0={belt: L0})
        return float(_strains_of(belt)[middle]) + 4e-6

    L0 = brentq(slack, 0.99 * belt.L0, 1.01 * belt.L0, xtol=1e-6 * belt.L0)
    slack(L0)
    now = _strains_of(belt)
    assert 1e-6 < np.abs(now).min() < 8e-6, "hardly slack, or taut"
    assert np.count_nonzero(now < 0) > 1 and np.count_nonzero(now > 0) > 1
    of, by = [belt, belt.start, belt.end, "energy"], [belt, "storm", ("EA", belt)]
    found = solver.sensitivities(of, by)
    assert found.one_sided == () and np.array_equal(found.increasing, found.decreasing)

    def read() -> list[float]:
        return [belt.tension, belt.part_tensions[0], belt.part_tensions[-1], scene.energy]

    h = 0.1 * float(np.abs(now).min())
    for j, change in enumerate((
        lambda h: solver.advance(L0={belt: L0 * (1 + h)}), lambda h: solver.advance(load=1.0 + h)
    )):  # fmt: skip
        step = h * (L0 if j == 0 else 1.0)
        exact = sides(solver, read, change, h).mean(axis=0) * h / step
        of_tensions, of_energy = np.abs(found.values[:, j] - exact)[:3], found.values[3, j]
        assert of_tensions.max() < 1e-3 * np.abs(exact[:3]).max()
        assert of_energy == pytest.approx(exact[3], rel=1e-3)


@pytest.mark.ranks
def test_a_free_cable_without_force_is_named(comm: MPI.Intracomm) -> None:
    """Where a change would tighten it; its derivatives are those of the slack one."""
    scene, solver = sheet(comm, 1.4)
    cable = scene.lay_cable(Cable(500.0), [(0.0, 1.3), (6.0, 4.1)])
    scene.put_load((0.0, 0.0, -0.1), name="snow")
    solver.advance()
    assert not cable.taut
    for one, names in ((cable, ("cable 1",)), ("snow", ()), (("EA", cable), ())):
        found = solver.sensitivities([cable], [one])
        assert found.one_sided == names and found.values[0, 0] == 0.0


@pytest.mark.ranks
def test_a_tight_belt_and_a_cable_near_a_vertex_have_equal_sides(comm: MPI.Intracomm) -> None:
    """And are not named, as a small change does not take a cable past it."""
    scene, solver = sheet(comm, 1.2, pressure=0.4)
    vertices = scene.membrane.stress_free
    inner = [x for x in comm.allgather(vertices.tolist())[0] if 2 < x[0] < 4 and 2 < x[1] < 4]
    y = float(inner[0][1]) + 0.003
    belt = scene.lay_cable(Cable(700.0), [(0.0, y), (6.0, y)], hold="bonded", tension=9.0)
    cable = scene.lay_cable(Cable(900.0), [(y, 0.0), (y, 6.0)], tension=4.0)
    solver.advance()
    s = np.concatenate([c.state.fractions[~np.isnan(c.state.fractions)] for c in (belt, cable)])
    assert np.minimum(s, 1 - s).min() < 0.02
    found = solver.sensitivities([belt, cable], [belt, cable])
    assert found.one_sided == () and np.array_equal(found.increasing, found.decreasing)


def guyed(
    comm: MPI.Intracomm, unit: float, force: float, held: str, spring: float = 0.0
) -> tuple[Scene, Joint, PlacedBar, PlacedBar]:
    """A joint between two guys in line, of the stiffnesses 100 and 50 kN/m."""
    scene = clamped(
        meshes.rectangle(comm, unit, unit, unit),
        IsotropicMembrane(200.0 * force / unit, 0.3, 1.0, prestress=force / unit),
    )
    top = scene.add_joint((5.0 * unit, 0.0, 2.0 * unit), held=held)
    a = scene.add_bar(Bar(200.0 * force, tension_only=True), (3.0 * unit, 0.0, 2.0 * unit), top)
    b = scene.add_bar(Bar(150.0 * force, tension_only=True), (8.0 * unit, 0.0, 2.0 * unit), top)
    if spring:
        scene.add_bar(Bar(spring * force), (6.0 * unit, 0.0, 2.0 * unit), top)
    scene.put_joint_load({top: (force, 0.0, 0.0)}, name="pull")
    return scene, top, a, b


@pytest.mark.ranks
@pytest.mark.parametrize("spring", [3.0, 0.0])
@pytest.mark.parametrize(("unit", "force"), UNITS, ids=IDS)
def test_guys_without_force(comm: MPI.Intracomm, unit: float, force: float, spring: float) -> None:
    """One of them carries a pull, with a spring or alone; shortened, it pulls at the other."""
    scene, _, a, b = guyed(comm, unit, force, "yz", spring)
    solver = advanced(Solver(scene, stability="ignore"))
    found = solver.sensitivities([a, b], ["pull", a])
    k, c, s = 100.0, 50.0, spring
    shorter = np.array([-k * (c + s), -k * c]) / (k + c + s) * force / unit
    pulls = np.array([[k / (k + s), 0.0], [0.0, -c / (c + s)]]) * force
    exact = np.array([pulls, [[0.0, 0.0], shorter]])
    for j, both in enumerate(exact):
        own = np.array([found.increasing[:, j], found.decreasing[:, j]])
        np.testing.assert_allclose(own, both, atol=1e-6 * np.abs(both).max())
    assert found.one_sided == (a.name, b.name)
    solver.advance(load={"pull": 0.5})
    found = solver.sensitivities([a, b], ["pull"])
    assert found.values[:, 0] == pytest.approx(pulls[0], abs=1e-6 * force)
    assert found.one_sided == () and np.array_equal(found.increasing, found.decreasing)


@pytest.mark.ranks
def test_a_mast_that_guys_without_force_keep_upright(comm: MPI.Intracomm) -> None:
    """Without them it would fall, so that they count as taut, and are named."""
    scene, top, a, b = guyed(comm, 1.0, 1.0, "y")
    scene.add_bar(Bar(1e9), (5.0, 0.0, 0.0), top)
    scene.put_joint_load({top: (0.0, 0.0, -6.0)}, name="weight")
    solver = advanced(Solver(scene, stability="ignore"), load={"weight": 1.0})
    found = solver.sensitivities([a, b], ["pull"])
    exact = np.array([100.0, -50.0]) / (100.0 + 50.0 - 6.0 / 2.0)
    np.testing.assert_allclose(found.increasing[:, 0], exact, rtol=1e-6)
    assert found.one_sided == (a.name, b.name) and np.array_equal(found.values, found.decreasing)
