"""Rails: the points of cables that slide along held edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array, Indices


class Rails:
    """The rails of cables in tension that this rank knows.

    Shapes: members (n,), blocks (n,), ends (n, 2).
    """

    def __init__(
        self,
        cables: Sequence[LaidCable],
        members: Sequence[NodeId],
        blocks: Indices,
        ends: Indices,
    ) -> None:
        self._cables, self.members, self.blocks, self.ends = cables, members, blocks, ends

    def known_fractions(self) -> Array:
        """Places on the edges where the cables have the rails, (n,)."""
        return np.array([self._cables[c].fractions[k] for c, k in self.members], dtype=float)

    def place(self, unknowns: Unknowns, x: Array) -> None:
        """Put the rails where they were on their edges, which may have been moved with x."""
        if not self.members:
            return
        places = unknowns.X[self.ends] + x[self.ends]
        sides = places[:, 1] - places[:, 0]
        unknowns.X[self.blocks] = places[:, 0] + self.known_fractions()[:, None] * sides
        x[self.blocks] = 0.0
        unknowns.set_rails(self.blocks, sides / np.linalg.norm(sides, axis=1)[:, None])

    def fractions(self, unknowns: Unknowns, x: Array) -> Array:
        """Places on the edges where the displacements x have the rails, (n,)."""
        start, end = (unknowns.X[own] + x[own] for own in self.ends.T)
        side, way = end - start, unknowns.X[self.blocks] + x[self.blocks] - start
        fractions: Array = np.sum(way * side, axis=1) / np.sum(side**2, axis=1)
        return fractions
