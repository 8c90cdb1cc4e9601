"""Snapshots of a scene's state, to go back to when a load step fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from crms_fenicsx.model.bar import BarState, JointState
from crms_fenicsx.model.cable_state import CableNode, CableState
from crms_fenicsx.model.crossing import Crossing
from crms_fenicsx.model.membrane_load import MembraneLoad
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.versions import StateWarning, Version
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.scene import Scene


@dataclass(frozen=True)
class State:
    """Displacements, cables, bars and loads of a scene at one moment."""

    version: Version
    u: Array
    pressure: float
    air: SealedAir | None
    loads: tuple[MembraneLoad, ...]
    ponds: tuple[Pond, ...]
    energies: dict[str, float]
    cables: tuple[CableState, ...]
    crossings: tuple[Crossing, ...]
    joints: tuple[JointState, ...]
    bars: tuple[BarState, ...]
    warnings: tuple[StateWarning, ...]

    @classmethod
    def of(cls, scene: Scene) -> State:
        """The scene's current state."""
        return cls(
            scene.versions.current,
            scene.u.x.array.copy(),
            scene.pressure,
            scene.air,
            scene.loads,
            scene.ponds,
            dict(scene.energies),
            tuple(cable.state for cable in scene.cables),
            scene.net.crossings,
            tuple(joint.state for joint in scene.joints),
            tuple(bar.state for bar in scene.bars),
            scene.warnings,
        )

    def restore_positions(self, scene: Scene) -> None:
        """Bring membrane and cables to where they were, the cables on their new paths. Collective.

        Points that the paths had are where they were; others lie on the membrane of then.
        """
        scene.u.x.array[:] = self.u
        self._restore_frame(scene)
        shape = scene.net.strip_shape()
        for cable, was in zip(scene.cables, self.cables, strict=True):
            known = {_key(was.nodes, k): k for k in range(len(was.nodes)) if not was.lifted[k]}
            positions, fractions = cable.positions.copy(), cable.fractions.copy()
            for k in range(len(cable.nodes)):
                old = known.get(_key(cable.nodes, k))
                if old is not None:
                    positions[k], fractions[k] = was.positions[old], was.fractions[old]
                else:
                    positions[k] = shape.mean(*cable.interpolation(k))
            cable.update(positions=positions, fractions=fractions)

    def restore(self, scene: Scene) -> None:
        """Bring the scene back to this state."""
        scene.versions.current = self.version
        scene.u.x.array[:] = self.u
        scene._pressure, scene._air = self.pressure, self.air
        scene._loads, scene._ponds = self.loads, self.ponds
        scene.energies, scene._warnings = dict(self.energies), self.warnings
        self._restore_frame(scene)
        for cable, was in zip(scene.cables, self.cables, strict=True):
            cable.state = was
        scene.net.crossings = self.crossings

    def _restore_frame(self, scene: Scene) -> None:
        """Bring joints and bars to this state."""
        for joint, state in zip(scene.joints, self.joints, strict=True):
            joint.state = state
        for bar, was in zip(scene.bars, self.bars, strict=True):
            bar.state = was


def _key(nodes: Sequence[CableNode], k: int) -> object:
    """What a node is known by while a path changes."""
    point = nodes[k].point
    if point is None:
        return "end", k > 0
    return nodes[k].kind, point.support if nodes[k].slides else point
