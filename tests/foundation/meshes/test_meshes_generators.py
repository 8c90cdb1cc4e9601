"""Generated membranes: exact shapes, names, quality, refinement, refused arguments."""

from itertools import pairwise

import numpy as np
import pytest
from mesh_measures import (
    area,
    cell_corners,
    edge_ends,
    input_cells,
    is_consistently_oriented,
    least_angle,
    length,
    point_places,
    total_area_vector,
)
from scipy.integrate import dblquad
from scipy.special import ellipe

from crms_fenicsx import InputError, MeshError, meshes, nets
from crms_fenicsx.foundation.meshes import Refinement
from crms_fenicsx.foundation.meshes.refinement import TargetSize


def order_of(errors, factor=2.0):
    """Mean order of convergence of errors at sizes that shrink by a factor."""
    return np.log(errors[0] / errors[-1]) / np.log(factor) / (len(errors) - 1)


def side_lengths(membrane):
    x = cell_corners(membrane)
    own = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    return np.concatenate(membrane.comm.allgather(own.ravel()))


# --- plane shapes ----------------------------------------------------------------------------


@pytest.mark.ranks
@pytest.mark.parametrize("structured", [False, True])
def test_rectangle(comm, structured):
    membrane = meshes.rectangle(comm, 3.0, 2.0, 0.3, corner=(-1.0, 5.0), structured=structured)
    assert area(membrane) == pytest.approx(6.0, rel=1e-12)
    assert total_area_vector(membrane)[2] > 0
    places = {"left": (0, -1.0), "right": (0, 2.0), "front": (1, 5.0), "back": (1, 7.0)}
    for name, (axis, value) in places.items():
        assert (edge_ends(membrane, name)[..., axis] == value).all()
        assert length(membrane, name) == pytest.approx(3.0 if axis else 2.0, rel=1e-12)
    assert length(membrane, "boundary") == pytest.approx(10.0, rel=1e-12)
    assert point_places(membrane, "back left").tolist() == [[-1.0, 7.0, 0.0]]
    assert point_places(membrane, "front right").tolist() == [[2.0, 5.0, 0.0]]
    assert least_angle(membrane) > 35.0
    assert 0.5 * 0.3 < side_lengths(membrane).min()
    assert side_lengths(membrane).max() < 1.5 * 0.3


def test_structured_rectangle_has_right_diagonals(comm):
    membrane = meshes.rectangle(comm, 4.0, 3.0, 1.0, structured=True)
    assert len(input_cells(membrane)) == 24
    for corners in cell_corners(membrane):
        sides = (np.roll(corners, -1, axis=0) - corners)[:, :2].tolist()
        slanted = [side for side in sides if 0.0 not in side]
        assert len(slanted) == 1
        assert slanted[0] in ([1.0, 1.0], [-1.0, -1.0])


def test_circle_and_ellipse_converge(comm):
    circle, ellipse, rim = [], [], []
    a, b = 2.0, 0.8
    for size in (0.2, 0.1, 0.05):
        circle.append(np.pi - area(meshes.circle(comm, 1.0, size, center=(3.0, 4.0))))
        membrane = meshes.ellipse(comm, a, b, size)
        ellipse.append(np.pi * a * b - area(membrane))
        rim.append(4.0 * a * ellipe(1.0 - (b / a) ** 2) - length(membrane, "boundary"))
        ends = edge_ends(membrane, "boundary").reshape(-1, 3)
        assert (ends[:, 0] / a) ** 2 + (ends[:, 1] / b) ** 2 == pytest.approx(1.0, abs=1e-9)
    for errors in (circle, ellipse, rim):
        assert 0 < errors[-1] < 0.01
        assert order_of(errors) == pytest.approx(2.0, abs=0.2)
    tall = meshes.ellipse(comm, b, a, 0.1)
    assert area(tall) == pytest.approx(np.pi * a * b, rel=5e-3)
    assert np.abs(edge_ends(tall, "boundary")[..., 1]).max() == pytest.approx(a)


ARROW = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 0.5)]


@pytest.mark.ranks
@pytest.mark.parametrize("corners", [ARROW, ARROW[::-1]])
def test_polygon(comm, corners):
    membrane = meshes.polygon(comm, corners, 0.2)
    assert area(membrane) == pytest.approx(1.5, rel=1e-12)
    assert total_area_vector(membrane)[2] == pytest.approx(1.5, rel=1e-12)
    for k in range(4):
        expected = np.linalg.norm(np.subtract(corners[k], corners[(k + 1) % 4]))
        assert length(membrane, f"side {k + 1}") == pytest.approx(expected, rel=1e-12)
        assert point_places(membrane, f"corner {k + 1}").tolist() == [[*corners[k], 0.0]]


