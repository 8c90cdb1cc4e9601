"""Two cables that cross."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True, eq=False)
class Crossing:
    """A place where two cables cross: one free point that both share.

    The nodes of the cables refer to it by its number among the scene's crossings.
    """

    lower: int  # lower, upper: numbers of the cables, the upper one on top
    upper: int
    support: tuple[int, ...]  # ids of the vertices of the cell (3) or edge (2) that it is in
    # where it is on the lower and on the upper cable: after which node, crossings not counted
    links: tuple[int, int]
    place: Annotated[Array, 3]  # (3,) where they cross, or would (length)
    # ids of the vertices on which the ends of these links lie, or between which: first those of the
    # lower cable's link
    between: tuple[tuple[int, ...], ...]
    # whether the upper cable has lifted off the lower one; they share no point then
    separated: bool = False


NodeId = tuple[int, int]
"""A node of a cable: the cable's number, the node's number."""
