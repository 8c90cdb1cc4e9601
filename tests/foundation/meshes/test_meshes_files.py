"""Membranes from files and from gmsh models, and good manners towards the user's gmsh session."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import gmsh
import meshio
import numpy as np
import pytest
from mesh_measures import area, cell_corners, edge_ends, length, point_places, total_area_vector
from scipy.integrate import dblquad

from crms_fenicsx import Cable, IsotropicMembrane, MeshError, PathWarning, Scene, meshes
from crms_fenicsx.foundation.meshes import AwayFrom

ROOT = Path(__file__).parents[3]


@pytest.fixture
def session(comm):
    """The user's own gmsh session on rank 0, with a model; None elsewhere."""
    if comm.rank == 0:
        gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("of the user")
    yield gmsh if comm.rank == 0 else None
    if comm.rank == 0:
        gmsh.finalize()


def two_rectangles(session, size=0.5):
    """Two halves of a 2 x 1 rectangle, with groups, a circle's centre and a named point."""
    kernel = session.model.geo
    p = [kernel.addPoint(x, y, 0.0, size) for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)]
    low = [kernel.addLine(p[0], p[1]), kernel.addLine(p[1], p[2])]
    high = [kernel.addLine(p[3], p[4]), kernel.addLine(p[4], p[5])]
    up = [kernel.addLine(p[k], p[k + 3]) for k in range(3)]
    halves = [
        kernel.addPlaneSurface([kernel.addCurveLoop([low[k], up[k + 1], -high[k], -up[k]])])
        for k in range(2)
    ]
    kernel.addPoint(5.0, 5.0, 0.0)  # belongs to nothing
    kernel.synchronize()
    session.model.addPhysicalGroup(2, [halves[0]], name="left")
    session.model.addPhysicalGroup(2, halves, tag=7)
    session.model.addPhysicalGroup(1, [up[1]], name="seam")
    session.model.addPhysicalGroup(1, [low[0], low[1]], tag=3)
    session.model.addPhysicalGroup(0, [p[4]], name="mast")
    session.model.mesh.generate(2)
    return p, up


def assert_two_rectangles(membrane):
    assert area(membrane) == pytest.approx(2.0)
    assert area(membrane, "left") == pytest.approx(1.0)
    assert area(membrane, "7") == pytest.approx(2.0)
    assert set(membrane.parts) == {"left", "7"}
    assert set(membrane.edges) == {"boundary", "seam", "3"}
    assert (edge_ends(membrane, "seam")[..., 0] == 1.0).all()
    assert length(membrane, "seam") == pytest.approx(1.0)
    assert (edge_ends(membrane, "3")[..., 1] == 0.0).all()
    assert length(membrane, "3") == pytest.approx(2.0)
    assert length(membrane, "boundary") == pytest.approx(6.0)
    assert set(membrane.points) == {"mast"}
    assert point_places(membrane, "mast").tolist() == [[1.0, 1.0, 0.0]]
    assert total_area_vector(membrane)[2] == pytest.approx(2.0)


# --- gmsh ------------------------------------------------------------------------------------


@pytest.mark.ranks
def test_model_of_the_user(comm, session):
    if session:
        two_rectangles(session)
    assert_two_rectangles(meshes.from_gmsh(comm))
    if session:
        assert session.model.getCurrent() == "of the user"
        assert len(session.model.getPhysicalGroups()) == 5


@pytest.mark.ranks
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_msh_round_trip(comm, session, folder, version):
    if session:
        two_rectangles(session)
        session.option.setNumber("Mesh.MshFileVersion", version)
        session.write(str(folder / "halves.msh"))
    assert_two_rectangles(meshes.from_file(comm, folder / "halves.msh"))
    assert_two_rectangles(meshes.from_file(comm, str(folder / "halves.msh")))


