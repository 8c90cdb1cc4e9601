"""The loads of a scene: on membrane and joints, ponded water, and the air under the membrane."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from dolfinx import fem

from crms_fenicsx.analysis.scene.frame import Frame, Place
from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.deformed_surface import gained_volume
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import (
    Finite,
    Name,
    PerRank,
    Positive,
    Vector,
    collective,
)
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.handle import ReadOnly, Stateful
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane_load import (
    Area,
    Coefficient,
    MembraneLoad,
    Pond,
    Traction,
    cable_load,
    fixed_direction_load,
    line_load,
    nodal_load,
    upper_side,
    wind_load,
)
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.strengths import ALL, SETTINGS
from crms_fenicsx.model.temperature import change_of, checked_changes
from crms_fenicsx.model.versions import Versions, changes_model


@dataclass(frozen=True)
class LoadsState:
    """State of the loads of a scene."""

    loads: tuple[MembraneLoad, ...] = ()  # on membrane and joints, with their factors
    ponds: tuple[Pond, ...] = ()  # with their levels, volumes and factors


class Loads(Stateful[LoadsState]):
    """Loads on the membrane and on joints, and ponds; iterate over it for the loads."""

    ponds: ReadOnly[tuple[Pond, ...]] = ReadOnly("state.ponds", "call scene.put_pond(...)")
    """The ponds, with their current levels, volumes and factors."""

    def __init__(self, net: CableNet, versions: Versions, frame: Frame) -> None:
        self.membrane, self.comm, self.versions = net.membrane, net.membrane.comm, versions
        self._net, self._frame = net, frame
        self.state = LoadsState()

    def __iter__(self) -> Iterator[MembraneLoad]:
        return iter(self.state.loads)

    def __len__(self) -> int:
        return len(self.state.loads)

    def load(self, name: str) -> MembraneLoad:
        """Return the load with a name.

        Raises
        ------
        InputError
            No load has that name.
        """
        return checks.named("load", {load.name: load for load in self}, name)

    @property
    def factors(self) -> dict[str, float]:
        """Current factors of loads and ponds, by name."""
        ponds = {pond.name: pond.factor for pond in self.ponds}
        return {load.name: load.factor for load in self} | ponds

    def replace_each(self, change: Callable[[Any], Any]) -> None:
        """Replace each load and pond by a function's value."""
        self.state = LoadsState(
            tuple(map(change, self.state.loads)), tuple(map(change, self.state.ponds))
        )

    @collective
    def put_load(self, force: Traction, *, name: Name = "load", per: Area = "surface") -> None:
        """Put a load of fixed direction on the membrane.

        Its forces follow from the current shape and then keep direction and size, and their places
        on the fabric; `Solver.advance` scales them by the load's factor.

        Parameters
        ----------
        force
            Force per area (force / length squared): (3,), or a function that returns (3, n) for
            points (3, n) on the current surface and its unit normals (3, n), which point the way
            that pressure pushes.
        name
            Name in load steps and results.
        per
            Reference area: the current "surface"; its "plan", the projection along z, as for snow;
            or the stress-free "material", as for the membrane's weight.

        Raises
        ------
        InputError
            On all ranks: a force that is not finite or of another shape, an unknown area, or a
            name that is taken.

        Examples
        --------
        >>> scene.put_load((0.0, 0.0, -0.6), name="snow", per="plan")
        >>> scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
        >>> solver.advance(load={"snow": 1.5, "weight": 1.35})
        """
        self._check_new("put_load", name)
        self.add(fixed_direction_load(self.membrane, force, name, per))

    @collective
    def put_wind(
        self, pressure: Positive, coefficient: Coefficient, *, name: Name = "wind"
    ) -> None:
        """Put wind on the membrane; `Solver.advance` applies it by its factor.

        The pressure stays normal to the surface: a load step ends when the wind's forces are those
        on the deformed shape. Coefficients stay with the fabric as it moves.

        Parameters
        ----------
        pressure
            Peak velocity pressure q_p (force per area), positive.
        coefficient
            Pressure coefficient c_p, positive for pressure on the outside and negative for
            suction, as in EN 1991-1-4: one number, one for each named part of the mesh, or a
            function that returns (n,) for points (3, n) on the current surface and its outward
            unit normals (3, n).
        name
            Name in load steps and results.

        Raises
        ------
        InputError
            On all ranks: a pressure that is not positive, coefficients that are not finite or of
            another shape, an unknown or missing part, overlapping parts, or a name that is taken.

        Examples
        --------
        >>> scene.put_wind(0.8, {"roof": -0.9, "walls": 0.7}, name="wind along x")
        >>> solver.advance(load={"wind along x": 1.5})
        """
        self._check_new("put_wind", name)
        self.add(wind_load(self.membrane, pressure, coefficient, name))

    @collective
    def put_forces(self, forces: PerRank[fem.Function], *, name: Name = "forces") -> None:
        """Put forces on the membrane's vertices, as from another program. Collective.

        They keep direction and size. The function is copied: later changes have no effect. Lines
        that slide with their cables stay at vertices with a force, except where all vertices around
        have one too.

        Parameters
        ----------
        forces
            Force on each vertex (force), as a ``dolfinx.fem.Function(scene.V)``; values of ghosts
            are ignored.
        name
            Name in load steps and results.

        Raises
        ------
        InputError
            On all ranks: no function in the space `V`, a force that is not finite, or a name that
            is taken.

        Examples
        --------
        >>> forces = dolfinx.fem.Function(scene.V)
        >>> forces.x.array[:] = fluid_forces
        >>> scene.put_forces(forces, name="fluid")
        >>> solver.advance(load={"fluid": 1.0})
        """
        self._check_new("put_forces", name)
        self.add(nodal_load(self.membrane, forces, name))

    @collective
    def put_line_load(
        self, force: Sequence[float] | Array, edges: str, *, name: Name = "line load"
    ) -> None:
        """Put a line load along edges of the membrane, such as the weight of a gutter. Collective.

        Its forces follow from the current lengths of the edges and then keep direction and size;
        half of an edge's force acts at each end.

        Parameters
        ----------
        force
            Force per length, (3,) (force / length).
        edges
            Name of a group of edges of the mesh.
        name
            Name in load steps and results.

        Raises
        ------
        InputError
            On all ranks: a force that is not finite, an unknown group, or a name that is taken.

        Examples
        --------
        >>> scene.put_line_load((0.0, 0.0, -0.2), "front", name="snow guard")
        >>> solver.advance(load={"snow guard": 1.35})
        """
        self._check_new("put_line_load", name)
        self.add(line_load(self.membrane, force, edges, name))

    @collective
    def put_cable_load(
        self, force: Vector, cables: Sequence[LaidCable], *, name: Name = "cable load"
    ) -> None:
        """Put a load along cables, such as their weight, ice or wind on them. Collective.

        It acts on the fabric where the cables lie at the time of the call, half of the length
        between two contacts at each, and on joints at their ends; the share of anchors goes into
        the ground and is not in their reactions. The forces keep their direction, size and place,
        also where a cable slides on. A slack cable loads the fabric, too, and so does one that a
        combination is "without".

        Parameters
        ----------
        force
            Force per current length, (3,) (force / length).
        cables
            Cables of this scene.
        name
            Name in load steps and results.

        Raises
        ------
        InputError
            On all ranks: a force that is not finite, no cables, or a name that is taken.

        Examples
        --------
        >>> scene.put_cable_load((0.0, 0.0, -0.012), [ridge], name="cable weight")
        >>> solver.advance(load={"cable weight": 1.35})
        """
        self._check_new("put_cable_load", name)
        checks.collection("put_cable_load: cables", cables, Sequence, "scene.cables", 1)
        for cable in cables:
            checks.of_type("put_cable_load: a cable", cable, LaidCable)
        self.add(cable_load(self.membrane, cables, np.asarray(force, dtype=float), name))

    @collective
    def put_joint_load(self, forces: Mapping[Joint, Place], *, name: Name = "joint load") -> None:
        """Put forces on joints; `Solver.advance` applies them by their factor. Collective.

        Parameters
        ----------
        forces
            Force on each joint, (3,) (force), constant in direction and size.
        name
            Name in load steps and results.

        Raises
        ------
        InputError
            On all ranks: no joint of this scene, a force that is not finite, or a name that is
            taken.

        Examples
        --------
        >>> scene.put_joint_load({top: (0.0, 0.0, -5.0)}, name="lamp")
        >>> solver.advance(load={"lamp": 1.35})
        """
        self._check_new("put_joint_load", name)
        checks.collection("put_joint_load: forces", forces, Mapping, "{joint: (Fx, Fy, Fz)}", 1)
        found: dict[str, tuple[float, float, float]] = {}
        for joint, force in forces.items():
            checks.own("put_joint_load", "joint", joint, self._frame.joints)
            x, y, z = map(float, checks.vector(f"put_joint_load: force on {joint!r}", force))
            found[joint.name] = (x, y, z)
        intensity = float(norm(np.array([*found.values()])).sum()) / self.membrane.size**2
        nodal = np.zeros(self.membrane.held.shape)
        self.add(MembraneLoad(name, nodal, intensity, joints=found))

    @collective
    def put_temperature(
        self, change: float | Mapping[str, float], *, name: Name = "temperature change",
        reference: Finite | None = None,
    ) -> None:  # fmt: skip
        """Change the temperature of fabric, cables and bars; `Solver.advance` applies it by its
        factor. Collective.

        All need their `expansion`, 0.0 to leave one out. Free members grow by the factor ``1 +
        expansion dT``, dT being the sum over temperature loads of factor times change. The
        temperature of sealed air is another one, see `Solver.advance`.

        Parameters
        ----------
        change
            Difference to the temperature at which the model's lengths and forces hold (kelvin): one
            number for all, or by name for "fabric", "cables", "bars", a part of the fabric with a
            material of its own, a cable or a bar; own names take precedence. What has no name here
            keeps its temperature.
        name
            Name in load steps and results. `codes.combinations` needs one that begins with
            "temperature".
        reference
            Temperature T_0 at which the model's lengths and forces hold, for the report (degrees
            Celsius): it lists the temperatures that follow.

        Raises
        ------
        InputError
            On all ranks: an unknown name, a change that is not finite or of more than 200 K, or a
            name that is taken. The load step refuses members without `expansion`, a `UflMembrane`,
            and step-wise laws.

        Notes
        -----
        `LaidCable.L0` and `PlacedBar.L0` are those at the present temperature. ``advance(L0=...)``
        takes lengths at the temperature before the call, whose temperature loads change them.

        Examples
        --------
        >>> strand = Cable(EA=1e3, expansion=1.2e-5)
        >>> stay = scene.lay_cable(strand, [(0.0, 1.0), (4.0, 3.0)], tension=4.0, name="stay")
        >>> scene.put_temperature({"stay": -30.0}, name="temperature winter", reference=10.0)
        >>> step = solver.advance(load={"temperature winter": 1.5})
        """
        self._check_new("put_temperature", name)
        parts = tuple(self.membrane.parts.values())
        bars = tuple(bar.name for bar in self._frame.bars)
        cables = tuple(cable.name for cable in self._net.cables)
        changes = checked_changes(change, {"fabric": parts, "cables": cables, "bars": bars})
        told = []
        if reference is not None:
            told.append(f"T_0 = {reference:g} °C")
            told += [
                f"{one or 'all'} {dT:+g} K to {reference + dT:g} °C" for one, dT in changes.items()
            ]
        none, basis = np.zeros(self.membrane.held.shape), ", ".join(told)
        self.add(MembraneLoad(name, none, 0.0, warms=changes, basis=basis))

    @property
    def has_wind(self) -> bool:
        """Whether a wind acts, whose forces turn with the membrane."""
        return any(load.is_active_wind for load in self)

    def warming(self, one: LaidCable | PlacedBar | int) -> float:
        """Present temperature change (kelvin) of a cable, a bar or a material, by its number."""
        return sum(load.factor * change for load, change in self.warmings(one))

    def warmings(self, one: LaidCable | PlacedBar | int) -> list[tuple[MembraneLoad, float]]:
        """Loads that change the temperature of such a member, with its changes (kelvin)."""
        if isinstance(one, int):
            kind, own = "fabric", str(self.membrane.parts.get(one, ALL))
        else:
            kind, own = "cables" if isinstance(one, LaidCable) else "bars", one.name
        found = [(load, change_of(load.warms, kind, own)) for load in self if load.warms]
        return [(load, change) for load, change in found if change]

    @collective
    def put_pond(
        self,
        weight: Positive,
        *,
        level: Finite | None = None,
        volume: Positive | None = None,
        on: Sequence[str] | None = None,
        name: Name = "pond",
    ) -> None:
        """Let water stand on the membrane; `Solver.advance` applies it by its factor. Collective.

        It covers everything below its level where the membrane's outer side faces up (the upper
        foil of a cushion), and its pressure grows with its depth. It does not run off over a rim
        below the level. Give the level, if water can flow in and out, or else the volume.

        Parameters
        ----------
        weight
            Weight of the water by volume (force / length cubed), such as 10 kN / m^3.
        level
            Height z of the surface of the water (length).
        volume
            Amount of water (length cubed); its level follows.
        on
            Parts of the mesh below the water, on the side that faces up; by default all cells
            whose outer side faces up when stress-free.
        name
            Name in load steps and results.

        Raises
        ------
        InputError
            On all ranks: a weight or volume that is not positive, neither or both of level and
            volume, an unknown part, cells that have no upper side or face both ways, or a name
            that is taken.

        Notes
        -----
        A load step to an unstable equilibrium raises a `PondWarning`, one without equilibrium a
        `ConvergenceError`. The rim of the flooded cells must be held, or slide in planes of
        symmetry.

        Examples
        --------
        >>> step = solver.advance(pressure=-1.0)  # makes a hollow
        >>> scene.put_pond(10.0, level=-0.1)
        >>> step = solver.advance(load={"pond": 1.0}, steps=2)
        >>> scene.ponds[0].volume > 0.0
        True
        """
        self._check_new("put_pond", name)
        if (level is None) == (volume is None):
            raise InputError(
                f"put_pond: level = {level!r} and volume = {volume!r}; pass one of the two."
            )
        if on is not None:
            checks.collection("put_pond: on", on, Sequence, 'on=["roof"]', 1)
            for part in on:
                checks.named("part", self.membrane.mesh.parts, part)
        parts = tuple(on or ())
        if volume is not None:
            pond = Pond(name, weight, "volume", float(self.membrane.centre[2]), volume, parts, 1)
        elif level is not None:
            pond = Pond(name, weight, "level", level, 0.0, parts, 1)
        pond = replace(pond, side=upper_side(pond, self.membrane))
        self.update(ponds=(*self.ponds, pond))
        self.versions.change_model(acts=False)

    @collective
    def remove_load(self, name: str) -> None:
        """Remove a load or pond from the next load step on. Collective.

        Raises
        ------
        InputError
            On all ranks: an unknown load, or a temperature change that acts.

        Examples
        --------
        >>> scene.put_load((0.0, 0.0, -0.2), name="snow")
        >>> scene.remove_load("snow")
        >>> scene.factors
        {}
        """
        factor = checks.named("load", self.factors, name)
        if factor != 0.0 and any(load.name == name and load.warms for load in self):
            raise InputError(
                f"remove_load: {name!r} acts by the factor {factor:g} on lengths and forces; call "
                f"solver.advance(load={{{name!r}: 0.0}}) before."
            )
        self.state = LoadsState(
            tuple(load for load in self if load.name != name),
            tuple(pond for pond in self.ponds if pond.name != name),
        )
        self.versions.change_model(acts=factor != 0.0)

    def follow_stress_free_places(self) -> None:
        """Renew the loads on cells, which have moved. Collective."""
        self.update(loads=tuple(load.at_stress_free_places(self.membrane) for load in self))

    def add(self, load: MembraneLoad) -> None:
        """Add a load made on the current shape."""
        self.update(loads=(*self.state.loads, load))
        self.versions.change_model(acts=load.factor != 0.0)

    def _check_new(self, call: str, name: str) -> None:
        """Refuse a name that is taken, and a shape that is not finite. Collective."""
        self.membrane.check_finite(call)
        if name in SETTINGS:
            raise InputError(
                f"{call}: name = {name!r} means another thing in combinations; use another name, "
                f"such as {'temperature summer' if call == 'put_temperature' else 'snow'!r}."
            )
        if name in self.factors:
            raise InputError(
                f"{call}: there is a load {name!r} already; use another name, or remove that one "
                f"with scene.remove_load({name!r})."
            )


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
        Collective.

        It lies between the two shapes as long as the rim of these cells is held, or slides in
        planes that are held in their normal direction.
        """
        return gained_volume(self._net)

    @collective
    @changes_model
    def seal(
        self, *, volume: Positive, atmosphere: Positive = 101.325, exponent: Finite = 1.0
    ) -> None:
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
        if self.sealed is not None:
            raise InputError("seal: the air is sealed already; call scene.unseal() first.")
        if self._law != "total":
            raise InputError(
                "seal: sealed air needs the exact follower pressure; use "
                'Scene(..., pressure="total").'
            )
        if exponent < 1.0:
            raise InputError(
                f"seal: exponent = {exponent:g} is below 1; use 1.0 (isothermal) to 1.4 "
                "(adiabatic)."
            )
        absolute = atmosphere + self.pressure
        if absolute <= 0.0:
            raise InputError(
                f"seal: the pressure {self.pressure:g} is below vacuum in an atmosphere of "
                f"{atmosphere:g}; use the same units for both."
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

        Examples
        --------
        >>> scene.seal(volume=50.0)
        >>> scene.unseal()
        >>> scene.air.sealed is None
        True
        """
        if self.sealed is None:
            raise InputError("unseal: the air is not sealed; scene.seal(volume=...) does that.")
        self.update(sealed=None)
