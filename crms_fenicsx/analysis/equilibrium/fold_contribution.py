"""Cells folded by cables: strain energy, penalty, pressure and wind."""

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
from crms_fenicsx.energy.terms.folded_membrane import FoldedMembraneEnergy
from crms_fenicsx.energy.terms.folded_pressure import FoldedWind
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.model.cable_state import NodeId


class FoldContribution(Contribution):
    """Terms of the folded cells, which those of the plain cells exclude; recreated with them.

    Attributes: `energy`: strain energy of the folded cells; `wind`: wind on them, or None; `terms`:
    all terms, without the pressure of sealed air, which is one term for all cells.
    """

    def __init__(
        self,
        scene: Scene,
        membrane: MembraneContribution,
        pressure: PressureContribution,
        numbering: CableNumbering,
        folds: CableTables,
    ) -> None:
        super().__init__(scene)
        self.numbering, self.tables = numbering, folds
        if membrane.stepwise is None:
            self.energy = FoldedMembraneEnergy(folds.folded, membrane.energy.stiffening)
        else:
            from crms_fenicsx.energy.terms.paper.step_folded_membrane import (
                StepFoldedMembraneEnergy,
            )

            self.energy = StepFoldedMembraneEnergy(
                folds.folded, membrane.stepwise, membrane.folded_energy
            )
        if scene.literal_penalty is None:
            angles = folds.penalty(scene.penalty, membrane.energy.moduli(folds.folded.cells))
        else:
            angles = folds.literal_penalty(scene.literal_penalty)
        self.penalty = FoldPenalty(angles)
        self.terms: list[EnergyTerm] = [self.energy, self.penalty]
        acts = pressure.term is not None and scene.pressure_law != "step"
        if acts and pressure.sealed is None:
            self.terms.append(pressure.term_on(folds))
        self.wind: FoldedWind | None = None
        if any(load.suction is not None for load in scene.loads):
            one = fem.Constant(scene.mesh.mesh, PETSc.ScalarType(1.0))
            self.wind = FoldedWind(*depth_of(numbering), one, scene.membrane.centre)
            self.terms.append(self.wind)

    def read_scene(self, potential: Potential) -> None:
        if self.wind is not None:
            loads = self.scene.loads
            winds = [load.factor * load.suction for load in loads if load.suction is not None]
            self.wind.take(np.sum(winds, axis=0))

    def kinked_nodes(self, limit: float) -> set[NodeId]:
        """Fold points with an edge kink above a limit (rad) at the last evaluated state; none with
        the literal penalty. Collective."""
        if self.scene.literal_penalty is not None:
            return set()
        mine: set[NodeId] = set()
        if len(self.tables.kinks):
            rows = self.tables.kink_nodes[np.abs(self.penalty.residuals) > limit]
            mine = set(self.numbering.nodes.ids(rows))
        return set().union(*self.scene.comm.allgather(mine))
