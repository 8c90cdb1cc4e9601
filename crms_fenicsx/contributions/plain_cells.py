"""Plain cells as folded ones without folds: terms of a few of them, in compiled loops.

DOLFINx's forms know all cells at once; what relaxes vertices next to a cable needs few.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.folded_membrane import FoldedCells, FoldedMembraneEnergy
from crms_fenicsx.energies.folded_pressure import Facets, FoldedFollowerPressure
from crms_fenicsx.energies.membrane import MembraneEnergy
from crms_fenicsx.energies.term import Twin
from crms_fenicsx.meshes.cell_geometry import cell_sides
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices


class PlainCells:
    """This rank's plain cells."""

    def __init__(self, unknowns: Unknowns, membrane: MembraneEnergy) -> None:
        self._energy, mesh = membrane, membrane.u.function_space.mesh
        self.cells = np.flatnonzero(
            membrane.plain.x.array[: mesh.topology.index_map(2).size_local]
        ).astype(np.int32)
        dofs = membrane.u.function_space.dofmap.list[self.cells]
        self.blocks = unknowns.vertex_blocks()[dofs]

    def _around(self, chosen: Booleans) -> Indices:
        """Rows of the cells with chosen vertices."""
        return np.flatnonzero(chosen[self.blocks].any(axis=1)).astype(np.int32)

    def membrane(self) -> Twin:
        """Twin of their strain energy."""
        stiffening = self._energy.stiffening
        return Twin(self._cells, lambda table: FoldedMembraneEnergy(table, stiffening))

    def _cells(self, chosen: Booleans) -> FoldedCells | None:
        """The cells with chosen vertices, (n_local,)."""
        rows, membrane = self._around(chosen), self._energy
        if len(rows) == 0:
            return None
        cells, n = self.cells[rows], 3 * len(rows)
        sides = cell_sides(membrane.u.function_space.mesh, cells)
        laws, parameters = membrane.laws(cells)
        ends = self.blocks[rows]
        return FoldedCells(
            cells=cells,
            segments=np.stack([ends, np.roll(ends, -1, axis=1)], axis=2).reshape(-1, 2),
            eps=np.zeros(n),
            side_pointers=np.arange(n + 1, dtype=np.int32),
            side_segments=np.arange(n, dtype=np.int32),
            sides=np.arange(n, dtype=np.int32).reshape(-1, 3),
            side_vectors=np.einsum("nki,nai->nka", sides, membrane.material_axes(cells)),
            laws=laws,
            parameters=parameters,
        )

    def pressure(self, pressed: fem.Function, pressure: fem.Constant, origin: Array) -> Twin:
        """Twin of the pressure on those of the cells that are under it."""

        def facets(chosen: Booleans) -> Facets | None:
            rows = self._around(chosen)
            rows = rows[pressed.x.array[self.cells[rows]] > 0.0]
            none = np.zeros((0, 3), dtype=np.int32)
            table = Facets(self.blocks[rows], np.ones(len(rows)), none)
            return table if len(rows) else None

        return Twin(facets, lambda table: FoldedFollowerPressure(table, pressure, origin))
