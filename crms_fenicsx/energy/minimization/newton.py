"""Newton's method, used under cables and where quasi-Newton stages make little progress.

Under cables that fold cells it uses the exact second derivatives where definite. Nearly all force
sits at a handful of cable points, each nonlinear over its own tiny distance, which updates from a
few gradients cannot represent. These are relaxed alone, also where a step has raised the energy:
after a full step as long as that helps, since a shortened step of all unknowns gains little. Cables
along edges of the mesh have no such points: there a stage with the second derivatives as its H0
takes one factorisation where Newton's method takes three.

Where much of a membrane is wrinkled or slack, quasi-Newton updates are outdated as soon as more
cells wrinkle. Then H0 without updates is rebuilt in each iteration: Newton's method on an energy
with kinks in its slope, plus a part of the taut stiffness that grows where the energy falls less
than predicted and shrinks otherwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import Strategy
from crms_fenicsx.energy.terms.kinematics import FLOOR
from crms_fenicsx.foundation.runtime.arrays import Array, Indices

if TYPE_CHECKING:
    from crms_fenicsx.energy.minimization.relaxation import LocalRelaxation

STEADY, RISE = 1e-10, 1e-11
"""Relative fall of the energy below which Newton's method uses the trapezoidal rule, and relative
rise up to which it does: both are rounding."""

Stopped = tuple[Indices, Array]
"""Blocks of stopped points (m,), and the correction of each, (m, 3) (length)."""


class NewtonMethod:
    """Newton steps on a potential, with H0 as its Hessian.

    Attributes: `active`: whether it has taken over; `trusts_exact`: whether H0 may be the energy's
    second derivatives in this solve; `wrinkle_stiffness`: stiffness added to wrinkled cells,
    relative to that of taut ones.
    """

    def __init__(
        self,
        potential: Potential,
        h0: InitialHessian,
        relaxation: LocalRelaxation | None,
        strategy: Strategy,
    ) -> None:
        self.potential, self.h0, self.relaxation = potential, h0, relaxation
        self.strategy = strategy
        self.begin()

    def begin(self) -> None:
        """Begin a solve, inactive."""
        self.active, self.wrinkle_stiffness = False, self.strategy.wrinkle_stiffness
        self.trusts_exact = self._tries_early = self.relaxation is not None
        self._quick, self._failed = False, 0
        self._exact = self._is_early = False
        self._count, self._mark, self._last = 0, 0.0, np.inf

    def is_quick(self, residual: float, scale: float) -> bool:
        """Whether the next step uses the second derivatives, with points relaxed: on the way to
        near the minimum, unless that fails or makes no progress. Units: residual (force)."""
        if self.trusts_exact and self._quick:
            self._count += 1
            if self._count == self.strategy.quick_steps:
                self._count, slow = 0, residual > self.strategy.quick * self._mark
                self._mark = residual
                self.trusts_exact = not slow
        self.trusts_exact &= self._failed < 2
        has_points = self.relaxation is not None and self.relaxation.has_points
        afar = self.strategy.afar if has_points else 0.0
        if self.trusts_exact and self.strategy.quick_to * scale < residual < afar * scale:
            if not self._quick:
                self._count, self._mark, self._last = 0, residual, np.inf
            self.active = self._quick = True
            self.wrinkle_stiffness = FLOOR
        elif self._quick:
            self.active = self._quick = False
        return self._quick

    def wants_exact(self, residual: float, scale: float) -> bool:
        """Whether the next H0 is to be the second derivatives: near the minimum, and earlier where
        a quick step with another H0 made little progress. Units: residual (force)."""
        near = residual < self.strategy.exact * scale
        slow = self._quick and not self._exact and residual > self.strategy.slow * self._last
        self._last = residual
        self._exact = self.trusts_exact and (near or (slow and self._tries_early))
        self._is_early = self._exact and not near
        return self._exact

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
            if not self.active and self.relaxation is not None:
                # H0 does no better than the second derivatives: use these until a step fails again.
                self.trusts_exact, self._failed = True, 1
            self._count, self._mark = 0, residual

    def step(
        self, x0: PETSc.Vec, g0: PETSc.Vec, energy0: float, x: PETSc.Vec, g: PETSc.Vec, d: PETSc.Vec
    ) -> bool:
        """Step by H0 alone with line search, stopping cable points short of the ends of their
        edges. Returns whether the energy has fallen; the potential is then at the new state."""
        part, kept, fallen = 2.0, 0.0, False
        self.h0.solve(g0, d)
        slope = -g0.dot(d)
        while not fallen and part >= self.strategy.shortest:
            part *= 0.5
            x.waxpy(-part, d, x0)
            stopped = self._stop_points(x0, x)
            work = part * slope + self._work(g0, stopped)
            energy = self.potential.objective_gradient(None, x, g)
            change = energy - energy0
            if -STEADY * abs(energy) <= change <= RISE * abs(energy):
                change = 0.5 * (work - part * g.dot(d) + self._work(g, stopped))
            fallen = change <= self.strategy.descent * work < 0.0
            if not fallen and self.h0.slackened:
                break  # relaxed or shortened, it ends where cables just turn taut: count these so
            if not fallen and self.relaxation is not None:
                change = self._relax(change, energy0, self.strategy.descent * work, part)
                fallen = change <= self.strategy.descent * work < 0.0
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
        self._tries_early &= not self._is_early or (fallen and part == 1.0)
        return fallen

    def _relax(self, change: float, energy0: float, needed: float, part: float) -> float:
        """Relax the points after a trial step that has changed the energy by `change` from energy0,
        until it has changed by `needed` or falls no more; return its change (force x length)."""
        assert self.relaxation is not None
        for _ in range(self.strategy.full_rounds if part == 1.0 else 1):
            if not self.relaxation.relax_points(0.0):
                break
            last, change = change, self.potential.energy() - energy0
            if change <= needed or change > self.strategy.gains * last:
                break
        return change

    def _stop_points(self, x0: PETSc.Vec, x: PETSc.Vec) -> Stopped | None:
        """Stop cable points in `x` short of the ends of their edges; None without such points."""
        damping, unknowns = self.potential.damping, self.potential.unknowns
        if damping is None:
            return None
        unknowns.update_ghosts(x0)
        unknowns.update_ghosts(x)
        with x0.localForm() as start, x.localForm() as end:
            return damping.stop_short(
                unknowns, start.array.reshape(-1, 3), end.array.reshape(-1, 3)
            )

    def _work(self, g: PETSc.Vec, stopped: Stopped | None) -> float:
        """Work of the forces g on the corrections of stopped points (force x length)."""
        if stopped is None:
            return 0.0
        points, change = stopped
        own = float(np.sum(g.array_r.reshape(-1, 3)[points] * change))
        return float(self.potential.comm.allreduce(own))
