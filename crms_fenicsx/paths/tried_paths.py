"""What has been tried of paths and contacts, so that it is not tried again in the same state."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from crms_fenicsx.contact.active_set import ContactKey
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.paths.path_change import is_crossed
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.corridor import Corridor
from crms_fenicsx.surface.points import Support

MISLED, MISLED_AT_CROSSINGS = 2, 1
"""How often in a load step geodesics may propose paths of higher energy, before only the forces of
vertices tell where cables go; and where cables cross, of which geodesics know little."""

WayKey = tuple[str, str, Support, bool]
"""What another way of crossing cables is known by: its kind, the other cable if there is one, the
vertex or the ends of the edge, and which of two orders."""

STILL = 1e-4
"""Movement, relative to a cable's length, within which rejected paths stay rejected."""


@dataclass
class TriedPaths:
    """What was tried in earlier load steps, by cable, and what in this one."""

    refused: dict[str, set[Corridor]] = field(default_factory=dict)  # paths that have been given up
    # runs of vertices that were left, and taken again: 1 for those left to the cable's left or -1,
    # and the vertices
    left: dict[str, set[tuple[int, ...]]] = field(default_factory=dict)
    # other ways of crossing cables; see `crms_fenicsx.paths.crossing_trials`
    ways: dict[str, set[WayKey]] = field(default_factory=dict)
    # (n, 3) where the cable was at the end of a load step (length); one that has hardly moved since
    # is still compared to where it was, so that it cannot creep away
    at: dict[str, Array] = field(default_factory=dict)
    L0: dict[str, float] = field(default_factory=dict)  # unstressed length then (length)
    # released, settled: where contacts have been released in the last load step, and where they
    # then stay closed however the cable pulls
    released: set[ContactKey] = field(default_factory=set)
    settled: set[ContactKey] = field(default_factory=set)
    # rejected, straightened: what cables with friction have not taken: ways past vertices, and fold
    # points put back in place
    rejected: set[tuple[str, Corridor]] = field(default_factory=set)
    straightened: set[tuple[str, Corridor]] = field(default_factory=set)
    # ways past a vertex, by cable, that cables with friction take now
    proposed: set[tuple[str, Corridor]] = field(init=False, default_factory=set)
    # how often cables with friction have passed a vertex in this load step, to its left or not
    passes: Counter[tuple[str, int, bool]] = field(init=False, default_factory=Counter)
    _misled: int = field(init=False, default=0)
    _first_look: bool = field(init=False, default=True)

    def begin_step(self) -> None:
        """Forget what holds for one load step only."""
        self._first_look, self._misled = True, 0
        self.proposed = set()
        self.passes.clear()

    def end_step(self, cables: Sequence[LaidCable]) -> None:
        """Note where the cables are, and how long."""
        for cable in cables:
            if self.has_moved(cable):
                self.at[cable.name] = cable.positions.copy()
        self.L0 = {cable.name: cable.L0 for cable in cables}

    def forget(self, name: str) -> None:
        """Forget all of a cable."""
        for table in (self.refused, self.left, self.ways, self.at, self.L0):
            table.pop(name, None)
        for keys in (self.released, self.settled):
            keys -= {key for key in keys if name in key}
        self._forget_ways(name)

    def _forget_ways(self, name: str) -> None:
        for ways in (self.rejected, self.straightened):
            ways -= {way for way in ways if way[0] == name}

    def forget_moved(self, cables: Sequence[LaidCable]) -> None:
        """Forget the paths that were tried for cables that have moved since. Once in a load step,
        in its first equilibrium: what was rejected in the state that is there would be rejected
        again, and a step without any load shall cost nothing."""
        if not self._first_look:
            return
        self._first_look = False
        for cable in cables:
            if self.has_moved(cable):
                self.refused.pop(cable.name, None)
                self.left.pop(cable.name, None)
                self.ways.pop(cable.name, None)
                self._forget_ways(cable.name)

    def has_moved(self, cable: LaidCable) -> bool:
        """Whether a cable is somewhere else than where the load steps before have left it."""
        before, x = self.at.get(cable.name), cable.positions
        if before is None or before.shape != x.shape:
            return True
        return bool(np.abs(before - x).max() > STILL * cable.length)

    def has_rested(self, cable: LaidCable) -> bool:
        """Whether a cable is as the last load step has found it."""
        return self.L0.get(cable.name) == cable.L0 and not self.has_moved(cable)

    def refused_paths(self) -> dict[str, set[Corridor]]:
        """A copy of the paths that have been given up, by cable."""
        return {name: set(ways) for name, ways in self.refused.items()}

    def runs_left(self, cable: LaidCable) -> set[tuple[int, ...]]:
        """The runs of vertices that a cable has left, to which new ones may be added."""
        return self.left.setdefault(cable.name, set())

    def count_misled(self) -> None:
        """Count a geodesic of higher energy; soon none is proposed any more in this load step."""
        self._misled += 1

    def uses_geodesic(self, cable: LaidCable) -> bool:
        """Whether a geodesic may still propose a path to a cable in this load step."""
        return self._misled < (MISLED_AT_CROSSINGS if is_crossed(cable) else MISLED)
