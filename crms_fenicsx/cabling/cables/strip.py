"""The strip of cells around the cables, gathered on all ranks, with numbered simplices.

Its size scales with the cables, not the mesh: each rank selects among its own cells, and only the
selection is gathered. It grows as cables slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.meshes.triangles import double_areas, lists, norm, vectors
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, floats, ints, runs
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.surface.points import Edge
from crms_fenicsx.foundation.surface.trace import near_section
from crms_fenicsx.model.membrane import Membrane

_CORNERS = np.array([[1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 2, 0], [1, 3, 0], [2, 3, 0], [1, 2, 3]])
"""Corners, counted from 1, of the vertices and edges of a cell and of the cell itself."""


class Simplices:
    """The m vertices, edges and cells of n cells, with the cells around each."""

    def __init__(self, cells: Integers, owner: Integers) -> None:
        self.vertices = np.unique(cells)  # ids of all vertices, ascending
        self.cells = np.searchsorted(self.vertices, cells)  # (n, 3) rows of `vertices`
        corners = np.sort(self.cells, axis=1) + 1
        corners = np.concatenate([np.zeros((len(cells), 1), dtype=np.int64), corners], axis=1)
        keys: Integers = self._keys(corners[:, _CORNERS] - 1).ravel()
        order = np.argsort(keys, kind="stable")
        self.rows = order // len(_CORNERS)  # cells around each simplex, ascending
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        self.pointers = np.append(first, len(keys))
        self.keys = keys[first]
        base = len(self.vertices) + 1
        rest, c = np.divmod(self.keys, base)
        # (m, 3) rows of `vertices` that span each simplex, ascending, padded with -1
        self.corners = np.stack([*np.divmod(rest, base), c], axis=1) - 1
        owners = owner[self.rows]
        # (m,) owner of points on each simplex: the lowest rank with a cell there
        self.owner = np.minimum.reduceat(owners, first) if len(first) else owners
        # (n, 3) edge from each corner of a cell to the next, and whether it points that way
        ends = np.stack([self.cells, np.roll(self.cells, -1, axis=1)], axis=2)
        self.forward: Booleans = ends[..., 0] < ends[..., 1]
        none = np.full((*ends.shape[:2], 1), -1)
        edges = np.concatenate([np.sort(ends, axis=2), none], axis=2)
        self.sides = np.searchsorted(self.keys, self._keys(edges))

    def _keys(self, corners: Integers) -> Integers:
        """Unique key of each simplex (..., 3), given as `corners`."""
        base = len(self.vertices) + 1
        keys: Integers = np.dot(corners + 1, [base**2, base, 1])
        return keys

    def find(self, supports: Integers) -> Integers:
        """Numbers of simplices by vertex ids (k, 3), ascending, padded with -1; -1 if absent."""
        if len(self.keys) == 0:
            return np.full(len(supports), -1)
        corners = np.minimum(np.searchsorted(self.vertices, supports), len(self.vertices) - 1)
        here = ((self.vertices[corners] == supports) | (supports < 0)).all(axis=1)
        keys = self._keys(np.where(supports < 0, -1, corners))
        found = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(here & (self.keys[found] == keys), found, -1)

    def spanned(self, first: Integers, second: Integers) -> Integers:
        """Numbers (k,) of simplices spanned by the vertices of two others; -1 if there is none."""
        found: Integers = _spanned(self.corners, self.keys, len(self.vertices) + 1, first, second)
        return found

    def around(self, simplices: Integers) -> tuple[Integers, Integers]:
        """Number of cells around each of some simplices (k,), and their rows."""
        first, counts = self.pointers[simplices], np.diff(self.pointers)[simplices]
        return counts, self.rows[runs(first, counts)]

    def touch(self, cells: Booleans) -> Booleans:
        """Whether each simplex (m,) belongs to any of the chosen cells (n,)."""
        chosen = cells[self.rows]
        return np.logical_or.reduceat(chosen, self.pointers[:-1]) if len(chosen) else chosen


@numba.njit(cache=True)
def _spanned(corners, keys, base, first, second):  # type: ignore[no-untyped-def]
    """`Simplices.spanned` with explicit arrays."""
    found = np.full(len(first), -1)
    for n in range(len(first)):
        if first[n] < 0 or second[n] < 0:
            continue
        one, other = corners[first[n]], corners[second[n]]
        key, i, j, size = 0, 0, 0, 0
        while (i < 3 and one[i] >= 0) or (j < 3 and other[j] >= 0):  # both ascend
            a = one[i] if i < 3 and one[i] >= 0 else base
            b = other[j] if j < 3 and other[j] >= 0 else base
            i, j = i + (a <= b), j + (b <= a)
            key, size = key * base + min(a, b) + 1, size + 1
        if size <= 3:
            key *= base ** (3 - size)
            low, high = 0, len(keys)
            while low < high:  # np.searchsorted would take half a second to compile
                middle = (low + high) // 2
                low, high = (middle + 1, high) if keys[middle] < key else (low, middle)
            if low < len(keys) and keys[low] == key:
                found[n] = low
    return found


NOBODY = np.iinfo(np.int32).max
"""Owner of covers, the cells without material that close holes below cables."""


class _CellsAround(dict[tuple[int, ...], list[int]]):
    """Cache of rows, ascending, of the cells around a vertex (a,), an edge (a, b) or a cell (a, b,
    c), vertices in any order or repeated. `some` (k,): rows of the cells considered."""

    def __init__(
        self, cells: Integers, corners: list[list[int]], some: Integers | None = None
    ) -> None:
        super().__init__()
        vertices = cells if some is None else cells[some]
        order = np.argsort(vertices, axis=None, kind="stable")
        ids, first = np.unique(vertices.ravel()[order], return_index=True)
        rows = order // 3 if some is None else some[order // 3]
        self._rows = ints(rows)
        cuts = pairwise([*ints(first), len(rows)])
        self._at = dict(zip(ints(ids), cuts, strict=True))
        self._corners = corners

    def __missing__(self, vertices: tuple[int, ...]) -> list[int]:
        first, *others = vertices
        rows = self._rows[slice(*self._at.get(first, (0, 0)))]
        found = [row for row in rows if all(vertex in self._corners[row] for vertex in others)]
        self[vertices] = found
        return found


@dataclass(frozen=True)
class Strip:
    """Cells with vertex ids, owners and local numbers."""

    # (n, 3) vertex ids (numbers in the given mesh), in each cell's own order; cells in the order of
    # `ascending`, so that sums over cells round alike for any number of ranks
    cells: Integers
    owner: Integers  # (n,) owning rank; `NOBODY` for covers of holes
    local: Integers  # (n,) local number on its owner; -1 for covers
    complete: frozenset[int] = frozenset()  # vertices with all their cells in the strip
    held_edges: frozenset[Edge] = frozenset()  # held over their whole length
    # cells (a, b, c), a < b < c, behind a seam, which cables fold but do not lie on
    hidden: frozenset[tuple[int, int, int]] = frozenset()

    @cached_property
    def _around(self) -> _CellsAround:
        return _CellsAround(self.cells, self.corners)

    @cached_property
    def _outer_around(self) -> _CellsAround:
        """`_around` without cells behind seams."""
        if not self.hidden:
            return self._around
        return _CellsAround(self.cells, self.corners, np.flatnonzero(self.is_outer))

    @cached_property
    def outer_cells(self) -> Integers:
        """`cells` without those behind seams, (n, 3)."""
        return self.cells[self.is_outer] if self.hidden else self.cells

    @cached_property
    def is_outer(self) -> Booleans:
        """Whether each cell is not behind a seam, (n,)."""
        if not self.hidden:
            return np.ones(len(self.cells), dtype=bool)
        outer = [tuple(sorted(cell)) not in self.hidden for cell in self.corners]
        return np.array(outer, dtype=bool)

    @cached_property
    def covers(self) -> Integers:
        """Cells without material over holes that cables span, (m, 3)."""
        return self.cells[self.owner == NOBODY]

    def with_covers(self, covers: Integers) -> Strip:
        """The strip with covers of holes, around whose vertices it must be complete."""
        if not len(covers):
            return self
        none = np.full(len(covers), -1)
        return self.merged(Strip(covers[ascending(covers)], np.full(len(covers), NOBODY), none))

    def over_hole(self, support: tuple[int, ...]) -> bool:
        """Whether a vertex, an edge or a cell belongs to covers only, where no cable touches."""
        if not len(self.covers):
            return False
        rows = self.rows(support)
        return len(rows) > 0 and all(self.owners[row] == NOBODY for row in rows)

    @cached_property
    def simplices(self) -> Simplices:
        """Numbered vertices, edges and cells, with the cells around them."""
        return Simplices(self.cells, self.owner)

    @cached_property
    def corners(self) -> list[list[int]]:
        """`cells` as lists, which loops read faster."""
        return lists(self.cells)

    @cached_property
    def owners(self) -> list[int]:
        """`owner` as a list."""
        return ints(self.owner)

    @cached_property
    def vertices(self) -> Integers:
        """Ids of all vertices, ascending, (k,)."""
        return np.unique(self.cells)

    @cached_property
    def givers(self) -> Integers:
        """Index of each of `vertices` in the flat `cells`, in a cell of the lowest rank, (k,)."""
        order = np.argsort(np.repeat(self.owner, 3), kind="stable")
        _, first = np.unique(self.cells.ravel()[order], return_index=True)
        return order[first]

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Row of each vertex id in `vertices`."""
        return {vertex: row for row, vertex in enumerate(ints(self.vertices))}

    def rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells with all these vertices."""
        return self._around[vertices]

    def outer_rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells with all these vertices over which cables can run."""
        return self._outer_around[vertices]

    def solid_rows(self, vertices: tuple[int, ...]) -> list[int]:
        """The same without covers, unless there are no others."""
        rows = self.outer_rows(vertices)
        return [row for row in rows if self.owners[row] != NOBODY] or rows

    def merged(self, other: Strip) -> Strip:
        """Union of two strips."""
        cells = np.concatenate([self.cells, other.cells])
        rows = ascending(cells)
        repeated = (np.diff(np.sort(cells[rows], axis=1), axis=0) == 0).all(axis=1)
        rows = rows[np.concatenate([[True], ~repeated])] if len(rows) else rows
        return Strip(
            cells[rows],
            np.concatenate([self.owner, other.owner])[rows],
            np.concatenate([self.local, other.local])[rows],
            self.complete | other.complete,
            self.held_edges | other.held_edges,
            self.hidden | other.hidden,
        )


