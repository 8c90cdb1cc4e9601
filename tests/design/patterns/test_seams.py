"""Seams: against great circles, helices and parallels; layout by the width of the roll."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from grids import grid
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, PathError, meshes, patterns
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.design.patterns.pattern_surface import PatternSurface
from crms_fenicsx.foundation.surface.points import VertexPoint

R = 10.0
SPHERE, FOOT = 10.25, -2.25
"""Radius of the sphere and height of its centre of a cap 8 high over a circle of radius R."""


def cylinder(comm: MPI.Intracomm, n: int) -> meshes.MembraneMesh:
    """A half cylinder of radius R along y, 8 long, with n cells around it."""
    flat, cells = grid(np.linspace(0.0, np.pi, n + 1), np.linspace(0, 8, 9))
    points = np.column_stack([-R * np.cos(flat[:, 0]), flat[:, 1], R * np.sin(flat[:, 0])])
    ends = {"near": 0, "far": 9 * n}
    edges = {side: [(k + i, k + i + 1) for i in range(8)] for side, k in ends.items()}
    return meshes.from_arrays(comm, points, cells, edges=edges)


def test_geodesic_is_a_great_circle(comm: MPI.Intracomm) -> None:
    """With second order in the cells' size."""
    a, b = np.array([-5.0, -3.0]), np.array([5.0, -3.0])
    angle = np.arccos((a @ b + SPHERE**2 - a @ a) / SPHERE**2)
    errors = []
    for size in (2.0, 1.0):
        cap = meshes.spherical_cap(comm, radius=R, height=8.0, size=size)
        seam = patterns.geodesic(cap, [a, b], name="seam")
        errors.append(abs(seam.length - SPHERE * angle))
    assert errors[1] < 0.35 * errors[0] and errors[1] < 2e-3 * SPHERE * angle


def test_geodesic_through_points_passes_them(comm: MPI.Intracomm) -> None:
    route = [(-8.0, 0.0), (0.0, 2.0), (8.0, 0.0)]
    cap = meshes.spherical_cap(comm, radius=R, height=8.0, size=2.0)
    seam = patterns.geodesic(cap, route, name="seam")
    for x, y in route:
        assert np.hypot(seam.path[:, 0] - x, seam.path[:, 1] - y).min() < 0.3


def test_straight_on_over_a_cylinder_is_a_helix(comm: MPI.Intracomm) -> None:
    """Unrolled it is a straight line, from rim to rim, through a place on the surface."""
    mesh = cylinder(comm, 24)
    flat = 2 * R * np.sin(np.pi / 48)  # of each facet
    start = np.array([0.0, 4.0, R])
    seam = patterns.geodesic_along(mesh, start, (0.3, 1.0, 0.0), name="helix")
    unrolled = np.concatenate(
        [[0.0], np.cumsum(np.hypot(*np.diff(seam.path[:, [0, 2]], axis=0).T))]
    )
    y = seam.path[:, 1]
    slope = 0.3 * np.cos(np.pi / 48)  # projected on the facet beside the ridge
    np.testing.assert_allclose(unrolled, slope * (y - y[0]), atol=1e-5 * flat)
    np.testing.assert_allclose([y[0], y[-1]], [0.0, 8.0], atol=1e-9)


def test_plane_section_lies_in_its_plane(comm: MPI.Intracomm) -> None:
    cap = meshes.spherical_cap(comm, radius=R, height=8.0, size=2.0)
    origin, normal = np.array([1.0, 0.0, 5.0]), np.array([1.0, 0.2, 0.1])
    seam = patterns.plane_section(cap, origin, normal, name="plane")
    away = (seam.path - origin) @ normal
    assert np.abs(away).max() < 2e-3 and not seam.closed
    ring = patterns.plane_section(cap, (0.0, 0.0, 5.0), (0.0, 0.0, 1.0), name="ring")
    assert ring.closed
    around = 2 * np.pi * np.sqrt(SPHERE**2 - (5.0 - FOOT) ** 2)
    np.testing.assert_allclose(ring.length, around, rtol=1e-2)


def test_edge_line_is_the_group(comm: MPI.Intracomm) -> None:
    mesh = meshes.rectangle(comm, 10.0, 6.0, 1.0)
    front = patterns.edge_line(mesh, "front")
    assert front.name == "front" and front.length == pytest.approx(10.0)
    assert all(isinstance(point, VertexPoint) for point in front.points)
    assert patterns.edge_line(mesh, "boundary", name="rim").closed


