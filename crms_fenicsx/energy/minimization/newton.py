"""Newton's method, used where quasi-Newton stages make little progress.

Where much of a membrane is wrinkled or slack, quasi-Newton updates are outdated as soon as more
cells wrinkle. Then H0 without updates is rebuilt in each iteration: Newton's method on an energy
with kinks in its slope, plus a part of the taut stiffness that grows where the energy falls less
than predicted and shrinks otherwise.
"""

from __future__ import annotations

from petsc4py import PETSc

from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import Strategy

STEADY, RISE = 1e-10, 1e-11
"""Relative fall of the energy below which Newton's method uses the trapezoidal rule, and relative
rise up to which it does: both are rounding."""


class NewtonMethod:
    """Newton steps on a potential, with H0 as its Hessian.

    Attributes: `active`: whether it has taken over; `trusts_exact`: whether H0 may be the energy's
    second derivatives in this solve; `wrinkle_stiffness`: stiffness added to wrinkled cells,
    relative to that of taut ones.
    """

    def __init__(self, potential: Potential, h0: InitialHessian, strategy: Strategy) -> None:
        self.potential, self.h0, self.strategy = potential, h0, strategy
        self.begin()

    def begin(self) -> None:
        """Begin a solve, inactive."""
        self.active, self.wrinkle_stiffness = False, self.strategy.wrinkle_stiffness
        self._count, self._mark, self._failed, self.trusts_exact = 0, 0.0, 0, True

    def take_over(self, residual: float, reduced: float, scale: float) -> None:
        """Take over if a stage has `reduced` the residual too little. Units: both (force)."""
        self.active = residual > self.strategy.stubborn * reduced
        self._count, self._mark = 0, residual
        part = (residual / max(scale, residual)) ** 0.5
        self.wrinkle_stiffness = self.strategy.wrinkle_stiffness * part

    def check_progress(self, residual: float) -> None:
        """Give up if the residual has not fallen enough in `newton_stages` iterations."""
        self._count += 1
        if self._count == self.strategy.newton_stages:
            self.active = residual <= self.strategy.stubborn * self._mark
            if not self.active:  # H0 does no better: use the second derivatives until a step fails
                self.trusts_exact, self._failed = True, 1
            self._count, self._mark = 0, residual

    def step(
        self, x0: PETSc.Vec, g0: PETSc.Vec, energy0: float, x: PETSc.Vec, g: PETSc.Vec, d: PETSc.Vec
    ) -> bool:
        """Step by H0 alone with line search. Returns whether the energy has fallen; the potential
        is then at the new state."""
        part, kept, fallen = 2.0, 0.0, False
        self.h0.solve(g0, d)
        slope = -g0.dot(d)
        while not fallen and part >= self.strategy.shortest:
            part *= 0.5
            x.waxpy(-part, d, x0)
            energy = self.potential.objective_gradient(None, x, g)
            change = energy - energy0
            if -STEADY * abs(energy) <= change <= RISE * abs(energy):
                change = 0.5 * part * (slope - g.dot(d))
            fallen = change <= self.strategy.descent * part * slope < 0.0
            if not fallen and self.h0.slackened:
                break  # shortened, it ends where cables just turn taut: count these so
            kept = change / (part * (1 - part / 2) * slope)  # relative to H0's prediction
        if not fallen:
            factor = 10.0
            if not energy - energy0 <= RISE * abs(energy):
                self.potential.place(x0)
        elif part < 0.25 or kept < 0.25:
            factor = 3.0
        else:
            factor = 0.1 if kept > 0.9 else 0.3 if kept > 0.6 else 1.0
            factor = factor if part == 1.0 else 1.0
        self.wrinkle_stiffness = min(factor * self.wrinkle_stiffness, 1.0)
        self._failed = 0 if fallen else self._failed + 1
        self.trusts_exact &= self._failed < 2
        return fallen
