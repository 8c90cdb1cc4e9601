"""Which tests run on several ranks: see conftest.py."""

import ast
from pathlib import Path

import pytest

FILES = sorted(Path(__file__).parent.rglob("test_*.py"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_all_ranks_come_from_the_fixture(file: Path) -> None:
    """Who takes them otherwise says so; else the test would be skipped under mpirun."""
    text = file.read_text()
    names = {node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)}
    if "COMM_WORLD" in names:
        marks = [line for line in text.splitlines() if line.startswith("pytestmark = ")]
        assert any('pytest.mark.usefixtures("comm")' in line for line in marks)
