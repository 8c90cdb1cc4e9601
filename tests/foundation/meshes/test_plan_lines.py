"""Meshes that follow lines: rows of vertices on them, ends, crossings, refused lines."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mesh_measures import cell_corners, edge_ends, least_angle, length, point_places
from mpi4py import MPI

from crms_fenicsx import InputError, meshes, nets
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.edge_table import line_of
from crms_fenicsx.foundation.meshes.membrane_mesh import gathered
from crms_fenicsx.foundation.runtime.arrays import Array

CROSS = {"A1": [(0.0, 0.5), (4.0, 2.5)], "B1": [(1.0, 3.0), (3.0, 0.0)]}


def row_of(mesh: MembraneMesh, name: str) -> Array:
    """Positions (n, 3) of the vertices along a line, on all ranks; fails if it is not one line."""
    surface, _ = gathered(mesh)
    row = None
    if mesh.comm.rank == 0:
        keys = surface.edges[name]
        line, ends = line_of([(int(key >> 32), int(key & 0xFFFFFFFF)) for key in keys])
        assert ends == 2 and len(line) == len(keys) + 1
        row = surface.points[line]
    found: Array = mesh.comm.bcast(row)
    return found


def off_line(points: Array, start: tuple[float, float], end: tuple[float, float]) -> float:
    """Largest distance in plan of points from a straight line."""
    way = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    offset = points[:, :2] - start
    return float(np.abs(offset[:, 0] * way[1] - offset[:, 1] * way[0]).max())


def shared(one: Array, other: Array) -> Array:
    """Vertices that two rows have in common."""
    same = (one[:, None] == other).all(axis=-1)
    return one[same.any(axis=1)]


def plane_shapes(comm: MPI.Intracomm, **lines: Any) -> dict[str, Callable[[], MembraneMesh]]:
    """Flat meshes that contain the rectangle from (0, 0) to (4, 3), to its corners."""
    corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0)]
    return {
        "rectangle": lambda: meshes.rectangle(comm, 4.0, 3.0, 0.3, **lines),
        "polygon": lambda: meshes.polygon(comm, corners, 0.3, **lines),
        "circle": lambda: meshes.circle(comm, 2.5, 0.3, center=(2.0, 1.5), **lines),
        "ellipse": lambda: meshes.ellipse(comm, 3.0, 2.0, 0.3, center=(2.0, 1.5), **lines),
    }


@pytest.mark.ranks
@pytest.mark.parametrize("shape", ["rectangle", "polygon", "circle", "ellipse"])
def test_rows_lie_on_their_lines_and_share_a_vertex(comm: MPI.Intracomm, shape: str) -> None:
    lines: dict[str, Any] = CROSS
    if shape in ("circle", "ellipse"):  # chords of them, through points inside
        a, b = (2.5, 2.5) if shape == "circle" else (3.0, 2.0)
        chords = {"A1": (np.pi, 0.3), "B1": (2.0, 5.0)}
        lines = {
            name: [(2.0 + a * np.cos(t), 1.5 + b * np.sin(t)) for t in ends]
            for name, ends in chords.items()
        }
    mesh = plane_shapes(comm, lines=lines)[shape]()
    rows = {name: row_of(mesh, name) for name in lines}
    for name, (start, end) in lines.items():
        row = rows[name]
        assert off_line(row, start, end) < 1e-12
        steps = np.linalg.norm(np.diff(row, axis=0), axis=1)
        assert 0.2 < steps.min() and steps.max() < 0.45
        assert length(mesh, name) == pytest.approx(np.linalg.norm(np.subtract(end, start)))
        for place in (start, end):
            assert np.linalg.norm(row[[0, -1], :2] - place, axis=1).min() < 1e-12
    assert len(shared(rows["A1"], rows["B1"])) == 1
    assert least_angle(mesh) > 25.0
    boundary = edge_ends(mesh, "boundary").reshape(-1, 3)
    assert len(shared(np.concatenate(list(rows.values())), boundary)) == 4
    if shape == "rectangle":  # the lines divide the sides, which stay whole
        assert length(mesh, "left") == pytest.approx(3.0)
        assert length(mesh, "front") == pytest.approx(4.0)
        assert point_places(mesh, "back right").tolist() == [[4.0, 3.0, 0.0]]


@pytest.mark.parametrize("shape", ["rectangle", "polygon", "circle", "ellipse"])
def test_no_lines_change_nothing(comm: MPI.Intracomm, shape: str) -> None:
    plain = plane_shapes(comm)[shape]()
    none = plane_shapes(comm, lines={})[shape]()
    np.testing.assert_array_equal(cell_corners(plain), cell_corners(none))


def test_a_circle_without_lines_is_gmshs_own(comm: MPI.Intracomm) -> None:
    """The vertices that gmsh makes of a circle of four arcs, to the last bit."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        geo = gmsh.model.geo
        middle = geo.addPoint(1.0, 2.0, 0.0)
        ends = [geo.addPoint(1.0 + 3 * u, 2.0 + 3 * v, 0.0)
                for u, v in ((1, 0), (0, 1), (-1, 0), (0, -1))]  # fmt: skip
        arcs = [geo.addEllipseArc(ends[k], middle, ends[0], ends[(k + 1) % 4]) for k in range(4)]
        geo.addPlaneSurface([geo.addCurveLoop(arcs)])
        geo.synchronize()
        gmsh.model.mesh.setSizeCallback(lambda *place: 0.4)
        gmsh.model.mesh.generate(2)
        own = meshes.from_gmsh(MPI.COMM_SELF)
    finally:
        gmsh.finalize()
    mesh = meshes.circle(MPI.COMM_SELF, 3.0, 0.4, center=(1.0, 2.0))
    np.testing.assert_array_equal(cell_corners(own), cell_corners(mesh))


