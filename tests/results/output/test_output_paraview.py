"""Series for ParaView: read back exactly, on any number of ranks."""

import os
import resource
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from vtu_file import read_vtu

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output import Line, Series, Surface

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]
COMM = MPI.COMM_WORLD


def strip(height: float = 0.0) -> Surface:
    """Return this rank's piece of a strip: two triangles that tell which rank they are from."""
    x = 10.0 * COMM.rank
    return Surface(
        [[x, 0, height], [x + 10, 0, height], [x + 10, 5, 1 / 3], [x, 5, height]],
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        {"u": np.arange(12.0).reshape(4, 3) / 7, "w": np.full(4, COMM.rank, dtype=np.float32)},
        {"folded": np.array([True, False]), "stress": np.arange(6.0).reshape(2, 3)},
    )


def listed(path: Path) -> list[tuple[float, int, str]]:
    COMM.barrier()
    root = ElementTree.parse(path).getroot()
    assert (root.tag, root.attrib["type"]) == ("VTKFile", "Collection")
    found = [
        (float(e.attrib["timestep"]), int(e.attrib["part"]), e.attrib["file"])
        for e in root.iter("DataSet")
    ]
    COMM.barrier()
    return found


def everyones(values: object) -> np.ndarray:
    """The rows of all ranks, one rank's after the other's."""
    return np.concatenate(COMM.allgather(np.asarray(values)))


def test_pieces_come_back_exactly(folder: Path) -> None:
    series = Series(folder / "out", COMM)
    series.write(0.1, strip())
    series.write(0.1 + 0.2, strip(2.5))
    entries = listed(folder / "out" / "surface.pvd")
    assert entries == [
        (0.1, 0, "steps/surface_000000.vtu"),
        (0.1 + 0.2, 0, "steps/surface_000001.vtu"),
    ]
    mesh = read_vtu(folder / "out" / entries[1][2])
    given = strip(2.5)
    np.testing.assert_array_equal(mesh.points, everyones(given.points))
    assert set(mesh.types.tolist()) == {5}
    np.testing.assert_array_equal(
        mesh.cells, everyones(np.asarray(given.triangles) + 4 * COMM.rank)
    )
    for name, values in given.point_data.items():
        assert mesh.point_data[name].dtype == np.asarray(values).dtype
        np.testing.assert_array_equal(mesh.point_data[name], everyones(values))
    for name, values in given.cell_data.items():
        np.testing.assert_array_equal(mesh.cell_data[name], everyones(values))
    assert not (folder / "out" / "cables.pvd").exists()


def test_shared_points_are_there_once(folder: Path) -> None:
    """Two triangles on each rank of a band: neighbouring ranks share two points."""
    rank, last = COMM.rank, COMM.rank == COMM.size - 1
    x = np.array([[rank, 0, 0], [rank, 1, 0], [rank + 1, 0, 0], [rank + 1, 1, 0]], dtype=float)
    homes = np.array([(rank, 0), (rank, 1), (rank, 2), (rank, 3)])
    if not last:  # the next rank's copy is the one that counts
        x[2:, 2], homes[2:] = 9.0, [(rank + 1, 0), (rank + 1, 1)]
    order = [2, 0, 3, 1]  # others' points may come before the own
    surface = Surface(x[order], [[1, 0, 2], [1, 2, 3]], {"y": x[order, 1]}, {}, homes[order])
    Series(folder, COMM).write(0.0, surface)
    COMM.barrier()
    mesh = read_vtu(folder / "steps" / "surface_000000.vtu")
    n = COMM.size
    assert mesh.points[:, 2].tolist() == [0.0] * (2 * n + 2)
    assert len(np.unique(mesh.points, axis=0)) == 2 * n + 2
    np.testing.assert_array_equal(mesh.point_data["y"], mesh.points[:, 1])
    corners = mesh.points[mesh.cells]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    np.testing.assert_array_equal(areas, 2 * n * [0.5])
    for change in ((1, 0), (0, 4), (0, -1), None):
        bad = homes[:3] if change is None else homes + np.array(change)
        wrong = Surface(x[order], [[1, 0, 2]], homes=bad[order] if len(bad) == 4 else bad)
        with pytest.raises(InputError, match="homes"):
            Series(folder, COMM).write(0.0, wrong)


