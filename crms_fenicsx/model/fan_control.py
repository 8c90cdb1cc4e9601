"""Fans that answer a load with another inner pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError


@dataclass(frozen=True)
class FanControl:
    """Inner pressure by the factor of a load, as fans of an air hall are set for wind or snow.

    Between the factors given the pressure is interpolated, beyond them it is that of the last one.

    Parameters
    ----------
    load
        Name of the load.
    factors
        Factors of it, rising.
    pressures
        Pressure at each (force per area).

    Raises
    ------
    InputError
        A load that is no text, numbers that are not finite, factors that do not rise, or not as
        many pressures.

    Examples
    --------
    >>> fans = FanControl("wind", factors=[0.0, 0.5, 1.0], pressures=[0.25, 0.35, 0.5])
    >>> solver.advance(load={"wind": 1.5}, pressure=fans, steps=6)
    """

    load: str
    factors: Sequence[float]
    pressures: Sequence[float]

    def __post_init__(self) -> None:
        if not isinstance(self.load, str) or not self.load:
            raise InputError(f"FanControl: load = {self.load!r} is no text; name a load.")
        for name in ("factors", "pressures"):
            given = getattr(self, name)
            if isinstance(given, str) or np.ndim(given) != 1 or not len(given):
                raise InputError(f"FanControl: {name} = {given!r}; give a list of numbers.")
            values = tuple(checks.finite(f"FanControl: one of {name}", value) for value in given)
            object.__setattr__(self, name, values)
        if len(self.factors) != len(self.pressures):
            raise InputError(
                f"FanControl: {len(self.factors)} factors and {len(self.pressures)} pressures; "
                "give a pressure for each factor."
            )
        if not all(a < b for a, b in zip(self.factors, self.factors[1:], strict=False)):
            raise InputError(
                f"FanControl: factors = {list(self.factors)} do not rise; sort them, each once."
            )

    def pressure(self, factor: float) -> float:
        """Pressure (force per area) at a factor of the load."""
        return float(np.interp(factor, self.factors, self.pressures))
