"""Pressure by the areas at the start of a load step."""

from __future__ import annotations

import numba
import numpy as np
import ufl
from dolfinx import fem

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.folded_pressure import Facets
from crms_fenicsx.energies.integral import one_point
from crms_fenicsx.energies.kinematics import Kinematics, tangent_basis
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


class FoldedStepPressure:
    """The paper's nodal forces, constant in a step, on folded cells; see `loads.StepPressure`.

    Parameters
    ----------
    gained
        Volume gained in the steps before, a one-element array kept by the caller.
    """

    name = "pressure"
    n_sums = 1

    def __init__(self, table: Facets, pressure: fem.Constant, gained: Array) -> None:
        self.table, self.pressure, self._gained = table, pressure, gained

    def attach(self, unknowns: Unknowns) -> None:
        """Use the positions of this layout."""
        self.unknowns = unknowns
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


class StepPressure:
    """The paper's pressure: nodal forces that keep direction and size in a step, (2.4-1, 2).

    A node carries a third of the area of each of its cells. The volume is summed up step by step,
    which is exact only as the steps get small. It needs no held edges.
    Parameters are those of `FollowerPressure`.

    Attributes
    ----------
    volume_n
        Volume gained in all steps before (length cubed).
    """

    name = "pressure"
    n_sums = 1

    def __init__(self, u: fem.Function, cells: fem.Function, pressure: fem.Constant) -> None:
        mesh, V = u.function_space.mesh, u.function_space
        self.pressure = pressure
        self.u = u
        self.u_n = fem.Function(V)
        F = Kinematics(self.u_n, tangent_basis(mesh, None)).F
        n = ufl.cross(F[0], F[1])
        dx = one_point(mesh)
        self._volume = fem.form(cells * ufl.dot(n, u - self.u_n) * dx)
        self._force = fem.form(cells * ufl.dot(n, ufl.TestFunction(V)) * dx)
        self._forces, self._scaled = np.zeros_like(u.x.array), np.zeros_like(u.x.array)
        self.volume_n = 0.0

    def attach(self, unknowns: Unknowns) -> None:
        """Use this layout."""
        self.unknowns = unknowns

    def begin_step(self, x: Array) -> None:
        """Take the current shape as the step's start."""
        self.u_n.x.array[:] = self.u.x.array
        self._forces[:] = 0.0
        fem.assemble_vector(self._forces, self._force)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained in the step (length cubed)."""
        out[0] = fem.assemble_scalar(self._volume)

    def energy(self, sums: Array) -> float:
        """``-p (V - V0)``, with the volume gained over all steps (force x length)."""
        return -float(self.pressure.value) * (self.volume_n + float(sums[0]))

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: keep its volume."""
        self.volume_n += float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Subtract the step's nodal forces."""
        np.multiply(self._forces, -float(self.pressure.value), out=self._scaled)
        self.unknowns.add_to_vertices(self._scaled.reshape(-1, 3), g)
