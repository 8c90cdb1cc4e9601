"""A load step, with its warnings and errors."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.checks import counted
from crms_fenicsx.foundation.runtime.errors import (
    ConvergenceError,
    DoubtWarning,
    FrictionWarning,
    InstabilityWarning,
    PathWarning,
    PondWarning,
    SnapThroughWarning,
)
from crms_fenicsx.model.laid_cable import CableEnd
from crms_fenicsx.model.membrane_load import Pond
from crms_fenicsx.model.versions import StateWarning


@dataclass(frozen=True, repr=False)
class Step:
    """An accepted load step.

    Attributes
    ----------
    number
        Counted from 1 over the solver's lifetime.
    outcome
        Statistics of the solve, including failed attempts.
    energies
        Energy by kind of term (force x length).
    seconds
        Wall time.
    halvings
        How often the increment was halved.
    verification
        Independent checks of the state; None if verification is off. Checkpoints have that of the
        last step only.
    warnings
        Warnings of the step: snap-through with its load interval, unstable equilibrium, cable
        ends under the membrane, ranges of uncertain forces.

    Examples
    --------
    >>> step = solver.advance(pressure=1.2)
    >>> step.verification.verdict
    'verified'
    """

    number: int
    outcome: Outcome
    energies: dict[str, float]
    seconds: float
    halvings: int
    verification: Verification | None = field(default=None, compare=False)
    warnings: tuple[StateWarning, ...] = ()

    @property
    def energy(self) -> float:
        """Total potential energy (force x length)."""
        return sum(self.energies.values())

    def __repr__(self) -> str:
        """One line."""
        words = [f"energy {self.energy:.6g}", counted(self.outcome.iterations, "iteration")]
        words += [f"{self.seconds:.2g} s"]
        words += [counted(self.halvings, "halving")] if self.halvings else []
        if self.verification is not None:
            words.append(self.verification.verdict)
        else:
            words += dict.fromkeys(one.kind for one in self.warnings)
        return f"Step({self.number}: {', '.join(words)})"


CALLER = 6
"""Stack level, from `_warn`, of the caller of `Solver.advance`."""

CATEGORIES: dict[str, type[UserWarning]] = {
    "snap-through": SnapThroughWarning,
    "instability": InstabilityWarning,
    "pond": PondWarning,
    "cable end": PathWarning,
    "doubtful": DoubtWarning,
}


def _warn(number: int, text: str, category: type[UserWarning]) -> None:
    warnings.warn(f"step {number}: {text}", category, stacklevel=CALLER)


def warn_of_staying(scene: Scene, ends: Sequence[CableEnd]) -> None:
    """Warn of cable ends that stay where an edge moves under them."""
    if ends and scene.comm.rank == 0:
        names = ", ".join(f"the {end.which} of {end.cable.name!r}" for end in ends)
        stay = "stays in space while its edge moves"
        if len(ends) > 1:
            stay = "stay in space while their edges move"
        text = f"advance: {names} {stay}; pass a movement of the cable, too, or (0, 0, 0)."
        warnings.warn(text, PathWarning, stacklevel=CALLER - 2)


def warn_of_friction(number: int, scene: Scene, before: SceneState, unsettled: float) -> None:
    """Warn of friction forces that have not settled, and of friction elements that hold a cable."""
    if scene.comm.rank > 0:
        return
    if unsettled > 0.0:
        text = "friction forces did not converge and are accurate only to"
        remedy = "of their sum; another mesh may help."
        _warn(number, f"{text} {unsettled:.1%} {remedy}", FrictionWarning)
    for cable, was in before.net.cables.items():
        held, before_it = (
            one.law.lateral.held if one.law.taut and one.law.lateral is not None else 0
            for one in (cable.state, was)
        )
        if held > 0 == before_it:
            text = (
                f"the friction elements of {cable.name!r} hold it at {counted(held, 'point')}, "
                "where a force mu N of neither sense lets it slide against that force. There the "
                "force is smaller, although the paper's element has no sticking."
            )
            _warn(number, text, FrictionWarning)


def warn_of_blocked(number: int, scene: Scene) -> None:
    """Warn of cables stopped by vertices that they must not pass."""
    for cable in scene.cables:
        blocked = cable.blocked
        if blocked and scene.comm.rank == 0:
            text = (
                f"{cable.name!r} has run into {len(blocked)} mesh vertices, the first at "
                f"{cable.state.positions[blocked[0]]}; it cannot slide on into other cells; the "
                "result is that of a cable blocked there."
            )
            _warn(number, text, PathWarning)


def warn_of_state(number: int, scene: Scene, found: Sequence[StateWarning]) -> None:
    """Issue the warnings of a step's state."""
    for one in found:
        if scene.comm.rank == 0:
            _warn(number, one.text, CATEGORIES[one.kind])


def _names(ponds: Sequence[Pond]) -> str:
    return ", ".join(repr(pond.name) for pond in ponds)


def no_equilibrium(
    number: int, outcome: Outcome, max_halvings: int, done: float, failed: Sequence[Pond],
    ponds: Sequence[Pond],
) -> ConvergenceError:  # fmt: skip
    """Error of a step whose last attempt has failed."""
    water = "" if not ponds else (
        f" Under {_names(ponds)} there may be no equilibrium, as water gathers without end; "
        "use more prestress or slope, or a given volume. Water that reaches a free edge has no "
        "equilibrium; hold that edge, or name all parts under water."
    )  # fmt: skip
    rising = [
        f"{pond.name!r} between {now.factor:.5g} and {pond.factor:.5g}"
        for pond, now in zip(failed, ponds, strict=True)
        if pond.factor > now.factor
    ]
    if rising:
        water = f" Limits of load factors: {', '.join(rising)}.{water}"
    return ConvergenceError(
        f"step {number}: no equilibrium found, {outcome.reason}: unbalanced force "
        f"{outcome.residual:.3g}, tolerance {outcome.tolerance:.3g}, with the increment halved "
        f"{max_halvings} times; {done:.2%} of the loads are applied, and the scene is in "
        "that state. Inspect it, and check that the cables can carry tension where they lie. "
        "Another mesh helps most often, unstructured or of a slightly different cell size, and "
        f"sometimes more prestress; more steps seldom help.{water}"
    )
