"""Contents of a checkpoint except its arrays; fingerprint and record of its scene.

By the record a resumed script is compared with the one that was interrupted. It is derived from the
whole state of the scene and from its model, so that whatever becomes part of them is compared, too.
Arrays on the mesh are recorded by weighted sums and functions by their values on the mesh: the same
on any number of processes, to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.steps.load_step import Step
from crms_fenicsx.cabling.cables.strip import Strip
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.energy.terms.kinematics import warp_field
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids, vertex_ids
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers, Rows
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.changed_materials import numbers
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.results.checkpoint.checkpoint_files import digest
from crms_fenicsx.results.checkpoint.codec import Plain, encode
from crms_fenicsx.results.quantities import summed


@dataclass(frozen=True)
class Run:
    """A solver's record of its load steps."""

    steps: list[Step]  # accepted load steps
    rows: list[Mapping[str, int | float | str]]  # rows of the history
    tried: TriedPaths | None  # paths tried and rejected; None before the first


@dataclass(frozen=True)
class Contents:
    """Contents of a checkpoint except the arrays on the mesh."""

    scene: Plain  # identifies the scene, see `fingerprint`
    positions: Plain  # description of the file of stress-free vertices
    state: Plain  # a `SceneState`
    state_version: int  # of the scene's versions
    in_equilibrium: bool  # whether the scene was unchanged since the last load step
    run: Run
    # call of `Solver.advance` that the checkpoint belongs to, if any
    call: Plain | None


def fingerprint(scene: Scene) -> dict[str, Any]:
    """What a script must rebuild identically, as numbers and texts by name. Collective."""
    refuse_history(scene)
    mesh = scene.mesh.mesh
    cells = cell_vertex_ids(mesh)
    first = scene.membrane.first_materials
    tags = np.zeros((len(cells), 1), dtype=np.int64)
    if scene.membrane.cell_tags is not None:
        tags[:, 0] = scene.membrane.cell_tags.values
    frames, shapes = scene.membrane.frames, None
    if frames is not None:
        rounded = np.rint(1e8 * frames.reshape(-1, 6)).astype(np.int64)
        shapes = mixed(scene, np.hstack([cells, rounded]))
    warps = None
    if frames is None and any(callable(one.warp) for one in first.values()):
        ways = np.zeros((len(cells), 3))
        for tag, one in first.items():
            if callable(one.warp):
                own = np.flatnonzero(tags[:, 0] == tag).astype(np.int32)
                ways[own] = warp_field(mesh, one, own).x.array.reshape(-1, 3)[own]
        warps = mixed(scene, np.hstack([cells, np.rint(1e8 * ways).astype(np.int64)]))
    return {
        "number of vertices": mesh.topology.index_map(0).size_global,
        "number of cells": mesh.topology.index_map(2).size_global,
        "cells (their vertices, mixed to one number)": mixed(scene, cells),
        "materials": [described(one) for one in first.values()],
        "warp (directions in the cells, mixed to one number)": warps,
        "cells of the materials (mixed to one number)": mixed(scene, np.hstack([cells, tags])),
        "stress-free shapes of the cells (mixed to one number)": shapes,
        "strain": scene.strain_law,
        "pressure": scene.pressure_law,
        "penalty": scene.penalty,
        "literal_penalty": scene.literal_penalty,
        "added terms": [term.name for term in scene.terms],
    }


def refuse_history(scene: Scene) -> None:
    """Refuse to checkpoint a scene whose terms have a history that would be lost."""
    for term in scene.terms:
        if term.has_history:
            raise InputError(
                f"the term {term.name!r} has a history, which checkpoints do not keep; do without "
                "checkpoints (resume=None), or without the term"
            )


def check_same(saved: dict[str, Any], scene: Scene) -> None:
    """Refuse a scene that does not match a saved fingerprint. Collective."""
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
    """A material as numbers and texts."""
    warp = material.warp
    direction = "a function" if callable(warp) else warp if warp is None else [*map(float, warp)]
    values = [*encode(numbers(material)).values()]
    if isinstance(material, UflMembrane):
        values += material.samples
    return [type(material).__name__, values, direction]


def mixed(scene: Scene, rows: Integers) -> str:
    """Hash of all ranks' integer rows, independent of their order. Collective."""
    return digest(scene.comm, np.zeros(len(rows), dtype=np.int64), rows)


WAY = ("nodes", "positions", "fractions", "lifted", "reference_positions")
"""Fields of a cable's state that are recorded by the moments of its way: its points depend on
rounding where it meets vertices."""


