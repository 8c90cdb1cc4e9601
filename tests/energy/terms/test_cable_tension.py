"""Cables: smoothed lengths, uniform tension, the paper's step-wise law."""

import numpy as np
import pytest
from taylor import TermOnPoints, gradient_order, is_semidefinite, stiffness_error, stiffness_order
from term_scene import cable_square, directions, displaced, moved, on_mesh

from crms_fenicsx.energy.terms.cable_tension import CableTension
from crms_fenicsx.energy.terms.paper.cable_elements import StepCableTension
from crms_fenicsx.energy.terms.segments import (
    add_segment_forces,
    segment_lengths,
    segment_stiffness,
    slope_over_distance,
    smoothed_length,
    turn_coefficient,
)
from crms_fenicsx.model.cable_state import StepStart

EPS = 0.3


def test_length_is_exact_from_eps_on():
    for d in (EPS, 1.0001 * EPS, 5.0, 1e3):
        assert smoothed_length(d, EPS) == d
        assert slope_over_distance(d, EPS) * d == pytest.approx(1, rel=1e-15)
    assert smoothed_length(0.0, 0.0) == 0.0
    assert slope_over_distance(0.0, 0.0) == turn_coefficient(0.0, 0.0) == 0.0


def test_given_points_that_coincide_have_a_distance_and_no_direction():
    for d in (0.0, 1e-17, 0.2 * EPS):
        assert smoothed_length(d, -EPS) == d
        assert slope_over_distance(d, -EPS) == turn_coefficient(d, -EPS) == 0.0
    assert slope_over_distance(2.0, -EPS) == 0.5
    assert turn_coefficient(2.0, -EPS) == 0.125


def test_length_below_eps_is_the_polynomial():
    for u in (0.0, 0.1, 0.5, 0.99):
        twin = EPS * (-(u**4) / 8 + 3 * u**2 / 4 + 3 / 8)
        assert smoothed_length(u * EPS, EPS) == pytest.approx(twin, rel=1e-14)


def derivatives(d):
    """l, l' and l'' by the coefficients of gradient and Hessian."""
    slope = slope_over_distance(d, EPS) * d
    # along r the Hessian l'/d I - k r r^T has the eigenvalue l''
    return np.array(
        [
            smoothed_length(d, EPS),
            slope,
            slope_over_distance(d, EPS) - turn_coefficient(d, EPS) * d**2,
        ]
    )


def test_length_is_twice_continuously_differentiable_at_eps():
    below, above = derivatives(EPS * (1 - 1e-9)), derivatives(EPS)
    np.testing.assert_allclose(below, above, atol=1e-7)
    np.testing.assert_allclose(above, [EPS, 1, 0], atol=1e-14)
    # the third derivative jumps, so C2 and no more is claimed
    assert abs(derivatives(EPS * (1 - 1e-3))[2] / 1e-3) > 1


@pytest.mark.parametrize("d", [0.05, 0.2, 0.29, 0.31, 2.0])
def test_derivatives_of_the_length(d):
    h = 1e-6
    up, down = derivatives(d + h), derivatives(d - h)
    np.testing.assert_allclose((up - down)[:2] / (2 * h), derivatives(d)[1:], atol=1e-8)


@pytest.mark.parametrize("d", [0.05, 0.29, 0.31, 2.0])
def test_segment_forces_and_stiffness(d):
    """Gradient and Hessian of a segment's length in space, by differences."""
    direction = np.array([1.0, 2.0, -2.0]) / 3
    X = np.array([(1.0, 2.0, 3.0), (0.0, 0.0, 0.0)])
    X[1] = X[0] + d * direction
    segments, eps, length = np.array([[0, 1]], dtype=np.int32), np.array([EPS]), np.zeros(1)

    def value(x):
        segment_lengths(X, x.reshape(2, 3), segments, eps, length)
        return length[0]

    def gradient(x):
        g = np.zeros((2, 3))
        add_segment_forces(X, x.reshape(2, 3), segments, eps, np.ones(1), g)
        return g.ravel()

    h, x0 = 1e-6, np.zeros(6)
    unit = h * np.eye(6)
    slope = np.array([(value(e) - value(-e)) / (2 * h) for e in unit])
    np.testing.assert_allclose(gradient(x0), slope, atol=1e-8)
    block = np.zeros((1, 3, 3))
    segment_stiffness(X, x0.reshape(2, 3), segments, eps, np.ones(1), block)
    hessian = np.array([(gradient(e) - gradient(-e)) / (2 * h) for e in unit])
    k = block[0]
    np.testing.assert_allclose(np.block([[k, -k], [-k, k]]), hessian, atol=1e-7)


