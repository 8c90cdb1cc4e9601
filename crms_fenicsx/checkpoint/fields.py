"""A scene's fields on the mesh, in files by the vertices' ids, and back on any number of ranks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from crms_fenicsx.errors import InputError, raised_together
from crms_fenicsx.meshes.edge_table import edge_keys
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids, vertex_ids
from crms_fenicsx.output.npy import read_rows, write_rows
from crms_fenicsx.output.shared_file import first_row
from crms_fenicsx.scene import Scene

Array = npt.NDArray[np.float64]
Booleans = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]

SAME_PLACE = 1e-9
"""Distance of vertices, relative to the membrane's size, that is rounding."""


@dataclass(frozen=True)
class Fields:
    """Fields by this rank's degrees of freedom and edges, ghosts included.

    Attributes
    ----------
    u : (n, 3)
        Displacements (length).
    held : (n, 3) bool
        Held components.
    held_edges : (m,) bool
        Edges that are held over their whole length.
    dead_forces : (n, 3) or None
        What this rank gives to its vertices of a dead load (force).
    """

    u: Array
    held: Booleans
    held_edges: Booleans
    dead_forces: Array | None

    @classmethod
    def of(cls, scene: Scene) -> Fields:
        """The scene's fields."""
        dead = scene.dead_forces
        u = scene.u.x.array.reshape(-1, 3)
        return cls(u, scene.held, scene.held_edges, None if dead is None else dead.forces)


def write_fields(folder: Path, scene: Scene) -> int:
    """Write the scene's fields, and where its vertices are when stress-free. Collective.

    Returns
    -------
    How many edges are held.
    """
    fields, comm = Fields.of(scene), scene.comm
    vertices = scene.V.dofmap.index_map
    own, total, ids = vertices.size_local, vertices.size_global, dof_vertex_ids(scene)
    X = scene.V.tabulate_dof_coordinates()
    for name, values in (("positions", X), ("displacement", fields.u), ("held", fields.held)):
        write_rows(folder / f"{name}.npy", comm, ids[:own], values[:own], total)
    if fields.dead_forces is not None:  # ranks that share a vertex each give it a part
        write_rows(folder / "dead_forces.npy", comm, ids, fields.dead_forces, total)
    edges = scene.mesh.mesh.topology.index_map(1).size_local
    pairs = edge_vertices(scene)[:edges][fields.held_edges[:edges]]
    first, count = first_row(len(pairs), comm)
    write_rows(folder / "held_edges.npy", comm, first + np.arange(len(pairs)), pairs, count)
    return count


def read_fields(folder: Path, scene: Scene, edges: int, dead_load: bool) -> Fields:
    """Read the fields that belong to this rank's part of the mesh. Collective.

    Parameters
    ----------
    folder
        Where they are.
    scene
        Its mesh is that of the fields.
    edges
        How many edges are held.
    dead_load
        Whether there is a dead load.

    Raises
    ------
    InputError
        On all ranks: files that are damaged, or vertices that are elsewhere.
    """
    comm, ids = scene.comm, dof_vertex_ids(scene)
    vertices = scene.V.dofmap.index_map
    own, shape = vertices.size_local, (vertices.size_global, 3)
    X = read_rows(folder / "positions.npy", comm, ids, np.float64, shape)
    here, size = scene.V.tabulate_dof_coordinates(), scene.size
    with raised_together(comm):
        apart = np.flatnonzero(~(np.abs(X - here).max(axis=1) <= SAME_PLACE * size))
        if len(apart):
            k = apart[0]
            raise InputError(
                f"load: the checkpoint is of another mesh: its vertex {ids[k]} is at {X[k]}, and "
                f"here at {here[k]}; build the mesh as it was when it was saved"
            )
    u = read_rows(folder / "displacement.npy", comm, ids, np.float64, shape)
    held = read_rows(folder / "held.npy", comm, ids, np.bool_, shape)
    with raised_together(comm):
        if not np.isfinite(u).all():
            raise InputError(
                f"{folder / 'displacement.npy'} has displacements that are not finite; take "
                "another checkpoint"
            )
    forces = None
    if dead_load:
        forces = read_rows(folder / "dead_forces.npy", comm, ids, np.float64, shape)
        forces[own:] = 0.0  # the owner gives all of it
    # The held edges are lines on the membrane: few, compared to its vertices.
    pairs = read_rows(folder / "held_edges.npy", comm, None, np.int64, (edges, 2))
    held_edges = np.isin(edge_keys(edge_vertices(scene)), edge_keys(pairs))
    return Fields(u, held, held_edges, forces)


def dof_vertex_ids(scene: Scene) -> Integers:
    """Ids of the vertices, numbers in the mesh as it was given, by degree of freedom."""
    ids = np.zeros(len(scene.held), dtype=np.int64)
    ids[scene.V.dofmap.list] = cell_vertex_ids(scene.mesh.mesh)
    return ids


def edge_vertices(scene: Scene) -> Integers:
    """Ids of the ends of this rank's edges, (m, 2)."""
    mesh = scene.mesh.mesh
    return vertex_ids(mesh)[mesh.topology.connectivity(1, 0).array.reshape(-1, 2)]