def cell_ids(scene: Scene) -> tuple[Integers, int]:
    """Numbers of this rank's cells in the mesh as given, and their global count."""
    topology = scene.mesh.mesh.topology
    ids = np.asarray(topology.original_cell_index, dtype=np.int64)
    return ids, topology.index_map(2).size_global


def edge_vertices(scene: Scene) -> Integers:
    """End ids of this rank's edges, (m, 2)."""
    mesh = scene.mesh.mesh
    return vertex_ids(mesh)[mesh.topology.connectivity(1, 0).array.reshape(-1, 2)]


def scene_record(scene: Scene) -> Plain:
    """A scene as numbers and texts, independent of the number of ranks to rounding. Collective."""
    storage = _RecordStorage(scene)
    mesh, cells = scene.mesh, cell_ids(scene)[0]
    pressed = scene.membrane.pressed[: len(cells)].astype(np.int64)
    edges = np.sort(edge_vertices(scene), axis=1)
    groups = {
        "parts": {name: mixed(scene, cells[_own(rows, len(cells)), None])
                  for name, rows in sorted(mesh.parts.items())},
        "edges": {name: mixed(scene, edges[_own(rows, storage.own_edges)])
                  for name, rows in sorted(mesh.edges.items())},
        "points": {
            name: mixed(scene, storage.ids[_own(rows, storage.own), None])
            for name in sorted(mesh.points)
            for rows in [fem.locate_dofs_topological(scene.V, 0, mesh.points[name])]
        },
    }  # fmt: skip
    return {
        **fingerprint(scene),
        "groups of the mesh (mixed to one number each)": groups,
        "pressure_on (cells, mixed to one number)": mixed(scene, np.stack([cells, pressed], 1)),
        "section forces of added terms": [
            None if term.section_forces is None
            else storage.write("", Rows.CELLS, term.section_forces)
            for term in scene.terms
        ],
        **encode(scene.state, storage),
    }  # fmt: skip


def _own(rows: Indices, count: int) -> Indices:
    return rows[rows < count]


class _RecordStorage:
    """Replaces the arrays of a scene's state by sums that do not depend on the ranks."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.ids = scene, scene.membrane.vertex_ids
        self.own = scene.V.dofmap.index_map.size_local
        self.own_edges = scene.mesh.mesh.topology.index_map(1).size_local

    def reduce(self, value: Any) -> Any:
        """A material as numbers, a cable by its way; a strip belongs to the mesh."""
        if isinstance(value, Strip):
            return None
        if isinstance(value, MembraneMaterial):
            return described(value)
        if isinstance(value, CableState):
            found = {one.name: getattr(value, one.name) for one in fields(value)}
            kept = {name: one for name, one in found.items() if name not in WAY}
            return kept | {"way": way(value)}
        return value

    def write(self, path: str, rows: Rows, values: Array) -> Any:
        """Weighted sums over all ranks and the largest component; Booleans as one number.
        Collective."""
        if rows is Rows.EDGES:
            pairs = np.sort(edge_vertices(self.scene)[: self.own_edges], axis=1)
            return mixed(self.scene, pairs[values[: self.own_edges]])
        if rows is Rows.SHARES:
            values = summed(self.scene.V, np.arange(len(values)), values)
        ids: Integers = cell_ids(self.scene)[0] if rows is Rows.CELLS else self.ids[: self.own]
        columns = values[: len(ids)].reshape(len(ids), -1)
        if columns.dtype == bool:
            return mixed(self.scene, np.column_stack([ids, columns.astype(np.int64)]))
        weights = 0.5 + (0.6180339887498949 * ids) % 1.0
        sums: Array = self.scene.comm.allreduce(weights @ columns)
        largest = self.scene.comm.allreduce(float(np.abs(columns).max(initial=0.0)), op=MPI.MAX)
        return [*map(float, sums), largest]

    def read(self, *arguments: Any) -> Any:
        """Nothing is read from a record."""
        raise NotImplementedError

    restore = unsaved = read


def way(state: CableState) -> Plain:
    """Ends, middle and second moments of a cable's polyline."""
    points = state.positions[~state.lifted]
    spans = np.diff(points, axis=0)
    lengths, middles = np.linalg.norm(spans, axis=1), (points[1:] + points[:-1]) / 2
    length = max(float(lengths.sum()), np.finfo(float).tiny)
    places = [lengths @ middles / length, points[0], points[-1]]
    square = np.einsum("s,si,sj->ij", lengths, middles, middles)
    square += np.einsum("s,si,sj->ij", lengths, spans, spans) / 12
    return {
        "ends and middle": [float(x) for place in places for x in place],
        "moments": (square / length).ravel().tolist(),
    }
