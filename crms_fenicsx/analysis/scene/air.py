"""The air under the membrane of a scene: of given pressure, or sealed."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.deformed_surface import gained_volume
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, collective
from crms_fenicsx.foundation.runtime.handle import Stateful
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.versions import Versions, changes_model


@dataclass(frozen=True)
class AirState:
    """State of the air."""

    pressure: float = 0.0  # current pressure (force per area)
    sealed: SealedAir | None = None  # None if the pressure is given


class Air(Stateful[AirState]):
    """The air under the membrane: ``scene.sealed``."""

    def __init__(self, net: CableNet, versions: Versions, law: str) -> None:
        self.membrane, self.comm, self.versions = net.membrane, net.membrane.comm, versions
        self._net, self._law = net, law
        self.state = AirState()

    @property
    def pressure(self) -> float:
        """Current pressure (force per area)."""
        return self.state.pressure

    @property
    def sealed(self) -> SealedAir | None:
        """The sealed air, with its current temperature and atmosphere; None if not sealed."""
        return self.state.sealed

    @property
    def volume(self) -> float:
        """Volume gained under the pressurised cells since the stress-free shape (length cubed).

        It lies between the two shapes as long as the rim of these cells is held, or slides in
        planes that are held in their normal direction.
        """
        return gained_volume(self._net)

    @collective
    @changes_model
    def seal(self, *, volume: float, atmosphere: float = 101.325, exponent: float = 1.0) -> None:
        """Seal the air under the membrane at its present pressure. Collective.

        From now on the gas law gives the pressure from the volume, as in a cushion, or in a hall
        in a gust that is faster than its fans. `pressure` is the current one.

        Parameters
        ----------
        volume
            Current volume of the air (length cubed), which a mesh open at the ground does not tell.
        atmosphere
            Pressure of the atmosphere (force per area); the default is in kPa.
        exponent
            1 for isothermal changes, 1.4 for adiabatic ones, too fast to exchange heat.

        Raises
        ------
        InputError
            On all ranks: air already sealed, a step-wise pressure law, a volume or atmosphere that
            is not positive, an exponent below 1, or a current pressure below vacuum.

        Examples
        --------
        >>> solver.advance(pressure=0.3)
        >>> with solver.branch("gust"):
        ...     scene.seal(volume=52000.0, exponent=1.4)
        ...     solver.advance(load={"wind": 1.5})
        """
        checks.same(self.comm, "seal", volume=volume, atmosphere=atmosphere, exponent=exponent)
        if self.sealed is not None:
            raise InputError("seal: the air is sealed already; call scene.unseal() first.")
        if self._law != "total":
            raise InputError(
                "seal: sealed air needs the exact follower pressure; use "
                'Scene(..., pressure="total").'
            )
        volume = checks.positive("seal: volume", volume)
        atmosphere = checks.positive("seal: atmosphere", atmosphere)
        exponent = checks.finite("seal: exponent", exponent)
        if exponent < 1.0:
            raise InputError(
                f"seal: exponent = {exponent:g} is below 1; give 1.0 (isothermal) to 1.4 "
                "(adiabatic)."
            )
        absolute = atmosphere + self.pressure
        if absolute <= 0.0:
            raise InputError(
                f"seal: the pressure {self.pressure:g} is below vacuum in an atmosphere of "
                f"{atmosphere:g}; give the atmosphere in the units of the pressure."
            )
        self.membrane.check_finite("seal")
        air = SealedAir(volume, self.volume, self.pressure, absolute, exponent, atmosphere)
        self.update(sealed=air)

    @collective
    @changes_model
    def unseal(self) -> None:
        """Let fans hold the current pressure of the sealed air. Collective.

        Raises
        ------
        InputError
            On all ranks: air that is not sealed.
        """
        if self.sealed is None:
            raise InputError("unseal: the air is not sealed; scene.seal(volume=...) does that.")
        self.update(sealed=None)
