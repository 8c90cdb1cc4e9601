"""A scene's arrays on the mesh in files, by its own numbers, and back on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.checkpoint.codec import Plain
from crms_fenicsx.meshes.edge_table import edge_keys
from crms_fenicsx.meshes.membrane_mesh import vertex_ids
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.output.shared_file import first_row, read_rows, write_rows
from crms_fenicsx.runtime.arrays import Booleans, Integers, Rows
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.scene import Scene

POSITIONS = "positions"
"""Name of the file that tells where the vertices are when stress-free."""


class MeshFiles:
    """Distributed arrays of a scene in files of a folder, by the numbers of its mesh as given."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self.folder, self.scene, self.comm = folder, scene, scene.comm
        vertices = scene.V.dofmap.index_map
        self._own, self._vertices = vertices.size_local, vertices.size_global
        self._ids = scene.membrane.vertex_ids
        self.held_edges: Booleans | None = None
        """Those that have been read."""

    def write(self, path: str, rows: Rows, values: np.ndarray[Any, Any]) -> Plain:
        """Write a distributed array; returns its digest and number of rows. Collective."""
        file = self.folder / f"{path}.npy"
        if rows is Rows.EDGES:
            own = self.scene.mesh.mesh.topology.index_map(1).size_local
            values = edge_vertices(self.scene)[:own][values[:own]]
            first, total = first_row(len(values), self.comm)
            ids: Integers = first + np.arange(len(values))
        elif rows is Rows.CELLS:
            ids, total = cell_ids(self.scene)
        else:
            count = self._own if rows is Rows.VERTICES else len(self._ids)
            ids, values, total = self._ids[:count], values[:count], self._vertices
        columns = values.reshape(len(values), int(np.prod(values.shape[1:])))
        return {"digest": write_rows(file, self.comm, ids, columns, total), "rows": total}

    def read(
        self, path: str, rows: Rows, dtype: np.dtype[Any], shape: tuple[int, ...], data: Any
    ) -> np.ndarray[Any, Any]:
        """Read this rank's rows, (n, *shape); of shares the owner gets all. Collective."""
        if not isinstance(data, dict) or data.keys() != {"digest", "rows"}:
            raise ValueError(f"{data!r} where a file {path}.npy is due")
        file, due = self.folder / f"{path}.npy", str(data["digest"])
        if rows is Rows.EDGES:
            pairs = read_rows(file, self.comm, None, np.int64, (int(data["rows"]), 2), due)
            self.held_edges = np.isin(edge_keys(edge_vertices(self.scene)), edge_keys(pairs))
            return self.held_edges
        ids, total = cell_ids(self.scene) if rows is Rows.CELLS else (self._ids, self._vertices)
        columns = int(np.prod(shape))
        values = read_rows(file, self.comm, ids, dtype, (total, columns), due)
        with raised_together(self.comm):
            if not np.isfinite(values).all():
                raise InputError(f"{file} has numbers that are not finite; take another checkpoint")
        if rows is Rows.SHARES:
            values[self._own :] = 0.0
        return values.reshape(-1, *shape)

    def check_mesh(self, data: Any) -> None:
        """Refuse another mesh than the one whose vertices have been written. Collective."""
        X = self.read(POSITIONS, Rows.VERTICES, np.dtype(float), (3,), data)
        here, size = self.scene.membrane.stress_free, self.scene.membrane.size
        with raised_together(self.comm):
            apart = np.flatnonzero(~(np.abs(X - here).max(axis=1) <= SAME_PLACE * size))
            if len(apart):
                k = apart[0]
                raise InputError(
                    f"load: the checkpoint is of another mesh: its vertex {self._ids[k]} is at "
                    f"{X[k]}, and here at {here[k]}; build the mesh as it was when it was saved"
                )


def cell_ids(scene: Scene) -> tuple[Integers, int]:
    """Ids of this rank's cells, numbers in the mesh as it was given, and how many there are."""
    topology = scene.mesh.mesh.topology
    ids = np.asarray(topology.original_cell_index, dtype=np.int64)
    return ids, topology.index_map(2).size_global


def edge_vertices(scene: Scene) -> Integers:
    """Ids of the ends of this rank's edges, (m, 2)."""
    mesh = scene.mesh.mesh
    return vertex_ids(mesh)[mesh.topology.connectivity(1, 0).array.reshape(-1, 2)]
