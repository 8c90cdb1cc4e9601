"""The strip of cells that cables cross, known to all ranks.

Its size is that of the cables, not of the mesh: each rank selects among its own cells, and only
those are gathered.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.trace import near_section
from crms_fenicsx.compat import geometry_dofmap

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Strip:
    """Cells with the ids of their vertices, their owners and their numbers there.

    Attributes
    ----------
    cells : (n, 3)
        Vertex ids (numbers in the mesh as it was given), in the cells' own order.
    owner, local : (n,)
        Owning rank and the cell's local number on it.
    """

    cells: Integers
    owner: Integers
    local: Integers

    @cached_property
    def around(self) -> dict[tuple[int, ...], list[int]]:
        """Rows of the cells around each vertex (a,), edge (a, b) and cell (a, b, c), sorted."""
        table: dict[tuple[int, ...], list[int]] = defaultdict(list)
        for row in range(len(self.cells)):
            a, b, c = sorted(int(vertex) for vertex in self.cells[row])
            for key in ((a,), (b,), (c,), (a, b), (a, c), (b, c), (a, b, c)):
                table[key].append(row)
        return dict(table)

    def rows(self, vertices: tuple[int, ...]) -> list[int]:
        """Rows of the cells that hold all these vertices."""
        return self.around.get(tuple(sorted(set(vertices))), [])

    def owner_of(self, vertices: tuple[int, ...]) -> int:
        """The rank that owns what lies on these vertices: the lowest one with a cell there."""
        return int(min(self.owner[row] for row in self.rows(vertices)))

    def select(self, rows: npt.NDArray[np.bool_]) -> Strip:
        """The strip of some rows."""
        return Strip(self.cells[rows], self.owner[rows], self.local[rows])

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
        )


EMPTY = Strip(np.zeros((0, 3), dtype=np.int64), *(np.zeros(0, dtype=np.int64),) * 2)


def gather_strip(scene: Scene, route: Array) -> tuple[Strip, Integers, Array, Array]:
    """Gather the cells near a route on the current shape.

    Returns
    -------
    strip
        Cells near the route.
    vertices : (n,), positions : (n, 3)
        Their vertices' ids and current positions.
    rows : (m, 3)
        The cells as rows of `vertices`.
    """
    mesh = scene.mesh.mesh
    comm = mesh.comm
    owned = mesh.topology.index_map(2).size_local
    nodes = geometry_dofmap(mesh)[:owned]
    ids = np.asarray(mesh.geometry.input_global_indices, dtype=np.int64)
    current = scene.positions()
    dofs = scene.V.dofmap.list[:owned]
    positions = np.zeros((mesh.geometry.x.shape[0], 3))
    positions[nodes] = current[dofs]
    near = np.flatnonzero(near_section(positions, nodes, route, comm=comm))
    parts = comm.allgather((ids[nodes[near]], near, positions[nodes[near]]))
    cells = np.concatenate([part[0].reshape(-1, 3) for part in parts])
    owner = np.concatenate([np.full(len(part[1]), rank) for rank, part in enumerate(parts)])
    local = np.concatenate([part[1] for part in parts])
    corners = np.concatenate([part[2].reshape(-1, 3) for part in parts])
    vertices, first, rows = np.unique(cells.ravel(), return_index=True, return_inverse=True)
    strip = Strip(cells, owner.astype(np.int64), local.astype(np.int64))
    return strip, vertices, corners[first], rows.reshape(-1, 3)