def crossed_rectangle(session):
    """A rectangle with two lines inside, the shorter of which ends on the other one."""
    kernel = session.model.occ
    whole = kernel.addRectangle(0.0, 0.0, 0.0, 4.0, 3.0)
    ends = [(0.0, 1.0, 4.0, 2.0), (1.0, 0.0, 2.0, 1.5)]
    lines = [kernel.addLine(kernel.addPoint(x, y, 0.0), kernel.addPoint(u, v, 0.0))
             for x, y, u, v in ends]  # fmt: skip
    _, parts = kernel.fragment([(2, whole)], [(1, line) for line in lines])
    kernel.synchronize()
    for name, members in zip(("long", "short"), parts[1:], strict=True):
        session.model.addPhysicalGroup(1, [tag for dim, tag in members if dim == 1], name=name)
    session.model.addPhysicalGroup(2, [tag for _, tag in parts[0]], name="roof")
    session.option.setNumber("Mesh.MeshSizeMax", 0.4)
    session.model.mesh.generate(2)


def assert_lines(mesh, names, lengths):
    """The groups are open lines of edges; a cable can be laid along each."""
    scene = Scene(mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        for name, expected in zip(names, lengths, strict=True):
            assert length(mesh, name) == pytest.approx(expected)
            assert scene.lay_cable(Cable(EA=1e3), along=name).length == pytest.approx(expected)


def test_curves_in_a_surface_are_lines(comm, session, folder):
    """Those that divide it, and those that end inside; from the model and from files."""
    crossed_rectangle(session)
    lengths = np.hypot(4.0, 1.0), np.hypot(1.0, 1.5)
    assert_lines(meshes.from_gmsh(comm), ("long", "short"), lengths)
    for name, version in (("old.msh", 2.2), ("new.msh", 4.1), ("abaqus.inp", 4.1)):
        session.option.setNumber("Mesh.MshFileVersion", version)
        session.write(str(folder / name))
        assert_lines(meshes.from_file(comm, folder / name), ("long", "short"), lengths)
    session.write(str(folder / "roof.step"))  # without names, in millimetres
    mesh = meshes.from_step(comm, folder / "roof.step", size=0.4, unit="mm")
    lines = [name for name in mesh.edges if name.startswith("line")]
    assert len(lines) == 3 and lines[-1] == "line 3"
    assert_lines(mesh, lines, [length(mesh, name) for name in lines])
    assert sum(length(mesh, name) for name in lines) == pytest.approx(sum(lengths))


def test_embedded_curves_are_lines(comm, session):
    """Of gmsh's own kernel: embedded in the surface, not dividing it."""
    kernel = session.model.geo
    corners = [kernel.addPoint(x, y, 0.0, 0.5) for x, y in ((0, 0), (4, 0), (4, 3), (0, 3))]
    rim = [kernel.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    surface = kernel.addPlaneSurface([kernel.addCurveLoop(rim)])
    inner = kernel.addPoint(2.0, 1.0, 0.0, 0.5)
    pieces = [kernel.addLine(corners[0], inner), kernel.addLine(inner, corners[2])]
    kernel.synchronize()
    session.model.mesh.embed(1, pieces, 2, surface)
    session.model.addPhysicalGroup(1, pieces, name="kinked")
    session.model.mesh.generate(2)
    lengths = [np.hypot(2.0, 1.0) + np.hypot(2.0, 2.0)]
    assert_lines(meshes.from_gmsh(comm), ("kinked",), lengths)


def test_generators_leave_the_session_of_the_user_alone(comm, session):
    names = ["General.Terminal", "Mesh.MeshSizeMax", "Mesh.Algorithm", "Mesh.MeshSizeFactor"]
    if session:
        session.option.setNumber("Mesh.MeshSizeMax", 0.123)
        session.option.setNumber("Mesh.Algorithm", 5)
        session.model.add("later")
        session.model.setCurrent("of the user")
        before = [session.option.getNumber(name) for name in names]
    membrane = meshes.rectangle(comm, 1.0, 1.0, 0.5)
    assert len(edge_ends(membrane, "boundary")) == 8  # the user's 0.123 does not reach it
    with pytest.raises(MeshError):
        meshes.from_file(comm, ROOT / "README that is not there.msh")
    if session:
        assert [session.option.getNumber(name) for name in names] == before
        assert session.model.getCurrent() == "of the user"
        assert "crms_fenicsx" not in session.model.list()


def test_session_of_our_own_is_closed(comm):
    meshes.circle(comm, 1.0, 0.5)
    assert not gmsh.isInitialized()
    with pytest.raises(MeshError, match="not initialised on rank 0"):
        meshes.from_gmsh(comm)


def test_nothing_is_printed_and_imports_stay_light():
    """In a process of its own, without MPI's launcher."""
    script = (
        "import sys\n"
        "from crms_fenicsx import meshes\n"
        "assert not {'gmsh', 'meshio', 'matplotlib'} & set(sys.modules)\n"
        "from mpi4py import MPI\n"
        "meshes.air_hall(MPI.COMM_SELF, 4.0, 6.0, 2.0, 1.0)\n"
        f"meshes.from_file(MPI.COMM_SELF, {str(ROOT / 'meshes' / 'hypar_tent.geo')!r})\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_geo_script(comm):
    tent = meshes.from_file(comm, ROOT / "meshes" / "hypar_tent.geo")
    side, rise = 10.0, 3.0
    assert set(tent.parts) == {"membrane"}
    assert length(tent, "edges") == pytest.approx(4.0 * np.hypot(side, rise))
    assert len(edge_ends(tent, "edges")) == len(edge_ends(tent, "boundary"))
    assert sorted(point_places(tent, "high").tolist()) == [[0, side, rise], [side, 0, rise]]
    assert sorted(point_places(tent, "low").tolist()) == [[0, 0, 0], [side, side, 0]]

    def density(u, v):  # z = rise (u + v - 2 u v)
        slope = np.array([1.0 - 2.0 * v, 1.0 - 2.0 * u]) * rise / side
        return side**2 * np.sqrt(1.0 + slope @ slope)

    assert area(tent) == pytest.approx(dblquad(density, 0.0, 1.0, 0.0, 1.0)[0], rel=2e-3)


def hall_plan(comm, size):
    return meshes.rectangle(comm, 36.0, 36.0, size, corner=(-18.0, -18.0))


def tent_plan(comm, size):
    corners = [(0.0, -7.0), (8.0, 0.0), (0.0, 7.0), (-8.0, 0.0)]
    names = ["south east", "north east", "north west", "south west"]
    return meshes.polygon(comm, corners, size, names=names)


@pytest.mark.parametrize(
    ("name", "made", "sizes"),
    [("hall", hall_plan, (2.4, 6.0)), ("tent", tent_plan, (0.6, 1.2))],
)
def test_plans_of_the_demos(comm, name, made, sizes):
    """They have the cells of the generators, at the size that gmsh is given."""
    gmsh = pytest.importorskip("gmsh")
    for size in sizes:
        gmsh.initialize(
            ["", "-setnumber", "size", str(size)], readConfigFiles=False, interruptible=False
        )
        plan = meshes.from_file(comm, ROOT / "meshes" / f"{name}.geo")
        gmsh.finalize()
        twin = made(comm, size)
        np.testing.assert_array_equal(cell_corners(plan), cell_corners(twin))
        assert list(plan.edges) == list(twin.edges) and len(plan.points) == len(twin.points) == 4
        for edge in plan.edges:
            assert length(plan, edge) == pytest.approx(length(twin, edge), rel=1e-12)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g, p, up: g.model.mesh.clear(), "no triangles"),
        (lambda g, p, up: g.model.mesh.setOrder(2), "'Triangle 6'.*3-node"),
        (lambda g, p, up: g.model.mesh.recombine(), "'Quadrilateral 4'.*3-node"),
        (lambda g, p, up: g.model.addPhysicalGroup(0, [7], name="far"), "'far' has node"),
        (lambda g, p, up: g.model.addPhysicalGroup(1, [up[1]], name="boundary"), "reserved"),
    ],
)
def test_bad_models(comm, session, change, message):
    if session:
        change(session, *two_rectangles(session))
    with pytest.raises(MeshError, match=message):
        meshes.from_gmsh(comm)


