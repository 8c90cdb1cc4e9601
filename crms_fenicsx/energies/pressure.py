"""Air pressure on the plain cells, as an exact follower load (section 2.4)."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from crms_fenicsx.energies.integral import Integral, one_point
from crms_fenicsx.energies.kinematics import Kinematics, tangent_basis
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime.arrays import Array


class FollowerPressure(EnergyTerm):
    """Potential ``-p (V - V0)`` of a uniform pressure, V the volume under the membrane.

    Its gradient is the pressure's exact nodal forces, normal to the current surface, as long as the
    `open_edges` are held; where they slide in planes `crms_fenicsx.energies.pressure_rim` has what
    is missing. V is counted from `origin`; V0 is that of the stress-free surface, so that the
    energy is the work done since and does not depend on the origin.

    Attributes: `integral`: the volume gained, and the gradient of the potential. Shapes and units:
    pressure (force per area), origin (3,) (length).
    """

    name = "pressure"
    exact_hessian = True
    integral: Integral

    def __init__(
        self,
        u: fem.Function,
        cells: fem.Function,
        pressure: fem.Constant,
        origin: Array,
    ) -> None:
        mesh = u.function_space.mesh
        self.u, self.cells, self.pressure = u, cells, pressure
        self._hessian: fem.Form | None = None
        e1, e2 = tangent_basis(mesh, None)
        F = Kinematics(u, (e1, e2)).F
        self.origin = fem.Constant(mesh, origin)
        X = ufl.SpatialCoordinate(mesh) - self.origin
        # V - V0 per area, term by term, so that a small change is not lost in a large volume.
        n0, n = ufl.cross(e1, e2), ufl.cross(F[0], F[1])
        change = ufl.dot(u, n) + ufl.dot(X, n - n0)
        x = X + u

        def variation(v: Any, q: Any, dx: ufl.Measure) -> Any:
            # of u . n + X . n, by hand: UFL's derivative has twice as many products
            dF = [ufl.dot(ufl.grad(v), e) for e in (e1, e2)]
            work = ufl.dot(v, n) + ufl.dot(dF[0], ufl.cross(F[1], x))
            work += ufl.dot(dF[1], ufl.cross(x, F[0]))
            return cells / 3 * (change * q - pressure * work) * dx

        self.integral = Integral(u.function_space, variation)

    def _hessian_form(self) -> fem.Form:
        """The form of the second derivatives, compiled when they are first wanted."""
        V = self.u.function_space
        e1, e2 = tangent_basis(V.mesh, None)
        F = Kinematics(self.u, (e1, e2)).F
        n = ufl.cross(F[0], F[1])
        volume = self.cells / 3 * ufl.dot(ufl.SpatialCoordinate(V.mesh) - self.origin + self.u, n)
        energy = -self.pressure * volume * one_point(V.mesh)
        force = ufl.derivative(energy, self.u, ufl.TestFunction(V))
        return fem.form(ufl.derivative(force, self.u, ufl.TrialFunction(V)))

    def add_hessian(self, x: Array, sums: Array, A: PETSc.Mat) -> None:
        """Add the second derivatives, in places that the membrane's stiffness has filled."""
        if self._hessian is None:
            self._hessian = self._hessian_form()
        fem_petsc.assemble_matrix(A, self._hessian)  # type: ignore[arg-type]

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained, V - V0 (length cubed)."""
        out[0] = self.integral.value

    def energy(self, sums: Array) -> float:
        """Minus the work of the pressure since the stress-free shape (force x length)."""
        return -float(self.pressure.value) * float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the pressure's nodal forces, with the sign of a gradient."""
        self.unknowns.add_to_vertices(self.integral.gradient, g)