def test_vtk_reads_the_same(folder: Path) -> None:
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    Series(folder, COMM).write(0.0, strip(), [Line([[0, 0, 0], [1, 1, 1]], {"t": 5.0})])
    COMM.barrier()
    for name, corners in (("surface", 3), ("cables", 2)):
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(folder / "steps" / f"{name}_000000.vtu"))
        reader.Update()
        grid, mesh = reader.GetOutput(), read_vtu(folder / "steps" / f"{name}_000000.vtu")
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), mesh.points)
        cells = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, corners)
        np.testing.assert_array_equal(cells, mesh.cells)
        for key, values in mesh.cell_data.items():
            found = vtk_to_numpy(grid.GetCellData().GetArray(key))
            np.testing.assert_array_equal(found, values)


def test_files_are_raw(folder: Path) -> None:
    Series(folder, COMM).write(0.0, strip())
    COMM.barrier()
    first = (folder / "steps/surface_000000.vtu").read_bytes()
    assert b'<AppendedData encoding="raw">\n_' in first
    assert b"ascii" not in first
    #       points, cells (int32), u, w as float32, folded, stress, sizes of the arrays
    numbers = 4 * 24 + 2 * (12 + 4 + 1) + 4 * 24 + 4 * 4 + 2 * 1 + 2 * 24
    assert COMM.size * numbers + 8 * 8 < len(first) < COMM.size * numbers + 2000


def test_a_full_disk_is_told_on_all_ranks(folder: Path) -> None:
    """A limit of the file size stands for it: the writing fails half-way, on some ranks."""
    series = Series(folder, COMM)
    series.write(0.0, strip())
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    many = np.zeros((3000, 3))
    big = Surface(many, [[0, 1, 2]])
    resource.setrlimit(resource.RLIMIT_FSIZE, (40000, hard))
    try:
        with pytest.raises(InputError, match=r"surface_000001\.vtu cannot be written.*free some"):
            series.write(1.0, big)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    COMM.barrier()
    assert [path.name for path in (folder / "steps").iterdir()] == ["surface_000000.vtu"]
    assert len(listed(folder / "surface.pvd")) == 1
    series.write(1.0, big)
    assert len(listed(folder / "surface.pvd")) == 2


def test_lines_with_data_of_all_kinds(folder: Path) -> None:
    lines = [
        Line(
            np.array([[0, 0, 0], [1, 0, 0], [2, 0, 1.5]]),
            {"tension": 60.5, "slip": [0.1, 0.2, 0.3]},
        ),
        Line([[0, 1, 0], [0, 2, 0]], {"tension": 7, "force": [4.0]}, name="cable 2"),
        Line([[5, 5, 5], [6, 6, 6], [7, 7, 8]], {"force": [1.0, 2.0]}),
    ]
    series = Series(folder, COMM)
    series.write(0.0, strip())
    series.write(1.0, strip(), lines if COMM.rank == 0 else [])
    assert listed(folder / "cables.pvd") == [(1.0, 0, "steps/cables_000001.vtu")]
    mesh = read_vtu(folder / "steps" / "cables_000001.vtu")
    segments = mesh.cells
    # line by line, segment by segment
    expected, tension, force, number = [], [], [], []
    for index, line in enumerate(lines):
        points = np.asarray(line.points, dtype=float)
        for k in range(len(points) - 1):
            expected.append(points[k : k + 2])
            tension.append(line.data.get("tension", np.nan))
            force.append(np.asarray(line.data["force"])[k] if "force" in line.data else np.nan)
            number.append(index)
    np.testing.assert_array_equal(mesh.points[segments], expected)
    assert set(mesh.types.tolist()) == {3}
    np.testing.assert_array_equal(mesh.cell_data["tension"], tension)
    np.testing.assert_array_equal(mesh.cell_data["force"], force)
    np.testing.assert_array_equal(mesh.cell_data["line"], number)
    np.testing.assert_array_equal(mesh.point_data["slip"], [0.1, 0.2, 0.3] + 5 * [np.nan])


