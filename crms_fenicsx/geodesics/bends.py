"""Vertices that hold a taut string, and the flips over them that would make it shorter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from crms_fenicsx.geodesics.corridor import Corridor
from crms_fenicsx.surface.points import Support

TIE = 1e-6
"""Difference (rad) below which two angles count as equal.

A symmetric shape that a solver has found is symmetric only to the solver's tolerance. A cable left
on a ridge that is less uneven than this is at rest to the same accuracy.
"""
TOGETHER = 0.5
"""Part of the sharpest turn from which on others are flipped with it in one sweep.

On a surface that curves outward there is a geodesic on either side of a vertex. Flipping all at
once ends more often in the longer one (by about 1e-4), and one by one takes ten times as long.
"""


@dataclass(frozen=True)
class Hold:
    """A vertex that may hold the string: a bend of it, or a visit of the path."""

    vertex: int  # its id
    first: int  # first, last: the supports of the path at the vertex, both included
    last: int
    strip_angle: float | None  # angle (rad) on the strip's side of a bend; None for a visit
    # arriving, leaving: angles (rad) of the string before and after a visit to edges at the vertex
    arriving: dict[int, float] = field(default_factory=dict)
    leaving: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Flip:
    """A way around a vertex that would make the string shorter."""

    angle: float  # angle at the vertex on that side (rad)
    vertex: int  # its id
    first: int  # first, last: the supports to be replaced, both included
    last: int
    spokes: Corridor  # the edges to cross instead
    cells: frozenset[Support]  # the cells and edges through which the path would go


def ordered(flips: Sequence[Flip], middle: int) -> list[Flip]:
    """Order by angle; equal ones from the middle of the path to its ends."""
    flips = sorted(flips, key=lambda flip: (flip.angle, flip.first))
    rank = dict.fromkeys(range(len(flips)), 0)
    for i in range(1, len(flips)):
        equal = flips[i].angle <= flips[rank[i - 1]].angle + TIE
        rank[i] = rank[i - 1] if equal else i
    keys = [(rank[i], abs(f.first + f.last - middle), f.first) for i, f in enumerate(flips)]
    return [flips[i] for i in sorted(range(len(flips)), key=keys.__getitem__)]


def compatible(flips: Sequence[Flip]) -> list[Flip]:
    """Return the first flip and those that turn nearly as sharply and share no cell with it.

    Nor with each other.
    """
    chosen: list[Flip] = []
    least = TOGETHER * (math.pi - flips[0].angle) - TIE if flips else 0.0
    busy: set[int] = set()
    cells: set[Support] = set()
    for flip in flips:
        if math.pi - flip.angle < least:
            continue
        # supports that stay may be shared: the string goes through both sides of them
        own = range(flip.first, flip.last + 1)
        around = range(flip.first - 1, flip.last + 2)
        if busy.isdisjoint(around) and cells.isdisjoint(flip.cells):
            chosen.append(flip)
            busy.update(own)
            cells |= flip.cells
    return chosen
