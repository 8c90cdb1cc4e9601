"""The reading path through the method leads through what there is, and the core loads no more."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "crms_fenicsx"
THEORY = ROOT / "docs" / "theory"
MOST_LINES = 2000
"""Lines of the whole path."""

CORE = """
import sys
from mpi4py import MPI
from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
mesh = meshes.rectangle(MPI.COMM_SELF, width=12.0, depth=8.0, size=2.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))
scene.fix("boundary")
solver = Solver(scene)
solver.advance(pressure=0.4)
def told():
    print(*(name for name in sys.modules if name.startswith("crms_fenicsx.")))
told()
cable = scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (12.0, 5.0)])
solver.advance(L0={cable: 0.99 * cable.L0})
told()
other = scene.lay_cable(Cable(EA=2e3, friction=0.5), [(0.0, 2.0), (12.0, 2.5)])
solver.advance(L0={other: 0.99 * other.L0})
told()
"""


def path() -> Iterator[tuple[Path, list[str], int]]:
    """File, names to read in it (none: all of it), and lines told, of each step."""
    text = (THEORY / "method_in_an_hour.md").read_text()
    steps = re.findall(r"^\d+\. \[.*?\]\((.+?)\), (\d+) lines(:.*?)?\.\s", text, re.M | re.S)
    for link, lines, read in steps:
        names = []
        for owner, methods in re.findall(r"`(\w+)`(?:\s+\((.*?)\))?", read, re.S):
            names += [f"{owner}.{name}" for name in re.findall(r"\w+", methods)] or [owner]
        yield (THEORY / link).resolve(), names, int(lines)


def lines_of(file: Path, names: list[str]) -> int:
    """Lines of a file, or of classes, functions and methods in it."""
    text = file.read_text()
    if not names:
        return len(text.splitlines())
    total = 0
    for name in names:
        scope: ast.AST = ast.parse(text)
        for part in name.split("."):
            scope = next(
                one
                for one in ast.iter_child_nodes(scope)
                if isinstance(one, ast.ClassDef | ast.FunctionDef) and one.name == part
            )
        assert isinstance(scope, ast.ClassDef | ast.FunctionDef)
        first = min([scope.lineno, *(one.lineno for one in scope.decorator_list)])
        total += (scope.end_lineno or first) - first + 1
    return total


def test_the_path_is_as_short_as_told() -> None:
    steps = list(path())
    assert len(steps) == 24
    real = [lines_of(file, names) for file, names, _ in steps]
    assert sum(real) < MOST_LINES
    for (file, _, told), lines in zip(steps, real, strict=True):
        assert told == pytest.approx(lines, rel=0.15, abs=5), file.name


def test_the_core_loads_what_the_table_says() -> None:
    """Modules of each wing: without cables, with one, and with friction."""
    done = subprocess.run(
        [sys.executable, "-c", CORE], capture_output=True, text=True, cwd=ROOT, check=True
    )
    loaded = [
        [name for name in line.split() if not ROOT.joinpath(*name.split(".")).is_dir()]
        for line in done.stdout.splitlines()
    ]
    unused = "design results.output.figures results.output.report results.checkpoint".split()
    assert not [name for name in loaded[-1] for one in unused if f"crms_fenicsx.{one}" in name]
    text = (THEORY / "architecture.md").read_text()
    rows = re.findall(r"^\| `(\w+)[/.py]*` \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", text, re.M)
    assert len(rows) == 8
    for wing, *counts in rows:
        real = [sum(name.split(".")[1] == wing for name in names) for names in loaded]
        files = [*PACKAGE.glob(f"{wing}.py"), *PACKAGE.joinpath(wing).rglob("*.py")]
        real.append(sum(file.name != "__init__.py" for file in files))
        assert [int(one) for one in counts] == pytest.approx(real, abs=2), wing