@pytest.mark.ranks
@pytest.mark.parametrize("coordinates", [2, 3])
def test_great_circles_stay_on_a_cap(comm: MPI.Intracomm, coordinates: int) -> None:
    """In plan, or anywhere in space on the rays from the sphere's centre."""
    radius, height, center = 20.0, 10.0, (3.0, -1.0)
    ball = (radius**2 + height**2) / (2 * height)
    lines = {}
    for k, (angle, offset) in enumerate([(0.4, 7.0), (0.4, -3.0), (-0.4, 6.0)]):
        plan = nets.great_circle(radius, height, angle, offset)
        if coordinates == 3:
            space = np.column_stack([plan, np.sqrt(ball**2 - (plan**2).sum(axis=1))])
            plan = 1.7 * space + [0.0, 0.0, height - ball]
        lines[f"A{k}"] = plan + (*center, 0.0)[:coordinates]
    mesh = meshes.spherical_cap(comm, radius, height, 2.0, center=center, lines=lines)
    for name in lines:
        offset = row_of(mesh, name) - [*center, height - ball]
        assert np.linalg.norm(offset, axis=1) == pytest.approx(ball, rel=1e-12)
        aside = np.linalg.svd(offset)[1][2]  # from the plane through the centre
        assert aside < 2e-4 * 2.0
        steps = np.linalg.norm(np.diff(offset, axis=0), axis=1)
        assert 0.8 * 2.0 < steps.min() and steps.max() < 1.25 * 2.0
    assert len(shared(row_of(mesh, "A0"), row_of(mesh, "A2"))) == 1
    assert least_angle(mesh) > 24.0


@pytest.mark.ranks
def test_lines_on_a_hall(comm: MPI.Intracomm, caplog: pytest.LogCaptureFixture) -> None:
    """Straight in plan, and on the surface; those that turn on it are told."""
    lines = {"A1": [(-3.0, 10.0), (21.0, 10.0)], "B1": [(-3.0, 2.0), (15.0, 18.0)]}
    with caplog.at_level(logging.INFO, logger="crms_fenicsx"):
        mesh = meshes.air_hall(comm, 24.0, 16.0, 6.0, 1.5, corner=(-3.0, 2.0), lines=lines)
    for name, (start, end) in lines.items():
        row = row_of(mesh, name)
        assert off_line(row, start, end) < 1e-12 and (row[[0, -1], 2] == 0.0).all()
        aside = np.minimum(row[:, :2] - (-3.0, 2.0), (21.0, 18.0) - row[:, :2])
        rise = np.sqrt(1.0 - (1.0 - np.minimum(aside, 8.0) / 8.0) ** 2)
        assert row[:, 2] == pytest.approx(6.0 * rise[:, 0] * rise[:, 1], abs=1e-12)
        steps = np.linalg.norm(np.diff(row, axis=0), axis=1)
        assert 0.6 * 1.5 < steps.min() and steps.max() < 1.35 * 1.5
    for name, long in {"left": 16.0, "right": 16.0, "front": 24.0, "back": 24.0}.items():
        assert length(mesh, name) == pytest.approx(long, rel=1e-12)
    assert point_places(mesh, "front left").tolist() == [[-3.0, 2.0, 0.0]]
    assert len(shared(row_of(mesh, "A1"), row_of(mesh, "B1"))) == 1
    assert least_angle(mesh) > 25.0
    if comm.rank == 0:  # the ridge is straight, the diagonal is not
        assert ["'B1' turns" in text for text in caplog.messages] == [True]


