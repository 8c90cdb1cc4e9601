"""History of tried paths and contacts, so that they are not tried again in the same state."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from crms_fenicsx.cabling.contact.active_set import ContactKey
from crms_fenicsx.cabling.paths.path_change import is_crossed
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.corridor import Corridor
from crms_fenicsx.foundation.surface.points import Support
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, TOL

WayKey = tuple[str, str, Support, bool]
"""Key of a trial at a crossing: kind, other cable if any, vertex or edge, one of two orders."""


@dataclass
class TriedPaths:
    """Trials of earlier load steps and of this one, by cable."""

    refused: dict[str, set[Corridor]] = field(default_factory=dict)  # rejected paths
    # runs of vertices already tried: 1 if left to the cable's left, else -1, and the vertices
    left: dict[str, set[tuple[int, ...]]] = field(default_factory=dict)
    # trials at crossings; see `cabling.paths.crossing_trials`
    ways: dict[str, set[WayKey]] = field(default_factory=dict)
    # (n, 3) cable positions at the end of a load step (length); not updated on small moves, so that
    # the cable cannot creep away
    at: dict[str, Array] = field(default_factory=dict)
    L0: dict[str, float] = field(default_factory=dict)  # unstressed length at that time (length)
    # released, settled: contacts released in the last step; those that then stay closed
    released: set[ContactKey] = field(default_factory=set)
    settled: set[ContactKey] = field(default_factory=set)
    # rejected, straightened: of cables with friction: ways past vertices, straightened fold points
    rejected: set[tuple[str, Corridor]] = field(default_factory=set)
    straightened: set[tuple[str, Corridor]] = field(default_factory=set)
    # current ways past a vertex of cables with friction, by cable
    proposed: set[tuple[str, Corridor]] = field(init=False, default_factory=set)
    # passes of cables with friction over a vertex in this load step, to its left or not
    passes: Counter[tuple[str, int, bool]] = field(init=False, default_factory=Counter)
    misled: int = field(init=False, default=0)  # geodesics of higher energy in this load step
    _first_look: bool = field(init=False, default=True)

    def begin_step(self) -> None:
        """Clear the data of the last load step."""
        self._first_look, self.misled = True, 0
        self.proposed = set()
        self.passes.clear()

    def end_step(self, cables: Sequence[LaidCable]) -> None:
        """Record positions and lengths of the cables."""
        for cable in cables:
            if self.has_moved(cable):
                self.at[cable.name] = cable.state.positions.copy()
        self.L0 = {cable.name: cable.L0 for cable in cables}

    def forget(self, name: str) -> None:
        """Remove the history of a cable."""
        self._forget_paths(name)
        self.at.pop(name, None)
        self.L0.pop(name, None)
        for keys in (self.released, self.settled):
            keys -= {key for key in keys if name in key}

    def _forget_paths(self, name: str) -> None:
        for table in (self.refused, self.left, self.ways):
            table.pop(name, None)
        for ways in (self.rejected, self.straightened):
            ways -= {way for way in ways if way[0] == name}

    def forget_moved(self, cables: Sequence[LaidCable]) -> None:
        """Forget the paths tried for cables that have moved since, once in a load step, at its
        first equilibrium: an unchanged state would reject all again, and must cost nothing."""
        if not self._first_look:
            return
        self._first_look = False
        for cable in cables:
            if self.has_moved(cable):
                self._forget_paths(cable.name)

    def has_moved(self, cable: LaidCable) -> bool:
        """Whether a cable is no longer where earlier load steps left it."""
        before, x = self.at.get(cable.name), cable.state.positions
        if before is None or before.shape != x.shape:
            return True
        return bool(np.abs(before - x).max() > TOL.slight * cable.length)

    def has_rested(self, cable: LaidCable) -> bool:
        """Whether a cable has not changed since the last load step."""
        return self.L0.get(cable.name) == cable.L0 and not self.has_moved(cable)

    def uses_geodesic(self, cable: LaidCable) -> bool:
        """Whether geodesics may still propose paths of a cable in this load step: not of one that
        has not moved since the last one, which ended with the budget that this one begins with."""
        return self.has_moved(cable) and self.misled < (
            BUDGET.misled_at_crossings if is_crossed(cable) else BUDGET.misled
        )
