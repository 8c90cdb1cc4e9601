"""Penalty against kinked sides: a twin by arc cosines, Taylor, stiffness, degenerate places."""

import numpy as np
import pytest
from taylor import TermOnPoints, gradient_order, is_semidefinite, stiffness_error, stiffness_order
from term_scene import cable_square, directions, displaced, moved, on_mesh

from crms_fenicsx.energy.terms.fold_penalty import FoldAngles, FoldPenalty

KINDS = pytest.mark.parametrize("weighted", [True, False], ids=["weighted", "literal"])


def kinks(X, points, weighted, mu=1.0):
    points = np.array(points, dtype=np.int32)
    return TermOnPoints(FoldPenalty(FoldAngles(points, np.full(len(points), mu), weighted)), X)


def random_kinks(weighted):
    """Three kinks that share points."""
    X = np.random.default_rng(0).normal(size=(8, 3)) * 3
    places = [(0, 1, 2, 3), (2, 3, 4, 1), (5, 6, 7, 0)]
    table = FoldAngles(np.array(places, dtype=np.int32), np.array([2.0, 0.5, 1.5]), weighted)
    return TermOnPoints(FoldPenalty(table), X)


def angle(a, b):
    return np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def twin(f, x):
    """(2.5-1), by arc cosines."""
    total, points = 0.0, f.X + x
    for (i, p, j, q), mu in zip(f.term.table.points, f.term.table.coefficients, strict=True):
        ip, jp, qp = points[i] - points[p], points[j] - points[p], points[q] - points[p]
        residual = angle(ip, qp) + angle(jp, qp) - np.pi
        if f.term.table.weighted:
            a, b = np.linalg.norm(ip), np.linalg.norm(jp)
            residual *= 4 * a * b / (a + b) ** 2
        total += mu * residual**2
    return total


@KINDS
def test_energy(weighted):
    f = random_kinks(weighted)
    for seed in range(50):
        x = 2 * np.random.default_rng(seed).normal(size=f.X.shape)
        assert f.value(x)[0] == pytest.approx(twin(f, x), rel=1e-11)


@KINDS
def test_gradient(weighted):
    f = random_kinks(weighted)
    for seed in range(5):
        x, d = np.random.default_rng(seed).normal(size=(2, *f.X.shape))
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03)


@pytest.mark.ranks
@KINDS
def test_gradient_on_the_membrane(comm, weighted):
    choices = {} if weighted else {"literal_penalty": 30.0}
    system = cable_square(comm, **choices)
    f = on_mesh(system, "FoldPenalty")
    assert f.potential.terms[0].table.weighted == weighted
    x = displaced(f.unknowns, 0.3)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


def straight_side(turn):
    """A side i-p-j, and a chord whose halves lie in two planes that meet in the side: no kink."""
    return np.array(
        [(-2.0, 0, 0), (0, 0, 0), (3.0, 0, 0), (0.7, 2 * np.cos(turn), 2 * np.sin(turn))]
    )


@KINDS
@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_no_penalty_on_a_straight_side(weighted, turn):
    X = straight_side(turn)
    f = kinks(X, [(0, 1, 2, 3)], weighted)
    energy, g = f.value(np.zeros_like(X))
    assert energy == pytest.approx(0.0, abs=1e-28)
    np.testing.assert_allclose(g, 0, atol=1e-14)


@KINDS
def test_a_fold_along_the_chord_is_free(weighted):
    """Halves of the side turned about the chord: unfolded about it, the side is straight."""
    X = straight_side(0.0)
    axis = X[3] / np.linalg.norm(X[3])
    K = np.cross(np.eye(3), -axis)
    turn = np.eye(3) + np.sin(0.8) * K + (1 - np.cos(0.8)) * K @ K
    assert np.allclose(turn @ axis, axis)
    bent = X.copy()
    bent[2] = turn @ X[2]
    assert np.linalg.norm(bent[2] - X[2]) > 1
    f = kinks(bent, [(0, 1, 2, 3)], weighted)
    assert f.value(np.zeros_like(X))[0] == pytest.approx(0.0, abs=1e-28)


@KINDS
def test_stiffness_is_exact_at_no_kink(weighted):
    X = straight_side(0.6)
    f = kinks(X, [(0, 1, 2, 3)], weighted, mu=3.0)
    x, d = np.zeros_like(X), np.random.default_rng(1).normal(size=X.shape)
    assert stiffness_error(f, x, d, h=1e-5) < 1e-6
    assert stiffness_order(f, x, d, 0.01 * 0.5 ** np.arange(5)) == pytest.approx(3, abs=0.1)


