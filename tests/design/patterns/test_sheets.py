"""Sheets: outlines, marks, nesting, DXF files, pictures, tables in the report."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced
from mpi4py import MPI
from pattern_surfaces import FABRIC, half_cylinder, hypar, pieces_of

from crms_fenicsx import InputError, Solver, patterns
from crms_fenicsx.design.patterns.sheet import drawings, offset

pytestmark = pytest.mark.filterwarnings("ignore:flatten")

SHEET = patterns.Sheet(2.0, allowance=0.03, rim=0.05, edges={"seam 1": 0.04}, marks=1.5, gap=0.1)
WIDTH = 30.0 * np.sin(np.pi / 24)
"""Of a strip of the half cylinder."""


@pytest.fixture(scope="module")
def pattern(comm: MPI.Intracomm) -> patterns.Pattern:
    return patterned(comm)


def patterned(comm: MPI.Intracomm) -> patterns.Pattern:
    """Four strips of a half cylinder, 8 long."""
    mesh = half_cylinder(comm, 4, 3, 8)
    return patterns.flatten(pieces_of(mesh), FABRIC)


class TestOffset:
    """Polylines moved to their right."""

    def test_square_grows(self) -> None:
        square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
        grown = offset(square, np.array([0.1, 0.2, 0.1, 0.2]), closed=True)
        np.testing.assert_allclose(
            grown, [(-0.2, -0.1), (1.2, -0.1), (1.2, 1.1), (-0.2, 1.1)], atol=1e-12
        )

    def test_circle_keeps_its_distance(self) -> None:
        a = np.linspace(0.0, 2 * np.pi, 101)[:-1]
        circle = np.stack([np.cos(a), np.sin(a)], axis=1)
        grown = offset(circle, np.full(100, 0.1), closed=True)
        np.testing.assert_allclose(np.hypot(*grown.T), 1.0 + 0.1 / np.cos(np.pi / 100))

    def test_sharp_corners_are_cut_off(self) -> None:
        needle = np.array([(0.0, 0.0), (10.0, 0.1), (0.0, 0.2)])
        grown = offset(needle, np.full(3, 0.05), closed=True)
        assert len(grown) == 4 and grown[:, 0].max() < 10.1

    def test_allowance_steps_on_a_straight_line(self) -> None:
        line = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)])
        found = offset(line, np.array([0.1, 0.2]), closed=False)
        np.testing.assert_allclose(found, [(0, -0.1), (1, -0.1), (1, -0.2), (2, -0.2)])


def test_outlines_have_their_allowances(pattern: patterns.Pattern) -> None:
    """At seams, at one with its own, and at all other edges."""
    first, second, *_ = drawings(pattern, SHEET)
    for one, sides in ((first, 0.04 + 0.05), (second, 0.04 + 0.03)):
        np.testing.assert_allclose(one.extent, [8.0 + 2 * 0.05, WIDTH + sides], rtol=1e-6)
        np.testing.assert_allclose(np.ptp(one.seam_line, axis=0), [8.0, WIDTH], rtol=1e-6)
    assert len(first.overlaps) == 1 and len(second.overlaps) == 2


def test_match_marks_meet(pattern: patterns.Pattern) -> None:
    """Both sides of a seam have the same numbers, as far from its start."""
    first, second, *_ = drawings(pattern, SHEET)
    one = {number: line[0] for number, line in first.marks}
    other = {number: line[0] for number, line in second.marks if line[0][1] < WIDTH / 2}
    top = {number: line[0] for number, line in second.marks if line[0][1] > WIDTH / 2}
    assert sorted(one) == [1, 2, 3, 4, 5]
    shared = other if abs(other[1][0] - one[1][0]) < 1e-6 else top
    for number, place in one.items():
        np.testing.assert_allclose(shared[number][0], place[0], atol=1e-6)
    steps = np.abs(np.diff([one[k][0] for k in sorted(one)]))
    np.testing.assert_allclose(steps, 1.5, rtol=1e-9)


def test_nesting_uses_the_width(pattern: patterns.Pattern) -> None:
    """Pieces lie side by side where the roll is wide enough, and do not overlap."""
    narrow = patterns.nest(pattern, patterns.Sheet(4.2, allowance=0.03, rim=0.05, gap=0.1))
    assert len(narrow.rows) == 4
    assert narrow.length == pytest.approx(4 * 8.1 + 3 * 0.1)
    wide = patterns.nest(pattern, patterns.Sheet(8.4, allowance=0.03, rim=0.05, gap=0.1))
    assert len(wide.rows) == 2 and wide.length == pytest.approx(2 * 8.1 + 0.1)
    boxes = [(one.cut_line.min(axis=0), one.cut_line.max(axis=0)) for one in wide.drawings]
    for k, (low, high) in enumerate(boxes):
        assert low.min() >= 0.0 and high[1] <= 8.4
        for other_low, other_high in boxes[:k]:
            assert (low >= other_high).any() or (other_low >= high).any()
    area = 2 * 8.1 * (2 * WIDTH + 2 * 0.08 + 2 * 0.06 - 2 * 0.03)
    used = sum(8.1 * one.extent[1] for one in wide.drawings)
    assert wide.waste == pytest.approx(1.0 - used / (8.4 * wide.length), rel=1e-6)
    assert used == pytest.approx(area, rel=0.02)


@pytest.mark.ranks
def test_dxf_is_read_back(comm: MPI.Intracomm, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Without errors, with all layers, the outline's length, and the unit."""
    ezdxf = pytest.importorskip("ezdxf")
    path = comm.bcast(tmp_path_factory.mktemp("dxf") if comm.rank == 0 else None) / "roof.dxf"
    pattern = patterned(comm)
    sheet = patterns.Sheet(4.2, allowance=0.03, rim=0.05)
    patterns.write_dxf(pattern, path, sheet, unit="m")
    comm.barrier()
    document = ezdxf.readfile(path)
    assert not document.audit().errors and document.units == 6
    space = document.modelspace()
    kinds = {entity.dxf.layer for entity in space}
    assert kinds == {"CUT", "SEAM", "OVERLAP", "MARK", "WARP", "TEXT", "ROLL"}
    seams = [np.array(line.get_points("xy")) for line in space.query("LWPOLYLINE[layer=='SEAM']")]
    assert len(seams) == 4
    for line in seams:
        np.testing.assert_allclose(np.ptp(line, axis=0), [8.0, WIDTH], rtol=1e-6)
    texts = {entity.dxf.text for entity in space.query("TEXT")}
    assert {"piece 1", "seam 1", "boundary", "5"} <= texts


