"""Rows of vertices that slide sideways with their cables: energy of the cells beside them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.contribution import Contribution, MembraneContribution
from crms_fenicsx.analysis.equilibrium.kept_vertices import kept_vertices
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.row_shifts import RowShifts
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.energy.terms.shifted_membrane import ShiftedCells, ShiftedMembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array


class ShiftContribution(Contribution):
    """Strain energy of the cells with a corner that shifts, which that of the plain cells excludes,
    and what their loads per stress-free area change by the shifts.

    Attributes: `energy`: the term; `numbering`: blocks of the shifts.
    """

    def __init__(
        self,
        scene: Scene,
        membrane: MembraneContribution,
        numbering: CableNumbering,
        held: bool,
    ) -> None:
        super().__init__(scene)
        self.numbering, self._membrane = numbering, membrane.energy
        if held:
            numbering.shifts = numbering.shifts.still()
        strip, rank = numbering.strip, scene.comm.rank
        simplices = strip.simplices
        at = np.full(len(simplices.vertices), -1)
        at[np.searchsorted(simplices.vertices, numbering.shifts.vertices)] = numbering.shift_blocks
        mine = np.flatnonzero((strip.owner == rank) & (at[simplices.cells] >= 0).any(axis=1))
        corners = simplices.cells[mine]
        cells = strip.local[mine].astype(np.int32)
        table = ShiftedCells.of(
            membrane.energy,
            cells,
            numbering.vertex_blocks[corners].astype(np.int32),
            at[corners].astype(np.int32),
        )
        self.energy = ShiftedMembraneEnergy(table, membrane.energy.stiffening)
        membrane.energy.plain.x.array[cells] = 0.0
        for term in self._residual():
            term.elsewhere = cells
        self._read_residual()

    def renew(self, unknowns: Unknowns, held: bool) -> None:
        """Start from the membrane's present stress-free places, `held` there or not. Collective."""
        scene, numbering = self.scene, self.numbering
        shape = scene.net.strip_shape()
        numbering.renew_places(unknowns, shape)
        now = RowShifts.of(
            scene.cables, numbering.nodes, shape, scene.membrane, kept_vertices(scene)
        )
        numbering.shifts = numbering.shifts.renewed(now)
        if held:
            numbering.shifts = numbering.shifts.still()
        self.energy.renew(self._membrane)
        for term in self._residual():
            term.follow(scene.membrane)
        self._read_residual()

    def _residual(self) -> list[ResidualStress]:
        return [term for term in self.scene.terms if isinstance(term, ResidualStress)]

    def _read_residual(self) -> None:
        """Copy the section forces of residual stresses, which leave these cells."""
        table = self.energy.table
        table.residual[:] = 0.0
        for term in self._residual():
            table.residual[:] += term.components(table.axes, table.cells)

    def read_scene(self, potential: Potential) -> None:
        self.numbering.place_shifts(potential.unknowns)
        self.numbering.hold(potential.unknowns)
        here = self.numbering.shift_blocks
        potential.x[here[here >= 0]] = 0.0
        assert potential.damping is not None
        potential.damping.springs.sizes[:] = self.numbering.shifts.sizes[self.numbering.own_shifts]
        table = self.energy.table
        table.loads[:] = 0.0
        for load in self.scene.loads:
            if load.material is not None:
                thirds = table.areas[:, None] / 3 * load.material[table.cells]
                table.loads[:] += load.factor * thirds

    def shifts(self, potential: Potential) -> Array:
        """Shifts (m, 3) of the stress-free places on all ranks (length). Collective."""
        numbering = self.numbering
        found = np.zeros((len(numbering.shift_blocks), 3))
        own = numbering.own_shifts
        found[own] = potential.x[numbering.shift_blocks[own]]
        self.scene.comm.Allreduce(MPI.IN_PLACE, found)
        return found
