"""The examples of the reference run, each after the script with which its page begins."""

from __future__ import annotations

import doctest
import inspect
import pydoc
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

API = Path(__file__).parents[1] / "docs" / "api"
DIRECTIVE = re.compile(r"^\.\. auto(?:function|class)\:\: (\S+)", re.MULTILINE)
LEFT_OUT: dict[str, str] = {}
"""Examples that are not run here, with the reason."""
BEFORE: dict[str, str] = {}
"""What an example takes for granted beyond the script, such as loads and other meshes."""


def documented(page: str) -> Iterator[tuple[str, str]]:
    """Names and docstrings of the objects of a page that have examples."""
    for name in DIRECTIVE.findall((API / f"{page}.md").read_text()):
        own = name.removeprefix("crms_fenicsx.")
        found = pydoc.locate(name)
        members = inspect.getmembers(found) if inspect.isclass(found) else []
        for label, one in [(own, found), *((f"{own}.{k}", x) for k, x in members if k[0] != "_")]:
            docstring = inspect.getdoc(one) or ""
            if ">>> " in docstring:
                yield label, docstring


EXAMPLES = {
    label: (page.stem, text)
    for page in sorted(API.glob("*.md"))
    for label, text in documented(page.stem)
}


def script(page: str) -> str:
    """The script at the beginning of a page, or that of most."""
    for one in (page, "index"):
        blocks = re.findall(r"^```python\n(.*?)^```", (API / f"{one}.md").read_text(), re.S | re.M)
        if blocks:
            return blocks[0]
    raise AssertionError(page)


@pytest.fixture(scope="module")
def scripts() -> dict[str, dict[str, Any]]:
    """Names after the scripts that have run."""
    return {}


def names_after(code: str, known: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The names after a script, which runs once; its scene is as at its end."""
    if code not in known:
        names: dict[str, Any] = {}
        exec(compile(code, "script", "exec"), names)
        names["_end"] = names["solver"].snapshot() if "solver" in names else None
        known[code] = names
    names = dict(known[code])
    if names["_end"] is not None:
        names["solver"].restore(names["_end"])
    return names


class Rounded(doctest.OutputChecker):
    """Numbers that differ by 2 % are equal, as meshes differ between versions of gmsh."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        """Whether an output is the one that is shown, if one is."""
        number = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
        if not want:
            return True
        if "".join(number.sub("0", want).split()) != "".join(number.sub("0", got).split()):
            return False
        numbers = ([float(x) for x in number.findall(text)] for text in (want, got))
        return np.allclose(*numbers, rtol=0.02)


@pytest.mark.parametrize("label", [label for label in EXAMPLES if label not in LEFT_OUT])
def test_example(
    label: str, scripts: dict[str, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It raises nothing, and prints what it shows."""
    monkeypatch.chdir(tmp_path)
    page, text = EXAMPLES[label]
    names = names_after(script(page), scripts)
    exec(BEFORE.get(label, ""), names)
    examples = doctest.DocTestParser().get_examples(text)
    runner, said = doctest.DocTestRunner(Rounded(), verbose=False), []
    test = doctest.DocTest(examples, names, label, None, None, text)
    found = runner.run(test, out=said.append, clear_globs=False)
    assert found.failed == 0, "".join(said)
