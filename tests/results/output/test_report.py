"""Reports: what is in the page and its tables, and what is refused before anything is written."""

from __future__ import annotations

import base64
import io
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from PIL import Image
from report_page import Page, read_csv
from walled_roof import roof_mesh

from crms_fenicsx import Cable, InputError, OrthotropicMembrane, Solver, __version__
from crms_fenicsx.foundation.runtime.checks import as_counted
from crms_fenicsx.results.cable_order import CableOrder, Order
from crms_fenicsx.results.output.report import pictures as pictures_of_reports
from crms_fenicsx.results.output.report import sections
from crms_fenicsx.results.output.report.case import case_of, shape_of
from crms_fenicsx.results.output.report.foundation_tables import cables_to_order
from crms_fenicsx.results.output.report.page import (
    BarChart,
    PagePart,
    PageSection,
    Paragraph,
    Table,
    Units,
    check_template,
    number,
    page,
    per_cent,
    place,
    shown,
)
from crms_fenicsx.results.output.report.pictures import pictured

FABRIC = OrthotropicMembrane(800.0, 500.0, 60.0, nu21=0.1, thickness=1.0, warp=(0.0, 1.0, 0.0))
TABLE = {"snow <&> ice": {"snow": 1.0}, "storm": {"wind": 1.0, "pressure": 0.5}}


def tent(comm: MPI.Intracomm, on_one_rank: bool = False) -> Solver:
    """A roof of two halves over a wall, a cable across it, snow and wind."""
    ranks = (lambda x: np.full(len(x), comm.size - 1)) if on_one_rank else None
    mesh = roof_mesh(comm, ranks, n=4, size=8.0, height=2.0, rise=1.0, levels=1)
    scene = clamped(mesh, FABRIC, pressure_on=["roof"])
    scene.put_load((0.0, 0.0, -0.3), name="snow", per="plan")
    scene.put_wind(0.5, -0.6)
    solver = advanced(Solver(scene), pressure=0.4)
    scene.lay_cable(Cable(EA=2000.0), [(0.0, 5.0), (8.0, 5.5)], tension=8.0, name="ridge")
    solver.advance()
    scene.set_strengths({"roof": (30.0, 25.0)}, cables=40.0)
    return solver