@pytest.mark.ranks
def test_ends_are_moved_a_little(comm: MPI.Intracomm, caplog: pytest.LogCaptureFixture) -> None:
    """To the rim, to its corners, to each other and to other lines."""
    lines = {
        "A1": [(0.05, 1.5), (3.96, 1.5)],  # to the rim
        "A2": [(0.0, 2.95), (4.0, 2.0)],  # to a corner
        "B1": [(1.0, 3.03), (1.0, 1.46)],  # from beyond the rim over to A1
        "B2": [(2.0, 1.48), (3.0, 0.0)],  # from A1
        "B3": [(2.0, 0.5), (3.03, 0.02)],  # to the end of B2, and to that of B4
        "B4": [(1.0, 0.0), (2.02, 0.49)],
    }
    with caplog.at_level(logging.INFO, logger="crms_fenicsx"):
        mesh = meshes.rectangle(comm, 4.0, 3.0, 0.4, lines=lines)
    rows = {name: row_of(mesh, name) for name in lines}

    def ends(name: str) -> list[list[float]]:
        return sorted([round(float(x), 9) for x in rows[name][k, :2]] for k in (0, -1))

    assert ends("A1") == [[0.0, 1.5], [4.0, 1.5]]
    assert ends("A2") == [[0.0, 3.0], [4.0, 2.0]]
    assert ends("B1")[1][1] in (1.5, 3.0) and [1.0, 1.5] in ends("B1")
    assert ends("B2") == [[2.0, 1.5], [3.0, 0.0]]
    assert [3.0, 0.0] in ends("B3")
    for one, other in (("B1", "A1"), ("B2", "A1"), ("B3", "B2"), ("B4", "B3"), ("B1", "A2")):
        assert len(shared(rows[one], rows[other])) == 1
    assert off_line(rows["A2"], (0.0, 3.0), (4.0, 2.0)) < 1e-12
    if comm.rank == 0:
        assert any("'A2' now ends at (0, 3), 0.05 away" in text for text in caplog.messages)


def test_three_lines_through_one_point(comm: MPI.Intracomm) -> None:
    third = np.pi / 3
    lines = {f"A{k}": [(5 * np.cos(t), 5 * np.sin(t)), (-5 * np.cos(t), -5 * np.sin(t))]
             for k, t in enumerate((0.1, 0.1 + third, 0.1 + 2 * third))}  # fmt: skip
    mesh = meshes.circle(comm, 5.0, 1.0, lines=lines)
    rows = [row_of(mesh, name) for name in lines]
    middle = shared(shared(rows[0], rows[1]), rows[2])
    assert np.abs(middle).max() < 1e-12 and len(middle) == 1


@pytest.mark.parametrize(("unit", "away"), [(1e3, 0.0), (1.0, 1e5)])
def test_units_and_distance_from_the_origin(comm: MPI.Intracomm, unit: float, away: float) -> None:
    """The same rows in millimetres and far away, on plans, caps and halls."""
    cap = {"A1": [(-10.0, 0.0), (10.0, 0.0)], "B1": [(0.0, -10.0), (1.0, 3.0), (0.0, 10.0)]}
    hall = {"A1": [(0.0, 6.0), (18.0, 6.0)], "B1": [(3.0, 0.0), (7.0, 12.0)]}

    def made(unit: float, away: float) -> list[Array]:
        moved = [{name: unit * np.array(line) + away for name, line in lines.items()}
                 for lines in (cap, hall, CROSS)]  # fmt: skip
        place, size = (away, away), 1.5 * unit
        found = [
            meshes.spherical_cap(comm, 10 * unit, 4 * unit, size, center=place, lines=moved[0]),
            meshes.air_hall(
                comm, 18 * unit, 12 * unit, 5 * unit, size, corner=place, lines=moved[1]
            ),
            meshes.rectangle(comm, 4 * unit, 3 * unit, size, corner=place, lines=moved[2]),
        ]
        shift = [away, away, 0.0]
        return [(row_of(mesh, name) - shift) / unit for mesh in found for name in ("A1", "B1")]

    for row, same in zip(made(1.0, 0.0), made(unit, away), strict=True):
        assert same == pytest.approx(row, abs=1e-8)


@pytest.mark.ranks
def test_refined_lines_are_lines(comm: MPI.Intracomm) -> None:
    plan = meshes.refine(meshes.rectangle(comm, 4.0, 3.0, 0.5, lines=CROSS))
    for name, (start, end) in CROSS.items():
        assert off_line(row_of(plan, name), start, end) < 1e-12
    circle = {"A1": nets.great_circle(20.0, 10.0, 0.4, 7.0)}
    cap = meshes.spherical_cap(comm, 20.0, 10.0, 4.0, lines=circle)
    fine = meshes.refine(cap)
    assert len(row_of(fine, "A1")) == 2 * len(row_of(cap, "A1")) - 1
    assert np.linalg.svd(row_of(fine, "A1") - [0.0, 0.0, -15.0])[1][2] < 1e-3
    near = meshes.refine(plan, cells=np.arange(3, dtype=np.int32))
    assert off_line(row_of(near, "A1"), *CROSS["A1"]) < 1e-12


