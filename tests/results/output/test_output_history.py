"""The history of a run: rows, columns that come later, and a file that is always whole."""

import csv
import io
import os
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output import History
from crms_fenicsx.results.output.history import Value
from crms_fenicsx.results.output.report.page import PageSection, Table, page

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD


def read_together(path: Path) -> str:
    COMM.barrier()
    text = path.read_text()
    COMM.barrier()
    return text


def test_every_digit_survives_the_file(folder: Path) -> None:
    rows: list[dict[str, Value]] = [
        {"step": 0, "energy": 0.1 + 0.2, "note": 'first, and "quoted"\nbroken'},
        {"step": 1, "energy": -1e-300 / 3.0, "note": ""},
        {"step": 2, "energy": float("inf"), "note": "ümlaut"},
    ]
    history = History(folder / "new" / "history.csv", COMM)
    for row in rows:
        history.append(row)
    COMM.barrier()
    again = History.read(folder / "new" / "history.csv")
    assert again.columns == history.columns == ("step", "energy", "note")
    assert again["step"].dtype == np.int64
    for column in history.columns:
        assert again[column].tolist() == [row[column] for row in rows]
    assert again["energy"][0] == 0.30000000000000004
    assert len(again) == 3


def test_numpy_scalars_become_plain_numbers(folder: Path) -> None:
    history = History(folder / "history.csv", COMM)
    history.append({"step": np.int32(3), "x": np.float64(0.5), "ok": np.bool_(True)})
    assert read_together(folder / "history.csv") == "step,x,ok\n3,0.5,1\n"


def test_a_later_row_may_bring_columns(folder: Path) -> None:
    history = History(folder / "history.csv", COMM)
    history.append({"step": 0, "energy": 1.5})
    history.append({"step": 1, "energy": 2.5, "tension cable 1": 60.25, "state": "taut"})
    history.append({"step": 2, "tension cable 1": 61.0})
    assert read_together(folder / "history.csv") == (
        "step,energy,tension cable 1,state\n0,1.5,,\n1,2.5,60.25,taut\n2,,61.0,\n"
    )
    for one in (history, History.read(folder / "history.csv")):
        np.testing.assert_array_equal(one["tension cable 1"], [np.nan, 60.25, 61.0])
        np.testing.assert_array_equal(one["energy"], [1.5, 2.5, np.nan])
        assert one["state"].tolist() == ["", "taut", ""]
        assert list(one)[2] == {"step": 2, "tension cable 1": 61.0}


@pytest.mark.ranks
def test_appending_equals_writing_all_at_once(folder: Path) -> None:
    """The kept lines against formatting every row anew, here by a plain join."""
    rng = np.random.default_rng(1)
    history = History(folder / "history.csv", COMM)
    rows = []
    for step in range(30):
        row: dict[str, Value] = {"step": step}
        for name in "abcdef"[: 1 + step // 6]:
            if rng.random() < 0.6:
                row[name] = float(rng.normal())
        rows.append(row)
        history.append(row)
    lines = [",".join(history.columns)]
    lines += [",".join(repr(row[c]) if c in row else "" for c in history.columns) for row in rows]
    assert read_together(folder / "history.csv") == "\n".join(lines) + "\n"


def test_rows_are_copies() -> None:
    history = History(None, COMM)
    row = {"step": 0}
    history.append(row)
    row["step"] = 7
    next(iter(history))["step"] = 8
    assert history["step"].tolist() == [0]


def test_the_old_run_stays_until_the_new_one_has_a_row(folder: Path) -> None:
    path = folder / "history.csv"
    History(path, COMM).append({"step": 5})
    second = History(path, COMM)
    assert read_together(path) == "step\n5\n"
    second.append({"time": 0.5})
    assert read_together(path) == "time\n0.5\n"


@pytest.mark.ranks
def test_killed_between_writing_and_replacing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "history.csv"
    history = History(path, COMM)
    history.append({"step": 0, "energy": 1.0})
    seen = []

    def refuse(source: object, target: object) -> None:
        seen.append(Path(str(source)).read_text())
        raise RuntimeError("the plug is pulled")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refuse)
        with pytest.raises(RuntimeError, match="plug"):
            history.append({"step": 1, "energy": 2.0, "more": 3.0})
    assert seen == (["step,energy,more\n0,1.0,\n1,2.0,3.0\n"] if COMM.rank == 0 else [])
    assert read_together(path) == "step,energy\n0,1.0\n"
    assert len(history) == 1
    assert history.columns == ("step", "energy")
    assert [entry.name for entry in folder.iterdir()] == ["history.csv"]
    COMM.barrier()

    if COMM.rank == 0:  # what a killed run leaves, which cannot clean up
        (folder / ".partial-history.csv").write_text("half a ro")
    history.append({"step": 1, "energy": 2.0})
    assert read_together(path) == "step,energy\n0,1.0\n1,2.0\n"


