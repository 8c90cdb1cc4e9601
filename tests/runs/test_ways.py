"""A few of the random scenes of benchmarks/ways.py: one equilibrium whatever the way, at rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
import ways
from same_state import assert_same_state

from crms_fenicsx import LaidCable
from crms_fenicsx.cabling.paths.geodesic_sliding import GeodesicSliding

ALIKE = (
    1,  # a cap whose mesh has meridians
    8,  # a gmsh mesh with the cable's line in it, cable nearly slack
    71,  # an air hall, cable nearly slack
    143,  # another one, whose cable turns by much and by little from edge to edge
    151,  # a jiggled mesh
    152,  # along a row of a turned lattice
    155,  # diagonals to the left
    161,  # an air hall whose cable is slack, and in tension with three times the pressure
    165,  # a tight cable on a gmsh mesh
)
SHORT = (1, 161)
"""A cap and an air hall, which always run; the others are slow."""


@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=[pytest.mark.slow] * (n not in SHORT)) for n in ALIKE]
)
def test_one_equilibrium_whatever_the_way(number: int) -> None:
    """Six ways, and the same load once more."""
    result = ways.run(number)
    assert not result.refused
    for way in ways.WAYS:
        assert result.within(way) and result.rests(way), ways.line(result)
        assert result.tightened[way] < 1e-9
    assert result.again_evaluations <= 5 * len(ways.WAYS)


def test_the_same_load_moves_nothing() -> None:
    """A round of held runs that gained little had left some of them for the next load step.

    The cable is nearly slack: it may be tried slack once more, which changes nothing.
    """
    result = ways.run(66, ["out"])
    assert result.rests("out") and result.again_evaluations <= 25, ways.line(result)


@pytest.mark.parametrize("number", [1, 66])
def test_a_path_at_rest_is_not_pulled_taut_again(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load step that ends with its budget of geodesics used up had left the next ones for the
    same load once more."""
    given = ways.setting(number, 10)
    scene, solver = ways.Ways(given).solve("direct")
    kept, pulled, pull = scene.state, list[object](), GeodesicSliding._slide

    def slide(self: GeodesicSliding, cables: Sequence[LaidCable], *rest: Any, **named: Any) -> int:
        pulled.extend(cables)
        return pull(self, cables, *rest, **named)

    monkeypatch.setattr(GeodesicSliding, "_slide", slide)
    solver.advance(pressure=given.pressure)
    assert_same_state(scene.state, kept, rtol=1e-12)
    assert not pulled
    solver.advance(pressure=1.5 * given.pressure)  # moves the cable
    assert pulled
