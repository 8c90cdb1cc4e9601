"""Between two load steps a structure may snap through: find at which loads.

A load step whose minimisation has gone a way on which the energy is not convex is looked at again,
in halves, with the half in which that is so halved again. If stable equilibria lead from one end to
the other, as those of a sheet from its flat state, no half is left, or the way in it becomes
shorter with the increment. What does not is a jump: the equilibrium in which the structure was has
become unstable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.model.versions import StateWarning
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import as_text
from crms_fenicsx.scene.state import SceneState
from crms_fenicsx.steps.increment_solver import IncrementSolver
from crms_fenicsx.steps.loading import Target, between

FINE, LEAST, MOST = 0.005, 3, 12
"""Width of the interval of each load, relative to its value, down to which it is halved, and how
many intervals are looked at, at least and at most."""

SMALLEST = 0.05
"""Part of the larger end of a load's way that its value counts as at least."""

LEFT = 0.7
"""Part of a way that two halvings of the increment leave at least of a jump. Where it is no jump
but steep for a short while, as next to a bifurcation, they leave half."""


@dataclass(frozen=True)
class _Part:
    """A part of an increment; `solved`: whether its end was found from this start."""

    start: SceneState
    end: SceneState
    low: float
    high: float
    solved: bool = True


class SnapThroughSearch:
    """Looks between the ends of an increment for a jump."""

    def __init__(
        self, increments: IncrementSolver, target: Target, first: SceneState, steps: int
    ) -> None:
        self.increments, self.scene = increments, increments.scene
        self.target, self.first, self.steps = target, first, steps

    def find(
        self, before: SceneState, low: float, high: float, balanced: bool
    ) -> StateWarning | None:
        """Find the jump of the increment at whose end the scene is. Collective."""
        end, began = self.increments.snapshot(), low
        part = _Part(replace(before, tried=end.tried), end, low, high)
        sizes = [self._way(before, end)[0]]
        try:
            while len(sizes) < LEAST or (len(sizes) < MOST and not self._is_fine(part)):
                halves = self._bent_halves(part, LEFT * sizes[-1])
                if halves is None:  # without equilibria in between it cannot be said closer
                    break
                if not halves:
                    return None
                size, part = max(halves, key=lambda one: one[0])
                sizes.append(size)
            calm = not part.solved and self._is_calm(part)
        finally:
            self.increments.go_back_to(end)
        if calm:
            return None
        if sizes[-1] < LEFT * sizes[-min(len(sizes), 3)] or (part.low == began and not balanced):
            return None
        return self._warning(part)

    def _bent_halves(self, part: _Part, large: float) -> list[tuple[float, _Part]] | None:
        """Halves on which the energy is not convex, with their movements. Collective."""
        # None without equilibrium in the middle. The second half is not solved while the way in it
        # stays large: a jump takes the most iterations of all.
        found: list[tuple[float, _Part]] = []
        start, middle = part.start, (part.low + part.high) / 2
        for low, high in ((part.low, middle), (middle, part.high)):
            left = self._way(start, part.end)[0]
            if low == middle and not found and left >= large:
                return [(left, _Part(start, part.end, low, high, solved=False))]
            self.increments.go_back_to(start)
            outcome = self.increments.solve(
                self.target, self.first, start, low, high, self.steps
            ).outcome
            if not outcome.converged and low == part.low:
                return None
            if not outcome.converged:
                return [(left, _Part(start, part.end, low, high))]
            end = self.increments.snapshot()
            size = self._way(start, end)[0]
            if outcome.bent:
                found.append((size, _Part(start, end, low, high)))
            if outcome.bent and size >= large:
                break
            start = end
        return found

    def _is_calm(self, part: _Part) -> bool:
        """Whether the energy is convex all the way from a part's start. Collective."""
        self.increments.go_back_to(part.start)
        outcome = self.increments.solve(
            self.target, self.first, part.start, part.low, part.high, self.steps
        ).outcome
        return outcome.converged and not outcome.bent

    def _is_fine(self, part: _Part) -> bool:
        """Whether the ends of a part tell each load well enough."""
        for first, last in self._ways().values() or [(0.0, 1.0)]:
            value = max(abs(first + part.high / self.steps * (last - first)),
                        SMALLEST * max(abs(first), abs(last)))  # fmt: skip
            if (part.high - part.low) / self.steps * abs(last - first) > FINE * value:
                return False
        return True

    def _ways(self) -> dict[str, tuple[float, float]]:
        """What loads go from and to, by their names; not of supports, lengths and sealed air."""
        ways, inner = dict(self.target.factors), self.target.pressure
        if inner.fans is None and inner.air is None:
            ways["pressure"] = (inner.first, inner.last)
        return {name: way for name, way in ways.items() if way[0] != way[1]}

    def _way(self, before: SceneState, after: SceneState) -> tuple[float, Array]:
        """Largest movement (length) of a vertex or joint, and where that was before. Collective."""
        own = self.scene.V.dofmap.index_map.size_local
        places: Array = self.scene.membrane.stress_free[:own] + before.u.reshape(-1, 3)[:own]
        moved: Array = (after.u - before.u).reshape(-1, 3)[:own]
        if before.frame.joints:
            joints = np.array([joint.position for joint in before.frame.joints.values()])
            ends = np.array([joint.position for joint in after.frame.joints.values()])
            places, moved = np.concatenate([places, joints]), np.concatenate([moved, ends - joints])
        sizes = np.linalg.norm(moved, axis=1)
        k = int(np.argmax(sizes)) if len(sizes) else -1
        found = (float(sizes[k]), places[k].tolist()) if k >= 0 else (0.0, [0.0] * 3)
        size, place = max(self.scene.comm.allgather(found))
        return size, np.array(place)

    def _warning(self, part: _Part) -> StateWarning:
        """Say what has happened in a part of the increment. Collective."""
        before, after = part.start, part.end
        low, high = float(part.low / self.steps), float(part.high / self.steps)
        loads = {
            name: (between(a, b, low), between(a, b, high)) for name, (a, b) in self._ways().items()
        }
        known = [f"{a:.5g} and {b:.5g} of {name!r}" for name, (a, b) in loads.items()]
        size, place = self._way(before, after)
        words = (
            f"between {', '.join(known) or f'{low:.2%} and {high:.2%} of the way'} the equilibrium "
            f"becomes unstable: the structure jumps to another one, which no stable equilibria "
            f"connect to it, by {size:.3g} near {as_text(place)}"
        )
        scene, heights = self.scene, []
        for state in (before, after):
            z = scene.membrane.stress_free[:, 2] + state.u.reshape(-1, 3)[:, 2]
            heights.append(scene.comm.allreduce(float(z.min(initial=np.inf)), op=MPI.MIN))
        if scene.floor_level is None and heights[1] < heights[0] - 0.1 * size:
            words += f"; where the ground would stop it, add scene.floor({heights[0]:.4g}) before"
        return StateWarning("snap-through", words, loads)
