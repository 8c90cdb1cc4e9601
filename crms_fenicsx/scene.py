"""The scene: a membrane, where it is held, its cables and loads, and its current state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal
from weakref import proxy

from dolfinx import fem

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.cables.deformed_surface import gained_volume
from crms_fenicsx.energies.term import EnergyTerm, checked_energy
from crms_fenicsx.filled_membrane import FilledMembrane
from crms_fenicsx.loaded_membrane import ANOTHER
from crms_fenicsx.meshes import MembraneMesh
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.membrane import Marker, Membrane, StepHistory, warn_of_penalty
from crms_fenicsx.model.versions import changes_model
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.runtime.errors import InputError, collective, raised_together
from crms_fenicsx.runtime.readonly import ReadOnly
from crms_fenicsx.views.scene_views import SceneViews

Law = Literal["total", "step"]


class Cables(tuple[LaidCable, ...]):
    """The cables of a scene in the order of laying; `remove` is all that changes them."""

    _scene: Scene  # by a proxy: scene and cables do not keep each other alive

    def remove(self, cable: LaidCable | str) -> None:
        """Take a cable away; see `Scene.remove`. Collective."""
        self._scene.remove(cable)


class Scene(FilledMembrane, SceneViews):
    """A cable-reinforced membrane structure and its current state.

    Use any consistent units of length and force.

    Parameters
    ----------
    mesh
        The stress-free membrane.
    material
        Material of the membrane, or of each of its parts by name.
    strain
        "total": Green-Lagrange strain from the stress-free shape. "step": the paper's incremental
        strain, linear in a step and aligned to a side of each cell, (2.3-3 ... 2.3-14).
    pressure
        "total": the exact follower pressure. The rim of the pressurised surface must be held, or
        slide in planes x, y or z = constant that are held in their normal direction, such as planes
        of symmetry. "step": the paper's nodal forces, which keep direction and size in a step,
        (2.4-1, 2). They need no held rim; with a free rim steps are repeated until the forces equal
        the follower pressure.
    pressure_on
        The parts of the mesh on which pressure acts; all by default. A wall below the roof has the
        same air on both its sides: leave it out.
    penalty
        Factor c of the penalty mu = c E t A that keeps unfolded cells triangles; stable and not
        locking from 1e-3 to 1.
    literal_penalty
        The paper's coefficient mu = nu of (2.5-1) instead (force x length), the same everywhere.

    Raises
    ------
    InputError
        A material for a part that does not exist, cells without a material or with several,
        pressure on a part that does not exist, or step-wise strain with a material that wrinkles.

    Warns
    -----
    PenaltyWarning
        The penalty's factor lies outside the range in which folded cells are sound.
    """

    mesh: ReadOnly[MembraneMesh] = ReadOnly("membrane.mesh", ANOTHER)
    V: ReadOnly[fem.FunctionSpace] = ReadOnly("membrane.V", ANOTHER)
    """Space of the displacements."""
    u: ReadOnly[fem.Function] = ReadOnly("membrane.u", "write to its array, scene.u.x.array[:]")
    """Displacement of the vertices from the stress-free shape (length)."""
    held: ReadOnly[Booleans] = ReadOnly("membrane.held", "call scene.fix(...)")
    """Held components of the vertices, by local degree of freedom."""
    materials: ReadOnly[dict[int, MembraneMaterial]] = ReadOnly(
        "membrane.materials", "call scene.set_material(...)"
    )
    pressure: ReadOnly[float] = ReadOnly("_pressure", "call solver.advance(pressure=...)")
    """Current pressure (force per area)."""
    cables: ReadOnly[Cables] = ReadOnly("_cables", "call scene.lay_cable(...) or scene.remove(...)")
    """The laid cables, in their order."""
    terms: ReadOnly[tuple[EnergyTerm, ...]] = ReadOnly("_terms", "call scene.add_term(term)")
    """The terms of the energy that have been added."""
    floor_level: ReadOnly[float | None] = ReadOnly("_floor_level", "call scene.floor(z)")
    strain_law: ReadOnly[Law] = ReadOnly("_strain_law", "give it to Scene(..., strain=...)")
    pressure_law: ReadOnly[Law] = ReadOnly("_pressure_law", "give it to Scene(..., pressure=...)")
    penalty: ReadOnly[float] = ReadOnly("_penalty", "give it to Scene(..., penalty=...)")
    literal_penalty: ReadOnly[float | None] = ReadOnly(
        "_literal_penalty", "give it to Scene(..., literal_penalty=...)"
    )

    def __init__(
        self,
        mesh: MembraneMesh,
        material: MembraneMaterial | Mapping[str, MembraneMaterial],
        *,
        strain: Law = "total",
        pressure: Law = "total",
        pressure_on: Sequence[str] | None = None,
        penalty: float = 0.1,
        literal_penalty: float | None = None,
    ) -> None:
        if not isinstance(mesh, MembraneMesh):
            raise InputError(
                f"Scene: mesh is of type {type(mesh).__name__}; give a MembraneMesh, as the "
                "functions of crms_fenicsx.meshes return."
            )
        checks.same(
            mesh.comm, "Scene", material=material, strain=strain, pressure=pressure,
            penalty=penalty, literal_penalty=literal_penalty,
        )  # fmt: skip
        for name, value in (("strain", strain), ("pressure", pressure)):
            if value not in ("total", "step"):
                raise InputError(f"Scene: {name} = {value!r} is not known; use 'total' or 'step'.")
        self._strain_law, self._pressure_law = strain, pressure
        self._penalty = checks.positive("Scene: penalty", penalty)
        if literal_penalty is not None:
            literal_penalty = checks.positive("Scene: literal_penalty", literal_penalty)
        self._literal_penalty = literal_penalty
        super().__init__(Membrane(mesh, material, pressure_on))
        if literal_penalty is None:
            warn_of_penalty(self.comm, self.penalty)
        if strain == "step":
            self.membrane.refuse_step_strain()
        self.net = CableNet(self.membrane)
        self._shown_cables = Cables()
        self._floor_level: float | None = None
        self._pressure = 0.0
        self._terms: tuple[EnergyTerm, ...] = ()
        self.energies: dict[str, float] = {}
        """Energy of each kind of term in the current state (force x length)."""
        self.step_history: StepHistory | None = None
        """What the step-wise laws know of the load steps before; None before the first."""

    @property
    def _cables(self) -> Cables:
        if self._shown_cables != self.net.cables:
            self._shown_cables = Cables(self.net.cables)
            self._shown_cables._scene = proxy(self)
        return self._shown_cables

    @property
    def energy(self) -> float:
        """Total potential energy of the current state (force x length)."""
        return sum(self.energies.values())

    @property
    def dissipated(self) -> float:
        """Energy that friction has dissipated in all load steps (force x length)."""
        return self.net.dissipated

    @property
    def volume(self) -> float:
        """Volume gained under the cells under pressure since the stress-free shape (length cubed).

        It is the volume between the two shapes while the rim of these cells is held, or slides in
        planes that are held in their normal direction.
        """
        return gained_volume(self.net)

    def positions(self) -> Array:
        """Current positions of the vertices by local degree of freedom, (n, 3), with ghosts."""
        return self.membrane.positions()

    def vertices(self, where: str | Marker) -> Indices:
        """Local degrees of freedom of the vertices of a named group or marked by a function.

        Collective; see `Membrane.vertices`.
        """
        return self.membrane.vertices(where)

    @collective
    @changes_model
    def fix(self, where: str | Marker, directions: str = "xyz") -> None:
        """Hold vertices at their current displacement.

        A group of edges that is held in all directions is held over its whole length: its edges
        stay straight, and cables that pass over them slide along them. Of points and marked
        vertices only these are held; edges between them can fold.

        Parameters
        ----------
        where
            As for `vertices`; "boundary" is the membrane's whole boundary.
        directions
            Held components of the displacement, out of "xyz".

        Raises
        ------
        InputError
            No such vertices or directions, or edges that cables have been laid over already.
        """
        checks.same(self.comm, "fix", where=where, directions=directions)
        self.membrane.hold(where, directions, new_edges=not self.cables)

    @collective
    @changes_model
    def floor(self, z: float = 0.0) -> None:
        """Put a rigid, frictionless floor at height z: no vertex or fold point goes below it.

        Raises
        ------
        InputError
            If the membrane is below it now.
        """
        checks.same(self.comm, "floor", z=z)
        z = checks.finite("floor: z", z)
        self.membrane.check_finite("floor")
        heights = self.positions()[:, 2]
        with raised_together(self.comm):
            if len(heights) and heights.min() < z:
                raise InputError(
                    f"floor: the membrane is at z = {heights.min():g}, below the floor z = {z:g}; "
                    "put the floor lower."
                )
        self._floor_level = z

    @collective
    @changes_model
    def add_term(self, term: EnergyTerm) -> None:
        """Add a term of your own to the potential energy; load steps minimise it with the rest.

        Its energy is in `energies` under its name, and its forces are loads: supports carry them.
        Terms are no part of checkpoints. A script that goes on from one adds them again.

        Parameters
        ----------
        term
            See `EnergyTerm`; `taylor_test` checks its derivatives.

        Raises
        ------
        InputError
            On all ranks: it is no `EnergyTerm`, its name is taken, or its sums, energy or forces
            are not finite in the current state.
        """
        checks.same(self.comm, "add_term", term=term, name=getattr(term, "name", None))
        self.membrane.check_finite("add_term")
        taken = [other.name for other in self.terms]
        term, energy = checked_energy(term, self.u, self.membrane.cell_tags, taken)
        self._terms = (*self._terms, term)
        self.energies = {**self.energies, term.name: energy}

    def cable(self, name: str) -> LaidCable:
        """The cable with a name.

        Raises
        ------
        InputError
            There is none.
        """
        return self.net.cable(name)

    @collective
    @changes_model
    def lay_cable(
        self,
        cable: Cable,
        path: Sequence[Sequence[float] | Joint] | Array,
        *,
        L0: float | None = None,
        tension: float | None = None,
        shortest: bool = False,
        sleeve: bool = False,
        layer: int = 0,
        name: str | None = None,
        measured_on: Literal["surface", "facets"] = "surface",
    ) -> LaidCable:
        """Lay a cable on the membrane's current shape.

        The cable lies on the membrane's outer side and spans hollows in a straight line; at a seam
        of three or more parts it stays on those that bound the outer side, never on a wall below.
        Its unstressed length makes it just taut, unless `L0` or `tension` is given. An end on a
        held edge of the membrane is held there; moved along the boundary it goes from edge to edge,
        moved off the boundary it slides over the edge. An end elsewhere on the membrane is tied to
        that place. In load steps the cable slides, also sideways, as far as friction permits, lifts
        off and touches down.

        Parameters
        ----------
        cable
            Its data.
        path
            Points of its path: in plan, (k, 2), or in space, (k, 3). A first or last point in
            space that lies off the membrane is an anchor, from which the cable runs straight to
            the membrane: beyond the boundary to where it first meets it, over the membrane to the
            place below. A `Joint` as first or last point (the others in space) holds the end.
        L0
            Unstressed length (length).
        tension
            Tension at laying (force), from which the unstressed length follows.
        shortest
            Whether to lay the cable along the shortest path on the membrane near `path`, where a
            cable without friction lies, instead of `path` itself.
        sleeve
            Whether a sleeve holds the cable to the membrane: the cable slides, but cannot lift off.
            A cable along free edges of the membrane always has a sleeve, and stays there.
        layer
            Of two crossing cables the one with the higher layer lies on top; with equal layers the
            one laid later.
        name
            Name in results; "cable 1", "cable 2" ... by default.
        measured_on
            Without `L0`: whether to measure the length on the smooth "surface" through the
            vertices, or on the "facets" inside, too short; ``Cable(law="step")`` uses the facets.

        Returns
        -------
        LaidCable
            The cable, as a handle for load steps and results.

        Raises
        ------
        PathError
            The path cannot be laid: it leaves the membrane, could only go around its back, begins
            inside of it, goes to a part behind a seam, or returns through the cells that it left
            by.
        InputError
            L0 or tension that is not positive, or both, or a name that is taken.
        """
        from crms_fenicsx.paths.laying import lay

        given: dict[str, Any] = {
            "L0": L0, "tension": tension, "shortest": shortest, "sleeve": sleeve, "layer": layer,
            "name": name, "measured_on": measured_on,
        }  # fmt: skip
        checks.same(self.comm, "lay_cable", cable=cable, path=path, **given)
        self.membrane.check_finite("lay_cable")
        given["layer"] = checks.whole("lay_cable: layer", layer, 0)
        route, joints = self.frame.path_of(path)
        laid = lay(self.net, cable, route, **given, joints=joints)
        return laid

    def _check_strain_law(self) -> None:
        if self.strain_law == "step":
            raise InputError(
                'set_material: strain="step" goes on from stresses of the material before; use '
                'strain="total", or make another Scene(...).'
            )

    def _stretched(self) -> tuple[LaidCable | PlacedBar, ...]:
        return *self.cables, *super()._stretched()

    def _used_joints(self) -> set[str | None]:
        """Names of the joints that loads and cables need."""
        return super()._used_joints().union(*(cable.joints for cable in self.cables))

    @collective
    @changes_model
    def remove(self, cable: LaidCable | str) -> None:
        """Take a cable away; the next load step finds the equilibrium without it.

        What other cables had to do with it ends: where they crossed it they lie on the membrane,
        or on the cables below. The energy that its friction has dissipated stays in `dissipated`,
        and what it was before in tables and pictures. A new cable may have its name.

        Parameters
        ----------
        cable
            A cable of this scene, or its name.

        Raises
        ------
        InputError
            On all ranks: there is no such cable.
        """
        checks.same(self.comm, "remove", cable=cable)
        self.net.remove(cable)