def test_polygon_may_have_sides_in_one_line(comm):
    horseshoe = [(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)]
    assert area(meshes.polygon(comm, horseshoe, 0.5)) == pytest.approx(5.0, rel=1e-12)
    with_flat_corner = [(0, 0), (1, 0), (2, 0), (2, 1), (0, 1)]
    assert area(meshes.polygon(comm, with_flat_corner, 0.5)) == pytest.approx(2.0, rel=1e-12)


def test_polygon_with_names_of_its_sides(comm):
    membrane = meshes.polygon(comm, ARROW, 0.3, names=["fixed", "free", "fixed", "low"])
    assert set(membrane.edges) == {"boundary", "fixed", "free", "low"}
    assert length(membrane, "fixed") == pytest.approx(2.0 + np.hypot(1.0, 1.5))


# --- curved shapes ---------------------------------------------------------------------------


@pytest.mark.ranks
@pytest.mark.parametrize("height", [0.2, 1.0, 1.6])
def test_spherical_cap(comm, height):
    errors = []
    for size in (0.2, 0.1):
        membrane = meshes.spherical_cap(comm, 1.0, height, size, center=(1.0, -2.0))
        errors.append(np.pi * (1.0 + height**2) - area(membrane))
        sphere = (1.0 + height**2) / (2.0 * height)
        offset = cell_corners(membrane) - (1.0, -2.0, height - sphere)
        assert np.linalg.norm(offset, axis=2) == pytest.approx(sphere, rel=1e-12)
        rim = edge_ends(membrane, "boundary")
        assert (rim[..., 2] == 0.0).all()
        assert np.hypot(rim[..., 0] - 1.0, rim[..., 1] + 2.0) == pytest.approx(1.0, rel=1e-12)
        assert least_angle(membrane) > 30.0
        assert 0.4 * size < side_lengths(membrane).min()
        assert side_lengths(membrane).max() < 1.6 * size
        assert is_consistently_oriented(input_cells(membrane))
        # the rim's polygon bounds the plan, whatever is above it
        step = 2.0 * np.pi / len(rim)
        assert total_area_vector(membrane)[2] == pytest.approx(0.5 * len(rim) * np.sin(step))
    assert 0 < errors[-1] < 0.02 * np.pi
    assert order_of(errors) == pytest.approx(2.0, abs=0.3)


def hall_rise(distance, end):
    return np.sqrt(1.0 - (1.0 - np.minimum(distance, end) / end) ** 2)


HALLS = [(40.0, 60.0, 12.0), (60.0, 40.0, 25.0), (30.0, 30.0, 15.0)]


@pytest.mark.ranks
@pytest.mark.parametrize(("width", "depth", "height"), HALLS)
def test_air_hall_has_the_documented_shape(comm, width, depth, height):
    size, corner = 2.5, np.array([-5.0, 7.0])
    membrane = meshes.air_hall(comm, width, depth, height, size, corner=corner)
    points = cell_corners(membrane).reshape(-1, 3)
    plan = points[:, :2] - corner
    gap = np.minimum(plan, np.array([width, depth]) - plan).clip(min=0.0)
    end = min(width, depth) / 2
    # squared, as the slope is infinite on the ground
    expected = (height * hall_rise(gap[:, 0], end) * hall_rise(gap[:, 1], end)) ** 2
    assert points[:, 2] ** 2 == pytest.approx(expected, abs=1e-6 * height**2)
    assert membrane.comm.allreduce(points[:, 2].max(initial=0.0), op=max) > 0.99 * height

    places = {
        "left": (0, corner[0]),
        "right": (0, corner[0] + width),
        "front": (1, corner[1]),
        "back": (1, corner[1] + depth),
    }
    for name, (axis, value) in places.items():
        ends = edge_ends(membrane, name)
        assert (ends[..., axis] == value).all()
        assert (ends[..., 2] == 0.0).all()
        assert length(membrane, name) == pytest.approx(width if axis else depth, rel=1e-12)
    assert len(edge_ends(membrane, "boundary")) == sum(len(edge_ends(membrane, k)) for k in places)
    assert point_places(membrane, "front left").tolist() == [[*corner.tolist(), 0.0]]
    assert total_area_vector(membrane) == pytest.approx((0.0, 0.0, width * depth), abs=1e-8)
    assert least_angle(membrane) > 28.0
    assert side_lengths(membrane).max() < 1.8 * size


def test_air_hall_area_converges(comm):
    """Against the area integral of the square hall in angles, x = sin(s), y = sin(t)."""
    height = 0.7

    def density(s, t):
        u = (np.cos(s), 0.0, -height * np.sin(s) * np.cos(t))
        v = (0.0, np.cos(t), -height * np.cos(s) * np.sin(t))
        return np.linalg.norm(np.cross(u, v))

    exact = 4.0 * dblquad(density, 0.0, np.pi / 2, 0.0, np.pi / 2, epsabs=1e-5)[0]
    errors = [exact - area(meshes.air_hall(comm, 2.0, 2.0, height, h)) for h in (0.2, 0.1)]
    assert 0 < errors[-1] < 0.005 * exact
    assert order_of(errors) == pytest.approx(2.0, abs=0.5)