# --- meshio ----------------------------------------------------------------------------------

POINTS = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (9, 9, 9)])  # the last is loose
HALVES = np.array([(0, 1, 2), (0, 3, 2)])  # one of them turned


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".stl", ".obj", ".ply", ".off"])
def test_suffixes_that_meshio_knows(comm, folder, suffix):
    file = folder / f"square{suffix}"
    if comm.rank == 0:
        meshio.Mesh(POINTS, [("triangle", HALVES)]).write(file)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        membrane = meshes.from_file(comm, file)
    assert area(membrane) == pytest.approx(1.0)
    assert len(edge_ends(membrane, "boundary")) == 4  # the halves are joined
    assert total_area_vector(membrane)[2] == pytest.approx(1.0)
    turned = meshes.from_file(comm, file, outside=AwayFrom((0.5, 0.5, 1.0)))
    assert total_area_vector(turned)[2] == pytest.approx(-1.0)


def test_marks_of_medit(comm, folder):
    file = folder / "square.mesh"
    if comm.rank == 0:
        cells = [("triangle", HALVES), ("line", [(0, 2), (2, 1)])]
        marks = {"medit:ref": [np.array([5, 0]), np.array([2, 2])]}
        meshio.Mesh(POINTS, cells, cell_data=marks).write(file)
    membrane = meshes.from_file(comm, file)
    assert set(membrane.parts) == {"5"}
    assert area(membrane, "5") == pytest.approx(0.5)
    assert length(membrane, "2") == pytest.approx(1.0 + np.sqrt(2.0))


