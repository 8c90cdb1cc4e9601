"""Design values and limits of a scene: what its results are judged by."""

from __future__ import annotations

from collections.abc import Mapping

from crms_fenicsx.analysis.scene.frame import Frame
from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import NonNegative, Positive, collective
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.strengths import (
    ALL,
    SERVICE,
    CableDesign,
    DesignStrength,
    FabricDesign,
    Limits,
    Strengths,
    acting_loads,
    checked_cables,
    checked_strengths,
    patch_radii,
)


class Design:
    """Strengths of fabric and cables, and limits in service. They do not belong to the scene's
    state; the membrane has those of the fabric."""

    def __init__(self, membrane: Membrane, frame: Frame, net: CableNet) -> None:
        self.membrane, self.comm, self._frame, self._net = membrane, membrane.comm, frame, net
        self.cables: dict[str, float | CableDesign] = {}
        self.limits = Limits()

    @collective
    def set_strengths(
        self,
        strengths: Strengths | FabricDesign | Mapping[str, Strengths | FabricDesign],
        *,
        cables: float | CableDesign | Mapping[str, float | CableDesign] | None = None,
        patches: float | Mapping[str, float] | None = None,
    ) -> None:
        """Set the strengths of fabric and cables, for the utilisation in results, files and
        reports.

        They replace earlier ones, do not change the equilibrium and are not in checkpoints. Bars
        have their own (`Bar.strength`). Strengths judge combinations of ultimate limit states; for
        serviceability see `set_limits`.

        Parameters
        ----------
        strengths
            A `codes.FabricDesign`, whose factors follow from the loads of each combination, or two
            design strengths in warp and weft, divided by all partial factors (force per length; of
            isotropic material the smaller counts). One for the membrane, or one per part; others
            have none.
        cables
            A `codes.CableDesign` or a design value of the tension (force), for all cables or by
            name; others have none. One for all also holds for cables that are laid later. Named
            bars that only pull, guys, are judged as cables, too, also in service, instead of by
            their `Bar.strength`.
        patches
            Radii on the stress-free membrane of the reinforcement around its corners (length), by
            group of points, or one for all corners. Within them the strengths of the plain fabric
            do not judge; 0: none. By default a twentieth of the distance to the next corner.
            Corners are point supports, ends of bars, ends of cables on free fabric, ends of held
            edges, re-entrant corners of free edges, and the named points: section forces there
            grow without limit as cells become finer.

        Raises
        ------
        InputError
            On all ranks: an unknown part, cable, guy or group of points, overlapping parts,
            strengths that are not positive, strengths of a `codes.FabricDesign` in other units than
            the stiffness, or a negative radius.

        Examples
        --------
        >>> scene.set_strengths({"roof": (84.0, 80.0), "wall": (60.0, 57.0)})
        >>> fabric = codes.FabricDesign((84.0, 80.0), gamma_M=1.4, biaxial=1.2)
        >>> scene.set_strengths(fabric, cables={"ridge": codes.CableDesign(breaking=220.0)})
        >>> scene.set_strengths((84.0, 80.0), patches={"mast head": 0.6, "low point": 0.4})
        """
        if isinstance(strengths, Mapping):
            strengths = checks.in_one_order(self.comm, strengths)
        mesh = self.membrane.mesh
        found = checked_strengths(
            "set_strengths", strengths, mesh, self.membrane.materials.values()
        )
        guys = [bar.name for bar in self._frame.bars if bar.bar.tension_only]
        laid = [cable.name for cable in self._net.cables]
        ropes = checked_cables("set_strengths", cables, [*laid, *guys])
        self.membrane.patches = patch_radii("set_strengths", patches, mesh)
        self.membrane.strengths, self.cables = found, ropes

    @collective
    def set_limits(
        self,
        *,
        deflection: Positive | Mapping[str, float] | None = None,
        prestress: Positive | Mapping[str, float] | None = None,
        slope: Positive | None = None,
        water: NonNegative | None = None,
    ) -> None:
        """Set limits in service, for the combinations of serviceability limit states.

        They replace earlier ones, do not change the equilibrium and are not in checkpoints. Codes
        leave them to the designer.

        Parameters
        ----------
        deflection
            Largest displacement, in any direction, from the state in operation, in which
            `Solver.combine` was called (length): of the membrane, or by part of the mesh or joint.
        prestress
            Smallest principal section force of the membrane, or by part, that shall remain in
            quasi-permanent combinations (force per length).
        slope
            Smallest slope for drainage in quasi-permanent combinations (degrees): mean slope of
            the way along which water runs from any vertex to where it leaves the membrane.
        water
            Depth up to which water may stand in hollows (length).

        Raises
        ------
        InputError
            On all ranks: a limit that is not positive (of water: negative), a slope of 90 degrees
            or more, or an unknown part or joint.

        Examples
        --------
        >>> scene.set_limits(deflection={"roof": 0.4}, prestress=0.5, slope=3.0, water=0.0)
        """
        parts = dict.fromkeys([ALL, *self.membrane.mesh.parts])
        places = {"deflection": parts | dict.fromkeys(joint.name for joint in self._frame.joints)}
        found = {}
        for name, given in {"deflection": deflection, "prestress": prestress}.items():
            by = given if isinstance(given, Mapping) else {} if given is None else {ALL: given}
            for place, value in by.items():
                checks.named(
                    f"part{' or joint' * (name in places)}", places.get(name, parts), place
                )
                checks.positive(f"set_limits: {name}{f' of {place!r}' * bool(place)}", value)
            found[name] = checks.in_one_order(self.comm, by)
        if slope is not None:
            checks.within("set_limits: slope", slope, 0.0, 89.0, "degrees")
        self.limits = Limits(**found, slope=slope, water=water)

    def of_fabric(self, state: str, factors: Mapping[str, float]) -> dict[str, DesignStrength]:
        """Design strengths in a limit state under loads, by part; none in service."""
        if state in SERVICE:
            return {}
        acting = acting_loads(factors)
        return {part: one.of(state, acting) for part, one in self.membrane.strengths.items()}

    def is_rope(self, bar: PlacedBar) -> bool:
        """Whether a bar is a guy that is judged as a cable."""
        return bar.bar.tension_only and bar.name in self.cables

    def of_cable(self, name: str, state: str) -> float | None:
        """Design value of a cable's tension in a limit state (force); None if unknown."""
        one = self.cables.get(name, self.cables.get(ALL))
        if isinstance(one, CableDesign):
            return one.of(state)
        return None if state in SERVICE else one
