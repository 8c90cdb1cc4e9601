"""Drawings, shapes and meshes of other programs: there and back, and bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, MeshError, Scene, Solver, meshes
from crms_fenicsx.design.exchange import from_compas, read_dxf, to_vertices_and_faces, write_shape

FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=1.0)


def roof(comm: MPI.Intracomm) -> Solver:
    """A sheet under pressure with a cable across it, and a mast beside it."""
    scene = sheet(comm, 4, material=FOIL, side=8.0)
    scene.add_bar(Bar(EA=1e4), (9.0, 0.0, 0.0), (9.0, 0.0, 4.0), name="mast")
    solver = advanced(Solver(scene), pressure=0.1)
    scene.lay_cable(Cable(1e4), [(0.0, 3.3), (8.0, 4.2)], tension=1.0, name="ridge/1")
    solver.advance(pressure=0.2)
    return solver


@pytest.mark.ranks
def test_a_shape_as_dxf(comm: MPI.Intracomm, folder: Path) -> None:
    """Faces with the area of the surface, the cable's line, the bar and the supports; no error."""
    ezdxf = pytest.importorskip("ezdxf")
    solver = roof(comm)
    scene, path = solver.scene, folder / "form.dxf"
    write_shape(scene, path, unit="mm")
    document = ezdxf.readfile(path)
    assert not document.audit().errors
    assert document.units == 4
    space = document.modelspace()
    faces = np.array([[tuple(face.dxf.get(f"vtx{k}")) for k in range(3)] for face in
                      space.query("3DFACE")])  # fmt: skip
    sides = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    surface = solver.results().surface
    corners = surface.points[surface.triangles]
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    expected = comm.allreduce(float(np.linalg.norm(own, axis=1).sum() / 2))
    assert np.linalg.norm(sides, axis=1).sum() / 2 == pytest.approx(expected, rel=1e-12)
    (line,) = space.query('POLYLINE[layer=="CABLE ridge_1"]')
    places = np.array([tuple(v.dxf.location) for v in line.vertices])
    np.testing.assert_allclose(places, scene.cable("ridge/1").line, atol=1e-12)
    (mast,) = space.query('LINE[layer=="BAR mast"]')
    np.testing.assert_allclose(tuple(mast.dxf.end), (9.0, 0.0, 4.0))
    held = comm.allreduce(int(scene.held[: scene.V.dofmap.index_map.size_local].any(axis=1).sum()))
    assert len(space.query("POINT")) == held


