"""A form that was found, and the scene to analyse it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from crms_fenicsx.energies.residual_stress import ResidualStress
from crms_fenicsx.form_finding.form_bars import FormBar, add_bars
from crms_fenicsx.form_finding.stresses import Materials, PrescribedStress
from crms_fenicsx.meshes import MembraneMesh
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.checks import counted, span
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.scene import Scene

ROUNDING = 1e-10
"""Residual section forces relative to those prescribed that are none."""


@dataclass(frozen=True)
class FormCableFound:
    """A cable of a form that was found.

    Attributes
    ----------
    name
        That of its edge group.
    tension
        Tension (force).
    length
        Length (length).
    path
        Places of its vertices from end to end (length), (k, 3).
    bonded
        Whether it is bonded to the fabric.
    """

    name: str
    tension: float
    length: float
    path: Array = field(repr=False)
    bonded: bool = False

    @property
    def force_density(self) -> float:
        """Tension over length (force per length)."""
        return self.tension / self.length


@dataclass(frozen=True, repr=False)
class FoundForm:
    """A form in equilibrium.

    Attributes
    ----------
    mesh
        The form, as the stress-free shape of an analysis, with the groups of the start mesh.
    stress
        Section forces that were prescribed.
    residual_stress
        What this rank's cells have beside these (force per length), tensors in space (n, 3, 3).
        Prescribed section forces balance each other along a curved surface only as well as its
        facets resolve it, and those that differ along warp and weft not at all: these do the rest.
    deviation
        Largest of them relative to the largest prescribed one.
    disturbance
        Largest relative change by these of the area, of a cable's length or tension, of the
        pressure or of the force of a support (of the largest of these forces).
    supports
        Directions in which groups are held, by their names.
    reactions
        Forces (3,) with which these groups are held, by their names (force): what masts and guys
        at a point are to bear. A vertex of several groups counts in each.
    cables
        The cables with tensions, lengths and places.
    area, volume
        Area, and with pressure the volume as `find_form` counts it.
    pressure
        Inner pressure (force per area), 0 without any.
    iterations
        Linear systems that were solved.
    """

    mesh: MembraneMesh
    stress: PrescribedStress
    residual_stress: Array
    deviation: float
    disturbance: float
    supports: Mapping[str, str]
    reactions: Mapping[str, Array]
    cables: tuple[FormCableFound, ...]
    area: float
    volume: float | None
    pressure: float
    iterations: int

    def __repr__(self) -> str:
        """In a line; not collective."""
        words = [f"area {self.area:.6g}"]
        words += [] if self.volume is None else [f"volume {self.volume:.6g}"]
        if self.cables:
            tensions = span(list(self.tensions.values()))
            words.append(f"{counted(len(self.cables), 'cable')}, tension {tensions}")
        words += [f"deviation {self.deviation:.2g}", f"disturbance {self.disturbance:.2g}"]
        return f"FoundForm({'; '.join(words)})"

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        return self.mesh.comm

    @property
    def tensions(self) -> dict[str, float]:
        """Tensions (force) of the cables by name."""
        return {cable.name: cable.tension for cable in self.cables}

    @collective
    def scene(
        self,
        material: Materials,
        cables: Cable | Mapping[str, Cable] | None = None,
        bars: Sequence[FormBar] = (),
        belts: Cable | Mapping[str, Cable] | None = None,
        **options: Any,
    ) -> Scene:
        """Make a scene that is in equilibrium as it is. Collective.

        Its supports hold, but for those that bars replace with the forces that balance the form.
        Its cables are laid with the tensions found, those along edges in pockets, others in
        sleeves, unless they are bonded; its pressure is that of the form. Where there is
        `residual_stress` it is a term of the energy, and section forces of results are those of the
        materials with it.

        Parameters
        ----------
        material
            Material of the membrane, or of each part. Its prestress is replaced by the section
            forces of the form, and its warp by the one given to `find_form`, or where these forces
            differ along warp and weft by the form's; it must not name another. Where nothing of
            this names a warp, the material's stays.
        cables
            What the cables are made of, one for all or each by name.
        bars
            Masts and guys that hold points in place of their supports.
        belts
            Belts sewn on along all cables, or along some by name: "belt front" along "front". They
            are bonded, and start without force.
        **options
            For `Scene`.

        Raises
        ------
        InputError
            On all ranks: materials that do not fit or name another warp, a cable that is missing
            or not known, or bars that do not balance the form.

        Examples
        --------
        >>> found.reactions["high point"]
        >>> mast, guy = Bar(EA=5e5), Bar(EA=3e4, tension_only=True)
        >>> scene = found.scene(fabric, steel, bars=[
        ...     FormBar("high point", mast, foot=(-1.0, 0.0, 0.0)),
        ...     FormBar("high point", guy, foot=(-5.0, -3.0, 0.0)),
        ...     FormBar("high point", guy, foot=(-5.0, 3.0, 0.0)),
        ... ])
        """
        checks.same(
            self.comm, "FoundForm.scene", material=material, cables=cables, bars=bars, belts=belts
        )
        kinds = self._kinds(cables)
        of_belts = {} if belts is None else self._kinds(belts, all_of_them=False)
        released = self._released(bars)
        scene = Scene(self.mesh, self.stress.materials(material), **options)
        for group, directions in self.supports.items():
            if group not in released:
                scene.fix(group, directions)
        add_bars(scene, self.reactions, bars)
        if self.deviation > ROUNDING:
            scene.add_term(ResidualStress(scene.u, self.residual_stress))
        for cable in self.cables:
            scene.lay_cable(
                kinds[cable.name], cable.path, tension=cable.tension, name=cable.name,
                hold="bonded" if cable.bonded else "sleeve", measured_on="facets",
            )  # fmt: skip
        for cable in self.cables:
            if cable.name in of_belts:
                name = f"belt {cable.name}"
                scene.lay_cable(of_belts[cable.name], cable.path, name=name, hold="bonded")
        scene.air.update(pressure=self.pressure)
        return scene

    def _released(self, bars: Sequence[FormBar]) -> set[str]:
        """The supports that bars replace."""
        checks.collection("FoundForm.scene: bars", bars, Sequence, "[FormBar(...)]")
        for bar in bars:
            if not isinstance(bar, FormBar):
                raise InputError(
                    f"FoundForm.scene: {bar!r} is no FormBar; write FormBar(group, bar, foot)."
                )
            if self.supports.get(bar.group) != "xyz":
                full = [group for group, held in self.supports.items() if held == "xyz"]
                raise InputError(
                    f"FoundForm.scene: {bar.label} holds {bar.group!r}, which is no support in all "
                    f"directions; these are {', '.join(map(repr, full)) or 'none'}."
                )
        return {bar.group for bar in bars}

    def _kinds(
        self, cables: Cable | Mapping[str, Cable] | None, all_of_them: bool = True
    ) -> dict[str, Cable]:
        """The kind of each cable, or of some."""
        names = [cable.name for cable in self.cables]
        kinds = dict.fromkeys(names, cables) if not isinstance(cables, Mapping) else dict(cables)
        for name, kind in kinds.items():
            if name not in names:
                raise InputError(
                    f"FoundForm.scene: the form has no cable {name!r}; it has "
                    f"{', '.join(map(repr, names)) or 'none'}."
                )
            if not isinstance(kind, Cable):
                raise InputError(
                    f"FoundForm.scene: the cable {name!r} is {kind!r}; give a Cable(EA=...)."
                )
        missing = [name for name in names if name not in kinds]
        if missing and all_of_them:
            raise InputError(f"FoundForm.scene: the cable {missing[0]!r} has no Cable; give one.")
        return kinds  # type: ignore[return-value]
