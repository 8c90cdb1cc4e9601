"""Strain energy of bars: a slow twin, Taylor tests on points and on ranks, a part of the bars."""

import numpy as np
import pytest
from cabled_square import clamped
from taylor import Points, TermOnPoints, gradient_order, is_semidefinite, noise, stiffness_error

from crms_fenicsx import Bar, IsotropicMembrane, meshes
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads, stiffness_order
from crms_fenicsx.energy.terms.bar_energy import SLACK, BarEnergy, BarTable
from crms_fenicsx.energy.terms.nodal_forces import JointForces

RNG = np.random.default_rng(3)
X = RNG.normal(size=(5, 3))
ENDS = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (3, 1)], dtype=np.int32)
LENGTHS = np.linalg.norm(X[ENDS[:, 1]] - X[ENDS[:, 0]], axis=1)
EA = np.array([3.0, 40.0, 7.0, 11.0, 2.0, 5.0, 9.0])
L0 = LENGTHS * np.array([0.9, 1.1, 0.95, 1.2, 1.3, 0.8, 1.07])
GUYS = np.array([False, False, True, True, False, False, True])


def term():
    """Bars and guys in tension and in compression."""
    return BarEnergy(BarTable(ENDS, EA, L0, GUYS))


class Exact(BarEnergy):
    """With its second derivatives as its stiffness."""

    add_stiffness = BarEnergy.add_hessian


def one_by_one(x):
    """The slow twin."""
    total, forces = 0.0, np.zeros((len(X), 3))
    for (a, b), stiffness, length, guy in zip(ENDS, EA, L0, GUYS, strict=True):
        way = X[b] + x[b] - X[a] - x[a]
        longer = np.sqrt(way @ way) - length
        if guy and longer < 0:
            continue
        total += stiffness / 2 * longer**2 / length
        pull = stiffness * longer / length * way / np.sqrt(way @ way)
        forces[a] -= pull
        forces[b] += pull
    return total, forces


def test_energy_and_forces_one_by_one():
    f, x = TermOnPoints(term(), X), 0.02 * noise(X, 1)
    energy, g = f.value(x)
    expected, forces = one_by_one(x)
    assert energy == pytest.approx(expected, rel=1e-14)
    np.testing.assert_allclose(g, forces, atol=1e-13)
    np.testing.assert_array_equal(f.term.forces[GUYS] > 0, [True, False, False])


def test_second_derivatives_and_what_h0_has_of_them():
    x, d = 0.02 * noise(X, 1), noise(X, 2)
    exact = TermOnPoints(Exact(BarTable(ENDS, EA, L0, GUYS)), X)
    assert gradient_order(exact, x, d) > 1.9
    assert stiffness_error(exact, x, d) < 1e-7
    assert not is_semidefinite(exact.matrix(x)), "in compression it is not"
    h0 = TermOnPoints(term(), X).matrix(x)
    assert is_semidefinite(h0)
    assert is_semidefinite(h0 - exact.matrix(x))


def test_h0_keeps_a_little_of_a_slack_guy():
    table = BarTable(ENDS[:1], np.array([3.0]), 1.1 * LENGTHS[:1], np.array([True]))
    f = TermOnPoints(BarEnergy(table), X)
    energy, g = f.value(0 * X)
    assert energy == 0.0 and not g.any()
    assert np.linalg.norm(f.matrix(0 * X), 2) == pytest.approx(2 * SLACK * 3.0 / table.L0[0])


def test_a_bar_whose_ends_meet_has_no_direction():
    meet = np.array([X[0], X[0]])
    table = BarTable(ENDS[:1], np.array([3.0]), np.array([2.0]), np.array([False]))
    f = TermOnPoints(BarEnergy(table), meet)
    energy, g = f.value(0 * meet)
    assert energy == pytest.approx(3.0) and not g.any()
    assert np.isfinite(f.matrix(0 * meet)).all()


def test_some_of_the_bars_make_a_term_of_their_own():
    f, x = TermOnPoints(term(), X), 0.02 * noise(X, 1)
    f.value(x)
    assert f.term.elements_on(np.zeros(5, dtype=bool)) is None
    table = f.term.elements_on(np.arange(5) == 2)
    np.testing.assert_array_equal(table.ends, ENDS[[1, 2, 5]])
    (twice,) = BarTable.joined([table, table])
    part, sums = f.term.of_elements(twice, f.sums), np.zeros(1)
    part.attach(Points(X))
    part.sums(x, sums)
    alone = 0.5 * f.term.forces**2 * f.term.table.L0 / f.term.table.EA
    assert sums[0] == pytest.approx(2 * alone[[1, 2, 5]].sum())


def test_loads_on_joints_are_linear():
    load = JointForces(np.array([1, 3], dtype=np.int32))
    load.forces[:] = RNG.normal(size=(2, 3))
    f, x = TermOnPoints(load, X), noise(X, 4)
    energy, g = f.value(x)
    assert energy == pytest.approx(-np.vdot(load.forces, x[[1, 3]]))
    np.testing.assert_allclose(g[[1, 3]], -load.forces)
    assert not g[[0, 2, 4]].any()


@pytest.mark.ranks
def test_bars_between_joints_and_vertices_of_any_rank(comm):
    """The first rank computes bars to vertices that it has not."""
    mesh = meshes.rectangle(comm, 8.0, 6.0, 2.0, structured=True)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    top = scene.add_joint((4.0, 3.0, -2.0))
    for x in (0.0, 2.0, 8.0):
        for y in (0.0, 4.0, 6.0):
            scene.add_bar(Bar(30.0 + x), top, scene.vertex_at((x, y, 0.0)), L0=4.0)
    scene.add_bar(Bar(20.0), scene.vertex_at((0, 0, 0)), scene.vertex_at((8, 6, 0)), L0=9.0)
    scene.add_bar(Bar(10.0), top, (0.0, 0.0, -5.0), L0=5.0)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    (bars,) = (t for t in system.potential.terms if t.name == "bars")
    f = TermsWithDyads(system.unknowns, scene.u, [bars], exact=True)
    own = system.unknowns.X[: system.unknowns.n_owned]
    x, d = 0.1 * noise(own, 1), noise(own, 2)
    energy, g = f.value(x)
    assert comm.allreduce(g.sum(axis=0)) == pytest.approx(np.zeros(3), abs=1e-12)
    expected = 0.0
    for bar in scene.bars:  # by places alone
        ends = np.array([getattr(end, "place", getattr(end, "first", None)) for end in
                         (bar.start, bar.end)])  # fmt: skip
        ends += 0.1 * noise(ends, 1)
        expected += bar.bar.EA / 2 * (np.linalg.norm(ends[1] - ends[0]) - bar.L0) ** 2 / bar.L0
    assert energy == pytest.approx(expected, rel=1e-12)
    assert gradient_order(f, x, d) > 1.9
    assert stiffness_order(f, x, d) > 2.9
    f.potential.destroy()
    system.destroy()
