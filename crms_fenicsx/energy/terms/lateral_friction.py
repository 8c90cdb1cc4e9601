"""Friction of cables that slide sideways: Coulomb's law, smoothed so that a cable can stick.

Each sliding node has the potential ``F eps f(s/eps)`` of its slip s, with the force F fixed during
the minimisation:

    f(y) = y^2 - |y|^3/3  for |y| < 1,   |y| - 1/3 beyond.

The force F f'(y) reaches F exactly at the slip eps and then stays constant, so that a sliding node
feels Coulomb's force and an unloaded one does not creep (the mollifier of M. Li et al., Incremental
potential contact, ACM Trans. Graph. 39, 2020). The slip is linear in the node's position on its
edge, ``s = slope * fraction + offset``, see `cabling.friction.slip`. The fraction of a vertex of a
row that slides is that of its shift across the row in a cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from crms_fenicsx.energy.terms.segments import EdgePoints, EdgePointTerm, shift_fractions
from crms_fenicsx.foundation.runtime.arrays import Array


@numba.njit(cache=True, inline="always")
def _potential(y, bound, eps):  # type: ignore[no-untyped-def]
    """Potential of a node at the absolute slip y eps."""
    if y < 1.0:
        return bound * eps * y * y * (1.0 - y / 3.0)
    return bound * eps * (y - 1.0 / 3.0)


@numba.njit(cache=True, inline="always")
def friction_force(slip, bound, eps):  # type: ignore[no-untyped-def]
    """Derivative of this potential by the slip; without a bound eps may be zero."""
    if bound == 0.0:
        return 0.0
    y = abs(slip) / eps
    return math.copysign(bound * y * (2.0 - y) if y < 1.0 else bound, slip)


@numba.njit(cache=True)
def friction_energy(slip, bound, eps, force):  # type: ignore[no-untyped-def]
    """Potential of all nodes; its derivatives by their slips into `force` (n,)."""
    energy = 0.0
    for k in range(slip.shape[0]):
        energy += _potential(abs(slip[k]) / eps[k], bound[k], eps[k])
        force[k] = friction_force(slip[k], bound[k], eps[k])
    return energy


def coulomb_forces(slip: Array, bound: Array, eps: Array) -> Array:
    """Friction force of each node, (n,) (force)."""
    y = np.minimum(np.abs(slip) / eps, 1.0)
    return np.asarray(np.copysign(bound * y * (2.0 - y), slip))


def stored_and_lost(slip: Array, bound: Array, eps: Array, elastic: Array) -> tuple[float, float]:
    """Elastically stored and dissipated friction energy (force x length); all arguments (n,)."""
    force = np.abs(coulomb_forces(slip, bound, eps))
    back = np.minimum(np.abs(slip), elastic)
    y = np.minimum(back / eps, 1.0)
    return float(np.sum(force * back * (1.0 - y / 3.0) / (2.0 - y))), float(
        np.sum(force * (np.abs(slip) - back))
    )


def secant_stiffness(slip: Array, bound: Array, eps: Array) -> Array:
    """Secant stiffness ``force / slip`` of nodes, (n,) (force/length). Its parabola touches the
    potential and lies above it elsewhere; the tangent would vanish beyond eps."""
    y = np.abs(slip) / eps
    return np.asarray(bound / eps * np.where(y < 1.0, 2.0 - y, 1.0 / np.maximum(y, 1.0)))


def tangent_stiffness(slip: Array, bound: Array, eps: Array) -> Array:
    """Second derivatives of the potentials by the slips, (n,) (force/length)."""
    return np.asarray(2 * bound / eps * np.maximum(1 - np.abs(slip) / eps, 0.0))


@dataclass(frozen=True)
class Slips(EdgePoints):
    """This rank's nodes with friction; at a vertex of a row its shift is the only block."""

    slope: Array  # slope, offset: (n,) slip as a function of the edge fraction (length)
    offset: Array
    bound: Array  # (n,) friction force F of a sliding node (force)
    eps: Array  # (n,) slip at which it is reached (length)
    across: Array  # (n, 3) fraction per shift of such a vertex (1/length); zero on edges


class LateralFriction(EdgePointTerm):
    """Sideways friction of the cables' sliding nodes, (3.3-1) with stick."""

    name = "friction"

    def __init__(self, table: Slips) -> None:
        super().__init__(table)
        self.slips, self._force = np.zeros((2, len(table.place)))

    def renew(self, table: Slips) -> None:
        """Use other forces and material curves for the same nodes."""
        self.table = table

    def locate(self, x: Array) -> None:
        super().locate(x)
        t = self.table
        shift_fractions(x, t.pointers, t.blocks, t.across, self._fractions, self._gradients)

    def evaluate(self) -> float:
        t = self.table
        np.multiply(t.slope, self._fractions, out=self.slips)
        self.slips += t.offset
        energy = friction_energy(self.slips, t.bound, t.eps, self._force)
        np.multiply(self._force, t.slope, out=self._pull)
        return float(energy)

    def stiffnesses(self, exact: bool) -> Array:
        """See `secant_stiffness`; if `exact`, nodes that slide beyond eps have none."""
        t, law = self.table, tangent_stiffness if exact else secant_stiffness
        return law(self.slips, t.bound, t.eps) * t.slope**2
