"""The chapter "Erection" of a report has the figures of its stages, in their order."""

from __future__ import annotations

from pathlib import Path

import pytest
from cabled_square import sheet
from mpi4py import MPI
from report_page import Page, read_csv

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Solver
from crms_fenicsx.results.output.report.page import EMPTY

NAMES = ("propped", "cable A1 tightened", "crew on the roof", "props removed")


def erected(comm: MPI.Intracomm, long: str = "") -> Solver:
    """A prestressed sheet over a prop, erected in four stages; `long` makes their names longer."""
    fabric = IsotropicMembrane(E=1e3, nu=0.3, thickness=1.0, prestress=2.0)
    scene = sheet(comm, 4, material=fabric, side=10.0)
    scene.put_load((0.0, 0.0, -0.1), name="crew")
    solver = Solver(scene)
    propped, tightened, crew, away = (name + long for name in NAMES)
    with solver.stage(propped):
        cable = scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (10.0, 4.0)], tension=3.0, name="A1")
        middle = scene.vertex_at((5.0, 5.0, 0.0))
        scene.add_bar(Bar(300.0, strength=50.0), (5.0, 5.0, -3.0), middle, L0=3.3, name="prop")
    with solver.stage(tightened):
        solver.advance(L0={cable: 0.99 * cable.L0})
    with solver.stage(crew):
        solver.advance(load={"crew": 1.0})
    with solver.stage(away):
        scene.remove_bar("prop")
        solver.advance(load={"crew": 0.0})
    return solver


@pytest.mark.ranks
def test_stages_have_a_chapter(comm: MPI.Intracomm, folder: Path) -> None:
    """With the figures of their states, a dash for what is missing, and a picture each; bars that
    only stages have are in the model."""
    solver = erected(comm)
    found = solver.combine({"rest": {}, "full": {"crew": 1.5}})
    solver.report(folder / "tent.html", solver.stages | found, unit="m", force="kN")
    comm.barrier()
    rows = read_csv(folder / "tent_erection.csv")
    page = Page((folder / "tent.html").read_text(encoding="utf-8"))
    assert list(rows[0]) == ["Result", "Of", *NAMES]
    table = {(row["Result"], row["Of"]): [row[name] for name in NAMES] for row in rows}
    for k, one in enumerate(solver.stages.values()):
        solver.restore(one.snapshot)
        (cable,), bars, summary = solver.scene.cables, solver.scene.bars, solver.summary()
        moved, first = summary.deflection, summary.membrane.largest["true force 1"]
        assert moved is not None
        expected = {
            ("Cable tension [kN]", "A1"): cable.tension,
            ("Unstressed length [m]", "A1"): cable.L0,
            ("Membrane, largest [kN/m]", "major principal force"): first.value,
            ("Shape [m]", "displacement in the stage"): moved.value,
        }
        for key, value in expected.items():
            assert float(table[key][k]) == pytest.approx(value, rel=1e-9)
        force = [float(x) for x in table["Bar force [kN]", "prop"][k : k + 1] if x]
        assert force == pytest.approx([bar.force for bar in bars], rel=1e-9)
    assert table["Acting", "crew"] == ["", "", "1.0", ""]
    assert float(table["Unstressed length [m]", "A1"][1]) < float(
        table["Unstressed length [m]", "A1"][0]
    )
    assert ("Unstressed length [m]", "prop") not in table
    heads, *shown = page.tables["Stages of erection"]
    assert heads == ["Result", "Of", *NAMES]
    assert next(row for row in shown if "prop" in row)[-1] == EMPTY
    assert [row[0] for row in page.tables["Bars"][1:]] == ["prop"]
    pictures = [str(one["alt"]).split(": axial forces") for one in page.images]
    assert [one[0] for one in pictures if len(one) == 2][-4:] == list(NAMES)
    codes = {row[1]: row[0] for row in page.tables["Factors of the loads"][1:]}
    expected_codes = {name: f"S{k}" for k, name in enumerate(NAMES, 1)}
    assert codes == {"rest": "LC0", "full": "LC1"} | expected_codes