class HeldTension(CableTension):
    """Energy ``T l`` of tensions that do not change: its Hessian is the geometric stiffness."""

    def tensions(self, lengths):
        return self.EA

    def energy(self, sums):
        return float(self.EA @ sums)


def chain(kind=CableTension, **history):
    """Two cables of four and three points, close points within the smoothing among them."""
    X = np.random.default_rng(0).normal(size=(7, 3)) * 4
    X[2] = X[1] + (0.05, 0.0, 0.1)
    segments = np.array([(0, 1), (1, 2), (2, 3), (4, 5), (5, 6)], dtype=np.int32)
    cable = np.array([0, 0, 0, 1, 1], dtype=np.int32)
    EA, L0 = np.array([50.0, 80.0]), np.array([6.0, 5.0])
    term = kind(segments, np.full(5, EPS), cable, EA, L0, **history)
    return TermOnPoints(term, X), X


def test_energy_and_tension_of_whole_polylines():
    f, X = chain()
    x = np.random.default_rng(1).normal(size=X.shape)
    x[2] = x[1]
    energy, _ = f.value(x)
    lengths = np.zeros(2)
    for (a, b), c in zip(f.term.segments, f.term.cable, strict=True):
        d = np.linalg.norm((X + x)[b] - (X + x)[a])
        u = d / EPS
        lengths[c] += d if d >= EPS else EPS * (-(u**4) / 8 + 3 * u**2 / 4 + 3 / 8)
    elongation = lengths - f.term.L0
    assert np.all(elongation > 0)
    np.testing.assert_allclose(f.sums, lengths, rtol=1e-14)
    assert energy == pytest.approx(np.sum(f.term.EA / (2 * f.term.L0) * elongation**2), rel=1e-13)
    np.testing.assert_allclose(
        f.term.tensions(lengths), f.term.EA * elongation / f.term.L0, rtol=1e-13
    )


def test_what_smoothing_adds_is_taken_off():
    """With the excess of a state it has the energy of the true lengths there, and its gradient is
    that of the smoothed ones."""
    f, X = chain()
    x = np.zeros_like(X)
    x[2] = X[1] - X[2] + (0.3 * EPS, 0.0, 0.0)
    _, before = f.value(x)
    true = np.zeros(2)
    np.add.at(
        true, f.term.cable, np.linalg.norm(np.diff((X + x)[f.term.segments], axis=1), axis=2)[:, 0]
    )
    smoothed = f.sums.copy()
    assert smoothed[0] - true[0] > 0.1 * EPS
    f.term.smoothing_length[:] = smoothed - true
    energy, g = f.value(x)
    np.testing.assert_allclose(f.sums, true, rtol=1e-14)
    strain = true / f.term.L0 - 1
    assert energy == pytest.approx(np.sum(f.term.EA * f.term.L0 * strain**2) / 2, rel=1e-13)
    ratio = (true - f.term.L0)[0] / (smoothed - f.term.L0)[0]
    np.testing.assert_allclose(g[:4], before[:4] * ratio, rtol=1e-12)


def test_slack_cable_has_no_energy_and_no_force():
    f, X = chain()
    f.term.L0[0] = 1e3
    energy, g = f.value(0 * X)
    assert energy > 0, "the other cable is taut"
    assert not np.any(g[:4])
    assert np.any(g[4:])
    f.term.L0[1] = 1e3
    energy, g = f.value(0 * X)
    assert energy == 0.0
    assert not np.any(g)


def test_gradient_on_free_points():
    f, X = chain()
    rng = np.random.default_rng(1)
    x, d = rng.normal(size=(2, *X.shape))
    x[2] = x[1]
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03)


@pytest.mark.ranks
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_gradient_on_the_membrane(comm, size):
    f = on_mesh(cable_square(comm), "CableTension")
    x = displaced(f.unknowns, size)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


def test_stiffness_is_the_geometric_part():
    f, X = chain(HeldTension)
    rng = np.random.default_rng(1)
    x, d = rng.normal(size=(2, *X.shape))
    x[2] = x[1]
    assert stiffness_error(f, x, d, h=1e-5) < 1e-7
    assert stiffness_order(f, x, d, steps=0.005 * 0.5 ** np.arange(5)) == pytest.approx(3, abs=0.1)


