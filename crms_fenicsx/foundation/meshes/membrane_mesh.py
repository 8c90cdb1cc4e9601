"""The distributed mesh of a membrane, with its named groups."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ParamSpec

import dolfinx.mesh
import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys, edges_of, whole_line
from crms_fenicsx.foundation.meshes.orientation import UPWARD, Outside, connected_labels
from crms_fenicsx.foundation.meshes.surface import (
    BOUNDARY,
    EMPTY,
    CheckedSurface,
    Projection,
    SurfaceArrays,
    checked_surface,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Arguments
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.compat import (
    create_mesh,
    default_ranks,
    geometry_dofmap,
    with_nodes,
)
from crms_fenicsx.foundation.runtime.errors import InputError, MeshError, raised_together

P = ParamSpec("P")

Ranks = ArrayLike | Callable[[Array], ArrayLike]
"""Rank of each cell, (m,), or a function that returns it from the cells' midpoints, (m, 3)."""


@dataclass(frozen=True, repr=False)
class MembraneMesh:
    """A triangulated membrane in its stress-free shape.

    Group members are sorted local indices, owned and ghosts. Every rank has every group's name,
    with an empty array if it has no members. The arrays are read-only.

    Attributes
    ----------
    mesh
        Triangles in space (topological dimension 2, geometric dimension 3), all normals on the
        outer side of the membrane, without ghost cells. Edges and the connectivities 1-2, 2-1 and
        0-2 exist.
    edges
        Groups of edges. "boundary", all edges with one cell, always exists.
    parts
        Groups of cells.
    points
        Groups of vertices.
    hidden
        Cells of pieces that meet others at a seam from behind, such as a wall under a roof; cables
        do not lie on them.
    project
        Projection of new vertices in refinement on the approximated surface: the generator's, on
        rank 0, or a user's function, on all ranks; None if unknown.
    given
        Nodes as given, once a scene uses the mesh, whose lines move them: none or one array.
    """

    mesh: dolfinx.mesh.Mesh
    edges: Mapping[str, Indices]
    parts: Mapping[str, Indices]
    points: Mapping[str, Indices]
    hidden: Indices
    project: Projection | None = None
    given: list[Array] = dataclasses.field(default_factory=list, compare=False)

    def __repr__(self) -> str:
        """One-line summary; not collective."""
        cells, vertices = (self.mesh.topology.index_map(dim).size_global for dim in (2, 0))
        words = [f"{cells} cells, {vertices} vertices"]
        words += [
            f"{kind} {', '.join(groups)}"
            for kind, groups in (
                ("edges", self.edges), ("parts", self.parts), ("points", self.points)
            )
            if groups
        ]  # fmt: skip
        return f"MembraneMesh({'; '.join(words)})"

    @cached_property
    def overlaps(self) -> Mapping[tuple[str, str], str | None]:
        """Inner one of each two parts with common cells, or None. Collective on first access."""
        names, n = sorted(self.parts), self.mesh.topology.index_map(2).size_local
        inside = np.zeros((len(names), n), dtype=np.int64)
        for row, name in zip(inside, names, strict=True):
            row[self.parts[name]] = 1
        common = self.comm.allreduce(inside @ inside.T) if names else inside
        found: dict[tuple[str, str], str | None] = {}
        for j, k in zip(*map(np.ndarray.tolist, np.nonzero(np.tril(common, -1))), strict=True):
            within = [names[i] for i in (j, k) if common[i, i] == common[j, k]]
            found[names[k], names[j]] = within[0] if len(within) == 1 else None
        return MappingProxyType(found)

    def of_scene(self) -> MembraneMesh:
        """This mesh for the first scene, and for each further one a mesh with nodes of its own,
        which the lines of another scene do not move."""
        if not self.given:
            self.given.append(np.array(self.mesh.geometry.x, dtype=np.float64))
            return self
        nodes = self.given[0]
        return dataclasses.replace(self, mesh=with_nodes(self.mesh, nodes.copy()), given=[nodes])

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        comm: MPI.Intracomm = self.mesh.comm
        return comm