def ascending(cells: Integers) -> Integers:
    """Rows that sort cells (n, 3) by their lowest, middle, then highest vertex id."""
    low, middle, high = np.sort(cells, axis=1).T
    return np.lexsort((high, middle, low))


EMPTY = Strip(np.zeros((0, 3), dtype=np.int64), *(np.zeros(0, dtype=np.int64),) * 2)


def cells_at(
    membrane: Membrane, vertices: npt.ArrayLike, held_edges: Booleans | None = None
) -> Strip:
    """Cells around vertices (ids, the same on all ranks), with the membrane's held edges or the
    given ones of a state to come. Collective."""
    wanted = np.unique(np.asarray(vertices, dtype=np.int64))
    ids = _own_cells(membrane)
    chosen = np.flatnonzero(np.isin(ids, wanted).any(axis=1))
    strip = _gathered(membrane, ids, chosen, held_edges)
    return replace(strip, complete=frozenset(int(vertex) for vertex in wanted))


def grown(membrane: Membrane, strip: Strip, vertices: npt.ArrayLike, rings: int = 1) -> Strip:
    """Strip extended by rings of cells around vertices (ids, the same on all ranks). Collective."""
    wanted = np.unique(np.asarray(vertices, dtype=np.int64))
    for ring in range(rings):
        if ring:
            wanted = np.unique(strip.cells[np.isin(strip.cells, wanted).any(axis=1)])
        lacking = [v for v in ints(wanted) if v not in strip.complete]
        if lacking:
            strip = strip.merged(cells_at(membrane, lacking))
    return strip


