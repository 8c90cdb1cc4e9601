"""The benchmark of cables along lines, on coarse roofs."""

from __future__ import annotations

import re

import lines
import numpy as np
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


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_lines_and_folded_cables_have_one_limit() -> None:
    """Of tensions; errors on meshes along the cables fall with the cells' size to the square."""
    on_rim = (72, 96, 120)
    found = lines.limits(1.0, on_rim)
    limit = found["folded"][-1, 0]
    for way in ("cut", "lines"):
        np.testing.assert_allclose(found[way][-1], limit, rtol=5e-3)
        errors = found[way][:-1, 0] - limit
        rate, _ = np.polyfit(np.log(on_rim), np.log(errors), 1)
        assert -2.3 < rate < -1.6
