"""The cells around the cables, gathered on all ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.strip import Strip, ascending
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.route import near_section


def cells_at(membrane: Membrane, vertices: npt.ArrayLike) -> Strip:
    """Gather the cells around some vertices, given by id and alike on all ranks. Collective."""
    wanted = np.unique(np.asarray(vertices, dtype=np.int64))
    ids = _own_cells(membrane)
    chosen = np.flatnonzero(np.isin(ids, wanted).any(axis=1))
    strip = _gathered(membrane, ids, chosen)
    complete = frozenset(int(vertex) for vertex in wanted)
    return replace(strip, complete=complete)


def grown(membrane: Membrane, strip: Strip, vertices: npt.ArrayLike, rings: int = 1) -> Strip:
    """A strip and the cells around some vertices, given by id and alike on all ranks. Collective.

    `rings` tells how many rings of cells around them are added.
    """
    wanted = np.unique(np.asarray(vertices, dtype=np.int64))
    for _ in range(rings):
        lacking = [int(v) for v in wanted if int(v) not in strip.complete]
        if lacking:
            strip = strip.merged(cells_at(membrane, lacking))
        wanted = np.unique(strip.cells[np.isin(strip.cells, wanted).any(axis=1)])
    return strip


def cells_near(membrane: Membrane, route: Array, along_legs: bool) -> Strip:
    """Gather the cells that tracing a route on the current shape needs. Collective.

    None behind a seam is among them. Those along the legs are enough for most routes, see
    `near_section`.
    """
    positions, nodes = own_surface(membrane)
    outer = np.setdiff1d(np.arange(len(nodes)), membrane.mesh.hidden)
    near = near_section(positions, nodes[outer], route, comm=membrane.comm, along_legs=along_legs)
    return _gathered(membrane, _own_cells(membrane), outer[near])


def own_surface(membrane: Membrane) -> tuple[Array, Integers]:
    """Current positions (k, 3), and rows of them for the corners of this rank's cells, (n, 3)."""
    mesh = membrane.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    nodes = np.asarray(geometry_dofmap(mesh)[:owned], dtype=np.int64)
    positions = np.zeros((mesh.geometry.x.shape[0], 3))
    positions[nodes] = membrane.positions()[membrane.V.dofmap.list[:owned]]
    return positions, nodes


def _own_cells(membrane: Membrane) -> Integers:
    """Vertex ids of this rank's cells, (n, 3)."""
    mesh = membrane.mesh.mesh
    return cell_vertex_ids(mesh)[: mesh.topology.index_map(2).size_local]


def _gathered(membrane: Membrane, ids: Integers, chosen: Integers) -> Strip:
    """Chosen cells of all ranks."""
    edges = membrane.mesh.mesh.topology.connectivity(2, 1).array.reshape(-1, 3)[chosen]
    cell, k = np.nonzero(membrane.held_edges[edges])  # edge k lies opposite to vertex k
    ends = np.stack([ids[chosen[cell], (k + 1) % 3], ids[chosen[cell], (k + 2) % 3]], axis=1)
    hidden = np.sort(ids[chosen[np.isin(chosen, membrane.mesh.hidden)]], axis=1)
    parts = membrane.comm.allgather((ids[chosen], chosen, np.sort(ends, axis=1), hidden))
    cells = np.concatenate([part[0] for part in parts]).reshape(-1, 3)
    rows = ascending(cells)
    return Strip(
        cells[rows],
        np.concatenate([np.full(len(part[1]), rank) for rank, part in enumerate(parts)])[rows],
        np.concatenate([part[1] for part in parts])[rows],
        held_edges=frozenset((int(a), int(b)) for part in parts for a, b in part[2]),
        hidden=frozenset((int(a), int(b), int(c)) for part in parts for a, b, c in part[3]),
    )
