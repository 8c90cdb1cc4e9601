"""Conversion of DOLFINx meshes and tags to membranes, and of membrane groups to tags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import dolfinx.mesh
import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.foundation.meshes.membrane_mesh import (
    MembraneMesh,
    build_and_distribute,
    vertex_nodes,
)
from crms_fenicsx.foundation.meshes.orientation import UPWARD, Outside
from crms_fenicsx.foundation.meshes.surface import SurfaceArrays
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.runtime.errors import MeshError, raised_together

Names = Mapping[str, tuple[int, int]]
"""Topological dimension (0: vertices, 1: edges, 2: cells) and tag of each group, by name."""

KINDS = {0: "vertex_tags", 1: "facet_tags", 2: "cell_tags"}


def from_dolfinx(
    mesh: dolfinx.mesh.Mesh,
    cell_tags: dolfinx.mesh.MeshTags | None = None,
    facet_tags: dolfinx.mesh.MeshTags | None = None,
    vertex_tags: dolfinx.mesh.MeshTags | None = None,
    *,
    names: Names | None = None,
    outside: Outside = UPWARD,
) -> MembraneMesh:
    """Make a membrane from a DOLFINx triangle mesh. Collective.

    The whole mesh is gathered on rank 0, which checks and orients it.
    The membrane gets a new mesh, with oriented cells and no ghost cells. Each rank keeps its cells
    of `mesh`, except those that meet cells of another rank at a seam. Data are transferred through
    ``membrane.mesh.topology.original_cell_index`` and
    ``membrane.mesh.geometry.input_global_indices``, the global numbers of cells and geometry nodes
    in `mesh`.

    Parameters
    ----------
    mesh
        Straight-sided triangles in the plane or in space (coordinates: length).
    cell_tags, facet_tags, vertex_tags
        Tags that become `parts`, `edges` and `points` of the membrane.
    names
        Names of groups, each with its topological dimension and tag, like the ``physical_groups``
        returned by ``dolfinx.io.gmsh.read_from_msh``. Tags without a name are named by their
        number, "1".
    outside
        The side that pressure acts towards, as for `from_arrays`.

    Returns
    -------
    MembraneMesh
        The membrane; `mesh_tags` returns its groups as tags.

    Raises
    ------
    MeshError
        On all ranks: cells other than straight-sided triangles, tags of another dimension, names of
        missing tags, or anything `from_arrays` refuses.

    Examples
    --------
    >>> square = dolfinx.mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)
    >>> meshes.from_dolfinx(square)
    MembraneMesh(8 cells, 9 vertices; edges boundary)
    """
    tags = {0: vertex_tags, 1: facet_tags, 2: cell_tags}
    with raised_together(mesh.comm):
        _check(mesh, tags, names or {})
    pieces = mesh.comm.gather(_own_piece(mesh, tags))

    def build() -> SurfaceArrays:
        assert pieces is not None
        return _joined(pieces, names or {})

    owners = None
    if pieces is not None:
        owners = np.repeat(np.arange(len(pieces)), [len(piece["cells"]) for piece in pieces])
    return build_and_distribute(mesh.comm, build, outside, owners)


def mesh_tags(
    membrane: MembraneMesh, dim: int, names: Names | None = None
) -> dolfinx.mesh.MeshTags:
    """Return the groups of one dimension as DOLFINx tags of ``membrane.mesh``. Collective.

    Parameters
    ----------
    membrane
        The membrane.
    dim
        2 for parts, 1 for edge groups, 0 for point groups.
    names
        Tags of groups, as for `from_dolfinx`; other groups are left out. By default, groups named
        by a number get it as their tag, and others are left out.

    Raises
    ------
    InputError
        On all ranks: a name without a group, or an entity in two of the groups.

    Examples
    --------
    >>> tags = meshes.mesh_tags(mesh, 1, names={"left": (1, 7), "right": (1, 8)})
    >>> sorted(set(tags.values.tolist()))
    [7, 8]
    """
    groups = {0: membrane.points, 1: membrane.edges, 2: membrane.parts}[dim]
    if names is None:
        names = {name: (dim, int(name)) for name in groups if name.isdigit()}
    chosen = {name: tag for name, (own, tag) in names.items() if own == dim}
    for name in chosen:
        checks.named("group", groups, name)
    empty = np.zeros(0, dtype=np.int32)
    indices = np.concatenate([empty, *(groups[name] for name in chosen)])
    values = np.concatenate(
        [empty, *(np.full(len(groups[name]), tag, dtype=np.int32) for name, tag in chosen.items())]
    )
    order = np.argsort(indices, kind="stable")
    with raised_together(membrane.comm):
        twice = np.flatnonzero(np.diff(indices[order]) == 0)
        if len(twice):
            both = [name for name in chosen if indices[order][twice[0]] in groups[name]]
            raise MeshError(
                f"the groups {' and '.join(map(repr, both))} have members in common, which can "
                "have one tag only; pass `names` without one of these groups."
            )
    return dolfinx.mesh.meshtags(membrane.mesh, dim, indices[order], values[order])


def _check(
    mesh: dolfinx.mesh.Mesh, tags: Mapping[int, dolfinx.mesh.MeshTags | None], names: Names
) -> None:
    cell, degree = mesh.topology.cell_name(), mesh.ufl_domain().ufl_coordinate_element().degree
    if cell != "triangle" or degree != 1:
        raise MeshError(
            f"the mesh has cells of type {cell} and degree {degree}; pass straight-sided triangles."
        )
    for dim, given in tags.items():
        if given is not None and given.dim != dim:
            raise MeshError(
                f"{KINDS[dim]} are of dimension {given.dim}; pass tags of dimension {dim}."
            )
    for name, (dim, tag) in names.items():
        if tags.get(dim) is None:
            raise MeshError(
                f"names gives {name!r} to tag {tag} of dimension {dim}, but there are no "
                f"{KINDS.get(dim, 'such tags')}; pass them, or leave the name out."
            )


def _own_piece(
    mesh: dolfinx.mesh.Mesh, tags: Mapping[int, dolfinx.mesh.MeshTags | None]
) -> dict[Any, Any]:
    """A rank's part of a mesh by global numbers: cells, positions of their vertices, tags."""
    topology, geometry = mesh.topology, mesh.geometry
    own = topology.index_map(2).size_local
    cells = geometry_dofmap(mesh)[:own]
    nodes = np.unique(cells).astype(np.int32)
    piece: dict[Any, Any] = {
        "cells": geometry.index_map().local_to_global(cells.ravel()).reshape(-1, 3),
        "nodes": geometry.index_map().local_to_global(nodes),
        "points": geometry.x[nodes],
    }
    for dim, given in tags.items():
        if given is None:
            continue
        topology.create_entities(dim)
        topology.create_connectivity(dim, 2)
        mine = given.indices < topology.index_map(dim).size_local
        piece[dim] = _members(mesh, dim, given.indices[mine]), given.values[mine]
    return piece