def from_arrays(
    comm: MPI.Intracomm,
    points: ArrayLike | None,
    cells: ArrayLike | None,
    *,
    edges: Mapping[str, ArrayLike] | None = None,
    parts: Mapping[str, ArrayLike] | None = None,
    point_groups: Mapping[str, ArrayLike] | None = None,
    outside: Outside = UPWARD,
    ranks: Ranks | None = None,
) -> MembraneMesh:
    """Make a membrane from arrays.

    All arguments but `comm` are used on rank 0 only; other ranks may pass None. The surface may
    have several pieces and holes, and may be closed. Pieces may meet at seams, edges of three or
    more cells, like a wall and its roof. Coincident vertices are not merged, so that pieces may lie
    side by side without being joined.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective, and rank 0 holds the whole mesh first.
    points
        Coordinates (length) of the stress-free shape, shape (n, 3), or (n, 2) for z = 0.
    cells
        Vertices of the triangles, shape (m, 3), in any order: cells are reoriented so that all
        normals of a piece point to the same side.
    edges
        Named groups of edges, each given by vertex pairs, shape (k, 2). "boundary" is reserved for
        all edges with one cell.
    parts
        Named parts of the membrane, each given by cell indices, shape (k,).
    point_groups
        Named vertices, shape (k,).
    outside
        The side towards which pressure acts: a direction with which each piece's area vector makes
        an acute angle, or `AwayFrom` a point inside. A mapping gives sides by part, such as
        ``{"wall": (1, 0, 0)}``, upward for other parts. Pieces between seams are oriented one by
        one.
    ranks
        Rank of each cell, shape (m,), or a function that returns it from the cells' midpoints,
        (m, 3); a rank may have no cells. Cells that meet at a seam go to the lowest of their ranks.
        By default DOLFINx distributes the cells evenly.

    Returns
    -------
    MembraneMesh
        The distributed mesh with its groups.

    Raises
    ------
    MeshError
        On all ranks: an array of a wrong shape or type, a coordinate that is not finite, a
        degenerate cell (area below 1e-10 times its longest edge squared) or a duplicate one, a
        vertex without a cell, parts that touch only in a vertex, a one-sided piece, an `outside`
        that does not tell a piece's sides apart, a group that is empty or names missing members, or
        invalid `ranks`.

    Examples
    --------
    >>> points = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)]
    >>> cells = [(0, 1, 2), (0, 2, 3)]
    >>> meshes.from_arrays(MPI.COMM_WORLD, points, cells, parts={"roof": [0, 1]})
    MembraneMesh(2 cells, 4 vertices; edges boundary; parts roof)
    """

    def arrays() -> SurfaceArrays:
        return SurfaceArrays(
            () if points is None else points,
            () if cells is None else cells,
            edges or {},
            parts or {},
            point_groups or {},
        )

    return build_and_distribute(comm, arrays, outside, ranks)


def build_and_distribute(
    comm: MPI.Intracomm,
    build: Callable[[], SurfaceArrays],
    outside: Outside = UPWARD,
    ranks: Ranks | None = None,
) -> MembraneMesh:
    """Build a surface on rank 0, without communication, check, orient and distribute it."""
    surface, given, project = EMPTY, None, None
    with raised_together(comm):
        if comm.rank == 0:
            arrays = build()
            surface, project = checked_surface(arrays, outside), arrays.project
            given = None if ranks is None else _checked_ranks(surface, ranks, comm.size)
    return distribute(comm, surface, given, project)


def distribute(
    comm: MPI.Intracomm, surface: CheckedSurface, given: Indices | None, project: Projection | None
) -> MembraneMesh:
    """Distribute a surface from rank 0, to given ranks of the cells if there are any."""
    mesh = create_mesh(comm, surface.cells, surface.points, _cell_ranks(comm, surface, given))
    topology = mesh.topology
    topology.create_entities(1)
    for a, b in ((1, 2), (2, 1), (0, 2)):
        topology.create_connectivity(a, b)
    vertices = vertex_ids(mesh)
    pairs = vertices[topology.connectivity(1, 0).array.reshape(-1, 2)]
    return MembraneMesh(
        mesh,
        _local_groups(comm, edge_keys(pairs), surface.edges),
        _local_groups(comm, topology.original_cell_index, surface.parts),
        _local_groups(comm, vertices, surface.point_groups),
        _local_groups(comm, topology.original_cell_index, {"hidden": surface.hidden})["hidden"],
        project,
    )


def _cell_ranks(
    comm: MPI.Intracomm, surface: CheckedSurface, given: Indices | None
) -> Indices | None:
    """Ranks of this rank's share of the input cells; None lets DOLFINx choose. Collective."""
    # DOLFINx detects vertices shared between ranks at edges with fewer than two cells on a rank. A
    # seam whose cells are scattered would be torn: two ranks would have separate vertices there.
    is_given, has_seams = comm.bcast((given is not None, len(surface.seam_links) > 0))
    if comm.size == 1 or not (is_given or has_seams):
        return None
    if not is_given:
        given = default_ranks(comm, surface.cells)
    ranks, links = np.zeros(0, dtype=np.int32) if given is None else given, surface.seam_links
    if not len(links):
        return ranks
    label = connected_labels(len(ranks), links[:, 0], links[:, 1])
    least = np.full(label.max() + 1, np.iinfo(np.int32).max, dtype=np.int32)
    np.minimum.at(least, label, ranks)
    together: Indices = least[label]  # linked cells go to the lowest of their ranks
    return together