@KINDS
def test_stiffness_is_the_square_of_the_residuals_slope(weighted):
    """Gauss-Newton, ``2 mu grad(w r) grad(w r)^T``, with the slope by differences."""
    X = np.random.default_rng(3).normal(size=(4, 3))
    f, h = kinks(X, [(0, 1, 2, 3)], weighted, mu=3.0), 1e-6
    units = h * np.eye(12).reshape(12, 4, 3)
    up, down = (np.sqrt([twin(f, sign * e) / 3.0 for e in units]) for sign in (1, -1))
    slope = (up - down) / (2 * h)  # of |w r|, whose sign does not matter
    np.testing.assert_allclose(f.matrix(0 * X), 6.0 * np.outer(slope, slope), atol=1e-6)


@KINDS
def test_stiffness_is_semidefinite(weighted):
    f = random_kinks(weighted)
    assert is_semidefinite(f.matrix(np.zeros_like(f.X)))


@KINDS
def test_rigid_motion_and_size_change_nothing(comm, weighted):
    choices = {} if weighted else {"literal_penalty": 30.0}
    f = on_mesh(cable_square(comm, **choices), "FoldPenalty")
    X = f.unknowns.X[: f.unknowns.n_owned]
    x = displaced(f.unknowns, 0.3)
    energy, _ = f.value(x)
    again, g = f.value(moved(f.unknowns, x))
    assert again == pytest.approx(energy, rel=1e-10)
    places = X + f.potential.x[: f.unknowns.n_owned]
    size = np.sqrt(f.dot(g, g))
    np.testing.assert_allclose(comm.allreduce(g.sum(axis=0)), 0, atol=1e-11 * size)
    moment = comm.allreduce(np.cross(places, g).sum(axis=0))
    np.testing.assert_allclose(moment, 0, atol=1e-9 * size)
    # angles and ratios of lengths only
    assert f.value(3 * places - X)[0] == pytest.approx(energy, rel=1e-10)


def test_weight_takes_the_penalty_off_near_a_vertex():
    """At the vertex the angle is undefined, and the energy goes to zero with the weight."""
    X = straight_side(0.0)
    energies = []
    for a in (1e-2, 1e-4, 1e-6):
        X[0] = a * np.array([-0.6, 0.8, 0.0])
        energies.append(kinks(X, [(0, 1, 2, 3)], True).value(0 * X)[0])
    np.testing.assert_allclose(np.diff(np.log10(energies)), -4, atol=0.05)


@KINDS
@pytest.mark.parametrize("together", [(0, 1), (2, 1), (3, 1)])
def test_points_that_coincide_give_finite_forces(weighted, together):
    X = straight_side(0.4)
    X[together[0]] = X[together[1]]
    f = kinks(X, [(0, 1, 2, 3)], weighted)
    energy, g = f.value(np.zeros_like(X))
    assert np.isfinite(energy)
    assert np.all(np.isfinite(g))
    assert np.all(np.isfinite(f.matrix(np.zeros_like(X))))


def test_coefficients_follow_the_cells_stiffness(comm):
    """mu = c E t A: proportional to the factor and to each folded cell's modulus and area."""
    system = cable_square(comm, penalty=0.2)
    tables = system.cables.tables
    table = tables.penalty(0.2, np.full(len(tables.folded.cells), 24.0))
    rows = tables.kink_cells
    np.testing.assert_allclose(table.coefficients, 0.2 * 24.0 * tables.folded.areas[rows])
    (used,) = (t for t in system.potential.terms if isinstance(t, FoldPenalty))
    np.testing.assert_allclose(used.table.coefficients, table.coefficients, rtol=1e-14)
    assert comm.allreduce(len(rows)) > 40


@pytest.mark.ranks
def test_kinks_are_measured_between_neighbours_on_the_side(comm):
    """Next to a fold point on its side may be another cable's, not the side's end."""
    system = cable_square(comm)
    tables, X = system.cables.tables, system.unknowns.X
    segments = {frozenset(pair) for pair in tables.folded.segments.tolist()}
    chords = {frozenset(pair) for pair in tables.segments.tolist()}
    fold_points, next_to_another = set(system.unknowns.owned_point_blocks().tolist()), 0
    fold_points |= set(system.unknowns.ghost_point_blocks().tolist())
    for i, p, j, q in tables.kinks.tolist():
        assert {i, p} in segments
        assert {p, j} in segments
        assert {p, q} in chords
        assert np.linalg.norm(np.cross(X[i] - X[p], X[j] - X[p])) < 1e-10, "they are on a line"
        next_to_another += bool({i, j} & fold_points)
    assert comm.allreduce(next_to_another) > 4
