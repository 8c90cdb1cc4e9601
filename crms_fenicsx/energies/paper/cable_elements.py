"""Tension of a cable from the strains of the load steps.

It sits between a membrane node v and the point p where the cable passes it, and holds back the
cable's movement over the node in this load step (3.3-1, 2):

    w = F d . (x_p - x_v),   F and the direction d as the step began (assumption 7).

The force acts at the node and not at the true contact point; by Saint-Venant's principle the error
stays local. As its direction does not depend on the movement, a cable that should stay is pushed
back: this potential has no stick. See `crms_fenicsx.energies.lateral_friction` for one that has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.cable_tension import CableTension
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.model.cable_state import StepStart
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices


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
        """Return none: blocks are not relaxed alone with a law that has a history."""
        return None

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: its tensions, lengths and energies are the next step's start."""
        state = zip(self.starts, self.tensions(sums), sums, self.energies(sums), strict=True)
        new: list[StepStart | None] = []
        for start, tension, length, energy in state:
            new.append(start and StepStart(float(tension), float(length), float(energy)))
        self.starts = new
        self._read()
