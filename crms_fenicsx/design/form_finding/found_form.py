"""A found form, the same along lines, and the scene to analyse it."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.form_finding.film import Film, Inflation
from crms_fenicsx.design.form_finding.form_bars import FormBar, add_bars
from crms_fenicsx.design.form_finding.form_cables import (
    EdgeLine,
    FormCable,
    FormCableFound,
    edge_lines,
    places_of,
)
from crms_fenicsx.design.form_finding.form_search import NO_FORM, FormSearch
from crms_fenicsx.design.form_finding.stresses import Materials, PrescribedStress
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation import meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.membrane_mesh import moved
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import ConvergenceError, InputError, as_text
from crms_fenicsx.model.cable import Cable, Net
from crms_fenicsx.model.materials import IsotropicMembrane
from crms_fenicsx.model.membrane import Membrane

logger = logging.getLogger("crms_fenicsx")

REPORTED_DEVIATION, COARSE = 0.05, 0.1
"""Deviation of section forces from the prescribed ones, relative to the largest: reported above
the first, refused above the second, plus the relative difference of warp and weft forces."""
REPORTED_DISTURBANCE = 0.01
"""Relative change of area and forces by the residual section forces above which it is reported."""
ROUNDING = 1e-10
"""Residual section forces, relative to those prescribed, that count as zero."""


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
    prefix
        Prefix of the linear solver's PETSc options, also in `along`.
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
    prefix: str

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
        cables have the tensions found, and are attached to the fabric as their `FormCable` says.
        The pressure is that of the form. `residual_stress`, if any, becomes an energy term, which
        the section forces of results include.

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
            cable, one with ``hold="outside"`` from which the fabric pulls away, as from a ridge, or
            bars that do not balance the form.

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
        add_bars(scene, self.reactions, bars)
        if self.deviation > ROUNDING:
            scene.add_term(ResidualStress(scene.u, self.residual_stress))
        for cable in self.cables:
            laid = scene.lay_cable(
                kinds[cable.name], cable.path, tension=cable.tension, name=cable.name,
                hold=cable.hold, measured_on="facets",
            )  # fmt: skip
            if laid.state.lifted.any():
                place = as_text(laid.state.positions[np.argmax(laid.state.lifted)])
                raise InputError(
                    f"FoundForm.scene: the cable {cable.name!r} lies on the outer side, but the "
                    f"fabric of the form pulls away from it, as at {place}; use a FormCable with "
                    'hold="sleeve", "pocket" or "bonded".'
                )
        for cable in self.cables:
            if cable.name in of_belts:
                name = f"belt {cable.name}"
                scene.lay_cable(of_belts[cable.name], cable.path, name=name, hold="bonded")
        scene.air.update(pressure=self.pressure)
        return scene

    @collective
    def along(self, lines: Net | Mapping[str, ArrayLike]) -> FoundForm:
        """Find the same form on a mesh cut along lines, as for cables on them. Collective.

        The mesh is `meshes.along` of this form's, with all its groups and a group of edges for
        each line. Section forces, warp, supports, pressure and the tensions of the cables stay.
        Vertices move along the normals of the surface only, from the facets on which they lie to
        the form of the finer mesh, so that lines stay as straight as they are cut.

        Parameters
        ----------
        lines
            A net, such as one laid out on a scene of this form, or routes (k, 3) or in plan (k, 2)
            by name (length).

        Returns
        -------
        FoundForm
            The form on the new mesh, in equilibrium, with its own residual section forces.

        Raises
        ------
        InputError
            On all ranks: lines along which the mesh cannot be cut, such as those of another form.
        ConvergenceError
            On all ranks: no form was found on the new mesh.

        Examples
        --------
        >>> ends = [cable.path[len(cable.path) // 2, :2] for cable in found.cables[::2]]
        >>> cut = found.along({"ridge": ends})
        >>> scene = cut.scene(IsotropicMembrane(E=500.0, nu=0.3, thickness=1.0), Cable(EA=8e3))
        """
        mesh = meshes.along(self.mesh, lines.paths if isinstance(lines, Net) else lines)
        prescribed = PrescribedStress.of(mesh, self.stress.forces, self.stress.warps)
        membrane = Membrane(mesh, IsotropicMembrane(E=1.0, nu=0.0, thickness=1.0))
        for group, directions in self.supports.items():
            membrane.hold(group, directions, new_edges=True)
        cables = edge_lines(membrane, [
            FormCable(cable.name, tension=cable.tension, hold=cable.hold)
            for cable in self.cables
        ])  # fmt: skip
        pressure = None if self.volume is None else self.pressure
        return found_on(
            "FoundForm.along", membrane, prescribed, self.supports, cables, None, self.prefix,
            pressure=pressure,
        )  # fmt: skip

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


def found_on(
    call: str, membrane: Membrane, prescribed: PrescribedStress, supports: Mapping[str, str],
    lines: list[EdgeLine], lift: Array | None, prefix: str, **given: float | None,
) -> FoundForm:  # fmt: skip
    """Find the form of a membrane with its supports, for the pressure, volume or rise that is
    given; near it if no lift is. Collective."""
    inflated = any(value is not None for value in given.values())
    centre = _rim_centre(membrane, lift, inflated)
    film = Film(membrane, prescribed.cell_forces, prescribed.directions, centre)
    n = membrane.V.dofmap.index_map.size_local
    inflation = Inflation(film, ~membrane.held[:n, 2], **given)
    search = FormSearch(membrane, film, lines, inflation, prefix)
    try:
        search.run(lift)
    finally:
        search.system.destroy()
    mesh = membrane.mesh
    shape = moved(mesh, membrane.V, membrane.positions())
    residual = film.section_forces() - prescribed.tensors(shape)
    largest = mesh.comm.allreduce(float(np.abs(residual).max(initial=0.0)), op=MPI.MAX)
    deviation = largest / film.largest
    found = tuple(
        FormCableFound(
            one.cable.group, one.tension, one.length, places_of(membrane, one.ids), one.cable.hold
        )
        for one in search.lines
    )
    reactions = _group_sums(membrane, supports, search.support_forces)
    disturbance = _disturbance(membrane, supports, search)
    _check_deviation(call, deviation, disturbance, prescribed, mesh)
    return FoundForm(
        shape, prescribed, residual, deviation, disturbance, supports, reactions, found,
        film.area(),
        film.volume() if inflation.acts else None, inflation.pressure, search.iterations, prefix,
    )  # fmt: skip


def _rim_centre(membrane: Membrane, lift: Array | None, inflated: bool) -> Array:
    """Mean position of the rim, or centre of a membrane without a rim. Collective."""
    edges = membrane.open_edges
    ends = np.unique(edges.vertices)
    if inflated:
        free = ends[~membrane.held[ends].all(axis=1)]
        found = np.concatenate(membrane.comm.allgather(membrane.stress_free[free[:1]]))
        if len(found):
            raise InputError(
                "find_form: there is pressure, but the rim is not held in all directions at "
                f"{as_text(found[0])}."
            )
    own = ends[ends < membrane.V.dofmap.index_map.size_local]
    places = (membrane.stress_free + (0.0 if lift is None else lift))[own]
    total = membrane.comm.allreduce(np.array([*places.sum(axis=0), len(own)]))
    return np.asarray(total[:3] / total[3]) if total[3] else membrane.centre


def _disturbance(membrane: Membrane, supports: Iterable[str], search: FormSearch) -> float:
    """Largest relative change of the form's figures by the sheet that holds it. Collective."""
    if not search.holding or search.freely is None:
        return 0.0
    (before, free), (numbers, held) = search.freely, search.figures()
    changed = np.abs(numbers - before) / np.maximum(np.abs(numbers), 1e-300)
    changes = _group_sums(membrane, supports, held - free)
    sizes = np.linalg.norm(held, axis=1)[:, None]
    largest = max(float(size[0]) for size in _group_sums(membrane, supports, sizes).values())
    moved_by = max(float(np.linalg.norm(change)) for change in changes.values())
    return max(float(changed.max()), moved_by / largest if largest else 0.0)


def _check_deviation(
    call: str, deviation: float, disturbance: float, stress: PrescribedStress, mesh: MembraneMesh
) -> None:
    """Refuse forms whose section forces differ from those prescribed."""
    forces = np.array(list(stress.forces.values()))
    incompatible = float(np.ptp(forces, axis=1).max() / forces.max())
    if deviation > incompatible + COARSE:
        raise ConvergenceError(
            f"{call}: the nearest form has section forces that differ by {deviation:.0%} from "
            f"those prescribed; {NO_FORM} Or the mesh is too coarse for its curvature."
        )
    if mesh.comm.rank > 0:
        return
    if disturbance > REPORTED_DISTURBANCE:
        logger.warning(
            "%s: residual section forces change the area, cables, pressure or supports' "
            "forces of the form by up to %.1f %%; use a finer mesh, or a start mesh nearer to it",
            call,
            100 * disturbance,
        )
    if deviation > REPORTED_DEVIATION:
        logger.warning(
            "%s: section forces of the form differ from those prescribed by up to %.0f %%: "
            "the mesh is coarse, or different ones along warp and weft do not balance each other",
            call,
            100 * deviation,
        )


def _group_sums(membrane: Membrane, groups: Iterable[str], forces: Array) -> dict[str, Array]:
    """Sum (3,) of the forces (n, 3) on this rank's owned vertices, per group. Collective."""
    sums = {}
    for group in groups:
        dofs = membrane.vertices(group)
        sums[group] = membrane.comm.allreduce(forces[dofs[dofs < len(forces)]].sum(axis=0))
    return sums