def test_envelopes_are_of_the_finished_roof(comm: MPI.Intracomm, folder: Path) -> None:
    """Stages have their own chapter and rows of the summary; foundations carry them, too."""
    solver = erected(comm)
    found = solver.combine({"rest": {}, "full": {"crew": 1.5}})
    solver.report(folder / "tent.html", found | solver.stages, unit="m", force="kN", pictures=[])
    summaries = {}
    for name, one in (found | solver.stages).items():
        solver.restore(one.snapshot)
        summaries[name] = solver.summary()
    least = {name: one.cables["A1"].least for name, one in summaries.items()}
    assert min(least, key=lambda name: least[name]) not in found
    (row,) = read_csv(folder / "tent_cable_envelope.csv")
    assert float(row["Least tension [kN]"]) == pytest.approx(min(least[name] for name in found))
    forces = {row["Result"]: row for row in read_csv(folder / "tent_envelope.csv")}
    for key, row in forces.items():
        assert {row["Governs least"], row["Governs largest"]} <= {*found, ""}, key
    page = Page((folder / "tent.html").read_text(encoding="utf-8"))
    over = ", over all combinations without stages of erection"
    for name in ("Envelope of the membrane", "Envelope of the cables' tensions"):
        assert f"{name}{over}" in page.tables
    held = page.tables[
        "Largest forces on the foundations over all combinations and stages of erection"
    ]
    assert any({*row} & {*NAMES} for row in held)


def test_stages_with_long_names_have_codes(comm: MPI.Intracomm, folder: Path) -> None:
    """Their chapter tells both; a report of stages alone has the model after the last one."""
    long = " after the ground anchors were tested"
    solver = erected(comm, long)
    solver.report(folder / "tent.html", solver.stages, pictures=["displacement"])
    text = (folder / "tent.html").read_text(encoding="utf-8")
    page = Page(text)
    expected = [f"S{k} {name}{long}" for k, name in enumerate(NAMES, 1)]
    assert page.tables["Stages of erection"][0] == ["Result", "Of", *expected]
    assert f"The model after {NAMES[-1]}{long}" in text
    captions = [str(one["alt"]).partition(":")[0] for one in page.images]
    assert captions[-4:] == expected
    checked = {row[0] for row in page.tables["Largest deflections, and state of the membrane"][1:]}
    assert checked == {"S1", "S2", "S3", "S4"}


def test_many_stages_share_out_their_columns(comm: MPI.Intracomm, folder: Path) -> None:
    """Over several tables of the page, and in one file; what is tightened has a row of its own."""
    solver = erected(comm)
    scene, at = solver.scene, (2.5, 2.5, 0.0)
    with solver.stage("hung"):
        for name in ("tie", "guy"):
            bars = [
                scene.add_bar(
                    Bar(10.0), (1.0 * k, 0.0, 3.0), scene.vertex_at(at), name=f"{name} {k}"
                )
                for k in range(10)
            ]
    with solver.stage("guy 9 tightened"):
        solver.advance(L0={bars[9]: 0.9 * bars[9].L0})
    for k in range(4):
        with solver.stage(f"turn {k}"):
            cable = solver.scene.cable("A1")
            solver.advance(L0={cable: 0.999 * cable.L0})
    solver.report(folder / "tent.html", solver.stages, pictures=[])
    page = Page((folder / "tent.html").read_text(encoding="utf-8"))
    heads = page.tables["Stages of erection"][0]  # of the last one
    assert heads == ["Result", "Of", "guy 9 tightened", *(f"turn {k}" for k in range(4))]
    rows = read_csv(folder / "tent_erection.csv")
    assert len(rows[0]) == 2 + 10
    names = [row["Of"] for row in rows if row["Result"] == "Bar force"]
    assert names == ["prop", "tie 0 ... tie 9", *(f"guy {k}" for k in range(10))]
    assert not any("axial" in str(one["alt"]) for one in page.images)


def test_a_report_without_stages_has_no_such_chapter(comm: MPI.Intracomm, folder: Path) -> None:
    solver = erected(comm)
    solver.report(folder / "tent.html", solver.combine({"rest": {}}), pictures=[])
    page = Page((folder / "tent.html").read_text(encoding="utf-8"))
    assert "Stages of erection" not in page.tables
    assert not (folder / "tent_erection.csv").exists()
