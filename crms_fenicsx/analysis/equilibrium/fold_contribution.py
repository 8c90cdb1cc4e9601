"""Cells folded by cables: strain energy, penalty and pressure; and compiled plain cells.

DOLFINx forms integrate over all cells; local relaxation next to a cable needs only a few.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.analysis.equilibrium.contribution import (
    Contribution,
    MembraneContribution,
    PressureContribution,
)
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.element_tables import CableTables, depth_of
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.fold_penalty import FoldPenalty
from crms_fenicsx.energy.terms.folded_membrane import FoldedCells, FoldedMembraneEnergy
from crms_fenicsx.energy.terms.folded_pressure import Facets, FoldedFollowerPressure, FoldedWind
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.pressure import FollowerPressure
from crms_fenicsx.energy.terms.term import ElementwiseTerms, EnergyTerm
from crms_fenicsx.foundation.dofs.layout import Unknowns, rows_of, rows_on
from crms_fenicsx.foundation.meshes.triangles import cell_sides
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.model.cable_state import NodeId
from crms_fenicsx.model.materials import UFL_LAW


class _PlainCells:
    """This rank's plain cells."""

    def __init__(self, unknowns: Unknowns, membrane: MembraneEnergy) -> None:
        self._energy, mesh = membrane, membrane.u.function_space.mesh
        self.cells = np.flatnonzero(
            membrane.plain.x.array[: mesh.topology.index_map(2).size_local]
        ).astype(np.int32)
        dofs = membrane.u.function_space.dofmap.list[self.cells]
        self.blocks = unknowns.vertex_blocks()[dofs]

    def _around(self, chosen: Booleans) -> Integers:
        """Rows of the cells with any chosen vertex."""
        rows: Integers = rows_on(*rows_of(self.blocks), chosen)
        return rows

    def membrane(self) -> ElementwiseTerms:
        """Compiled counterpart of their strain energy."""
        stiffening = self._energy.stiffening
        return ElementwiseTerms(self._cells, lambda table: FoldedMembraneEnergy(table, stiffening))

    def _cells(self, chosen: Booleans) -> FoldedCells | None:
        """The cells with any chosen vertex, (n_local,)."""
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

    def pressure(
        self, pressed: fem.Function, pressure: fem.Constant, origin: Array
    ) -> ElementwiseTerms:
        """Compiled counterpart of the pressure on the pressed cells among them."""

        def facets(chosen: Booleans) -> Facets | None:
            rows = self._around(chosen)
            rows = rows[pressed.x.array[self.cells[rows]] > 0.0]
            none = np.zeros((0, 3), dtype=np.int32)
            table = Facets(self.blocks[rows], np.ones(len(rows)), none)
            return table if len(rows) else None

        return ElementwiseTerms(
            facets, lambda table: FoldedFollowerPressure(table, pressure, origin)
        )


class FoldContribution(Contribution):
    """Terms of the folded cells, which those of the plain cells exclude.

    Attributes: `energy`: strain energy of the folded cells, if any; `wind`: wind on them, or None.
    """

    wind: FoldedWind | None = None

    def __init__(
        self,
        scene: Scene,
        membrane: MembraneContribution,
        pressure: PressureContribution,
        numbering: CableNumbering,
        tables: CableTables | None,
    ) -> None:
        super().__init__(scene)
        self.membrane, self.pressure = membrane, pressure
        self.numbering, self.tables = numbering, tables

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        self.wind = None
        # Folds may be on some ranks only, but global sums need the same terms on every rank.
        if self.tables is None or not self.membrane.has_folds:
            return []
        self.energy = self._fold_term(self.tables)
        if self.scene.literal_penalty is None:
            moduli = self.membrane.energy.moduli(self.tables.folded.cells)
            angles = self.tables.penalty(self.scene.penalty, moduli)
        else:
            angles = self.tables.literal_penalty(self.scene.literal_penalty)
        self.penalty = FoldPenalty(angles)
        terms: list[EnergyTerm] = [self.energy, self.penalty]
        self._make_twins(unknowns)
        if self.pressure.sealed is not None:
            self.pressure.sealed.parts.append(self._pressure_term(self.tables))
        elif self.pressure.term is not None and self.scene.pressure_law != "step":
            terms.append(self._pressure_term(self.tables))
        if any(load.suction is not None for load in self.scene.loads):
            one = fem.Constant(self.scene.mesh.mesh, PETSc.ScalarType(1.0))
            self.wind = FoldedWind(*depth_of(self.numbering), one, self.scene.membrane.centre)
            terms.append(self.wind)
        return terms

    def read_scene(self, potential: Potential) -> None:
        if self.wind is not None:
            loads = self.scene.loads
            winds = [load.factor * load.suction for load in loads if load.suction is not None]
            self.wind.take(np.sum(winds, axis=0))

    def _make_twins(self, unknowns: Unknowns) -> None:
        """Give the terms of plain cells compiled counterparts where the materials have them."""
        energy, pressure = self.membrane.energy, self.pressure
        if self.membrane.has_history or UFL_LAW in (m.law for m in energy.materials.values()):
            return
        cells = _PlainCells(unknowns, energy)
        energy.elementwise = cells.membrane()
        if isinstance(pressure.term, FollowerPressure):
            centre = self.scene.membrane.centre
            pressure.term.elementwise = cells.pressure(pressure.cells, pressure.value, centre)

    def _fold_term(self, tables: CableTables) -> FoldedMembraneEnergy:
        membrane = self.membrane
        if membrane.stepwise is None:
            return FoldedMembraneEnergy(tables.folded, membrane.energy.stiffening)
        from crms_fenicsx.energy.terms.paper.step_folded_membrane import StepFoldedMembraneEnergy

        return StepFoldedMembraneEnergy(tables.folded, membrane.stepwise, membrane.folded_energy)

    def _pressure_term(self, tables: CableTables) -> EnergyTerm:
        pressure = self.pressure
        if self.scene.pressure_law == "total":
            return FoldedFollowerPressure(tables.facets, pressure.value, self.scene.membrane.centre)
        from crms_fenicsx.energy.terms.paper.step_folded_membrane import FoldedLaggedPressure

        return FoldedLaggedPressure(tables.facets, pressure.value, pressure.folded_volume)

    def kinked_nodes(self, limit: float) -> set[NodeId]:
        """Fold points with an edge kink above a limit (rad) at the last evaluated state; none with
        the literal penalty. Collective."""
        if self.tables is None or self.scene.literal_penalty is not None:
            return set()
        mine: set[NodeId] = set()
        if len(self.tables.kinks):
            rows = self.tables.kink_nodes[np.abs(self.penalty.residuals) > limit]
            mine = set(self.numbering.nodes.ids(rows))
        return set().union(*self.scene.comm.allgather(mine))
