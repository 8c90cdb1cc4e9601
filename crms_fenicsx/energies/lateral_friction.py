"""Friction of cables that slide sideways: Coulomb's law, smoothed so that a cable can stick.

Each sliding node has the potential ``F eps f(s/eps)`` of its slip s, with the force F held while
the potential is minimised:

    f(y) = y^2 - |y|^3/3  for |y| < 1,   |y| - 1/3 beyond.

The force F f'(y) is reached at the slip eps exactly and does not grow any more, so that what slides
feels Coulomb's force and what is idle does not creep (the mollifier of M. Li et al., Incremental
potential contact, ACM Trans. Graph. 39, 2020). The slip is linear in the node's place on its edge,
``s = slope * fraction + offset``, see `crms_fenicsx.friction.slip`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from petsc4py import PETSc

from crms_fenicsx.dofs.block_patterns import ElementPattern
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.dofs.preallocation import RowSizes
from crms_fenicsx.energies.segments import difference
from crms_fenicsx.runtime.arrays import Array, Indices


@dataclass(frozen=True)
class Slips:
    """This rank's nodes with friction.

    Attributes
    ----------
    pointers, blocks
        Blocks along the edge of each node in CSR form: its first vertex, the points on it, its
        last vertex.
    place : (n,)
        Which of them the node is.
    slope, offset : (n,)
        Slip by place on the edge (length).
    bound : (n,)
        Friction force F of a node that slides (force).
    eps : (n,)
        Slip at which that force is reached (length).
    """

    pointers: Indices
    blocks: Indices
    place: Indices
    slope: Array
    offset: Array
    bound: Array
    eps: Array


@numba.njit(cache=True)
def edge_fractions(X, x, pointers, blocks, place, fractions, gradients):  # type: ignore[no-untyped-def]
    """Places on edges, as shares of their lengths (n,), and their derivatives by all blocks."""
    gradients[:] = 0.0
    for k in range(place.shape[0]):
        start, end, at = pointers[k], pointers[k + 1], pointers[k] + place[k]
        before = total = 0.0
        for q in range(start, end - 1):
            _, _, _, d = difference(X, x, blocks[q], blocks[q + 1])
            total += d
            if q < at:
                before += d
        s = before / total if total > 0.0 else 0.0
        fractions[k] = s
        for q in range(start, end - 1):
            r0, r1, r2, d = difference(X, x, blocks[q], blocks[q + 1])
            if d == 0.0:
                continue  # no direction, no force
            weight = ((1.0 - s) if q < at else -s) / (total * d)
            for i, r in enumerate((r0, r1, r2)):
                gradients[q, i] -= weight * r
                gradients[q + 1, i] += weight * r


@numba.njit(cache=True)
def friction_energy(slip, bound, eps, force):  # type: ignore[no-untyped-def]
    """Potential of all nodes; its derivative by their slips into `force` (n,)."""
    energy = 0.0
    for k in range(slip.shape[0]):
        y = abs(slip[k]) / eps[k]
        if y < 1.0:
            energy += bound[k] * eps[k] * y * y * (1.0 - y / 3.0)
            force[k] = math.copysign(bound[k] * y * (2.0 - y), slip[k])
        else:
            energy += bound[k] * eps[k] * (y - 1.0 / 3.0)
            force[k] = math.copysign(bound[k], slip[k])
    return energy


def secant_stiffness(slip: Array, bound: Array, eps: Array) -> Array:
    """Stiffness ``force / slip`` of nodes, (n,) (force/length).

    It is that of the parabola which touches the potential at the present slip and lies above it
    elsewhere: the tangent is zero beyond eps, and says nothing of what comes below.
    """
    y = np.abs(slip) / eps
    return np.asarray(bound / eps * np.where(y < 1.0, 2.0 - y, 1.0 / np.maximum(y, 1.0)))


class StickSlip:
    """Friction of the sliding nodes of cables, (3.3-1) with stick.

    Parameters
    ----------
    table
        This rank's nodes.
    """

    name = "friction"
    n_sums = 1

    def __init__(self, table: Slips) -> None:
        self.table = table
        n = len(table.place)
        self._fractions, self.slips, self._force = np.zeros(n), np.zeros(n), np.zeros(n)
        self._gradients = np.zeros((len(table.blocks), 3))
        self.pattern = ElementPattern(table.pointers, table.blocks)

    def attach(self, unknowns: Unknowns) -> None:
        """Use the positions of this layout."""
        self.unknowns = unknowns

    def renew(self, table: Slips) -> None:
        """Take other forces and material curves for the same nodes."""
        self.table = table

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the potential; keeps slips and forces for the gradient."""
        t = self.table
        edge_fractions(
            self.unknowns.X, x, t.pointers, t.blocks, t.place, self._fractions, self._gradients
        )
        np.multiply(t.slope, self._fractions, out=self.slips)
        self.slips += t.offset
        out[0] = friction_energy(self.slips, t.bound, t.eps, self._force)

    def energy(self, sums: Array) -> float:
        """The friction potential (force x length)."""
        return float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the friction forces."""
        t = self.table
        add_slip_forces(t.pointers, t.blocks, self._gradients, self._force, t.slope, g)

    def count_stiffness(self, sizes: RowSizes) -> None:
        """Count the blocks of the stiffness."""
        self.pattern.count(sizes)

    def add_stiffness(self, x: Array, sums: Array, A: PETSc.Mat) -> None:
        """Add the stiffness ``force / slip`` against the slip; see `secant_stiffness`."""
        t = self.table
        secant = secant_stiffness(self.slips, t.bound, t.eps)
        start = 0
        for k, value in enumerate(secant * t.slope**2):
            own = self._gradients[t.pointers[k] : t.pointers[k + 1]]
            n = len(own)
            self.pattern.values[start : start + n * n] = value * np.einsum(
                "ai,bj->abij", own, own
            ).reshape(n * n, 3, 3)
            start += n * n
        self.pattern.add(A, self.unknowns)


@numba.njit(cache=True)
def add_slip_forces(pointers, blocks, gradients, force, slope, g):  # type: ignore[no-untyped-def]
    """Add ``sum force * slope * d(fractions)/dx`` to g, (n_blocks, 3)."""
    for k in range(force.shape[0]):
        for q in range(pointers[k], pointers[k + 1]):
            for i in range(3):
                g[blocks[q], i] += force[k] * slope[k] * gradients[q, i]
