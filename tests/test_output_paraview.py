"""Series for ParaView: read back with meshio, on any number of ranks."""

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx.errors import InputError
from crms_fenicsx.output import Line, Series, Surface

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(COMM.bcast(str(tmp_path)))


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


def test_pieces_come_back_exactly(folder: Path) -> None:
    series = Series(folder / "out", COMM)
    series.write(0.1, strip())
    series.write(0.1 + 0.2, strip(2.5))
    entries = listed(folder / "out" / "surface.pvd")
    assert [entry[:2] for entry in entries] == [
        (time, rank) for time in (0.1, 0.1 + 0.2) for rank in range(COMM.size)
    ]
    mesh = meshio.read(folder / "out" / entries[COMM.size + COMM.rank][2])
    given = strip(2.5)
    np.testing.assert_array_equal(mesh.points, given.points)
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], given.triangles)
    for name, values in given.point_data.items():
        np.testing.assert_array_equal(mesh.point_data[name], values)
    for name, values in given.cell_data.items():
        np.testing.assert_array_equal(mesh.cell_data[name][0], values)
    assert not (folder / "out" / "cables.pvd").exists()


def test_files_are_compressed_binary(folder: Path) -> None:
    Series(folder, COMM).write(0.0, strip())
    COMM.barrier()
    text = (folder / "steps" / f"surface_000000_{COMM.rank:04d}.vtu").read_text()
    assert 'compressor="vtkZLibDataCompressor"' in text
    assert 'format="binary"' in text
    assert 'format="ascii"' not in text


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
    mesh = meshio.read(folder / "steps" / "cables_000001.vtu")
    segments = mesh.cells_dict["line"]
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
    np.testing.assert_array_equal(mesh.cell_data["tension"][0], tension)
    np.testing.assert_array_equal(mesh.cell_data["force"][0], force)
    np.testing.assert_array_equal(mesh.cell_data["line"][0], number)
    np.testing.assert_array_equal(mesh.point_data["slip"], [0.1, 0.2, 0.3] + 5 * [np.nan])


def test_a_new_run_starts_anew_and_touches_nothing_else(folder: Path) -> None:
    first = Series(folder, COMM)
    for time in range(3):
        first.write(time, strip(), [Line([[0, 0, 0], [1, 1, 1]])])
    if COMM.rank == 0:
        (folder / "steps" / "surface_000000_mine.vtu").write_text("mine")
        (folder / "steps" / ".partial-surface_000007_0000.vtu").write_text("half")
        (folder / "history.csv").write_text("step\n")
    second = Series(folder, COMM)
    assert len(listed(folder / "cables.pvd")) == 3  # until the new run has a result
    second.write(9.0, strip())
    assert [entry[0] for entry in listed(folder / "surface.pvd")] == COMM.size * [9.0]
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    assert names == {"surface.pvd", "history.csv", "steps/surface_000000_mine.vtu"} | {
        f"steps/surface_000000_{rank:04d}.vtu" for rank in range(COMM.size)
    }


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
    assert len(listed(folder / "surface.pvd")) == 2 * COMM.size


def test_ranks_without_triangles(folder: Path) -> None:
    series = Series(folder, COMM)
    last = COMM.rank == COMM.size - 1
    series.write(0.0, strip() if last else Surface([], []))
    name = f"steps/surface_000000_{COMM.size - 1:04d}.vtu"
    assert listed(folder / "surface.pvd") == [(0.0, 0, name)]
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
        (Surface(np.zeros((3, 3)), [[0.0, 1.0, 2.0]]), [], 1.0, "give integers"),
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
    assert len(listed(folder / "surface.pvd")) == COMM.size


def test_a_folder_that_cannot_be_written(folder: Path) -> None:
    if COMM.rank == 0:
        (folder / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        Series(folder / "file" / "results", COMM)
