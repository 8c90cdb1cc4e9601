"""How a cable is attached to the membrane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.points import Support

Hold = Literal["outside", "sleeve", "pocket", "bonded"]


@dataclass(frozen=True)
class Freedom:
    """Motions relative to the membrane that an attachment leaves free."""

    lifts: bool  # off the membrane
    sideways: bool  # sliding sideways over the fabric
    along: bool  # sliding along its axis


HOLDS: dict[Hold, Freedom] = {
    "outside": Freedom(lifts=True, sideways=True, along=True),
    "sleeve": Freedom(lifts=False, sideways=True, along=True),
    "pocket": Freedom(lifts=False, sideways=False, along=True),
    "bonded": Freedom(lifts=False, sideways=False, along=False),
}
"""Free motions of each kind of attachment."""


@dataclass(frozen=True)
class Bonds:
    """Points between its ends at which a cable is bonded to the fabric."""

    supports: tuple[Support, ...]  # supports of its m points, in order
    at: Annotated[Array, "m"]  # unstressed lengths up to them, relative to the whole cable's
