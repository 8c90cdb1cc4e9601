"""Slip against the material curve: nearest points, directions, and what is carried along."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import put
from friction_scene import friction_dome, shaken_fractions
from mpi4py import MPI
from rigid_surfaces import band, curve, rigid, sphere

from crms_fenicsx.cabling.friction.lateral import start_step
from crms_fenicsx.cabling.friction.slip import material_curve, node_slips
from crms_fenicsx.model.friction import Friction, MaterialCurve


def some_curve(points, part=None, elastic=None, moving=None):
    points = np.array(points, dtype=float)
    n = len(points)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return MaterialCurve(
        points,
        np.concatenate([[0.0], np.cumsum(steps)]),
        np.zeros(n, dtype=np.int64) if part is None else np.array(part),
        np.zeros(n) if elastic is None else np.array(elastic, dtype=float),
        np.zeros(n) if moving is None else np.array(moving, dtype=float),
    )


def nearest_twin(curve, place):
    """Segment by segment; beyond the ends of a part the arc length goes on."""
    best = np.inf, 0.0, np.zeros(3), -1
    for k in range(len(curve.points) - 1):
        if curve.part[k] != curve.part[k + 1]:
            continue
        a, b = curve.points[k], curve.points[k + 1]
        size = np.linalg.norm(b - a)
        if size == 0.0:
            continue
        t = (place - a) @ (b - a) / size**2
        foot = a + min(max(t, 0.0), 1.0) * (b - a)
        far = np.linalg.norm(place - foot)
        if far < best[0]:
            first = k == 0 or curve.part[k - 1] != curve.part[k]
            last = k + 2 == len(curve.points) or curve.part[k + 2] != curve.part[k]
            beyond = (t < 0 and first) or (t > 1 and last)
            share = t if beyond else min(max(t, 0.0), 1.0)
            best = far, curve.arc[k] + share * size, foot, curve.part[k]
    return best[1:]


def zigzag():
    """Two parts with a gap, points in one place, a kink."""
    points = [
        (0, 0, 0),
        (1, 0, 0),
        (1, 0, 0),
        (2, 1, 0),
        (3, 1, 0.5),
        (5, 0, 0),
        (6, 0, 0),
        (8, 1, 0),
    ]
    return some_curve(points, part=[0, 0, 0, 0, 0, 1, 1, 1], elastic=np.arange(8) / 10)


def test_nearest_points():
    curve = zigzag()
    places = np.random.default_rng(0).uniform((-2, -2, -1), (10, 3, 1), (300, 3))
    at, feet, parts = curve.nearest(places)
    twins = [nearest_twin(curve, place) for place in places]
    np.testing.assert_allclose(at, [t[0] for t in twins], atol=1e-12)
    np.testing.assert_allclose(feet, [t[1] for t in twins], atol=1e-12)
    assert parts.tolist() == [t[2] for t in twins]
    assert set(parts.tolist()) == {0, 1}
    assert at.min() < 0 and at.max() > curve.arc[-1]  # beyond the ends of all


def test_nearest_of_nothing():
    places = np.array([(1.0, 2.0, 3.0)])
    for nothing in (some_curve([(0, 0, 0)]), some_curve([(0, 0, 0), (0, 0, 0)])):
        at, feet, parts = nothing.nearest(places)
        assert (at.tolist(), feet.tolist(), parts.tolist()) == ([0.0], places.tolist(), [-1])


def test_tangents_are_means_over_a_reach():
    """Chords between the points a reach before and after, or at the end of the part."""
    curve = zigzag()
    at, reach = np.array([0.1, 1.2, 3.0, 7.0]), np.array([0.5, 0.7, 0.2, 5.0])
    found = curve.tangents(at, np.array([0, 0, 0, 1]), reach)
    for k, part in enumerate([0, 0, 0, 1]):
        own = curve.part == part
        arc, points = curve.arc[own], curve.points[own]
        ends = np.clip([at[k] - reach[k], at[k] + reach[k]], arc[0], arc[-1])
        chord = np.diff([[np.interp(e, arc, points[:, i]) for i in range(3)] for e in ends], axis=0)
        np.testing.assert_allclose(found[k], chord[0] / np.linalg.norm(chord), atol=1e-14)


def test_tangents_where_points_lie_close_together():
    """The direction between two points that are 1e-9 apart means nothing, that around them does."""
    curve = some_curve([(0, 0, 0), (1, 0, 0), (1, 1e-9, 0), (2, 0, 0)])
    t = curve.tangents(np.array([1.0]), np.array([0]), np.array([0.3]))
    np.testing.assert_allclose(t[0], (1, 0, 0), atol=1e-8)


def test_elastic_slip_and_motion_along_the_curve():
    curve = zigzag()
    curve.moving[:] = (0, 1, 1, -1, 0, 0, 1, 0)
    at = curve.arc[0] + 0.25
    assert curve.history(np.array([at]), np.array([0]))[0][0] == pytest.approx(0.25 * 0.1)
    # nothing is taken from the other side of a gap
    assert curve.history(np.array([curve.arc[5] - 0.1]), np.array([1]))[0][0] == 0.5
    _, moving = curve.history(np.array([0.4, 0.6, curve.arc[6] + 0.1]), np.array([0, 0, 1]))
    assert moving.tolist() == [0, 1, 1]


def test_no_slip_where_a_cable_lies():
    """Whatever its mesh: all its points are on the curve. Elastic slip that was left is there."""
    scene, shape = friction_dome()
    for cable in scene.cables:
        curve = material_curve(cable, shape)
        slips = node_slips(cable, curve, shape)
        assert len(slips.nodes) > 5
        assert np.abs(slips.slip).max() < 1e-13 * 100
        elastic = {k: 0.01 * (k % 3) for k in slips.nodes}
        moving = {k: float(k % 2) for k in slips.nodes}
        left = node_slips(cable, material_curve(cable, shape, elastic, moving), shape)
        np.testing.assert_allclose(left.slip, list(elastic.values()), atol=1e-12)
        assert left.moving.tolist() == list(moving.values())


def edge_of(cable, k, shape):
    """The stress-free edge of a node, as a vector."""
    a, b = (shape.stress_free_at(v) for v in cable.state.nodes[k].point.support)
    return b - a


def test_slip_is_the_distance_to_the_left():
    """To the second order in the slip: the curve bends."""
    scene, shape = friction_dome()
    for cable in scene.cables:
        start_step(cable, shape)
        curve = cable.state.law.lateral.curve
        for size, seed in ((0.02, 1), (0.01, 2)):
            shaken_fractions(scene, size, seed)
            slips = node_slips(cable, curve, shape)
            assert np.ptp(np.sign(slips.slip)) == 2
            along, compared = curve.points[-1] - curve.points[0], 0
            for i, k in enumerate(slips.nodes):
                ids, weights = cable.interpolation(k)
                place = np.dot(weights, [shape.stress_free_at(v) for v in ids])
                arc, foot, _ = nearest_twin(curve, place)
                steep = abs(slips.slope[i]) / np.linalg.norm(edge_of(cable, k, shape))
                if not 0.0 < arc < curve.arc[-1] or steep < 0.5:
                    continue  # the way along the curve, at its ends and its corners, is no slip
                compared += 1
                side = np.sign(np.cross(along, place - foot)[2])
                far = side * np.linalg.norm(place - foot)
                # a chord's direction turns by up to .3 around a node; so does the left
                assert slips.slip[i] == pytest.approx(far, rel=0.06, abs=1e-3)
                assert slips.size[i] == pytest.approx(100 / 6, rel=0.5)
            assert compared > len(slips.nodes) // 2
            frozen = slips.slope * cable.state.fractions[slips.nodes] + slips.offset
            np.testing.assert_allclose(slips.slip, frozen, atol=1e-13)


def test_slip_does_not_depend_on_the_direction_of_the_path():
    """A cable laid the other way slips to the other side by as much."""
    way = curve(sphere(0.5), np.tan(0.5), 0.5)
    mesh = band(way, 0.1, 3)
    slipped = []
    for path in (way.points[::16], way.points[::-16]):
        scene, cable = rigid(MPI.COMM_SELF, way, mesh, Friction(0.5), path=path)
        shape = scene.net.strip_shape()
        start_step(cable, shape)
        by_edge = {cable.state.nodes[k].point.support: k for k in range(len(cable.state.nodes))}
        for k in by_edge.values():
            if cable.state.nodes[k].slides:
                put(cable, "fractions", k, cable.state.fractions[k] * 0.95)
        slips = node_slips(cable, cable.state.law.lateral.curve, shape)
        slipped.append(dict(zip(slips.supports, slips.slip, strict=True)))
    assert slipped[0].keys() == slipped[1].keys()
    for support, slip in slipped[0].items():
        assert slipped[1][support] == pytest.approx(-slip, abs=1e-9)
    assert max(map(abs, slipped[0].values())) > 1e-3


def test_nodes_where_the_cable_was_off_the_membrane_have_no_slip():
    """They touch down in this step, and stay in the tables: their number must not change."""
    scene, shape = friction_dome()
    cable = scene.cables[0]
    curve = material_curve(cable, shape)
    half = len(curve.points) // 2
    first = MaterialCurve(
        curve.points[:half], curve.arc[:half], curve.part[:half], curve.elastic[:half] + 0.01,
        curve.moving[:half] + 1,
    )  # fmt: skip
    slips = node_slips(cable, first, shape)
    assert slips.nodes == node_slips(cable, curve, shape).nodes
    beyond = np.linalg.norm(cable.state.positions[slips.nodes] - curve.points[half - 1], axis=1)
    far = (beyond > 30) & (cable.state.positions[slips.nodes, 0] > 50)
    assert far.sum() > 2
    for values in (slips.slope, slips.offset, slips.slip, slips.moving):
        assert np.all(values[far] == 0.0)
        assert np.any(values[~far] != 0.0)


def test_lifted_nodes_part_the_curve():
    scene, shape = friction_dome()
    cable = scene.cables[0]
    put(cable, "lifted", slice(None), False)
    put(cable, "lifted", slice(5, 7), True)
    curve = material_curve(cable, shape)
    on = [k for k in cable.contacts() if cable.state.nodes[k].kind != "anchor"]
    assert len(curve.points) == len(on)
    assert np.unique(curve.part).tolist() == [0, 1]
    assert not set(node_slips(cable, curve, shape).nodes) & {5, 6}
