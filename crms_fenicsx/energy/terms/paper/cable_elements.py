"""The paper's friction element (3.3), and its step-wise law of a cable (2.2).

A friction element sits between a membrane node v and the point p where the cable passes it. Its
work is that of the force F against the slip s of cable and membrane in a load step (3.3-1, 2):

    w = F |s|,   s = d . ((x_p - x_v) - (x_p - x_v at the step's start)),

with F and the direction d of the step's start (assumption 7). The force acts at the node and not at
the true contact point; by Saint-Venant's principle the error stays local. The paper takes the sense
of the slip as known. Here the minimisation finds it: |s| is smoothed over a small elastic slip eps,
as by `energy.terms.lateral_friction`. A node that slides farther has exactly the paper's
force, and a node that would slide against the force of either sense, elastically, less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from crms_fenicsx.energy.terms.cable_tension import CableTension
from crms_fenicsx.energy.terms.lateral_friction import (
    friction_energy,
    secant_stiffness,
    tangent_stiffness,
)
from crms_fenicsx.energy.terms.segments import slip_stiffness
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.model.cable_state import StepStart


@dataclass(frozen=True)
class FrictionElements(ElementTable):
    """This rank's friction elements."""

    blocks: Indices  # (n, 3) ends of the edge that the cable crosses, its point between them
    slopes: Array  # (n, 3, 3) derivatives of the slip by them: d at p, -d at v, and zero
    offset: Array  # (n,) slip where p lies on v (length)
    bound: Array  # (n,) friction force F of a sliding node (force)
    eps: Array  # (n,) slip at which it is reached (length)
    addresses = ("blocks",)


class FrictionElementEnergy(ElementTerm):
    """Work against the friction elements in a load step, (3.3-2)."""

    name = "friction"
    of_cables = True

    def __init__(self, table: FrictionElements) -> None:
        super().__init__(table)
        self.slips, self._force = np.zeros((2, len(table.blocks)))
        self.pattern = ElementPattern(*table.element_blocks)
        self.patterns = (self.pattern,)

    def renew(self, table: FrictionElements) -> None:
        """Use the elements of another load step at the same nodes."""
        self.table = table

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the work; keeps slips and forces for the gradient."""
        t = self.table
        _find_slips(self.unknowns.X, x, t.blocks, t.slopes, t.offset, self.slips)
        out[0] = friction_energy(self.slips, t.bound, t.eps, self._force)

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the friction forces."""
        _add_forces(self.table.blocks, self.table.slopes, self._force, g)

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the secant stiffness ``force / slip``."""
        self._add(secant_stiffness(self.slips, self.table.bound, self.table.eps), A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the second derivatives; sliding nodes have none."""
        self._add(tangent_stiffness(self.slips, self.table.bound, self.table.eps), A)

    def _add(self, stiffness: Array, A: BlockSink) -> None:
        pointers, blocks = self.table.element_blocks
        slopes = self.table.slopes.reshape(-1, 3)
        slip_stiffness(pointers, blocks, slopes, stiffness, self.pattern.values)
        self.pattern.add(A)


@numba.njit(cache=True)
def _find_slips(X, x, blocks, slopes, offset, slips):  # type: ignore[no-untyped-def]
    for k in range(blocks.shape[0]):
        slips[k] = offset[k]
        for q in range(3):
            for i in range(3):
                slips[k] += slopes[k, q, i] * (X[blocks[k, q], i] + x[blocks[k, q], i])


@numba.njit(cache=True)
def _add_forces(blocks, slopes, force, g):  # type: ignore[no-untyped-def]
    for k in range(blocks.shape[0]):
        for q in range(3):
            for i in range(3):
                g[blocks[k, q], i] += force[k] * slopes[k, q, i]


class StepCableTension(CableTension):
    """The paper's step-wise cable law, (2.2-1 ... 2.2-3), which also carries compression."""

    has_history = True
    exact_hessian = False

    def __init__(
        self,
        segments: npt.NDArray[np.int32],
        eps: Array,
        cable: npt.NDArray[np.int32],
        EA: Array,
        L0: Array,
        starts: Sequence[StepStart | None],
    ) -> None:
        super().__init__(segments, eps, cable, EA, L0)
        self.starts = starts
        self._stepwise = np.array([start is not None for start in starts])

    def attach(self, unknowns: Unknowns) -> None:
        """Use the positions of this layout, and the cables' state."""
        super().attach(unknowns)
        self._read()

    def _read(self) -> None:
        values = [(s.tension, s.length, s.energy) if s else (0.0, 1.0, 0.0) for s in self.starts]
        self._tension_n, self._length_n, self._energy_n = np.array(values).T

    def tensions(self, lengths: Array) -> Array:
        """Tension of each cable (force)."""
        grown = self._tension_n + self.EA / self._length_n * (lengths - self._length_n)
        return np.where(self._stepwise, grown, super().tensions(lengths))

    def stiffnesses(self, sums: Array, exact: bool = False) -> Array:
        """Stiffness against the elongation of each cable (force/length)."""
        return np.where(self._stepwise, self.EA / self._length_n, super().stiffnesses(sums, exact))

    def energies(self, lengths: Array) -> Array:
        """Strain energy of each cable, over all steps (force x length)."""
        mean = (self.tensions(lengths) + self._tension_n) / 2
        grown = self._energy_n + mean * (lengths - self._length_n)
        return np.where(self._stepwise, grown, super().energies(lengths))

    def elements_on(self, chosen: Booleans) -> None:
        """Return none: nothing is relaxed alone with a law that has a history."""
        return None

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: its tensions, lengths and energies are the next step's start."""
        state = zip(self.starts, self.tensions(sums), sums, self.energies(sums), strict=True)
        new: list[StepStart | None] = []
        for start, tension, length, energy in state:
            new.append(start and StepStart(float(tension), float(length), float(energy)))
        self.starts = new
        self._read()
