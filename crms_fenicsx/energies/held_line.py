"""Cables that keep their line on the fabric: what holds their points at places of their edges.

A point of a cable in a pocket, or bonded, crosses its edge at one place of the fabric. A stiff
spring holds it there, with the energy ``k/2 (a (s - s0))^2``: s the place on the edge now, as a
share of its length, s0 that at which it was laid, a the edge's stress-free length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.energies.segments import (
    EdgePoints,
    add_slip_curvature,
    add_slip_forces,
    edge_fractions,
    slip_stiffness,
)
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime.arrays import Array, Booleans


@dataclass(frozen=True)
class HeldPoints(EdgePoints):
    """This rank's points that are held on their edges."""

    rest: Array  # (n,) its place on the edge, as a share of the length
    stiffness: Array  # (n,) against that share, k a^2 (force x length)


class HeldLine(EnergyTerm):
    """What holds points of cables at their places on edges."""

    name = "held lines"
    exact_hessian = True
    of_cables = True

    def __init__(self, table: HeldPoints) -> None:
        self.table = table
        self._fractions, self._off = np.zeros((2, len(table.place)))
        self._gradients = np.zeros((len(table.blocks), 3))
        self.pattern = ElementPattern(table.pointers, table.blocks)
        self.patterns = (self.pattern,)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the energy; keeps what the gradient needs."""
        t = self.table
        edge_fractions(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients
        )
        np.subtract(self._fractions, t.rest, out=self._off)
        out[0] = float(self.element_energies(out).sum())

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the springs' forces."""
        t = self.table
        add_slip_forces(t.pointers, t.blocks, self._gradients, self._off, t.stiffness, g)

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the stiffness without that of the springs' forces."""
        t = self.table
        slip_stiffness(t.pointers, t.blocks, self._gradients, t.stiffness, self.pattern.values)
        self.pattern.add(A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the second derivatives."""
        t, values = self.table, self.pattern.values
        slip_stiffness(t.pointers, t.blocks, self._gradients, t.stiffness, values)
        add_slip_curvature(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients,
            self._off * t.stiffness, values,
        )  # fmt: skip
        self.pattern.add(A)

    def elements_on(self, chosen: Booleans) -> HeldPoints | None:
        """Points with chosen blocks on their edges."""
        return self.table.points_on(chosen)

    def of_elements(self, table: HeldPoints, sums: Array) -> HeldLine:
        """What holds such points."""
        return HeldLine(table)

    def element_energies(self, sums: Array) -> Array:
        """Energies of the points (force x length)."""
        return np.asarray(0.5 * self.table.stiffness * self._off**2)
