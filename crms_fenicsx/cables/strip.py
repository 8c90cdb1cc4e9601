"""The strip of cells around the cables, known to all ranks.

Its size is that of the cables, not of the mesh: each rank selects among its own cells, and only
those are gathered. It grows as cables slide.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.trace import near_section
from crms_fenicsx.surface.triangles import cross, norm

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene

Edge = tuple[int, int]


@dataclass(frozen=True)
class Strip:
    """Cells with the ids of their vertices, their owners and their numbers there.

    Attributes
    ----------
    cells : (n, 3)
        Vertex ids (numbers in the mesh as it was given), in the cells' own order.
    owner, local : (n,)
        Owning rank and the cell's local number on it.
    complete
        Ids of the vertices all of whose cells are here.
    held_edges
        Edges (a, b), a < b, of these cells that are held over their whole length.
    hidden
        Cells (a, b, c), a < b < c, behind a seam: cables fold them at the seam, but do not lie on
        them.
    """

    cells: Integers
    owner: Integers
    local: Integers
    complete: frozenset[int] = frozenset()
    held_edges: frozenset[tuple[int, int]] = frozenset()
    hidden: frozenset[tuple[int, int, int]] = frozenset()

    @cached_property
    def around(self) -> dict[tuple[int, ...], list[int]]:
        """Rows of the cells around each vertex (a,), edge (a, b) and cell (a, b, c), sorted."""
        return _around(self.corners, frozenset())

    @cached_property
    def outer_around(self) -> dict[tuple[int, ...], list[int]]:
        """`around`, without the cells behind seams."""
        return _around(self.corners, self.hidden) if self.hidden else self.around

    @cached_property
    def outer_cells(self) -> Integers:
        """`cells`, without those behind seams, (n, 3)."""
        if not self.hidden:
            return self.cells
        return self.cells[[tuple(sorted(cell)) not in self.hidden for cell in self.corners]]

    @cached_property
    def corners(self) -> list[list[int]]:
        """`cells` as lists of numbers, which loops read faster."""
        return [[int(vertex) for vertex in cell] for cell in self.cells]

    @cached_property
    def owners(self) -> list[int]:
        """`owner` as a list of numbers."""
        return [int(rank) for rank in self.owner]

    @cached_property
    def sides(self) -> list[list[tuple[Edge, bool]]]:
        """Sides of each cell: the ids ascending, and whether that is the cell's own direction."""
        return [
            [((a, b), True) if a < b else ((b, a), False) for a, b in pairwise((*cell, cell[0]))]
            for cell in self.corners
        ]

    @cached_property
    def vertices(self) -> Integers:
        """Ids of all vertices, ascending, (k,)."""
        return np.unique(self.cells)

    @cached_property
    def givers(self) -> Integers:
        """Where each of `vertices` is in the flat `cells`: in a cell of the lowest rank, (k,)."""
        order = np.argsort(np.repeat(self.owner, 3), kind="stable")
        _, first = np.unique(self.cells.ravel()[order], return_index=True)
        return order[first]

    @cached_property
    def row_of(self) -> dict[int, int]:
        """Place of each vertex in `vertices`."""
        return {int(vertex): row for row, vertex in enumerate(self.vertices)}

    def rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells that hold all these vertices."""
        return _rows(self.around, vertices)

    def outer_rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells that hold all these vertices and that cables can lie on."""
        return _rows(self.outer_around, vertices)

    def owner_of(self, vertices: tuple[int, ...]) -> int:
        """The rank that owns what lies on these vertices: the lowest one with a cell there."""
        return min(self.owners[row] for row in self.rows(vertices))

    def merged(self, other: Strip) -> Strip:
        """Cells of both."""
        keys = np.concatenate(
            [np.stack([s.owner, s.local], axis=1) for s in (self, other)]
        )  # fmt: skip
        _, first = np.unique(keys, axis=0, return_index=True)
        return Strip(
            np.concatenate([self.cells, other.cells])[first],
            np.concatenate([self.owner, other.owner])[first],
            np.concatenate([self.local, other.local])[first],
            self.complete | other.complete,
            self.held_edges | other.held_edges,
            self.hidden | other.hidden,
        )


