"""Cables that keep their line on the fabric: springs that hold their points on edges.

A point of a cable that is bonded or lies in a pocket crosses its edge at a fixed material point. A
stiff spring holds it there, with the energy ``k/2 (a (s - s0))^2``: s and s0 are the current and
initial positions on the edge as fractions of its length, a the edge's stress-free length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.energy.terms.segments import EdgePoints, EdgePointTerm
from crms_fenicsx.foundation.runtime.arrays import Array


@dataclass(frozen=True)
class HeldPoints(EdgePoints):
    """This rank's points that are held on their edges."""

    rest: Array  # (n,) its initial fraction s0 of the edge
    stiffness: Array  # (n,) k a^2 (force x length)


class HeldLine(EdgePointTerm):
    """Springs that hold cable points on their edges."""

    name = "held lines"
    exact_hessian = True

    def __init__(self, table: HeldPoints) -> None:
        super().__init__(table)
        self._off = np.zeros(len(table.place))

    def evaluate(self) -> float:
        np.subtract(self._fractions, self.table.rest, out=self._off)
        np.multiply(self._off, self.table.stiffness, out=self._pull)
        return 0.5 * float(np.dot(self._pull, self._off))

    def stiffnesses(self, exact: bool) -> Array:
        return np.asarray(self.table.stiffness)
