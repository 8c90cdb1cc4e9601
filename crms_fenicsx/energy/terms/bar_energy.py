"""Strain energy of straight bars, ``EA/2 (l - L0)^2 / L0``.

A bar of direction d has the force N = EA (l - L0)/L0 and the stiffness EA/L0 d d^T + N/l (I - d
d^T). H0 must be positive definite, so it omits the second part in compression. A guy shorter than
L0 is slack, without energy; H0 keeps a small part of its stiffness, so that a joint held only by
slack guys does not fly off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from crms_fenicsx.energy.terms.segments import difference
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, SegmentPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans, Indices
from crms_fenicsx.model.bar import SHORTEST

SLACK = 1e-3
"""Stiffness of a slack guy in H0, relative to its axial stiffness."""


@dataclass(frozen=True)
class BarTable(ElementTable):
    """This rank's bars."""

    ends: Indices  # (n, 2) blocks of their ends
    EA: Array  # EA, L0: (n,) axial stiffness (force) and unstressed length (length)
    L0: Array
    tension_only: Booleans  # (n,) whether they can be slack
    addresses = ("ends",)
    joins = True


class BarEnergy(ElementTerm):
    """Strain energy of bars.

    Attributes: `lengths`, `forces` (n,): lengths (length) and axial forces (force), tension
    positive, at the last evaluation; `least`, `loose`: for the second derivatives, a lower bound of
    the axial forces, and the relative slack up to which guys count as taut; stability checks change
    both.
    """

    name = "bars"
    exact_hessian = True
    least, loose = -np.inf, 0.0

    def __init__(self, table: BarTable) -> None:
        super().__init__(table)
        self.lengths, self.forces = np.zeros((2, len(table.EA)))
        self._pattern = SegmentPattern(table.ends)
        self.patterns = (self._pattern,)

    def sums(self, x: Array, out: Array) -> None:
        """Energy of this rank's bars (force x length)."""
        t = self.table
        out[0] = _energy(
            self.unknowns.X, x, t.ends, t.EA, t.L0, t.tension_only, self.lengths, self.forces
        )

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        _add_forces(self.unknowns.X, x, self.table.ends, self.forces, g)

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the rounding errors of this rank's bar forces, due to the coordinates."""
        ends = self.unknowns.X[self.table.ends] + x[self.table.ends]
        far = np.linalg.norm(ends, axis=2).max(axis=1, initial=0.0)
        stiffness = np.abs(self.forces) / self._least_lengths() + self.table.EA / self.table.L0
        return float(np.sum((EPSILON * stiffness * far) ** 2))

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the stiffness, without its reduction by compression."""
        self._add(x, SLACK, 0.0, A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        self._add(x, 0.0, self.least, A)

    def _add(self, x: Array, slack: float, least: float, A: BlockSink) -> None:
        """Add the stiffness: `slack` times that of slack guys, and forces not below `least`."""
        t = self.table
        axial = (
            np.where(t.tension_only & (self.lengths < (1 - self.loose) * t.L0), slack, 1.0)
            * t.EA
            / t.L0
        )
        lengths = self._least_lengths()
        across = np.maximum(self.forces, least) / lengths
        ways = self.unknowns.X[t.ends] + x[t.ends]
        d = (ways[:, 1] - ways[:, 0]) / lengths[:, None]
        along = d[:, :, None] * d[:, None, :]
        self._pattern.values[:] = (axial - across)[:, None, None] * along
        self._pattern.values += across[:, None, None] * np.eye(3)
        self._pattern.add(A)

    def _least_lengths(self) -> Array:
        """Lengths, bounded from below for bars without direction, whose ends coincide."""
        return np.maximum(self.lengths, SHORTEST * self.table.L0)


@numba.njit(cache=True)
def _energy(X, x, ends, EA, L0, tension_only, lengths, forces):  # type: ignore[no-untyped-def]
    """Energy of bars between blocks (n, 2); stores their lengths and forces."""
    total = 0.0
    for b in range(ends.shape[0]):
        _, _, _, lengths[b] = difference(X, x, ends[b, 0], ends[b, 1])
        strain = (lengths[b] - L0[b]) / L0[b]
        if tension_only[b] and strain < 0.0:
            strain = 0.0
        forces[b] = EA[b] * strain
        total += 0.5 * forces[b] * strain * L0[b]
    return total


@numba.njit(cache=True)
def _add_forces(X, x, ends, forces, g):  # type: ignore[no-untyped-def]
    """Add ``sum forces * d(lengths)/dx`` to g, (n_blocks, 3)."""
    for s in range(ends.shape[0]):
        a, b = ends[s, 0], ends[s, 1]
        r0, r1, r2, d = difference(X, x, a, b)
        c = forces[s] / d if d > 0.0 else 0.0
        r = (r0, r1, r2)
        for i in range(3):
            g[a, i] -= c * r[i]
            g[b, i] += c * r[i]