@pytest.mark.ranks
def test_a_report_of_combinations(comm: MPI.Intracomm, folder: Path) -> None:
    solver = tent(comm)
    scene = solver.scene
    u, tension = scene.u.x.array.copy(), scene.cables[0].tension
    found = solver.combine(TABLE)
    solver.report(
        folder / "out" / "tent.html", found, title="Tent <1> & roof", unit="m", force="kN",
        about={"Project": "A & B"}, pictures=["tension", "utilisation"],
    )  # fmt: skip
    comm.barrier()
    assert np.array_equal(scene.u.x.array, u)
    assert scene.cables[0].tension == tension
    # what the states say that the combinations led to
    expected = {}
    states = {"LC0": found["storm"].base} | {name: one.snapshot for name, one in found.items()}
    for name, state in states.items():
        solver.restore(state)
        every = np.concatenate(comm.allgather(solver.results().warp_weft))
        expected[name] = (every[:, 0].max(), scene.cables[0].tension, solver.summary())

    text = (folder / "out" / "tent.html").read_text(encoding="utf-8")
    assert len(text.encode()) < 5e6
    assert re.findall(r"""(?:src|href)\s*=\s*["'](?!data:|#)""", text) == []
    assert "@import" not in text
    assert "url(" not in text
    assert "<script" not in text
    page = Page(text)
    assert any("Tent <1> & roof" in word for word in page.words)
    assert sum("snow <&> ice" in word for word in page.words) > 5
    assert len(page.images) == 2 + 2 + 3 * 2 + 2  # model, loads, cases, foundations
    for image in page.images:
        assert image["alt"]
        data = base64.b64decode((image["src"] or "").removeprefix("data:image/png;base64,"))
        assert data.startswith(b"\x89PNG")

    out = folder / "out"
    names = {path.name for path in out.iterdir()}
    assert names == {"tent.html"} | {
        f"tent_{table}.csv"
        for table in ("combinations", "overview", "membrane", "envelope", "drainage", "cables",
                      "cable_envelope", "supports", "support_lines", "balance", "anchors",
                      "foundation_points", "foundations", "foundation_envelope", "governing", "rim",
                      "verification")
    }  # fmt: skip
    warp = "Section force along warp [kN/m]"
    rows = [row for row in read_csv(out / "tent_membrane.csv") if row["Result"] == warp]
    for name, (largest, _, summary) in expected.items():
        row = next(r for r in rows if (r["Combination"], r["Part"]) == (name, "whole membrane"))
        assert float(row["Largest"]) == pytest.approx(largest, rel=1e-9)
        where = [float(row[f"largest at {x} [m]"]) for x in "xyz"]
        np.testing.assert_allclose(where, summary.membrane.largest["warp"].at, rtol=1e-9)
    envelope = read_csv(out / "tent_envelope.csv")
    worst = max(expected, key=lambda name: expected[name][0])
    row = next(r for r in envelope if (r["Part"], r["Result"]) == ("whole membrane", warp))
    assert float(row["Largest"]) == pytest.approx(expected[worst][0], rel=1e-9)
    assert row["Governs largest"] == worst
    tensions = {name: one[1] for name, one in expected.items()}
    for cable in read_csv(out / "tent_cables.csv"):
        assert float(cable["Mean [kN]"]) == pytest.approx(tensions[cable["Combination"]], rel=1e-9)
    (cable,) = page.tables["Envelope of the cables' tensions"][1:]
    assert cable[0] == "ridge"
    assert cable[5] == per_cent(max(tensions.values()) / 40.0)
    # the wall has no strengths, and no utilisation
    used = {row["Part"] for row in envelope if row["Result"] == "Utilisation [%]"}
    assert used == {"whole membrane", "roof"}
    # the same utilisation in the summaries, the envelope, the card and the verdict
    judged = max(one[2].membrane.largest["utilisation"].value for one in expected.values())
    labels = ("whole membrane", "Utilisation [%]")
    row = next(row for row in envelope if (row["Part"], row["Result"]) == labels)
    assert float(row["Largest"]) == pytest.approx(100 * judged, rel=1e-9)
    assert per_cent(judged) in page.words
    assert any(f"is loaded to {per_cent(judged)} of its strength" in word for word in page.words)
    for case in read_csv(out / "tent_verification.csv"):
        assert case["Verdict"] == "passed", case
    assert any("passed all checks" in word for word in page.words)
    cases = [row[:2] for row in page.tables["Inner pressure and factors of the loads"][1:]]
    assert cases == [["LC0", "base state"], ["LC1", "snow <&> ice"], ["LC2", "storm"]]
    for row in read_csv(out / "tent_balance.csv"):
        assert not row["Sum of"].startswith("all") or row["Sum of"].endswith("to 1e-08)")


