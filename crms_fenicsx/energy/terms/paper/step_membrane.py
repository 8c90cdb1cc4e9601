"""The paper's incremental, edge-aligned membrane strain, as an option (2.3-3 ... 2.3-14).

A cell's x axis lies along its side ik. In a step its length grows by du_k, and the third corner j,
found from the two other sides, moves by (du_j, dv_j). With the shape (a, e, f) of a cell, a = |ik|
and (e, f) the place of j, the strain increment B d_delta is

    d_eps = (du_k / a,  dv_j / f,  (du_j - du_k e / a) / f).

The stress stays in that frame from step to step. The result depends on the step size and, at
finite strain, on which side is taken; in the limit of small steps it is a hypoelastic law that
differs from St. Venant-Kirchhoff's by the order of the strain.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from crms_fenicsx.energy.terms.integral import one_point
from crms_fenicsx.energy.terms.kinematics import Kinematics, tangent_basis
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap, interpolation_points
from crms_fenicsx.model.materials import MembraneMaterial


class StepPressure(EnergyTerm):
    """The paper's pressure: nodal forces that keep direction and size in a step (2.4-1, 2). Each
    corner of a cell, folded or not, carries a third of the area of the triangle between them."""

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


def shape_of(a_side: Any, b_side: Any) -> tuple[Any, Any, Any]:
    """Shape (a, e, f) of a triangle from the vectors i -> k and i -> j, in UFL."""
    a = ufl.sqrt(ufl.dot(a_side, a_side))
    e = ufl.dot(a_side, b_side) / a
    normal = ufl.cross(a_side, b_side)
    return a, e, ufl.sqrt(ufl.dot(normal, normal)) / a


def _strain_increment(old: Any, new: Any) -> Any:
    """d_eps (11, 22, 2 x 12) between two shapes, (2.3-8 ... 2.3-10), in UFL."""
    a, e, f = old
    du_k, du_j, dv_j = new[0] - a, new[1] - e, new[2] - f
    return ufl.as_vector([du_k / a, dv_j / f, (du_j - du_k * e / a) / f])


def rotated_stiffness(stiffness: Array, directions: Array) -> Array:
    """Voigt stiffness (n, 3, 3) in frames whose x axes (n, 2) are given in the material axes."""
    c, s = (directions / np.linalg.norm(directions, axis=1)[:, None]).T
    zero_row = [c * c, s * s, -c * s]
    T = np.array([zero_row, [s * s, c * c, c * s], [2 * c * s, -2 * c * s, c * c - s * s]])
    T = np.moveaxis(T, 2, 0)  # strain in the frame -> strain in the material axes
    return np.einsum("nki,kl,nlj->nij", T, stiffness, T)


def rotated_stress(stress: Array, directions: Array) -> Array:
    """Stresses (n, 3) in frames whose x axes are `directions`, (n, 2), in the old frames."""
    c, s = (directions / np.linalg.norm(directions, axis=1)[:, None]).T
    x, y, xy = stress.T
    return np.stack(
        [
            c * c * x + s * s * y + 2 * c * s * xy,
            s * s * x + c * c * y - 2 * c * s * xy,
            c * s * (y - x) + (c * c - s * s) * xy,
        ],
        axis=1,
    )


def second_piola(stress: Array, shape: Array, stress_free: Array, directions: Array) -> Array:
    """Second Piola-Kirchhoff forces (n, 3) in the material axes: S = J F^-1 sigma F^-T."""
    (a, e, f), (a0, e0, f0) = shape.T, stress_free.T
    F = np.zeros((len(shape), 2, 2))
    F[:, 0, 0], F[:, 0, 1], F[:, 1, 1] = a / a0, (e - a * e0 / a0) / f0, f / f0
    sigma = stress[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    inverse = np.linalg.inv(F)
    S = np.linalg.det(F)[:, None, None] * (inverse @ sigma @ np.swapaxes(inverse, 1, 2))
    in_frame = np.stack([S[:, 0, 0], S[:, 1, 1], S[:, 0, 1]], axis=1)
    return rotated_stress(in_frame, directions * [1.0, -1.0])  # the material axis 1 from the side


class StepMembraneEnergy(MembraneEnergy):
    """Strain energy of plain cells over all steps (2.3-14); side ik joins corners 0 and 1."""

    has_history = True
    exact_hessian = False

    def __init__(
        self, u: fem.Function, materials: Mapping[int, MembraneMaterial], cell_tags: Any = None
    ) -> None:
        super().__init__(u, materials, cell_tags)
        self.integral.inputs = None
        mesh = u.function_space.mesh
        self.history = fem.Function(fem.functionspace(mesh, ("DG", 0, (6,))))
        self.stiffness_n = fem.Function(fem.functionspace(mesh, ("DG", 0, (3, 3))))
        self._start()
        J = ufl.Jacobian(mesh)
        sides = [J[:, k] + ufl.dot(ufl.grad(u), J[:, k]) for k in (0, 1)]
        h, D = self.history, self.stiffness_n
        stress, old = ufl.as_vector([h[0], h[1], h[2]]), (h[3], h[4], h[5])
        new = shape_of(*sides)
        increment = _strain_increment(old, new)
        normal = ufl.cross(J[:, 0], J[:, 1])
        area = old[0] * old[2] / ufl.sqrt(ufl.dot(normal, normal))
        self._density = ufl.dot(stress + ufl.dot(D, increment) / 2, increment) * area
        after = stress + ufl.dot(D, increment)
        points = interpolation_points(self.history.function_space.element)
        self._after = fem.Expression(ufl.as_vector([*(after[i] for i in range(3)), *new]), points)
        self._next = fem.Function(self.history.function_space)
        self._stress_free = self.history.x.array.reshape(-1, 6)[:, 3:].copy()
        self.energy_n = 0.0

    def _variation(self, v: Any, q: Any, dx: ufl.Measure) -> Any:
        """The form of energy and gradient, as `Integral` wants it."""
        density = self.plain * self._density
        return density * q * dx + ufl.derivative(density * dx, self.u, v)

    def _start(self) -> None:
        """The stress-free (or prestressed) state in the cells' frames."""
        mesh = self.u.function_space.mesh
        x = mesh.geometry.x[geometry_dofmap(mesh)]
        cells = np.arange(len(x), dtype=np.int32)
        side, other = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        a = np.linalg.norm(side, axis=1)
        directions = np.einsum("ni,nai->na", side, self.material_axes(cells))
        self._directions = directions
        history = self.history.x.array.reshape(-1, 6)
        D = self.stiffness_n.x.array.reshape(-1, 3, 3)
        tags = self.material_tags(cells)
        for tag, material in self.materials.items():
            own = tags == tag
            D[own] = rotated_stiffness(material.stiffness, directions[own])
            stress = np.broadcast_to(material.prestress_vector, (int(own.sum()), 3))
            history[own, :3] = rotated_stress(stress, directions[own])
        history[:, 3] = a
        history[:, 4] = np.sum(side * other, axis=1) / a
        history[:, 5] = np.linalg.norm(np.cross(side, other), axis=1) / a

    def energy(self, sums: Array) -> float:
        """Strain energy over all steps (force x length)."""
        return self.energy_n + float(sums[0])

    def rounding(self, x: Array, sums: Array) -> float:
        """As `MembraneEnergy.rounding`, of section forces at a strain of 1: increments of strain
        are differences of lengths, and the total strain is one of displacements."""
        return self._area * (4 * EPSILON * (self._prestress + self._modulus)) ** 2

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: its stresses and shapes are the next step's start."""
        self.energy_n = self.energy(sums)
        self._next.interpolate(self._after)
        plain = self.plain.x.array > 0.5
        self.history.x.array.reshape(-1, 6)[plain] = self._next.x.array.reshape(-1, 6)[plain]

    def cell_results(self) -> Array:
        """As `MembraneEnergy.cell_results`, with the section forces of the steps' law."""
        results = super().cell_results()
        self._next.interpolate(self._after)
        n = len(results)
        state = self._next.x.array.reshape(-1, 6)[:n]
        results[:, 3:6] = second_piola(
            state[:, :3], state[:, 3:], self._stress_free[:n], self._directions[:n]
        )
        return results
