"""Minimisation of the potential by TAO's BLMVM with a positive definite initial Hessian.

The paper minimises each step's potential by a quasi-Newton method (section 2.7). Plain BLMVM, the
option ``-crms_h0 false``, needs hundreds of iterations on a membrane and thousands with a cable.
Here its initial Hessian H0 is a stiffness, positive definite by construction. The solve runs in
*stages*: one ends, and H0 is rebuilt, once finishing would take longer than with a new H0, or its
line searches have cost as much. The next solve of the same potential, at other loads, starts with
the last H0.

Newton's method, with H0 rebuilt in each iteration, takes over where a stage makes little progress,
as where much of a membrane is wrinkled or slack. Under cables H0 is the energy's second derivative
near the minimum, and a solve begins with the place that is out of balance (`relaxation.py`).

Near the minimum energy differences drown in rounding before the forces balance. There a stage keeps
the H0 of the one before and measures energy from its start x0 by the trapezoidal rule, accurate to
the rounding of the forces:

    W(x) - W(x0) = (g(x) + g(x0)) . (x - x0) / 2 + O(|x - x0|^3).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energy.minimization import outcome as endings
from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian, at_bounds
from crms_fenicsx.energy.minimization.newton import STEADY, NewtonMethod
from crms_fenicsx.energy.minimization.outcome import (
    REASONS,
    SEARCH_FAILED,
    Outcome,
    Stalling,
    is_unstressed,
)
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import STRATEGY, Strategy
from crms_fenicsx.energy.terms.kinematics import FLOOR, Stiffening
from crms_fenicsx.foundation.runtime.errors import InputError, garbage_kept

if TYPE_CHECKING:
    from crms_fenicsx.energy.minimization.relaxation import Relaxation

ROUNDED = 1e-6
"""Residual, relative to the force scale, below which energy is measured from the stage's start, as
also below a hundred tolerances where these are set by rounding or `atol`; farther away the rule's
error would matter. Up to it a residual of pure rounding is accepted, and to it a solve without H0
goes: the last digits would take it a hundred times as many iterations."""

Interrupt = Callable[[float, float, bool], bool]
"""Whether to stop, given residual and force scale (force), and whether it is the last call."""

BOUNDED_TYPES, UNBOUNDED_TYPES = ("blmvm", "bqnls", "bncg"), ("lmvm", "cg")
"""Minimisers that need only energy and gradient, with bounds and without."""


class Minimizer:
    """TAO's BLMVM on a potential, in stages with a fresh H0 each, or without H0. PETSc options with
    the prefix override every choice, for example ``-crms_tao_type``, ``-crms_tao_monitor``,
    ``-crms_h0 false``, ``-crms_h0_pc_type``. Units: atol (force).

    Where much of a membrane is slack a solve may take hundreds of stages, each fast; halving the
    increments instead takes more in sum and often finds nothing. It ends early without progress."""

    def __init__(
        self,
        potential: Potential,
        prefix: str = "crms_",
        rtol: float = 1e-9,
        atol: float = 0.0,
        max_stages: int = 1000,
        strategy: Strategy = STRATEGY,
    ) -> None:
        self.potential, self.strategy = potential, strategy
        self.rtol, self.atol, self.max_stages = rtol, atol, max_stages
        self.stiffness = self.size = 0.0
        """Of the unloaded structure, as in `is_unstressed` (force, length)."""
        self.newton, self.reach = True, math.inf
        """Whether Newton's method may take over from slow stages, and how far vertices may be from
        their stress-free positions (length)."""
        comm = potential.comm
        self.h0 = InitialHessian(potential, prefix + "h0_", strategy)
        self._x, self._g, self._x0, self._g0, self._step = (
            potential.x_vector.duplicate() for _ in range(5)
        )
        self._trial = self._x, self._g, self._step
        self._close = self._at_start = False
        self._energy0 = self._residual0 = self._tolerance = self._scale = self._near = 0.0
        self._evaluations0, self._length = 0, strategy.stage_lengths[0]
        self._relaxation: Relaxation | None = None
        self._h0_is_outdated, self._most_h0_iterations = True, math.inf
        self._interrupt: Interrupt | None = None
        self._looks: tuple[float, ...] = ()
        self._interrupted = False
        self._error: BaseException | None = None
        self.tao = PETSc.TAO().create(comm)
        self.tao.setOptionsPrefix(prefix)
        self.tao.setType(PETSc.TAO.Type.BLMVM)
        self.tao.setObjectiveGradient(self._objective_gradient, self._g)
        self.tao.setSolution(self._x)
        self.tao.setMonitor(self._monitor)
        self.tao.setMaximumIterations(100_000)
        self._bounds: tuple[PETSc.Vec, PETSc.Vec] | None = None
        if potential.unknowns.bounds is not None:
            self._bounds = (self._x.duplicate(), self._x.duplicate())
            self.tao.setVariableBounds(*self._bounds)
        options = PETSc.Options(prefix)
        defaults = {"tao_blmvm_mat_lmvm_hist_size": 20, "tao_ls_max_funcs": strategy.longest_search}
        for name, value in defaults.items():
            if not options.hasName(name):
                options[name] = value
        self.tao.setFromOptions()
        kind = self.tao.getType()
        usable = BOUNDED_TYPES if self._bounds else BOUNDED_TYPES + UNBOUNDED_TYPES
        if kind not in usable:
            why = "has no bounds for a floor" if kind in UNBOUNDED_TYPES else "is not for this"
            raise InputError(
                f"option -{prefix}tao_type {kind} {why}; choose one of {', '.join(usable)}."
            )
        self._uses_h0 = kind in ("blmvm", "lmvm") and options.getBool("h0", True)
        # Under cables with neither laws of steps nor bounds H0 may be the second derivatives.
        self._by_cables = self._uses_h0 and self._bounds is None
        self._by_cables &= any(term.of_cables for term in potential.terms)
        self._by_cables &= not any(term.has_history for term in potential.terms)
        # Forms over all cells may have no counterpart for the cells around some vertices.
        alone = all(t.integral is None or t.elementwise is not None for t in potential.terms)
        if self._by_cables and alone:
            from crms_fenicsx.energy.minimization.relaxation import Relaxation

            self._relaxation = Relaxation(potential, strategy)
        self._stalling = Stalling(strategy)
        self._newton_method = NewtonMethod(potential, self.h0, strategy)
        self._h0_set = False

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.tao.destroy()
        self.h0.destroy()
        if self._relaxation is not None:
            self._relaxation.destroy()
        for vector in (self._x, self._g, self._x0, self._g0, self._step, *(self._bounds or ())):
            vector.destroy()

    def _objective_gradient(self, tao: PETSc.TAO, X: PETSc.Vec, G: PETSc.Vec) -> float:
        """TAO's callback: energy, or its change since the stage's start, and gradient."""
        if self._at_start:  # TAO first asks for the stage's start, which is known
            self._at_start = False
            self._g0.copy(G)
            return 0.0 if self._close else self._energy0
        energy = self.potential.objective_gradient(tao, X, G)
        if self.potential.unknowns.n_shifts and not math.isfinite(energy):
            # Cells collapse. From a state as high as the start the search goes a fifth as far.
            self._g0.copy(G)
            return abs(self._energy0) * STEADY + (0.0 if self._close else self._energy0)
        if not self._close:
            return energy
        X.copy(self._step)
        self._step.axpy(-1.0, self._x0)
        return 0.5 * (self._step.dot(G) + self._step.dot(self._g0))

    def _monitor(self, tao: PETSc.TAO) -> None:
        """TAO's callback after each iteration: ask whether to stop; end the stage if that pays."""
        residual = tao.getSolutionStatus()[2]
        try:
            if tao.getIterationNumber() > 0:
                self._ask(residual, self._x)
        except BaseException as error:  # PETSc would replace it by an error of its own
            self._error, self._interrupted = error, True
        over = self._interrupted or self._stage_is_over(tao.getIterationNumber(), residual)
        if over or self._largest_shift() > self.strategy.far_shift:
            tao.setConvergedReason(PETSc.TAO.ConvergedReason.CONVERGED_USER)

    def _ask(self, residual: float, X: PETSc.Vec | None = None) -> None:
        """Ask the caller whether to continue, at the state X or the current one."""
        left = tuple(look for look in self._looks if residual > look * self._scale)
        if self._interrupt is not None and len(left) < len(self._looks) and not self._interrupted:
            self._looks = left
            if X is not None:
                self.potential.place(X)
            self._interrupted = self._interrupt(residual, self._scale, not left)

    def _largest_shift(self) -> float:
        """Largest shift of a stress-free place at TAO's state. Collective."""
        unknowns = self.potential.unknowns
        return unknowns.largest_shift(self._x.array_r.reshape(-1, 3)) if unknowns.n_shifts else 0.0

    def _stage_is_over(self, iterations: int, residual: float) -> bool:
        """Whether to change the measure of energy or to rebuild H0."""
        if iterations == 0:
            return False
        searches = self.potential.evaluations - self._evaluations0 - iterations
        slow = iterations >= self._length and self._is_slow(iterations, residual)
        self._h0_is_outdated = self._uses_h0 and (slow or searches >= self.strategy.rebuild)
        return self._h0_is_outdated or (not self._close and residual <= self._near)

    def _is_slow(self, iterations: int, residual: float) -> bool:
        """Whether finishing takes longer than rebuilding H0 and going on with that."""
        if residual <= self._tolerance:
            return False
        left = math.log(residual) - math.log(max(self._tolerance, 1e-300))
        rate = (math.log(self._residual0) - math.log(residual)) / iterations
        return left > rate * (self.strategy.rebuild - left / math.log(self.strategy.fresh))

    def _run(self, residual: float) -> int:
        """Run TAO from this residual to the end of a stage and return its reason."""
        self._close = residual <= self._near
        self._at_start = self._bounds is None
        self._evaluations0 = self.potential.evaluations
        self.tao.setTolerances(gatol=self._tolerance, grtol=0.0, gttol=0.0)
        try:
            with garbage_kept():
                self.tao.solve()
            ended = int(self.tao.getConvergedReason())
        except PETSc.Error as error:
            # Raised where a trial step has a slope of the wrong sign: the line search has failed.
            if error.ierr != endings.OUT_OF_RANGE or error.__cause__ is not None:
                raise
            self._x0.copy(self._x)
            ended = SEARCH_FAILED
        if self._error is not None:
            raise self._error
        far = self.strategy.far_shift * (0.1 if ended == SEARCH_FAILED else 1.0)
        self._interrupted |= self._largest_shift() > far  # go on from a mesh that follows
        return ended

    def reset_h0(self) -> None:
        """Start the next solve with a new H0, as another process would."""
        self._h0_is_outdated = True

    def _renew_h0(self, h0_prestress: tuple[float, ...], renewals: int, failures: int) -> bool:
        """Rebuild H0 at the current state, and set it in TAO the first time. Returns whether it is
        usable. `renewals`: rebuilds so far in this solve; `failures`: consecutive failed line
        searches."""
        exact = self._by_cables and self._newton_method.trusts_exact
        strategy, rows = self.strategy, self.potential.unknowns.n_shifts > 0
        below = strategy.exact_of_rows if rows else strategy.exact
        exact = exact and self._residual0 < below * self._scale
        prestress = h0_prestress[-1 if exact else min(renewals, len(h0_prestress) - 1)]
        flat, least = h0_prestress[0] > 0.0, 0.0
        if flat and renewals > 1:
            least = self.strategy.unsettled * (self._residual0 / max(self._scale, 1e-300)) ** 2
        for stiffening in self._stiffenings():
            stiffening.set(prestress, failures, least)
            if self._newton_method.active:
                stiffening.floor.value = self._newton_method.wrinkle_stiffness
        lengths = self.strategy.stage_lengths
        self._length = lengths[min(renewals, len(lengths) - 1)]
        self._most_h0_iterations = 2 * self.strategy.rebuild if least > FLOOR else math.inf
        exact &= failures == 0
        if not self.h0.rebuild(exact) and not self.h0.rebuild():
            return False
        if not self._h0_set:
            self.tao.setLMVMH0(self.h0.matrix)
            self.h0.solve_for(self.tao.getLMVMH0KSP())
            self._h0_set = True
        return True

    def _stiffenings(self) -> list[Stiffening]:
        return [t.stiffening for t in self.potential.terms if t.stiffening is not None]

    def _begin(self, interrupt: Interrupt | None) -> None:
        """Begin a solve at the potential's current state."""
        self._interrupt, self._interrupted, self._error = interrupt, False, None
        strategy = self.strategy
        self._length = strategy.stage_lengths[0]
        self._looks = strategy.looks_of_cables if self._by_cables else strategy.looks
        self._newton_method.begin()
        self._stalling = Stalling(strategy)
        if self._bounds is not None and (bounds := self.potential.unknowns.bounds) is not None:
            n = self.potential.unknowns.n_owned
            for vector, bound in zip(self._bounds, bounds, strict=True):
                vector.array[:] = bound[:n].ravel()
        self.potential.place()

    def residual(self) -> float:
        """Norm of the last gradient without contact forces of an obstacle."""
        potential = self.potential
        n = potential.unknowns.n_owned
        g = potential.g[:n].copy()
        if potential.unknowns.bounds is not None:
            g[at_bounds(potential)] = 0.0
        return float(potential.comm.allreduce(float(np.sum(g * g)), op=MPI.SUM) ** 0.5)

    @np.errstate(over="ignore", invalid="ignore")  # the residual is checked
    def solve(
        self,
        h0_prestress: tuple[float, ...] = (0.0,),
        interrupt: Interrupt | None = None,
    ) -> Outcome:
        """Minimise from the potential's current state, which becomes the minimiser. Units:
        h0_prestress (force per length)."""
        potential, reason = self.potential, "too many stages"
        self._begin(interrupt)
        iterations = newton_steps = factorizations = failures = renewed = 0
        start, stages, best = potential.evaluations, 0.0, np.inf
        relaxation, warm = self._relaxation, h0_prestress[0] == 0.0
        local = 0 if relaxation is None else relaxation.steps
        # H0 holds the components in contact with a floor.
        self._h0_is_outdated |= h0_prestress[0] != 0.0 or self._bounds is not None
        while stages < self.max_stages:
            residual, tolerance, rounding = self._evaluate()
            if relaxation is not None and warm and stages == 0 and relaxation.relax(self._scale):
                residual, tolerance, rounding = self._evaluate()
                self._ask(residual)
            elif self._newton_method.active:  # in stages TAO asks
                self._ask(residual)
            end = self._end(residual, tolerance, stages)
            if end or (failures >= 3 and residual > 0.5 * best):
                reason = end or reason
                break
            best = min(best, residual)
            self._choose_method(stages, residual)
            # A Newton iteration takes one or two evaluations, a stage 5 to 30.
            stages += 1 / 8 if self._newton_method.active else 1
            self._residual0, self._tolerance = residual, tolerance
            if self._uses_h0 and self._h0_is_outdated:
                if not self._renew_h0(h0_prestress, factorizations, failures):
                    reason = endings.SINGULAR
                    break
                factorizations, renewed = factorizations + 1, iterations
            potential.x_vector.copy(self._x)
            potential.x_vector.copy(self._x0)
            if self._newton_method.active:
                iterations, newton_steps = iterations + 1, newton_steps + 1
                fallen = self._newton_method.step(self._x0, self._g0, self._energy0, *self._trial)
                failures = 0 if fallen else failures + 1
                continue
            self._h0_is_outdated = False
            ended = self._run(residual)
            iterations += self.tao.getIterationNumber()
            potential.place(self._x)
            reason = "too many stages" if ended >= 0 else REASONS.get(ended, f"TAO reason {ended}")
            self._h0_is_outdated |= ended < 0
            failures = failures + 1 if ended == SEARCH_FAILED else 0
        for stiffening in self._stiffenings():
            stiffening.set(0.0)
        worn = iterations - renewed > self._most_h0_iterations
        self._h0_is_outdated |= worn or reason not in ("converged", "interrupted")
        converged = reason in ("converged", "interrupted")
        if not converged and rounding > tolerance:
            reason += endings.DROWNED.format(rounding)
        return Outcome(
            converged,
            reason,
            residual,
            tolerance,
            iterations,
            potential.evaluations - start,
            factorizations,
            newton_steps,
            0 if relaxation is None else relaxation.steps - local,
            scale=max(self._scale, self.atol / self.rtol),
        )

    def _evaluate(self) -> tuple[float, float, float]:
        """Evaluate the potential; return the gradient's norm, its tolerance and rounding."""
        potential = self.potential
        self._energy0, self._scale = potential.evaluate_terms()
        potential.free_gradient(self._g0)
        rounding = potential.rounding()
        rtol = self.rtol if self._uses_h0 else max(ROUNDED, self.rtol)
        tolerance = max(rtol * self._scale, self.atol, rounding)
        tolerance = min(tolerance, max(ROUNDED, self.rtol) * self._scale + self.atol)
        if is_unstressed(self._scale, self._energy0, self.stiffness, self.size):
            tolerance = max(tolerance, self._scale)
        self._near = max(ROUNDED * self._scale, 100 * tolerance)
        return self.residual(), tolerance, rounding

    def _end(self, residual: float, tolerance: float, stages: float) -> str:
        """Reason why a solve ends at the evaluated state; "" if it continues."""
        if not np.isfinite([residual, self._energy0]).all():  # TAO would raise an error
            return REASONS[-4]
        if self._interrupted:
            return "interrupted"
        x = self.potential.x[: self.potential.unknowns.n_vertices]
        far = self.reach < math.inf and float(np.abs(x).max(initial=0.0)) > self.reach
        if self.potential.comm.allreduce(far, op=MPI.LOR):
            return endings.ENDLESS
        if residual <= tolerance:
            return "converged"
        return endings.STALLED if self._stalling.ends(stages, residual, self._energy0) else ""

    def _choose_method(self, stages: float, residual: float) -> None:
        """Switch from slow stages to Newton's method, or back."""
        newton = self._newton_method
        possible = self.newton and self._uses_h0 and self._bounds is None
        if newton.active:
            newton.check_progress(residual)
        elif possible and self._h0_is_outdated and stages >= self.strategy.patience:
            newton.take_over(residual, self._residual0, self._scale)
