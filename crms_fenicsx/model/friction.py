"""What a cable's friction on the membrane is: coefficients and law (chapter 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError

MOST_TOLERANCE = 0.1
"""Slip tolerances above this (parts of a cell) are no friction any more."""


@dataclass(frozen=True)
class Friction:
    """Dry friction between a cable and the membrane.

    Parameters
    ----------
    mu
        Coefficient of friction against sliding sideways, of a cable that slides (kinetic). 0: it
        slides sideways freely.
    static
        Coefficient for a cable that is at rest, `mu` or more; None: as `mu`.
    along
        Coefficient against sliding along the cable's axis; with one the tension varies along the
        cable, between two nodes by ``exp(along * angle)`` at most (`LaidCable.tensions`). The angle
        is the turn around the membrane; in the pocket of a free edge, which pulls in the surface as
        well, the whole turn. An unstressed length that changes is taken in or let out at the
        cable's last end. 0: the cable slides along itself freely, assumption 6 of the paper.
    cone
        How the limits sideways, ``mu N``, and along, ``along N``, of a contact force N go together.
        False: each on its own, a box; the force of a cable that slides obliquely is too large by
        up to 1.41. True: an ellipse, with `along` equal to `mu` Coulomb's cone, and a cable slides
        in the direction that dissipates most. It takes more passes.
    law
        "coulomb": stick and slip. "step": the paper's friction element (section 3.3), whose force
        keeps its direction and size in a load step (assumption 7), so that nothing can stick: a
        cable that should stay is pushed back.
    tolerance
        Elastic slip at which the friction force is fully mobilised: the width that the jump of the
        friction force is smoothed to. Sideways it is relative to the size of the cells, along the
        cable to what the friction force of a node stretches the cable by in a cell.

    Raises
    ------
    InputError
        A coefficient that is negative, `static` below `mu`, an unknown law, `cone` without `mu`
        and `along`, with a static coefficient or with the law "step", or a tolerance that is not
        between 0 and 0.1.
    """

    mu: float
    static: float | None = None
    along: float = 0.0
    law: Literal["coulomb", "step"] = "coulomb"
    tolerance: float = 3e-3
    cone: bool = False

    def __post_init__(self) -> None:
        for name in ("mu", "along"):
            if checks.finite(f"Friction: {name}", getattr(self, name)) < 0:
                raise InputError(
                    f"Friction: {name} = {getattr(self, name)} is negative; give 0 or more."
                )
        if self.static is not None and checks.finite("Friction: static", self.static) < self.mu:
            raise InputError(
                f"Friction: static = {self.static} is smaller than mu = {self.mu}, the coefficient "
                "of a cable that slides; give at least that."
            )
        if self.law not in ("coulomb", "step"):
            raise InputError(f"Friction: law = {self.law!r} is not known; use 'coulomb' or 'step'.")
        if self.law == "step" and (self.static not in (None, self.mu) or self.along):
            raise InputError(
                'Friction: law = "step" knows neither a static coefficient nor friction along the '
                f"cable, but static = {self.static}, along = {self.along}; leave them out, or use "
                '"coulomb".'
            )
        if self.cone and (self.law == "step" or min(self.mu, self.along) == 0):
            raise InputError(
                f"Friction: cone = True couples the friction forces sideways and along the cable, "
                f'but mu = {self.mu}, along = {self.along}, law = "{self.law}"; give both '
                'coefficients with the law "coulomb", or leave cone out.'
            )
        if self.cone and self.static not in (None, self.mu):
            raise InputError(
                f"Friction: cone = True knows no static coefficient, but static = {self.static}; "
                "leave one of them out."
            )
        tolerance = checks.positive("Friction: tolerance", self.tolerance)
        if tolerance > MOST_TOLERANCE:
            raise InputError(
                f"Friction: tolerance = {tolerance} is a slip of more than {MOST_TOLERANCE} of a "
                "cell, which is no sticking; give about 0.003."
            )

    @property
    def at_rest(self) -> float:
        """Coefficient for a cable that is at rest."""
        return self.mu if self.static is None else self.static

    @property
    def any(self) -> bool:
        """Whether there is friction at all."""
        return self.at_rest > 0 or self.along > 0
