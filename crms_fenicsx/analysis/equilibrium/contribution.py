"""Contributions of physical features to the potential: the membrane's plain cells, its supports,
pressure and loads. Those of cables, folds, bars and ponds have their own files."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.outcome import NO_STRAIN
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.nodal_forces import NodalForces
from crms_fenicsx.energy.terms.pressure import (
    FollowerPressure,
    Rim,
    RimPressure,
    moved_volume,
    rim_of,
)
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.model.materials import UFL_LAW
from crms_fenicsx.model.membrane import StepHistory
from crms_fenicsx.model.tolerances import UNSTRAINED

if TYPE_CHECKING:
    from crms_fenicsx.cabling.cables.element_tables import CableTables, PlainCells
    from crms_fenicsx.energy.terms.paper.step_membrane import StepMembraneEnergy, StepPressure
    from crms_fenicsx.energy.terms.sealed_pressure import SealedPressure


class Contribution:
    """One feature of a scene: its energy terms, and the data exchange between these and the scene.
    Methods do nothing by default. All are called on all ranks, in the order of the terms."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def read_scene(self, potential: Potential) -> None:
        """Copy loads, parameters and state from the scene to terms and potential."""

    def write_scene(self, potential: Potential) -> None:
        """Copy the solved state to the scene, whose `energies` are the potential's."""

    def commit(self) -> None:
        """End a load step at the scene's current state. Collective."""


class MembraneContribution(Contribution):
    """Strain energy of the plain cells; its forms are compiled once.

    Attributes: `energy`: the term; `stepwise`: the same if the strain is step-wise, or None;
    `folded_energy` (1,): strain energy of folded cells in the previous steps, with step-wise strain
    (force x length); `plain`: the plain cells beside folded ones, if their laws are compiled.
    """

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.stepwise: StepMembraneEnergy | None = None
        parts = scene.u, scene.materials, scene.membrane.cell_tags
        if scene.strain_law == "total":
            self.energy = MembraneEnergy(*parts, scene.membrane.frames)
        else:
            from crms_fenicsx.energy.terms.paper.step_membrane import StepMembraneEnergy

            self.energy = self.stepwise = StepMembraneEnergy(*parts)
        self.folded_energy = np.zeros(1)
        self.plain: PlainCells | None = None
        self._placement = scene.membrane.placement
        history = scene.step_history
        if self.stepwise is not None and history is not None:
            assert history.cells is not None
            self.stepwise.history.x.array[:] = history.cells.ravel()
            self.stepwise.energy_n, self.folded_energy[0] = history.energy, history.folded_energy

    def terms(self, unknowns: Unknowns, folds: CableTables | None) -> list[EnergyTerm]:
        """The term, in the scene's materials, without folded cells, which have their own terms."""
        energy, self.plain = self.energy, None
        energy.renew_materials()
        self.renew_places()
        energy.plain.x.array[:] = 1.0
        for term in self.scene.terms:
            if isinstance(term, ResidualStress):
                term.follow(self.scene.membrane)
                term.elsewhere = term.elsewhere[:0]
        if folds is not None:
            energy.plain.x.array[folds.folded.cells] = 0.0
            compiled = UFL_LAW not in (m.law for m in energy.materials.values())
            if compiled and self.stepwise is None:
                from crms_fenicsx.cabling.cables.element_tables import PlainCells

                self.plain = PlainCells(unknowns, energy)
        elif self.stepwise is not None:
            self.stepwise.energy_n += float(self.folded_energy[0])
            self.folded_energy[0] = 0.0
        energy.elementwise = None if self.plain is None else self.plain.membrane()
        return [energy]

    def renew_places(self) -> None:
        """Follow the stress-free places of the vertices, if they have moved."""
        if self._placement != self.scene.membrane.placement:
            self.energy.renew_places()
            self._placement = self.scene.membrane.placement

    def read_scene(self, potential: Potential) -> None:
        blocks = potential.unknowns.vertex_blocks()
        potential.x[blocks] = self.scene.u.x.array.reshape(-1, 3)

    def commit(self) -> None:
        if self.stepwise is not None:
            history = replace(
                self.scene.step_history or StepHistory(),
                cells=self.stepwise.history.x.array.reshape(-1, 6).copy(),
                energy=self.stepwise.energy_n,
                folded_energy=float(self.folded_energy[0]),
            )
            self.scene.record(step_history=history)


