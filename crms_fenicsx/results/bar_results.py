"""Forces of bars, and of what holds their joints."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.results.cable_results import Force
from crms_fenicsx.runtime.arrays import floats
from crms_fenicsx.scene import Scene


@dataclass(frozen=True)
class BarResults:
    """A bar in an equilibrium, by plain numbers."""

    name: str  # of the bar
    force: float  # axial force (force): tension is positive, compression negative
    slack: bool  # whether it is a guy without tension
    length: float  # length, L0: current and unstressed length (length)
    L0: float


def bar_results(scene: Scene) -> dict[str, BarResults]:
    """Forces of a scene's bars in its current state, by their names."""
    return {
        bar.name: BarResults(bar.name, bar.force, bar.slack, bar.length, bar.L0)
        for bar in scene.bars
    }


def joint_reactions(scene: Scene) -> dict[str, Force]:
    """Forces with which held joints are held (force), by their names."""
    found = {}
    for joint in scene.joints:
        if joint.held.any():
            x, y, z = floats(joint.reaction)
            found[joint.name] = (x, y, z)
    return found