def _checked_ranks(surface: CheckedSurface, ranks: Ranks, size: int) -> Indices:
    """Check and return the rank of each cell (m,) wanted by the caller."""
    midpoints = surface.points[surface.cells].mean(axis=1)
    given = np.asarray(ranks(midpoints) if callable(ranks) else ranks)
    count = len(midpoints)
    if given.shape != (count,) or given.dtype.kind not in "iu":
        raise MeshError(
            f"`ranks` is an array of {given.dtype} of shape {given.shape}; pass an integer for "
            f"each of the {count} cells."
        )
    bad = np.flatnonzero((given < 0) | (given >= size))
    if len(bad):
        raise MeshError(
            f"`ranks` puts cell {bad[0]} on rank {given[bad[0]]}, but there are only ranks 0 to "
            f"{size - 1}; name one of these."
        )
    return given.astype(np.int32)


def mesh_generator(shape: Callable[P, SurfaceArrays]) -> Callable[P, MembraneMesh]:
    """Turn a function that meshes a shape on rank 0 into a collective mesh generator."""
    signature, its = inspect.signature(shape), Arguments(shape, shape.__name__)

    @functools.wraps(shape)
    def generate(*args: P.args, **kwargs: P.kwargs) -> MembraneMesh:
        given = signature.bind(*args, **kwargs)
        given.apply_defaults()
        comm, ranks = given.arguments.pop("comm"), given.arguments.pop("ranks")
        checks.same(comm, shape.__name__, **given.arguments)
        places, named = its.checked(args, kwargs)
        return build_and_distribute(comm, lambda: shape(*places, **named), ranks=ranks)

    generate.__signature__ = signature.replace(  # type: ignore[attr-defined]
        return_annotation=MembraneMesh
    )
    return generate


def moved(mesh: MembraneMesh, V: Any, places: Array) -> MembraneMesh:
    """A mesh with its vertices at other positions (n, 3), by the degrees of freedom of `V`; its
    projection is left out unless they lie where that leaves them. Collective."""
    nodes: Array = np.zeros((len(mesh.mesh.geometry.x), 3))
    nodes[geometry_dofmap(mesh.mesh)] = places[V.dofmap.list]
    new = dataclasses.replace(mesh, mesh=with_nodes(mesh.mesh, nodes), given=[])
    if not mesh.comm.bcast(mesh.project is not None):
        return new
    surface, left = gathered(new)[0], False
    with raised_together(mesh.comm):
        if mesh.comm.rank == 0 and mesh.project is not None:
            x = surface.points
            on_rim = np.isin(np.arange(len(x)), edges_of(surface.edges[BOUNDARY]))
            left = bool(np.abs(mesh.project(x.T, on_rim).T - x).max() > 1e-6 * np.ptp(x))
    return dataclasses.replace(new, project=None) if mesh.comm.bcast(left) else new


def redistributed(mesh: MembraneMesh, comm: MPI.Intracomm) -> MembraneMesh:
    """Redistribute a mesh over a subset of its ranks. Collective on all of its ranks."""
    surface, _ = gathered(mesh)
    surface = dataclasses.replace(surface, seam_links=EdgeTable.of(surface.cells).seam_links())
    everywhere = mesh.comm.allreduce(mesh.project is not None, op=MPI.LAND)  # a user's function
    sent = surface, None if everywhere else mesh.project
    roots = mesh.comm.allgather(comm.rank == 0)
    if mesh.comm.rank == 0:
        for rank in np.flatnonzero(roots[1:]) + 1:
            mesh.comm.send(sent, dest=int(rank))
    elif comm.rank == 0:
        sent = mesh.comm.recv(source=0)
    own, project = sent if comm.rank == 0 else (EMPTY, None)
    return distribute(comm, own, None, mesh.project if everywhere else project)


