"""Meshes each of whose cells is divided into four, and places and fields of the one on the other.

The first rank makes the finer mesh, as it does all meshes. Vertices keep their numbers; the middle
of the e-th edge, in the order of `EdgeTable`, is the vertex n + e. So the finer mesh is the same on
any number of ranks. Cells stay on the rank of the cell that they are a part of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.meshes.membrane_mesh import (
    MembraneMesh,
    cell_vertex_ids,
    shared_out,
    vertex_ids,
    vertex_nodes,
)
from crms_fenicsx.meshes.surface import EMPTY, Projection, Surface, check_shapes
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.surface.points import CellPoint, Edge, EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.surface.smooth_surface import SmoothSurface


@dataclass(frozen=True)
class UniformRefinement:
    """A mesh and the finer one that has four cells for each of its own.

    Attributes
    ----------
    finer
        The finer mesh.
    vertices
        How many vertices the coarse mesh has.
    edges : (e, 2)
        On rank 0: ids of the ends of the coarse mesh's edges; elsewhere empty.
    """

    finer: MembraneMesh
    vertices: int
    edges: Integers

    @classmethod
    def of(
        cls, mesh: MembraneMesh, project: Callable[[Array], Array] | None = None
    ) -> UniformRefinement:
        """Divide each cell into four. Collective.

        Parameters
        ----------
        mesh
            The mesh.
        project
            Function of points (3, n) near the stress-free surface that returns the points (3, n) of
            the surface that new vertices are to lie in. By default it is what the mesh's generator
            knows; else the smooth surface behind the facets, flat where they are.

        Raises
        ------
        InputError
            On all ranks: a function that returns no such points.
        MeshError
            On all ranks: points that leave cells without area.
        """
        surface, ranks = _gathered(mesh)
        finer = EMPTY
        edges: Integers = np.zeros((0, 2), dtype=np.int64)
        onto = mesh.project if project is None else _checked(project)
        with raised_together(mesh.comm):
            if mesh.comm.rank == 0:
                table = EdgeTable.of(surface.cells)
                finer, edges = _divided(surface, table, onto), table.vertices
        return cls(
            shared_out(mesh.comm, finer, np.repeat(ranks, 4), onto),
            mesh.mesh.topology.index_map(0).size_global,
            edges,
        )

    def carried(
        self,
        ids: Integers,
        values: Array,
        finer_ids: Integers,
        bends: Mapping[Edge, Array] | None = None,
    ) -> Array:
        """Values at vertices of the finer mesh, in the middles of edges means of their ends.

        Collective.

        Parameters
        ----------
        ids, values : (n,), (n, k)
            Vertices of the coarse mesh that this rank owns, and the values there.
        finer_ids : (m,)
            The vertices of the finer mesh that this rank wants the values of.
        bends
            What is added to these means (k,) on some edges, the same on all ranks.
        """
        comm = self.finer.comm
        given = comm.gather((ids, values), root=0)
        wanted = comm.gather(finer_ids, root=0)
        answers = None
        if given is not None and wanted is not None:
            coarse = np.zeros((self.vertices, values.shape[1]))
            for theirs, some in given:
                coarse[theirs] = some
            means = coarse[self.edges].mean(axis=1)
            keys = edge_keys(self.edges)
            for edge, value in (bends or {}).items():
                means[np.searchsorted(keys, edge_keys(np.array([edge]))[0])] += value
            fine = np.concatenate([coarse, means])
            answers = [fine[theirs] for theirs in wanted]
        found: Array = comm.scatter(answers, root=0)
        return found

    def places(self, points: Sequence[SurfacePoint]) -> list[SurfacePoint]:
        """Where places on the coarse mesh are on the finer one. Collective.

        Parameters
        ----------
        points
            The same on all ranks.
        """
        comm = self.finer.comm
        found: list[SurfacePoint] = []
        if comm.rank == 0:
            keys = edge_keys(self.edges)

            def middle(a: int, b: int) -> int:
                key = edge_keys(np.array([[a, b]]))[0]
                return self.vertices + int(np.searchsorted(keys, key))

            found = [_place(point, middle) for point in points]
        return comm.bcast(found)

    def along_edges(self, points: Sequence[SurfacePoint]) -> list[SurfacePoint]:
        """`places` of a path with the middles of the edges that it follows. Collective."""
        dense: list[SurfacePoint] = []
        for point in points:
            last = dense[-1] if dense else None
            if isinstance(last, VertexPoint) and isinstance(point, VertexPoint):
                edge = (min(last.vertex, point.vertex), max(last.vertex, point.vertex))
                dense.append(EdgePoint(edge, 0.5))
            dense.append(point)
        return self.places(dense)


def _checked(project: Callable[[Array], Array]) -> Projection:
    """The user's function, of which all is checked that can be."""

    def onto(points: Array, on_rim: Booleans) -> Array:
        found = np.asarray(project(points.copy()))
        if found.shape != points.shape or found.dtype.kind not in "fiu":
            raise InputError(
                f"refine: project returned an array of shape {found.shape} and type {found.dtype}; "
                f"it must return real numbers of shape {points.shape}."
            )
        bad = ~np.isfinite(found).all(axis=0)
        if bad.any():
            first = int(np.argmax(bad))
            raise InputError(
                f"refine: project returned {found[:, first]} at {points[:, first]}; it must return "
                "finite coordinates."
            )
        return np.asarray(found, dtype=np.float64)

    return onto


