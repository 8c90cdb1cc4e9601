"""The membrane's strain energy in its plain cells, and what holds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.contributions.contribution import Contribution
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.membrane import MembraneEnergy
from crms_fenicsx.energies.paper.step_history import StepHistory
from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Indices
from crms_fenicsx.scene import Scene

NOTHING, AXIAL_NOTHING = 1e-12, 1e-8
"""Strains, of a membrane as large as the scene and of cables and bars, whose forces are nothing."""


class MembraneContribution(Contribution):
    """Strain energy of the plain cells; its forms are compiled once.

    Attributes: `energy`: the term; `folded_energy` (1,): strain energy of folded cells in the steps
    before, with the step-wise strain (force x length); `has_folds`: whether some rank has folded
    cells.
    """

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        law = MembraneEnergy if scene.strain_law == "total" else StepMembraneEnergy
        self.energy = law(scene.u, scene.materials, scene.membrane.cell_tags)
        self.folded_energy = np.zeros(1)
        self.has_folds = False
        history = scene.step_history
        if isinstance(self.energy, StepMembraneEnergy) and history is not None:
            assert history.cells is not None
            self.energy.history.x.array[:] = history.cells.ravel()
            self.energy.energy_n, self.folded_energy[0] = history.energy, history.folded_energy

    @property
    def has_history(self) -> bool:
        return self.scene.strain_law == "step"

    def unfold(self) -> None:
        """Let all cells be plain."""
        self.energy.plain.x.array[:] = 1.0
        self.energy.twin = None
        self.has_folds = False

    def fold(self, cells: Indices) -> None:
        """Leave this rank's folded cells to terms of their own. Collective."""
        self.energy.plain.x.array[cells] = 0.0
        self.has_folds = self.scene.comm.allreduce(len(cells), op=MPI.SUM) > 0

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        if isinstance(self.energy, StepMembraneEnergy) and not self.has_folds:
            self.energy.energy_n += float(self.folded_energy[0])
            self.folded_energy[0] = 0.0
        return [self.energy]

    def read_scene(self, potential: Potential) -> None:
        blocks = potential.unknowns.vertex_blocks()
        potential.x[blocks] = self.scene.u.x.array.reshape(-1, 3)

    def commit(self) -> None:
        if isinstance(self.energy, StepMembraneEnergy):
            self.scene.step_history = replace(
                self.scene.step_history or StepHistory(),
                cells=self.energy.history.x.array.reshape(-1, 6).copy(),
                energy=self.energy.energy_n,
                folded_energy=float(self.folded_energy[0]),
            )


def hold(scene: Scene, unknowns: Unknowns) -> None:
    """Prescribe the displacements of held vertices in a layout, and put the floor below it."""
    unknowns.held[unknowns.vertex_blocks()] = scene.held
    if scene.floor_level is not None:
        lower = np.full_like(unknowns.X, -np.inf)
        lower[:, 2] = scene.floor_level - unknowns.X[:, 2]
        lower[unknowns.held] = -np.inf
        lower[unknowns.rails] = -np.inf
        unknowns.bounds = (lower, np.full_like(lower, np.inf))


def tiny_force(scene: Scene) -> float:
    """Return a force that is nothing without any load; with one, forces are told from its own.

    However stiff the membrane is, it is nothing to a cable in tension, or to a bar, either.
    """
    if scene.pressure != 0.0 or any(load.factor * load.intensity != 0.0 for load in scene.loads):
        return 0.0
    materials = scene.materials.values()
    section = max(m.reference_modulus + float(m.prestress_vector.max()) for m in materials)
    axial = [cable.cable.EA for cable in scene.cables if cable.taut]
    axial += [bar.bar.EA for bar in scene.bars]
    return min([NOTHING * section * scene.membrane.size, *(AXIAL_NOTHING * EA for EA in axial)])