def cells_near(membrane: Membrane, route: Array, along_legs: bool) -> Strip:
    """Cells not behind seams that tracing a route on the current shape needs, or only those along
    its legs, which suffice for most routes. Collective."""
    positions, nodes = own_surface(membrane)
    outer = np.setdiff1d(np.arange(len(nodes)), membrane.mesh.hidden)
    near = near_section(positions, nodes[outer], route, comm=membrane.comm, along_legs=along_legs)
    return _gathered(membrane, _own_cells(membrane), outer[near])


def whole(membrane: Membrane) -> Strip:
    """All cells. Collective."""
    ids = _own_cells(membrane)
    return _gathered(membrane, ids, np.arange(len(ids)))


def own_surface(membrane: Membrane) -> tuple[Array, Integers]:
    """Current positions (k, 3), and their rows for the corners of this rank's cells, (n, 3)."""
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


def _gathered(
    membrane: Membrane, ids: Integers, chosen: Integers, held_edges: Booleans | None = None
) -> Strip:
    """Gather the chosen cells of all ranks."""
    held = membrane.held_edges if held_edges is None else held_edges
    edges = membrane.mesh.mesh.topology.connectivity(2, 1).array.reshape(-1, 3)[chosen]
    cell, k = np.nonzero(held[edges])  # edge k lies opposite to vertex k
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