# --- refinement ------------------------------------------------------------------------------


def test_target_size_against_a_plain_loop():
    line = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (1.0, 2.0, 0.5)]
    flat = [(0.0, 1.0), (2.0, 1.0)]
    target = TargetSize(1.0, [Refinement(line, 0.1, 2.0), Refinement(flat, 0.3, 0.5)])

    def gap(point, a, b):
        share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return np.linalg.norm(point - a - share * (b - a))

    for point in np.random.default_rng(2).uniform(-1.0, 3.0, (50, 3)):
        near = min(gap(point, np.array(a), np.array(b)) for a, b in pairwise(line))
        below = gap(point[:2], np.array(flat[0]), np.array(flat[1]))
        expected = min(1.0, 0.1 + 0.9 * near / 2.0, 0.3 + 0.7 * below / 0.5)
        assert target(point) == pytest.approx(expected)
    spot = TargetSize(1.0, [Refinement([(0.0, 0.0)], 0.2, 1.0)])
    assert spot(np.array([0.3, 0.4, 9.0])) == pytest.approx(0.6)


def test_great_circle_is_the_shortest_way_over_the_cap() -> None:
    """It runs from rim to rim on the sphere, in a plane through the sphere's centre."""
    radius, height, angle, offset = 20.0, 10.0, 0.4, 7.0
    sphere = (radius**2 + height**2) / (2 * height)
    plan = nets.great_circle(radius, height, angle, offset)
    np.testing.assert_allclose(np.linalg.norm(plan[[0, -1]], axis=1), radius)
    np.testing.assert_allclose(plan[[0, -1]] @ [-np.sin(angle), np.cos(angle)], offset)
    assert (plan[-1] - plan[0]) @ [np.cos(angle), np.sin(angle)] > radius
    up = np.sqrt(sphere**2 - np.sum(plan**2, axis=1))
    way = np.column_stack([plan, up])
    assert up[16] > up[0] and np.linalg.svd(way)[1][2] < 1e-12 * sphere
    assert np.ptp(np.linalg.norm(np.diff(way, axis=0), axis=1)) < 1e-12 * sphere


@pytest.mark.parametrize("shape", ["rectangle", "ellipse", "polygon", "spherical_cap", "air_hall"])
def test_refinement_refines_near_its_line_only(comm, shape):
    line = [(0.0, 0.0), (0.6, 0.8)]
    near = Refinement(line, 0.05, 0.8)
    membrane = {
        "rectangle": lambda: meshes.rectangle(
            comm, 4.0, 4.0, 0.4, corner=(-2.0, -2.0), refinements=[near]
        ),
        "ellipse": lambda: meshes.ellipse(comm, 2.0, 2.1, 0.4, refinements=[near]),
        "polygon": lambda: meshes.polygon(
            comm, [(-2, -2), (2, -2), (2, 2), (-2, 2)], 0.4, refinements=[near]
        ),
        "spherical_cap": lambda: meshes.spherical_cap(comm, 2.0, 0.8, 0.4, refinements=[near]),
        "air_hall": lambda: meshes.air_hall(
            comm, 4.0, 4.0, 1.0, 0.4, corner=(-2.0, -2.0), refinements=[near]
        ),
    }[shape]()
    corners = cell_corners(membrane)
    target = TargetSize(0.4, [near])
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).mean(axis=1)
    wanted = np.array([target(middle) for middle in corners.mean(axis=1)])
    ratio, wanted = (np.concatenate(comm.allgather(a)) for a in (sides / wanted, wanted))
    assert wanted.min() < 0.08  # there are cells on the line
    assert 0.5 < ratio.min()
    assert ratio.max() < 1.7
    assert np.median(ratio[wanted < 0.1]) == pytest.approx(1.0, abs=0.25)
    assert np.median(ratio[wanted == 0.4]) == pytest.approx(1.0, abs=0.25)
    assert least_angle(membrane) > 25.0


