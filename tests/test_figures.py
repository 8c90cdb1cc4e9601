"""The figures on the pages are those that their scripts draw."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from xml.etree import ElementTree

DOCS = Path(__file__).parents[1] / "docs"
LARGEST = 80_000  # bytes


def words(folder: Path) -> dict[str, list[str]]:
    """The texts in each figure of a folder, which matplotlib notes beside the outlines."""
    return {
        path.name: re.findall(r"<!-- (.*?) -->", path.read_text(), re.DOTALL)
        for path in sorted(folder.iterdir())
    }


def test_script_draws_the_committed_figures(tmp_path: Path) -> None:
    """The same files with the same words and numbers; lines may differ between versions."""
    committed = DOCS / "theory" / "figures"
    runpy.run_path(str(DOCS / "draw_method.py"))["main"](tmp_path)
    assert words(tmp_path) == words(committed)
    assert all(words(committed).values())
    assert all(path.stat().st_size < LARGEST for path in committed.iterdir())


def test_every_figure_is_on_a_page() -> None:
    text = "".join(page.read_text() for page in DOCS.joinpath("theory").glob("*.md"))
    linked = re.findall(r"!\[[^\]]+\]\(figures/([\w.]+)\)", text)
    assert sorted(linked) == sorted(path.name for path in (DOCS / "theory/figures").iterdir())


def test_plots_show_the_tables_above_them() -> None:
    """After a change of a table or of a plot's comment run `./run python docs/draw_plots.py`."""
    plots = list(runpy.run_path(str(DOCS / "draw_plots.py"))["plots"]())
    for plot in plots:
        tree = ElementTree.parse(plot.path)
        said = tree.findtext(".//{http://purl.org/dc/elements/1.1/}description")
        assert said == plot.content, plot.path.name
        assert all(len(x) > 1 for _, x, _ in plot.lines), plot.path.name
    assert sorted(plot.path.name for plot in plots) == sorted(
        path.name for path in (DOCS / "plots").iterdir()
    )
    comments = "".join(page.read_text() for page in DOCS.rglob("*.md"))
    assert len(re.findall("<!-- (?:plot|bars)", comments)) == len(plots)