class StripShape:
    """Current and stress-free positions (k, 3) (length) of a strip's vertices, on all ranks."""

    def __init__(self, strip: Strip, current: Array, stress_free: Array) -> None:
        self.strip, self.current, self.stress_free = strip, current, stress_free

    @classmethod
    def of(cls, membrane: Membrane, strip: Strip) -> StripShape:
        """Gather the positions of a strip's vertices from all ranks. Collective."""
        cell, corner = np.divmod(strip.givers, 3)
        mine = np.flatnonzero(strip.owner[cell] == membrane.comm.rank)
        dofs = membrane.V.dofmap.list[strip.local[cell[mine]], corner[mine]]
        given = np.zeros((2, len(strip.vertices), 3))
        given[1, mine] = membrane.stress_free[dofs]
        given[0, mine] = given[1, mine] + membrane.u.x.array.reshape(-1, 3)[dofs]
        membrane.comm.Allreduce(MPI.IN_PLACE, given)
        return cls(strip, given[0], given[1])

    @cached_property
    def places(self) -> dict[int, tuple[float, float, float]]:
        """Current positions by vertex id, which loops read faster."""
        rows = zip(ints(self.strip.vertices), *map(floats, vectors(self.current.T)), strict=True)
        return {vertex: (x, y, z) for vertex, x, y, z in rows}

    def at(self, vertex: int) -> Array:
        """Current position (3,) of a vertex id."""
        return self.current[self.strip.row_of[vertex]]

    def mean(self, vertices: Sequence[int], weights: Sequence[float]) -> Array:
        """Current position (3,) interpolated from vertex ids and weights."""
        return np.asarray(np.dot(weights, [self.at(vertex) for vertex in vertices]))

    @cached_property
    def normals(self) -> Array:
        """Current cell normals of twice the cell area, (n, 3)."""
        return double_areas(self.current[self.strip.simplices.cells])

    @cached_property
    def stress_free_normals(self) -> Array:
        """Stress-free cell normals of twice the cell area, (n, 3)."""
        return double_areas(self.stress_free[self.strip.simplices.cells])

    def stress_free_size(self, support: tuple[int, ...]) -> float:
        """Stress-free cell size around a vertex or an edge (length)."""
        around = self.stress_free_normals[self.strip.solid_rows(support)]
        return float(np.linalg.norm(around, axis=1).mean() ** 0.5)

    def stress_free_at(self, vertex: int) -> Array:
        """Stress-free position (3,) of a vertex id."""
        return self.stress_free[self.strip.row_of[vertex]]

    def normals_and_sizes(self, supports: Sequence[tuple[int, ...]]) -> tuple[Array, Array]:
        """Current unit normals (m, 3) at vertices, edges or cells, and sizes (m,): square roots of
        twice the mean area of the cells around (length)."""
        around = [self.strip.solid_rows(support) for support in supports]
        counts = np.array([len(rows) for rows in around], dtype=np.int64)
        return self._means(counts, np.fromiter(chain.from_iterable(around), np.int64))

    def around(self, simplices: Integers) -> tuple[Array, Array]:
        """The same for simplices given by number, (m,)."""
        counts, rows = self.strip.simplices.around(simplices)
        strip = self.strip
        if strip.hidden or len(strip.covers):
            of = np.repeat(np.arange(len(counts)), counts)
            kept = (strip.owner[rows] != NOBODY) | (strip.simplices.owner[simplices] == NOBODY)[of]
            if strip.hidden:
                kept &= strip.is_outer[rows]
            counts, rows = np.bincount(of[kept], minlength=len(counts)), rows[kept]
        return self._means(counts, rows)

    def _means(self, counts: Integers, rows: Integers) -> tuple[Array, Array]:
        """Normals and sizes for consecutive lists of cells."""
        normals, first = self.normals[rows], np.cumsum(counts) - counts
        totals, areas = [np.add.reduceat(values, first) for values in (normals, norm(normals))]
        return totals / norm(totals)[:, None], np.sqrt(areas / counts)

    def normal(self, support: tuple[int, ...]) -> Array:
        """Current unit normal (3,) of the cells around a vertex, an edge or a cell."""
        return self.normals_and_sizes([support])[0][0]
