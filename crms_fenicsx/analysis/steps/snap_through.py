"""Find the loads at which a structure snaps through within a load step.

A load step whose minimisation passed through non-convex energy is bisected, and so is each half in
which this happens again. If stable equilibria connect both ends, as from the flat state of a sheet,
no such half remains, or its displacement shrinks with the increment. A displacement that does not
shrink is a jump: the equilibrium of the structure has become unstable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.other_states import furthest
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.increment_solver import IncrementSolver
from crms_fenicsx.analysis.steps.loading import Target, between
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.versions import StateWarning

FINE, LEAST, MOST = 0.005, 3, 12
"""Load interval, relative to the load, at which bisection ends, and the least and largest number of
intervals examined."""

SHARES, WIDE = (0.5, 0.25, 0.75), 0.05
"""Places in an interval that are tried in turn until one has an equilibrium, as a solve may fail at
one load and not at others, and the width, in increments, down to which that is done."""

SMALLEST = 0.05
"""Least load for that comparison, relative to the larger of the load's end values."""

LEFT = 0.7
"""Part of the displacement that a jump keeps at least after two bisections. A steep but stable
branch, as next to a bifurcation, keeps half."""


@dataclass(frozen=True)
class _Part:
    """Part of an increment; `solved`: whether its end was computed from this start."""

    start: SceneState
    end: SceneState
    low: float
    high: float
    solved: bool = True


class SnapThroughSearch:
    """Searches an increment for a snap-through."""

    def __init__(
        self, increments: IncrementSolver, target: Target, first: SceneState, steps: int
    ) -> None:
        self.increments, self.scene = increments, increments.scene
        self.target, self.first, self.steps = target, first, steps

    def find(
        self, before: SceneState, low: float, high: float, balanced: bool
    ) -> StateWarning | None:
        """Find a snap-through in the increment that ends in the present state. Collective."""
        end, began = self.increments.snapshot(), low
        part = _Part(replace(before, tried=end.tried), end, low, high)
        sizes = [self._largest_displacement(before, end)[0]]
        try:
            while len(sizes) < LEAST or (len(sizes) < MOST and not self._is_fine(part)):
                halves = self._nonconvex_halves(part, LEFT * sizes[-1])
                if halves is None:  # no equilibrium in between to narrow the interval
                    break
                if not halves:
                    return None
                size, part = max(halves, key=lambda one: one[0])
                sizes.append(size)
            calm = False
            if not part.solved:  # the energy may be convex all the way
                outcome = self._solve(part.start, part.low, part.high)
                calm = outcome.converged and not outcome.nonconvex
        finally:
            self.increments.go_back_to(end)
        if calm:
            return None
        if sizes[-1] < LEFT * sizes[-min(len(sizes), 3)] or (part.low == began and not balanced):
            return None
        return self._warning(part)

    def _nonconvex_halves(self, part: _Part, large: float) -> list[tuple[float, _Part]] | None:
        """Halves with non-convex energy and their displacements. Collective."""
        # None if no equilibrium is found in between. While the second half's displacement stays
        # large, it is not solved: a jump takes the most iterations.
        found: list[tuple[float, _Part]] = []
        reached = self._between(part)
        if reached is None:
            return None
        middle, outcome = reached
        start = part.start
        for low, high in ((part.low, middle), (middle, part.high)):
            left = self._largest_displacement(start, part.end)[0]
            if low == middle:
                if not found and left >= large:
                    return [(left, _Part(start, part.end, low, high, solved=False))]
                outcome = self._solve(start, low, high)
                if not outcome.converged:
                    return [(left, _Part(start, part.end, low, high))]
            end = self.increments.snapshot()
            size = self._largest_displacement(start, end)[0]
            if outcome.nonconvex:
                found.append((size, _Part(start, end, low, high)))
            if outcome.nonconvex and size >= large:
                break
            start = end
        return found

    def _between(self, part: _Part) -> tuple[float, Outcome] | None:
        """Solve at the first place in a part where an equilibrium is found. Collective."""
        for share in SHARES if part.high - part.low > WIDE else SHARES[:1]:
            middle = part.low + share * (part.high - part.low)
            outcome = self._solve(part.start, part.low, middle)
            if outcome.converged:
                return middle, outcome
        return None

    def _solve(self, start: SceneState, low: float, high: float) -> Outcome:
        """Solve a part of the increment from its start. Collective."""
        self.increments.go_back_to(start)
        found = self.increments.solve(self.target, self.first, start, low, high, self.steps)
        return found.outcome

    def _is_fine(self, part: _Part) -> bool:
        """Whether a part narrows every load down to `FINE`."""
        for first, last in self._load_ranges().values() or [(0.0, 1.0)]:
            value = max(abs(first + part.high / self.steps * (last - first)),
                        SMALLEST * max(abs(first), abs(last)))  # fmt: skip
            if (part.high - part.low) / self.steps * abs(last - first) > FINE * value:
                return False
        return True

    def _load_ranges(self) -> dict[str, tuple[float, float]]:
        """First and last value of each changing load, without supports, lengths and sealed air."""
        ways, inner = dict(self.target.factors), self.target.pressure
        if not inner.fans and inner.air is None:
            ways["pressure"] = (inner.first, inner.last)
        return {name: way for name, way in ways.items() if way[0] != way[1]}

    def _largest_displacement(self, before: SceneState, after: SceneState) -> tuple[float, Array]:
        """Largest displacement (length) of a vertex or joint, and its place before. Collective."""
        own = self.scene.V.dofmap.index_map.size_local
        membrane = self.scene.membrane
        places: Array = membrane.positions_in(before.membrane)[:own]
        moved: Array = membrane.positions_in(after.membrane)[:own] - places
        if before.frame.joints:
            joints = np.array([joint.position for joint in before.frame.joints.values()])
            ends = np.array([joint.position for joint in after.frame.joints.values()])
            places, moved = np.concatenate([places, joints]), np.concatenate([moved, ends - joints])
        return furthest(self.scene.comm, moved, places)

    def _warning(self, part: _Part) -> StateWarning:
        """Warning for a snap-through in a part of the increment. Collective."""
        before, after = part.start, part.end
        low, high = float(part.low / self.steps), float(part.high / self.steps)
        loads = {
            name: (between(a, b, low), between(a, b, high))
            for name, (a, b) in self._load_ranges().items()
        }
        known = [f"{a:.5g} and {b:.5g} of {name!r}" for name, (a, b) in loads.items()]
        size, place = self._largest_displacement(before, after)
        words = (
            f"between {', '.join(known) or f'{low:.2%} and {high:.2%} of the way'} the equilibrium "
            f"becomes unstable: the structure jumps to another one, which no stable equilibria "
            f"connect to it, by {size:.3g} near {as_text(place)}"
        )
        scene, heights = self.scene, []
        for state in (before, after):
            z = scene.membrane.positions_in(state.membrane)[:, 2]
            heights.append(scene.comm.allreduce(float(z.min(initial=np.inf)), op=MPI.MIN))
        if scene.floor_level is None and heights[1] < heights[0] - 0.1 * size:
            words += f"; where the ground would stop it, add scene.floor({heights[0]:.4g}) before"
        return StateWarning("snap-through", words, loads)
