"""What load steps change of bars and joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class JointState:
    """What load steps change of a joint."""

    position: Annotated[Array, 3]  # (3,) where it is (length)
    # (3,) force with which what holds it acts on it (force); zero in directions in which it is free
    reaction: Annotated[Array, 3]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            value.flags.writeable = False


@dataclass(frozen=True)
class BarState:
    """What load steps change of a bar."""

    L0: float  # unstressed length (length)
    points: Annotated[Array, 2, 3]  # (2, 3) where its ends are (length)

    def __post_init__(self) -> None:
        self.points.flags.writeable = False
