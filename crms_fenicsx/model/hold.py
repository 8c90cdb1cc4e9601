"""What holds a cable on the membrane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import Support

Hold = Literal["outside", "sleeve", "pocket", "bonded"]


@dataclass(frozen=True)
class Freedom:
    """What a cable is free to do on the membrane."""

    lifts: bool  # off the membrane
    sideways: bool  # to slide sideways, over the fabric
    along: bool  # to slide along itself


HOLDS: dict[Hold, Freedom] = {
    "outside": Freedom(lifts=True, sideways=True, along=True),
    "sleeve": Freedom(lifts=False, sideways=True, along=True),
    "pocket": Freedom(lifts=False, sideways=False, along=True),
    "bonded": Freedom(lifts=False, sideways=False, along=False),
}
"""What holds a cable, by a word."""


@dataclass(frozen=True)
class Bonds:
    """Where a cable is bonded to the fabric, between its ends."""

    supports: tuple[Support, ...]  # places of its m points, in order
    at: Annotated[Array, "m"]  # unstressed lengths up to there, as shares of the whole
