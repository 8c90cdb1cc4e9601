"""The benchmark of cables along lines, on coarse roofs."""

from __future__ import annotations

import re

import lines
import pytest


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_dome(capsys: pytest.CaptureFixture[str]) -> None:
    """A step with cables takes few factorisations."""
    lines.dome(1600.0, 1)
    said = capsys.readouterr().out
    (counts,) = re.findall(r"28 cables .* (\d+)\+(\d+) +\d+\+\d+", said)
    assert max(map(int, counts)) <= 12
    assert re.search(r"ratio [\d.]+; laying [\d.]+ s", said)


def test_angles_of_a_hall() -> None:
    name, mesh, routes = next(lines.roofs(0.2))
    assert len(routes) == 12 and "12 cables" in name
    assert lines.smallest_angles(mesh).min() > 30.0