def test_pictures_to_be_compared_have_one_scale(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of combinations whose values are small, and from 0."""
    solver = tent(comm)
    found = solver.combine({"calm": {"pressure": 0.02}, "storm": {"pressure": 2.0}})
    drawn: dict[str, list[tuple[float, float]]] = {"displacement": [], "stress": []}

    def png(solver: Solver, **options: Any) -> bytes:
        if "limits" in options:  # pictures of combinations
            drawn[options["colour"]].append(options["limits"])
        return b""

    monkeypatch.setattr(pictures_of_reports, "draw_png", png)
    solver.report(folder / "two.html", found, pictures=["displacement", "stress"])
    forces = []
    for one in found.values():
        solver.restore(one.snapshot)
        forces.append(solver.summary().membrane.largest["true force 1"].value)
    assert max(forces) > 5.0 * min(forces)
    assert [len(limits) for limits in drawn.values()] == [3, 3]
    for limits in drawn.values():
        assert len(set(limits)) == 1 and limits[0][0] == 0.0


def test_pictures_of_reports_keep_their_colours(comm: MPI.Intracomm, folder: Path) -> None:
    """Reduced to 256 colours; of those at the ends of a bar there are few pixels."""
    solver, options = tent(comm), {"colour": "displacement", "dpi": 100}
    solver.draw(folder / "whole.png", width=4.6, **options)
    png = pictures_of_reports.draw_png(solver, **options)
    with Image.open(folder / "whole.png") as whole, Image.open(io.BytesIO(png)) as reduced:
        wanted, got = (np.asarray(one.convert("RGB"), dtype=float) for one in (whole, reduced))
    coloured = np.ptp(wanted, axis=-1) > 30.0
    assert coloured.sum() > 10_000
    assert np.abs(got - wanted)[coloured].max() < 25.0  # of 255


def test_a_report_of_the_current_state(comm: MPI.Intracomm, folder: Path) -> None:
    """Where the ranks but one have no cell."""
    solver = tent(comm, on_one_rank=True)
    solver.report(folder / "now.html", pictures=[])
    comm.barrier()
    page = Page((folder / "now.html").read_text(encoding="utf-8"))
    assert "Current state" in page.tables["Inner pressure and factors of the loads"][1]
    told = "Verified, but not everything is judged: the state passed"
    assert any(told in word for word in page.words)
    assert any("without a design value: membrane part wall." in word for word in page.words)
    solver.scene.u.x.array[:] *= 1.01
    solver.report(folder / "now.html", pictures=[])
    comm.barrier()
    page = Page((folder / "now.html").read_text(encoding="utf-8"))
    assert any("Not in equilibrium: Current state" in word for word in page.words)


@pytest.mark.ranks
def test_bad_reports_write_nothing(comm: MPI.Intracomm, folder: Path) -> None:
    solver, other = tent(comm), tent(comm)
    found = other.combine({"snow": {"snow": 0.1}})
    page = folder / "tent.html"
    if comm.rank == 0:
        page.write_text("as before")
        (folder / "folder.html").mkdir()
    comm.barrier()
    for options, words in (
        ({"filename": folder / "tent.pdf"}, r"tent.pdf' is not a page; pass a name with .html"),
        ({"filename": folder / "folder.html"}, "folder.html is a folder"),
        ({"filename": page / "below.html"}, "cannot be written"),
        ({"combinations": {}}, r"combinations = {} is not a valid mapping; write solver.combine"),
        ({"combinations": {"snow": 1.5}}, "combination 'snow' is of type float"),
        ({"combinations": found}, "'snow' is of another scene"),
        ({"title": None}, "title is of type NoneType; pass a str"),
        ({"about": {"Project": 3}}, "3 in about is of type int"),
        ({"pictures": ["colour"]}, "'colour' is not known"),
        ({"pictures": "stress"}, "not a valid list; write pictures="),
        ({"strain_limit": 0.0}, "strain_limit = 0.0"),
        ({"template": folder / "office.html"}, "no template .*office.html"),
        ({"template": page}, r"tent.html' is a template's name; use another name"),
        ({"filename": folder / "parts.html"}, r"parts.html' is a template's name"),
        ({"basis": {"s_k": 0.75}}, "0.75 in basis is of type float"),
        ({"view": (1.0, 2.0, 3.0)}, "view"),
        ({"cable_strengths": {}}, "option = 'cable_strengths' is not known; use 'title'"),
    ):
        with pytest.raises(InputError, match=words):
            solver.report(**{"filename": page} | options)  # type: ignore[arg-type]
    solver.scene.membrane.strengths.clear()
    with pytest.raises(InputError, match=r"no strengths; call scene.set_strengths"):
        solver.report(page, pictures=["utilisation"])
    comm.barrier()
    assert page.read_text() == "as before"
    assert {path.name for path in folder.iterdir()} == {"tent.html", "folder.html"}


def test_what_cannot_be_completed_leaves_what_is_there(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = tent(comm)
    page = folder / "tent.html"
    solver.report(page, pictures=[])
    comm.barrier()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def full(self: Table) -> str:
        if self.name == "supports":
            raise OSError(28, "No space left on device")
        return "new"

    monkeypatch.setattr(Table, "csv", full)
    with pytest.raises((InputError, OSError), match="No space"):
        solver.report(page, title="new", pictures=[])
    comm.barrier()
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("most", [330_000, 350_000], ids=["all", "some"])
def test_pictures_that_do_not_fit_are_left_out(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    solver = tent(comm)
    monkeypatch.setattr(sections, "LARGEST", most)
    solver.report(folder / "now.html")
    comm.barrier()
    text = (folder / "now.html").read_text(encoding="utf-8")
    page = Page(text)
    assert len(text) < most
    assert any("pictures are left out" in word for word in page.words)


def test_numbers_as_people_read_them() -> None:
    shown = {
        0.0: "0", 1234.56: "1235", 12.3456: "12.35", -0.012343: "\u22120.01234", 9.99996: "10.00",
        1e-5: "1.000e\u22125", 1.23e9: "1.230e9", np.nan: "\u2013", 123456.7: "123457",
    }  # fmt: skip
    for value, text in shown.items():
        assert number(value) == text
    assert [per_cent(x) for x in (0.0, 1e-5, 0.1234)] == ["0.0 %", "< 0.1 %", "12.3 %"]
    assert place((1.23456, -20.0, -1e-9), 40.0) == "1.2; \u221220.0; 0.0"


def html(*parts: PagePart) -> str:
    return page("T", [], [PageSection("S", parts)])


def test_numbers_of_a_unit_have_the_decimals_of_the_largest() -> None:
    """Of the caption's unit, too; zeros, texts and numbers of other units stay."""
    columns = ("Cable", "Least [kN]", "Largest [kN]", "On the rim [kN/m]")
    rows = [("A", 0.04696, 47.3, 0.1234), ("B", 0.0, -3.0, None)]
    table = Table("Tensions", columns, rows, even=True)
    shown_rows = [[shown(cell) for cell in row] for row in table.shown.rows]
    assert shown_rows == [["A", "0.05", "47.30", "0.1234"], ["B", "0", "\u22123.00", "\u2013"]]
    assert "0.04696" in table.csv()
    table = Table("Tensions [kN]", ("Case", "A", "B"), [("LC0", 123.4, 0.5)], even=True)
    assert [shown(cell) for cell in table.shown.rows[0]] == ["LC0", "123.4", "0.5"]
    chart = BarChart("Tension", [("A", 0.04696, 47.3)])
    assert chart.drawn[0][3] == "0.05 to 47.30"


def test_bars_are_as_long_as_their_values() -> None:
    rows = [("calm <1>", 0.0, 0.5), ("storm", 0.5, 1.25)]
    text = html(BarChart("Utilisation", rows, limit=1.0))
    Page(text)
    widths = [float(x) for x in re.findall(r"; width: ([\d.]+)%", text.partition("</style>")[2])]
    assert widths[1] == pytest.approx(1.5 * widths[0], rel=1e-2)
    assert text.count('class="over"') == 1
    assert "0.500 to 1.250</div>" in text
    nothing = [BarChart("nothing", []), BarChart("slack", [("a", 0.0, 0.0)])]
    assert "<figure" not in html(*nothing, BarChart("many", rows * 30))


def test_tables_group_rows_of_one_heading() -> None:
    rows = [("a", "x", 1.0, None), ("a", "y", None, ""), ("b", "x", 2, None)]
    table = Table("T <1>", ("A", "B", "C", "of nothing"), rows, "t", headings=2)
    assert Page(html(table)).tables["T <1>"] == [
        ["A", "B", "C"], ["a", "x", "1.000"], ["y", "\u2013"], ["b", "x", "2"],
    ]  # fmt: skip
    assert 'rowspan="2"' in html(table)
    assert table.csv() == "A,B,C,of nothing\na,x,1.0,\na,y,,\nb,x,2,\n"
    assert "1000 rows" in html(Table("T", ("A",), [("a",)] * 1000, "t"))
    many = Table("T", ("A", "B", "C"), [("a", k, 1.0) for k in range(28)], headings=2)
    assert [len(group) for group in many.groups] == [9, 9, 10]  # each stays on one page
    assert [row[1] for group in many.groups for row in group] == list(range(28))


@pytest.mark.parametrize(
    ("unit", "metre"),
    [("m", 1.0), ("mm", 1e3), ("cm", 1e2), ("ft", 1 / 0.3048), ("in", 1 / 0.0254)],
)
def test_lengths_to_order_have_millimetres(comm: MPI.Intracomm, unit: str, metre: float) -> None:
    """Each length on the page is less than half a millimetre off, whatever the unit; those of the
    CSV file are the object's."""
    spacings = (float(np.pi) * metre, 123.4567891 * metre, 0.0123456 * metre)
    length, L0, cut = sum(spacings), 126.6 * metre / 1.001, 127.19876543 * metre
    cable = CableOrder("A1", 2e4, L0, 10.0, length, ("A1 x B1", "A1 x B2"), spacings, cut)
    order = Order({"A1": cable}, -15.0, 1.2e-5, (0.3, 0.3), comm)
    table = cables_to_order(order, Units(unit, "kN"))
    (heads, *rows) = Page(html(table)).tables[table.caption]
    lengths = [k for k, name in enumerate(heads) if name.endswith(f"[{unit}]")]
    assert len(lengths) == 5 and len(rows) == 3
    for row, cells in zip(order.rows(), rows, strict=True):
        for k in lengths:
            assert abs(float(cells[k]) - float(row[k])) < 0.5e-3 * metre
    written = table.csv().splitlines()[1:]
    assert written == [",".join(map(str, row)) for row in order.rows()]


def test_an_office_has_a_template_of_its_own(comm: MPI.Intracomm, folder: Path) -> None:
    template = folder / "office.html"
    if comm.rank == 0:
        template.write_text(
            '{% extends "report.html" %}{% block head %}<h1>Office & {{ title }}</h1>{% endblock %}'
        )
    comm.barrier()
    tent(comm).report(folder / "now.html", pictures=[], template=template, title="<T>")
    comm.barrier()
    text = (folder / "now.html").read_text(encoding="utf-8")
    assert "<h1>Office & &lt;T&gt;</h1>" in text
    assert "<table" in text
    assert 'class="about"' not in text.partition("</style>")[2]


@pytest.mark.parametrize("name", ["office.html", "report.html"])
def test_templates_beside_pages(tmp_path: Path, name: str) -> None:
    """The package's page is extended, also by a template of its name or beside an old page; style
    sheet and macros of the template's folder hold."""
    (tmp_path / "report.html").write_text("an old page")
    template = tmp_path / name
    template.write_text('{% extends "report.html" %}{% block head %}Büro{% endblock %}', "utf-8")
    sections = [PageSection("S", [Paragraph("as it is now")])]
    text = page("T", [], sections, template)
    assert "Büro" in text and "as it is now" in text and "an old page" not in text
    (tmp_path / "report.css").write_text("own style")
    (tmp_path / "parts.html").write_text(
        "{% macro text(part) %}{{ part.text }} by own macros{% endmacro %}"
    )
    assert "own style" in page("T", [], sections, template)
    assert "as it is now by own macros" in page("T", [], sections, template)


def text_of(path: Path) -> list[str]:
    """Text of each page of a PDF, in one line."""
    pypdf = pytest.importorskip("pypdf")
    return [" ".join(one.extract_text().split()) for one in pypdf.PdfReader(path).pages]


def test_a_pdf_to_hand_in(comm: MPI.Intracomm, folder: Path) -> None:
    """Head, foot and number on each page; verdict, what governs and signatures on the first."""
    pytest.importorskip("weasyprint")
    solver = tent(comm)
    about = {"Office": "Office & Sons", "Project": "Roof", "Author": "A. Weaver",
             "Checker": "C. Mast", "Revision": "B"}  # fmt: skip
    combinations = {f"ULS: {k} snow": {"snow": 0.02 * k} for k in range(1, 33)}
    solver.report(
        folder / "tent.html", solver.combine(combinations), title="Tent", unit="m", force="kN",
        about=about, basis={"Codes": "EN 1990"}, pdf=True,
        pictures=["displacement", "utilisation"],
    )  # fmt: skip
    comm.barrier()
    pages = text_of(folder / "tent.pdf")
    assert 5 < len(pages) <= 30
    for k, text in enumerate(pages, 1):
        assert f"Page {k} of {len(pages)}" in text
        for word in ("Office & Sons", "Roof", "Revision B", f"crms_fenicsx {__version__}"):
            assert word in text, (k, word)
    for word in ("A. Weaver", "C. Mast", "judged: all 32 combinations and the base", "Signature",
                 "Checked by", "Governing verifications", "ULS", "Contents"):  # fmt: skip
        assert (word in pages[0]) is (word != "Contents"), word
    whole = " ".join(pages)
    for word in ("EN 1990", "E1 t = 800 kN/m", "LC32", "Balance of loads and foundations",
                 "Forces per length on the held edges", "Requirements of equilibrium"):  # fmt: skip
        assert word in whole, word
    assert not re.search("hollow|crude|used to|held by edges", whole)
    root = pytest.importorskip("pypdf").PdfReader(folder / "tent.pdf").trailer["/Root"]
    assert root["/MarkInfo"]["/Marked"] and "/StructTreeRoot" in root  # for screen readers
    assert root["/Lang"] == "en" and root["/ViewerPreferences"]["/DisplayDocTitle"]
    kinds = [kind for kind, _ in elements(root["/StructTreeRoot"])]
    heads = [int(kind[2]) for kind in kinds if re.fullmatch("/H[1-6]", kind)]
    assert heads[:2] == [1, 2] and heads.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(heads))  # none is left out
    assert {"/Table", "/TH", "/TD"} <= {*kinds}
    told = [alt for kind, alt in elements(root["/StructTreeRoot"]) if kind == "/Figure"]
    assert all(told) and (told or int(version("weasyprint").partition(".")[0]) < 70)


