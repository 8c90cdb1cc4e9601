"""What is active in one solve: which cables are in tension, where they touch, which cross.

All this is decided from a solved state, and the solve repeated until nothing changes. Everything
may change back and forth only a few times in a solve, so that it ends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from crms_fenicsx.cables import contact
from crms_fenicsx.cables.cable import LaidCable
from crms_fenicsx.cables.folded_surface import bends, nodes_on_edges
from crms_fenicsx.cables.intrinsic import Edge
from crms_fenicsx.cables.path import EdgePoint, VertexPoint
from crms_fenicsx.cables.strip import StripShape

if TYPE_CHECKING:
    from crms_fenicsx.cables.retrace import ContactKey, Retracer
    from crms_fenicsx.scene import Scene


MAX_SWITCHES = 6
"""How often each cable may turn from slack to taut or back in one solve."""


class ActiveSet:
    """Decides what is active in one solve.

    Parameters
    ----------
    scene
        The scene; its cables and crossings are changed.
    paths
        What is remembered of the cables' last load step; None where they stay in their cells.
    """

    def __init__(self, scene: Scene, paths: Retracer | None) -> None:
        self.scene, self._paths = scene, paths
        self._switches: Counter[str] = Counter()
        self._tried: set[str] = set()
        """Cables that have been tried in tension."""
        self._first_look = True
        self._released, self._settled = (
            (set(), set()) if paths is None else (paths.released, paths.settled)
        )

    def tighten(self) -> list[str]:
        """Switch cables between slack and taut for their current lengths; say which. Collective."""
        shape = StripShape.of(self.scene)
        return [text for cable in self.scene.cables for text in self._switch(cable, shape, False)]

    def update(self) -> list[str]:
        """Switch what a solved state asks for; say what, in words. Collective."""
        if self._first_look:
            self._forget()
        scene, shape = self.scene, StripShape.of(self.scene)
        changes = [text for cable in scene.cables for text in self._switch(cable, shape, True)]
        if not changes:
            tops, on_edges = self._tops(), nodes_on_edges(scene.cables)
            for c, cable in enumerate(scene.cables):
                if cable.taut and not cable.sleeve:
                    covered = {v for v, top in tops.items() if top > (cable.level, c)}
                    changes += self._contacts(cable, shape, covered, on_edges)
        if not changes and scene.crossings:
            changes = self._crossings(shape)
        return changes

    def _forget(self) -> None:
        """Forget where cables were let go and touched, but not those that have not moved since.

        What has settled in the state that is there would settle again.
        """
        self._first_look = False
        moved = {cable.name for cable in self.scene.cables if not self._rested(cable)}
        for keys in (self._released, self._settled):
            keys -= {key for key in keys if not moved.isdisjoint(key)}

    def _rested(self, cable: LaidCable) -> bool:
        """Whether a cable is as the last load step has found it."""
        return self._paths is not None and self._paths.has_rested(cable)

    def restless(self) -> str:
        """A cable that keeps turning from slack to taut and back; empty if there is none."""
        return next((name for name, n in self._switches.items() if n > MAX_SWITCHES), "")

    def _switch(self, cable: LaidCable, shape: StripShape, solved: bool) -> list[str]:
        """Tighten a slack cable that has become too short for its path, slacken another.

        Near the limit a cable is in equilibrium both slack, on flat cells, and in tension, on cells
        that it has folded and that bulge. It is in tension if it is nearly tight on flat cells and
        stays so on folded ones, which is tried once in each solve. One that is in tension, but on
        flat cells would be slack, is let go first, so that the way there does not matter.
        """
        if cable.cable.law == "step":
            return []
        if not cable.taut and not cable.sleeve:
            contact.drape(cable, shape)
        untried = cable.name not in self._tried and not self._rested(cable)
        judged = solved and cable.taut
        taut = tight = cable.is_tight(nearly=untried and not judged)
        if judged and tight and untried and cable.slides_freely:
            taut = contact.flat_length(cable, shape) > cable.L0
        if taut == cable.taut:
            return []
        if taut or not tight:
            self._tried.add(cable.name)
        cable.state.taut = taut
        cable.state.traced &= taut  # it gets its folds back from the straight way
        self._switches[cable.name] += 1
        return [f"{cable.name} {'tightens' if taut else 'slackens'}"]

    def _contacts(
        self,
        cable: LaidCable,
        shape: StripShape,
        covered: set[int],
        on_edges: Mapping[Edge, Sequence[tuple[int, int]]],
    ) -> list[str]:
        def key(k: int) -> ContactKey:
            return cable.name, cable.nodes[k].support

        released = contact.released(cable, shape, covered)
        free = [k for k in released if key(k) not in self._settled]
        places = {}
        if cable.lifted.any():
            off = [cable.nodes[k].point for k in np.flatnonzero(cable.lifted)]
            edges = [point.edge for point in off if isinstance(point, EdgePoint)]
            near = {edge: on_edges[edge] for edge in edges if edge in on_edges}
            folds = bends(self.scene.cables, near, but=cable)
            places = contact.captured(cable, shape, folds)
            unclear = cable.slides_freely and not self._rested(cable)
            if unclear and not free and not places:
                nearly = contact.captured(cable, shape, folds, contact.NEARLY)
                places = {k: place for k, place in nearly.items() if key(k) not in self._released}
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
            names = scene.cables[crossing.upper].name, scene.cables[crossing.lower].name
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
