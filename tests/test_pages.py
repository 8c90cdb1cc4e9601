"""The code on the documentation's pages runs as a reader would run it, from top to bottom."""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from crms_fenicsx.energy.minimization.outcome import ENDLESS, REASONS, SINGULAR, STALLED

DOCS = Path(__file__).parents[1] / "docs"
PAGES = [
    "mesh", "form_finding", "tents", "fabric", "edges", "loads", "codes", "rain", "bars", "nets",
    "patterns", "results", "files", "error", "pictures", "own_term", "coupling", "supports",
    "not_converged",
]  # fmt: skip
NEEDED = ("precice", "dolfinx.io.gmsh")
"""Modules without which a block of code is left out."""


def blocks(page: str) -> list[str]:
    """The Python code of a page, with coarse meshes."""
    text = (DOCS / f"{page}.md").read_text()
    found = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [block.replace("size=1.0", "size=2.5") for block in found]


def run(code: str, names: dict[str, Any], page: str) -> None:
    """Execute code of a page."""
    exec(compile(code, f"{page}.md", "exec"), names)


def missing(block: str) -> bool:
    """Whether a block needs what is not installed, or somebody who closes pyvista's window.

    `test_coupling` runs the loop for preCICE, `tests/results/test_pyvista.py` pyvista's pictures.
    """
    if "pyvista" in block:
        return True
    for module in NEEDED:
        try:
            found = importlib.util.find_spec(module) is not None
        except ModuleNotFoundError:
            found = False
        if not found and (f"import {module}" in block or f"{module}." in block):
            return True
    return False


@pytest.fixture(scope="module")
def roof(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names of `roof.py`, the script that most pages continue, and a snapshot at its end."""
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("roof"))
        run(*blocks("start"), names, "start")
        assert Path("results/roof/windy.png").exists()
    return names | {"_at_end": names["solver"].snapshot()}


@pytest.mark.parametrize("page", PAGES)
def test_code_of_page_runs(
    page: str, roof: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an empty folder with the files that the page saves, after `roof.py` where it says so."""
    monkeypatch.chdir(tmp_path)
    text = (DOCS / f"how_to/{page}.md").read_text()
    for name, content in re.findall(
        r"`([\w.]+)`:\n\n```\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    ):
        Path(name).write_text(content.replace("MeshSizeMax = 0.7", "MeshSizeMax = 1.5"))
    names: dict[str, Any] = {}
    if "continues `roof.py`" in text:
        roof["solver"].restore(roof["_at_end"])
        names |= roof
    for block in blocks(f"how_to/{page}"):
        if not missing(block):
            run(block, names, page)


def test_script_of_readme_prints_what_readme_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run(*blocks("../README"), {}, "README")
    assert f"`{capfd.readouterr().out.strip()}`" in (DOCS.parent / "README.md").read_text()
    assert Path("results/square/tightened.png").exists()


def test_hall_in_30_minutes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tutorial for first-time readers ends with a report: coarse, with half of the loads."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks("hall"):
        block = block.replace("size=2.0", "size=3.0").replace("cases,", 'cases, pictures=["warp"],')
        run(re.sub(r' +"(Operation|Storm along x)": .*\n', "", block), names, "hall")
    assert len(names["cables"]) == 8
    assert names["form"].pressure == pytest.approx(0.3, abs=0.01)
    assert min(cable.tension for cable in names["cables"]) > 5.0
    assert Path("results/hall/report.html").stat().st_size > 1e5
    assert Path("results/hall/operation.png").exists()


def test_interrupted_script_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """`roof.py` with the solver of the page on interrupted runs gives the same when resumed."""
    monkeypatch.chdir(tmp_path)
    (script,), (resumable,) = blocks("start"), blocks("how_to/restart")
    script = re.sub(r"^solver = .*\n", lambda _: resumable, script, flags=re.MULTILINE)
    script = re.sub(r"^(draw|print\(solver).*\n", "", script, flags=re.MULTILINE)
    said = []
    for arguments in ([], ["--resume"]):
        monkeypatch.setattr(sys, "argv", ["roof.py", *arguments])
        run(script, {}, "restart")
        said.append(capfd.readouterr().out)
    assert said[0] == said[1] and "windy" in said[0]


def strings_of_the_package() -> list[str]:
    """All texts in the code, with … where values are put in."""
    found = []
    for path in (DOCS.parent / "crms_fenicsx").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = (
                    str(one.value) if isinstance(one, ast.Constant) else "…" for one in node.values
                )
                found.append("".join(parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(re.sub(r"\{[^}]*\}", "…", node.value))
    return found


def reasons_of_the_loops() -> list[str]:
    """The longest fixed part of each reason for which a loop of a load step gives up."""
    found = []
    for path in (DOCS.parent / "crms_fenicsx" / "analysis").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "reason":
                parts = (one for one in ast.walk(node.value) if isinstance(one, ast.Constant))
                longest = max((str(part.value) for part in parts), key=len)
                found.append(longest.partition(";")[0].strip(" :%"))
    return found


def test_messages_on_the_page_are_those_of_the_package() -> None:
    """What is in bold in tables, and every reason for which the code refuses a load step."""
    page = (DOCS / "how_to" / "not_converged.md").read_text()
    rows = "\n".join(line for line in page.splitlines() if line.startswith("|"))
    told = re.findall(r"\*\*(.+?)\*\*", rows)
    texts = strings_of_the_package()
    patterns = (".*?".join(map(re.escape, one.split("…"))) for one in told)
    assert len(told) > 60
    assert not [one for one in patterns if not any(re.search(one, text) for text in texts)]
    reasons = [*REASONS.values(), ENDLESS, STALLED, SINGULAR, *reasons_of_the_loops()]
    untold = [one for one in reasons if one not in rows]
    assert untold == [REASONS[-8]]  # the user's own Ctrl-C
