"""The paper's friction element, literally (section 3.3): a force that keeps direction and size.

It sits between a membrane node v and the point p where the cable passes it, and holds back the
cable's movement over the node in this load step (3.3-1, 2):

    w = F d . (x_p - x_v),   F and the direction d as the step began (assumption 7).

The force acts at the node and not at the true contact point; by Saint-Venant's principle the error
stays local. As its direction does not depend on the movement, a cable that should stay is pushed
back: this potential has no stick. See `crms_fenicsx.energies.lateral_friction` for one that has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba

from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime.arrays import Array, Indices


@dataclass(frozen=True)
class FrictionElements:
    """This rank's friction elements."""

    blocks: Indices  # (n, 2) membrane node and cable point
    forces: Array  # (n, 3) F d, the direction that of the sliding that is resisted (force)
    offsets: Array  # (n,) energy at zero displacements (force x length)


class FrictionElementEnergy(EnergyTerm):
    """Work against the friction elements in a load step, (3.3-2)."""

    name = "friction"
    of_cables = True

    def __init__(self, table: FrictionElements) -> None:
        self.table = table

    def renew(self, table: FrictionElements) -> None:
        """Take the elements of another load step."""
        self.table = table

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the work."""
        t = self.table
        out[0] = _work(self.unknowns.X, x, t.blocks, t.forces) + t.offsets.sum()

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the friction forces."""
        _add_forces(self.table.blocks, self.table.forces, g)


@numba.njit(cache=True)
def _work(X, x, blocks, forces):  # type: ignore[no-untyped-def]
    work = 0.0
    for k in range(blocks.shape[0]):
        v, p = blocks[k, 0], blocks[k, 1]
        for i in range(3):
            work += forces[k, i] * (X[p, i] - X[v, i] + (x[p, i] - x[v, i]))
    return work


@numba.njit(cache=True)
def _add_forces(blocks, forces, g):  # type: ignore[no-untyped-def]
    for k in range(blocks.shape[0]):
        for i in range(3):
            g[blocks[k, 1], i] += forces[k, i]
            g[blocks[k, 0], i] -= forces[k, i]
