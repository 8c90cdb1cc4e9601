"""The membrane: mesh, displacements, supports, materials, penalty and pressurised cells."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import MeshTags, meshtags
from mpi4py import MPI

from crms_fenicsx.foundation.dofs.layout import vertex_places
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.first_surface import FirstSurface
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids, cells_of, outer_first
from crms_fenicsx.foundation.meshes.placed_fields import PlacedFields
from crms_fenicsx.foundation.meshes.triangles import (
    OpenEdges,
    area_vectors,
    open_edges,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers, Rows
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap, require_real
from crms_fenicsx.foundation.runtime.errors import (
    InputError,
    PathError,
    PenaltyWarning,
    raised_together,
)
from crms_fenicsx.model.frames import checked_frames, own_areas
from crms_fenicsx.model.materials import LINEAR, UFL_LAW, MembraneMaterial
from crms_fenicsx.model.strengths import FabricDesign

STABLE_PENALTY = (1e-3, 1.0)
"""Range of penalty factors in which folded cells are stable and do not lock."""


def warn_of_penalty(comm: MPI.Intracomm, penalty: float) -> None:
    """Warn on rank 0 of a penalty factor outside `STABLE_PENALTY`."""
    lower, upper = STABLE_PENALTY
    if lower <= penalty <= upper or comm.rank > 0:
        return
    happens = (
        "folded cells are unstable, as sides in compression repel their fold points"
        if penalty < lower
        else "folded cells lock and cables come out too tight"
    )
    warnings.warn(
        f"Scene: penalty = {penalty:g} lies outside {lower:g} ... {upper:g}: {happens}; use one "
        "in this range.",
        PenaltyWarning,
        stacklevel=4,
    )


Marker = Callable[[Array], Booleans]
"""Function of stress-free coordinates (3, n) that returns Booleans (n,)."""
COMPONENTS = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class MembraneState:
    """Variable data of a membrane; see the attributes of `Membrane`."""

    u: Annotated[Array, Rows.VERTICES, 3] = field(repr=False)  # displacements of the vertices
    held: Annotated[Booleans, Rows.VERTICES, 3] = field(repr=False)
    held_edges: Annotated[Booleans, Rows.EDGES] = field(repr=False)
    materials: tuple[MembraneMaterial, ...]  # by material number
    # displacements of the stress-free places from those of the mesh as given; None before any moved
    moved: Annotated[Array, Rows.VERTICES, 3] | None = field(default=None, repr=False)


class Membrane:
    """A membrane and its current shape."""

    def __init__(
        self,
        mesh: MembraneMesh,
        material: MembraneMaterial | Mapping[str, MembraneMaterial],
        pressure_on: Sequence[str] | None = None,
        frames: Array | None = None,
    ) -> None:
        require_real()
        mesh = mesh.of_scene()
        self.mesh, self.comm = mesh, mesh.comm
        _ = mesh.overlaps  # computed now; needed wherever parts are named
        # tags: material number of each cell, None with a single material; materials by number
        # and parts by the number of their material
        self.cell_tags, self.materials, self.parts = _assign_materials(mesh, material)
        self.first_materials = dict(self.materials)  # before `Scene.set_material`
        self.pressed = _pressed_cells(mesh, pressure_on)  # whether pressure acts on each local cell
        self.pressure_on = pressure_on
        self.V = fem.functionspace(mesh.mesh, ("Lagrange", 1, (3,)))
        self.u = fem.Function(self.V, name="displacement")  # from the stress-free shape (length)
        # (n, 3) held components of the vertices; edges held over their whole length
        self.held = np.zeros((len(self.u.x.array) // 3, 3), dtype=bool)
        edges = mesh.mesh.topology.index_map(1)
        self.held_edges = np.zeros(edges.size_local + edges.num_ghosts, dtype=bool)
        # (n, 2, 3) images in the mesh of the unit vectors along warp and weft of the cells' own
        # stress-free shapes; None where the mesh is stress-free
        self.frames = None if frames is None else checked_frames(mesh, frames)
        # for results only, not part of the state: strengths by part, and radii of reinforcement by
        # group of points
        self.strengths: dict[str, FabricDesign] = {}
        self.patches: dict[str, float] = {}
        # stress-free places in the mesh as given, displacements from there as in `MembraneState`,
        # and how often these have changed: the key of data that depend on them
        self.given = self.stress_free
        self.moved: Array | None = None
        self.placement = 0

    @property
    def has_warp(self) -> bool:
        """Whether a material or the cells' own shapes have a warp direction."""
        return self.frames is not None or any(x.warp is not None for x in self.materials.values())

    @cached_property
    def isotropic(self) -> Booleans:
        """Whether the material of each of this rank's own cells has no axes, (n,)."""
        own = self.mesh.mesh.topology.index_map(2).size_local
        tags = np.zeros(own, int) if self.cell_tags is None else self.cell_tags.values[:own]
        return np.array([x.warp is None for x in self.materials.values()])[tags]

    @property
    def state(self) -> MembraneState:
        """Copy of the variable data."""
        return MembraneState(
            self.u.x.array.reshape(-1, 3).copy(), self.held.copy(), self.held_edges.copy(),
            tuple(self.materials.values()), self.moved,
        )  # fmt: skip

    @state.setter
    def state(self, state: MembraneState) -> None:
        self.u.x.array[:], self.held[:] = state.u.ravel(), state.held
        self.held_edges[:] = state.held_edges
        self.materials.update(zip(self.materials, state.materials, strict=True))
        if state.moved is not self.moved:
            self._move(state.moved)

    def place_stress_free(self, X: Array) -> None:
        """Move the stress-free places of the vertices to X (n, 3), by local degree of freedom with
        ghosts; displacements stay. Scenes do it by `place_stress_free` there. Collective."""
        if self.frames is not None:
            raise InputError(
                "lines of the mesh slide, but its cells have stress-free shapes of their own, from "
                "patterns.sew, which cannot follow; hold the lines with slide=False."
            )
        owned = la.vector(self.V.dofmap.index_map, 3, dtype=np.float64)
        owned.array[:] = (X - self.given).ravel()
        owned.scatter_forward()
        self._move(owned.array.reshape(-1, 3).copy())

    def _move(self, moved: Array | None) -> None:
        """Place the vertices at given displacements from the mesh as given. Collective."""
        # origin and scale, collective at first: always those of the mesh as given
        _ = self.centre, self.size
        X = self.given if moved is None else self.given + moved
        self.mesh.mesh.geometry.x[geometry_dofmap(self.mesh.mesh)] = X[self.V.dofmap.list]
        for name in ("stress_free", "cell_areas"):
            self.__dict__.pop(name, None)
        if moved is not None:
            moved.flags.writeable = False  # states share it
        self.moved, self.placement = moved, self.placement + 1

    @cached_property
    def open_edges(self) -> OpenEdges:
        """Edges of the pressurised cells that must be held. Collective."""
        return open_edges(self.V, self.pressed)

    @cached_property
    def stress_free(self) -> Array:
        """Stress-free positions (n, 3) (length) of the vertices, with ghosts; read-only."""
        positions = vertex_places(self.V)
        positions.flags.writeable = False
        return positions

    @cached_property
    def cell_areas(self) -> Array:
        """Stress-free areas (n,) (length squared) of this rank's own cells."""
        own = self.mesh.mesh.topology.index_map(2).size_local
        areas = np.linalg.norm(area_vectors(self.mesh.mesh)[:own], axis=1)
        return areas if self.frames is None else areas * own_areas(self.frames[:own])

    @cached_property
    def kinds(self) -> Indices:
        """Kinds of this rank's cells, (n,): numbers by material and whether pressure acts."""
        tags = np.zeros(len(self.pressed), dtype=np.int64)
        if self.cell_tags is not None:
            tags[self.cell_tags.indices] = self.cell_tags.values
        return np.asarray(2 * tags + self.pressed)

    @cached_property
    def first_surface(self) -> FirstSurface:
        """The mesh as given, on all ranks. Collective."""
        return FirstSurface(self.V, self.vertex_ids, self.given)

    def at_places(self, data: Array, places: Array) -> Array:
        """Values (n, ...) of a field in this rank's cells at their present stress-free places, from
        its values (n, ...) when these were at `places` (k, 3). Collective."""
        if self.moved is None:
            return data
        fields = self._first_fields
        if not self.comm.allreduce(np.array_equal(places, self.given), op=MPI.LAND):
            surface = FirstSurface(self.V, self.vertex_ids, places)
            fields = PlacedFields(self.V, surface, self.kinds)
        return fields.values(data, self.stress_free)

    @cached_property
    def _first_fields(self) -> PlacedFields:
        return PlacedFields(self.V, self.first_surface, self.kinds)

    @cached_property
    def nodal_values(self) -> fem.FunctionSpace:
        """P1 space of results at vertices. Collective."""
        return fem.functionspace(self.mesh.mesh, ("Lagrange", 1))

    @cached_property
    def cell_values(self) -> fem.FunctionSpace:
        """DG0 space of results in cells. Collective."""
        return fem.functionspace(self.mesh.mesh, ("Discontinuous Lagrange", 0))

    @cached_property
    def vertex_ids(self) -> Integers:
        """Vertex numbers in the mesh as given, by degree of freedom, (n,)."""
        ids = np.zeros(len(self.held), dtype=np.int64)
        ids[self.V.dofmap.list] = cell_vertex_ids(self.mesh.mesh)
        return ids

    @cached_property
    def centre(self) -> Array:
        """Mean position in the mesh as given (length), the origin of volumes. Collective."""
        vertices = self.V.dofmap.index_map
        total = self.comm.allreduce(self.stress_free[: vertices.size_local].sum(axis=0))
        return np.asarray(total / vertices.size_global)

    @cached_property
    def size(self) -> float:
        """Square root of the area of the mesh as given (length). Collective."""
        areas = np.linalg.norm(area_vectors(self.mesh.mesh), axis=1)
        return float(np.sqrt(self.comm.allreduce(float(areas.sum()))))

    def positions(self) -> Array:
        """Current positions of the vertices by local degree of freedom, (n, 3), with ghosts."""
        return self.stress_free + self.u.x.array.reshape(-1, 3)

    def positions_in(self, state: MembraneState) -> Array:
        """The same in another state of this membrane."""
        X = self.given if state.moved is None else self.given + state.moved
        return np.asarray(X + state.u)

    @property
    def owned_u(self) -> Array:
        """Displacements of this rank's own vertices, flat, without ghosts."""
        return self.u.x.array[: 3 * self.V.dofmap.index_map.size_local]

    def check_finite(self, purpose: str) -> None:
        """Refuse displacements that are not finite."""
        with raised_together(self.comm):
            u = self.u.x.array.reshape(-1, 3)
            bad = ~np.isfinite(u).all(axis=1)
            if bad.any():
                first = int(np.argmax(bad))
                raise InputError(
                    f"{purpose}: scene.u is {u[first]} at the vertex "
                    f"{self.stress_free[first]}; set it to finite displacements."
                )

    @collective
    def vertices(self, where: str | Marker) -> Indices:
        """Local degrees of freedom of the vertices of a group or marked by a function."""
        mesh = self.mesh
        dofs: Indices = np.zeros(0, dtype=np.int32)
        with raised_together(self.comm):
            if callable(where):
                marks = np.asarray(where(vertex_places(self.V).T))
                if marks.shape != (len(self.held),) or marks.dtype != bool:
                    raise InputError(
                        f"vertices: the marker returned {marks.dtype} of shape {marks.shape}; it "
                        f"must return booleans of shape {(len(self.held),)}."
                    )
                dofs = np.flatnonzero(marks).astype(np.int32)
            elif not isinstance(where, str):
                raise InputError(
                    f"vertices: {where!r} is not a group; pass the name of one group or a function "
                    "of coordinates."
                )
            elif where not in mesh.edges and where not in mesh.points:
                names = ", ".join(sorted({*mesh.edges, *mesh.points}, key=checks.as_counted))
                raise InputError(
                    f"vertices: the mesh has no group of edges or points {where!r}; it has {names}."
                )
        if not callable(where):
            dimension, groups = (1, mesh.edges) if where in mesh.edges else (0, mesh.points)
            dofs = fem.locate_dofs_topological(self.V, dimension, groups[where])
        if self.comm.allreduce(len(dofs)) == 0:
            what = "the marker function" if callable(where) else f"the group {where!r}"
            raise InputError(f"vertices: {what} marks no vertex of the membrane; mark one or more.")
        return dofs

    def owner_of_material(self, number: int) -> str:
        """Owner of a material in messages: a part or the membrane."""
        return f"part {self.parts[number]!r}" if self.parts else "the membrane"

    def refuse_step_strain(self) -> None:
        """Refuse frames and materials that the paper's step-wise strain does not support."""
        if self.frames is not None:
            raise InputError(
                'Scene: strain="step" starts from the mesh as the stress-free shape, but there are '
                'frames of other shapes; use strain="total".'
            )
        for number, own in self.materials.items():
            if own.law == UFL_LAW:
                raise InputError(
                    'Scene: strain="step" has a linear law of its own, but '
                    f"{self.owner_of_material(number)} has a UflMembrane; use "
                    'strain="total", or use an IsotropicMembrane or OrthotropicMembrane.'
                )
            if own.law != LINEAR:
                raise InputError(
                    f'Scene: strain="step" has no wrinkling model, but the material is {own}; '
                    "set its wrinkling=False."
                )

    def refuse_folds(self, cells: Indices, cable: str) -> None:
        """Refuse a cable over cells whose material has no compiled law. Collective."""
        uncompiled = [k for k, own in self.materials.items() if own.law == UFL_LAW]
        if not uncompiled:
            return
        with raised_together(self.comm):
            tags = self.cell_tags
            numbers = np.zeros(len(cells), int) if tags is None else tags.values[cells]
            bad = numbers[np.isin(numbers, uncompiled)]
            if len(bad):
                raise PathError(
                    f"{cable}: {self.owner_of_material(int(bad[0]))} has a UflMembrane, which "
                    "cells that a cable folds cannot have; lead the cable over other parts, or "
                    "use an IsotropicMembrane or OrthotropicMembrane under it."
                )

    def hold(self, where: str | Marker, directions: str, new_edges: bool) -> None:
        """Hold vertices at their current displacement, and edges over their length. Collective."""
        checks.directions("fix", directions)
        dofs = self.vertices(where)
        edges: Indices = np.zeros(0, dtype=np.int32)
        if isinstance(where, str) and where in self.mesh.edges and set(directions) == set("xyz"):
            edges = self.mesh.edges[where]
        new = self.comm.allreduce(int(np.count_nonzero(~self.held_edges[edges])))
        if new and not new_edges:
            raise InputError(
                f"fix: {where!r} would be held after cables have been laid, which slide along held "
                "edges without folding them; hold edges first."
            )
        for letter in directions:
            self.held[dofs, COMPONENTS[letter]] = True
        self.held_edges[edges] = True


