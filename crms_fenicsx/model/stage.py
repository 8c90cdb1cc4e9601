"""What a scene was like when something was put on it: a cable, a load, a bar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from crms_fenicsx.model.bar_state import BarState, JointState
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class Stage:
    """A state of a scene, from which a finer mesh comes to the same one.

    Attributes
    ----------
    number
        Number of the state that load steps had brought the scene to, see `Version`.
    u : (n, 3)
        Displacements of this rank's vertices, ghosts included (length); read-only, and the same
        array for all that is put on the same shape.
    pressure
        Pressure (force per area).
    factors
        Factors of the loads, by their names.
    cables, joints, bars
        The states of all there were, by their names.
    ponds, air, floor
        As in the scene.
    sealed_on
        What the air was sealed on.
    terms
        Names of the terms that were added.
    """

    number: int
    u: Array
    pressure: float
    factors: Mapping[str, float]
    cables: Mapping[str, CableState]
    joints: Mapping[str, JointState]
    bars: Mapping[str, BarState]
    ponds: tuple[Pond, ...]
    air: SealedAir | None
    sealed_on: Stage | None
    floor: float | None
    terms: tuple[str, ...]


def same(a: Stage, b: Stage) -> bool:
    """Whether they are of the same shape; what is laid on it one after the other is there later."""
    return a.number == b.number and a.u is b.u