def test_parallel_lies_at_its_distance(comm: MPI.Intracomm) -> None:
    """Exactly on developable surfaces, whose fronts are straight."""
    mesh = cylinder(comm, 24)
    chord = 2 * R * np.sin(np.pi / 48)
    seam = patterns.parallel(mesh, "near", 5.5 * chord, toward=(0.0, 4.0, R), name="parallel")
    middle = [[-R * np.cos(k * np.pi / 24), R * np.sin(k * np.pi / 24)] for k in (5, 6)]
    np.testing.assert_allclose(seam.path[:, [0, 2]] - np.mean(middle, axis=0), 0.0, atol=1e-9)


def test_distances_over_a_sphere_converge(comm: MPI.Intracomm) -> None:
    """From a parallel of latitude, with first order but for where the fronts meet at the top."""
    errors = []
    for size in (2.0, 1.0, 0.5):
        cap = meshes.spherical_cap(comm, radius=R, height=8.0, size=size)
        surface = PatternSurface.of(cap)
        away = surface.distances(surface.line_of_group("test", "boundary"))
        rim, latitude = np.arcsin(-FOOT / SPHERE), np.arcsin((surface.points[:, 2] - FOOT) / SPHERE)
        exact = SPHERE * (latitude - rim)
        errors.append(np.abs(away - exact)[exact < 8.0].max())
    assert np.log2(errors[0] / errors[2]) / 2 > 0.85
    assert errors[2] < 0.042


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["geodesic", "parallel"])
def test_strips_are_as_wide_as_the_roll_allows(comm: MPI.Intracomm, kind: str) -> None:
    """On a flat roof 6 m deep 1.22 m usable makes 5 strips of 1.2 m; seams on a dome bulge."""
    mesh = meshes.rectangle(comm, 10.0, 6.0, 1.0)
    seams = patterns.strips(mesh, "front", "back", 1.3, allowance=0.04, kind=kind)  # type: ignore[arg-type]
    assert [seam.name for seam in seams] == ["seam 1", "seam 2", "seam 3", "seam 4"]
    for k, seam in enumerate(seams, 1):
        np.testing.assert_allclose(seam.path[:, 1], 1.2 * k, atol=2e-3)
    assert patterns.strips(mesh, "front", "back", 7.0) == []


@pytest.mark.ranks
def test_strips_between_edges_that_curve_are_alike(comm: MPI.Intracomm) -> None:
    """Those along the edges of a sail, which curve inward, are cut as wide as those between them,
    and none is wider than the roll."""
    sides = ("front", "right", "back", "left")
    found = find_form(
        meshes.rectangle(comm, 10.0, 10.0, size=1.0),
        stress=2.0,
        fixed=["front left", "front right", "back right", "back left"],
        lifted={"front left": (0.0, 0.0, 2.0), "back right": (0.0, 0.0, 2.0)},
        cables=[FormCable(side, tension=25.0) for side in sides],
    )
    pieces = patterns.cut(found.mesh, patterns.strips(found.mesh, "front", "back", width=1.74))
    fabric = IsotropicMembrane(E=900.0, nu=0.3, thickness=1.0)
    widths = [one.width for one in patterns.flatten(pieces, fabric, warp="seams").flat]
    assert len(widths) == 7
    assert 0.9 * max(widths) < min(widths) and max(widths) <= 1.74


@pytest.mark.ranks
def test_strips_fan_out_from_a_corner(comm: MPI.Intracomm) -> None:
    """On a flat roof: seams are rays from the corner; wedges, turned so that their middles lie
    along the roll, fit it, are alike in width, and few: all of them sweep the arc length at the
    opposite rim, across the rays."""
    mesh = meshes.rectangle(comm, 6.0, 4.0, 0.5)
    seams = patterns.strips(mesh, "front", "left", 1.5, allowance=0.05)
    swept = 6.0 * np.arcsinh(4.0 / 6.0) + 4.0 * np.arcsinh(6.0 / 4.0)
    assert len(seams) + 1 == np.ceil(swept / 1.4)
    rim, widths = [np.array([6.0, 0.0])], []
    for seam in seams:
        path = seam.path[:, :2] if np.allclose(seam.path[0], 0.0) else seam.path[::-1, :2]
        assert np.allclose(path[0], 0.0) and (np.isclose(path[-1], (6.0, 4.0))).any()
        ray = path[-1] / np.linalg.norm(path[-1])
        np.testing.assert_allclose(np.abs(path @ [-ray[1], ray[0]]), 0.0, atol=1e-9)
        rim.append(path[-1])
    rim.append(np.array([0.0, 4.0]))
    for a, b in pairwise(rim):
        outline = [np.zeros(2), a, b]
        if a[0] > 6.0 - 1e-9 and b[1] > 4.0 - 1e-9:
            outline.append(np.array([6.0, 4.0]))
        middle = a / np.linalg.norm(a) + b / np.linalg.norm(b)
        middle /= np.linalg.norm(middle)
        widths.append(np.ptp(np.array(outline) @ [-middle[1], middle[0]]))
    assert max(widths) <= 1.4 + 1e-9 and min(widths) > 0.6 * max(widths)
    pieces = patterns.cut(mesh, seams).pieces
    assert (
        sum(piece.area for piece in pieces) == pytest.approx(24.0) and len(pieces) == len(seams) + 1
    )