def hold(scene: Scene, unknowns: Unknowns) -> None:
    """Prescribe the displacements of held vertices in a layout, and the bounds of the floor."""
    unknowns.held[unknowns.vertex_blocks()] = scene.held
    if scene.floor_level is not None:
        lower = np.full_like(unknowns.X, -np.inf)
        lower[:, 2] = scene.floor_level - unknowns.X[:, 2]
        lower[unknowns.held] = -np.inf
        lower[unknowns.sliders] = -np.inf
        unknowns.bounds = (lower, np.full_like(lower, np.inf))


def unloaded_scales(scene: Scene) -> tuple[float, float]:
    """Force scale (force) negligible for the unloaded membrane and, however stiff this is, for taut
    cables and bars; and least stiffness (force) of these; 0 with loads, which set their own."""
    if scene.pressure != 0.0 or any(load.factor * load.intensity != 0.0 for load in scene.loads):
        return 0.0, 0.0
    materials = scene.materials.values()
    section = max(m.reference_modulus + float(m.prestress_vector.max()) for m in materials)
    membrane = section * scene.membrane.size
    axial = [cable.cable.EA for cable in scene.cables if cable.taut]
    axial += [bar.bar.EA for bar in scene.bars]
    weakest = min(axial, default=math.inf)
    return min(UNSTRAINED * membrane, NO_STRAIN * weakest), min(membrane, weakest)


