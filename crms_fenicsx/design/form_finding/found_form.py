"""A found form, and the scene to analyse it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.form_finding.form_bars import FormBar, add_bars
from crms_fenicsx.design.form_finding.stresses import Materials, PrescribedStress
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import InputError, collective
from crms_fenicsx.model.cable import Cable

ROUNDING = 1e-10
"""Residual section forces, relative to those prescribed, that count as zero."""


@dataclass(frozen=True)
class FormCableFound:
    """A cable of a found form.

    Attributes
    ----------
    name
        Name of its edge group.
    tension
        Tension (force).
    length
        Length (length).
    path
        Positions of its vertices from end to end (length), (k, 3).
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
        The form, as the stress-free shape for an analysis, with the start mesh's groups.
    stress
        Prescribed section forces.
    residual_stress
        Residual section forces of this rank's cells (force per length), tensors in space (n, 3, 3),
        to be added to those prescribed. Prescribed section forces balance on a curved surface only
        to the accuracy of its facets, and not at all if they differ along warp and weft; the
        residual ones restore equilibrium.
    deviation
        Largest residual section force relative to the largest prescribed one.
    disturbance
        Largest relative change that they cause in the area, in a cable's length or tension, in the
        pressure, or in a support force (relative to the largest of these).
    supports
        Held directions by group.
    reactions
        Reactions (3,) on these groups by name (force): the load on masts and guys at a point. A
        vertex in several groups counts in each.
    cables
        Cables with tensions, lengths and positions.
    area, volume
        Area, and under pressure the volume as defined in `find_form`.
    pressure
        Inner pressure (force per area), 0 if there is none.
    iterations
        Number of linear systems solved.
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
        """One line; not collective."""
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
        """Cable tensions (force) by name."""
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
        """Make a scene that is in equilibrium from the start. Collective.

        Its supports hold, except where bars replace them with the forces that balance the form. Its
        cables have the tensions found; they lie in pockets at the rim and in sleeves inside, unless
        they are bonded. The pressure is that of the form. `residual_stress`, if any, becomes an
        energy term, which the section forces of results include.

        Parameters
        ----------
        material
            Material of the membrane, or of each part. The form's section forces replace its
            prestress, and the warp given to `find_form` replaces its warp, as does the form's warp
            if the forces along warp and weft differ; the material must not name another. If none
            is named, the material's warp stays.
        cables
            Properties of the cables, one for all or by name.
        bars
            Masts and guys that replace supports at points.
        belts
            Belts sewn along all cables, or along some by name: "belt front" along "front". They are
            bonded and start without force.
        **options
            Arguments of `Scene`.

        Raises
        ------
        InputError
            On all ranks: materials that do not fit or name another warp, a missing or unknown
            cable, or bars that do not balance the form.

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
        """Supports that bars replace."""
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
        """Properties of each cable, or of some."""
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
