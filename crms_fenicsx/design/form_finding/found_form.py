"""A found form, masts and guys that replace its supports, and the scene to analyse it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.form_finding.stresses import Materials, PrescribedStress
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.model.bar import Bar
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.tolerances import SAME_PLACE

BALANCED = 1e-9
"""Part of a reaction that bars may leave, and relative size of singular values taken as zero."""
ROUNDING = 1e-10
"""Residual section forces, relative to those prescribed, that count as zero."""


@dataclass(frozen=True)
class FormBar:
    """A bar (mast, guy or tie) that replaces a form's support at a point, with others there.

    Parameters
    ----------
    group
        The support: a point group with one vertex.
    bar
        Properties of the bar.
    foot
        Place (3,) of the other end (length), which is anchored.
    name
        Name in results, by default "bar 1", "bar 2" ...
    force
        Axial force (force), tension positive; by default such that the support's bars balance the
        reaction.

    Raises
    ------
    InputError
        Not a `Bar`, an invalid foot, or a force that is not finite or compresses a guy.
    """

    group: str
    bar: Bar
    foot: Sequence[float]
    name: str | None = None
    force: float | None = None

    def __post_init__(self) -> None:
        checks.of_type("FormBar: bar", self.bar, Bar)
        checks.vector(f"FormBar: foot of {self.label}", self.foot)
        if self.force is not None:
            self.unstressed(1.0, checks.finite(f"FormBar: force of {self.label}", self.force))

    @property
    def label(self) -> str:
        """Name in messages."""
        return repr(self.name) if self.name else f"a bar of {self.group!r}"

    def unstressed(self, length: float, force: float) -> float:
        """Unstressed length (length) of a bar from its length under a force.

        Raises
        ------
        InputError
            A guy under compression, or a force beyond its stiffness.
        """
        if force <= (0.0 if self.bar.tension_only else -self.bar.EA):
            what = "a guy" if self.bar.tension_only else f"a bar of EA = {self.bar.EA:g}"
            raise InputError(
                f"FormBar: {self.label} would have the force {force:.6g}, which {what} cannot "
                "have; move its foot, or change its force or Bar."
            )
        return length / (1.0 + force / self.bar.EA)


def _add_bars(scene: Scene, reactions: Mapping[str, Array], bars: Sequence[FormBar]) -> None:
    """Add bars in place of supports at points. Collective. Shapes: reactions (3,)."""
    frame = scene.frame
    for group in dict.fromkeys(bar.group for bar in bars):
        own = [bar for bar in bars if bar.group == group]
        vertex = frame.vertex_in_group(group)
        rank, dof = frame.home(vertex)
        held = scene.comm.bcast(
            bool(scene.held[dof].any()) if scene.comm.rank == rank else None, rank
        )
        if held:
            raise InputError(
                f"FoundForm.scene: another support holds {group!r} as well; bars replace supports "
                "of points in one group."
            )
        place = frame.place_of(vertex)
        ways = np.array([bar.foot for bar in own], dtype=float) - place
        lengths = np.linalg.norm(ways, axis=1)
        if lengths.min() <= SAME_PLACE * scene.membrane.size:
            bar = own[int(np.argmin(lengths))]
            raise InputError(
                f"FoundForm.scene: {bar.label} has its foot at {as_text(place)}, where {group!r} "
                "is."
            )
        forces = _bar_forces(reactions[group], ways / lengths[:, None], own)
        for bar, length, force in zip(own, lengths, forces, strict=True):
            L0 = bar.unstressed(float(length), float(force))
            scene.add_bar(bar.bar, bar.foot, vertex, L0=L0, name=bar.name)


def _bar_forces(reaction: Array, ways: Array, bars: Sequence[FormBar]) -> Array:
    """Forces (n,) of bars along `ways` (n, 3) that sum to a reaction (force)."""
    group = bars[0].group
    found = np.array([np.nan if bar.force is None else bar.force for bar in bars])
    asked = np.isnan(found)
    rest = reaction - found[~asked] @ ways[~asked]
    solved, _, rank, _ = np.linalg.lstsq(ways[asked].T, rest, rcond=BALANCED)
    found[asked] = solved
    left = reaction - found @ ways
    if rank < np.count_nonzero(asked):
        raise InputError(
            f"FoundForm.scene: the forces of {np.count_nonzero(asked)} bars at {group!r} do not "
            "follow from its reaction; set the force of some, or move their feet."
        )
    if np.linalg.norm(left) > BALANCED * max(np.linalg.norm(reaction), np.abs(found).max()):
        raise InputError(
            f"FoundForm.scene: the bars at {group!r} leave {as_text(left)} of its reaction "
            f"{as_text(reaction)}; add a bar, or put a foot in the direction of the rest."
        )
    return found


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
        >>> found.reactions["front left"]
        >>> mast, guy = Bar(EA=5e5), Bar(EA=3e4, tension_only=True)
        >>> scene = found.scene(fabric, steel, bars=[
        ...     FormBar("front left", mast, foot=(0.5, 0.5, -3.0)),
        ...     FormBar("front left", guy, foot=(-5.0, 0.0, -3.0)),
        ...     FormBar("front left", guy, foot=(0.0, -5.0, -3.0)),
        ... ])
        """
        kinds = self._kinds(cables)
        of_belts = {} if belts is None else self._kinds(belts, all_of_them=False)
        released = self._released(bars)
        scene = Scene(self.mesh, self.stress.materials(material), **options)
        for group, directions in self.supports.items():
            if group not in released:
                scene.fix(group, directions)
        _add_bars(scene, self.reactions, bars)
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
            checks.of_type("FoundForm.scene: a bar", bar, FormBar)
            if self.supports.get(bar.group) != "xyz":
                full = [group for group, held in self.supports.items() if held == "xyz"]
                raise InputError(
                    f"FoundForm.scene: {bar.label} holds {bar.group!r}, which is not a support in "
                    f"all directions; these are {', '.join(map(repr, full)) or 'none'}."
                )
        return {bar.group for bar in bars}

    def _kinds(
        self, cables: Cable | Mapping[str, Cable] | None, all_of_them: bool = True
    ) -> dict[str, Cable]:
        """Properties of each cable, or of some."""
        names = [cable.name for cable in self.cables]
        kinds = dict.fromkeys(names, cables) if not isinstance(cables, Mapping) else dict(cables)
        for name, kind in kinds.items():
            checks.named("cable", dict.fromkeys(names), name)
            checks.of_type(f"FoundForm.scene: the cable {name!r}", kind, Cable)
        missing = [name for name in names if name not in kinds]
        if missing and all_of_them:
            raise InputError(f"FoundForm.scene: the cable {missing[0]!r} has no Cable.")
        return kinds  # type: ignore[return-value]
