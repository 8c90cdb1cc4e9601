"""What lies under and over a loaded membrane: air that is sealed."""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

from crms_fenicsx.loaded_membrane import LoadedMembrane
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.runtime.readonly import ReadOnly


class FilledMembrane(LoadedMembrane):
    """A loaded membrane over air that may be sealed.

    Parameters
    ----------
    membrane
        The membrane.
    """

    air: ReadOnly[SealedAir | None] = ReadOnly(
        "_air", "call scene.seal(volume=...) or scene.unseal()"
    )
    """The air, if it is sealed, with its current temperature and atmosphere; else None."""
    pressure_law: ReadOnly[Literal["total", "step"]]
    _pressure: float

    def __init__(self, membrane: Membrane) -> None:
        super().__init__(membrane)
        self._air: SealedAir | None = None

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume gained since the stress-free shape (length cubed)."""

    @collective
    def seal(self, *, volume: float, atmosphere: float = 101.325, exponent: float = 1.0) -> None:
        """Seal the air under the membrane at its present pressure. Collective.

        From now on its pressure follows from its volume by the gas law, as in a cushion, or in a
        hall in a gust that is faster than its fans. `pressure` is what it has come to.

        Parameters
        ----------
        volume
            Volume of the air now (length cubed); the mesh, open at the ground, does not tell it.
        atmosphere
            Pressure of the atmosphere (force per area); the default is in kPa.
        exponent
            1 if the air keeps its temperature (isothermal); 1.4 if it has no time to exchange heat
            (adiabatic).

        Raises
        ------
        InputError
            On all ranks: air that is sealed already, the paper's pressure, a volume or an
            atmosphere that is not positive, an exponent below 1, or a present pressure below
            vacuum.

        Examples
        --------
        >>> solver.advance(pressure=0.3)
        >>> with solver.branch("gust"):
        ...     scene.seal(volume=52000.0, exponent=1.4)
        ...     solver.advance(load={"wind": 1.5})
        """
        checks.same(self.comm, "seal", volume=volume, atmosphere=atmosphere, exponent=exponent)
        if self._air is not None:
            raise InputError("seal: the air is sealed already; call scene.unseal() first.")
        if self.pressure_law != "total":
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
        absolute = atmosphere + self._pressure
        if absolute <= 0.0:
            raise InputError(
                f"seal: the pressure {self._pressure:g} is below vacuum in an atmosphere of "
                f"{atmosphere:g}; give the atmosphere in the units of the pressure."
            )
        self.membrane.check_finite("seal")
        self._air = SealedAir(volume, self.volume, self._pressure, absolute, exponent, atmosphere)
        self.changes += 1

    @collective
    def unseal(self) -> None:
        """Let fans hold the pressure that the sealed air has come to. Collective.

        Raises
        ------
        InputError
            On all ranks: the air is not sealed.
        """
        if self._air is None:
            raise InputError("unseal: the air is not sealed; scene.seal(volume=...) does that.")
        self._air = None
        self.changes += 1
