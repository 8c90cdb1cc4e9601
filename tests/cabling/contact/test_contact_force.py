"""How hard a cable presses: the paper's formulas, signs, what smoothing keeps, and convergence."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced, sheet
from friction_scene import friction_square
from grids import grid
from mpi4py import MPI
from rigid_surfaces import SURFACES, band, curve, rigid, sphere
from strip_roof import cable_of

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.cabling.contact.contact_force import (
    WIDTH,
    contact_forces,
    paper_forces,
    runs,
    smoothed,
    stretches,
    turns,
)
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.model.cable_state import CableNode

COMM = MPI.COMM_SELF
T = 3.0


def polyline(positions, anchored=False, lifted=()):
    """A cable in tension through fold points, on a membrane that is not there."""
    kinds = ["fold"] * len(positions)
    if anchored:
        kinds[0] = kinds[-1] = "anchor"
    nodes = [
        CableNode(kind, None if kind == "anchor" else EdgePoint((k, k + 1), 0.5))
        for k, kind in enumerate(kinds)
    ]
    return cable_of(Cable(1.0), nodes, positions, tension=T, lifted=lifted)


def turned(theta, **choices):
    """Three legs of length 1 that turn by theta at both points between them."""
    at = np.cumsum([(0, 0), *((np.cos(a), np.sin(a)) for a in (0, theta, 2 * theta))], axis=0)
    return polyline(np.column_stack([at, np.zeros(4)]), **choices)


ANGLES = (1e-9, 1e-5, 0.1, 1.0, 2.0, 3.0, np.pi - 1e-3)


@pytest.mark.parametrize("theta", ANGLES)
def test_paper_formulas(theta):
    """(3.2-1) and (3.2-2) as they are printed, where these can be evaluated."""
    inside, boundary = 2 * T * np.sin(theta / 2), T * (1 - np.cos(theta)) / np.sin(theta)
    if theta < 1e-4:  # 1 - cos(theta) has lost all its digits there
        boundary = T * theta / 2
    # positions of size 1 have rounding of 1e-16, which their directions show as an angle
    close = {"rel": 1e-9, "abs": 1e-15 * T / max(np.cos(theta / 2), 1e-3) ** 2}
    assert paper_forces(turned(theta))[1:-1] == pytest.approx([inside] * 2, **close)
    assert paper_forces(turned(theta, anchored=True))[1:-1] == pytest.approx(
        [boundary] * 2, **close
    )


def test_paper_formulas_at_the_ends_of_the_range():
    straight = turned(0.0)
    assert np.all(paper_forces(straight) == 0.0)
    assert np.all(paper_forces(turned(0.0, anchored=True)) == 0.0)
    back = paper_forces(turned(np.pi))
    assert back[1:-1] == pytest.approx([2 * T] * 2)
    # the cable runs back: no membrane's boundary is there, but nothing overflows either
    assert np.all(np.isfinite(paper_forces(turned(np.pi, anchored=True))))


def test_a_slack_cable_presses_nowhere():
    cable = turned(1.0)
    cable.update(taut=False)
    assert not np.any(paper_forces(cable))
    scene, cable = on_cylinder(0.2)[1:]
    cable.update(taut=False)
    forces = contact_forces(cable, scene.net.strip_shape())
    assert not np.any([forces.normal, forces.lateral, forces.bearing])
    assert np.all(np.isnan(forces.line))


def test_points_in_one_place_have_the_directions_around_them():
    """One of two points in one place turns by all of the angle, if counted once each."""
    cable = polyline([(0, 0, 0), (1, 0, 0), (1, 0, 0), (1, 1, 0)])
    for before, after in turns(cable).values():
        np.testing.assert_array_equal(before, (1, 0, 0))
        np.testing.assert_array_equal(after, (0, 1, 0))
    assert polyline([(0, 0, 0)] * 3).contacts() == [0, 1, 2]
    assert turns(polyline([(0, 0, 0)] * 3)) == {}


def test_lifted_nodes_are_passed():
    cable = polyline([(0, 0, 0), (1, 0, 0), (2, 5, 5), (2, 0, 0), (2, 1, 0)], lifted=[2])
    assert list(turns(cable)) == [1, 3]
    np.testing.assert_array_equal(turns(cable)[3][0], (1, 0, 0))
    assert runs(cable) == [[0, 1], [3, 4]]


def hat_twin(arc, forces, at, width):
    """Sum from the cable's start of what two boxes make of the forces, by convolution on a grid;
    what leaves at an end comes back there as in a mirror."""
    n = 4001
    start, end = arc[0], arc[-1]
    x = np.linspace(start - 2 * width, end + 2 * width, n)
    step = x[1] - x[0]
    density = np.zeros(n)
    for place, force in zip(arc, forces, strict=True):
        hat = np.maximum(1 - np.abs(x - place) / width, 0.0) / width
        density += force * hat
    folded = np.where(x < start, 2 * start - x, np.where(x > end, 2 * end - x, x))
    return np.array([np.sum(density[folded <= to]) * step for to in at])


def test_smoothing_is_a_hat_reflected_at_the_ends():
    rng = np.random.default_rng(0)
    arc = np.sort(rng.uniform(2.0, 12.0, 15))
    forces, at, width = rng.normal(size=15), np.linspace(arc[0], arc[-1], 9)[1:], 1.7
    ends = float(arc[0]), float(arc[-1])
    found, twin = smoothed(arc, forces, at, width, ends), hat_twin(arc, forces, at, width)
    # a step of the twin's grid, 4e-3, holds at most 4e-3/1.7 of a force
    np.testing.assert_allclose(found, twin, atol=2.5e-3 * np.abs(forces).sum())
    assert np.ptp(found) > 1.0


@pytest.mark.parametrize("width", [0.3, 2.0, 10.0])
def test_smoothing_keeps_the_sum(width):
    rng = np.random.default_rng(1)
    arc = np.sort(rng.uniform(0.0, 10.0, 12))
    forces = rng.normal(size=12)
    width = min(width, arc[-1] - arc[0])
    ends = stretches(arc)
    sums = smoothed(arc, forces, ends.ravel(), width, (arc[0], arc[-1])).reshape(-1, 2)
    assert np.all(ends[1:, 0] == ends[:-1, 1])
    assert (ends[0, 0], ends[-1, 1]) == (arc[0], arc[-1])
    assert np.sum(sums[:, 1] - sums[:, 0]) == pytest.approx(forces.sum(), abs=1e-13)


def on_cylinder(h, seed=0, ratio=0.0, kind="jittered"):
    """A cable around the top of a cylinder of radius 1, along a helix if the ratio is zero."""
    way = curve(SURFACES["cylinder"], ratio, 0.8)
    scene, cable = rigid(COMM, way, band(way, h, seed, kind), 0.5)
    cable.update(taut=True, tension=T)
    return way, scene, cable


def forces_twin(cable, shape):
    """Normal and lateral forces node by node, as in words: the force T (t2 - t1) in the plane
    across the cable, split into the part along the normal of edge and cable, and the rest."""
    normal, lateral = np.zeros((2, len(cable.state.nodes)))
    x = cable.state.positions
    for k in range(1, len(x) - 1):
        t1, t2 = (d / np.linalg.norm(d) for d in (x[k] - x[k - 1], x[k + 1] - x[k]))
        a, b = (shape.at(v) for v in cable.state.nodes[k].point.edge)
        edge = (b - x[k]) / np.linalg.norm(b - x[k]) + (x[k] - a) / np.linalg.norm(x[k] - a)
        along = (t1 + t2) / np.linalg.norm(t1 + t2)
        n = np.cross(edge, along) / np.linalg.norm(np.cross(edge, along))
        n *= np.sign(n @ shape.normal(cable.state.nodes[k].point.support))
        normal[k] = -T * (t2 - t1) @ n
        lateral[k] = T * (t2 - t1) @ np.cross(n, along)
    return normal, lateral


def bearing_twin(cable, shape, normal):
    """Smoothed force of each node but the ends, as a difference of sums at the ends of its stretch,
    which begins and ends in the middles between it and the nodes beside it."""
    x = cable.state.positions
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    sizes = []
    for node in cable.state.nodes[1:-1]:
        cells = shape.strip.rows(node.point.support)
        sizes.append(np.mean(np.linalg.norm(shape.normals[cells], axis=1)) ** 0.5)
    middles = (arc[1:] + arc[:-1]) / 2
    width, ends = WIDTH * np.mean(sizes), (middles[0], middles[-1])
    sums = smoothed(arc[1:-1], normal[1:-1], middles, width, ends)
    return np.concatenate([[0.0], np.diff(sums), [0.0]])


def test_forces_are_those_of_a_slow_twin():
    _, scene, cable = on_cylinder(0.15, ratio=0.4)
    shape = scene.net.strip_shape()
    forces = contact_forces(cable, shape)
    normal, lateral = forces_twin(cable, shape)
    np.testing.assert_allclose(forces.normal, normal, atol=1e-13 * T)
    np.testing.assert_allclose(forces.lateral, lateral, atol=1e-13 * T)
    np.testing.assert_allclose(forces.bearing, bearing_twin(cable, shape, normal), atol=1e-12 * T)
    assert np.sum(lateral) > 0.3 * T  # it turns left


def test_geodesic_turn_is_sideways_only_to_its_share():
    """On a sphere the two forces are as the tangent of the latitude: nothing of the turn to the
    side counts as pressure. Ends, half a cell each, and rounding of cells allow 3 % at h = R/20."""
    way = curve(sphere(np.radians(30.0)), np.tan(np.radians(30.0)), 1.0)
    ratios = []
    for seed in range(3):
        scene, cable = rigid(COMM, way, band(way, 0.05, seed), 0.5)
        cable.update(taut=True, tension=T)
        forces = contact_forces(cable, scene.net.strip_shape())
        ratios.append(forces.lateral.sum() / forces.normal.sum() / way.ratio)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.03)
    # the full turn as a pressure would make it sin(30 degrees) instead of tan
    assert abs(np.sin(np.radians(30.0)) / way.ratio - 1) > 4 * 0.03


def test_line_force_on_a_helix():
    """What has been passed up to a place tends to T/R times the way, with order 1: the normals of
    cells are off by up to h/R. The smoothed force per length is off by that over the filter's
    width, whatever h is, however irregularly the fold points come; that of single nodes is useless.
    """
    sizes, errors = (0.2, 0.1, 0.05), []
    for h in sizes:
        off: list[np.ndarray] = []
        roughest = 0.0
        for seed in range(4):
            way, scene, cable = on_cylinder(h, seed)
            forces = contact_forces(cable, scene.net.strip_shape())
            x = cable.state.positions
            arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
            inner = (arc > 0.45) & (arc < way.length - 0.45)
            density = T * np.cos(way.surface.course) ** 2
            assert np.all(np.abs(forces.line[inner] / density - 1) < 0.3)
            raw = forces.normal[inner] / np.diff(stretches(arc), axis=1)[inner, 0] / density
            roughest = max(roughest, float(np.ptp(raw)))
            start = np.flatnonzero(inner)[0]
            passed = np.cumsum(forces.bearing)[inner] - np.cumsum(forces.bearing)[start]
            ends = stretches(arc)[:, 1]
            off.append(passed / density - (ends[inner] - ends[start]))
        assert roughest > 1.0
        errors.append(float(np.sqrt(np.mean(np.concatenate(off) ** 2))))
    assert errors[-1] < 0.5 * sizes[-1]
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 0.8


def hollow(hold):
    """A cable across a rigid sheet with a ridge and a valley, z = sin(x)."""
    x = np.linspace(0.0, 2 * np.pi, 25)
    mesh = meshes.from_arrays(COMM, *grid(x, np.linspace(-0.6, 0.6, 6), lambda x, y: np.sin(x)))
    scene = Scene(mesh, IsotropicMembrane(1e6, 0.3, 1.0, wrinkling=False))
    scene.fix(lambda x: np.full(x.shape[1], True))
    path = np.column_stack([x, np.full(25, 0.05), np.sin(x)])
    cable = scene.lay_cable(Cable(1.0, friction=0.5), path, hold=hold)
    cable.update(taut=True, tension=T)
    return scene, cable


def test_a_sleeve_bears_from_both_sides():
    """Positive on the ridge, negative in the valley; a sleeve holds the cable there too."""
    scene, cable = hollow("sleeve")
    forces = contact_forces(cable, scene.net.strip_shape())
    x = cable.state.positions[:, 0]
    ridge = (x > 0.6) & (x < np.pi - 0.6)
    valley = (x > np.pi + 0.6) & (x < 2 * np.pi - 0.6)
    # every other point lies on a diagonal of a flat rectangle, and does not turn
    assert forces.normal[ridge].min() > -1e-13 * T
    assert forces.normal[valley].max() < 1e-13 * T
    assert np.all(forces.bearing >= 0)
    assert forces.bearing[valley].sum() > T  # it turns by more than a right angle
    assert forces.line[valley].min() > 0
    cable.update(hold="outside")  # on the very same points
    bare = contact_forces(cable, scene.net.strip_shape())
    np.testing.assert_array_equal(bare.normal, forces.normal)
    np.testing.assert_array_equal(bare.bearing[ridge], forces.bearing[ridge])
    assert not np.any(bare.bearing[valley])
    assert np.all(bare.line[valley] < 0)  # so that it shows where a cable should lift off


def test_lifted_cable_bears_where_it_lies():
    scene, cable = hollow("outside")
    assert cable.state.lifted.any()
    forces = contact_forces(cable, scene.net.strip_shape())
    for values in (forces.normal, forces.lateral, forces.bearing):
        assert not np.any(values[cable.state.lifted])
    assert np.all(np.isnan(forces.line[cable.state.lifted]))
    assert len(runs(cable)) == 2
    on = ~cable.state.lifted & (cable.state.positions[:, 0] < 3)
    assert forces.bearing[on].sum() == pytest.approx(
        np.maximum(forces.normal[on].sum(), 0), rel=0.05
    )


def test_nodes_beside_anchors_bear_for_themselves():
    """On the edge of the boundary, where it turns down to its anchor, is a single force."""
    system = friction_square(COMM)
    cable = system.scene.cables[2]
    assert [node.kind for node in cable.state.nodes[:2]] == ["anchor", "edge slider"]
    forces = contact_forces(cable, system.scene.net.strip_shape())
    for k in (1, len(cable.state.nodes) - 2):
        assert forces.bearing[k] == forces.normal[k] > 0
        assert np.isnan(forces.line[k])
    inner = slice(2, -2)
    assert forces.bearing[inner].sum() == pytest.approx(forces.normal[inner].sum(), rel=1e-12)
    # the paper halves the force there: tan(theta/2) against 2 sin(theta/2)
    paper, (before, after) = paper_forces(cable), turns(cable)[1]
    theta = np.arccos(before @ after)
    assert paper[1] == pytest.approx(cable.tension * np.tan(theta / 2), rel=1e-9)


def test_what_presses_at_a_crossing_is_not_the_membranes():
    scene = sheet(COMM, 7, "unstructured")
    solver = advanced(Solver(scene), pressure=0.01)
    for path in ([(0, 40), (100, 60)], [(40, 0), (60, 100)]):
        scene.lay_cable(Cable(32000.0, friction=0.3), path, tension=20.0)
    solver.advance(pressure=0.01)
    shape = scene.net.strip_shape()
    for cable in scene.cables:
        kinds = [node.kind for node in cable.state.nodes]
        assert "crossing" in kinds
        forces = contact_forces(cable, shape)
        k = kinds.index("crossing")
        assert forces.normal[k] == forces.lateral[k] == forces.bearing[k] == 0.0
        assert paper_forces(cable)[k] == 0.0
        assert np.isnan(forces.line[k])
        assert all(k not in run for run in runs(cable))
    lower, upper = (c.state.positions for c in scene.cables)
    assert len(lower) > 3 and len(upper) > 3
