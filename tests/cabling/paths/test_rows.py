"""Cables along lines of the mesh give what the same cables laid by path and held sideways give."""

from __future__ import annotations

import numpy as np
import pytest

from crms_fenicsx import Cable, Solver
from crms_fenicsx.model.cable import HOLDS, Hold
from tests.scenes.lined_roof import LINES, lined_scene, net_of_lines


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_a_cable_along_a_line_is_that_laid_by_path_and_held(hold: Hold) -> None:
    by_path: Hold = "bonded" if hold == "bonded" else "pocket"
    found = []
    for on_lines in (True, False):
        scene, cables = lined_scene(on_lines=on_lines, hold=hold if on_lines else by_path)
        step = Solver(scene, slide=on_lines).advance(pressure=4.0)
        values = [step.energy, *(x for one in cables for x in (one.tension, one.length, one.L0))]
        found.append((np.array(values), scene.positions()))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-10)
    assert np.abs(found[0][1] - found[1][1]).max(initial=0.0) < 1e-10


def test_all_lines_of_a_net_are_laid_along_those_of_the_mesh() -> None:
    one, single = lined_scene(on_lines=True)
    other, _ = lined_scene(on_lines=True)
    for name in LINES:
        other.remove(name)
    together = other.lay_net(net_of_lines(), Cable(EA=2e3), tension=2.0, hold="pocket")
    assert [c.name for c in together] == list(LINES)
    for a, b in zip(single, together, strict=True):
        assert (a.L0, a.tension, a.hold) == (b.L0, b.tension, b.hold)
        assert np.array_equal(a.line, b.line)
    assert len(one.cables) == 3
