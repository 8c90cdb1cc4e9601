"""What smoothing adds to the lengths of cables is taken off with the friction that there is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from crms_fenicsx.analysis.equilibrium import search
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.energy.minimization.outcome import Outcome

FOUND = Outcome(True, "found", 0.0, 1.0, 1, 1, 1)


def test_friction_is_renewed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It settles less sharply: each time it would lead to other lengths, without end."""
    changes, solved = [True, True, True, False], list[str]()

    class Loop:
        def __init__(self, *_: object) -> None: ...

        def solve(self, *_: object) -> Outcome:
            solved.append("friction")
            return replace(FOUND, unsettled=0.03)

    def in_cells(h0_prestress: object, rough: bool) -> Outcome:
        assert not rough
        solved.append("in cells")
        return FOUND

    monkeypatch.setattr(search, "FrictionLoop", Loop)
    system: Any = SimpleNamespace(scene=None, renew_smoothing_length=lambda: changes.pop(0))
    contacts: Any = SimpleNamespace(solve_in_cells=in_cells)
    found = EquilibriumSearch(system, None)._unsmoothed(FOUND, contacts)
    assert solved == ["friction", "in cells", "in cells"]
    assert found.converged and found.unsettled == 0.03 and found.iterations == 4
