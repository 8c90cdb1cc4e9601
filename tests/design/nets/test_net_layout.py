"""Nets laid out on a plane, a cylinder, a sphere and a found dome, against exact nets there."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from cabled_square import clamped
from curved_surfaces import unstructured
from dome import dome
from mpi4py import MPI
from scipy.integrate import solve_ivp

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    NetWarning,
    PathError,
    Scene,
    Solver,
    meshes,
    nets,
)
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.design.nets.equidistant import Chart
from crms_fenicsx.design.nets.whole_surface import WholeSurface

FABRIC = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)
R = 10.0


def scene_of(mesh: meshes.MembraneMesh) -> Scene:
    return clamped(mesh, FABRIC)


def sheet(comm: MPI.Intracomm, size: float = 0.9) -> Scene:
    """A flat sheet of 20 x 10 m."""
    return scene_of(meshes.rectangle(comm, 20.0, 10.0, size))


def sphere(comm: MPI.Intracomm, size: float) -> Scene:
    """Four fifths of a sphere of radius 10, its top at the origin's plan."""
    height = 16.0
    radius = (2 * R * height - height**2) ** 0.5
    return scene_of(meshes.spherical_cap(comm, radius, height, size))


def angles(nodes: np.ndarray, i: int, j: int) -> float:
    """Angle (rad) at a node between its lines, by central differences."""
    a = nodes[i + 1, j] - nodes[i - 1, j]
    b = nodes[i, j + 1] - nodes[i, j - 1]
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def widths(nodes: np.ndarray) -> np.ndarray:
    """Sides of all meshes."""
    both = [np.linalg.norm(np.diff(nodes, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    found = np.concatenate(both)
    return found[np.isfinite(found)]


@pytest.mark.ranks
def test_equidistant_net_on_a_plane_is_of_squares(comm) -> None:
    """Also where the first lines end before the sheet does; it covers all of it."""
    origin, turn = np.array([10.1, 5.2]), 0.6
    u, v = (np.array([np.cos(t), np.sin(t), 0.0]) for t in (turn, turn + np.pi / 2))
    net = nets.equidistant(sheet(comm), 0.7, origin, [u[:2], v[:2]])
    nodes = net.nodes
    k = tuple(np.argwhere(np.linalg.norm(nodes - np.append(origin, 0.0), axis=2) < 1e-9)[0])
    i, j = (np.arange(n) - at for n, at in zip(nodes.shape[:2], k, strict=True))
    exact = np.append(origin, 0.0) + 0.7 * (i[:, None, None] * u + j[None, :, None] * v)
    there = np.isfinite(nodes[..., 0])
    np.testing.assert_allclose(nodes[there], exact[there], atol=1e-11)
    inside = np.all((exact[..., :2] > 0.0) & (exact[..., :2] < (20.0, 10.0)), axis=2)
    assert np.array_equal(inside, there)
    for line in net.lines:  # from rim to rim
        x, y = line.path[[0, -1], :2].T
        assert np.abs(np.minimum(np.minimum(x, 20.0 - x), np.minimum(y, 10.0 - y))).max() < 1e-9
    assert {line.name for line in net.lines} >= {"A1", "A2", "B1", "B26"}
    at = {one.lines: one for one in net.crossings}
    assert all(np.isfinite(one.place).all() for one in at.values())
    lines = {line.name: line for line in net.lines}
    for (first, second), one in at.items():
        for name, s in zip((first, second), one.at, strict=True):
            start, end = lines[name].path[[0, -1]]
            along = start + s / lines[name].length * (end - start)
            np.testing.assert_allclose(one.place, along, atol=1e-3)  # near vertices: on them


def test_equidistant_net_on_a_cylinder_is_the_rolled_one(comm) -> None:
    """Whatever its directions; but for a chord's being shorter than its arc."""
    worst = []
    for n in (20, 40):
        cells, points = unstructured(n, np.random.default_rng(1), 100.0)
        arc, along = 0.25 * (points[:, 0] - 50.0), 0.2 * (points[:, 1] - 50.0)
        x = np.column_stack([R * np.sin(arc / R), along, R * np.cos(arc / R)])
        scene = scene_of(meshes.from_arrays(comm, x, cells))
        net = nets.equidistant(scene, 1.0, (0.0, 0.0), [(1.0, 0.5), (-0.5, 1.0)])
        nodes = net.nodes
        flat = np.stack([R * np.arctan2(nodes[..., 0], nodes[..., 2]), nodes[..., 1]], axis=-1)
        far = np.linalg.norm(np.nan_to_num(flat, nan=99.0), axis=-1)
        k = np.unravel_index(np.argmin(far), far.shape)
        i, j = (np.arange(m) - at for m, at in zip(far.shape, k, strict=True))
        u, v = np.array([2.0, 1.0]) / 5**0.5, np.array([-1.0, 2.0]) / 5**0.5
        exact = i[:, None, None] * u + j[None, :, None] * v
        away = np.linalg.norm(flat - exact, axis=-1)
        worst.append(np.nanmax(away))
        assert np.count_nonzero(np.isfinite(away)) > 400
    assert worst[1] < 0.6 * worst[0] and worst[1] < 0.015


@pytest.fixture(scope="module")
def nodes_on_sphere(comm) -> Callable[[float], np.ndarray]:
    """Nodes of the net from the top for widths, without its many lines."""
    surface = WholeSurface.of("test", sphere(comm, 0.25))
    place, ways = surface.place(np.zeros(2)), np.array([[1.0, 0, 0], [0, 1, 0]])
    u, v = (surface.tangent(place, way) for way in ways)

    @cache
    def nodes(width: float) -> np.ndarray:
        chart = Chart(surface, width, 30.0)
        chart.grow(place, (u, -u, v, -v))
        assert chart.folds
        return chart.table()

    return nodes


def test_equidistant_net_on_a_sphere(nodes_on_sphere) -> None:
    """The angle w between lines that start as orthogonal great circles: z = u v / R^2,
    z w'' + w' = -sin w; 30 degrees at u = v = 10.577. Order 2 in the width."""
    exact = solve_ivp(
        lambda z, y: [y[1], (-np.sin(y[0]) - y[1]) / z], (1e-6, 2.0), [np.pi / 2 - 1e-6, -1.0],
        rtol=1e-11, atol=1e-12, dense_output=True, events=lambda z, y: y[0] - np.pi / 6,
    )  # fmt: skip
    reach = R * exact.t_events[0][0] ** 0.5
    assert reach == pytest.approx(10.577, abs=5e-4)
    errors = []
    for width in (2.0, 1.0, 0.5):
        nodes = nodes_on_sphere(width)
        assert np.abs(widths(nodes) - width).max() < 1e-8
        middle, at = nodes.shape[0] // 2, round(8.0 / width)
        found = [
            w if p * q > 0 else np.pi - w
            for p in (1, -1)
            for q in (1, -1)
            for w in [angles(nodes, middle + p * at, middle + q * at)]
        ]
        errors.append(abs(np.degrees(np.mean(found) - exact.sol(0.64)[0])))
    assert errors[0] < 0.8 and errors[2] < 0.06
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(2.0, abs=0.4)
    last = max(k for k in range(middle) if np.isfinite(nodes[middle + k, middle + k, 0]))
    assert abs(last * 0.5 - reach) < 0.5  # where it ends


def test_hazzidakis_formula(nodes_on_sphere) -> None:
    """A block of a net on a sphere has the area R^2 (2 pi - sum of its four inner angles)."""
    nodes = nodes_on_sphere(0.5)
    k, a, b = nodes.shape[0] // 2, 4, 16
    block = nodes[k + a : k + b + 1, k + a : k + b + 1] - [0.0, 0.0, 6.0]  # from its centre

    def area(p, q, r):
        unit = [x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (p, q, r)]
        volume = np.sum(unit[0] * np.cross(unit[1], unit[2]), axis=-1)
        return 2 * np.arctan2(
            np.abs(volume), 1 + sum(np.sum(unit[i] * unit[i - 1], axis=-1) for i in range(3))
        )

    p, q, r, s = block[:-1, :-1], block[1:, :-1], block[1:, 1:], block[:-1, 1:]
    covered = float((area(p, q, r) + area(p, r, s)).sum())
    at = {(i, j): angles(nodes, k + i, k + j) for i in (a, b) for j in (a, b)}
    inner = at[a, a] + at[b, b] + 2 * np.pi - at[a, b] - at[b, a]
    assert 2 * np.pi - inner == pytest.approx(covered, abs=1e-3)
    assert covered == pytest.approx(0.347, abs=2e-3)


def test_net_ends_where_it_would_fold(comm) -> None:
    with pytest.warns(NetWarning, match="angles below 40 degrees"):
        net = nets.equidistant(sphere(comm, 1.0), 2.0, (0.0, 0.0), least_angle=40.0)
    nodes = net.nodes
    k = nodes.shape[0] // 2
    last = max(i for i in range(k) if np.isfinite(nodes[k + i, k + i, 0]))
    assert 2.0 * last == 10.0  # the angle is 40 degrees at 9.7, between 8 and 10
    rims = np.array([line.path[[0, -1], 2] for line in net.lines])
    assert np.abs(rims).max() < 1e-9


@pytest.mark.ranks
def test_meshes_on_a_found_dome_have_the_width(comm) -> None:
    """A form is found over a square, and its net covers it; cables on it are just taut."""
    plan = meshes.rectangle(comm, 12.0, 12.0, 1.2, corner=(-6.0, -6.0))
    form = find_form(plan, stress=2.0, fixed=["boundary"], pressure=0.4)
    scene = form.scene(FABRIC)
    net = nets.equidistant(scene, 1.5, (0.0, 0.0), [(1, 1), (-1, 1)])
    assert np.abs(widths(net.nodes) - 1.5).max() < 1e-8 and len(widths(net.nodes)) > 80
    cables = scene.lay_net(net, Cable(EA=1e3), tension=2.0)
    assert [cable.name for cable in cables] == [line.name for line in net.lines]
    on = [
        (c.L0, line.length)
        for c, line in zip(cables, net.lines, strict=True)
        if not c.state.lifted.any()
    ]
    for L0, length in on:  # others span hollows; one may just touch at the ends of a shallow one
        assert L0 == pytest.approx(length / (1 + 2.0 / 1e3), rel=1e-5)
    assert len(on) > 4
    numbers = comm.allgather([float(line.length) for line in net.lines])
    assert all(one == numbers[0] for one in numbers)


@pytest.mark.ranks
def test_geodesic_nets_on_a_sphere_are_of_great_circles(comm) -> None:
    """Lines square to a great circle, and lines between given edges."""
    scene = scene_of(dome(comm, 2.0))
    net = nets.geodesics_across(scene, [[(-19.0, 0.0), (19.0, 0.0)]], spacing=8.0)
    assert [line.name for line in net.lines] == ["A1", "A2", "A3", "A4", "A5"]
    centre = np.array([0.0, 0.0, -15.0])
    for line, s in zip(net.lines, 8.0 * np.arange(-2, 3) / 25.0, strict=True):
        pole = np.array([np.cos(s), 0.0, -np.sin(s)])  # normal of its plane
        assert np.abs((line.path - centre) @ pole).max() < 0.15
    assert net.lines[2].length == pytest.approx(50.0 * np.arctan2(20.0, 15.0), rel=1e-4)


@pytest.mark.ranks
def test_nets_between_edges_and_straight_in_plan(comm) -> None:
    """On a flat sheet both are straight lines in places that can be told."""
    scene = sheet(comm)
    net = nets.geodesics_between(scene, [("left", "right"), ("front", "back")], n=(3, 4))
    assert [line.name for line in net.lines] == ["A1", "A2", "A3", "B1", "B2", "B3", "B4"]
    at = sorted(tuple(np.round(one.place[:2], 9)) for one in net.crossings)
    assert at == [(x, y) for x in (4.0, 8.0, 12.0, 16.0) for y in (2.5, 5.0, 7.5)]
    crossed = nets.sections(scene, (np.pi / 4, -np.pi / 4), [-1.0, 2.0], center=(10.0, 5.0))
    assert len(crossed.crossings) == 4 and crossed.lines[0].length == pytest.approx(200**0.5)
    laid = nets.from_paths(scene, [[line.path for line in crossed.lines[:2]]], shortest=True)
    for line, other in zip(laid.lines, crossed.lines, strict=False):
        np.testing.assert_allclose(line.path[[0, -1]], other.path[[0, -1]], atol=1e-9)


def test_a_net_that_cannot_be_laid_leaves_nothing(comm) -> None:
    scene = sheet(comm)
    net = nets.sections(scene, (0.0, 1.0), [-1.0, 2.0], center=(10.0, 5.0))
    scene.lay_cable(Cable(EA=1e3), [(0.0, 2.0), (20.0, 3.0)], name="B2")
    with pytest.raises(InputError, match="there is a cable 'B2' already"):
        scene.lay_net(net, Cable(EA=1e3))
    assert [cable.name for cable in scene.cables] == ["B2"]
    scene.remove("B2")
    scene.lay_net(net, Cable(EA=1e3), tension=1.0)
    Solver(scene).advance(pressure=0.1)
    assert [cable.name for cable in scene.cables] == ["A1", "A2", "B1", "B2"]
    assert len(scene.net.crossings) == len(net.crossings) == 4


@pytest.mark.ranks
def test_bad_layouts_are_refused(comm) -> None:
    scene = sheet(comm)
    bad = [
        (lambda: nets.equidistant(scene, 30.0, (10.0, 5.0)), "no mesh of width = 30 has room"),
        (lambda: nets.equidistant(scene, 1.0, (40.0, 5.0)), "leaves the membrane"),
        (lambda: nets.equidistant(scene, 1.0, (10.0, 5.0, 9.0)), "9 from the membrane"),
        (lambda: nets.equidistant(scene, 1.0, (10, 5), [(1, 0), (1, 0.1)]), "cross at a larger"),
        (lambda: nets.equidistant(scene, 1.0, (10, 5), [(1, 0), (0, 0, 1)]), "is normal to"),
        (lambda: nets.equidistant(scene, 1.0, (10, 5), least_angle=95.0), "least_angle = 95"),
        (lambda: nets.geodesics_across(scene, [[(0, 5), (20, 5)]], 25.0), "spacing = 25"),
        (lambda: nets.geodesics_between(scene, [("left", "top")], 3), "no group of edges 'top'"),
        (lambda: nets.geodesics_between(scene, [("left", "boundary")], 3), "is closed"),
        (lambda: nets.geodesics_between(scene, ["left", "right"], 3), "expected pairs of groups"),
        (lambda: nets.geodesics_between(scene, [("left", "right")], 0), "n = 0"),
        (lambda: nets.geodesics_between(scene, [("left", "right")], (1, 2)), "for 1 families"),
        (lambda: nets.sections(scene, [0.0], [50.0]), "does not cross the membrane's rim twice"),
        (lambda: nets.from_paths(scene, [[[(0, 0)]]]), "two or more points"),
        (lambda: nets.from_paths(scene, [[[(1, 1), (30, 1)]]]), "line A1: .* leaves the membrane"),
    ]
    for call, message in bad:
        with pytest.raises(InputError, match=message):
            call()
    assert not scene.cables


def test_a_net_on_a_wall_needs_directions_in_space(comm) -> None:
    """And on a tube a first line ends where it comes back to itself."""
    k = np.arange(24)
    ring = np.column_stack([np.cos(k * np.pi / 12), np.sin(k * np.pi / 12)])
    x = np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in np.linspace(0, 4, 9)])
    first = (24 * np.arange(8)[:, None] + k).ravel()
    after = (24 * np.arange(8)[:, None] + (k + 1) % 24).ravel()
    cells = np.concatenate([
        np.stack([first, after, after + 24], axis=1),
        np.stack([first, after + 24, first + 24], axis=1),
    ])  # fmt: skip
    scene = scene_of(meshes.from_arrays(comm, x, cells, outside=meshes.AwayFrom((0.0, 0.0, 2.0))))
    start = (1.0, 0.0, 2.0)
    with pytest.raises(PathError, match="the membrane is vertical"):
        nets.equidistant(scene, 0.4, start)
    with warnings.catch_warnings():
        warnings.simplefilter("error", NetWarning)
        net = nets.equidistant(scene, 0.4, start, [(0, 1, 0), (0, 0, 1)])
    assert np.abs(widths(net.nodes) - 0.4).max() < 1e-8


def test_equidistant_nets_slide(comm) -> None:
    """Their lines, which turn within the surface, straighten and hang loose."""
    scene = scene_of(meshes.spherical_cap(comm, 8.0, 6.0, 1.2))
    net = nets.equidistant(scene, 2.0, (0.1, 0.05))
    scene.lay_net(net, Cable(EA=1e3), tension=1.0, hold="sleeve")
    Solver(scene).advance(pressure=0.6)
    loose = [cable.name for cable in scene.cables if not cable.taut]
    assert len(loose) == len(net.lines) - 2  # all but the two geodesics