class PressureContribution(Contribution):
    """Pressure on the plain cells, and on the closure of the volume where the rim slides in planes.

    Attributes: `cells`: 1 in the cells of `term`, else 0; `value`: the pressure (force per
    area), or 1 if the air is sealed (`sealed` then has it); `term`: pressure on these cells, None
    until there is any; `sealed`: pressure of sealed air, which includes all others, or None;
    `folded_volume` (1,): volume gained under folded cells before, if lagged (length cubed).
    """

    def __init__(self, scene: Scene, membrane: MembraneContribution) -> None:
        super().__init__(scene)
        self.membrane = membrane
        self.cells = fem.Function(membrane.energy.plain.function_space)
        self.value = fem.Constant(scene.mesh.mesh, PETSc.ScalarType(0.0))
        self.term: FollowerPressure | StepPressure | None = None
        self.sealed: SealedPressure | None = None
        history = scene.step_history or StepHistory()
        self._volume = history.volume
        self.folded_volume = np.array([history.folded_volume])

    @property
    def is_missing(self) -> bool:
        """Whether there is pressure, but no term of it yet."""
        acts = self.scene.pressure != 0.0 or self.scene.air.sealed is not None
        return acts and self.term is None

    def terms(self, folds: CableTables | None) -> list[EnergyTerm]:
        """The terms, those on folded cells included if the air is sealed. Collective."""
        self.cells.x.array[:] = self.scene.membrane.pressed
        if self.scene.pressure_law != "step":  # which acts on corners of folded cells, too
            self.cells.x.array[:] *= self.membrane.energy.plain.x.array
        self.sealed = None
        if self.term is None:
            idle = self.scene.pressure == 0.0 and "pressure" not in self.scene.energies
            if idle and self.scene.air.sealed is None:
                return []
            self.term = self._make_term()
        if not isinstance(self.term, FollowerPressure):
            if folds is None:
                self.term.volume_n += float(self.folded_volume[0])
                self.folded_volume[0] = 0.0
            return [self.term]
        rim = self.renew_places(self.term)
        plain = self.membrane.plain
        self.term.elementwise = None if plain is None else plain.pressure(self.term)
        if self.scene.air.sealed is None:
            return [self.term, *self._rim_terms(rim)]
        from crms_fenicsx.energy.terms.sealed_pressure import SealedPressure

        self.value.value = 1.0
        others = [*self._rim_terms(rim), *([] if folds is None else [self.term_on(folds)])]
        self.sealed = SealedPressure(self.scene.air.sealed, self.term, others, self.value)
        return [self.sealed]

    def renew_places(self, term: FollowerPressure) -> Rim:
        """Follow the stress-free places of the vertices; return the rim. Collective."""
        rim = rim_of(self.scene.membrane)
        term.moved = moved_volume(self.scene.membrane, rim)
        return rim

    def _make_term(self) -> FollowerPressure | StepPressure:
        scene = self.scene
        if scene.pressure_law == "total":
            return FollowerPressure(scene.u, self.cells, self.value, scene.membrane.centre)
        from crms_fenicsx.energy.terms.paper.step_membrane import StepPressure

        term = StepPressure(scene.u, self.cells, self.value)
        term.volume_n = self._volume
        return term

    def _rim_terms(self, rim: Rim) -> list[EnergyTerm]:
        if self.scene.comm.allreduce(len(rim.sliding), op=MPI.SUM) == 0:
            return []
        return [RimPressure(rim, self.value, self.scene.membrane.centre)]

    def term_on(self, folds: CableTables) -> EnergyTerm:
        """The pressure on folded cells."""
        if self.scene.pressure_law == "total":
            from crms_fenicsx.energy.terms.folded_pressure import FoldedFollowerPressure

            return FoldedFollowerPressure(folds.facets, self.value, self.scene.membrane.centre)
        from crms_fenicsx.energy.terms.paper.step_folded_membrane import FoldedLaggedPressure

        return FoldedLaggedPressure(folds.facets, self.value, self.folded_volume)

    def read_scene(self, potential: Potential) -> None:
        if self.sealed is None:
            self.value.value = self.scene.pressure
        elif self.scene.air.sealed is not None:
            self.sealed.air = self.scene.air.sealed

    def write_scene(self, potential: Potential) -> None:
        if self.sealed is not None:
            pressure = self.sealed.pressure(potential.sums_of(self.sealed))
            self.scene.air.update(pressure=pressure)

    def commit(self) -> None:
        if not isinstance(self.term, FollowerPressure) and self.scene.pressure_law != "total":
            history = replace(
                self.scene.step_history or StepHistory(),
                volume=0.0 if self.term is None else self.term.volume_n,
                folded_volume=float(self.folded_volume[0]),
            )
            self.scene.record(step_history=history)


class MembraneLoadsContribution(Contribution):
    """The loads of `Scene.put_load` and `Scene.put_wind` on the membrane."""

    term: NodalForces | None = None

    def terms(self) -> list[EnergyTerm]:
        """The term of all loads."""
        self.term = NodalForces(len(self.scene.held)) if self.scene.loads else None
        return [] if self.term is None else [self.term]

    def read_scene(self, potential: Potential) -> None:
        if self.term is not None:
            self.term.take(self.scene.loads)


def force_per_area(scene: Scene, potential: Potential) -> float:
    """Mean size of the forces of added terms (force per area) at the current state. Collective."""
    potential.bring_up_to_date()
    g, unknowns = potential.g, potential.unknowns  # not in use between two solves
    g[:] = 0.0
    for term in scene.terms:
        term.add_gradient(potential.x, potential.sums_of(term), g)
    unknowns.gather_forces(potential.g_vector, g)
    g[: unknowns.n_owned][unknowns.held[: unknowns.n_owned]] = 0.0
    sizes = np.linalg.norm(g[: unknowns.n_owned], axis=1)
    return float(scene.comm.allreduce(float(sizes.sum()))) / scene.membrane.size**2