def _assign_materials(
    mesh: MembraneMesh, material: MembraneMaterial | Mapping[str, MembraneMaterial]
) -> tuple[MeshTags | None, dict[int, MembraneMaterial], dict[int, str]]:
    """Material number of each cell (None with a single material), and materials and parts by
    number."""
    if isinstance(material, MembraneMaterial):
        return None, {0: material}, {}
    if not isinstance(material, Mapping):
        raise InputError(
            f"Scene: material = {material!r} is not a membrane material; use IsotropicMembrane, "
            "for example, or a mapping from the mesh's parts to membranes."
        )
    tags = np.full(len(geometry_dofmap(mesh.mesh)), -1, dtype=np.int32)
    given = [(part, material[part]) for part in outer_first(mesh, "Scene", "material", material)]
    with raised_together(mesh.comm):
        for k, (part, value) in enumerate(given):
            if not isinstance(value, MembraneMaterial):
                raise InputError(
                    f"Scene: the material of part {part!r} is {value!r}, which is not a "
                    "MembraneMaterial."
                )
            tags[mesh.parts[part]] = k
        if np.any(tags < 0):
            raise InputError(
                f"Scene: {np.count_nonzero(tags < 0)} cells have no material; pass one for "
                "every part of the mesh."
            )
    cells = np.arange(len(tags), dtype=np.int32)
    numbered = list(enumerate(given))
    materials, parts = {k: own for k, (_, own) in numbered}, {k: part for k, (part, _) in numbered}
    return meshtags(mesh.mesh, 2, cells, tags), materials, parts


def _pressed_cells(mesh: MembraneMesh, pressure_on: Sequence[str] | None) -> Booleans:
    """Whether pressure acts on each local cell, (n,)."""
    if pressure_on is None:
        return np.ones(len(geometry_dofmap(mesh.mesh)), dtype=bool)
    checks.collection("Scene: pressure_on", pressure_on, Sequence, 'pressure_on=["roof"]')
    for part in pressure_on:
        checks.named("part", mesh.parts, part)
    return cells_of(mesh, pressure_on)


@dataclass(frozen=True)
class StepHistory:
    """This rank's history of the step-wise laws."""

    # (n, 6) section forces and shapes of cells, as in `StepMembraneEnergy.history`; None with the
    # total law
    cells: Annotated[Array, Rows.CELLS, 6] | None = None
    energy: float = 0.0  # accumulated strain energy of plain cells (force x length)
    folded_energy: float = 0.0  # of folded cells
    volume: float = 0.0  # volume gained under plain cells (length cubed)
    folded_volume: float = 0.0  # under folded cells
