"""Pressure by the areas at the start of a load step."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

from crms_fenicsx.energies.integral import one_point
from crms_fenicsx.energies.kinematics import Kinematics, tangent_basis
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime.arrays import Array


class StepPressure(EnergyTerm):
    """The paper's pressure: nodal forces that keep direction and size in a step, (2.4-1, 2).

    A node carries a third of the area of each of its cells. The volume is summed up step by step,
    which is exact only as the steps get small. It needs no held edges. Parameters are those of
    `FollowerPressure`.

    Attributes: `volume_n`: volume gained in all steps before (length cubed).
    """

    name = "pressure"
    has_history = True

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
