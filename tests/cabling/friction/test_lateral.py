"""Bounds of friction through a load step: shared on new paths, found by secants, energies."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from friction_scene import friction_dome, shaken_fractions
from strip_roof import cable_of

from crms_fenicsx import Cable
from crms_fenicsx.cabling.contact.contact_force import contact_forces
from crms_fenicsx.cabling.friction import passes as iteration
from crms_fenicsx.cabling.friction.axial import remap_axial
from crms_fenicsx.cabling.friction.lateral import end_step, energies, remap, start_step
from crms_fenicsx.cabling.friction.passes import AitkenRelaxation, LateralIteration
from crms_fenicsx.cabling.friction.slip import node_slips
from crms_fenicsx.foundation.surface.points import EdgePoint, VertexPoint
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.friction import (
    AxialFrictionState,
    Friction,
    LateralFrictionState,
    MaterialCurve,
)
from crms_fenicsx.model.tolerances import TOL

NOWHERE = MaterialCurve(
    np.zeros((1, 3)), np.zeros(1), np.zeros(1, dtype=np.int64), np.zeros(1), np.zeros(1)
)


def along(*supports):
    """A cable between two anchors over these edges (a, b) and vertices (a,)."""
    nodes = [
        CableNode("fold", EdgePoint(s, 0.5))
        if len(s) == 2
        else CableNode("vertex", VertexPoint(*s))
        for s in supports
    ]
    nodes = [CableNode("anchor"), *nodes, CableNode("anchor")]
    n = len(nodes)
    x = np.column_stack([np.arange(n), np.zeros((n, 2))])
    return cable_of(Cable(1.0, friction=0.5), nodes, x, tension=1.0)


def gripped(bounds, moving=None):
    """What held a cable over edges (0, 1), (1, 2) ... ."""
    n = len(bounds)
    supports = tuple((k, k + 1) for k in range(n))
    way = np.zeros(n) if moving is None else np.array(moving, dtype=float)
    return LateralFrictionState(NOWHERE, supports, np.array(bounds, dtype=float), way, known=True)


@pytest.mark.parametrize(
    ("path", "bounds", "moving"),
    [
        # two edges give way to three: they share the force of the two
        ([(0, 1), (1, 7), (7, 8), (3, 8), (3, 4)], [1, 2, 2, 2, 5], [0, -1, -1, -1, 0]),
        # two give way to none: their neighbours get it
        ([(0, 1), (3, 4)], [1 + 3, 5 + 3], [-1, -1]),
        # at the cable's end there is one neighbour
        ([(1, 2), (2, 3), (3, 4)], [2 + 1, 4, 5], [-1, -1, 0]),
        # nothing gives way to one: it has no force yet
        ([(0, 1), (1, 2), (2, 8), (2, 3), (3, 4)], [1, 2, 0, 4, 5], [0, -1, 0, -1, 0]),
        # an edge to a vertex
        ([(0, 1), (1, 2), (3,), (3, 4)], [1, 2, 4, 5], [0, -1, -1, 0]),
        # all new, or the other way round: the ends have those of the ends, what is left is shared
        ([(8, 9), (9, 10)], [1 + 3, 5 + 3], [-1, -1]),
        ([(3, 4), (2, 3), (1, 2), (0, 1)], [1 + 1.5, 1.5, 1.5, 5 + 1.5], [-1, -1, -1, -1]),
    ],
)
def test_bounds_move_to_a_new_path(path, bounds, moving):
    cable = along(*path)
    cable.update(lateral=gripped([1, 2, 4, 5], [0, -1, -1, 0]))
    remap(cable)
    assert cable.state.law.lateral.supports == tuple(path)
    assert cable.state.law.lateral.bounds.tolist() == bounds
    assert cable.state.law.lateral.moving.tolist() == moving
    assert cable.state.law.lateral.bounds.sum() == 12


def test_widths_of_the_cone_are_not_shared_out() -> None:
    """Three nodes in place of two have their force together, and each the width of the two."""
    cable = along((0, 1), (1, 7), (7, 8), (3, 8), (3, 4))
    old = gripped([1, 2, 4, 5])
    cone = replace(cable.cable, friction=Friction(0.5, along=0.5, cone=True))
    cable.update(cable=cone)
    widths, none = np.array([0.1, 0.2, 0.4, 0.5]), np.zeros(0)
    cable.update(
        axial=AxialFrictionState(
            NOWHERE, none, old.supports, old.bounds, widths, widths / 2, none, none, none, widths
        )
    )
    remap_axial(cable)
    axial = cable.state.law.axial
    assert axial is not None
    np.testing.assert_allclose(axial.bounds, [1, 2, 2, 2, 5])
    for values, scale in ((axial.eps, 1.0), (axial.elastic, 0.5), (axial.slips, 1.0)):
        np.testing.assert_allclose(values, scale * np.array([0.1, 0.3, 0.3, 0.3, 0.5]))


def test_random_path_changes_keep_the_sum():
    rng = np.random.default_rng(0)
    cable = along(*[(k, k + 1) for k in range(12)])
    cable.update(lateral=gripped(rng.uniform(0, 1, 12)))
    total = cable.state.law.lateral.bounds.sum()
    for number in range(200):
        supports = list(cable.state.law.lateral.supports)
        start = int(rng.integers(0, len(supports) - 2))
        gone = int(rng.integers(1, 3))
        new = [(1000 + 3 * number, 1001 + 3 * number + i) for i in range(int(rng.integers(1, 4)))]
        old, cable = (
            cable.state.law.lateral,
            along(*supports[:start], *new, *supports[start + gone :]),
        )
        cable.update(lateral=old)
        remap(cable)
        assert cable.state.law.lateral.bounds.sum() == pytest.approx(total, rel=1e-12)
        assert cable.state.law.lateral.bounds.min() >= 0


def found_from(monkeypatch, law):
    """Passes until the bounds of a state, which `law` gives from their sum, have settled."""
    cable = along((0, 1), (1, 2), (2, 3))
    cable.update(lateral=gripped([1.0, 2.0, 1.0]))
    shares = np.array([0.3, 0.5, 0.2])

    def bounds(cable, grip, shape, settled):
        return law(grip.bounds.sum()) * shares, grip.moving

    monkeypatch.setattr(iteration, "_bounds", bounds)
    monkeypatch.setattr(iteration, "_turned", lambda cable, grip, shape: (grip, 0.0))
    lag = LateralIteration(cable)
    for passes in range(1, 60):
        if lag.renew(None) <= iteration.SETTLED:
            return cable.state.law.lateral.bounds, passes
    raise AssertionError("never settles")


@pytest.mark.parametrize(
    ("law", "root", "most"),
    [
        (lambda F: 3.0, 3.0, 2),  # the tension does not depend on friction
        (lambda F: 0.5 + 0.8 * F, 2.5, 5),  # a cable that keeps its tension if it is held
        (lambda F: 0.5 * F**0.9, 0.5**10, 8),  # one that loses nearly all, .1 % of it left
        (lambda F: 2.0 / F, 2**0.5, 4),  # these two would never settle by themselves
        (lambda F: 2.0 / F**1.5, 2**0.4, 6),
        (lambda F: 2.0 / F**20, 2 ** (1 / 21), 25),  # that lifts off where friction holds it
    ],
)
def test_bounds_are_found_in_a_few_passes(monkeypatch, law, root, most):
    bounds, passes = found_from(monkeypatch, law)
    assert bounds.sum() == pytest.approx(root, rel=5 * iteration.SETTLED)
    assert passes <= most


def test_pace_settles_what_goes_round_in_circles() -> None:
    """Maps that would run away by themselves, or never settle; rows of other nodes begin anew."""
    for slopes in ([-1.0, -1.0], [-3.0, 0.2], [-8.0, -8.0], [0.5, 0.3]):
        pace, x = AitkenRelaxation(0.01), np.array([1.0, -2.0])
        for _ in range(30):
            change = np.array(slopes) * x - x
            if np.abs(change).max() < 1e-6:
                break
            x = x + pace.factor("same", change) * change
        assert np.abs(x).max() < 1e-5, slopes
    part = pace.factor("same", np.array([1.0, 1.0]))
    assert pace.factor("other", np.array([-5.0, 3.0])) == part


def test_first_bounds_hold_by_all_means():
    """More than the cable could ever pull sideways at one node, its tension: it sticks first."""
    scene, shape = friction_dome()
    for cable in scene.cables:
        bounds = cable.state.law.lateral.bounds
        assert not cable.state.law.lateral.known
        assert np.all(bounds > 0.99 * cable.tension)
        lateral = contact_forces(cable, shape).lateral
        for k, node in enumerate(cable.state.nodes):
            if node.point is not None and node.point.support in cable.state.law.lateral.row_of:
                assert cable.state.law.lateral.at(node.point.support) > abs(lateral[k])


def test_bounds_are_those_of_the_contact_forces():
    scene, shape = friction_dome(Friction(0.4))
    for cable in scene.cables:
        lag = LateralIteration(cable)
        first = lag.renew(shape)
        assert first > 1  # the first guess was far too much
        forces = contact_forces(cable, shape)
        for k, node in enumerate(cable.state.nodes[1:-1], start=1):
            if node.kind in ("fold", "edge slider", "vertex") and not cable.state.lifted[k]:
                assert cable.state.law.lateral.at(node.point.support) == 0.4 * forces.bearing[k]
        assert cable.state.law.lateral.known
        assert lag.renew(shape) < 1e-12  # of slips counted from another line, to rounding
        cable.update(taut=False)
        assert LateralIteration(cable).renew(shape) == 0.0


def slid_dome(friction, size=0.02):
    scene, shape = friction_dome(friction)
    for cable in scene.cables:
        LateralIteration(cable).renew(shape)
    shaken_fractions(scene, size)
    return scene, scene.net.strip_shape()


def energies_twin(cable, shape):
    """Integral of the force over the slip: up to eps it is stored, beyond it is heat."""
    friction, stored, heat = cable.cable.sideways, 0.0, 0.0
    slips = node_slips(cable, cable.state.law.lateral.curve, shape)
    for s, size, support in zip(np.abs(slips.slip), slips.size, slips.supports, strict=True):
        eps, F = friction.tolerance * size, cable.state.law.lateral.at(support)
        way = np.linspace(0.0, min(s, eps), 2001)
        stored += np.trapezoid(F * (2 * way / eps - (way / eps) ** 2), way)
        heat += F * max(s - eps, 0.0)
    return stored, heat


def test_energies():
    scene, shape = slid_dome(Friction(0.4, tolerance=0.01))
    for cable in scene.cables:
        stored, heat = energies_twin(cable, shape)
        # the trapezoidal rule with 2000 steps is good to 1/2000^2 of the integrand's bend
        assert energies(cable, shape) == pytest.approx((stored, heat), rel=1e-6)
        assert min(stored, heat) > 0
        cable.update(taut=False)
        assert energies(cable, shape) == (0.0, 0.0)


def test_end_of_a_step():
    """Heat adds up, elastic slip is carried on, what has slid far counts as moving."""
    scene, shape = slid_dome(Friction(0.4, tolerance=0.01), size=0.1)
    for cable in scene.cables:
        stored, heat = energies(cable, shape)
        before = node_slips(cable, cable.state.law.lateral.curve, shape)
        eps = 0.01 * before.size
        cable.update(lateral=replace(cable.state.law.lateral, dissipated=7.0))
        end_step(cable, shape)
        assert cable.state.law.lateral.dissipated == pytest.approx(7.0 + heat, rel=1e-14)
        assert not cable.state.law.lateral.moving.any()
        after = node_slips(cable, cable.state.law.lateral.curve, shape)
        np.testing.assert_allclose(after.slip, np.clip(before.slip, -eps, eps), atol=1e-12)
        far = np.abs(before.slip) > TOL.sliding * before.size
        assert far.any() and not far.all()
        np.testing.assert_array_equal(after.moving, np.sign(before.slip) * far)
        again = energies(cable, shape)
        assert again[1] <= 1e-12  # nothing is counted twice
        assert again[0] == pytest.approx(stored, rel=1e-9)


def test_a_slack_cable_forgets():
    scene, shape = slid_dome(Friction(0.4))
    cable = scene.cables[0]
    cable.update(taut=False)
    end_step(cable, shape)
    assert not cable.state.law.lateral.known
    assert not cable.state.law.lateral.curve.elastic.any()
    cable.update(L0=cable.L0 * 0.99)
    start_step(cable, shape)
    assert np.all(cable.state.law.lateral.bounds > 0.009 * cable.cable.EA)


def test_kinetic_coefficient_where_it_slides():
    """Once the bounds have nearly settled; before, sliding may be theirs."""
    scene, shape = slid_dome(Friction(0.4, static=0.6), size=0.15)
    cable = scene.cables[0]
    slips = node_slips(cable, cable.state.law.lateral.curve, shape)
    far = np.abs(slips.slip) > TOL.sliding * slips.size
    assert far.any() and not far.all()
    rows = [cable.state.law.lateral.row_of[s] for s in slips.supports]
    bearing = contact_forces(cable, shape).bearing[slips.nodes]
    found, moving = iteration._bounds(cable, cable.state.law.lateral, shape, settled=False)
    np.testing.assert_allclose(found[rows], 0.6 * bearing, rtol=1e-14)
    assert not moving.any()
    found, moving = iteration._bounds(cable, cable.state.law.lateral, shape, settled=True)
    np.testing.assert_allclose(found[rows], np.where(far, 0.4, 0.6) * bearing, rtol=1e-14)
    np.testing.assert_array_equal(moving[rows], np.sign(slips.slip) * far)
    # not unset in the step, though the slip has become small
    cable.update(
        lateral=replace(
            cable.state.law.lateral, moving=np.ones_like(cable.state.law.lateral.moving)
        )
    )
    assert iteration._bounds(cable, cable.state.law.lateral, shape, settled=True)[1].all()


def test_what_slides_is_seen_even_if_the_bounds_settle_at_once(monkeypatch):
    """A pass that settles without having nearly settled must not end with static friction."""
    cable = along((0, 1), (1, 2))
    cable.update(lateral=gripped([0.6, 0.6]))
    asked: list[bool] = []

    def bounds(cable, grip, shape, settled):
        asked.append(settled)
        return np.full(2, 0.4 if settled else 0.6), np.full(2, 1.0 if settled else 0.0)

    monkeypatch.setattr(iteration, "_bounds", bounds)
    monkeypatch.setattr(iteration, "_turned", lambda cable, grip, shape: (grip, 0.0))
    assert LateralIteration(cable).renew(SimpleNamespace()) > iteration.SETTLED
    assert asked == [False, True]
    assert cable.state.law.lateral.bounds.tolist() == [0.4, 0.4]
