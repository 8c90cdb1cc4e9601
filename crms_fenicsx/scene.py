"""The scene: a membrane, where it is held, its cables and loads, and its current state."""

from __future__ import annotations

import warnings
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import MeshTags, meshtags

from crms_fenicsx.energies.checked_term import checked_energy
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.meshes import MembraneMesh
from crms_fenicsx.meshes.cell_geometry import area_vectors
from crms_fenicsx.model.materials import LINEAR, Membrane
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, PenaltyWarning, collective, raised_together
from crms_fenicsx.runtime.readonly import ReadOnly

if TYPE_CHECKING:
    from crms_fenicsx.cables.strip import Strip
    from crms_fenicsx.energies.dead_load import DeadForces, Traction
    from crms_fenicsx.energies.paper.step_history import StepHistory
    from crms_fenicsx.energies.pressure_rim import Rim
    from crms_fenicsx.meshes.cell_geometry import OpenEdges
    from crms_fenicsx.model.cable import Cable
    from crms_fenicsx.model.crossing import Crossing
    from crms_fenicsx.model.laid_cable import LaidCable

Marker = Callable[[Array], npt.NDArray[np.bool_]]
Law = Literal["total", "step"]

STABLE_PENALTY = (1e-3, 1.0)
"""Penalty factors between which folded cells are stable and do not lock."""
COMPONENTS = {"x": 0, "y": 1, "z": 2}


class Cables(tuple["LaidCable", ...]):
    """The cables of a scene in the order of laying; `remove` is all that changes them."""

    _scene: weakref.ref[Scene]

    @classmethod
    def of(cls, scene: Scene, cables: Iterable[LaidCable]) -> Cables:
        """Some cables of a scene."""
        new = cls(cables)
        new._scene = weakref.ref(scene)
        return new

    def remove(self, cable: LaidCable | str) -> None:
        """Take a cable away; see `Scene.remove`. Collective."""
        scene = self._scene()
        assert scene is not None, "its cables outlive the scene"
        scene.remove(cable)


