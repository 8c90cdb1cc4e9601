"""What follows from loads cannot be assigned, and a failed increment changes none of it."""

from __future__ import annotations

import copy
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from reference_meshes import square

from crms_fenicsx import Cable, ConvergenceError, Friction, IsotropicMembrane, Scene, Solver
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.model.laid_cable import CableState, LaidCable
from crms_fenicsx.runtime.readonly import ReadOnly

FAILURE = Outcome(False, "made to fail", 1.0, 0.0, 0, 0, 0)
CABLES = {
    "plain": Cable(EA=32000.0),
    "step": Cable(EA=32000.0, law="step"),
    "rough": Cable(EA=32000.0, friction=Friction(0.3, along=0.2)),
}


def laid(comm, kind: str = "plain") -> tuple[Scene, Solver, LaidCable]:
    scene = Scene(square(comm, 4), IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    cable = scene.lay_cable(CABLES[kind], [(-9.0, 47.0, 0.0), (109.0, 56.0, 0.0)], tension=9.0)
    return scene, Solver(scene, max_halvings=0), cable


def test_nothing_is_assigned(comm) -> None:
    """The message names the way to do it. On one rank alone it would be done there only."""
    scene, solver, cable = laid(comm)
    ways = {
        (solver, "rtol"): r"Solver.rtol = 7: .* make another Solver",
        (scene, "pressure"): r"Scene.pressure = 7: .* call solver.advance\(pressure=",
        (scene, "load"): r"solver.advance\(load=",
        (scene, "cables"): "scene.lay_cable",
        (scene, "floor_level"): r"scene.floor\(z\)",
        (cable, "L0"): r"LaidCable.L0 = 7: .*solver.advance\(L0=",
        (cable, "tension"): "solver.advance",
        (cable, "taut"): "solver.advance",
        (cable, "positions"): "solver.advance",
        (cable, "name"): "scene.lay_cable",
    }
    for (owner, name), way in ways.items():
        before = getattr(owner, name)
        with pytest.raises(AttributeError, match=way):
            setattr(owner, name, 7)
        assert getattr(owner, name) is before
    shown = {name for name, value in vars(LaidCable).items() if isinstance(value, ReadOnly)}
    assert shown == {field.name for field in fields(CableState)} | {
        "name",
        "cable",
        "sleeve",
        "level",
    }
    assert isinstance(scene.cables, tuple)


def plain(value: Any) -> Any:
    """Data that can be compared."""
    if isinstance(value, np.ndarray):
        return value.tolist() if value.dtype != float else [repr(x) for x in value.ravel()]
    if not hasattr(value, "__dict__"):
        return value
    return {k: plain(v) for k, v in vars(value).items() if k != "row_of"}  # follows from others


@pytest.mark.parametrize("kind", CABLES)
def test_a_failed_increment_changes_no_cable(comm, monkeypatch, kind: str) -> None:
    """Not what it has for the next one either: failures come at any stage, also after all."""
    scene, solver, cable = laid(comm, kind)
    solver.advance(pressure=0.01)
    before, energy = plain(copy.deepcopy(cable.state)), scene.energy
    whole = type(solver.search).find
    committed = type(solver.system).commit

    def fails(self: Any, *arguments: Any) -> Outcome:
        outcome = whole(self, *arguments)
        for own in scene.cables:
            own.state.traced = not own.traced
        return replace(outcome, converged=False)

    def interrupted(self: Any) -> None:
        committed(self)
        raise KeyboardInterrupt

    for owner, method, error in (
        (type(solver.search), "find", ConvergenceError),
        (type(solver.system), "commit", KeyboardInterrupt),
    ):
        with monkeypatch.context() as patch, pytest.raises(error):
            patch.setattr(owner, method, fails if method == "find" else interrupted)
            solver.advance(pressure=0.02, move={cable.start: (0.0, 0.0, -1.0)})
        assert plain(cable.state) == before and scene.energy == energy
