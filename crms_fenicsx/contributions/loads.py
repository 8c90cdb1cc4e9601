"""Loads on the membrane: pressure on the plain cells, dead load and wind on the vertices."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.contributions.contribution import Contribution
from crms_fenicsx.contributions.membrane import MembraneContribution
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.dead_load import DeadLoad
from crms_fenicsx.energies.paper.step_history import StepHistory
from crms_fenicsx.energies.paper.step_pressure import StepPressure
from crms_fenicsx.energies.pressure import FollowerPressure
from crms_fenicsx.energies.pressure_rim import RimPressure, rim_of
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.scene import Scene

if TYPE_CHECKING:
    from crms_fenicsx.energies.sealed_pressure import SealedPressure


class PressureContribution(Contribution):
    """Pressure on the plain cells, and on what closes the volume where the rim slides in planes.

    Attributes: `cells`: 1 in the plain cells under pressure, else 0; `value`: the pressure (force
    per area); 1 where the air is sealed, and another one knows it; `term`: pressure on these cells;
    None before there has been any; `sealed`: pressure of sealed air, of which `term` is a part;
    None if there is none; `folded_volume` (1,): volume gained under folded cells in the steps
    before, with the paper's pressure (length cubed).
    """

    def __init__(self, scene: Scene, membrane: MembraneContribution) -> None:
        super().__init__(scene)
        self.membrane = membrane
        self.cells = fem.Function(membrane.energy.plain.function_space)
        self.value = fem.Constant(scene.mesh.mesh, PETSc.ScalarType(0.0))
        self.term: FollowerPressure | StepPressure | None = None
        self.sealed: SealedPressure | None = None
        self._history = scene.step_history or StepHistory()
        self.folded_volume = np.array([self._history.folded_volume])

    @property
    def is_stale(self) -> bool:
        acts = self.scene.pressure != 0.0 or self.scene.air is not None
        return acts and self.term is None

    @property
    def has_history(self) -> bool:
        return self.scene.pressure_law == "step"

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        self.cells.x.array[:] = self.membrane.energy.plain.x.array * self.scene.membrane.pressed
        if self.term is None:
            idle = self.scene.pressure == 0.0 and "pressure" not in self.scene.energies
            if idle and self.scene.air is None:
                return []
            self.term = self._make_term()
        self.term.twin, self.sealed = None, None
        if isinstance(self.term, StepPressure):
            if not self.membrane.has_folds:
                self.term.volume_n += float(self.folded_volume[0])
                self.folded_volume[0] = 0.0
            return [self.term]
        if self.scene.air is None:
            return [self.term, *self._rim_terms()]
        from crms_fenicsx.energies.sealed_pressure import SealedPressure

        self.value.value = 1.0
        self.sealed = SealedPressure(self.scene.air, self.term, self._rim_terms(), self.value)
        return [self.sealed]

    def _make_term(self) -> FollowerPressure | StepPressure:
        scene = self.scene
        if scene.pressure_law == "total":
            return FollowerPressure(scene.u, self.cells, self.value, scene.membrane.centre)
        term = StepPressure(scene.u, self.cells, self.value)
        term.volume_n = self._history.volume
        return term

    def _rim_terms(self) -> list[EnergyTerm]:
        rim = rim_of(self.scene.membrane)
        if self.scene.comm.allreduce(len(rim.sliding), op=MPI.SUM) == 0:
            return []
        return [RimPressure(rim, self.value, self.scene.membrane.centre)]

    def read_scene(self, potential: Potential) -> None:
        if self.sealed is None:
            self.value.value = self.scene.pressure
        elif self.scene.air is not None:
            self.sealed.air = self.scene.air

    def write_scene(self, potential: Potential) -> None:
        if self.sealed is not None:
            self.scene._pressure = self.sealed.pressure(potential.sums_of(self.sealed))

    def commit(self) -> None:
        if self.has_history:
            self.scene.step_history = replace(
                self.scene.step_history or StepHistory(),
                volume=self.term.volume_n if isinstance(self.term, StepPressure) else 0.0,
                folded_volume=float(self.folded_volume[0]),
            )


class MembraneLoadsContribution(Contribution):
    """The loads that `Scene.put_load` and `Scene.put_wind` have put on the membrane."""

    term: DeadLoad | None = None

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        self.term = DeadLoad(len(self.scene.held)) if self.scene.loads else None
        return [] if self.term is None else [self.term]

    def read_scene(self, potential: Potential) -> None:
        if self.term is not None:
            self.term.take(self.scene.loads)
