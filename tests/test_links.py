"""The documentation names files, headings and public names that there are."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

from crms_fenicsx import Scene, Solver

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.joinpath("docs").rglob("*.md")])
PAGES = [page for page in PAGES if "generated" not in page.parts]
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FILE = re.compile(r"`((?:demos|benchmarks|tests|docs|meshes)/[\w/.]+\.\w+)`")
KNOWN = {"comm", "energies", "steps", "history"}
"""Attributes of scenes and solvers that they make when they are made."""


def prose(page: Path) -> str:
    """A page without blocks of code."""
    return re.sub(r"^ *```.*?^ *```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, as MyST and Git hosts make them."""
    titles = re.findall(r"^#+ +(.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_what_there_is(page: Path) -> None:
    wrong = []
    for link in LINK.findall(prose(page)):
        if re.match(r"\w+:|tutorials/", link):  # on the web, or made from the demos
            continue
        name, _, anchor = link.partition("#")
        target = page if not name else (page.parent / name).resolve()
        if not target.exists() and not target.with_suffix(".md").exists():
            wrong.append(link)
        elif anchor and target.suffix == ".md" and anchor not in headings(target):
            wrong.append(link)
    wrong += [name for name in FILE.findall(prose(page)) if not (ROOT / name).exists()]
    assert not wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_on_pages_is_python(page: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    for block in blocks:
        compile(block, str(page), "exec")
    names = {n for b in blocks for n in re.findall(r"\b(?:scene|solver)\.([a-z]\w*)", b)}
    assert not [n for n in names if not (hasattr(Scene, n) or hasattr(Solver, n) or n in KNOWN)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_can_be_read_aloud(page: Path) -> None:
    """Headings go down by one level at a time, pictures and heads of tables have words."""
    text = prose(page)
    levels = [len(marks) for marks in re.findall(r"^(#+) ", text, re.MULTILINE)]
    if page.name != "changelog.md":  # which includes another page
        assert levels[0] == 1 and levels.count(1) == 1
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))
    assert all(len(alt) > 10 for alt in re.findall(r"!\[([^\]]*)\]", text))
    heads = re.findall(r"^ *\|(.*)\|\n *\|[-|]+\|$", text, re.MULTILINE)
    assert all(cell.strip() for head in heads for cell in head.split("|"))


def test_every_demo_is_a_tutorial() -> None:
    """Those that are not in their order end the building of the site."""
    order = re.findall(r'^    "(\w+)",$', (ROOT / "docs" / "conf.py").read_text(), re.MULTILINE)
    assert {path.stem for path in (ROOT / "demos").glob("*.py")} <= set(order)