def test_sets_of_abaqus(comm, folder):
    file = folder / "square.inp"
    if comm.rank == 0:
        meshio.Mesh(
            POINTS,
            [("triangle", HALVES)],
            cell_sets={"upper": [np.array([1])]},
            point_sets={"tips": np.array([1, 3])},
        ).write(file)
    membrane = meshes.from_file(comm, file)
    assert area(membrane, "upper") == pytest.approx(0.5)
    assert sorted(point_places(membrane, "tips").tolist()) == [[0, 1, 0], [1, 0, 0]]


# --- files that cannot be used ---------------------------------------------------------------


def write_mesh(*cells, points=POINTS, **more):
    return lambda file: meshio.Mesh(points, list(cells), **more).write(file)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("none.msh", lambda file: None, "no mesh file .*none.msh"),
        ("none.vtu", lambda file: None, "no mesh file .*none.vtu"),
        ("folder.msh", lambda file: file.mkdir(), "no mesh file"),
        ("text.msh", lambda file: file.write_text("Point(1) = {0, 0, 0};"), "not a gmsh mesh"),
        ("short.msh", lambda file: file.write_text("$MeshFormat\n4.1 0 8\n"), "short.msh"),
        ("bad.geo", lambda file: file.write_text("Point(1) = {0, 0;"), "gmsh cannot read.*bad.geo"),
        ("empty.geo", lambda file: file.write_text(""), "gmsh cannot read.*empty.geo"),
        (
            "point.geo",
            lambda file: file.write_text("Point(1) = {0, 0, 0};"),
            "point.geo.*no triangles",
        ),
        ("text.vtu", lambda file: file.write_text("no xml"), "meshio cannot read.*text.vtu"),
        ("text.odd", lambda file: file.write_text("?"), "suffix '.odd'; convert"),
        ("text.stl", lambda file: file.write_bytes(b"\xff\x00"), "text.stl"),
        ("lines.vtu", write_mesh(("line", [(0, 1)])), "lines.vtu.*no triangles"),
        ("quad.vtu", write_mesh(("quad", [(0, 1, 2, 3)])), "cells of the type 'quad'"),
        (
            "mixed.vtu",
            write_mesh(("triangle", HALVES), ("quad", [(0, 1, 2, 3)])),
            "cells of the type 'quad'",
        ),
        (
            "far.inp",
            write_mesh(("triangle", HALVES), point_sets={"far": np.array([4])}),
            "far.inp.*'far' has node 4",
        ),
        ("thin.vtu", write_mesh(("triangle", [(0, 1, 1)])), "no area"),
    ],
)
def test_bad_files(comm, folder, capfd, name, write, message):
    file = folder / name
    if comm.rank == 0:
        write(file)
    capfd.readouterr()
    with pytest.raises(MeshError, match=message):
        meshes.from_file(comm, file)
    assert capfd.readouterr() == ("", "")
    assert not gmsh.isInitialized()