def test_dxf_with_a_line_break_in_a_name(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """The text of a seam stays on one line."""
    ezdxf = pytest.importorskip("ezdxf")
    mesh = half_cylinder(comm, 2, 3, 8)
    (edge,) = [name for name in mesh.edges if name != "boundary"]
    seam = dataclasses.replace(patterns.edge_line(mesh, edge), name="left\n  0\nEOF")
    pattern = patterns.flatten(patterns.cut(mesh, [seam]), FABRIC)
    patterns.write_dxf(pattern, tmp_path / "roof.dxf", patterns.Sheet(9.0))
    document = ezdxf.readfile(tmp_path / "roof.dxf")
    assert not document.audit().errors
    assert "left   0 EOF" in {one.dxf.text for one in document.modelspace().query("TEXT")}


def test_without_ezdxf_nothing_is_written(
    pattern: patterns.Pattern, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(ImportError, match="python3-ezdxf"):
        patterns.write_dxf(pattern, tmp_path / "roof.dxf", patterns.Sheet(4.2))
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["svg", "pdf", "png"])
def test_pictures_are_written(pattern: patterns.Pattern, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"sheets.{suffix}"
    patterns.draw_sheets(pattern, path, patterns.Sheet(4.2, allowance=0.03), unit="m")
    data = path.read_bytes()
    assert len(data) > 5000
    if suffix == "pdf":
        assert data.count(b"/Type /Page ") == 5  # the roll and four pieces
    roll = patterns.draw_sheets(pattern, None, patterns.Sheet(4.2))
    assert roll is not None
    legend = roll.axes[0].get_legend()  # beside the roll
    assert legend is not None and len(legend.get_texts()) == 5
    roll.canvas.draw()
    assert legend.get_window_extent().x0 >= roll.axes[0].get_window_extent().x1


@pytest.mark.ranks
def test_report_has_the_pattern(
    comm: MPI.Intracomm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Its pieces and seams, and what the sewn roof has got, in the page and as CSV."""
    folder = comm.bcast(tmp_path_factory.mktemp("report") if comm.rank == 0 else None)
    pattern = patterns.flatten(
        pieces_of(hypar(comm, 4)), FABRIC, shrink=patterns.shrink_for(FABRIC, 2.0)
    )
    scene = patterns.sew(pattern)
    scene.fix("boundary")
    solver = advanced(Solver(scene))
    found = patterns.compare(solver, pattern, 2.0)
    sections = patterns.report_sections(
        pattern, patterns.Sheet(3.0, allowance=0.05), found, unit="m", force="kN"
    )
    with pytest.raises(InputError, match="sections"):
        solver.report(folder / "roof.html", sections=["text"])
    solver.report(folder / "roof.html", pictures=[], sections=sections, unit="m", force="kN")
    comm.barrier()
    page = (folder / "roof.html").read_text()
    for text in (
        "Cutting pattern",
        "Sewn from its pieces",
        "piece 3",
        "seam 2",
        "The pieces on the",
    ):
        assert text in page
    rows = (folder / "roof_pieces.csv").read_text().splitlines()
    assert len(rows) == 4 and rows[0].startswith("Piece,Area [m")
    assert len((folder / "roof_sewn.csv").read_text().splitlines()) == 5
    differences = [
        float(row.split(",")[3]) for row in (folder / "roof_seams.csv").read_text().splitlines()[1:]
    ]
    assert max(differences) < 1e-9


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda p, f: patterns.Sheet(0.1, allowance=0.05), "twice"),
        (lambda p, f: patterns.Sheet(4.0, rim=-1.0), "negative"),
        (lambda p, f: patterns.Sheet(4.0, marks=0.0), "marks"),
        (lambda p, f: patterns.nest(p, patterns.Sheet(3.0)), r"piece 1 \(3.9"),
        (lambda p, f: patterns.nest(p, patterns.Sheet(5.0, edges={"x": 0.1})), "no edge"),
        (lambda p, f: patterns.write_dxf(p, f / "a.dxf", patterns.Sheet(3.0)), "wider"),
        (
            lambda p, f: patterns.write_dxf(p, f / "a.dwg", patterns.Sheet(5.0)),
            "end in .dxf",
        ),
        (lambda p, f: patterns.write_dxf(p, f / "a.dxf", patterns.Sheet(5.0), unit="mile"), "mile"),
        (lambda p, f: patterns.draw_sheets(p, f / "a.doc", patterns.Sheet(5.0)), "suffix"),
        (
            lambda p, f: patterns.draw_sheets(3, f / "a.svg", patterns.Sheet(5.0)),
            "of type int",
        ),
        (
            lambda p, f: patterns.write_dxf(3, f / "a.dxf", patterns.Sheet(5.0)),
            "of type int",
        ),
        (lambda p, f: patterns.report_sections(3, patterns.Sheet(5.0)), "of type int"),
    ],
)
def test_bad_sheets_are_named_and_nothing_is_written(  # type: ignore[no-untyped-def]
    comm: MPI.Intracomm, call, text: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = comm.bcast(tmp_path_factory.mktemp("bad") if comm.rank == 0 else None)
    pattern = patterned(comm)
    with pytest.raises(InputError, match=text):
        call(pattern, folder)
    assert not any(folder.iterdir())


@pytest.mark.ranks
@pytest.mark.parametrize("suffix", ["dxf", "pdf"])
def test_a_file_that_cannot_be_written_leaves_no_half_one(
    comm: MPI.Intracomm, suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A folder in its place, a file instead of its folder, a writer that fails halfway: what was
    there stays, on all ranks alike."""
    pytest.importorskip("ezdxf")
    folder = comm.bcast(tmp_path_factory.mktemp("files") if comm.rank == 0 else None)
    pattern, sheet = patterned(comm), patterns.Sheet(4.2)
    write = patterns.write_dxf if suffix == "dxf" else patterns.draw_sheets
    if comm.rank == 0:
        (folder / f"taken.{suffix}").mkdir()
        (folder / "file").write_text("")
        (folder / f"old.{suffix}").write_text("old")
    comm.barrier()
    for path in (folder / f"taken.{suffix}", folder / "file" / f"roof.{suffix}"):
        with pytest.raises(InputError, match="cannot be written"):
            write(pattern, path, sheet)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(InputError, match="disk is full"):
        patch.setattr(
            *(("ezdxf.document.Drawing.saveas", _half_a_file) if suffix == "dxf" else
              ("matplotlib.backends.backend_pdf.PdfPages.savefig", _half_a_page))
        )  # fmt: skip
        write(pattern, folder / f"old.{suffix}", sheet)
    comm.barrier()
    assert (folder / f"old.{suffix}").read_text() == "old"
    left = sorted(path.name for path in folder.rglob("*"))
    assert left == ["file", f"old.{suffix}", f"taken.{suffix}"]


def _half_a_file(document: object, path: str) -> None:
    Path(path).write_text("half")
    raise OSError("the disk is full")


def _half_a_page(pages: object, *arguments: object, **options: object) -> None:
    raise OSError("the disk is full")
