"""What came of a minimisation."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.runtime.checks import counted

SEARCH_FAILED, OUT_OF_RANGE = -6, 63
"""TAO's reason, and PETSc's error code, for a line search that has led nowhere."""

REASONS = {
    -2: "too many iterations",
    -4: "energy or gradient not finite",
    -5: "too many evaluations",
    SEARCH_FAILED: "line search failed",
    -7: "trust region failed",
    -8: "stopped by the user",
}

ENDLESS = "the membrane moves without end"
"""Why a minimisation is given up that has gone too far."""

DROWNED = (
    ", where forces cancel to their rounding ({:.2g}): a tension, a penalty or a stiffness is too "
    "large for the loads"
)


@dataclass(frozen=True, repr=False)
class Outcome:
    """What a minimisation came to."""

    converged: bool  # whether the gradient's norm fell below `tolerance`
    reason: str  # in words, why it ended
    residual: float  # residual, tolerance: norm of the gradient and what was asked for (force)
    tolerance: float
    # iterations, evaluations, factorizations: quasi-Newton iterations, evaluations of energy and
    # gradient, factorisations of H0
    iterations: int
    evaluations: int
    factorizations: int
    local_steps: int = 0  # Newton steps of clusters of cable points and vertices alone
    # minimisations: more than one where cables turned slack or taut, lifted off or slid
    solves: int = 1
    # mesh vertices over which cables slid sideways between minimisations, those of rejected paths
    # included; not those over which paths were pulled straight before the first
    flips: int = 0
    # how often friction forces were taken from the state that they led to; 0 without friction
    passes: int = 0
    # what the friction forces still change by, relative to their sum, where they went round in
    # circles and were left at that
    unsettled: float = 0.0
    # the scene's own force, to which the tolerance is relative unless rounding is larger
    scale: float = 0.0
    # whether the energy was found not to be convex on the way of a minimisation: something may have
    # snapped through
    bent: bool = False

    def __repr__(self) -> str:
        """In a line."""
        return (
            f"Outcome({self.reason}, residual {self.residual:.2g} for {self.tolerance:.2g}, "
            f"{counted(self.iterations, 'iteration')}, {counted(self.evaluations, 'evaluation')}, "
            f"{counted(self.factorizations, 'factorisation')})"
        )

    def __add__(self, other: Outcome) -> Outcome:
        """The outcome of `other`, after the work of both."""
        return Outcome(
            other.converged,
            other.reason,
            other.residual,
            other.tolerance,
            self.iterations + other.iterations,
            self.evaluations + other.evaluations,
            self.factorizations + other.factorizations,
            self.local_steps + other.local_steps,
            self.solves + other.solves,
            self.flips + other.flips,
            self.passes + other.passes,
            other.unsettled,
            other.scale,
            self.bent or other.bent,
        )
