"""Progress: a bar on a terminal, log records elsewhere, silence on the other ranks."""

import io
import logging
import sys

import pytest
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.progress import progress

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]
COMM = MPI.COMM_WORLD


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_log_records_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with caplog.at_level(logging.INFO, "crms_fenicsx"), progress(COMM, 2, "inflating") as bar:
        bar.advance(0.5, "12 iterations")
        bar.advance()
    expected = ["inflating 0.5/2: 12 iterations", "inflating 1.5/2"] if COMM.rank == 0 else []
    assert [record.getMessage() for record in caplog.records] == expected
    assert all(record.levelno == logging.INFO for record in caplog.records)
    assert stream.getvalue() == ""


def test_a_bar_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("tqdm")
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with caplog.at_level(logging.INFO, "crms_fenicsx"), progress(COMM, 1, "tightening") as bar:
        for _ in range(3):
            bar.advance(0.1, "9 iterations")
        bar.advance(0.7, "done")
    assert caplog.records == []
    if COMM.rank == 0:
        last = terminal.getvalue().split("\r")[-1]
        assert last.startswith("tightening: 100%")
        assert "1/1" in last
        assert "done" in last
    else:
        assert terminal.getvalue() == ""


def test_a_bar_ends_with_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tqdm")
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with pytest.raises(RuntimeError, match="stop"), progress(COMM, 4, "x") as bar:
        bar.advance()
        raise RuntimeError("stop")
    assert terminal.getvalue().endswith("\n") == (COMM.rank == 0)


def test_without_tqdm_a_terminal_gets_log_records(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with caplog.at_level(logging.INFO, "crms_fenicsx"), progress(COMM, 1, "x") as bar:
        bar.advance()
    assert len(caplog.records) == (1 if COMM.rank == 0 else 0)


def test_nothing_is_configured() -> None:
    assert logging.getLogger("crms_fenicsx").handlers == []


@pytest.mark.parametrize("total", [-1, float("nan"), float("inf")])
def test_a_total_that_cannot_be(total: float) -> None:
    with pytest.raises(InputError, match=f"total {total}"):
        progress(COMM, total, "x")
