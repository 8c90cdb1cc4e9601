"""What a scene was like when a cable was laid or a load put on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class Stage:
    """A state of a scene, from which a finer mesh comes to the same one.

    Attributes
    ----------
    number
        How many states load steps had brought the scene to, see `Scene.commits`.
    u : (n, 3)
        Displacements of this rank's vertices, ghosts included (length); read-only, and the same
        array for all that is put on the same shape.
    pressure
        Pressure (force per area).
    factors
        Factors of the loads, by their names.
    cables
        The cables' states, by their names.
    """

    number: int
    u: Array
    pressure: float
    factors: Mapping[str, float]
    cables: Mapping[str, CableState]