def test_a_new_run_starts_anew_and_touches_nothing_else(folder: Path) -> None:
    first = Series(folder, COMM)
    for time in range(3):
        first.write(time, strip(), [Line([[0, 0, 0], [1, 1, 1]])])
    if COMM.rank == 0:
        (folder / "steps" / "surface_000000_mine.vtu").write_text("mine")
        (folder / "steps" / ".partial-surface_000007.vtu").write_text("half")
        (folder / "history.csv").write_text("step\n")
    second = Series(folder, COMM)
    assert len(listed(folder / "cables.pvd")) == 3  # until the new run has a result
    second.write(9.0, strip())
    assert [entry[0] for entry in listed(folder / "surface.pvd")] == [9.0]
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    mine = {"history.csv", "steps/surface_000000_mine.vtu"}
    assert names == {"surface.pvd", "steps/surface_000000.vtu"} | mine


def test_a_collection_lists_complete_files_only(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    series = Series(folder, COMM)
    series.write(0.0, strip())
    before = listed(folder / "surface.pvd")
    replace = os.replace

    def refuse_the_cables(source: Path, target: Path) -> None:
        if "cables" in target.name:
            raise OSError(28, "No space left on device")
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refuse_the_cables)
        with pytest.raises(InputError, match=r"cables_000001\.vtu cannot be written"):
            series.write(1.0, strip(), [Line([[0, 0, 0], [1, 1, 1]])])
    assert listed(folder / "surface.pvd") == before
    series.write(1.0, strip(), [Line([[0, 0, 0], [1, 1, 1]])])
    assert len(listed(folder / "surface.pvd")) == 2


def test_ranks_without_triangles(folder: Path) -> None:
    series = Series(folder, COMM)
    last = COMM.rank == COMM.size - 1
    series.write(0.0, strip() if last else Surface([], []))
    assert listed(folder / "surface.pvd") == [(0.0, 0, "steps/surface_000000.vtu")]
    assert len(read_vtu(folder / "steps" / "surface_000000.vtu").points) == 4
    with pytest.raises(InputError, match="no triangle on any rank"):
        series.write(1.0, Surface([], []))


def test_pieces_with_different_data(folder: Path) -> None:
    if COMM.size == 1:
        pytest.skip("needs two ranks")
    surface = strip()
    if COMM.rank == 1:
        surface = Surface(surface.points, surface.triangles)
    with pytest.raises(InputError, match="rank 1 has"):
        Series(folder, COMM).write(0.0, surface)


@pytest.mark.parametrize(
    ("surface", "lines", "time", "message"),
    [
        (Surface([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]), [], 1.0, r"shape \(3, 2\)"),
        (Surface([[0, 0, np.nan]], [[0, 0, 0]]), [], 1.0, "finite"),
        (Surface(np.zeros((3, 3)), [[0, 1, 3]]), [], 1.0, "vertices 0 to 3"),
        (Surface(np.zeros((3, 3)), [[-1, 1, 2]]), [], 1.0, "vertices -1"),
        (Surface(np.zeros((3, 3)), [[0.0, 1.0, 2.0]]), [], 1.0, "expected integers"),
        (Surface(np.zeros((3, 3)), [[0, 1, 2]], {"a": np.zeros(2)}), [], 1.0, "point data 'a'"),
        (Surface(np.zeros((3, 3)), [[0, 1, 2]], {}, {"a": [1j]}), [], 1.0, "complex"),
        (Surface(np.zeros((3, 3)), [[0, 1, 2]]), [Line([[0, 0, 0]])], 1.0, "1 points"),
        (
            Surface(np.zeros((3, 3)), [[0, 1, 2]]),
            [Line(np.zeros((4, 3)), {"t": [1, 2]}, "A")],
            1.0,
            "line 'A': 't' has shape",
        ),
        (Surface(np.zeros((3, 3)), [[0, 1, 2]]), [], 0.0, "times must grow"),
        (Surface(np.zeros((3, 3)), [[0, 1, 2]]), [], float("nan"), "times must grow"),
    ],
)
def test_bad_input_on_one_rank_reaches_all(
    folder: Path, surface: Surface, lines: list[Line], time: float, message: str
) -> None:
    series = Series(folder, COMM)
    series.write(0.0, strip())
    with pytest.raises(InputError, match=message):
        series.write(time, surface if COMM.rank == 0 else strip(), lines)
    assert len(listed(folder / "surface.pvd")) == 1


def test_a_folder_that_cannot_be_written(folder: Path) -> None:
    if COMM.rank == 0:
        (folder / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        Series(folder / "file" / "results", COMM)
