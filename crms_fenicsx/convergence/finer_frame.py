"""Bars and joints of a scene, beside the membrane of the scene on the finer mesh.

Vertices keep their numbers, so that bars end where they did. A bar that was placed without a length
got the distance of its ends, and gets it on the finer mesh again; a length that was given, at
placing or in a load step, is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from crms_fenicsx.model.bar import BarEnd, Joint, PlacedBar, Placing
from crms_fenicsx.model.bar_state import BarState, JointState
from crms_fenicsx.model.stage import Stage, same
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.scene import Scene


class FinerFrame:
    """Gives the finer scene the bars and joints that the coarse one had in some state.

    Parameters
    ----------
    coarse, finer
        The scenes.
    """

    def __init__(self, coarse: Scene, finer: Scene) -> None:
        self._coarse, self._frame = coarse.frame, finer.frame
        self._stage = finer.stage
        self._joints = {j.name: Joint(j.name, j.first, j.held, j.state) for j in coarse.joints}
        self._bars = {
            b.name: PlacedBar(b.name, b.bar, self._end(b.start), self._end(b.end), b.state)
            for b in coarse.bars
        }

    def _end(self, end: BarEnd) -> BarEnd:
        return self._joints[end.name] if isinstance(end, Joint) else end

    def take(self, joints: Mapping[str, JointState], bars: Mapping[str, BarState]) -> None:
        """Give the finer scene joints and bars in some states, by their names."""
        frame = self._frame
        frame.joints = tuple(joint for name, joint in self._joints.items() if name in joints)
        frame.bars = tuple(bar for name, bar in self._bars.items() if name in bars)
        for joint in frame.joints:
            joint.state = joints[joint.name]
        for bar in frame.bars:
            was, now = self._coarse_bar(bar.name).placing, bar.placing
            bar.state = bars[bar.name]
            if was is not None and now is not None and bar.L0 == was.first.L0:
                bar.update(L0=now.first.L0)

    def _coarse_bar(self, name: str) -> PlacedBar:
        return next(bar for bar in self._coarse.bars if bar.name == name)

    def place(self, stage: Stage) -> None:
        """Place the bars that were placed on a stage, at which the finer scene is. Collective."""
        for bar in self._coarse.bars:
            was, now = bar.placing, self._bars[bar.name]
            if was is None or not same(was.stage, stage):
                continue
            first = was.first.points
            points = np.array([self._place(now.start, first[0]), self._place(now.end, first[1])])
            L0 = was.L0 or float(np.linalg.norm(points[1] - points[0]))
            now.placing = Placing(was.L0, BarState(L0, points), was.EA, self._stage())

    def _place(self, end: BarEnd, place: Array) -> Array:
        """Where an end is; a joint that has been in no load step is where it was in the coarse."""
        if isinstance(end, Joint) and self._frame.number(end) < 0:
            return place
        return self._frame.place_of(end)


def standing(scene: Scene, stage: Stage) -> Stage:
    """A stage without what was put there just then, and has been in no load step yet.

    Parameters
    ----------
    scene
        The coarse scene.
    stage
        One of its stages.
    """
    laid = {c.name for c in scene.cables if c.laying is not None and same(c.laying.stage, stage)}
    cables = {name: state for name, state in stage.cables.items() if name not in laid}
    new = {b.name for b in scene.bars if b.placing is not None and same(b.placing.stage, stage)}
    bars = {name: state for name, state in stage.bars.items() if name not in new}
    used: set[object] = {end for b in scene.bars if b.name in bars for end in (b.start, b.end)}
    ends = {end for c in scene.cables if c.name in cables for end in c.joints}
    kept = {j.name for j in scene.joints if j in used or j.held.all() or j.name in ends}
    joints = {name: state for name, state in stage.joints.items() if name in kept}
    return replace(stage, cables=cables, bars=bars, joints=joints)
