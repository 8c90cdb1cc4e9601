"""Outcome of a minimisation, and when one that makes no progress is given up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from crms_fenicsx.energy.minimization.strategy import Strategy
from crms_fenicsx.foundation.runtime.checks import counted

SEARCH_FAILED, OUT_OF_RANGE = -6, 63
"""TAO's reason and PETSc's error code for a failed line search."""

REASONS = {
    -2: "too many iterations",
    -4: "energy or gradient not finite",
    -5: "too many evaluations",
    SEARCH_FAILED: "line search failed",
    -7: "trust region failed",
    -8: "stopped by the user",
}

ENDLESS = "the membrane moves without end"
"""Reason for giving up when vertices have moved too far."""

STALLED = "neither residual nor energy falls"
"""Reason for giving up before `max_stages`."""

SINGULAR = "the stiffness is singular to rounding"
"""Reason for giving up when H0 cannot be factorised."""

DROWNED = (
    ", where forces cancel to their rounding ({:.2g}): a tension, a penalty or a stiffness is too "
    "large for the loads"
)


WORK = ("iterations", "evaluations", "factorizations", "newton_steps", "local_steps", "solves",
        "flips", "passes")  # fmt: skip
"""Counts of an `Outcome`, which add up over several minimisations."""


@dataclass(frozen=True, repr=False)
class Outcome:
    """Result of a minimisation."""

    converged: bool  # whether the gradient's norm fell below `tolerance`
    reason: str  # reason for its end, in words
    residual: float  # residual, tolerance: norm of the gradient and its limit (force)
    tolerance: float
    # iterations, evaluations, factorizations: of BLMVM and Newton's method; evaluations of energy
    # and gradient, factorisations of H0
    iterations: int
    evaluations: int
    factorizations: int
    newton_steps: int = 0  # iterations of Newton's method
    local_steps: int = 0  # Newton steps of patches of cable points and vertices
    # minimisations: several where cables turned slack or taut, lifted off or slid
    solves: int = 1
    # mesh vertices that cables passed sideways between minimisations, including those on rejected
    # paths, excluding the straightening of paths before the first
    flips: int = 0
    # updates of the friction forces; 0 without friction
    passes: int = 0
    # last relative change of the friction forces, if they cycled and were left unconverged
    unsettled: float = 0.0
    # force scale of the scene, to which the tolerance is relative unless rounding is larger
    scale: float = 0.0
    # whether the energy was not convex on the way of a minimisation: possible snap-through
    nonconvex: bool = False
    # whether two states took turns as the pressure turned with them, which smaller increments of
    # the loads seldom end
    takes_turns: bool = False

    def __repr__(self) -> str:
        """One line."""
        return (
            f"Outcome({self.reason}, residual {self.residual:.2g} for {self.tolerance:.2g}, "
            f"{counted(self.iterations, 'iteration')}, {counted(self.evaluations, 'evaluation')}, "
            f"{counted(self.factorizations, 'factorisation')})"
        )

    def __add__(self, other: Outcome) -> Outcome:
        """Outcome `other` with the work of both."""
        work = {name: getattr(self, name) + getattr(other, name) for name in WORK}
        nonconvex = self.nonconvex or other.nonconvex
        return replace(other, nonconvex=nonconvex, takes_turns=False, **work)


class Stalling:
    """Notes when a solve has last halved its least residual or lowered its energy."""

    def __init__(self, strategy: Strategy) -> None:
        self._strategy = strategy
        self._residual, self._energy, self._stage = math.inf, math.inf, 0.0

    def ends(self, stage: float, residual: float, energy: float) -> bool:
        """Whether the solve has made no progress for long, now at this stage. Units: residual
        (force), energy (force x length)."""
        halved = residual < 0.5 * self._residual
        if halved or energy < self._energy - self._strategy.least_fall * abs(energy):
            self._residual = min(self._residual, residual)
            self._energy, self._stage = energy, stage
        return stage - self._stage > self._strategy.stall


NO_STRAIN = 1e-8
"""Strain below which a cable, a bar or the membrane counts as unstressed: the solver's tolerance is
as coarse."""


def is_unstressed(forces: float, energy: float, stiffness: float, size: float) -> bool:
    """Whether forces and energy are at most those of a strain of `NO_STRAIN`.

    Where nothing loads a slack membrane all forces fade together, so that none becomes small beside
    the others. Forces alone can also cancel in a stressed state, and the energy of prestress is
    zero where the membrane is laid: both count.

    Parameters
    ----------
    forces, energy
        Scale of the forces (force) before they cancel, and potential energy (force x length).
    stiffness, size
        Force at a strain of 1, 0 where loads set the scale, and size (length) of the structure.
    """
    tiny = NO_STRAIN * stiffness
    return forces <= tiny and energy <= 0.5 * NO_STRAIN * tiny * size
