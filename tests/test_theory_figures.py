"""The figures of the theory's pages are those that their script draws."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

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
