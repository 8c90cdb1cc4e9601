"""The state of a scene: one value, to which the scene comes back whatever was done in between."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields
from operator import is_

import numpy as np
import pytest
from cabled_square import CABLE, advanced, sheet
from same_state import assert_same, assert_same_state

from crms_fenicsx import Bar, Cable, Friction, IsotropicMembrane, Solver
from crms_fenicsx.analysis.scene.state import SceneState

STIFFER = IsotropicMembrane(E=900.0, nu=0.25, thickness=0.08)


def full(comm) -> Solver:
    """A scene of which each part has something."""
    scene = sheet(comm, 6)
    scene.put_load((0.0, 0.0, -1e-3), name="snow")
    scene.loads.put_wind(1e-3, -0.5)
    scene.loads.put_pond(1e-4, level=-0.1)
    top = scene.frame.add_joint((50.0, 50.0, 9.0), name="top", held="xy")
    scene.frame.add_bar(Bar(1e2), top, (50.0, 50.0, 30.0), name="hanger")
    scene.frame.add_bar(Bar(1e2), top, scene.frame.vertex_at((50.0, 50.0, 0.0)), name="post")
    rough = Cable(9000.0, friction=Friction(0.3, along=0.2))
    scene.lay_cable(rough, [(0.0, 33.0), (100.0, 41.0)], tension=5.0, name="rough")
    scene.lay_cable(CABLE, [(41.0, 0.0), (33.0, 100.0)], tension=5.0, name="smooth")
    return advanced(Solver(scene), pressure=0.01, load={"snow": 1.0, "wind": 0.5})


def change_all(solver: Solver) -> None:
    """Change each part of the scene."""
    scene = solver.scene
    scene.air.seal(volume=1e6)
    scene.floor(-50.0)
    scene.remove("rough")
    scene.remove_bar("hanger")
    scene.remove_load("wind")
    scene.set_material(STIFFER)
    scene.set_stiffness({scene.cable("smooth"): 5000.0})
    scene.lay_cable(CABLE, [(0.0, 70.0), (100.0, 60.0)], name="rough")
    scene.fix(lambda x: np.hypot(x[0] - 50.0, x[1] - 50.0) < 1.0)
    solver.advance(load={"snow": 2.0, "pond": 1.0}, L0={scene.cable("smooth"): 99.0})


@pytest.mark.ranks
def test_it_comes_back_whole(comm) -> None:
    """Each field; the cables and bars that come back are the objects that they were."""
    solver = full(comm)
    scene = solver.scene
    before, handles = scene.state, (*scene.cables, *scene.joints, *scene.bars)
    again = scene.state
    change_all(solver)
    changed = scene.state
    for name in ("membrane", "loads", "air", "frame", "net", "floor", "energies"):
        with pytest.raises(AssertionError):
            assert_same(getattr(changed, name), getattr(before, name), name)
    assert_same_state(before, again)  # what was done has not changed the value
    scene.state = before
    assert_same_state(scene.state, before)
    now = (*scene.cables, *scene.joints, *scene.bars)
    assert len(now) == len(handles) and all(map(is_, now, handles))
    assert scene.versions.current == before.version
    scene.state = changed
    assert_same_state(scene.state, changed)


def test_it_is_frozen(comm) -> None:
    state = full(comm).scene.state
    for field in fields(SceneState):
        with pytest.raises(FrozenInstanceError):
            setattr(state, field.name, None)
    assert repr(state).startswith("SceneState(energy ")
