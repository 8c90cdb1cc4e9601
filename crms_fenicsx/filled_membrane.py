"""What is under and on a loaded membrane: air that is sealed, and water."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

from crms_fenicsx.loaded_membrane import LoadedMembrane
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.versions import changes_model
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.runtime.readonly import ReadOnly


class FilledMembrane(LoadedMembrane):
    """A loaded membrane over air that may be sealed, and under ponds.

    Parameters
    ----------
    membrane
        The membrane.
    """

    air: ReadOnly[SealedAir | None] = ReadOnly(
        "_air", "call scene.seal(volume=...) or scene.unseal()"
    )
    """The air, if it is sealed, with its current temperature and atmosphere; else None."""
    ponds: ReadOnly[tuple[Pond, ...]] = ReadOnly(
        "_ponds", "call scene.put_pond(...) or solver.advance(load=...)"
    )
    """The water on the membrane, with its current levels, volumes and factors."""
    pressure_law: ReadOnly[Literal["total", "step"]]
    _pressure: float

    def __init__(self, membrane: Membrane) -> None:
        super().__init__(membrane)
        self._air: SealedAir | None = None
        self._ponds: tuple[Pond, ...] = ()

    @property
    def factors(self) -> dict[str, float]:
        """Current factors of the loads and ponds, by their names."""
        return super().factors | {pond.name: pond.factor for pond in self._ponds}

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume gained since the stress-free shape (length cubed)."""

    @collective
    @changes_model
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

    @collective
    @changes_model
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

    @collective
    def put_pond(
        self,
        weight: float,
        *,
        level: float | None = None,
        volume: float | None = None,
        on: Sequence[str] | None = None,
        name: str = "pond",
    ) -> None:
        """Let water stand on the membrane; `Solver.advance` brings it on by its factor. Collective.

        It lies over all that is below its level, where the membrane's outer side faces up (of a
        cushion on the upper foil), and presses on it the more the further it sinks. Water over a
        rim below the level does not run off. Give either the level, as where water comes and goes,
        or the volume.

        Parameters
        ----------
        weight
            Weight of the water by volume (force / length cubed), positive: 10 kN / m^3.
        level
            Height z of the water's surface (length).
        volume
            Amount of water (length cubed); its level follows.
        on
            Parts of the mesh that it stands on, on the side that faces up; without it all cells
            whose outer side faces up when stress-free.
        name
            What load steps and results know it by.

        Raises
        ------
        InputError
            On all ranks: a weight or a volume that is not positive, neither level nor volume or
            both, a part that does not exist, cells without an upper side or of which some face up
            and some down, or a name that is taken.

        Notes
        -----
        A load step that ends in an equilibrium that is not stable raises a `PondWarning`, one
        without equilibrium a `ConvergenceError`. The rim of what is under water must be held, or
        slide in planes of symmetry: elsewhere a dam would have to stand on it.

        Examples
        --------
        >>> scene.put_pond(10.0, level=6.2, on=["roof"])
        >>> solver.advance(load={"pond": 1.0}, steps=4)
        >>> scene.ponds[0].volume
        """
        checks.same(
            self.comm, "put_pond", weight=weight, level=level, volume=volume, on=on, name=name
        )
        self._check_new_load("put_pond", name)
        weight = checks.positive("put_pond: weight", weight)
        if (level is None) == (volume is None):
            raise InputError(
                f"put_pond: level = {level!r} and volume = {volume!r}; give one of the two."
            )
        parts = () if on is None else self._parts(on)
        if volume is not None:
            volume = checks.positive("put_pond: volume", volume)
            pond = Pond(name, weight, "volume", float(self.membrane.centre[2]), volume, parts, 1)
        else:
            level = checks.finite("put_pond: level", level)
            pond = Pond(name, weight, "level", level, 0.0, parts, 1)
        pond = replace(pond, side=pond.found_side(self.membrane))
        self._ponds = (*self._ponds, pond)
        self.versions.change_model(acts=False)

    def _parts(self, on: Any) -> tuple[str, ...]:
        """The parts of the mesh that a pond's `on` names."""
        known = list(self.membrane.mesh.parts)
        listed = isinstance(on, Sequence) and not isinstance(on, str) and len(on) > 0
        if not listed or any(part not in known for part in on):
            names = ", ".join(map(repr, known)) or "none"
            raise InputError(
                f"put_pond: on = {on!r}; give a list of parts of the mesh, which are {names}."
            )
        return tuple(on)

    @collective
    def remove_load(self, name: str) -> None:
        """Take a load or a pond away; the next load step goes on without it. Collective.

        Raises
        ------
        InputError
            On all ranks: there is no such load.
        """
        checks.same(self.comm, "remove_load", name=name)
        factor = checks.named("load", self.factors, name)
        self._loads = tuple(load for load in self._loads if load.name != name)
        self._ponds = tuple(pond for pond in self._ponds if pond.name != name)
        self.versions.change_model(acts=factor != 0.0)
