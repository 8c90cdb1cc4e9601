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
from crms_fenicsx.model.materials import N_PARAMETERS
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.runtime.compat import geometry_dofmap


class PlainCells:
    """This rank's plain cells.

    Parameters
    ----------
    unknowns
        The layout.
    membrane
        Strain energy of the plain cells.
    """

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

    def membrane(self, chosen: Booleans) -> FoldedMembraneEnergy | None:
        """Strain energy of the cells with chosen vertices, (n_local,)."""
        rows, membrane = self._around(chosen), self._energy
        if len(rows) == 0:
            return None
        cells, n = self.cells[rows], 3 * len(rows)
        mesh = membrane.u.function_space.mesh
        X: Array = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[cells]], dtype=float)
        sides = np.roll(X, -1, axis=1) - X
        tags, material = np.unique(membrane.material_tags(cells), return_inverse=True)
        materials = [membrane.materials[int(tag)] for tag in tags]
        ends = self.blocks[rows]
        table = FoldedCells(
            cells=cells,
            segments=np.stack([ends, np.roll(ends, -1, axis=1)], axis=2).reshape(-1, 2),
            eps=np.zeros(n),
            side_pointers=np.arange(n + 1, dtype=np.int32),
            side_segments=np.arange(n, dtype=np.int32),
            sides=np.arange(n, dtype=np.int32).reshape(-1, 3),
            side_vectors=np.einsum("nki,nai->nka", sides, membrane.material_axes(cells)),
            laws=np.array([m.law for m in materials], dtype=np.int32)[material],
            parameters=np.array([m.parameters for m in materials]).reshape(-1, N_PARAMETERS)[
                material
            ],
        )
        return FoldedMembraneEnergy(table, membrane.stiffening)

    def pressure(
        self, pressed: fem.Function, pressure: fem.Constant, origin: Array, chosen: Booleans
    ) -> FoldedFollowerPressure | None:
        """Pressure on those of the cells that are under it.

        Parameters
        ----------
        pressed
            1 in the plain cells under pressure, else 0.
        pressure, origin
            As for `FoldedFollowerPressure`.
        chosen : (n_local,)
            Whether a block moves.
        """
        rows = self._around(chosen)
        rows = rows[pressed.x.array[self.cells[rows]] > 0.0]
        if len(rows) == 0:
            return None
        none = np.zeros((0, 3), dtype=np.int32)
        return FoldedFollowerPressure(
            Facets(self.blocks[rows], np.ones(len(rows)), none), pressure, origin
        )