class Scene:
    """A cable-reinforced membrane structure and its current state.

    Units are the user's: any consistent set of length and force.

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
        "total": the exact follower pressure. The rim of what is under pressure must be held, or
        slide in planes x, y or z = constant that are held in their normal direction, as planes of
        symmetry are. "step": the paper's nodal forces, which keep direction and size in a step,
        (2.4-1, 2). They need no held rim; where it is free steps are repeated until the forces are
        those of the follower pressure.
    pressure_on
        The parts of the mesh on which pressure acts; all of it by default. A wall below the roof
        has the same air on both its sides: leave it out.
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

    pressure: ReadOnly[float] = ReadOnly("_pressure", "call solver.advance(pressure=...)")
    """Current pressure (force per area)."""
    load: ReadOnly[float] = ReadOnly("_load", "call solver.advance(load=...)")
    """Current factor of the dead load."""
    cables: ReadOnly[Cables] = ReadOnly("_cables", "call scene.lay_cable(...) or scene.remove(...)")
    """The laid cables, in their order."""
    terms: ReadOnly[tuple[EnergyTerm, ...]] = ReadOnly("_terms", "call scene.add_term(term)")
    """The terms of the energy that have been added."""
    dead_forces: ReadOnly[DeadForces | None] = ReadOnly("_dead_forces", "call scene.put_load(...)")
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
        material: Membrane | Mapping[str, Membrane],
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
            mesh.comm,
            "Scene",
            material=material,
            strain=strain,
            pressure=pressure,
            penalty=penalty,
            literal_penalty=literal_penalty,
        )
        for name, value in (("strain", strain), ("pressure", pressure)):
            if value not in ("total", "step"):
                raise InputError(f"Scene: {name} = {value!r} is not known; use 'total' or 'step'.")
        self.mesh, self.comm = mesh, mesh.comm
        self._strain_law, self._pressure_law = strain, pressure
        self._penalty = checks.positive("Scene: penalty", penalty)
        self._literal_penalty = (
            None
            if literal_penalty is None
            else checks.positive("Scene: literal_penalty", literal_penalty)
        )
        self._warn_of_penalty()
        self.cell_tags, self.materials = _assign_materials(mesh, material)
        for own in self.materials.values():
            if strain == "step" and own.law != LINEAR:
                raise InputError(
                    f'Scene: strain="step" has no wrinkling model, but the material is {own}; '
                    "give it wrinkling=False."
                )
        self.pressed = _pressed_cells(mesh, pressure_on)
        """Whether pressure acts on each local cell."""
        self.V = fem.functionspace(mesh.mesh, ("Lagrange", 1, (3,)))
        self.u = fem.Function(self.V, name="displacement")
        """Displacement of the vertices from the stress-free shape (length)."""
        self.held = np.zeros((len(self.u.x.array) // 3, 3), dtype=bool)
        """Held components of the vertices, by local degree of freedom."""
        edges = mesh.mesh.topology.index_map(1)
        self.held_edges = np.zeros(edges.size_local + edges.num_ghosts, dtype=bool)
        """Edges that are held over their whole length, by local number."""
        self._floor_level: float | None = None
        self._pressure = self._load = 0.0
        self._dead_forces: DeadForces | None = None
        self._terms: tuple[EnergyTerm, ...] = ()
        self._cables = Cables.of(self, ())
        self._laid = 0
        self._dissipated = 0.0
        """How many cables have been laid, and what friction of those that are gone has dissipated.
        """
        self.strip: Strip | None = None
        self.crossings: list[Crossing] = []
        self.energies: dict[str, float] = {}
        """Energy of each kind of term in the current state (force x length)."""
        self.changes = 0
        """Counts what needs a new set-up of the solver."""
        self.commits = 0
        """Counts the states that load steps and checkpoints have brought it to."""
        self.step_history: StepHistory | None = None
        """What the step-wise laws know of the load steps before; None before the first."""

    @property
    def energy(self) -> float:
        """Total potential energy of the current state (force x length)."""
        return sum(self.energies.values())

    @property
    def dissipated(self) -> float:
        """Energy that friction has dissipated in all load steps (force x length)."""
        return self._dissipated + sum(cable.dissipated for cable in self.cables)

    @property
    def volume(self) -> float:
        """Volume gained under the cells under pressure since the stress-free shape (length cubed).

        It is the volume between the two shapes while the rim of these cells is held, or slides in
        planes that are held in their normal direction.
        """
        from crms_fenicsx.cables.enclosed_volume import gained_volume

        return gained_volume(self)

    @cached_property
    def open_edges(self) -> OpenEdges:
        """Edges that pressure needs to be held; see `loads.open_edges`. Collective."""
        from crms_fenicsx.meshes.cell_geometry import open_edges

        return open_edges(self.V, self.pressed)

    def rim(self) -> Rim:
        """How the `open_edges` are held in the current state. Collective."""
        from crms_fenicsx.energies.pressure_rim import rim_of

        return rim_of(self.open_edges, self.V, self.held, self.positions(), self.size)

    @cached_property
    def stress_free(self) -> Array:
        """Stress-free positions (length) of the vertices by degree of freedom, (n, 3), read-only.

        With ghosts, as `positions`.
        """
        positions: Array = self.V.tabulate_dof_coordinates()
        positions.flags.writeable = False
        return positions

    @cached_property
    def centre(self) -> Array:
        """Mean stress-free position (length), from which volumes count. Collective."""
        vertices = self.V.dofmap.index_map
        total = self.comm.allreduce(self.stress_free[: vertices.size_local].sum(axis=0))
        return np.asarray(total / vertices.size_global)

    @cached_property
    def size(self) -> float:
        """Square root of the stress-free area (length). Collective."""
        owned = self.mesh.mesh.topology.index_map(2).size_local
        areas = np.linalg.norm(area_vectors(self.mesh.mesh)[:owned], axis=1)
        return float(np.sqrt(self.comm.allreduce(float(areas.sum()))))

    def positions(self) -> Array:
        """Current positions of the vertices by local degree of freedom, (n, 3), with ghosts."""
        return self.stress_free + self.u.x.array.reshape(-1, 3)

    def check_finite(self, purpose: str) -> None:
        """Refuse to go on from a displacement that is not finite.

        Parameters
        ----------
        purpose
            What needs it, for the message.

        Raises
        ------
        InputError
            On all ranks, naming a place.
        """
        with raised_together(self.comm):
            u = self.u.x.array.reshape(-1, 3)
            bad = ~np.isfinite(u).all(axis=1)
            if bad.any():
                first = int(np.argmax(bad))
                raise InputError(
                    f"{purpose}: scene.u is {u[first]} at the vertex "
                    f"{self.stress_free[first]}; set it to finite displacements."
                )

    def _warn_of_penalty(self) -> None:
        lower, upper = STABLE_PENALTY
        if self.literal_penalty is not None or lower <= self.penalty <= upper:
            return
        if self.comm.rank == 0:
            happens = (
                "folded cells are unstable, as sides in compression repel their fold points"
                if self.penalty < lower
                else "folded cells lock and cables come out too tight"
            )
            warnings.warn(
                f"Scene: penalty = {self.penalty:g} lies outside {lower:g} ... {upper:g}: "
                f"{happens}; give one in this range.",
                PenaltyWarning,
                stacklevel=3,
            )

    @collective
    def vertices(self, where: str | Marker) -> npt.NDArray[np.int32]:
        """Local degrees of freedom of the vertices of a named group or marked by a function.

        Parameters
        ----------
        where
            Name of a group of edges or points, or a function of stress-free coordinates (3, n)
            that returns (n,) booleans.

        Raises
        ------
        InputError
            No such group, or no vertex is marked.
        """
        checks.same(self.comm, "vertices", where=where)
        mesh = self.mesh
        dofs: npt.NDArray[np.int32] = np.zeros(0, dtype=np.int32)
        with raised_together(self.comm):
            if callable(where):
                marks = np.asarray(where(self.V.tabulate_dof_coordinates().T))
                if marks.shape != (len(self.held),) or marks.dtype != bool:
                    raise InputError(
                        f"vertices: the marker returned {marks.dtype} of shape {marks.shape}; it "
                        f"must return booleans of shape {(len(self.held),)}."
                    )
                dofs = np.flatnonzero(marks).astype(np.int32)
            elif not isinstance(where, str):
                raise InputError(
                    f"vertices: {where!r} is no group; give the name of one group or a function "
                    "of coordinates."
                )
            elif where not in mesh.edges and where not in mesh.points:
                names = ", ".join(sorted({*mesh.edges, *mesh.points}))
                raise InputError(
                    f"vertices: the mesh has no group of edges or points {where!r}; it has {names}."
                )
        if not callable(where):
            dimension, members = (
                (1, mesh.edges[where]) if where in mesh.edges else (0, mesh.points[where])
            )
            dofs = fem.locate_dofs_topological(self.V, dimension, members)
        found = self.comm.allreduce(len(dofs))
        if found == 0:
            what = "the marker function" if callable(where) else f"the group {where!r}"
            raise InputError(f"vertices: {what} marks no vertex of the membrane; mark one or more.")
        return dofs

    @collective
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
        if not isinstance(directions, str) or not directions or set(directions) - set(COMPONENTS):
            raise InputError(
                f"fix: directions = {directions!r} must be made of the letters x, y and z."
            )
        dofs = self.vertices(where)
        edges: npt.NDArray[np.int32] = np.zeros(0, dtype=np.int32)
        if isinstance(where, str) and where in self.mesh.edges and set(directions) == set("xyz"):
            edges = self.mesh.edges[where]
        new = self.comm.allreduce(int(np.count_nonzero(~self.held_edges[edges])))
        if new and self.cables:
            raise InputError(
                f"fix: {where!r} would be held after cables have been laid, which slide along held "
                "edges without folding them; hold edges first."
            )
        for letter in directions:
            self.held[dofs, COMPONENTS[letter]] = True
        self.held_edges[edges] = True
        self.changes += 1

    @collective
    def floor(self, z: float = 0.0) -> None:
        """Put a rigid, frictionless floor at height z: no vertex or fold point goes below it.

        Raises
        ------
        InputError
            If the membrane is below it now.
        """
        checks.same(self.comm, "floor", z=z)
        z = checks.finite("floor: z", z)
        self.check_finite("floor")
        heights = self.positions()[:, 2]
        with raised_together(self.comm):
            if len(heights) and heights.min() < z:
                raise InputError(
                    f"floor: the membrane is at z = {heights.min():g}, below the floor z = {z:g}; "
                    "put the floor lower."
                )
        self._floor_level = z
        self.changes += 1

    @collective
    def put_load(self, force: Traction) -> None:
        """Put a dead load on the membrane's current shape; `Solver.advance` brings it on.

        Its forces follow from the areas and normals of the current shape, and then keep direction
        and size. That is right for snow and for weight (put on the stress-free shape). For wind it
        is right up to the rotation of the surface and the change of its area since; where that is
        too much, put the load again in the equilibrium that it led to and advance with the same
        factor. Each time the error shrinks by about the share that it had at first.

        Parameters
        ----------
        force
            Force per area (force / length squared): (3,), or a function of points (3, n) on the
            current surface and of its unit normals (3, n), which point to the side that pressure
            pushes to, that returns (3, n). It replaces the load that there is, at its factor.

        Raises
        ------
        InputError
            On all ranks: a force that is not finite or of another shape.
        """
        from crms_fenicsx.energies.dead_load import dead_forces

        checks.same(self.comm, "put_load", force=force)
        self.check_finite("put_load")
        self._dead_forces = dead_forces(self, force)
        self.changes += 1

    @collective
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
        self.check_finite("add_term")
        taken = [other.name for other in self.terms]
        term, energy = checked_energy(term, self.u, self.cell_tags, taken)
        self._terms = (*self._terms, term)
        self.energies = {**self.energies, term.name: energy}
        self.changes += 1

    def cable(self, name: str) -> LaidCable:
        """The cable with a name.

        Raises
        ------
        InputError
            There is none.
        """
        for cable in self.cables:
            if cable.name == name:
                return cable
        names = ", ".join(repr(cable.name) for cable in self.cables) or "none"
        raise InputError(f"cable: there is no cable {name!r}; there are {names}.")

    @collective
    def lay_cable(
        self,
        cable: Cable,
        path: Sequence[Sequence[float]] | Array,
        *,
        L0: float | None = None,
        tension: float | None = None,
        sleeve: bool = False,
        level: int = 0,
        name: str | None = None,
    ) -> LaidCable:
        """Lay a cable on the membrane's current shape.

        It lies on the membrane's outer side, drawn straight over hollows; at a seam of three parts
        or more it stays on those that bound the outer side, never on a wall below. It gets the
        length that makes it just taut, unless `L0` or `tension` is given. Where it ends on a held
        edge of the membrane it is held there; moved along the boundary its end goes from edge to
        edge, moved off it slides over the edge. Where it ends elsewhere on the membrane it is tied
        to that place. In load steps it slides, also sideways, as far as its friction lets it, lifts
        off and touches down.

        Parameters
        ----------
        cable
            Its data.
        path
            Points of its path: in plan, (k, 2), or in space, (k, 3). A first or last point in
            space that lies off the membrane is an anchor, from which the cable runs straight to
            the membrane: beyond the boundary to where it first meets it, over the membrane to the
            place below.
        L0
            Unstressed length (length).
        tension
            Tension at laying (force), from which the unstressed length follows.
        sleeve
            Whether a sleeve holds the cable to the membrane: it slides, but cannot lift off.
        level
            Of two cables that cross the one with the higher level lies on top; of equal ones the
            one laid later.
        name
            Name in results; "cable 1", "cable 2" ... by default.

        Returns
        -------
        LaidCable
            The cable, as a handle for load steps and results.

        Raises
        ------
        PathError
            The path cannot be laid, as one that leaves the membrane, could only go around its
            back, begins inside of it, goes to a part behind a seam, or comes back through the
            cells that it went out by.
        InputError
            L0 or tension that is not positive, or both, or a name that is taken.
        """
        from crms_fenicsx.paths.laying import lay

        given = {"L0": L0, "tension": tension, "sleeve": sleeve, "level": level, "name": name}
        checks.same(self.comm, "lay_cable", cable=cable, path=path, **given)
        self.check_finite("lay_cable")
        level = checks.whole("lay_cable: level", level, 0)
        laid = lay(self, cable, path, L0=L0, tension=tension, sleeve=sleeve, level=level, name=name)
        self.changes += 1
        return laid

    @collective
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
        from crms_fenicsx.paths.removing import remove

        checks.same(self.comm, "remove", cable=cable)
        remove(self, cable)
        self.changes += 1


def _assign_materials(
    mesh: MembraneMesh, material: Membrane | Mapping[str, Membrane]
) -> tuple[MeshTags | None, dict[int, Membrane]]:
    """Cell tags of the parts with a material of their own (None if there is one for all)."""
    if isinstance(material, Membrane):
        return None, {0: material}
    if not isinstance(material, Mapping):
        raise InputError(
            f"Scene: material = {material!r} is none; give a membrane such as IsotropicMembrane, "
            "or a mapping from the mesh's parts to membranes."
        )
    given = sorted(material.items(), key=lambda item: repr(item[0]))  # alike on all ranks
    n = mesh.mesh.topology.index_map(2).size_local + mesh.mesh.topology.index_map(2).num_ghosts
    tags = np.full(n, -1, dtype=np.int32)
    with raised_together(mesh.comm):
        for k, (part, value) in enumerate(given):
            if part not in mesh.parts:
                raise InputError(
                    f"Scene: the mesh has no part {part!r}; it has "
                    f"{', '.join(sorted(mesh.parts)) or 'none'}."
                )
            if not isinstance(value, Membrane):
                raise InputError(f"Scene: the material of part {part!r} is {value!r}, no Membrane.")
            own = mesh.parts[part]
            if np.any(tags[own] >= 0):
                shared = next(p for p, _ in given[:k] if np.isin(mesh.parts[p], own).any())
                raise InputError(
                    f"Scene: part {part!r} shares cells with part {shared!r}, which has a material "
                    "as well; give each cell one material."
                )
            tags[own] = k
        if np.any(tags < 0):
            raise InputError(
                f"Scene: {np.count_nonzero(tags < 0)} cells have no material; give one for "
                "every part of the mesh."
            )
    cells = np.arange(n, dtype=np.int32)
    return meshtags(mesh.mesh, 2, cells, tags), {k: value for k, (_, value) in enumerate(given)}


def _pressed_cells(mesh: MembraneMesh, pressure_on: Sequence[str] | None) -> npt.NDArray[np.bool_]:
    """Whether pressure acts on each local cell, (n,)."""
    cells = mesh.mesh.topology.index_map(2)
    n = cells.size_local + cells.num_ghosts
    if pressure_on is None:
        return np.ones(n, dtype=bool)
    if isinstance(pressure_on, str) or not isinstance(pressure_on, Sequence):
        raise InputError(
            f'Scene: pressure_on = {pressure_on!r} is no list of parts; write pressure_on=["roof"].'
        )
    pressed = np.zeros(n, dtype=bool)
    for part in pressure_on:
        if part not in mesh.parts:
            raise InputError(
                f"Scene: pressure_on has {part!r}, but the mesh has the parts "
                f"{', '.join(sorted(mesh.parts)) or '(none)'}; name some of these."
            )
        pressed[mesh.parts[part]] = True
    return pressed