def test_names_with_line_breaks(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """Names are one line of a DXF: what cannot be printed is replaced, other scripts stay."""
    ezdxf = pytest.importorskip("ezdxf")
    solver = roof(comm)
    names = ["up\n  0\nEOF", "tab\tand\rreturn", "Grat ü 峰"]
    for k, name in enumerate(names):
        solver.scene.lay_cable(Cable(1e4), [(0.0, 1.0 + k), (8.0, 1.0 + k)], name=name)
    write_shape(solver.scene, tmp_path / "form.dxf")
    document = ezdxf.readfile(tmp_path / "form.dxf")
    assert not document.audit().errors
    expected = ["up_  0_EOF", "tab_and_return", "Grat ü 峰"]
    layers = [line.dxf.layer for line in document.modelspace().query("POLYLINE")]
    assert layers == ["CABLE ridge_1", *(f"CABLE {name}" for name in expected)]


@pytest.mark.ranks
@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply"])
def test_a_shape_as_triangles(comm: MPI.Intracomm, folder: Path, suffix: str) -> None:
    """Reading it gives a mesh with the same area."""
    meshio = pytest.importorskip("meshio")
    scene = roof(comm).scene
    path = folder / f"form{suffix}"
    write_shape(scene, path)
    content = meshio.read(path)
    corners = content.points[content.cells_dict["triangle"]]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(sides, axis=1).sum() / 2
    known = comm.bcast(to_vertices_and_faces(scene))
    corners = np.array(known[0])[np.array(known[1])]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert area == pytest.approx(np.linalg.norm(sides, axis=1).sum() / 2, rel=1e-6)


def test_a_drawing(tmp_path: Path, comm: MPI.Intracomm) -> None:
    """Layers, units, closed and open lines, arcs as chords; a mesh of an outline."""
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.new("R2010", units=4)  # mm
    space = drawing.modelspace()
    corners = [(0, 0), (8000, 0), (8000, 6000), (0, 6000)]
    space.add_lwpolyline(corners, close=True, dxfattribs={"layer": "ROOF"})
    space.add_circle((4000, 3000), 1000, dxfattribs={"layer": "HOLE"})
    space.add_line((0, 0, 0), (0, 0, 3000), dxfattribs={"layer": "MAST"})
    space.add_point((1000, 2000, 3000), dxfattribs={"layer": "MAST"})
    space.add_text("no line", dxfattribs={"layer": "TEXT"})
    path = tmp_path / "site.dxf"
    drawing.saveas(path)
    found = read_dxf(path)
    assert set(found) == {"ROOF", "HOLE", "MAST"}
    (outline,) = found["ROOF"].outlines
    np.testing.assert_allclose(outline[:, :2], np.array(corners) / 1000.0)
    (circle,) = found["HOLE"].outlines
    np.testing.assert_allclose(np.hypot(*(circle[:, :2] - (4.0, 3.0)).T), 1.0, atol=1e-3)
    assert len(circle) > 8
    np.testing.assert_allclose(found["MAST"].lines, [[(0, 0, 0), (0, 0, 3)]])
    np.testing.assert_allclose(found["MAST"].points, [(1, 2, 3)])
    np.testing.assert_allclose(read_dxf(path, unit=1.0)["MAST"].points, [(1000, 2000, 3000)])
    mesh = meshes.polygon(comm, outline[:, :2], size=2.0)
    assert Scene(mesh, FOIL).membrane.cell_areas.sum() == pytest.approx(48.0)


def drawn(path: Path, *, units: int = 6) -> tuple[Any, Any]:
    """A function that reads what has been drawn so far, and the space to draw in."""
    drawing = pytest.importorskip("ezdxf").new("R2010", units=units)

    def read(**options: Any) -> Any:
        drawing.saveas(path)
        return read_dxf(path, **options)

    return read, drawing.modelspace()


@pytest.mark.parametrize(("size", "x"), [(1.0, 0.0), (2e4, 0.0), (2e4, 7e4), (3.0, 4e6)])
def test_curves_of_any_size_and_place(tmp_path: Path, size: float, x: float) -> None:
    """Chords stay within 0.1 % of the curve's size, and are few: below 3 x the coarsest circle's.

    A regular polygon with n corners in the unit circle is 1 - cos(pi / n) off.
    """
    read, space = drawn(tmp_path / "curves.dxf")
    space.add_circle((x, 0), size, dxfattribs={"layer": "circle"})
    space.add_ellipse((x, 0), (size, 0), 0.5, dxfattribs={"layer": "ellipse"})
    space.add_arc((x, 0), size, 0, 90, dxfattribs={"layer": "arc"})
    space.add_circle((x, 0), 0.0, dxfattribs={"layer": "nothing"})
    space.add_line((0, 0), (0, 1e-3), dxfattribs={"layer": "far away"})
    found = read()
    assert "nothing" not in found
    for layer, height in (("circle", 1.0), ("ellipse", 0.5), ("arc", 1.0)):
        (line,) = found[layer].outlines or found[layer].lines
        places = (line[:, :2] - (x, 0.0)) / (size, height * size)
        # ezdxf has cubics for arcs: 2.7e-4 of the radius off for a quarter of a circle
        np.testing.assert_allclose(np.hypot(*places.T), 1.0, atol=3e-4)
        middles = (places[1:] + places[:-1]) / 2
        assert np.hypot(*middles.T).min() > 1 - 1e-3 * np.hypot(2.0, 2.0) / height
        assert np.linalg.norm(np.diff(places, axis=0), axis=1).min() > 1e-2  # none comes twice
        assert len(line) < 3 * np.pi / np.arccos(1 - 2e-3)


def test_contours_of_single_lines(tmp_path: Path) -> None:
    """Lines and arcs in any order and sense become one outline; three ends at a point do not."""
    read, space = drawn(tmp_path / "contour.dxf")
    space.add_line((8, 2), (8, 0))
    space.add_line((0, 6), (0, 0))
    space.add_arc((4, 2), 4, 0, 90)  # from (8, 2) to (4, 6)
    space.add_line((8, 0), (0, 0))
    space.add_line((20, 0), (21, 0))  # open, from one end to the next
    space.add_line((21, 0), (21, 1))
    space.add_line((0, 6), (4, 6))
    space.add_lwpolyline([(0, 6), (0, 9), (-1, 6)], close=True)
    for a, b in (((0, 0), (2, 0)), ((2, 0), (1, 1)), ((1, 1), (0, 0)), ((1, 1), (1, 5))):
        space.add_line(a, b, dxfattribs={"layer": "guyed"})
    for _ in range(2):
        space.add_line((0, 0), (2, 0), dxfattribs={"layer": "twice"})
    found = read()
    triangle, outline = sorted(found["0"].outlines, key=len)
    np.testing.assert_allclose(triangle[:, :2], [(0, 6), (0, 9), (-1, 6)])
    x, y = outline[:, :2].T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
    assert area == pytest.approx(8 * 6 - (4 - np.pi) * 4, rel=5e-3)
    assert np.linalg.norm(np.diff(outline, axis=0), axis=1).min() > 0.1  # no corner comes twice
    np.testing.assert_allclose(
        found["0"].lines, [[(20, 0, 0), (21, 0, 0)], [(21, 0, 0), (21, 1, 0)]]
    )
    assert not found["guyed"].outlines and len(found["guyed"].lines) == 4
    assert not found["twice"].outlines and len(found["twice"].lines) == 2


def test_units_of_drawings(tmp_path: Path) -> None:
    """Lengths as in ezdxf's table, survey units by the foot of 1200/3937 m; others are refused."""
    units = pytest.importorskip("ezdxf.units")
    survey = 1200 / 3937
    own = {8: 2.54e-8, 9: 2.54e-5, 21: survey, 22: survey / 12, 23: survey * 3, 24: survey * 5280}
    for code in range(25):
        read, space = drawn(tmp_path / "unit.dxf", units=code)
        space.add_point((2, 0, 0))
        if code in (11, 12, 17, 18, 19, 20):
            with pytest.raises(InputError, match=rf"unit code \$INSUNITS = {code}, .* pass unit"):
                read()
            assert read(unit=0.5)["0"].points[0, 0] == 1.0
        else:
            metre = 1.0 if code == 0 else own.get(code) or units.conversion_factor(code, units.M)
            assert read()["0"].points[0, 0] == pytest.approx(2 * metre, rel=1e-8)


def test_broken_drawings(tmp_path: Path) -> None:
    """A file cut anywhere, damaged, or with numbers that are not finite gives an `InputError`."""
    read, space = drawn(tmp_path / "whole.dxf")
    space.add_line((0, 0), (12345, 0))
    space.add_circle((0, 0), 3)
    read()
    whole, path = (tmp_path / "whole.dxf").read_bytes(), tmp_path / "broken.dxf"
    for data, message in (
        *((whole[: len(whole) * k // 10], "EOF") for k in range(10)),
        (whole[: whole.rindex(b"  0")], "EOF"),
        (whole.replace(b"12345.0", b"nan"), "LINE.* not finite"),
        (whole.replace(b"12345.0", b"1e400"), "LINE.* not finite"),
        (whole.replace(b"12345.0", b"twelve"), "cannot be read"),
    ):
        assert data != whole
        path.write_bytes(data)
        with pytest.raises(InputError, match=message):
            read_dxf(path)


class Compas:
    """What of a mesh of compas counts."""

    def to_vertices_and_faces(self) -> Any:
        return [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [3, 0.5, 0]], [[0, 1, 2, 3], [1, 4, 2]]


@pytest.mark.ranks
def test_meshes_of_compas(comm: MPI.Intracomm) -> None:
    """Quadrilaterals are cut; the area stays, and so do vertices there and back."""
    mesh = from_compas(comm, Compas())
    scene = Scene(mesh, FOIL)
    own = mesh.mesh.topology.index_map(2).size_local
    assert comm.allreduce(float(scene.membrane.cell_areas[:own].sum())) == pytest.approx(2.5)
    found = to_vertices_and_faces(scene)
    assert (found is None) == (comm.rank > 0)
    vertices, faces = comm.bcast(found)
    assert sorted(map(tuple, vertices)) == sorted(map(tuple, Compas().to_vertices_and_faces()[0]))
    assert len(faces) == 3
    from_compas(comm, (vertices, faces))
    for bad in (3, None, ([[0, 0]], [[0, 1]]), ([], []), ([[0, 0, 0]], [["x"]])):
        with pytest.raises(MeshError):
            from_compas(comm, bad)


def test_there_and_back_by_compas(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """A mesh of the library itself, from its file, and the loaded shape back into one."""
    datastructures = pytest.importorskip("compas.datastructures")
    given = datastructures.Mesh.from_meshgrid(dx=4.0, nx=4, dy=2.0, ny=2)
    given.to_obj(tmp_path / "roof.obj")
    scene = Scene(from_compas(comm, datastructures.Mesh.from_obj(tmp_path / "roof.obj")), FOIL)
    assert scene.membrane.cell_areas.sum() == pytest.approx(8.0)
    scene.fix("boundary")
    Solver(scene).advance(pressure=0.1)
    vertices, faces = to_vertices_and_faces(scene)  # type: ignore[misc]
    found = datastructures.Mesh.from_vertices_and_faces(vertices, faces)
    assert found.is_valid() and found.number_of_faces() == 16
    assert found.number_of_vertices() == given.number_of_vertices()
    assert found.area() > 8.0
    found.to_obj(tmp_path / "again.obj")
    again = from_compas(comm, datastructures.Mesh.from_obj(tmp_path / "again.obj"))
    assert Scene(again, FOIL).membrane.cell_areas.sum() == pytest.approx(found.area(), rel=1e-4)


@pytest.mark.ranks
def test_a_step_file(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """A rectangle of two faces that OpenCASCADE writes in mm: parts, edges, area in m."""
    gmsh = pytest.importorskip("gmsh")
    path = comm.bcast(tmp_path) / "roof.step"
    if comm.rank == 0:
        gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("roof")
        left = gmsh.model.occ.addRectangle(0, 0, 0, 4000, 3000)
        right = gmsh.model.occ.addRectangle(4000, 0, 0, 2000, 3000)
        gmsh.model.occ.fragment([(2, left)], [(2, right)])
        gmsh.model.occ.synchronize()
        gmsh.write(str(path))
        gmsh.finalize()
    comm.barrier()
    mesh = meshes.from_step(comm, path, size=1.0)
    assert set(mesh.parts) == {"face 1", "face 2"}
    assert len([name for name in mesh.edges if name.startswith("edge ")]) == 6
    own = mesh.mesh.topology.index_map(2).size_local
    area = comm.allreduce(float(Scene(mesh, FOIL).membrane.cell_areas[:own].sum()))
    assert area == pytest.approx(18.0)
    if comm.rank == 0:
        (tmp_path / "broken.step").write_text("ISO-10303-21; nothing")
        (tmp_path / "none.step").write_text("solid")
    comm.barrier()
    folder = comm.bcast(tmp_path)
    for name, message in (
        ("broken.step", "cannot read"), ("none.step", "not a STEP file"),
        ("away.step", "there is no"),
        ("roof.igs", "there is no"),
    ):  # fmt: skip
        with pytest.raises(MeshError, match=message):
            meshes.from_step(comm, folder / name, size=1.0)
    with pytest.raises(InputError, match=r"size = 0\.0 is not positive"):
        meshes.from_step(comm, path, size=0.0)
    with pytest.raises(InputError, match="unit = 'mile' is not known"):
        meshes.from_step(comm, path, size=1.0, unit="mile")


@pytest.mark.ranks
def test_bad_input(comm: MPI.Intracomm, folder: Path) -> None:
    scene = Scene(meshes.rectangle(comm, 4.0, 4.0, 2.0, structured=True), FOIL)
    for arguments, message in (
        ({"filename": folder / "a.doc"}, "suffix = '.doc' is not known"),
        ({"filename": folder / "a.dxf", "unit": "mile"}, "unit = 'mile' is not known"),
    ):
        with pytest.raises(InputError, match=message):
            write_shape(**{"scene": scene, **arguments})
    assert not list(folder.glob("a.*"))
    with pytest.raises(InputError, match="does not exist"):
        read_dxf(folder / "none.dxf")
    if comm.rank == 0:
        (folder / "wrong.dxf").write_text("no drawing")
    comm.barrier()
    with pytest.raises(InputError, match="cannot be read as DXF"):
        read_dxf(folder / "wrong.dxf")


@pytest.mark.ranks
def test_steps_name_combinations_and_cables(comm: MPI.Intracomm, folder: Path) -> None:
    """As texts of the files, which VTK gives as field data; the history has both."""
    folder = folder / "run"
    scene = sheet(comm, 4, material=FOIL, side=8.0)
    scene.put_load((0.0, 0.0, -0.05), name="snow")
    solver = advanced(Solver(scene, results=folder), pressure=0.1)
    scene.lay_cable(Cable(1e4), [(0.0, 3.3), (8.0, 4.2)], tension=1.0, name="ridge")
    solver.combine({"heavy snow": {"snow": 1.0}})

    def text(name: str) -> str:
        return " ".join(str(k) for k in (*name.encode(), 0))

    first, last = ((folder / f"steps/surface_00000{k}.vtu").read_bytes() for k in (0, 1))
    assert b"FieldData" not in first
    assert f">{text('heavy snow')}<".encode() in last
    cables = (folder / "steps/cables_000001.vtu").read_bytes()
    assert f">{text('ridge')}<".encode() in cables
    assert solver.history["case"][-1] == "heavy snow"
    assert "tension ridge" in solver.history.columns
    pyvista = pytest.importorskip("pyvista")
    assert list(pyvista.read(folder / "steps/cables_000001.vtu").field_data["names"]) == ["ridge"]
