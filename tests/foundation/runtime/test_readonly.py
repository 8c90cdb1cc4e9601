"""What follows from loads cannot be assigned, and a failed increment changes none of it."""

from __future__ import annotations

import copy
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np
import pytest
from cabled_square import sheet

from crms_fenicsx import Bar, Cable, ConvergenceError, Friction, LaidCable, Scene, Solver
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.handle import ReadOnly
from crms_fenicsx.model.cable_state import CableState

FAILURE = Outcome(False, "made to fail", 1.0, 0.0, 0, 0, 0)
CABLES = {
    "plain": Cable(EA=32000.0),
    "step": Cable(EA=32000.0, law="step"),
    "rough": Cable(EA=32000.0, friction=Friction(0.3, along=0.2)),
}


def laid(comm, kind: str = "plain") -> tuple[Scene, Solver, LaidCable]:
    scene = sheet(comm, 4)
    cable = scene.lay_cable(CABLES[kind], [(-9.0, 47.0, 0.0), (109.0, 56.0, 0.0)], tension=9.0)
    return scene, Solver(scene, max_halvings=0), cable


def test_nothing_is_assigned(comm) -> None:
    """The message names the way to do it. On one rank alone it would be done there only."""
    scene, solver, cable = laid(comm)
    bar = scene.add_bar(Bar(1.0), (0.0, 0.0, 9.0), (1.0, 0.0, 9.0))
    for state in (bar.state, bar.start.state):
        with pytest.raises(FrozenInstanceError):
            state.position = None
    ways = {
        (solver, "rtol"): r"Solver.rtol = 7: .* make another Solver",
        (scene, "pressure"): r"Scene.pressure = 7: .* call solver.advance\(pressure=",
        (scene, "loads"): r"scene.put_load\(",
        (scene, "air"): r"solver.advance\(pressure=",
        (scene, "frame"): r"scene.add_bar\(",
        (scene.loads, "ponds"): r"scene.put_pond\(",
        (scene, "cables"): "scene.lay_cable",
        (scene, "terms"): r"scene.add_term\(term\)",
        (scene, "floor_level"): r"scene.floor\(z\)",
        (cable, "L0"): r"LaidCable.L0 = 7: .*solver.advance\(L0=",
        (cable, "tension"): "solver.advance",
        (cable, "taut"): "solver.advance",
        (cable, "length"): "solver.advance",
        (cable, "name"): "when it is made",
        (scene, "bars"): "scene.add_bar",
        (scene, "joints"): "scene.add_joint",
        (bar, "L0"): r"PlacedBar.L0 = 7: .*solver.advance\(L0=",
        (bar, "points"): "solver.advance",
        (bar.start, "position"): "solver.advance",
    }
    for (owner, name), way in ways.items():
        before = getattr(owner, name)
        with pytest.raises(AttributeError, match=way):
            setattr(owner, name, 7)
        assert getattr(owner, name) is before
    shown = {name for name, value in vars(LaidCable).items() if isinstance(value, ReadOnly)}
    assert shown == {
        *("cable", "hold", "layer", "L0", "length", "tension", "taut", "reference_positions")
    }
    assert isinstance(scene.cables, tuple)


def test_all_that_changes_of_a_cable_is_its_state(comm) -> None:
    """It is one frozen value, whose arrays cannot be written: a snapshot is a reference to it."""
    *_, cable = laid(comm)
    assert vars(cable).keys() == {"_name", "state"}
    before = cable.state
    for field in fields(CableState):
        with pytest.raises(FrozenInstanceError):
            setattr(cable.state, field.name, None)
        value = getattr(cable.state, field.name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[:] = 0
    cable.update(tension=7.0)
    assert cable.tension == 7.0 and before.law.tension != 7.0
    assert cable.state.positions is before.positions


def plain(value: Any) -> Any:
    """Data that can be compared."""
    if isinstance(value, np.ndarray):
        return value.tolist() if value.dtype != float else [repr(x) for x in value.ravel()]
    if not hasattr(value, "__dict__"):
        return value
    return {k: plain(v) for k, v in vars(value).items() if k != "row_of"}  # follows from others


@pytest.mark.ranks
@pytest.mark.parametrize("kind", CABLES)
def test_a_failed_increment_changes_no_cable_and_no_crossing(comm, monkeypatch, kind: str) -> None:
    """Not what it has for the next one either: failures come at any stage, also after all."""
    scene, solver, cable = laid(comm, kind)
    solver.advance(pressure=0.01)
    over = scene.lay_cable(CABLES[kind], [(41.0, 0.0), (62.0, 100.0)], L0=98.0)
    solver.advance(pressure=0.01)
    assert not scene.net.crossings[0].separated

    def state() -> list[Any]:
        values = (cable.state, over.state, *scene.net.crossings)
        return [plain(copy.deepcopy(value)) for value in values]

    before, energy = state(), scene.energy
    whole = type(solver.search).find
    committed = type(solver.system).commit

    def fails(self: Any, *arguments: Any) -> Outcome:
        outcome = whole(self, *arguments)
        for own in scene.cables:
            own.update(path_is_geodesic=not own.state.memory.path_is_geodesic)
        self.system.rebuild()
        return replace(outcome, converged=False)

    def interrupted(self: Any) -> None:
        committed(self)
        raise KeyboardInterrupt

    for owner, method, error in (
        (type(solver.search), "find", ConvergenceError),
        (type(solver.system), "commit", KeyboardInterrupt),
    ):
        for move in ({}, {cable.start: (0.0, 0.0, -1.0)}):
            with monkeypatch.context() as patch, pytest.raises(error):
                patch.setattr(owner, method, fails if method == "find" else interrupted)
                solver.advance(pressure=0.02, move=move)
            assert state() == before and scene.energy == energy