def test_stiffness_lacks_the_dyad_of_the_whole_cable_alone():
    """The rest of the Hessian is ``EA/L0`` times the dyad of the length's gradient."""
    f, X = chain()
    x, h = 0.3 * np.random.default_rng(1).normal(size=X.shape), 1e-6
    held, _ = chain(HeldTension)
    dyads = np.zeros((X.size, X.size))
    for c in (0, 1):
        held.term.EA = np.eye(2)[c]
        g = held.value(x)[1].ravel()
        dyads += f.term.EA[c] / f.term.L0[c] * np.outer(g, g)
    units = h * np.eye(X.size).reshape(-1, *X.shape)
    hessian = np.array([(f.value(x + e)[1] - f.value(x - e)[1]).ravel() / (2 * h) for e in units])
    np.testing.assert_allclose(f.matrix(x) + dyads, hessian, atol=1e-5 * np.abs(hessian).max())


@pytest.mark.ranks
def test_stiffness_on_the_membrane(comm):
    """With tied points and anchors, on any number of ranks."""
    system = cable_square(comm)
    t = system.cables.tables
    held = HeldTension(t.segments, t.eps, t.cable, np.array([20.0, 30.0, 15.0]), np.ones(3))
    system.potential.terms.append(held)
    f = on_mesh(system, "HeldTension")
    x, d = displaced(f.unknowns, 0.3), directions(f.unknowns)["all"]
    # held components are zero in a tied point's row, but a tied point moves with its vertices
    assert stiffness_error(f, x, d) < 1e-6


def test_stiffness_is_semidefinite():
    f, X = chain()
    assert is_semidefinite(f.matrix(0.3 * np.random.default_rng(1).normal(size=X.shape)))


def test_rigid_motion_changes_nothing(comm):
    f = on_mesh(cable_square(comm), "CableTension")
    X = f.unknowns.X[: f.unknowns.n_owned]
    x = displaced(f.unknowns, 1.0)
    energy, _ = f.value(x)
    rigid = moved(f.unknowns, x)
    again, g = f.value(rigid)
    rigid = f.potential.x[: f.unknowns.n_owned]
    assert again == pytest.approx(energy, rel=1e-12)
    size = np.sqrt(f.dot(g, g))
    np.testing.assert_allclose(comm.allreduce(g.sum(axis=0)), 0, atol=1e-11 * size)
    moment = comm.allreduce(np.cross(X + rigid, g).sum(axis=0))
    np.testing.assert_allclose(moment, 0, atol=1e-9 * size)


def step_chain():
    starts = [StepStart(2.0, 20.0, 1.0), StepStart(0.5, 10.0, 3.0)]
    return chain(StepCableTension, starts=starts)


def test_step_law_is_the_papers():
    f, X = step_chain()
    energy, _ = f.value(0 * X)
    EA, (length, T, W) = f.term.EA, ((20.0, 10.0), (2.0, 0.5), (1.0, 3.0))
    delta = f.sums - length  # (2.2-1)
    dT = EA / length * delta  # (2.2-2)
    assert energy == pytest.approx(np.sum(W + ((dT + T) + T) * delta / 2), rel=1e-13)  # (2.2-3)
    assert np.any(dT + T < 0), "the paper's cable may be compressed"


def test_step_law_gradient():
    f, X = step_chain()
    x, d = 0.3 * np.random.default_rng(1).normal(size=(2, *X.shape))
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03)


def test_step_law_in_many_steps():
    """Energy is the work of the tension, whatever the steps; tension is ``EA ln(l / l_n)``."""
    f, X = step_chain()
    f.value(0 * X)
    f.term.starts = [StepStart(1.0, length, 0.0) for length in f.sums]
    f.term.attach(f.term.unknowns)
    first, work, before = f.sums.copy(), 0.0, (f.sums.copy(), np.ones(2))
    for k in range(400):
        energy, _ = f.value((k + 1) / 400 * 0.2 * X)
        tension = f.term.tensions(f.sums)
        work += float(np.sum((tension + before[1]) / 2 * (f.sums - before[0])))
        before = (f.sums.copy(), tension.copy())
        f.term.commit(0 * X, f.sums)
        assert f.term.energy(f.sums) == pytest.approx(energy, rel=1e-14)
    assert energy == pytest.approx(work, rel=1e-12)
    tensions = [start.tension for start in f.term.starts]
    np.testing.assert_allclose(tensions, 1 + f.term.EA * np.log(f.sums / first), rtol=1e-3)
