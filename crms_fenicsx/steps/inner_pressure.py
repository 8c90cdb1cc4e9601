"""The inner pressure on the way of a call to `Solver.advance`: given, by fans, or of sealed air."""

from __future__ import annotations

from dataclasses import dataclass, replace

from crms_fenicsx.model.fan_control import FanControl
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import EPSILON
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene


def between(first: float, last: float, share: float) -> float:
    """A load at a share of the way; none where only rounding is left of it.

    A scene without load is another one than one with the least: nothing may be in equilibrium.
    """
    value = first + share * (last - first)
    rounding = 4 * EPSILON * max(abs(first), abs(last))
    return 0.0 if abs(value) <= rounding else value


@dataclass(frozen=True)
class InnerPressure:
    """The inner pressure's way."""

    # first, last: pressure at its ends (force per area); with fans what is on top of theirs
    first: float
    last: float
    fans: FanControl | None = None  # their control, if there is one
    air: tuple[SealedAir, SealedAir] | None = None  # sealed air at the way's ends, if there is any

    @property
    def acts(self) -> bool:
        """Whether there is any at the way's end."""
        return self.last != 0.0 or self.fans is not None or self.air is not None

    def apply(self, scene: Scene, share: float) -> None:
        """Set the pressure at a share of the way; the loads on the membrane are set. Collective."""
        if self.air is not None:
            first, last = self.air
            scene._air = replace(
                last,
                temperature=between(first.temperature, last.temperature, share),
                atmosphere=between(first.atmosphere, last.atmosphere, share),
            )
            scene._pressure = scene._air.pressure(scene.volume)
        elif self.fans is not None:
            factor = scene.factors[self.fans.load]
            rest = between(self.first, self.last, share)
            scene._pressure = self.fans.pressure(factor) + rest
        else:
            scene._pressure = between(self.first, self.last, share)


def checked_pressure(
    scene: Scene,
    pressure: float | FanControl | None,
    temperature: float | None,
    atmosphere: float | None,
) -> InnerPressure:
    """Check the inner pressure that a call to `Solver.advance` asks for; see there."""
    air, given = scene.air, {"temperature": temperature, "atmosphere": atmosphere}
    for name, value in given.items():
        if value is not None and air is None:
            raise InputError(
                f"advance: {name} = {value!r}, but the air is not sealed; call "
                "scene.seal(volume=...) first, or give the pressure."
            )
    if air is not None:
        if pressure is not None:
            raise InputError(
                f"advance: pressure = {pressure!r}, but the air is sealed, and its pressure "
                "follows from its volume; call scene.unseal() first."
            )
        changed = {
            name: checks.positive(f"advance: {name}", value)
            for name, value in given.items()
            if value is not None
        }
        return InnerPressure(scene.pressure, scene.pressure, air=(air, replace(air, **changed)))
    if isinstance(pressure, FanControl):
        factor = checks.named("load", scene.factors, pressure.load)
        offset = scene.pressure - pressure.pressure(factor)
        return InnerPressure(offset, 0.0, fans=pressure)
    last = scene.pressure if pressure is None else checks.finite("advance: pressure", pressure)
    return InnerPressure(scene.pressure, last)