def test_seams_of_a_hall_are_few_and_narrow_enough(comm: MPI.Intracomm) -> None:
    """One strip less would be too wide."""
    form = cylinder(comm, 24)
    length = 24 * 2 * R * np.sin(np.pi / 48)
    seams = patterns.strips(form, "near", "far", length / 7.5)
    assert len(seams) == 7


@pytest.mark.ranks
@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_seams_follow_the_warp(comm: MPI.Intracomm, slope: float) -> None:
    """Over a half cylinder they are rulings, or helices where the warp winds around it."""
    mesh, chord = cylinder(comm, 24), 2 * R * np.sin(np.pi / 48)

    def winding(x: np.ndarray) -> np.ndarray:
        return np.array([slope * x[2] / R, 1.0 + 0.0 * x[0], -slope * x[0] / R])

    seams = patterns.strips(mesh, "near", "far", 5.0, warp=winding if slope else (0.0, 1.0, 0.0))
    assert len(seams) == 6
    for k, seam in enumerate(seams, 1):
        steps = np.diff(seam.path, axis=0)
        around = np.cumsum(np.hypot(steps[:, 0], steps[:, 2]))
        y = seam.path[:, 1]
        np.testing.assert_allclose([y.min(), y.max()], [0.0, 8.0], atol=1e-9)
        np.testing.assert_allclose(around, slope * np.abs(y[1:] - y[0]), rtol=0.01, atol=1e-4)
        middle = seam.path[np.abs(y - 4.0).argmin(), [0, 2]]
        angle = np.arctan2(middle[1], -middle[0])
        assert angle == pytest.approx(k * np.pi / (len(seams) + 1), abs=0.2 * chord / R)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda m: patterns.strips(m, "front", "back", 0.08, allowance=0.04), InputError, "twice"),
        (lambda m: patterns.strips(m, "front", "front", 1.0), PathError, "meet at .* of both"),
        (lambda m: patterns.strips(m, "front", "back", 1.0, warp=(0.0, 1.0, 0.0)),
         PathError, "beside the warp"),
        (lambda m: patterns.strips(m, "front", "back", 1.0, warp=(0.0, 0.0, 0.0)),
         InputError, "must be a nonzero direction"),
        (lambda m: patterns.strips(m, "front", "back", 1.0, warp=lambda x: x[:2]),
         InputError, "strips: warp"),
        (lambda m: patterns.strips(m, "front", "back", 1.0, warp=(0.0, 0.0, 1.0)),
         PathError, "normal"),
        (lambda m: patterns.strips(m, "front", "nowhere", 1.0), InputError, "nowhere"),
        (lambda m: patterns.geodesic(m, [(0.0, 0.0, 3.0), (5.0, 5.0, 0.0)], name="s"),
         PathError, "does not lie on"),
        (lambda m: patterns.geodesic_along(m, (5.0, 3.0, 0.0), (0.0, 0.0, 1.0), name="s"),
         PathError, "normal"),
        (lambda m: patterns.plane_section(m, (20.0, 0.0, 0.0), (1.0, 0.0, 0.0), name="s"),
         PathError, "does not cut"),
        (lambda m: patterns.parallel(m, "front", 7.0, toward=(0.0, 0.0, 0.0), name="s"),
         PathError, "ends 6 from"),
        (lambda m: patterns.geodesic(m, [(0.0, 1.0), (10.0, 1.0)], name=" "), PathError, "name"),
        (lambda m: patterns.geodesic(3, [(0.0, 1.0), (10.0, 1.0)], name="s"), InputError, "int"),
    ],
)  # fmt: skip
@pytest.mark.ranks
def test_what_is_no_seam_is_named(call, error, text, comm: MPI.Intracomm) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(error, match=text):
        call(meshes.rectangle(comm, 10.0, 6.0, 1.0))
