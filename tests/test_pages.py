"""The code on the documentation's pages runs as a reader would run it, from top to bottom."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest

from crms_fenicsx.energy.minimization.outcome import ENDLESS, REASONS, SINGULAR, STALLED

DOCS = Path(__file__).parents[1] / "docs"
SCRIPT = runpy.run_path(str(DOCS / "draw_how_to.py"))
blocks, run, play = (SCRIPT[name] for name in ("blocks", "run", "play"))
PAGES = list(SCRIPT["DRAWN"])
NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")
PLACE = re.compile(r"\([-+\d.e]+(?:, [-+\d.e]+)+\)")
"""Of a largest or smallest value: another mesh may have it elsewhere."""

SECONDS = re.compile(r"\b[\d.]+ s\b")
SAME_MESHES = gmsh.GMSH_API_VERSION.startswith("4.13.")
"""Other versions make other meshes than those of the pages: small tensions and strains differ."""


def code(page: str) -> list[str]:
    """The Python code of a page."""
    return [block.code for block in blocks(page)]


def assert_shows(shown: str, said: str, numbers: bool = True) -> None:
    """The same words and, if wanted, numbers that differ by 5 % or 0.01 at most."""
    shown, said = (SECONDS.sub("time", PLACE.sub("(place)", t)) for t in (shown, said))
    words = [NUMBER.sub("#", text).split() for text in (shown, said)]
    assert words[0] == words[1], f"the page shows\n{shown}\nits code prints\n{said}"
    if numbers:
        pair = [[float(number) for number in NUMBER.findall(text)] for text in (shown, said)]
        np.testing.assert_allclose(*pair, rtol=0.05, atol=0.01, err_msg=said)


def test_comparison_of_output_can_fail() -> None:
    assert_shows("tension 10.0 kN at (0.1, 2.0)", "tension  10.4 kN at (3, 4)\n")
    for other in ("tension 10.6 kN at (0.1, 2.0)", "force 10.0 kN at (0.1, 2.0)", ""):
        with pytest.raises(AssertionError):
            assert_shows("tension 10.0 kN at (0.1, 2.0)", other)


@pytest.fixture(scope="module")
def roof(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names of `roof.py`, the script that most pages continue, and a snapshot at its end."""
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("roof"))
        run(*code("start"), names, "start")
        assert Path("results/roof/windy.png").exists()
    return names | {"_at_end": names["solver"].snapshot()}


@pytest.mark.parametrize("page", PAGES)
def test_code_of_page_runs_and_prints_what_it_shows(
    page: str, roof: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an empty folder with the files that the page saves, after `roof.py` where it says so."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    if "continues `roof.py`" in (DOCS / f"how_to/{page}.md").read_text():
        roof["solver"].restore(roof["_at_end"])
        scene = roof["scene"]  # what judges its results is not in the snapshot
        scene.membrane.strengths, scene.design.cables = {}, {}
        scene.design.limits = type(scene.design.limits)()
        names |= roof
    for _, block, said in play(f"how_to/{page}", names):
        assert_shows(block.shown or "", said, numbers=SAME_MESHES)


def test_pictures_are_those_that_the_script_draws() -> None:
    """Each is on its page, small, and drawn after a block of code that there is."""
    drawn = {f"{name}.png" for pictures in SCRIPT["DRAWN"].values() for name in pictures}
    files = list(SCRIPT["PICTURES"].iterdir())
    assert {path.name for path in files} == drawn
    assert max(path.stat().st_size for path in files) < SCRIPT["LARGEST"]
    for page, pictures in SCRIPT["DRAWN"].items():
        text = (DOCS / f"how_to/{page}.md").read_text()
        for name, (block, _) in pictures.items():
            assert f"(pictures/{name}.png)" in text
            assert block < len(blocks(f"how_to/{page}"))


def test_script_of_readme_prints_what_readme_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = run(*code("../README"), {}, "README")
    assert f"`{said.strip()}`" in (DOCS.parent / "README.md").read_text()
    assert Path("results/square/tightened.png").exists()


def test_hall_in_30_minutes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tutorial for first-time readers ends with a report: coarse, with half of the loads."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in code("hall"):
        block = block.replace("size=1.5", "size=3.0").replace("cases,", 'cases, pictures=["warp"],')
        run(re.sub(r' +"(Operation|Storm along x)": .*\n', "", block), names, "hall")
    assert len(names["cables"]) == 8
    assert names["form"].pressure == pytest.approx(0.3, abs=0.01)
    tensions = [cable.tension for cable in names["cables"]]  # in the storm along y
    assert 3.0 < min(tensions) and max(tensions) == pytest.approx(58.4, rel=0.1)
    assert Path("results/hall/report.html").stat().st_size > 1e5
    assert Path("results/hall/operation.png").exists()


def test_interrupted_script_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`roof.py` with the solver of the page on interrupted runs gives the same when resumed."""
    monkeypatch.chdir(tmp_path)
    (script,), (resumable,) = code("start"), code("how_to/restart")
    script = re.sub(r"^solver = .*\n", lambda _: resumable, script, flags=re.MULTILINE)
    script = re.sub(r"^(draw|print\(solver).*\n", "", script, flags=re.MULTILINE)
    said = []
    for arguments in ([], ["--resume"]):
        monkeypatch.setattr(sys, "argv", ["roof.py", *arguments])
        said.append(run(script, {}, "restart"))
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
