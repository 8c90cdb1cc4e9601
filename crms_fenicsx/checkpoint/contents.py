"""Contents of a checkpoint besides the fields, and the fingerprint of its scene."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Annotated, Any

import numpy as np

from crms_fenicsx.checkpoint.codec import Plain
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.model.bar import Bar, BarState, JointState, MeshVertex
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.crossing import Crossing
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.membrane import StepHistory
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.model.versions import StateWarning
from crms_fenicsx.output.shared_file import digest
from crms_fenicsx.paths.tried_paths import TriedPaths
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.surface.points import Support


@dataclass(frozen=True)
class Run:
    """What a solver knows of its load steps, besides the scene."""

    steps: list[Step]  # the accepted steps
    rows: list[Mapping[str, int | float | str]]  # rows of the history
    step_history: StepHistory | None  # what the step-wise laws know; None where there are none
    tried: TriedPaths | None  # paths that cables have not taken; None before any were tried

    def with_cells(self, cells: Array | None) -> Run:
        """The run with a state of the cells, (n, 6), in what its step-wise laws know."""
        if self.step_history is None:
            return self
        return replace(self, step_history=replace(self.step_history, cells=cells))


@dataclass(frozen=True)
class SavedCable:
    """A laid cable; see `LaidCable`."""

    name: str
    cable: Cable
    sleeve: bool
    layer: int
    in_edge: bool
    joints: tuple[str | None, str | None]
    state: CableState


@dataclass(frozen=True)
class SavedJoint:
    """A joint; see `Joint`."""

    name: str
    first: Annotated[Array, 3]
    held: Annotated[Booleans, 3]
    state: JointState


@dataclass(frozen=True)
class SavedBar:
    """A bar, between joints by their numbers or vertices; see `PlacedBar`."""

    name: str
    bar: Bar
    ends: tuple[int | MeshVertex, int | MeshVertex]
    state: BarState


@dataclass(frozen=True)
class SavedLoad:
    """A load on the membrane without its fields; see `MembraneLoad`."""

    name: str
    intensity: float
    follows: bool  # whether it follows the surface's normals
    factor: float
    joints: dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Contents:
    """All that a checkpoint holds but for the fields."""

    scene: Plain  # what tells the scene from others, see `fingerprint`
    held_edges: int  # how many edges are held
    digests: dict[str, str]  # of the files with the fields, by their names
    pressure: float  # pressure, air, floor, dissipated, energies: as in the scene
    air: SealedAir | None
    state_version: int  # as in the scene's versions
    in_equilibrium: bool  # whether nothing had changed since the last load step
    floor: float | None
    laid: int  # how many cables have been laid
    dissipated: float
    energies: dict[str, float]
    materials: tuple[dict[str, Any], ...]
    loads: tuple[SavedLoad, ...]  # those on the membrane but for their forces
    ponds: tuple[Pond, ...]  # as in the scene
    strip: tuple[int, ...]  # ids of the vertices all whose cells are known to the cables
    cables: tuple[SavedCable, ...]
    crossings: tuple[Crossing, ...]
    joints: tuple[SavedJoint, ...]
    bars: tuple[SavedBar, ...]
    run: Run  # of its step history without the cells
    # the call of `Solver.advance` that the checkpoint belongs to; None if to none
    call: Plain | None
    warnings: tuple[StateWarning, ...]  # as in the scene

    def check(self, n_vertices: int) -> None:
        """Refuse what does not fit together, or a mesh with some number of vertices."""
        if self.laid < len(self.cables):
            raise ValueError(f"{self.laid} cables were laid, but {len(self.cables)} are there")
        for load in self.loads:
            if not load.intensity >= 0:
                raise ValueError(f"a load {load.name!r} of the intensity {load.intensity}")
            if not load.joints.keys() <= {joint.name for joint in self.joints}:
                raise ValueError(f"a load {load.name!r} on joints that are not there")
        fixed = {name for cable in self.cables for name in cable.joints} - {None}
        if not fixed <= {joint.name for joint in self.joints}:
            raise ValueError("a cable that is fixed to a joint that is not there")
        ends = list(chain.from_iterable(bar.ends for bar in self.bars))
        if any(isinstance(end, int) and end not in range(len(self.joints)) for end in ends):
            raise ValueError("a bar that ends at a joint that is not there")
        for pond in self.ponds:
            if not (pond.weight > 0 and pond.side in (-1, 1)):
                raise ValueError(f"a pond {pond.name!r} of {pond.weight} on the side {pond.side}")
        if self.air is not None and not min(self.air.volume, self.air.absolute) > 0:
            raise ValueError(f"sealed air that is none, {self.air}")
        ids = [*self.strip, *chain.from_iterable(self._supports())]
        ids += [end.number for end in ends if isinstance(end, MeshVertex)]
        if ids and not 0 <= min(ids) <= max(ids) < n_vertices:
            raise ValueError(f"vertices {min(ids)} to {max(ids)} of a mesh with {n_vertices}")
        numbers = range(len(self.cables))
        if any(k.lower not in numbers or k.upper not in numbers for k in self.crossings):
            raise ValueError("a crossing of cables that are not there")
        for state in (cable.state for cable in self.cables):
            for node in state.nodes:
                if (node.point is None) != (node.kind == "anchor"):
                    raise ValueError(f"a node of kind {node.kind!r} with the point {node.point!r}")
                if node.crossing is not None and node.crossing not in range(len(self.crossings)):
                    raise ValueError(f"a node of the crossing {node.crossing}, which is not there")
            if state.axial is not None and len(state.axial.rest) != len(state.axial.curve.arc):
                raise ValueError("a cable whose unstressed arcs are not those of its curve")

    def _supports(self) -> Iterator[Support]:
        """The vertices on or between which cables and crossings are."""
        states = [cable.state for cable in self.cables]
        nodes = chain.from_iterable(state.nodes for state in states)
        yield from (node.point.support for node in nodes if node.point is not None)
        yield from (crossing.support for crossing in self.crossings)


def fingerprint(scene: Scene) -> dict[str, Any]:
    """Describe what a script must build alike, but for where the vertices are. Collective.

    Returns by name, in the order in which differences are worth telling; made of numbers and texts.
    """
    refuse_history(scene)
    mesh = scene.mesh.mesh
    cells = cell_vertex_ids(mesh)[: mesh.topology.index_map(2).size_local]
    tags = np.zeros((len(cells), 1), dtype=np.int64)
    if scene.membrane.cell_tags is not None:
        tags[:, 0] = scene.membrane.cell_tags.values[: len(cells)]
    return {
        "number of vertices": mesh.topology.index_map(0).size_global,
        "number of cells": mesh.topology.index_map(2).size_global,
        "cells (their vertices, mixed to one number)": mixed(scene, cells),
        "materials": [described(one) for one in scene.membrane.first_materials.values()],
        "cells of the materials (mixed to one number)": mixed(scene, np.hstack([cells, tags])),
        "strain": scene.strain_law,
        "pressure": scene.pressure_law,
        "penalty": scene.penalty,
        "literal_penalty": scene.literal_penalty,
        "added terms": [term.name for term in scene.terms],
    }


def refuse_history(scene: Scene) -> None:
    """Refuse to make checkpoints of a scene with terms whose history they would not keep."""
    for term in scene.terms:
        if term.has_history:
            raise InputError(
                f"the term {term.name!r} has a history, which checkpoints do not keep; do without "
                "checkpoints (resume=None), or without the term"
            )


def check_same(saved: dict[str, Any], scene: Scene) -> None:
    """Compare a scene with a fingerprint. Collective."""
    for name, value in fingerprint(scene).items():
        was = saved.get(name)
        if not _same(was, value):
            raise InputError(
                f"load: the checkpoint is of another scene: {name} {was!r}, and here {value!r}; "
                "build the mesh and the scene as they were when it was saved"
            )


def _same(a: object, b: object) -> bool:
    """Whether two values agree, numbers up to rounding."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-12)
    return a == b


def described(material: MembraneMaterial) -> list[Any]:
    """A material in numbers and texts."""
    warp = material.warp
    direction = "a function" if callable(warp) else warp if warp is None else [*map(float, warp)]
    values = [float(value) for value in material.parameters]
    if isinstance(material, UflMembrane):
        values += material.samples
    return [type(material).__name__, values, direction]


def mixed(scene: Scene, rows: Integers) -> str:
    """A number of all ranks' rows of integers, whatever their order. Collective."""
    return digest(scene.comm, np.zeros(len(rows), dtype=np.int64), rows)
