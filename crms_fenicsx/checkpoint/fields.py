"""A scene's fields on the mesh, in files by the vertices' ids, and back on any number of ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crms_fenicsx.meshes.edge_table import edge_keys
from crms_fenicsx.meshes.membrane_mesh import vertex_ids
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.output.shared_file import first_row, read_rows, write_rows
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.scene import Scene


@dataclass(frozen=True)
class Fields:
    """Fields by this rank's degrees of freedom and edges, ghosts included."""

    u: Array  # (n, 3) displacements (length)
    held: Booleans  # (n, 3) bool held components
    held_edges: Booleans  # (m,) bool edges that are held over their whole length
    # (n, 3) each what this rank gives to its vertices of each load (force)
    forces: tuple[Array, ...]
    # (m,) each, or None force per area of this rank's cells of each load that follows their normals
    suctions: tuple[Array | None, ...]

    @classmethod
    def of(cls, scene: Scene) -> Fields:
        """The scene's fields."""
        u, loads = scene.u.x.array.reshape(-1, 3), scene.loads
        forces = tuple(load.forces for load in loads)
        suctions = tuple(load.suction for load in loads)
        return cls(u, scene.held, scene.membrane.held_edges, forces, suctions)


def write_fields(folder: Path, scene: Scene) -> tuple[int, dict[str, str]]:
    """Write the scene's fields, and where its vertices are when stress-free. Collective.

    Returns how many edges are held, and the digests of the files by their names.
    """
    fields, comm = Fields.of(scene), scene.comm
    vertices = scene.V.dofmap.index_map
    own, total, ids = vertices.size_local, vertices.size_global, scene.membrane.vertex_ids
    X = scene.membrane.stress_free
    digests = {
        name: write_rows(folder / f"{name}.npy", comm, ids[:own], values[:own], total)
        for name, values in (("positions", X), ("displacement", fields.u), ("held", fields.held))
    }
    for k, forces in enumerate(fields.forces):  # ranks that share a vertex each give it a part
        name = f"forces_{k + 1}"
        digests[name] = write_rows(folder / f"{name}.npy", comm, ids, forces, total)
    cells, n_cells = cell_ids(scene)
    for k, suction in enumerate(fields.suctions):
        if suction is not None:
            name, column = f"suction_{k + 1}", suction[:, None]
            digests[name] = write_rows(folder / f"{name}.npy", comm, cells, column, n_cells)
    edges = scene.mesh.mesh.topology.index_map(1).size_local
    pairs = edge_vertices(scene)[:edges][fields.held_edges[:edges]]
    first, count = first_row(len(pairs), comm)
    rows = first + np.arange(len(pairs))
    digests["held_edges"] = write_rows(folder / "held_edges.npy", comm, rows, pairs, count)
    return count, digests


def read_fields(
    folder: Path, scene: Scene, edges: int, digests: Mapping[str, str], loads: Sequence[bool]
) -> Fields:
    """Read the fields that belong to this rank's part of the mesh. Collective."""
    comm, ids = scene.comm, scene.membrane.vertex_ids
    vertices = scene.V.dofmap.index_map
    own, shape = vertices.size_local, (vertices.size_global, 3)

    def read(name: str, dtype: npt.DTypeLike = np.float64) -> npt.NDArray[Any]:
        file = folder / f"{name}.npy"
        return read_rows(file, comm, ids, dtype, shape, digests.get(name, ""))

    X = read("positions")
    here, size = scene.membrane.stress_free, scene.membrane.size
    with raised_together(comm):
        apart = np.flatnonzero(~(np.abs(X - here).max(axis=1) <= SAME_PLACE * size))
        if len(apart):
            k = apart[0]
            raise InputError(
                f"load: the checkpoint is of another mesh: its vertex {ids[k]} is at {X[k]}, and "
                f"here at {here[k]}; build the mesh as it was when it was saved"
            )
    u, held = read("displacement"), read("held", np.bool_)
    with raised_together(comm):
        _check_finite(folder / "displacement.npy", u)
    forces: list[Array] = []
    suctions: list[Array | None] = []
    cells, n_cells = cell_ids(scene)
    for k, follows in enumerate(loads, start=1):
        forces.append(read(f"forces_{k}"))
        with raised_together(comm):
            _check_finite(folder / f"forces_{k}.npy", forces[-1])
        forces[-1][own:] = 0.0  # the owner gives all of it
        suctions.append(None)
        if follows:
            file, due = folder / f"suction_{k}.npy", digests.get(f"suction_{k}", "")
            column = read_rows(file, comm, cells, np.float64, (n_cells, 1), due)
            with raised_together(comm):
                _check_finite(file, column)
            suctions[-1] = column[:, 0]
    # The held edges are lines on the membrane: few, compared to its vertices.
    pairs = read_rows(folder / "held_edges.npy", comm, None, np.int64, (edges, 2),
                      digests.get("held_edges", ""))  # fmt: skip
    held_edges = np.isin(edge_keys(edge_vertices(scene)), edge_keys(pairs))
    return Fields(u, held, held_edges, tuple(forces), tuple(suctions))


def _check_finite(file: Path, values: Array) -> None:
    if not np.isfinite(values).all():
        raise InputError(f"{file} has numbers that are not finite; take another checkpoint")


def cell_ids(scene: Scene) -> tuple[Integers, int]:
    """Ids of this rank's cells, numbers in the mesh as it was given, and how many there are."""
    topology = scene.mesh.mesh.topology
    ids = np.asarray(topology.original_cell_index, dtype=np.int64)
    return ids, topology.index_map(2).size_global


def edge_vertices(scene: Scene) -> Integers:
    """Ids of the ends of this rank's edges, (m, 2)."""
    mesh = scene.mesh.mesh
    return vertex_ids(mesh)[mesh.topology.connectivity(1, 0).array.reshape(-1, 2)]
