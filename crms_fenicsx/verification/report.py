"""What a verification has found."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.model.versions import StateWarning

NO_STRAIN = 1e-8
"""Strain of a cable or a bar that is none: the solver may stop at forces as small."""

ROUNDED = 1e-12
"""Part of a length, or of the distance from the origin, that is rounding."""

UNBALANCED = 1e-3
"""Unbalanced forces of one part of a scene, relative to that part's own, from which on a state is
doubtful: the solver stops by the largest forces of all, beside which a part's may be small."""


@dataclass(frozen=True)
class Check:
    """One thing that is true of an equilibrium."""

    name: str  # what is checked
    value: float  # how far it is from true, without a unit
    limit: float  # how far it may be
    where: str = ""  # the cable, bar or joint for which it is worst; empty if it concerns the scene
    # whether a state that fails is no result. What depends on how coarse the mesh is, as the
    # contact of single points, or on forces that are small beside the scene's, only makes it
    # doubtful.
    binding: bool = True

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit; not a number is not."""
        return bool(self.value <= self.limit)

    def __str__(self) -> str:
        of = f" of {self.where!r}" if self.where else ""
        sign = "<=" if self.passed else "and not <="
        return f"{self.name}{of} {self.value:.2g} {sign} {self.limit:.2g}"


@dataclass(frozen=True, repr=False)
class Verification:
    """What came of the checks of a load step."""

    checks: tuple[Check, ...]  # all of them
    seconds: float  # wall time that they took
    # what the state's user is warned of, though it is an equilibrium
    warnings: tuple[StateWarning, ...] = ()

    @property
    def verdict(self) -> str:
        """In a few words."""
        if self.failed:
            return "not verified"
        kinds = dict.fromkeys(one.kind for one in self.warnings)
        return f"equilibrium, but {', '.join(kinds)}" if kinds else "verified"

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that say that the state is no equilibrium."""
        return tuple(check for check in self.checks if check.binding and not check.passed)

    @property
    def doubtful(self) -> tuple[Check, ...]:
        """The checks that say that the state is crude in what they look at."""
        return tuple(check for check in self.checks if not check.binding and not check.passed)

    @property
    def passed(self) -> bool:
        """Whether all is as it must be."""
        return not self.failed

    def __getitem__(self, name: str) -> Check:
        """The check with a name."""
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def __repr__(self) -> str:
        """A table of all checks, or in one line those that have failed."""
        if self.failed:
            return f"{self.verdict}: " + "; ".join(map(str, self.failed))
        rows = [
            f"  {check.name:<32}{check.value:9.2g} {'<=' if check.passed else '> '} {check.limit:g}"
            + (f"  ({check.where})" if check.where else "")
            for check in self.checks
        ]
        return "\n".join([self.verdict, *map(str, self.warnings), *rows])
