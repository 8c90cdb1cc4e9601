"""Minimisers to compare with: BLMVM on its own, TAO's Newton method and SciPy's L-BFGS.

Each takes the place of the package's minimiser, under the same load steps, paths and contacts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from crms_fenicsx.energies.integral import one_point
from crms_fenicsx.energies.kinematics import Kinematics, tangent_basis
from crms_fenicsx.energies.membrane_energy import MembraneEnergy
from crms_fenicsx.energies.pressure import FollowerPressure
from crms_fenicsx.minimization.initial_hessian import InitialHessian
from crms_fenicsx.minimization.minimizer import COARSE, Minimizer
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.minimization.potential import Potential

MUMPS = "crms_h0_pc_factor_mat_solver_type"


class WithoutH0(Minimizer):
    """TAO's BLMVM with its own scaled identity, as the paper's quasi-Newton method."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._uses_h0 = False


class Newton(Minimizer):
    """TAO's Newton method with a line search (NLS).

    The Hessian of the plain cells is exact: the relaxed energy's consistent tangent, without the
    floor that it has in H0, and the pressure's stiffness. Folded cells, cables and penalty are in
    by the positive part that H0 has of them, folded cells without the pressure's. The first
    iterations from a flat sheet have the package's extra prestress.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._uses_h0 = False
        self.h0.destroy()
        self.h0 = self.hessian = ExactHessian(self.potential, "crms_h0_")
        self._membrane = [term for term in self.potential.terms if hasattr(term, "stiffening")]
        self.tao.setType(PETSc.TAO.Type.NLS)
        self.tao.setHessian(self._place_hessian, self.h0.matrix)
        ksp = self.tao.getKSP()
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        ksp.getPC().setPythonContext(_Factors(self.hessian))
        self.tao.setFromOptions()

    def solve(
        self,
        h0_prestress: tuple[float, ...] = (0.0,),
        interrupt: Callable[[], bool] | None = None,
    ) -> Outcome:
        """As `Minimizer.solve`."""
        self._prestress, self.hessian.count = h0_prestress, 0
        outcome = super().solve(h0_prestress, interrupt)
        return Outcome(**{**outcome.__dict__, "factorizations": self.hessian.count})

    def _place_hessian(self, tao: PETSc.TAO, X: PETSc.Vec, H: PETSc.Mat, P: PETSc.Mat) -> None:
        """TAO's callback: the Hessian at X."""
        if not X.equal(self.potential.x_vector):
            self.potential.place(X)
            self.potential.evaluate()
        for term in self._membrane:
            last = len(self._prestress) - 1
            stiffening = term.stiffening  # type: ignore[attr-defined]
            stiffening.set(self._prestress[min(self.hessian.count, last)])
            stiffening.floor.value = 0.0
        self.hessian.assemble()


class ExactHessian(InitialHessian):
    """The Hessian of a potential; factorised as an indefinite matrix, also after TAO's shifts."""

    def __init__(self, potential: Potential, prefix: str) -> None:
        PETSc.Options()[MUMPS] = "mumps"
        super().__init__(potential, prefix)
        self.count = 0
        plain = next(term.plain for term in potential.terms if isinstance(term, MembraneEnergy))
        for term in potential.terms:
            if isinstance(term, FollowerPressure) and not hasattr(term, "add_stiffness"):
                stiffness = PressureStiffness(term, potential.u, plain)
                term.add_stiffness = stiffness  # type: ignore[attr-defined]

    def assemble(self) -> None:
        """Assemble at the potential's current state."""
        self._held = self.potential.unknowns.held[: self.potential.unknowns.n_owned].copy()
        self._assemble(self._held)
        self.matrix.setOption(PETSc.Mat.Option.SPD, False)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def factorize(self) -> None:
        """Factorise, and solve for the cables' dyads."""
        self.count += 1
        self.pc.setUp()
        self._add_dyads(self._held)


class _Factors:
    """What PETSc calls as a preconditioner; the Hessian's own `destroy` is not for PETSc."""

    def __init__(self, hessian: ExactHessian) -> None:
        self.hessian = hessian

    def setUp(self, pc: PETSc.PC) -> None:
        self.hessian.factorize()

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, y: PETSc.Vec) -> None:
        self.hessian.precondition(b, y)


class PressureStiffness:
    """Second derivative of the follower pressure's potential ``-p (V - V0)`` on all plain cells."""

    def __init__(self, term: FollowerPressure, u: fem.Function, plain: fem.Function) -> None:
        V, mesh = u.function_space, u.function_space.mesh
        e1, e2 = tangent_basis(mesh, None)
        F = Kinematics(u, (e1, e2)).F
        X = ufl.SpatialCoordinate(mesh) - term.origin
        n0, n = ufl.cross(e1, e2), ufl.cross(F[0], F[1])
        change = ufl.dot(u, n) + ufl.dot(X, n - n0)
        energy = -term.pressure * plain * change / 3 * one_point(mesh)
        first = ufl.derivative(energy, u, ufl.TestFunction(V))
        self.form = fem.form(ufl.derivative(first, u, ufl.TrialFunction(V)))

    def __call__(self, x: np.ndarray, sums: np.ndarray, A: PETSc.Mat) -> None:
        """Add it to a matrix, as a term's `add_stiffness`."""
        fem_petsc.assemble_matrix(A, self.form)


class ScipyLBFGS(Minimizer):
    """SciPy's L-BFGS-B on the same energy and gradient."""

    def solve(
        self,
        h0_prestress: tuple[float, ...] = (0.0,),
        interrupt: Callable[[], bool] | None = None,
    ) -> Outcome:
        """As `Minimizer.solve`."""
        from scipy.optimize import minimize

        potential = self.potential
        potential.place()
        before = potential.evaluations
        energy0, scale = potential.evaluate_terms()
        tolerance = max(self.rtol * scale, self.atol)
        X, G = self._x, self._g
        looked = stopped = False

        def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
            X.array[:] = x
            return potential.objective_gradient(None, X, G) - energy0, G.array.copy()

        def look(x: np.ndarray) -> None:
            nonlocal looked, stopped
            residual = G.norm()
            if residual <= tolerance:
                raise StopIteration
            if interrupt is not None and not looked and residual <= COARSE * scale:
                X.array[:] = x
                potential.place(X)
                looked, stopped = True, interrupt()
                if stopped:
                    raise StopIteration

        limits = {"maxcor": 20, "maxiter": 10**7, "maxfun": 10**7, "ftol": 0.0, "gtol": 0.0}
        result = minimize(
            objective, potential.x_vector.array.copy(), jac=True, method="L-BFGS-B", callback=look,
            options=limits,
        )  # fmt: skip
        objective(result.x)
        residual = float(G.norm())
        reason = result.message
        if stopped or residual <= tolerance:
            reason = "interrupted" if stopped else "converged"
        counts = result.nit, potential.evaluations - before, 0
        converged = reason in ("converged", "interrupted")
        return Outcome(converged, reason, residual, tolerance, *counts)