def elements(node: Any) -> Iterator[tuple[str, str]]:
    """Kinds of a PDF's structure elements in reading order, with their alternative texts."""
    node = node.get_object() if hasattr(node, "get_object") else node
    if isinstance(node, dict):
        if "/S" in node:
            yield str(node["/S"]), str(node.get("/Alt", ""))
        yield from elements(node.get("/K"))
    for one in node if isinstance(node, list) else ():
        yield from elements(one)


def test_texts_have_enough_contrast() -> None:
    """4.5 of all inks to white and to what lies behind text, as WCAG 2.1, 1.4.3, asks."""
    style = (Path(sections.__file__).parent / "templates" / "report.css").read_text()
    inks = {*re.findall(r"(?<![-\w])color: (#\w{6})", style)}
    inks |= {colour for name, colour in re.findall(r"--(\w+): (#\w{6})", style)
             if name in ("ink", "faint", "accent")}  # fmt: skip
    grounds = {"#ffffff", *re.findall(r"background: (#\w{6})", style)}
    grounds |= {*re.findall(r"--tint: (#\w{6})", style)}
    grounds.remove("#b3261e")  # bars of a chart, whose numbers are beside them
    assert len(inks) >= 3 and len(grounds) == 5

    def light(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts]
        return float(np.dot((0.2126, 0.7152, 0.0722), linear))

    for ink, ground in product(inks, grounds):
        assert (light(ground) + 0.05) / (light(ink) + 0.05) > 4.5, (ink, ground)


