"""The record by which a resumed script is compared with the one that was interrupted.

It is derived from the whole state of the scene and from its model, so that whatever becomes part
of them is compared, too. Arrays on the mesh are recorded by weighted sums and functions by their
values on the mesh: the same on any number of processes, to rounding.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.strip import Strip
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers, Rows
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.results.checkpoint.codec import Plain, encode
from crms_fenicsx.results.checkpoint.contents import described, fingerprint, mixed
from crms_fenicsx.results.checkpoint.saving import cell_ids, edge_vertices

WAY = ("nodes", "positions", "fractions", "lifted", "reference_positions")
"""Fields of a cable's state that are recorded by the moments of its way: its points depend on
rounding where it meets vertices."""


def scene_record(scene: Scene) -> Plain:
    """A scene as numbers and texts, independent of the number of ranks to rounding. Collective."""
    storage = RecordStorage(scene)
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


class RecordStorage:
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
            shared = fem.Function(self.scene.V)
            shared.x.array[:] = values.ravel()
            shared.x.scatter_reverse(la.InsertMode.add)
            values = shared.x.array.reshape(values.shape)
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