def _members(mesh: dolfinx.mesh.Mesh, dim: int, entities: Indices) -> Integers:
    """Entities by global numbers: cells (k,), edges (k, 2) and vertices (k,) by their nodes."""
    if dim == 2:
        return mesh.topology.index_map(2).local_to_global(entities)
    vertices = entities[:, None]
    if dim == 1:
        vertices = mesh.topology.connectivity(1, 0).array.reshape(-1, 2)[entities]
    nodes = vertex_nodes(mesh)[vertices]
    found: Integers = mesh.geometry.index_map().local_to_global(nodes.ravel())
    return found.reshape(-1, 2) if dim == 1 else found


def _joined(pieces: list[dict[Any, Any]], names: Names) -> SurfaceArrays:
    """The whole mesh: concatenated by rank, cells are in the order of their global numbers."""
    points: Array = np.zeros((1 + max(p["nodes"].max(initial=-1) for p in pieces), 3))
    for piece in pieces:
        points[piece["nodes"]] = piece["points"]
    known = {(dim, tag): name for name, (dim, tag) in names.items()}
    groups: dict[int, dict[str, NDArray[np.int64]]] = {0: {}, 1: {}, 2: {}}
    for dim, of_dim in groups.items():
        tagged = [piece[dim] for piece in pieces if dim in piece]
        if not tagged:
            continue
        members, values = (np.concatenate(arrays) for arrays in zip(*tagged, strict=True))
        for tag in np.unique(values):
            of_dim[known.get((dim, int(tag)), str(tag))] = members[values == tag]
    for name, (dim, tag) in names.items():
        if name not in groups[dim]:
            raise MeshError(
                f"names gives {name!r} to tag {tag} of dimension {dim}, which no entity of the "
                "mesh has; leave it out."
            )
    cells = np.concatenate([piece["cells"] for piece in pieces])
    return SurfaceArrays(points, cells, groups[1], groups[2], groups[0])
