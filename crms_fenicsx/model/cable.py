"""Properties of a cable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.friction import Friction


@dataclass(frozen=True)
class Cable:
    """A linearly elastic cable (section 2.2).

    Parameters
    ----------
    EA
        Axial stiffness (force).
    law
        "total": tension ``EA (L - L0)/L0`` where positive, with the unstressed length L0. "step":
        the paper's (2.2-2), a tension that grows by ``EA/l_n`` times the elongation in the step,
        with the length l_n at the step's start.
    friction
        Friction on the membrane: a coefficient, or a `Friction` with more data. The default 0 costs
        nothing.
    """

    EA: float
    law: Literal["total", "step"] = "total"
    friction: float | Friction = 0.0

    def __post_init__(self) -> None:
        checks.positive("Cable: EA", self.EA)
        if not isinstance(self.friction, Friction):
            Friction(checks.finite("Cable: friction", self.friction))
        checks.one_of("Cable: law", self.law, ("total", "step"))
        if self.law == "step" and self.along:
            raise InputError(
                f'Cable: law = "step" has one tension for the whole cable, but its friction has '
                f'along = {self.along}; use law="total", or leave it out.'
            )

    @property
    def sideways(self) -> Friction | None:
        """Friction against sideways sliding; None if it slides freely."""
        friction = self.friction
        if not isinstance(friction, Friction):
            return Friction(friction) if friction > 0 else None
        return friction if friction.at_rest > 0 else None

    @property
    def along(self) -> float:
        """Coefficient of friction along the cable's axis."""
        return self.friction.along if isinstance(self.friction, Friction) else 0.0

    @property
    def cone(self) -> bool:
        """Whether one limit couples friction sideways and along the axis."""
        return isinstance(self.friction, Friction) and self.friction.cone
