"""A mesh whose cells are divided, and places and fields of the one on the other.

The first rank makes the finer mesh, as it does all meshes. Vertices keep their numbers; the middle
of the k-th divided edge, in the order of `EdgeTable`, is the vertex n + k. So the finer mesh is the
same on any number of ranks. Cells stay on the rank of the cell that they are a part of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from crms_fenicsx.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.meshes.membrane_mesh import (
    MembraneMesh,
    cell_vertex_ids,
    shared_out,
    vertex_ids,
    vertex_nodes,
)
from crms_fenicsx.meshes.smooth_surface import SmoothSurface
from crms_fenicsx.meshes.surface import EMPTY, Projection, Surface, check_shapes
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.surface.points import CellPoint, Edge, EdgePoint, SurfacePoint, VertexPoint

CORNERS = np.array([(2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1)]) / 2
"""Barycentric weights, in a cell, of the vertices that its parts have: its own, and the middles of
its sides 0-1, 1-2 and 2-0."""

Own = TypeVar("Own", bound="MeshRefinement")


@dataclass(frozen=True)
class Division:
    """The parts that cells are divided into; one that is not divided is its only part.

    Attributes
    ----------
    parents : (k,)
        The cells that the parts belong to, ascending.
    corners : (k, 3)
        Rows of `CORNERS`, in the direction of the cell's own.
    """

    parents: Integers
    corners: Integers


@dataclass(frozen=True)
class MeshRefinement:
    """A mesh and a finer one.

    Attributes
    ----------
    finer
        The finer mesh.
    vertices
        How many vertices the coarse mesh has.
    edges : (e, 2)
        On rank 0: ids of the ends of the edges that are divided; elsewhere empty.
    cells : (m, 3)
        On rank 0: vertices of the coarse cells; elsewhere empty.
    division
        On rank 0: the parts of these cells, which are the cells of the finer mesh.
    """

    finer: MembraneMesh
    vertices: int
    edges: Integers
    cells: Integers
    division: Division

    @classmethod
    def made(
        cls: type[Own],
        mesh: MembraneMesh,
        divide: Callable[[Surface], Division],
        project: Callable[[Array], Array] | None,
    ) -> Own:
        """Divide cells. Collective.

        Parameters
        ----------
        mesh
            The mesh.
        divide
            Says on rank 0 how the cells of the whole mesh are divided.
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
        finer, none = EMPTY, np.zeros((0, 3), dtype=np.int64)
        edges, division = none[:, :2], Division(none[:, 0], none)
        onto = mesh.project if project is None else _checked(project)
        with raised_together(mesh.comm):
            if mesh.comm.rank == 0:
                division = divide(surface)
                finer, edges = _divided(surface, division, onto)
        return cls(
            shared_out(mesh.comm, finer, ranks[division.parents], onto),
            mesh.mesh.topology.index_map(0).size_global,
            edges,
            surface.cells,
            division,
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
            fine = np.concatenate([coarse, coarse[self.edges].mean(axis=1)])
            for edge, value in (bends or {}).items():
                middle = self._middle(*edge)
                if middle is not None:
                    fine[middle] += value
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
        on_root = self.finer.comm.rank == 0
        return self.finer.comm.bcast([self._place(point) for point in points] if on_root else [])

    def along_edges(self, points: Sequence[SurfacePoint]) -> list[SurfacePoint]:
        """`places` of a path with the middles of the edges that it follows. Collective."""
        dense: list[SurfacePoint] = []
        last: SurfacePoint | None = None
        for point in points if self.finer.comm.rank == 0 else ():
            if isinstance(last, VertexPoint) and isinstance(point, VertexPoint):
                middle = self._middle(last.vertex, point.vertex)
                if middle is not None:
                    dense.append(VertexPoint(middle))
            dense.append(self._place(point))
            last = point
        return self.finer.comm.bcast(dense)

    @cached_property
    def _keys(self) -> Integers:
        return edge_keys(self.edges)

    def _middle(self, a: int, b: int) -> int | None:
        """The vertex in the middle of an edge that is divided. On rank 0."""
        key = edge_keys(np.array([[a, b]]))[0]
        k = int(np.searchsorted(self._keys, key))
        divided = k < len(self._keys) and self._keys[k] == key
        return self.vertices + k if divided else None

    def _place(self, point: SurfacePoint) -> SurfacePoint:
        """Where a place is on the finer mesh, by the weights of the corners around it."""
        ids, weights = list(point.support), np.array(point.weights)
        if len(ids) == 1:
            return point
        if len(ids) == 2:
            middle = self._middle(*ids)
            if middle is None:
                return point
            near, far = (0, 1) if weights[0] >= 0.5 else (1, 0)
            return _point({ids[near]: weights[near] - weights[far], middle: 2 * weights[far]})
        cell = int(np.flatnonzero((np.sort(self.cells, axis=1) == np.sort(ids)).all(axis=1))[0])
        corners = self.cells[cell].tolist()
        inside = weights[[ids.index(vertex) for vertex in corners]]
        own, parts = [*corners, *map(self._middle, corners, corners[1:] + corners[:1])], []
        for part in self.division.corners[self.division.parents == cell]:
            parts.append((np.linalg.solve(CORNERS[part].T, inside), part))
        shares, part = max(parts, key=lambda one: one[0].min())
        return _point({own[k]: share for k, share in zip(part, shares, strict=True)})


def _point(weights: Mapping[int, float]) -> SurfacePoint:
    """The place of weights of one to three vertices."""
    inside = {vertex: float(share) for vertex, share in weights.items() if share > 0.0}
    total = sum(inside.values())
    if len(inside) == 1:
        return VertexPoint(next(iter(inside)))
    if len(inside) == 2:
        (a, _), (b, second) = sorted(inside.items())
        return EdgePoint((a, b), second / total)
    a, b, c = inside
    return CellPoint((a, b, c), (inside[a] / total, inside[b] / total, inside[c] / total))


def _checked(project: Callable[[Array], Array]) -> Projection:
    """The user's function, of which all is checked that can be."""
    if not callable(project):
        raise InputError(
            f"project = {project!r} is no function; give one of points (3, n) that returns those "
            "in the surface, (3, n)."
        )

    def onto(points: Array, on_rim: Booleans) -> Array:
        found = np.asarray(project(points.copy()))
        if found.shape != points.shape or found.dtype.kind not in "fiu":
            raise InputError(
                f"project returned an array of shape {found.shape} and type {found.dtype}; it must "
                f"return real numbers of shape {points.shape}."
            )
        bad = ~np.isfinite(found).all(axis=0)
        if bad.any():
            first = int(np.argmax(bad))
            raise InputError(
                f"project returned {found[:, first]} at {points[:, first]}; it must return finite "
                "coordinates."
            )
        return np.asarray(found, dtype=np.float64)

    return onto


def _divided(
    surface: Surface, division: Division, onto: Projection | None
) -> tuple[Surface, Integers]:
    """A surface whose cells are divided, and the ends of its divided edges."""
    n, parents = len(surface.points), division.parents
    table = EdgeTable.of(surface.cells)
    sides = np.empty((len(surface.cells), 3), dtype=np.int64)  # the edge of each
    sides.ravel()[table.order] = np.repeat(np.arange(len(table.counts)), table.counts)
    middle = np.full(len(table.counts), -1)
    own, k = np.nonzero(division.corners >= 3)
    middle[sides[parents[own], division.corners[own, k] - 3]] = 0
    split = np.flatnonzero(middle == 0)
    middle[split] = n + np.arange(len(split))
    around = np.concatenate([surface.cells, middle[sides]], axis=1)
    cells = np.take_along_axis(around[parents], division.corners, axis=1)
    ends = table.vertices[split]
    middles = surface.points[ends].mean(axis=1)
    if onto is not None:
        middles = onto(middles.T, table.counts[split] == 1).T
    else:
        smooth = SmoothSurface.of(surface.points, surface.cells)
        corners = np.column_stack([ends, ends[:, 0]])
        middles = middles + smooth.raised(corners, np.tile([0.5, 0.5, 0.0], (len(corners), 1)))[0]
    points = np.concatenate([surface.points, middles])
    check_shapes(points, cells)

    def parts(keys: Integers) -> Integers:
        at = middle[np.searchsorted(table.keys, keys)]
        ends = np.stack([keys >> 32, keys & 0xFFFFFFFF])[:, at >= 0]
        halves = edge_keys(np.stack([ends, np.broadcast_to(at[at >= 0], ends.shape)], axis=-1))
        return np.unique(np.concatenate([keys[at < 0], halves]))

    def children(numbers: Integers) -> Integers:
        return np.flatnonzero(np.isin(parents, numbers))

    finer = Surface(
        points,
        cells,
        {name: parts(keys) for name, keys in surface.edges.items()},
        {name: children(members) for name, members in surface.parts.items()},
        surface.point_groups,
        np.stack(EdgeTable.of(cells).seam_sides(), axis=1) // 3,
        children(surface.hidden),
    )
    return finer, ends


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