ARROW = [(0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (2.0, 1.0)]


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([(0, 0), (1, 1)], "lines = .* is not a valid mapping"),
        ({1: [(0, 1), (4, 1)]}, "a line has the name 1"),
        ({"boundary": [(0, 1), (4, 1)]}, "edges of the mesh are named 'boundary' already"),
        ({"left": [(0, 1), (4, 1)]}, "edges of the mesh are named 'left' already"),
        ({"A": [(0, 1)]}, r"rectangle: lines\['A'\] is not a line; pass two or more"),
        ({"A": "there"}, "is not a line"),
        ({"A": [(0, 1, 2, 3), (4, 1, 2, 3)]}, "is not a line"),
        ({"A": [(0, 1), (4,)]}, "is not a line"),
        ({"A": [(0, 1), (4, np.nan)]}, "pass finite coordinates"),
        ({"A": [(1, 1), (1, 1)]}, "has no length"),
        ({"A": [(0, 1), (1e9, 1)]}, "line 'A' leaves the plan, to .*inside"),
        ({"A": [(0, 1), (4.5, 1)]}, r"line 'A' ends outside the plan, at \(4.5, 1\), 0.5 from"),
        ({"A": [(0, 1), (3, 1)]}, "line 'A' ends inside the plan.*on the rim or on another line"),
        ({"A": [(0, 1), (2, 3.5), (4, 2.5)]}, "line 'A' leaves the plan or runs along its rim"),
        ({"A": [(0, 0), (4, 0)]}, "runs along its rim at"),
        ({"A": [(0, 1), (3, 1), (1, 1.1), (4, 2)]}, "line 'A' runs back at"),
        ({"A": [(1, 0), (1, 2), (3, 2), (3, 1), (0, 1)]}, "line 'A' crosses itself at"),
        ({"A": [(0, 1), (1, 2), (2, 1), (1, 0.5), (0, 1)]}, "begins and ends at .*two ends"),
        ({"A": [(0, 1), (4, 1)], "B": [(0, 1), (4, 1)]}, "lines '[AB]' and '[AB]' run side by"),
        ({"A": [(0, 1), (4, 2)], "B": [(0, 1.002), (4, 2.002)]}, "side by side"),
        ({"A": [(0, 1), (4, 2)], "B": [(1, 0), (1, 1.25), (3, 1.75), (3, 3)]}, "side by side"),
    ],
)
def test_bad_lines(comm: MPI.Intracomm, lines: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        meshes.rectangle(comm, 4.0, 3.0, 0.5, lines=lines)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda c: meshes.rectangle(c, 4.0, 3.0, 0.5, structured=True, lines=CROSS),
            r"cannot take 2 line\(s\)",
        ),
        (
            lambda c: meshes.polygon(c, ARROW, 0.2, lines={"A": [(0, 0), (4, 3)]}),
            "polygon: line 'A' leaves the plan",
        ),
        (
            lambda c: meshes.polygon(c, ARROW, 0.2, lines={"side 2": [(0, 0), (3, 0)]}),
            "named 'side 2' already",
        ),
        (
            lambda c: meshes.circle(c, 2.0, 0.5, lines={"A": [(-2, 0), (2.5, 0)]}),
            "circle: line 'A' ends outside",
        ),
        (
            lambda c: meshes.spherical_cap(c, 2.0, 2.0, 0.5, lines={"A": [(-2, 0), (2, 0)]}),
            "opposite sides of the sphere; pass a point between",
        ),
        (
            lambda c: meshes.spherical_cap(c, 2.0, 1.0, 0.5, lines={"A": [(0, 0), (1e300, 0)]}),
            "too far away",
        ),
        (
            lambda c: meshes.spherical_cap(c, 2.0, 1.0, 0.5, lines={"A": [(0, 0), (1, 0)]}),
            "spherical_cap: line 'A' ends inside",
        ),
        (
            lambda c: meshes.air_hall(c, 4.0, 4.0, 1.0, 0.5, lines={"A": [(0, 2), (2, 2)]}),
            "air_hall: line 'A' ends inside",
        ),
    ],
)
def test_bad_lines_of_other_shapes(
    comm: MPI.Intracomm, make: Callable[[MPI.Intracomm], object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make(comm)