def _divided(surface: Surface, table: EdgeTable, onto: Projection | None) -> Surface:
    """A surface each of whose cells is divided into four."""
    n, m = len(surface.points), len(surface.cells)
    middles = surface.points[table.vertices].mean(axis=1)
    if onto is not None:
        middles = onto(middles.T, table.counts == 1).T
    else:
        smooth = SmoothSurface.of(surface.points, surface.cells)
        corners = np.column_stack([table.vertices, table.vertices[:, 0]])
        middles = middles + smooth.raised(corners, np.tile([0.5, 0.5, 0.0], (len(corners), 1)))[0]
    side = np.empty(3 * m, dtype=np.int64)  # the edge of each side
    side[table.order] = np.repeat(np.arange(len(table.counts)), table.counts)
    (a, b, c), (ab, bc, ca) = surface.cells.T, n + side.reshape(-1, 3).T
    cells = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    points = np.concatenate([surface.points, middles])
    check_shapes(points, cells)
    finer_table = EdgeTable.of(cells)

    def halves(keys: Integers) -> Integers:
        ends, middle = np.stack([keys >> 32, keys & 0xFFFFFFFF]), np.searchsorted(table.keys, keys)
        return edge_keys(np.stack([ends, np.broadcast_to(n + middle, ends.shape)], axis=-1))

    def quarters(numbers: Integers) -> Integers:
        return (4 * numbers[:, None] + np.arange(4)).ravel()

    return Surface(
        points,
        cells,
        {name: np.unique(halves(keys)) for name, keys in surface.edges.items()},
        {name: quarters(members) for name, members in surface.parts.items()},
        surface.point_groups,
        np.stack(finer_table.seam_sides(), axis=1) // 3,
        quarters(surface.hidden),
    )


def _gathered(mesh: MembraneMesh) -> tuple[Surface, Indices]:
    """A mesh and the ranks of its cells, all of it on rank 0. Collective."""
    topology, comm = mesh.mesh.topology, mesh.comm
    own = topology.index_map(2).size_local
    ids, numbers = vertex_ids(mesh.mesh), np.asarray(topology.original_cell_index, dtype=np.int64)
    pairs = ids[topology.connectivity(1, 0).array.reshape(-1, 2)]
    parts = comm.gather((
        ids,
        mesh.mesh.geometry.x[vertex_nodes(mesh.mesh)],
        numbers[:own],
        cell_vertex_ids(mesh.mesh)[:own],
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
    return Surface(points, cells, edges, named, vertices, links, hidden), ranks


def _place(point: SurfacePoint, middle: Callable[[int, int], int]) -> SurfacePoint:
    """Where a place is on the finer mesh, by the weights of the corners of the quarter it is in."""
    ids, weights = point.support, np.array(point.weights)
    if len(ids) == 1:
        return point
    at = int(np.argmax(weights))
    if weights[at] >= 0.5:
        found = {ids[at]: 2 * weights[at] - 1}
        for k in range(len(ids)):
            if k != at:
                found[middle(ids[at], ids[k])] = 2 * weights[k]
    else:
        pairs = ((0, (1, 2)), (1, (2, 0)), (2, (0, 1)))
        found = {middle(ids[i], ids[j]): 1 - 2 * weights[k] for k, (i, j) in pairs}
    inside = {vertex: float(share) for vertex, share in found.items() if share > 0.0}
    if len(inside) == 1:
        return VertexPoint(next(iter(inside)))
    if len(inside) == 2:
        (a, first), (b, second) = sorted(inside.items())
        return EdgePoint((a, b), second / (first + second))
    total = sum(inside.values())
    cell = tuple(inside)
    return CellPoint(
        (cell[0], cell[1], cell[2]),
        (inside[cell[0]] / total, inside[cell[1]] / total, inside[cell[2]] / total),
    )
