"""Newton's method, which takes over under cables, and where quasi-Newton stages come to little.

Under cables it steps by the exact second derivatives where these are definite. What has learnt from
a few gradients knows nothing of the handful of cable points that hold nearly all the force, each
nonlinear over a tiny distance of its own. These are relaxed alone, also at the end of a step that
has raised the energy, before that is shortened.

Where much of a membrane is wrinkled or slack, what the quasi-Newton updates have learnt is wrong as
soon as some more cells have wrinkled. Then H0 without updates is rebuilt in each iteration:
Newton's method on an energy whose slope has kinks, with a part of the taut stiffness on top that
grows where the energy falls less than promised, and shrinks else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from crms_fenicsx.energies.kinematics import FLOOR
from crms_fenicsx.minimization.initial_hessian import InitialHessian
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Array, Indices

if TYPE_CHECKING:
    from crms_fenicsx.minimization.relaxation import LocalRelaxation

STUBBORN, PATIENCE = 0.1, 8
"""Reduction of the residual by a stage above which Newton's method takes over, after how many
stages: cables that pass vertices take a few, and no Newton step makes that faster."""

RESTRAINT = 1e-2
"""Part of the taut stiffness that wrinkled cells have at first in Newton's method, relative to the
root of the residual over the force scale."""

NEAR, QUICK, QUICK_STEPS = 1e-4, 0.3, 10
"""Residual, relative to the force scale, down to which steps are made by the second derivatives
where cable points can be relaxed; and part that may be left of it after how many of them."""

NEWTON_STAGES = 20
"""Iterations of Newton's method in which the residual must fall by more than that."""

STEADY, RISE = 1e-10, 1e-11
"""Fall of the energy, relative to it, below which the trapezoidal rule takes its place in Newton's
method, and rise up to which: that much is rounding."""

DESCENT, SHORTEST = 1e-4, 1e-3
"""Least part of the descent promised that a Newton step must keep, and the shortest one tried."""

Stopped = tuple[Indices, Array]
"""Blocks of points that were stopped on their way (m,), and by how much, (m, 3) (length)."""


class NewtonMethod:
    """Steps of Newton's method on a potential, with H0 as its Hessian.

    Attributes: `active`: whether it has taken over; `trusts_exact`: whether H0 may be the energy's
    second derivatives in this solve; `restraint`: part of the taut stiffness that wrinkled cells
    have on top of their tangent.
    """

    def __init__(
        self, potential: Potential, h0: InitialHessian, relaxation: LocalRelaxation | None
    ) -> None:
        self.potential, self.h0, self.relaxation = potential, h0, relaxation
        self.begin()

    def begin(self) -> None:
        """Begin a solve, without this method at first."""
        self.active, self.restraint = False, RESTRAINT
        self.trusts_exact = self.relaxation is not None
        self._quick, self._failed = False, 0
        self._count, self._mark = 0, 0.0

    def is_quick(self, residual: float, scale: float) -> bool:
        """Decide whether the next step is one by the second derivatives, with points relaxed. So it
        is on the way from afar to near the minimum, unless it fails or makes no progress. Units:
        residual (force)."""
        if self.trusts_exact and self._quick:
            self._count += 1
            if self._count == QUICK_STEPS:
                self._count, slow = 0, residual > QUICK * self._mark
                self._mark = residual
                self.trusts_exact = not slow
        self.trusts_exact &= self._failed < 2
        afar = 0.0 if self.relaxation is None else self.relaxation.afar
        if self.trusts_exact and NEAR * scale < residual < afar * scale:
            if not self._quick:
                self._count, self._mark = 0, residual
            self.active = self._quick = True
            self.restraint = FLOOR
        elif self._quick:
            self.active = self._quick = False
        return self._quick

    def take_over(self, residual: float, reduced: float, scale: float) -> None:
        """Begin where a stage has `reduced` the residual to little less than it was. Units:
        residual, reduced (force)."""
        self.active, self._count, self._mark = residual > STUBBORN * reduced, 0, residual
        self.restraint = RESTRAINT * (residual / max(scale, residual)) ** 0.5

    def check_progress(self, residual: float) -> None:
        """Give up where the residual has not fallen in `NEWTON_STAGES` iterations."""
        self._count += 1
        if self._count == NEWTON_STAGES:
            self.active = residual <= STUBBORN * self._mark
            self._count, self._mark = 0, residual

    def step(
        self, x0: PETSc.Vec, g0: PETSc.Vec, energy0: float, x: PETSc.Vec, g: PETSc.Vec, d: PETSc.Vec
    ) -> bool:
        """Step by H0 alone, as far as the energy falls, cable points no farther than near the ends
        of their edges. Returns whether the energy has fallen; the potential is then in the new
        state."""
        part, kept, fallen = 2.0, 0.0, False
        self.h0.solve(g0, d)
        slope = -g0.dot(d)
        while not fallen and part >= SHORTEST:
            part *= 0.5
            x.waxpy(-part, d, x0)
            stopped = self._stop_points(x0, x)
            work = part * slope + self._work(g0, stopped)
            energy = self.potential.objective_gradient(None, x, g)
            change = energy - energy0
            if -STEADY * abs(energy) <= change <= RISE * abs(energy):
                change = 0.5 * (work - part * g.dot(d) + self._work(g, stopped))
            fallen = change <= DESCENT * work < 0.0
            if not fallen and self.relaxation is not None and self.relaxation.relax_points(0.0):
                change = self.potential.energy() - energy0
                fallen = change <= DESCENT * work < 0.0
            kept = change / (part * (1 - part / 2) * slope)  # of what H0 promises
        if not fallen:
            factor = 10.0
            if not energy - energy0 <= RISE * abs(energy):
                self.potential.place(x0)
        elif part < 0.25 or kept < 0.25:
            factor = 3.0
        else:
            factor = 0.1 if kept > 0.9 else 0.3 if kept > 0.6 else 1.0
            factor = factor if part == 1.0 else 1.0
        self.restraint = min(factor * self.restraint, 1.0)
        self._failed = 0 if fallen else self._failed + 1
        return fallen

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
        """Work of forces on the way that points were moved back by (force x length)."""
        if stopped is None:
            return 0.0
        points, change = stopped
        own = float(np.sum(g.array_r.reshape(-1, 3)[points] * change))
        return float(self.potential.comm.allreduce(own))
