"""The cells around the cables, gathered on all ranks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.strip import EMPTY, Strip
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.trace import near_section

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene


def cells_at(scene: Scene, vertices: npt.ArrayLike) -> Strip:
    """Gather the cells around some vertices, given by id and alike on all ranks. Collective."""
    wanted = np.unique(np.asarray(vertices, dtype=np.int64))
    ids = _own_cells(scene)
    chosen = np.flatnonzero(np.isin(ids, wanted).any(axis=1))
    strip = _gathered(scene, ids, chosen)
    complete = frozenset(int(vertex) for vertex in wanted)
    return replace(strip, complete=complete)


def grow(scene: Scene, vertices: npt.ArrayLike, rings: int = 1) -> None:
    """Add the cells around some vertices to the scene's strip. Collective.

    Parameters
    ----------
    scene
        Its strip is replaced if it lacks some.
    vertices
        Ids, the same on all ranks.
    rings
        How many rings of cells to add.
    """
    strip = scene.strip or EMPTY
    wanted = np.unique(np.asarray(vertices, dtype=np.int64))
    for _ in range(rings):
        lacking = [int(v) for v in wanted if int(v) not in strip.complete]
        if lacking:
            strip = strip.merged(cells_at(scene, lacking))
        wanted = np.unique(strip.cells[np.isin(strip.cells, wanted).any(axis=1)])
    scene.strip = strip


def cells_near(scene: Scene, route: Array) -> Strip:
    """Gather the cells that tracing a route on the current shape needs. Collective.

    None behind a seam is among them.
    """
    positions, nodes = own_surface(scene)
    outer = np.setdiff1d(np.arange(len(nodes)), scene.mesh.hidden)
    near = outer[near_section(positions, nodes[outer], route, comm=scene.comm)]
    return _gathered(scene, _own_cells(scene), near)


def own_surface(scene: Scene) -> tuple[Array, Integers]:
    """Current positions (k, 3), and rows of them for the corners of this rank's cells, (n, 3)."""
    mesh = scene.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    nodes = np.asarray(geometry_dofmap(mesh)[:owned], dtype=np.int64)
    positions = np.zeros((mesh.geometry.x.shape[0], 3))
    positions[nodes] = scene.positions()[scene.V.dofmap.list[:owned]]
    return positions, nodes


def _own_cells(scene: Scene) -> Integers:
    """Vertex ids of this rank's cells, (n, 3)."""
    mesh = scene.mesh.mesh
    return cell_vertex_ids(mesh)[: mesh.topology.index_map(2).size_local]


def _gathered(scene: Scene, ids: Integers, chosen: npt.NDArray[np.int64]) -> Strip:
    """Chosen cells of all ranks."""
    edges = scene.mesh.mesh.topology.connectivity(2, 1).array.reshape(-1, 3)[chosen]
    cell, k = np.nonzero(scene.held_edges[edges])  # edge k lies opposite to vertex k
    ends = np.stack([ids[chosen[cell], (k + 1) % 3], ids[chosen[cell], (k + 2) % 3]], axis=1)
    hidden = np.sort(ids[chosen[np.isin(chosen, scene.mesh.hidden)]], axis=1)
    parts = scene.comm.allgather((ids[chosen], chosen, np.sort(ends, axis=1), hidden))
    return Strip(
        np.concatenate([part[0] for part in parts]).reshape(-1, 3),
        np.concatenate([np.full(len(part[1]), rank) for rank, part in enumerate(parts)]),
        np.concatenate([part[1] for part in parts]),
        held_edges=frozenset((int(a), int(b)) for part in parts for a, b in part[2]),
        hidden=frozenset((int(a), int(b), int(c)) for part in parts for a, b, c in part[3]),
    )
