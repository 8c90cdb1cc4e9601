"""Cables that keep their line on the fabric: springs that hold their points on edges.

A point of a cable that is bonded or lies in a pocket crosses its edge at a fixed material point. A
stiff spring holds it there, with the energy ``k/2 (a (s - s0))^2``: s and s0 are the current and
initial positions on the edge as fractions of its length, a the edge's stress-free length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.energy.terms.segments import (
    EdgePoints,
    add_slip_curvature,
    add_slip_forces,
    edge_fractions,
    slip_stiffness,
)
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans


@dataclass(frozen=True)
class HeldPoints(EdgePoints):
    """This rank's points that are held on their edges."""

    rest: Array  # (n,) its initial fraction s0 of the edge
    stiffness: Array  # (n,) k a^2 (force x length)


class HeldLine(EnergyTerm):
    """Springs that hold cable points on their edges."""

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
        """This rank's part of the energy; keeps fractions for the gradient."""
        t = self.table
        edge_fractions(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients
        )
        np.subtract(self._fractions, t.rest, out=self._off)
        out[0] = float(self.element_energies(out).sum())

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        t = self.table
        add_slip_forces(t.pointers, t.blocks, self._gradients, self._off, t.stiffness, g)

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the stiffness, without the geometric part of the springs' forces."""
        t = self.table
        slip_stiffness(t.pointers, t.blocks, self._gradients, t.stiffness, self.pattern.values)
        self.pattern.add(A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        t, values = self.table, self.pattern.values
        slip_stiffness(t.pointers, t.blocks, self._gradients, t.stiffness, values)
        add_slip_curvature(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients,
            self._off * t.stiffness, values,
        )  # fmt: skip
        self.pattern.add(A)

    def elements_on(self, chosen: Booleans) -> HeldPoints | None:
        return self.table.points_on(chosen)

    def of_elements(self, table: HeldPoints, sums: Array) -> HeldLine:
        return HeldLine(table)

    def element_energies(self, sums: Array) -> Array:
        return np.asarray(0.5 * self.table.stiffness * self._off**2)