def _around(
    cells: list[list[int]], but: frozenset[tuple[int, int, int]]
) -> dict[tuple[int, ...], list[int]]:
    """Rows of the cells around each vertex, edge and cell, without some cells."""
    table: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for row, cell in enumerate(cells):
        a, b, c = sorted(cell)
        if (a, b, c) not in but:
            for key in ((a,), (b,), (c,), (a, b), (a, c), (b, c), (a, b, c)):
                table[key].append(row)
    return dict(table)


def _rows(around: dict[tuple[int, ...], list[int]], vertices: tuple[int, ...]) -> list[int]:
    """What is at vertices in any order, also repeated; most often they are in order."""
    found = around.get(vertices)
    return around.get(tuple(sorted(set(vertices))), []) if found is None else found


EMPTY = Strip(np.zeros((0, 3), dtype=np.int64), *(np.zeros(0, dtype=np.int64),) * 2)


class StripShape:
    """Positions of a strip's vertices, on all ranks.

    Attributes
    ----------
    strip
        The cells.
    current, stress_free : (k, 3)
        Positions (length) of `strip.vertices`.
    """

    def __init__(self, strip: Strip, current: Array, stress_free: Array) -> None:
        self.strip, self.current, self.stress_free = strip, current, stress_free

    @classmethod
    def of(cls, scene: Scene, strip: Strip | None = None) -> StripShape:
        """Gather the scene's positions, by default of its own strip. Collective."""
        strip = scene.strip if strip is None else strip
        assert strip is not None
        cell, corner = np.divmod(strip.givers, 3)
        mine = np.flatnonzero(strip.owner[cell] == scene.comm.rank)
        dofs = scene.V.dofmap.list[strip.local[cell[mine]], corner[mine]]
        given = np.zeros((2, len(strip.vertices), 3))
        given[1, mine] = scene.stress_free[dofs]
        given[0, mine] = given[1, mine] + scene.u.x.array.reshape(-1, 3)[dofs]
        found = np.zeros_like(given)
        scene.comm.Allreduce(given, found)
        return cls(strip, found[0], found[1])

    @cached_property
    def places(self) -> dict[int, tuple[float, float, float]]:
        """Current positions of all vertices, by id, which loops read faster."""
        rows = zip(self.strip.vertices, *self.current.T, strict=True)
        return {int(vertex): (float(x), float(y), float(z)) for vertex, x, y, z in rows}

    def at(self, vertex: int) -> Array:
        """Current position of a vertex, by id, (3,)."""
        return self.current[self.strip.row_of[vertex]]

    @cached_property
    def normals(self) -> Array:
        """Current normals of the cells, twice as long as their areas, (n, 3)."""
        x = self.current[np.searchsorted(self.strip.vertices, self.strip.cells)]
        return cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])

    @cached_property
    def stress_free_normals(self) -> Array:
        """Stress-free normals of the cells, twice as long as their areas, (n, 3)."""
        x = self.stress_free[np.searchsorted(self.strip.vertices, self.strip.cells)]
        return cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])

    def stress_free_size(self, support: tuple[int, ...]) -> float:
        """Size of the stress-free cells around a vertex or an edge (length)."""
        around = self.stress_free_normals[self.strip.outer_rows(support)]
        return float(np.linalg.norm(around, axis=1).mean() ** 0.5)

    def stress_free_at(self, vertex: int) -> Array:
        """Stress-free position of a vertex, by id, (3,)."""
        return self.stress_free[self.strip.row_of[vertex]]

    def normals_and_sizes(self, supports: Sequence[tuple[int, ...]]) -> tuple[Array, Array]:
        """Normals and sizes of the membrane at vertices, edges or cells: of the cells around.

        Parameters
        ----------
        supports
            Ids of their vertices, (m,).

        Returns
        -------
        normals : (m, 3)
            Current unit normals.
        sizes : (m,)
            Square roots of twice the cells' mean areas (length).
        """
        around = [self.strip.outer_around[tuple(sorted(support))] for support in supports]
        counts = np.array([len(rows) for rows in around], dtype=np.int64)
        normals = self.normals[np.fromiter(chain.from_iterable(around), np.int64)]
        first = np.cumsum(counts) - counts
        totals, areas = (np.add.reduceat(values, first) for values in (normals, norm(normals)))
        return totals / norm(totals)[:, None], np.sqrt(areas / counts)

    def normal(self, support: tuple[int, ...]) -> Array:
        """Current unit normal at a vertex, an edge or a cell: that of the cells around, (3,)."""
        return self.normals_and_sizes([support])[0][0]


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
