"""What load steps change of bars and joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class JointState:
    """What load steps change of a joint.

    Attributes
    ----------
    position : (3,)
        Where it is (length).
    reaction : (3,)
        Force with which what holds it acts on it (force); zero in directions in which it is free.
    """

    position: Annotated[Array, 3]
    reaction: Annotated[Array, 3]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.flags.writeable = False


@dataclass(frozen=True)
class BarState:
    """What load steps change of a bar.

    Attributes
    ----------
    L0
        Unstressed length (length).
    points : (2, 3)
        Where its ends are (length).
    """

    L0: float
    points: Annotated[Array, 2, 3]

    def __post_init__(self) -> None:
        self.points.flags.writeable = False
