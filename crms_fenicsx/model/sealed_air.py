"""Sealed air, whose pressure follows from its volume, and fans, which answer a load.

A quantity of gas at the absolute pressure P0 and the volume V0, heated to tau times its absolute
temperature and then brought to the volume V, has the absolute pressure

    P = tau P0 (V0 / V)^gamma.

The exponent gamma is 1 where it has time to take its surroundings' temperature (isothermal, Boyle),
and the ratio of specific heats, 1.4 for air, where it has not (adiabatic, Poisson), as in a gust.
With the atmosphere's pressure p_a outside, its potential is

    Pi = p_a V + tau P0 V0 / (gamma - 1) (V0 / V)^(gamma - 1),    isothermal:
    Pi = p_a V - tau P0 V0 ln(V / V0),

whose derivative by V is minus the pressure P - p_a on the membrane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import EPSILON
from crms_fenicsx.runtime.errors import InputError

LEAST = 0.02
"""Volume, relative to that at sealing, below which the pressure goes on as its tangent: no air is
pressed together that far, but steps of a minimiser may try to."""

SERIES = 0.1
"""Change of the volume, relative to it, up to which what the potential has of second order is
summed up in powers: as a difference it would drown in rounding."""


@dataclass(frozen=True)
class SealedAir:
    """A quantity of air under the cells that are under pressure.

    Attributes
    ----------
    volume
        Its volume at sealing (length cubed).
    gained
        `Scene.volume` at sealing (length cubed); what that is more later, the air has more.
    sealed_at
        Its pressure over that of the atmosphere, at sealing (force per area).
    absolute
        Its absolute pressure at sealing (force per area).
    exponent
        1 if isothermal, 1.4 for air if adiabatic.
    atmosphere
        Current pressure of the atmosphere (force per area).
    temperature
        Current absolute temperature, relative to that at sealing. If adiabatic that is what heat
        has made of it, before it changes with the volume.
    """

    volume: float
    gained: float
    sealed_at: float
    absolute: float
    exponent: float
    atmosphere: float
    temperature: float = 1.0

    def _change(self, gained: float) -> float:
        """Change of the volume, relative to that at sealing."""
        return (gained - self.gained) / self.volume

    def pressure(self, gained: float) -> float:
        """Pressure over that of the atmosphere (force per area), for a gained volume (length^3)."""
        v, hot = self._change(gained), self.temperature * self.absolute
        known = max(v, LEAST - 1.0)
        p = (hot - self.atmosphere) + hot * math.expm1(-self.exponent * math.log1p(known))
        return p - self.stiffness(gained) * self.volume * (v - known)

    def stiffness(self, gained: float) -> float:
        """Second derivative of the potential by the volume (force / length^5); positive."""
        known, hot = max(self._change(gained), LEAST - 1.0), self.temperature * self.absolute
        return self.exponent * hot * (1.0 + known) ** (-self.exponent - 1.0) / self.volume

    def energy(self, gained: float) -> float:
        """Potential (force x length); that of the pressure before, at sealing."""
        v, hot = self._change(gained), self.temperature * self.absolute
        known = max(v, LEAST - 1.0)
        energy = hot * _second_order(known, self.exponent) - (hot - self.atmosphere) * known
        edge = self.gained + known * self.volume
        beyond = (v - known) * self.volume
        energy = energy * self.volume - self.pressure(edge) * beyond
        return energy + self.stiffness(edge) * beyond**2 / 2 - self.sealed_at * self.gained


def _second_order(v: float, exponent: float) -> float:
    """``v`` minus the integral of ``(1 + s)^-exponent`` over s from 0 to v."""
    if abs(v) > SERIES:
        if exponent == 1.0:
            return v - math.log1p(v)
        return v + math.expm1((1.0 - exponent) * math.log1p(v)) / (exponent - 1.0)
    total, power, k = 0.0, exponent * v * v, 1
    while abs(power) > EPSILON * abs(total):
        total += power / (k + 1)
        k += 1
        power *= -(exponent + k - 1) / k * v
    return total


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
        checks.text("FanControl: load", self.load)
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
