"""The cells that cables in tension fold: strain energy, penalty, pressure and wind."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.cables.element_tables import CableTables, depth_of
from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.contributions.contribution import Contribution
from crms_fenicsx.contributions.loads import PressureContribution
from crms_fenicsx.contributions.membrane import MembraneContribution
from crms_fenicsx.contributions.plain_cells import PlainCells
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.fold_penalty import FoldPenalty
from crms_fenicsx.energies.folded_membrane import FoldedMembraneEnergy
from crms_fenicsx.energies.folded_pressure import FoldedFollowerPressure, FoldedWind
from crms_fenicsx.energies.paper.step_folded_membrane import StepFoldedMembraneEnergy
from crms_fenicsx.energies.paper.step_folded_pressure import FoldedStepPressure
from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy
from crms_fenicsx.energies.pressure import FollowerPressure
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.materials import UFL_LAW
from crms_fenicsx.scene import Scene


class FoldContribution(Contribution):
    """Terms of the folded cells, which have left those of the plain cells.

    Attributes: `energy`: strain energy of the folded cells, if there are any; `wind`: wind on them;
    None if there are none, or no wind.
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
        # Every rank has the same terms, so that sums line up; folds may be on some ranks only.
        if self.tables is None or not self.membrane.has_folds:
            return []
        self.energy, self.penalty = self._fold_term(self.tables), self._penalty_term(self.tables)
        terms: list[EnergyTerm] = [self.energy, self.penalty]
        self._make_twins(unknowns)
        if self.pressure.sealed is not None:
            self.pressure.sealed.parts.append(self._pressure_term(self.tables))
        elif self.pressure.term is not None:
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
        """Let plain cells be relaxed with the folded ones where their laws are compiled."""
        energy, pressure = self.membrane.energy, self.pressure
        if self.membrane.has_history or UFL_LAW in (m.law for m in energy.materials.values()):
            return
        cells = PlainCells(unknowns, energy)
        energy.twin = cells.membrane()
        if isinstance(pressure.term, FollowerPressure):
            centre = self.scene.membrane.centre
            pressure.term.twin = cells.pressure(pressure.cells, pressure.value, centre)

    def _fold_term(self, tables: CableTables) -> FoldedMembraneEnergy:
        plain = self.membrane.energy
        if isinstance(plain, StepMembraneEnergy):
            return StepFoldedMembraneEnergy(tables.folded, plain, self.membrane.folded_energy)
        return FoldedMembraneEnergy(tables.folded, plain.stiffening)

    def _penalty_term(self, tables: CableTables) -> FoldPenalty:
        if self.scene.literal_penalty is not None:
            return FoldPenalty(tables.literal_penalty(self.scene.literal_penalty))
        plain = self.membrane.energy
        tags = plain.material_tags(tables.folded.cells)
        moduli = np.array([plain.materials[int(tag)].reference_modulus for tag in tags])
        return FoldPenalty(tables.penalty(self.scene.penalty, moduli))

    def _pressure_term(self, tables: CableTables) -> EnergyTerm:
        pressure = self.pressure
        if self.scene.pressure_law == "total":
            return FoldedFollowerPressure(tables.facets, pressure.value, self.scene.membrane.centre)
        return FoldedStepPressure(tables.facets, pressure.value, pressure.folded_volume)

    def caught_nodes(self, limit: float) -> set[NodeId]:
        """As `Contribution`; judged at the state last evaluated, not for the literal penalty."""
        if self.tables is None or self.scene.literal_penalty is not None:
            return set()
        mine: set[NodeId] = set()
        if len(self.tables.kinks):
            rows = self.tables.kink_nodes[np.abs(self.penalty.residuals) > limit]
            mine = set(self.numbering.nodes.ids(rows))
        return set().union(*self.scene.comm.allgather(mine))
