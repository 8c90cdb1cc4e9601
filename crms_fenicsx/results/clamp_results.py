"""Forces of clamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.triangles import cross, norm
from crms_fenicsx.foundation.runtime.arrays import Array, floats
from crms_fenicsx.model.cable import Clamp
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.results.cable_and_bar_results import Force

Pair = tuple[float, float]


@dataclass(frozen=True)
class ClampResults:
    """Results of a clamp in equilibrium.

    Attributes
    ----------
    name
        Name of the clamp.
    place
        Position, (3,) (length).
    before, after
        Tensions of the two cables before and after the clamp, along their directions (force).
    force
        Tangential force that the clamp transfers from the first cable to the second, (3,) (force).
    """

    name: str
    place: Force
    before: Pair
    after: Pair
    force: Force

    @property
    def differences(self) -> Pair:
        """Increase of its cables' tensions at the clamp (force)."""
        return self.after[0] - self.before[0], self.after[1] - self.before[1]

    @property
    def size(self) -> float:
        """Magnitude of the tangential force on the clamp (force)."""
        return float(np.linalg.norm(self.force))


def clamp_results(scene: Scene) -> dict[str, ClampResults]:
    """Results of a scene's clamps by name; zero if a cable is slack."""
    return {clamp.name: _results(scene, clamp) for clamp in scene.clamps}


def _results(scene: Scene, clamp: Clamp) -> ClampResults:
    sides = [_side(scene.cable(name), at) for name, at in zip(clamp.cables, clamp.at, strict=True)]
    (first, ways), (second, others) = sides
    # Each cable pulls with T2 t2 - T1 t1; air and membrane carry the part normal to both.
    pulls = [side[1] * way[1] - side[0] * way[0] for side, way in sides]
    across = cross(ways.sum(axis=0), others.sum(axis=0))
    normal = across / max(float(norm(across)), 1e-300)
    force = (pulls[0] - pulls[1]) / 2
    force = force - (force @ normal) * normal
    x, y, z = floats(clamp.place)
    u, v, w = floats(force)
    before, after = (first[0], second[0]), (first[1], second[1])
    return ClampResults(clamp.name, (x, y, z), before, after, (u, v, w))


def _side(cable: LaidCable, at: float) -> tuple[Pair, Array]:
    """Tensions before and after a clamp, and the cable's directions there, (2, 3)."""
    if cable.state.parts is None or not cable.state.parts.nodes:
        return (0.0, 0.0), np.zeros((2, 3))
    i = int(np.argmin(np.abs(cable.state.parts.at - at)))
    contacts = cable.contacts()
    k = contacts.index(cable.state.parts.nodes[i])
    ways = np.diff(cable.state.positions[contacts[k - 1 : k + 2]], axis=0)
    before, after = floats(cable.part_tensions[k - 1 : k + 1])
    return (before, after), np.asarray(ways / np.maximum(norm(ways), 1e-300)[:, None])
