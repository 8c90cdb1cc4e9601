"""Friction sideways and along a cable together: one node by hand, and a cable dragged obliquely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from grids import numbered, triangles
from mpi4py import MPI
from roped_drum import WRAP, roped
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from crms_fenicsx import Cable, Friction, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.verification.cable_forces import forces
from crms_fenicsx.cabling.contact.contact_force import contact_forces
from crms_fenicsx.cabling.friction.slip import Slip, law_sideways, shares
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.laid_cable import LaidCable

MU, ALONG = 0.4, 0.2
EPS = np.array([1e-3]), np.array([1e-5])
"""Slips at which friction is mobilised, sideways and along."""


def node(s: float, t: float) -> tuple[float, float]:
    """Forces of one node, relative to the bounds in each direction, by its slips."""
    u, v = shares(Slip.of(MU, np.array([s]), EPS[0]), Slip.of(ALONG, np.array([t]), EPS[1]))
    return float(u[0]), float(v[0])


# one node


@pytest.mark.parametrize("y", [0.2, 0.9, 3.0, 1e4])
def test_slip_in_one_direction_has_its_own_law(y: float) -> None:
    one = min(y, 1.0) * (2 - min(y, 1.0))
    assert node(y * EPS[0][0], 0.0) == pytest.approx((one, 0.0), abs=1e-12)
    assert node(0.0, y * EPS[1][0]) == pytest.approx((0.0, one), abs=1e-12)


def test_node_sticks_as_in_the_box() -> None:
    """Shares 0.36 and 0.75, inside of the ellipse."""
    assert node(0.2 * EPS[0][0], 0.5 * EPS[1][0]) == pytest.approx((0.36, 0.75), rel=1e-12)


@pytest.mark.parametrize("angle", [10.0, 45.0, 80.0])
def test_long_slip_dissipates_most(angle: float) -> None:
    """Of all forces on the ellipse: F = (mu^2 s, along^2 t) N/sqrt((mu s)^2 + (along t)^2)."""
    s, t = 1e3 * np.sin(np.radians(angle)), 1e3 * np.cos(np.radians(angle))
    u, v = node(s, t)
    every = np.linspace(0, np.pi / 2, 100001)
    best = every[np.argmax(MU * np.sin(every) * s + ALONG * np.cos(every) * t)]
    assert (u, v) == pytest.approx((np.sin(best), np.cos(best)), abs=2e-5)
    assert u / v == pytest.approx(MU * s / (ALONG * t), rel=1e-4)


def test_forces_are_those_of_a_potential_and_within_the_cone() -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        s, t = 10 ** rng.uniform(-1, 1, 2) * (EPS[0][0], EPS[0][0] * rng.choice([0.01, 1.0]))
        u, v = node(s, t)
        assert u**2 + v**2 <= 1 + 1e-12
        ds, dt = 1e-5 * s, 1e-5 * t
        across = MU * (node(s, t + dt)[0] - node(s, t - dt)[0]) / (2 * dt)
        back = ALONG * (node(s + ds, t)[1] - node(s - ds, t)[1]) / (2 * ds)
        assert across == pytest.approx(back, rel=1e-3, abs=1e-6 * MU / t)


@pytest.mark.parametrize(("s", "t"), [(2e-3, 1e-3), (1e-4, 1e-3), (0.0, 1e-3), (2e-3, 0.0)])
def test_law_with_the_other_slip_held_has_the_same_force(s: float, t: float) -> None:
    sideways = Slip.of(MU, np.array([s]), EPS[0])
    along = Slip.of(ALONG, np.array([t]), EPS[1])
    u, v = shares(sideways, along)
    bound, width, elastic = sideways.law(u, along.plastic(v))
    y = np.minimum(s / (EPS[0] * width), 1.0)
    assert bound * y * (2 - y) == pytest.approx(u, abs=1e-12)
    assert elastic <= 1.0
    if s == 0.0:  # as much as the exact force for a small slip
        small = 1e-6
        y = small / (EPS[0] * width)
        assert (bound * y * (2 - y))[0] == pytest.approx(node(small, t)[0], rel=0.01)


# a cable on a drum


def steady(mu: float, along: float, beta: float) -> tuple[Array, Array, Array, Array]:
    """A cable that slides over the drum of radius 1 and keeps its shape, on the developed drum.

    It moves by sin(beta) along the drum's axis and by cos(beta) along itself. With alpha its angle
    to the drum's circles, it presses with ``T cos(alpha)^2``, slips by ``sin(beta) cos(alpha)``
    sideways and ``cos(beta) + sin(beta) sin(alpha)`` along, and so alpha' = q_s, (ln T)' = q_t with
    the friction forces of the ellipse.

    Returns
    -------
    Places along the axis and around the drum, alpha, and ln T.
    """

    def motion(_: float, state: Array) -> list[float]:
        alpha, press = state[2], np.cos(state[2]) ** 2
        s, t = np.sin(beta) * np.cos(alpha), np.cos(beta) + np.sin(beta) * np.sin(alpha)
        size = np.hypot(mu * s, along * t)
        sideways, forward = press * mu**2 * s / size, press * along**2 * t / size
        return [np.sin(alpha), np.cos(alpha), sideways, forward]

    def left(_: float, state: Array) -> float:
        return float(state[1] - np.pi / 2)

    left.terminal = True  # type: ignore[attr-defined]

    def go(alpha: float) -> Array:
        start = [0.0, -np.pi / 2, alpha, 0.0]
        way = solve_ivp(motion, (0, 20), start, events=left, rtol=1e-9, max_step=0.02)
        return np.asarray(way.y)

    found = brentq(lambda alpha: go(alpha)[2, -1] + alpha, -1.2, 0.5)
    x, around, alpha, T = go(found)
    return x, around, alpha, T


def dragged(
    comm: MPI.Intracomm, friction: Friction, beta: float, n: int = 16, seed: int = 1
) -> tuple[Scene, LaidCable, Array]:
    """A cable that was laid in the steady shape and dragged; and the exact ln T."""
    x, around, alpha, T = steady(friction.mu, friction.along, beta)
    far, way, size = 0.2, 0.5, np.pi / n
    low, high = x.min() - far - 0.2, x.max() + far + 0.2
    rows, rng = round((high - low) / size), np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(rows + 1), np.arange(n + 1), indexing="ij")
    inner = (i > 0) & (i < rows) & (j > 0) & (j < n)
    along, about = 0.25 * inner * rng.uniform(-1, 1, (2, *i.shape)) + (i, j)
    angle = about / n * np.pi - np.pi / 2
    along = low + (high - low) * along / rows
    points = np.stack([along, np.sin(angle), np.cos(angle)], axis=-1).reshape(-1, 3)
    cells = triangles(numbered(*i.shape))
    membrane = meshes.from_arrays(comm, points, cells, outside=(0.0, 0.0, 1.0))
    scene = Scene(membrane, IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False))
    scene.fix(lambda x: np.full(x.shape[1], True))
    path = np.column_stack([x, np.sin(around), np.cos(around)])[:: max(len(x) // 40, 1)]
    path[-1] = x[-1], 1.0, 0.0
    ends = way * np.array([(-np.tan(alpha[0]), 0, -1), (np.tan(alpha[-1]), 0, -1)])
    path = np.vstack([path[0] + ends[0], path, path[-1] + ends[1]])
    cable = scene.lay_cable(Cable(100.0, friction=friction), path, tension=1.0)
    sideways, forward = far * np.sin(beta), far * np.cos(beta)
    moves = {
        end: (sideways + forward * np.sin(angle), 0.0, sign * forward * np.cos(angle))
        for end, angle, sign in ((cable.start, alpha[0], 1.0), (cable.end, alpha[-1], -1.0))
    }
    Solver(scene).advance(move=moves)
    return scene, cable, T


def test_pure_sliding_along_is_a_capstan(comm) -> None:
    tensions = []
    for cone in (False, True):
        scene, rope = roped(comm, 20, 0.3, mu=0.3, cone=cone)
        Solver(scene).advance(move={rope.end: (0.0, 0.0, -0.1)})
        tensions.append(rope.tensions)
    T = tensions[1]
    assert T[-1] / T[0] == pytest.approx(np.exp(0.3 * WRAP), rel=1e-4)
    np.testing.assert_allclose(T, tensions[0], rtol=1e-4)


@pytest.mark.ranks
@pytest.mark.parametrize(("mu", "along", "degrees"), [(0.3, 0.3, 60.0), (0.3, 0.15, 30.0)])
def test_cable_that_is_dragged_obliquely(comm, mu: float, along: float, degrees: float) -> None:
    """Against an ordinary differential equation; single meshes are off by 3 %."""
    friction = Friction(mu, along=along, cone=True)
    scene, cable, exact = dragged(comm, friction, np.radians(degrees))
    ratio = np.log(cable.tensions[-1] / cable.tensions[0])
    assert ratio == pytest.approx(exact[-1], rel=0.06)
    assert ratio < 0.9 * along * np.pi
    shape = scene.net.strip_shape()
    assert forces(cable, shape, 0.0, None)["friction beyond its bound"] < 0.05
    on = [k for k in cable.contacts() if cable.state.nodes[k].slides]
    press = contact_forces(cable, shape)
    sideways = abs(press.lateral[on].sum()) / press.bearing[on].sum()
    _, around, alpha, _ = steady(mu, along, np.radians(degrees))
    mean = (alpha[-1] - alpha[0]) / np.trapezoid(np.cos(alpha), around)
    assert sideways == pytest.approx(mean, rel=0.1)
    assert scene.dissipated > 0.0


def test_verification_sees_what_is_beyond_the_cone(comm) -> None:
    box = Friction(0.3, along=0.3)
    scene, cable, _ = dragged(comm, box, np.radians(45.0))
    shape = scene.net.strip_shape()
    assert forces(cable, shape, 0.0, None)["friction beyond its bound"] < 0.1
    cable.update(cable=replace(cable.cable, friction=replace(box, cone=True)))
    assert forces(cable, shape, 0.0, None)["friction beyond its bound"] > 0.3


def test_a_slack_cable_has_no_cone(comm) -> None:
    """One part of it may be in tension, but the slip that mobilises friction follows the strain of
    the whole."""
    scene, cable, _ = dragged(comm, Friction(0.3, along=0.3, cone=True), np.radians(60.0))
    shape, grip = scene.net.strip_shape(), cable.state.law.lateral
    law = law_sideways(cable, grip, shape)
    assert law is not None and np.isfinite([law.bound, law.width, law.elastic]).all()
    cable.update(length=0.999 * cable.L0)
    assert law_sideways(cable, grip, shape) is None


def test_refusals() -> None:
    for wrong in ({"along": 0.0}, {"mu": 0.0}, {"law": "step", "along": 0.0}):
        with pytest.raises(InputError, match="cone = True couples"):
            Friction(**{"mu": 0.3, "along": 0.3, "cone": True, **wrong})
    with pytest.raises(InputError, match="has no static coefficient"):
        Friction(0.3, along=0.3, static=0.4, cone=True)
