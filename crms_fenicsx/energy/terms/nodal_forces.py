"""Potentials ``-F . u`` of given forces on the membrane and on joints of bars."""

from __future__ import annotations

from collections.abc import Iterable

import numba
import numpy as np

from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.model.membrane_load import MembraneLoad


class NodalForces(EnergyTerm):
    """Potential ``-F . u`` of the nodal forces F of all loads on the membrane.

    Attributes: `forces` (n, 3): nodal forces from this rank's cells (force).
    """

    name = "dead load"
    exact_hessian = True

    def __init__(self, n: int) -> None:
        self.forces, self._u, self._minus = np.zeros((3, n, 3))

    def take(self, loads: Iterable[MembraneLoad]) -> None:
        """Sum the loads' forces at their factors."""
        self.forces[:] = 0.0
        for load in loads:
            self.forces += load.factor * load.forces
        np.negative(self.forces, out=self._minus)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the forces' work (force x length)."""
        self.unknowns.read_vertices(x, self._u)
        out[0] = np.vdot(self.forces, self._u)

    def energy(self, sums: Array) -> float:
        """Minus the work of the forces since the stress-free shape (force x length)."""
        return -float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        self.unknowns.add_to_vertices(self._minus, g)


class JointForces(EnergyTerm):
    """Potential ``-F . u`` of forces on joints.

    Attributes: `forces` (n, 3): the forces (force). Shapes: blocks (n,).
    """

    name = "dead load"
    exact_hessian = True

    def __init__(self, blocks: Indices) -> None:
        self._blocks, self.forces = blocks, np.zeros((len(blocks), 3))

    def sums(self, x: Array, out: Array) -> None:
        """Work of the forces (force x length)."""
        out[0] = _work(x, self._blocks, self.forces)

    def energy(self, sums: Array) -> float:
        """Minus the work of the forces since the joints were made (force x length)."""
        return -float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        np.subtract.at(g, self._blocks, self.forces)


@numba.njit(cache=True)
def _work(x, blocks, forces):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(blocks)):
        for i in range(3):
            total += x[blocks[k], i] * forces[k, i]
    return total
