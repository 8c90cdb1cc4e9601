"""Tension of a cable from the strains of the load steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.cable_tension import CableTension
from crms_fenicsx.model.cable_state import StepStart
from crms_fenicsx.runtime.arrays import Array, Booleans


class StepCableTension(CableTension):
    """The paper's step-wise cable law, (2.2-1 ... 2.2-3), for some or all of the cables.

    The tension grows from its value at the step's start, T_n, by ``EA/l_n (l - l_n)``, l_n the
    length at the step's start. As in the paper a cable may be compressed.
    """

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

    def dyads(self, sums: Array) -> Array:
        """Stiffness against the elongation of each cable (force/length)."""
        return np.where(self._stepwise, self.EA / self._length_n, super().dyads(sums))

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
