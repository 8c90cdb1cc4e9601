"""Minimisers for comparison: BLMVM alone, TAO's Newton method and SciPy's L-BFGS.

Each replaces the package's minimiser under the same load steps, paths and contacts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.energy.minimization.potential import Potential

MUMPS = "crms_h0_pc_factor_mat_solver_type"


class H0Alone(Minimizer):
    """BLMVM with H0: under cables without second derivatives and without relaxation."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        if self._relaxation is not None:
            self._relaxation.destroy()
        self._relaxation, self._by_cables = None, False


class WithoutH0(H0Alone):
    """TAO's BLMVM with its own scaled identity, as the paper's quasi-Newton method."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._uses_h0 = False


class Newton(WithoutH0):
    """TAO's Newton method with a line search (NLS).

    The Hessian is exact, but in the first iterations from a flat sheet: there it is H0's stiffness
    with its extra prestress.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.h0.destroy()
        self.h0 = self.hessian = ExactHessian(self.potential, "crms_h0_")
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
        prestress = self._prestress[min(self.hessian.count, len(self._prestress) - 1)]
        for stiffening in self._stiffenings():
            stiffening.set(prestress)
        self.hessian.assemble(exact=prestress == 0.0)


class ExactHessian(InitialHessian):
    """The Hessian of a potential; factorised as an indefinite matrix, also after TAO's shifts."""

    def __init__(self, potential: Potential, prefix: str) -> None:
        PETSc.Options()[MUMPS] = "mumps"
        super().__init__(potential, prefix)
        self.count = 0

    def assemble(self, exact: bool) -> npt.NDArray[np.bool_]:
        """Assemble at the potential's current state."""
        held = super().assemble(exact)
        self.matrix.setOption(PETSc.Mat.Option.SPD, False)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return held

    def factorize(self) -> None:
        """Factorise, and solve for the cables' dyads."""
        self.count += 1
        self.pc.setUp()
        self._dyads, columns = self.potential.dyad_columns(self._held, exact=True)
        self._add_dyads(columns)


class _Factors:
    """What PETSc calls as a preconditioner; the Hessian's own `destroy` is not for PETSc."""

    def __init__(self, hessian: ExactHessian) -> None:
        self.hessian = hessian

    def setUp(self, pc: PETSc.PC) -> None:
        self.hessian.factorize()

    def apply(self, pc: PETSc.PC, b: PETSc.Vec, y: PETSc.Vec) -> None:
        self.hessian.precondition(b, y)


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
            if interrupt is not None and not looked and residual <= self.strategy.looks[0] * scale:
                X.array[:] = x
                potential.place(X)
                looked, stopped = True, interrupt(residual, scale, True)
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
        return Outcome(converged, reason, residual, tolerance, *counts, scale=scale)