def vertex_nodes(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Geometry node of each local vertex, shape (vertices on this rank,)."""
    vertex_map = mesh.topology.index_map(0)
    nodes = np.empty(vertex_map.size_local + vertex_map.num_ghosts, dtype=np.int32)
    nodes[mesh.topology.connectivity(2, 0).array] = geometry_dofmap(mesh).ravel()
    return nodes


def vertex_ids(mesh: dolfinx.mesh.Mesh) -> Integers:
    """Number of each local vertex in the mesh as given, shape (n,)."""
    return np.asarray(mesh.geometry.input_global_indices[vertex_nodes(mesh)], dtype=np.int64)


def cell_vertex_ids(mesh: dolfinx.mesh.Mesh) -> Integers:
    """`vertex_ids` of each local cell's corners, shape (m, 3)."""
    return np.asarray(mesh.geometry.input_global_indices[geometry_dofmap(mesh)], dtype=np.int64)


def rows_of(mesh: MembraneMesh, call: str, groups: Sequence[str]) -> list[list[int]]:
    """Vertex ids along groups of edges, which must be open lines. Collective."""
    ends, ids = mesh.mesh.topology.connectivity(1, 0).array.reshape(-1, 2), vertex_ids(mesh.mesh)
    own = [
        edge_keys(ids[ends[checks.named("group of edges", mesh.edges, group)]]) for group in groups
    ]
    parts = mesh.comm.allgather(own)
    keys = [np.unique(np.concatenate(every)) for every in zip(*parts, strict=True)]
    return [
        whole_line(call, group, edges_of(some)) for group, some in zip(groups, keys, strict=True)
    ]


def gathered(mesh: MembraneMesh) -> tuple[CheckedSurface, Indices]:
    """The surface of a mesh and the ranks of its cells (m,), both on rank 0. Collective."""
    topology, comm = mesh.mesh.topology, mesh.comm
    ids, numbers = vertex_ids(mesh.mesh), np.asarray(topology.original_cell_index, dtype=np.int64)
    pairs = ids[topology.connectivity(1, 0).array.reshape(-1, 2)]
    parts = comm.gather((
        ids,
        mesh.mesh.geometry.x[vertex_nodes(mesh.mesh)],
        numbers,
        cell_vertex_ids(mesh.mesh),
        {name: edge_keys(pairs[members]) for name, members in mesh.edges.items()},
        {name: numbers[members] for name, members in mesh.parts.items()},
        {name: ids[members] for name, members in mesh.points.items()},
        numbers[mesh.hidden],
    ))  # fmt: skip
    if parts is None:
        return EMPTY, np.zeros(0, dtype=np.int32)
    points = np.zeros((topology.index_map(0).size_global, 3))
    cells = np.zeros((topology.index_map(2).size_global, 3), dtype=np.int64)
    ranks = np.zeros(len(cells), dtype=np.int32)
    for rank, part in enumerate(parts):
        points[part[0]] = part[1]
        cells[part[2]], ranks[part[2]] = part[3], rank
    edges, named, vertices = (
        {name: np.unique(np.concatenate([part[k][name] for part in parts])) for name in parts[0][k]}
        for k in (4, 5, 6)
    )
    hidden = np.unique(np.concatenate([part[7] for part in parts]))
    links = np.zeros((0, 2), dtype=np.int64)
    return CheckedSurface(points, cells, edges, named, vertices, links, hidden), ranks


def _local_groups(
    comm: MPI.Intracomm, keys: Integers, groups: Mapping[str, Integers]
) -> Mapping[str, Indices]:
    """Local members of the groups known to rank 0, by the keys of local entities. Collective."""
    # Rank 0 searches the keys of one rank after the other, so that no other rank ever holds a whole
    # group, and ghosts need no further communication.
    asked = comm.gather(keys, root=0)
    answers = None
    if asked is not None:
        answers = []
        for theirs in asked:
            order = np.argsort(theirs)  # once for all groups
            known = theirs[order]
            answers.append(
                {
                    name: np.sort(order[_found(known, members)]).astype(np.int32)
                    for name, members in groups.items()
                }
            )
    local: dict[str, Indices] = comm.scatter(answers, root=0)
    for indices in local.values():
        indices.setflags(write=False)
    return MappingProxyType(local)


def _found(known: Integers, keys: Integers) -> Integers:
    """Places (k,) in an ascending array of those keys that are there."""
    at = np.searchsorted(known[:-1], keys)  # the last place for those beyond
    return at[known[at] == keys] if len(known) else np.zeros(0, dtype=np.int64)


def cells_of(mesh: MembraneMesh, parts: Iterable[str]) -> Booleans:
    """Whether each local cell belongs to one of the parts, (m,)."""
    marks = np.zeros(len(geometry_dofmap(mesh.mesh)), dtype=bool)
    for part in parts:
        marks[mesh.parts[part]] = True
    return marks


def outer_first(mesh: MembraneMesh, call: str, what: str, names: Iterable[object]) -> list[str]:
    """Order parts as counted, nested ones after those around them. Collective on first access."""
    given = sorted(names, key=lambda name: checks.as_counted(repr(name)))
    for part in given:
        if part not in mesh.parts:
            known = ", ".join(sorted(mesh.parts, key=checks.as_counted)) or "(none)"
            raise InputError(f"{call}: the mesh has no part {part!r}; it has the parts {known}.")
    around = dict.fromkeys(map(str, given), 0)
    for (one, other), inner in mesh.overlaps.items():
        if one in around and other in around:
            if inner is None:
                raise InputError(
                    f"{call}: part {one!r} shares cells with part {other!r}, which has a {what} as "
                    f"well, and neither is inside the other; pass one {what} for each cell."
                )
            around[inner] += 1
    return sorted(around, key=lambda part: around[part])
