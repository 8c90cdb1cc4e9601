"""The benchmark of cables along lines, on coarse roofs."""

from __future__ import annotations

import re

import lines
import numpy as np
import pytest
from lined import dome
from lined.many_roofs import run
from lined.mirrored import MESHES


def test_square() -> None:
    """A line slides to the place that folded cells find."""
    found = lines.square((10, 20))
    limit = (103.0532, -298.76483, 29.39128)  # docs/benchmarks/validation.md
    np.testing.assert_allclose(found[-1], limit, rtol=1e-3)
    assert np.all(np.abs(found[1] - limit)[:2] < 0.4 * np.abs(found[0] - limit)[:2])


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_dome(capsys: pytest.CaptureFixture[str]) -> None:
    """A step with cables takes few factorisations, and lines that slide change tensions little."""
    lines.dome(1600.0, 1)
    said = capsys.readouterr().out
    means = []
    for way in ("held", "slide"):
        ((*counts, mean),) = re.findall(
            rf"lines {way} .* (\d+)\+(\d+) +\d+\+\d+ +[\d.]+ +[\d.]+ +([\d.]+)", said
        )
        assert max(map(int, counts)) <= 12
        means.append(float(mean))
    assert 0.99 < means[1] / means[0] < 1.0


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_mirrored_mesh() -> None:
    """Tensions of cables that are mirror images are equal where the mesh is mirrored, too."""
    mesh = MESHES["mirrored"](3000.0)
    found = dome.inflated(mesh, dome.net_on(mesh))
    families = np.reshape(found.tensions, (2, 2, dome.CABLES))
    assert dome.unlike(families).max() < 1e-7


def test_random_roofs(capsys: pytest.CaptureFixture[str]) -> None:
    """One that embeds its lines, and one that is cut along them."""
    assert run(7, 1500.0) == [] == run(3, 1500.0)
    assert capsys.readouterr().out.count(" verified") == 20


def test_angles_of_a_hall() -> None:
    name, mesh, routes = next(lines.roofs(0.2))
    assert len(routes) == 12 and "12 cables" in name
    assert lines.smallest_angles(mesh).min() > 30.0


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_lines_and_folded_cables_have_one_limit() -> None:
    """Of tensions; errors on meshes along the cables fall with the cells' size to the square."""
    on_rim = (96, 120, 144)
    found = lines.limits(1.0, on_rim)
    limit = found["folded"][-1, 0]
    for way in ("cut", "lines"):
        np.testing.assert_allclose(found[way][-1], limit, rtol=5e-3)
        errors = found[way][:-1, 0] - limit
        rate, _ = np.polyfit(np.log(on_rim), np.log(errors), 1)
        assert -2.3 < rate < -1.6