# --- refused arguments -----------------------------------------------------------------------


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda c: meshes.rectangle(c, 0.0, 1.0, 0.1), "rectangle: width = 0.0 is not positive"),
        (lambda c: meshes.rectangle(c, 1.0, np.inf, 0.1), "depth = inf"),
        (lambda c: meshes.rectangle(c, 1.0, 1.0, -0.1), "size = -0.1"),
        (lambda c: meshes.rectangle(c, 1.0, 1.0, "a"), "size = 'a'"),  # type: ignore[arg-type]
        (lambda c: meshes.rectangle(c, 3.0, 1.0, 1.1, structured=True), "smallest extent 1"),
        (lambda c: meshes.rectangle(c, 1.0, 1.0, 1e-5), "about 2.3e[+]10 cells"),
        (
            lambda c: meshes.rectangle(c, 1.0, 1.0, 0.5, corner=(0, 0, 0)),
            r"corner = \(0, 0, 0\) must be two",
        ),
        (
            lambda c: meshes.rectangle(
                c, 1, 1, 0.5, structured=True, refinements=[Refinement([(0, 0)], 0.1, 1)]
            ),
            "structured=False",
        ),
        (
            lambda c: meshes.rectangle(c, 1, 1, 0.2, refinements=[Refinement([(0, 0)], 0.3, 1)]),
            "refinement has size 0.3, more than the mesh's 0.2",
        ),
        (lambda c: meshes.ellipse(c, 1.0, np.nan, 0.1), "b = nan"),
        (lambda c: meshes.circle(c, -1.0, 0.1), "radius = -1.0"),
        (lambda c: meshes.circle(c, 1.0, 0.1, center=(np.nan, 0.0)), "center = "),
        (lambda c: meshes.spherical_cap(c, 1.0, 0.0, 0.1), "height = 0.0"),
        (lambda c: meshes.spherical_cap(c, 1.0, 1e-300, 0.1), "height = 1e-300 is outside"),
        (lambda c: nets.great_circle(1.0, 1.0, 0.0, 0.0), "height = 1.0 must be less than 1"),
        (lambda c: nets.great_circle(1.0, 0.5, 0.0, -2.0), "offset = 2.0 must be less than 1"),
        (lambda c: meshes.air_hall(c, 1.0, 1.0, None, 0.1), "height = None"),  # type: ignore[arg-type]
        (lambda c: meshes.air_hall(c, 4.0, 1.0, 1.0, 2.0), "smallest extent 1"),
        (lambda c: meshes.polygon(c, [(0, 0), (1, 0)], 0.1), "three or more points"),
        (lambda c: meshes.polygon(c, [(0, 0, 1), (1, 0, 1), (1, 1, 1)], 0.1), "three or more"),
        (lambda c: meshes.polygon(c, [(0, 0), (1, 0), (1, np.nan)], 0.1), "not all finite"),
        (lambda c: meshes.polygon(c, [(0, 0), (1, 0), (1, 0), (1, 1)], 0.1), "side 2 .* no length"),
        (lambda c: meshes.polygon(c, [(0, 0), (1, 1), (1, 0), (0, 1)], 0.1), "sides 1 and 3"),
        (lambda c: meshes.polygon(c, [(0, 0), (2, 0), (2, 2), (1, 0)], 0.1), "sides 1 and 3"),
        (lambda c: meshes.polygon(c, [(0, 0), (2, 0), (1, 0), (1, 1)], 0.1), "sides 1 and 2"),
        (lambda c: meshes.polygon(c, ARROW, 0.1, names=["a"]), "1 names for the 4 sides"),
        (lambda c: meshes.polygon(c, ARROW, 0.1, names=["a", "b", "c", ""]), "the name ''"),
        (lambda c: meshes.polygon(c, ARROW, 0.1, names=["boundary", *"abc"]), "reserved"),
        (lambda c: Refinement([], 0.1, 1.0), "line is"),
        (lambda c: Refinement([(0, 0), (0, 0, 1)], 0.1, 1.0), "line is"),
        (lambda c: Refinement([(0, np.inf)], 0.1, 1.0), "not finite"),
        (lambda c: Refinement([(0, 0)], 0.0, 1.0), "size = 0.0"),
        (lambda c: Refinement([(0, 0)], 0.1, -1.0), "distance = -1.0"),
    ],
)
def test_bad_arguments(comm, make, message):
    with pytest.raises(InputError, match=message):
        make(comm)


@pytest.mark.ranks
@pytest.mark.parametrize("why", [None, "libGLU.so.1"])
def test_without_gmsh_it_says_what_to_install(comm, monkeypatch, why) -> None:
    """Where it is not there, or cannot be loaded; structured rectangles do without."""
    from crms_fenicsx.foundation.meshes import gmsh_model

    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {name!r}") if why is None else OSError(why)

    monkeypatch.setattr(gmsh_model, "import_module", missing)
    with pytest.raises(MeshError, match=r"needs gmsh.*(No module|libGLU).*crms_fenicsx\[mesh\]"):
        meshes.rectangle(comm, 1.0, 1.0, 0.5)
    with pytest.raises(MeshError, match=r"crms_fenicsx\[mesh\]"):
        meshes.from_gmsh(comm)
    meshes.rectangle(comm, 1.0, 1.0, 0.5, structured=True)
