"""Snapshots of a scene's state, to go back to when a load step fails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crms_fenicsx.scene import Scene

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class CableState:
    """What changes of a laid cable."""

    positions: Array
    fractions: Array
    L0: float
    length: float
    tension: float
    taut: bool
    blocked: tuple[int, ...]


@dataclass(frozen=True)
class State:
    """Displacements, cables and loads of a scene at one moment."""

    u: Array
    pressure: float
    energies: dict[str, float]
    cables: tuple[CableState, ...]

    @classmethod
    def of(cls, scene: Scene) -> State:
        """The scene's current state."""
        return cls(
            scene.u.x.array.copy(),
            scene.pressure,
            dict(scene.energies),
            tuple(
                CableState(
                    c.positions.copy(), c.fractions.copy(), c.L0, c.length, c.tension, c.taut,
                    c.blocked,
                )
                for c in scene.cables
            ),
        )  # fmt: skip

    def restore_shape(self, scene: Scene) -> None:
        """Bring only the positions of membrane and cables back to this state."""
        scene.u.x.array[:] = self.u
        for cable, was in zip(scene.cables, self.cables, strict=True):
            cable.positions[:], cable.fractions[:] = was.positions, was.fractions

    def restore(self, scene: Scene) -> None:
        """Bring the scene back to this state."""
        self.restore_shape(scene)
        scene.pressure = self.pressure
        scene.energies = dict(self.energies)
        for cable, was in zip(scene.cables, self.cables, strict=True):
            cable.L0, cable.length, cable.tension = was.L0, was.length, was.tension
            cable.taut, cable.blocked = was.taut, was.blocked