@pytest.mark.ranks
def test_a_folder_that_cannot_be_written(folder: Path) -> None:
    if COMM.rank == 0:
        (folder / "file").write_text("")
    with pytest.raises(InputError, match="file/results cannot be written"):
        History(folder / "file" / "results" / "history.csv", COMM)
    with pytest.raises(InputError, match="is a folder"):
        History(folder, COMM)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder(folder: Path) -> None:
    if COMM.rank == 0:
        folder.chmod(0o500)
    try:
        with pytest.raises(InputError, match="Permission denied"):
            History(folder / "history.csv", COMM)
    finally:
        COMM.barrier()
        if COMM.rank == 0:
            folder.chmod(0o700)


@pytest.mark.ranks
def test_a_full_disk_reaches_all_ranks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    history = History(folder / "history.csv", COMM)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"history\.csv cannot be written \(No space left"):
        history.append({"step": 0})
    assert len(history) == 0


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({}, "empty row"),
        ({"step": None}, "'step' got None"),
        ({"step": 1 + 2j}, r"got \(1\+2j\)"),
        ({"step": "one"}, "got 'one' after 0"),
        ({"": 1}, "not a column name"),
        ({" step": 1}, "not a column name"),
        ({3: 1}, "3 is not a column name"),
    ],
)
def test_bad_rows(row: dict, message: str) -> None:
    history = History(None, COMM)
    history.append({"step": 0})
    with pytest.raises(InputError, match=message):
        history.append(row)
    assert list(history) == [{"step": 0}]


def test_bad_reading(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no column 'b'"):
        History(None, COMM)["b"]
    with pytest.raises(InputError, match="cannot be read"):
        History.read(tmp_path / "none.csv")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(InputError, match="is empty"):
        History.read(tmp_path / "empty.csv")
    (tmp_path / "torn.csv").write_text("a,b\n1,2\n3\n")
    with pytest.raises(InputError, match="1 values in row 2"):
        History.read(tmp_path / "torn.csv")


def test_text_with_underscores_is_no_number(tmp_path: Path) -> None:
    (tmp_path / "h.csv").write_text("name\n1_2\n")
    assert History.read(tmp_path / "h.csv")["name"].tolist() == ["1_2"]


NAMES = ["=1+1", "+1", "-5", "@A1", "\tx", "\rx", "'quoted", "plain", "a=b"]


def test_texts_are_no_formulas(tmp_path: Path) -> None:
    """As names of loads and cables may be; they are read back as they were given."""
    history = History(tmp_path / "h.csv", MPI.COMM_SELF)
    for k, name in enumerate(NAMES):
        history.append({"step": k, "case": name, "energy": -float(k)})
    history.append({"step": 9, "=cmd()": 2.5})
    with (tmp_path / "h.csv").open(newline="") as file:
        cells = list(csv.reader(file))
    written = [row[1] for row in cells[1:-1]]
    assert all(text[0] not in "=+-@\t\r" for text in [*written, *cells[0]])
    assert written[-2:] == ["plain", "a=b"]
    assert cells[2][2] == "-1.0"  # numbers stay numbers
    again = History.read(tmp_path / "h.csv")
    assert again.columns == history.columns
    assert again["case"].tolist() == [*NAMES, ""]
    assert again["energy"][:9].tolist() == [-float(k) for k in range(9)]


def test_texts_of_report_tables_are_no_formulas() -> None:
    table = Table("T", ("=A", "B"), [(name, -1.5) for name in NAMES], "t")
    cells = list(csv.reader(io.StringIO(table.csv(), newline="")))
    assert all(row[0][0] not in "=+-@\t\r" for row in cells)
    assert {row[1] for row in cells[1:]} == {"-1.5"}
    assert "=1+1" in page("T", [], [PageSection("S", [table])])
