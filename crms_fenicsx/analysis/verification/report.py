"""Result of a verification."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.model.versions import StateWarning

ROUNDED = 1e-12
"""Relative rounding of a length, or of the distance from the origin: the largest distance of points
from places that are set, not solved for."""

UNBALANCED = 1e-3
"""Unbalanced forces of one part of a scene, relative to that part's own, beyond which a state is
doubtful: the solver stops by the scene's largest forces, and a part's may be small beside them."""


@dataclass(frozen=True)
class Check:
    """One check of an equilibrium."""

    name: str  # what is checked
    value: float  # error, without a unit
    limit: float  # largest admissible error
    where: str = ""  # worst cable, bar or joint; empty if it concerns the scene
    # whether a failure rejects the state; checks that depend on the mesh size, as contact at single
    # points does, or on forces that are small beside the scene's, only make it doubtful
    binding: bool = True

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit; NaN is not."""
        return bool(self.value <= self.limit)

    def __str__(self) -> str:
        of = f" of {self.where!r}" if self.where else ""
        sign = "<=" if self.passed else "and not <="
        return f"{self.name}{of} {self.value:.2g} {sign} {self.limit:.2g}"


@dataclass(frozen=True, repr=False)
class Verification:
    """Result of a load step's checks.

    Attributes
    ----------
    checks
        All checks.
    seconds
        Wall time of the checks.
    warnings
        Warnings about a state that is an equilibrium.
    """

    checks: tuple[Check, ...]
    seconds: float
    warnings: tuple[StateWarning, ...] = ()

    @property
    def verdict(self) -> str:
        """The result in a few words."""
        if self.failed:
            return "not verified"
        kinds = dict.fromkeys(one.kind for one in self.warnings)
        return f"equilibrium, but {', '.join(kinds)}" if kinds else "verified"

    @property
    def failed(self) -> tuple[Check, ...]:
        """Failed checks that reject the state."""
        return tuple(check for check in self.checks if check.binding and not check.passed)

    @property
    def doubtful(self) -> tuple[Check, ...]:
        """Failed checks that only make the state doubtful."""
        return tuple(check for check in self.checks if not check.binding and not check.passed)

    @property
    def passed(self) -> bool:
        """Whether no check rejects the state."""
        return not self.failed

    def __getitem__(self, name: str) -> Check:
        """The check of that name."""
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def __repr__(self) -> str:
        """A table of all checks, or one line with those that failed."""
        if self.failed:
            return f"{self.verdict}: " + "; ".join(map(str, self.failed))
        rows = [
            f"  {check.name:<32}{check.value:9.2g} {'<=' if check.passed else '> '} {check.limit:g}"
            + (f"  ({check.where})" if check.where else "")
            for check in self.checks
        ]
        return "\n".join([self.verdict, *map(str, self.warnings), *rows])
