"""Sealed air, whose pressure follows from its volume, and fan control by a load factor.

Gas sealed at the absolute pressure P0 and the volume V0, heated to tau times its absolute
temperature and then brought to the volume V, has the absolute pressure

    P = tau P0 (V0 / V)^gamma.

The exponent gamma is 1 if the gas has time to take the temperature of its surroundings (isothermal,
Boyle), and the ratio of specific heats, 1.4 for air, if not (adiabatic, Poisson), as in a gust.
With the atmospheric pressure p_a outside, its potential is

    Pi = p_a V + tau P0 V0 / (gamma - 1) (V0 / V)^(gamma - 1),    isothermal:
    Pi = p_a V - tau P0 V0 ln(V / V0),

whose derivative by V is minus the gauge pressure P - p_a on the membrane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Name, checked
from crms_fenicsx.foundation.runtime.arrays import EPSILON
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.strengths import fits

LEAST = 0.02
"""Volume, relative to that at sealing, below which the pressure is extrapolated linearly: trial
steps of a minimiser may go there, equilibria do not."""

SERIES = 0.1
"""Relative volume change up to which the second-order part of the potential is summed as a power
series: as a difference it would be lost in rounding."""


@dataclass(frozen=True)
class SealedAir:
    """A sealed quantity of air under the pressurised cells.

    Attributes
    ----------
    volume
        Volume at sealing (length cubed).
    gained
        `Scene.volume` at sealing (length cubed); any later increase is one of the air's volume.
    sealed_at
        Gauge pressure at sealing (force per area).
    absolute
        Absolute pressure at sealing (force per area).
    exponent
        1 if isothermal, 1.4 for air if adiabatic.
    atmosphere
        Current atmospheric pressure (force per area).
    temperature
        Current absolute temperature, relative to that at sealing; if adiabatic, the effect of heat
        alone, without that of the volume change.
    """

    volume: float
    gained: float
    sealed_at: float
    absolute: float
    exponent: float
    atmosphere: float
    temperature: float = 1.0

    def _change(self, gained: float) -> float:
        """Volume change relative to the volume at sealing."""
        return (gained - self.gained) / self.volume

    def pressure(self, gained: float) -> float:
        """Gauge pressure (force per area) at a gained volume (length cubed)."""
        v, hot = self._change(gained), self.temperature * self.absolute
        known = max(v, LEAST - 1.0)
        p = (hot - self.atmosphere) + hot * math.expm1(-self.exponent * math.log1p(known))
        return p - self.stiffness(gained) * self.volume * (v - known)

    def stiffness(self, gained: float) -> float:
        """Second derivative of the potential by the volume (force / length^5); positive."""
        known, hot = max(self._change(gained), LEAST - 1.0), self.temperature * self.absolute
        return self.exponent * hot * (1.0 + known) ** (-self.exponent - 1.0) / self.volume

    def energy(self, gained: float) -> float:
        """Potential (force x length), at sealing equal to that of the constant pressure before."""
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


@checked
@dataclass(frozen=True)
class FanControl:
    """Inner pressure as a function of a load factor, as set by the fans of an air hall.

    The pressure is interpolated between the given factors, and constant beyond them. Where several
    are given in a list, the highest pressure counts.

    Parameters
    ----------
    load
        Name of the load, or the kind that names begin with: "wind" means "wind x" and "wind y",
        too, of which the highest pressure counts.
    factors
        Load factors, increasing.
    pressures
        Pressure at each factor (force per area).

    Raises
    ------
    InputError
        If the load is not a string, numbers are not finite, factors do not increase, or there are
        not as many pressures.

    Examples
    --------
    >>> fans = FanControl("wind", factors=[0.0, 0.5, 1.0], pressures=[0.25, 0.35, 0.5])
    >>> solver.advance(load={"wind": 1.5}, pressure=fans, steps=6)
    >>> both = [fans, FanControl("snow", factors=[0.0, 0.2], pressures=[0.25, 0.6])]
    >>> FanControl.highest(both, {"snow": 0.1, "wind x": 0.5})
    0.425
    """

    load: Name
    factors: Sequence[float]
    pressures: Sequence[float]

    def __post_init__(self) -> None:
        for name in ("factors", "pressures"):
            given = getattr(self, name)
            if isinstance(given, str) or np.ndim(given) != 1 or not len(given):
                raise InputError(f"FanControl: {name} = {given!r}; pass a list of numbers.")
            values = tuple(checks.finite(f"FanControl: one of {name}", value) for value in given)
            object.__setattr__(self, name, values)
        if len(self.factors) != len(self.pressures):
            raise InputError(
                f"FanControl: {len(self.factors)} factors and {len(self.pressures)} pressures; "
                "pass a pressure for each factor."
            )
        if not all(a < b for a, b in zip(self.factors, self.factors[1:], strict=False)):
            raise InputError(
                f"FanControl: factors = {list(self.factors)} must increase; sort them."
            )

    def pressure(self, factor: float) -> float:
        """Pressure (force per area) at a load factor."""
        return float(np.interp(factor, self.factors, self.pressures))

    @staticmethod
    def highest(controls: Sequence[FanControl], factors: Mapping[str, float]) -> float:
        """Highest pressure (force per area) of some controls at load factors by name.

        Raises
        ------
        InputError
            No load that a control follows.
        """
        found: list[float] = []
        for one in controls:
            own = [factor for load, factor in factors.items() if fits(load, one.load)]
            if not own:
                checks.named("load", factors, one.load)
            found += map(one.pressure, own)
        return max(found)
