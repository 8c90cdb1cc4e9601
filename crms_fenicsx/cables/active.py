"""What is active in one solve: which cables are in tension, where they touch, which cross.

All this is decided from a solved state, and the solve repeated until nothing changes. Everything
may change back and forth only a few times in a solve, so that it ends.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from crms_fenicsx.cables import contact
from crms_fenicsx.cables.cable import LaidCable
from crms_fenicsx.cables.folded_surface import bends
from crms_fenicsx.cables.path import VertexPoint
from crms_fenicsx.cables.strip import StripShape

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene


MAX_SWITCHES = 6
"""How often each cable may turn from slack to taut or back in one solve."""


class ActiveSet:
    """Decides what is active in one solve.

    Parameters
    ----------
    scene
        The scene; its cables and crossings are changed.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._switches: Counter[str] = Counter()
        self._released: set[object] = set()
        self._settled: set[object] = set()

    def tighten(self) -> list[str]:
        """Switch cables between slack and taut for their current lengths; say which. Collective."""
        shape = StripShape.of(self.scene)
        return [text for cable in self.scene.cables for text in self._switch(cable, shape)]

    def update(self) -> list[str]:
        """Switch what a solved state asks for; say what, in words. Collective."""
        scene, shape = self.scene, StripShape.of(self.scene)
        changes = [text for cable in scene.cables for text in self._switch(cable, shape)]
        if not changes:
            tops = self._tops()
            for c, cable in enumerate(scene.cables):
                if cable.taut and not cable.sleeve:
                    covered = {v for v, top in tops.items() if top > (cable.level, c)}
                    changes += self._contacts(cable, shape, covered)
        if not changes and scene.crossings:
            changes = self._crossings(shape)
        return changes

    def restless(self) -> str:
        """A cable that keeps turning from slack to taut and back; empty if there is none."""
        return next((name for name, n in self._switches.items() if n > MAX_SWITCHES), "")

    def _switch(self, cable: LaidCable, shape: StripShape) -> list[str]:
        """Tighten a slack cable that has become too short for its path, slacken another."""
        if cable.cable.law == "step":
            return []
        if not cable.taut and not cable.sleeve:
            contact.drape(cable, shape)
        taut = cable.is_tight(cable.ends_before is None and not self._switches[cable.name])
        if taut == cable.taut:
            return []
        cable.taut = taut
        cable.traced &= taut  # it gets its folds back from the straight way
        self._switches[cable.name] += 1
        return [f"{cable.name} {'tightens' if taut else 'slackens'}"]

    def _contacts(self, cable: LaidCable, shape: StripShape, covered: set[int]) -> list[str]:
        def key(k: int) -> object:
            point = cable.nodes[k].point
            assert point is not None
            return cable.name, point.support

        released = contact.released(cable, shape, covered)
        free = [k for k in released if key(k) not in self._settled]
        places = {}
        if cable.lifted.any():
            places = contact.captured(cable, shape, bends(self.scene.cables, cable))
        cable.lifted[free] = True
        contact.touch(cable, places)
        self._settled |= {key(k) for k in places} & self._released
        self._released |= {key(k) for k in free}
        texts = [f"{cable.name} lifts off at {cable.nodes[k].point}" for k in free]
        return texts + [f"{cable.name} touches down at {cable.nodes[k].point}" for k in places]

    def _tops(self) -> dict[int, tuple[int, int]]:
        """The uppermost cable in tension on each vertex that one touches: its level and number."""
        tops: dict[int, tuple[int, int]] = {}
        for c, cable in enumerate(self.scene.cables):
            for k in cable.contacts() if cable.taut else []:
                point = cable.nodes[k].point
                if isinstance(point, VertexPoint):
                    order = (cable.level, c)
                    tops[point.vertex] = max(order, tops.get(point.vertex, order))
        return tops

    def _crossings(self, shape: StripShape) -> list[str]:
        changes = []
        scene = self.scene
        parting = {id(k) for k in contact.parting(scene.crossings, scene.cables, shape)}
        for crossing in scene.crossings:
            names = tuple(scene.cables[c].name for c in (crossing.upper, crossing.lower))
            # Not by place: a crossing may come back in another cell than that where it was left.
            if id(crossing) in parting and names not in self._settled:
                crossing.apart = True
                self._released.add(names)
                changes.append("{} lifts off {}".format(*names))
            elif contact.joins(crossing, scene.cables, shape):
                crossing.apart = False
                if names in self._released:
                    self._settled.add(names)
                changes.append("{} touches {}".format(*names))
        return changes
