"""The documentation names files, headings and public names that there are."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from fnmatch import fnmatch
from pathlib import Path

import pytest

from crms_fenicsx import Scene, Solver

ROOT = Path(__file__).parents[1]
PAGES = sorted(page for folder in (".", ".github") for page in ROOT.joinpath(folder).glob("*.md"))
PAGES += sorted(
    page for page in ROOT.joinpath("docs").rglob("*.md") if "generated" not in page.parts
)
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)(?: +\"[^\"]*\")?\)")
TAG = re.compile(r"<(?:img|a|source)\b[^>]*? (?:src|href|srcset)=\"([^\"]+)\"")
FILE = re.compile(r"`((?:demos|benchmarks|tests|docs|meshes)/[\w/.]+\.\w+)`")
PICTURES = {".png", ".svg", ".jpg", ".gif"}
KNOWN = {"comm", "energies", "stages", "steps", "history"}
"""Attributes of scenes and solvers that they make when they are made."""

DIRECTIVES = {
    "toctree": ("docs/",),
    "eval-rst": ("docs/api/",),
    "summary": ("docs/api/",),
    "include": ("docs/changelog.md", "docs/contributing.md"),
    "grid": ("docs/index.md",),
    "grid-item-card": ("docs/index.md",),
}
"""Directives of MyST and where they may stand: Git hosts show them as code or as plain text."""

WIDEST = 88
"""Characters of a line of code: what a page shows without scrolling, also on Git hosts."""


def prose(page: Path) -> str:
    """A page without blocks of code and comments."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)


def headings(page: Path) -> set[str]:
    """Anchors of a page's headings, as Git hosts make them and MyST does."""
    found: Counter[str] = Counter()
    anchors = set()
    for title in re.findall(r"^#+ +(.+?)(?: +#+)?$", prose(page), re.MULTILINE):
        title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        slug = re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-")
        anchors.add(slug if not found[slug] else f"{slug}-{found[slug]}")
        found[slug] += 1
    return anchors


def is_built(path: Path) -> bool:
    """Whether a file is not committed, but made: it is there on the site or this machine only."""
    inside = path.relative_to(ROOT).as_posix()
    for line in ROOT.joinpath(".gitignore").read_text().split():
        pattern = line.strip("/")
        if line.startswith("/") and f"{inside}/".startswith(f"{pattern}/"):
            return True
        if not line.startswith("/") and any(fnmatch(part, pattern) for part in inside.split("/")):
            return True
    return False


def leads_nowhere(page: Path, link: str, picture: bool) -> bool:
    """Whether a Git host would not find what a link leads to."""
    if re.match(r"(https?|mailto):", link):
        return picture  # which the site, without a network, would not show
    name, _, anchor = link.partition("#")
    target = page if not name else page.parent.joinpath(name).resolve()
    if name.startswith("/") or not target.is_relative_to(ROOT) or not target.exists():
        return True
    if is_built(target) or (picture and target.suffix not in PICTURES):
        return True
    return bool(anchor) and (target.suffix != ".md" or anchor not in headings(target))


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_to_what_there_is(page: Path) -> None:
    """On Git hosts, too, which know neither what the site builds nor the titles of pages."""
    text = re.sub(r"`[^`]+`", "`code`", prose(page))
    wrong = [link for link in TAG.findall(text) if leads_nowhere(page, link, "." not in link)]
    for picture, said, link in LINK.findall(text):
        if not said.strip() or leads_nowhere(page, link, picture == "!"):
            wrong.append(f"[{said}]({link})")
    wrong += [name for name in FILE.findall(prose(page)) if not (ROOT / name).exists()]
    assert not wrong


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_git_hosts_show_what_the_site_shows(page: Path) -> None:
    """Lists of pages are hidden, beside links with texts; formulas are those that both can read."""
    name, text = page.relative_to(ROOT).as_posix(), page.read_text()
    for directive in re.findall(r"^ *(?:`{3,}|:{3,})\{([\w-]+)\}", text, re.MULTILINE):
        assert name.startswith(DIRECTIVES.get(directive, ())), directive
    lists = re.findall(r"^```\{toctree\}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert all(":hidden:" in pages for pages in lists)
    words = prose(page)
    assert not re.findall(r"\{[\w:-]+\}`[^`]+`", words)  # roles
    assert all(line.strip() == "$$" for line in words.splitlines() if "$$" in line)
    formulas = re.findall(r"^\$\$$(.*?)^\$\$$", words, re.DOTALL | re.MULTILINE)
    assert not [tex for tex in formulas if r"\tag" in tex and r"\\" in tex]  # Sphinx splits it


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_code_is_narrow(page: Path) -> None:
    """But for the test command that CI looks for on one line."""
    fence, code, before, long = "", False, "", []
    ci = ROOT.joinpath(".ci", "run").read_text()
    for line in page.read_text().splitlines():
        if line.lstrip().startswith("```"):
            fence = "" if fence else line.strip()
        indented = line.startswith("    ") and (code or not before)  # else it continues a list
        code = "{" not in fence and fence != "```text" if fence else indented  # not its output
        before = line
        if code and len(line) > WIDEST and line.strip() not in ci:
            long.append(line)
    assert not long


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_code_on_pages_is_python(page: Path) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    for block in blocks:
        compile(block, str(page), "exec")
    names = {n for b in blocks for n in re.findall(r"\b(?:scene|solver)\.([a-z]\w*)", b)}
    assert not [n for n in names if not (hasattr(Scene, n) or hasattr(Solver, n) or n in KNOWN)]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_pages_can_be_read_aloud(page: Path) -> None:
    """Headings go down by one level at a time, pictures and heads of tables have words."""
    text = prose(page)
    levels = [len(marks) for marks in re.findall(r"^(#+) ", text, re.MULTILINE)]
    if page.name not in ("changelog.md", "contributing.md"):  # which include other pages
        assert levels[0] == 1 and levels.count(1) == 1
    assert all(b - a <= 1 for a, b in itertools.pairwise(levels))
    assert all(len(alt) > 10 for alt in re.findall(r"!\[([^\]]*)\]", text))
    heads = re.findall(r"^ *\|(.*)\|\n *\|[-|]+\|$", text, re.MULTILINE)
    assert all(cell.strip() for head in heads for cell in head.split("|"))


def test_every_demo_is_a_tutorial() -> None:
    """Those that are not in their order end the building of the site."""
    order = re.findall(r'^    "(\w+)",$', (ROOT / "docs" / "conf.py").read_text(), re.MULTILINE)
    assert {path.stem for path in (ROOT / "demos").glob("*.py")} <= set(order)
