"""What a scene is under: pressure, loads, water, air, and where its supports and anchors are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.stage import Stage
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.scene import Scene


@dataclass(frozen=True)
class Loading:
    """All that load steps bring on.

    Attributes
    ----------
    u : (n, 3)
        Displacements, of which the held ones count (length).
    pressure, air
        As in the scene.
    sealed_on
        What the air was sealed on.
    factors
        Of loads and ponds, by their names.
    ends
        Where cables begin and end, (2, 3) each, by their names (length).
    lengths
        Unstressed lengths of cables and bars, by these (length).
    joints
        Where joints are, (3,) each, by their names (length).
    """

    u: Array
    pressure: float
    air: SealedAir | None
    sealed_on: Stage | None
    factors: Mapping[str, float]
    ends: Mapping[str, Array]
    lengths: Mapping[tuple[str, str], float]
    joints: Mapping[str, Array]

    @classmethod
    def of(cls, scene: Scene) -> Loading:
        """What a scene is under now."""
        lengths = {("cable", cable.name): cable.L0 for cable in scene.cables}
        return cls(
            scene.u.x.array.reshape(-1, 3).copy(),
            scene.pressure,
            scene.air,
            scene._sealed_on,
            scene.factors,
            {cable.name: cable.positions[[0, -1]] for cable in scene.cables},
            lengths | {("bar", bar.name): bar.L0 for bar in scene.bars},
            {joint.name: joint.position for joint in scene.joints},
        )

    def sealed(self, scene: Scene) -> tuple[SealedAir | None, Stage | None]:
        """The air, as it was sealed or as a scene has it now; and what it was sealed on."""
        if self.air is None or scene.air is not None:
            return (self.air and scene.air), self.sealed_on
        first = self.air.absolute - self.air.sealed_at
        return replace(self.air, atmosphere=first, temperature=1.0), self.sealed_on

    def take(self, scene: Scene, goal: Loading, share: float) -> None:
        """Bring a scene with the same things to a share of the way to other loads."""

        def between(first: float, last: float) -> float:
            return last if share == 1.0 else first + share * (last - first)

        u = scene.u.x.array.reshape(-1, 3)
        u[scene.held] = (self.u + share * (goal.u - self.u))[scene.held]
        scene._pressure = between(self.pressure, goal.pressure)
        if self.air is not None and goal.air is not None:
            scene._air = replace(
                goal.air,
                temperature=between(self.air.temperature, goal.air.temperature),
                atmosphere=between(self.air.atmosphere, goal.air.atmosphere),
            )
        factors = {n: between(self.factors[n], goal.factors[n]) for n in scene.factors}
        scene._loads = tuple(replace(one, factor=factors[one.name]) for one in scene.loads)
        scene._ponds = tuple(replace(one, factor=factors[one.name]) for one in scene.ponds)
        for cable in scene.cables:
            first, last = self.ends[cable.name], goal.ends[cable.name]
            positions = cable.positions.copy()
            for k in (0, -1):
                if cable.nodes[k].kind == "anchor" and cable.joints[k] is None:
                    positions[k] = first[k] + share * (last[k] - first[k])
            key = ("cable", cable.name)
            cable.update(positions=positions, L0=between(self.lengths[key], goal.lengths[key]))
        for bar in scene.bars:
            key = ("bar", bar.name)
            bar.update(L0=between(self.lengths[key], goal.lengths[key]))
        for joint in scene.joints:
            first, last, position = self.joints[joint.name], goal.joints[joint.name], joint.position
            way = first + share * (last - first)
            joint.update(position=np.where(joint.held, way, position))