def test_pdf_without_weasyprint(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A remedy, before anything is written."""
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(InputError, match=r"pdf=True needs WeasyPrint.* apt install weasyprint"):
        tent(comm).report(folder / "now.html", pictures=[], pdf=True)
    comm.barrier()
    assert not list(folder.iterdir())


def test_templates_that_cannot_write_a_report(tmp_path: Path) -> None:
    """One without the sections, one that fails, and macros of an earlier version, by name."""
    template = tmp_path / "office.html"
    for text, words in (
        ("<h1>{{ title }}</h1>", r"office.html' leaves out the report's sections; begin it with"),
        ("{% extends 'report.html' %}{% block head %}{{ head }}{% endblock %}",
         "office.html' fails: 'head' is undefined"),
        ("{% block head %}", "office.html' fails: "),
    ):  # fmt: skip
        template.write_text(text)
        with pytest.raises(InputError, match=words):
            check_template(template)
    template.write_text("{% extends 'report.html' %}")
    check_template(template)
    (tmp_path / "parts.html").write_text("{% macro text(part) %}{{ part.text }}{% endmacro %}")
    with pytest.raises(InputError, match=r"parts.html lacks the macros notes, link, .*signatures"):
        check_template(template)


def test_names_in_the_order_of_counting() -> None:
    names = ["A10", "A2", "A1", "B1", "A", "10", "9"]
    assert sorted(names, key=as_counted) == ["9", "10", "A", "A1", "A2", "A10", "B1"]


def test_many_states_have_pictures_where_they_govern(comm: MPI.Intracomm) -> None:
    solver = tent(comm)
    before = shape_of(solver.scene)
    solver.advance(load={"snow": 0.5})
    one = case_of(solver, "x", before)
    every = [
        replace(one, name=f"{state} {k}", state=state,
                deflection=replace(one.deflection, value=size))
        for state in ("ULS", "frequent") for k, size in enumerate([0.2, 0.9, 0.4])
    ]  # fmt: skip
    base = replace(one, name="LC0", state="", deflection=replace(one.deflection, value=0.0))
    few = pictured([base, *every], ["displacement"])
    assert all(few[case.name] == ["displacement"] for case in [base, *every])
    many = pictured([base, *every], ["displacement", "utilisation"])
    assert [name for name, own in many.items() if "displacement" in own] == ["ULS 1", "frequent 1"]
    assert "utilisation" in many["LC0"]
