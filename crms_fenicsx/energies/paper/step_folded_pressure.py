"""Pressure on folded cells by the areas at the start of a load step."""

from __future__ import annotations

import numba
import numpy as np
from dolfinx import fem

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.folded_pressure import Facets
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime.arrays import Array


@numba.njit(cache=True)
def _add_area_forces(X, x, corners, weights, factor, g):  # type: ignore[no-untyped-def]
    for f in range(corners.shape[0]):
        i, j, k = corners[f, 0], corners[f, 1], corners[f, 2]
        a, b = np.empty(3), np.empty(3)
        for m in range(3):
            origin = X[i, m] + x[i, m]
            a[m] = X[j, m] + x[j, m] - origin
            b[m] = X[k, m] + x[k, m] - origin
        scale = factor * weights[f] / 6.0
        for node in (i, j, k):
            g[node, 0] += scale * (a[1] * b[2] - a[2] * b[1])
            g[node, 1] += scale * (a[2] * b[0] - a[0] * b[2])
            g[node, 2] += scale * (a[0] * b[1] - a[1] * b[0])


class FoldedStepPressure(EnergyTerm):
    """The paper's nodal forces, constant in a step, on folded cells; see `loads.StepPressure`."""

    name = "pressure"
    of_cables = True
    has_history = True

    def __init__(self, table: Facets, pressure: fem.Constant, gained: Array) -> None:
        self.table, self.pressure, self._gained = table, pressure, gained

    def attach(self, unknowns: Unknowns) -> None:
        """Use the positions of this layout."""
        super().attach(unknowns)
        self._x_n = np.zeros_like(unknowns.X)
        self._forces = np.zeros_like(unknowns.X)

    def begin_step(self, x: Array) -> None:
        """Take the current shape as the step's start."""
        self._x_n[:] = x
        self._forces[:] = 0.0
        t = self.table
        _add_area_forces(self.unknowns.X, x, t.corners, t.weights, 1.0, self._forces)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained in the step (length cubed)."""
        out[0] = np.vdot(self._forces, x) - np.vdot(self._forces, self._x_n)

    def energy(self, sums: Array) -> float:
        """``-p (V - V0)``, with the volume gained over all steps (force x length)."""
        return -float(self.pressure.value) * float(self._gained[0] + sums[0])

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: keep its volume."""
        self._gained[0] += sums[0]

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Subtract the step's nodal forces."""
        g -= float(self.pressure.value) * self._forces
