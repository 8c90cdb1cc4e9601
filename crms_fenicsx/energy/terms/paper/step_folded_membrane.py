"""The paper's incremental strain in folded cells, (2.3-1 ... 2.3-14); see `step_membrane`."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from crms_fenicsx.energy.terms.folded_membrane import FoldedCells, FoldedMembraneEnergy
from crms_fenicsx.energy.terms.folded_pressure import Facets
from crms_fenicsx.energy.terms.paper.step_membrane import (
    StepMembraneEnergy,
    rotated_stiffness,
    rotated_stress,
    second_piola,
)
from crms_fenicsx.energy.terms.segments import segment_lengths
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes.triangles import double_areas
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans


@numba.njit(cache=True)
def _step_forces(lengths, pointers, side_segments, sides, base, shape, stress, D, forces, out):  # type: ignore[no-untyped-def]  # fmt: skip
    """Energy of the step; forces of segments, and new stress and shape (n, 6) into `out`."""
    forces[:] = 0.0
    energy = 0.0
    r, s, increment = np.empty(3), np.empty(3), np.empty(3)
    slopes = np.empty((3, 3))  # of the strain by the sides ik, kj, ij
    for c in range(sides.shape[0]):
        for m in range(3):
            r[m] = 0.0
            side = sides[c, (base[c] + m) % 3]
            for q in range(pointers[side], pointers[side + 1]):
                r[m] += lengths[side_segments[q]]
        # Circles of radii |ij| about i and |kj| about k meet in j'''.
        x = (r[0] ** 2 + r[2] ** 2 - r[1] ** 2) / (2 * r[0])
        y = math.sqrt(r[2] ** 2 - x**2)
        a, e, f = shape[c, 0], shape[c, 1], shape[c, 2]
        increment[0] = (r[0] - a) / a
        increment[1] = (y - f) / f
        increment[2] = (x - e - increment[0] * e) / f
        dx = (1 - x / r[0], -r[1] / r[0], r[2] / r[0])
        for m in range(3):
            dy = -x * dx[m] / y
            if m == 2:
                dy += r[2] / y
            da = 1.0 if m == 0 else 0.0
            slopes[0, m], slopes[1, m] = da / a, dy / f
            slopes[2, m] = (dx[m] - da * e / a) / f
        area = 0.5 * a * f
        for i in range(3):
            s[i] = 0.0
            for j in range(3):
                s[i] += D[c, i, j] * increment[j]
            energy += area * (stress[c, i] + 0.5 * s[i]) * increment[i]
            s[i] += stress[c, i]
        for m in range(3):
            force = area * (s[0] * slopes[0, m] + s[1] * slopes[1, m] + s[2] * slopes[2, m])
            side = sides[c, (base[c] + m) % 3]
            for q in range(pointers[side], pointers[side + 1]):
                forces[side_segments[q]] += force
        out[c, 0], out[c, 1], out[c, 2] = s[0], s[1], s[2]
        out[c, 3], out[c, 4], out[c, 5] = r[0], x, y
    return energy


def _side_directions(shape: Array) -> Array:
    """Directions (n, 3, 2) of sides 0-1, 1-2 and 2-0 in the frame of side 0-1, from (a, e, f)."""
    a, e, f = shape.T
    zero = np.zeros_like(a)
    sides = [[a, zero], [e - a, f], [-e, -f]]
    return np.moveaxis(np.array(sides), 2, 0)


def _shape_on(shape: Array, base: npt.NDArray[np.int64]) -> Array:
    """Shapes (a, e, f) seen from the frame of side `base` instead of side 0-1, (n, 3)."""
    rows = np.arange(len(shape))
    sides = _side_directions(shape)
    own, previous = sides[rows, base], sides[rows, (base + 2) % 3]
    a = np.linalg.norm(own, axis=1)
    corner = -previous  # from i to j
    e = np.sum(own * corner, axis=1) / a
    f = np.abs(own[:, 0] * corner[:, 1] - own[:, 1] * corner[:, 0]) / a
    return np.stack([a, e, f], axis=1)


class StepFoldedMembraneEnergy(FoldedMembraneEnergy):
    """Strain energy of folded cells over all steps; side ik is the one with the fewest folds."""

    has_history = True
    exact_hessian = False

    def __init__(
        self,
        table: FoldedCells,
        membrane: StepMembraneEnergy,
        energy: Array,
    ) -> None:
        super().__init__(table, membrane.stiffening)
        self._history = membrane.history.x.array.reshape(-1, 6)
        self._energy_n = energy
        counts = np.diff(table.side_pointers)[table.sides]
        self.base = np.argmin(counts, axis=1)
        rows = np.arange(len(table.cells))
        directions = table.side_vectors[rows, self.base]
        self._D = np.zeros((len(rows), 3, 3))
        for n in rows:
            stiffness = table.parameters[n, :9].reshape(3, 3)
            self._D[n] = rotated_stiffness(stiffness, directions[n : n + 1])[0]
        self._after = np.zeros((len(rows), 6))
        self._read()

    def _read(self) -> None:
        """Turn the state at the step's start into the frames of the sides ik."""
        state = self._history[self.table.cells]
        rows = np.arange(len(state))
        directions = _side_directions(state[:, 3:])[rows, self.base]
        self._stress = rotated_stress(state[:, :3], directions)
        self._shape = _shape_on(state[:, 3:], self.base)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the step's energy; keeps the segments' forces for the gradient."""
        t = self.table
        segment_lengths(self.unknowns.X, x, t.segments, t.eps, self.lengths)
        out[0] = _step_forces(
            self.lengths, t.side_pointers, t.side_segments, t.sides, self.base, self._shape,
            self._stress, self._D, self.forces, self._after,
        )  # fmt: skip

    def cell_results(self) -> Array:
        """As `FoldedMembraneEnergy.cell_results`, with the section forces of the steps' law."""
        t = self.table
        rows = np.arange(len(t.cells))
        of_sides = np.add.reduceat(self.lengths[t.side_segments], t.side_pointers[:-1])
        changes = of_sides[t.sides] ** 2 - self.squares
        results = np.zeros_like(self.results)
        results[:, :3] = np.einsum("nij,nj->ni", self.maps, changes)
        side, back = t.side_vectors[rows, self.base], -t.side_vectors[rows, (self.base + 2) % 3]
        a = np.linalg.norm(side, axis=1)
        e = np.sum(side * back, axis=1) / a
        results[:, 3:6] = second_piola(
            self._after[:, :3],
            self._after[:, 3:],
            np.stack([a, e, 2 * self.areas / a], axis=1),
            side,
        )
        results[:, 6] = 2
        return results

    def energy(self, sums: Array) -> float:
        """Strain energy over all steps (force x length)."""
        return float(self._energy_n[0]) + float(sums[0])

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the stiffness of the total formulation."""
        super().sums(x, np.zeros(1))
        super().add_stiffness(x, sums, A)
        self.sums(x, np.zeros(1))

    def elements_on(self, chosen: Booleans) -> None:
        """Return none: nothing is relaxed alone with a law that has a history."""
        return None

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: write stresses and shapes back to the frame of side 0-1."""
        self._energy_n[0] = self.energy(sums)
        back = (3 - self.base) % 3  # side 0-1 counted from side ik
        rows = np.arange(len(self._after))
        directions = _side_directions(self._after[:, 3:])[rows, back]
        cells = self.table.cells
        self._history[cells, :3] = rotated_stress(self._after[:, :3], directions)
        self._history[cells, 3:] = _shape_on(self._after[:, 3:], back)
        self._read()


class FoldedLaggedPressure(EnergyTerm):
    """Nodal forces of the facets of folded cells that are constant in a step; see `StepPressure`.

    The paper loads the corners of a folded element only, (2.4-1).
    """

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
        corners = self.table.corners
        vectors = double_areas((self.unknowns.X + x)[corners])
        shares = (self.table.weights / 6.0)[:, None, None] * vectors[:, None]
        np.add.at(self._forces, corners, shares)

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
