"""What a load step has found."""

from __future__ import annotations

from dataclasses import dataclass, field

from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.model.state_warning import StateWarning
from crms_fenicsx.runtime.text import counted
from crms_fenicsx.verification.report import Verification


@dataclass(frozen=True, repr=False)
class Step:
    """An accepted load step.

    Attributes
    ----------
    number
        Counted from 1 over the solver's life.
    outcome
        What the solve took; failed attempts of the step are included.
    energies
        Energy of each kind of term (force x length).
    seconds
        Wall time.
    halvings
        How often the increment had to be halved.
    verification
        What checks of the state say that do without the solver; None if it was told not to make
        any. It is not saved with a run.
    warnings
        What was warned of in this step: a snap-through and between which loads it was, an
        equilibrium that is not stable, ends of cables under the membrane.
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
        """In a line."""
        words = [f"energy {self.energy:.6g}", counted(self.outcome.iterations, "iteration")]
        words += [f"{self.seconds:.2g} s"]
        words += [counted(self.halvings, "halving")] if self.halvings else []
        if self.verification is not None:
            words.append(self.verification.verdict)
        else:
            words += dict.fromkeys(one.kind for one in self.warnings)
        return f"Step({self.number}: {', '.join(words)})"
