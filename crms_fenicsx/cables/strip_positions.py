"""Positions of the vertices of the strip of cells around the cables."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import chain

import numpy as np

from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.meshes.triangles import cross, norm
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array


class StripShape:
    """Positions of a strip's vertices, on all ranks.

    Attributes: `strip`: the cells; `current`, `stress_free` (k, 3): positions (length) of
    `strip.vertices`.
    """

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
        found = np.zeros_like(given)
        membrane.comm.Allreduce(given, found)
        return cls(strip, found[0], found[1])

    @cached_property
    def places(self) -> dict[int, tuple[float, float, float]]:
        """Current positions of all vertices, by id, which loops read faster."""
        rows = zip(self.strip.vertices, *self.current.T, strict=True)
        return {int(vertex): (float(x), float(y), float(z)) for vertex, x, y, z in rows}

    def at(self, vertex: int) -> Array:
        """Current position of a vertex, by id, (3,)."""
        return self.current[self.strip.row_of[vertex]]

    def mean(self, vertices: Sequence[int], weights: Sequence[float]) -> Array:
        """Current position of a place given by weights of vertices (ids), (3,)."""
        return np.asarray(np.dot(weights, [self.at(vertex) for vertex in vertices]))

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

        Shapes: supports (m,). Returns normals (m, 3): current unit normals; sizes (m,): square
        roots of twice the cells' mean areas (length).
        """
        around = [self.strip.outer_rows(support) for support in supports]
        counts = np.array([len(rows) for rows in around], dtype=np.int64)
        normals = self.normals[np.fromiter(chain.from_iterable(around), np.int64)]
        first = np.cumsum(counts) - counts
        totals, areas = (np.add.reduceat(values, first) for values in (normals, norm(normals)))
        return totals / norm(totals)[:, None], np.sqrt(areas / counts)

    def normal(self, support: tuple[int, ...]) -> Array:
        """Current unit normal at a vertex, an edge or a cell: that of the cells around, (3,)."""
        return self.normals_and_sizes([support])[0][0]
