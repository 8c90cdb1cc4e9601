"""Rows of vertices that slide sideways with their cables: energy of the cells beside them, and the
stress-free mesh that follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.contribution import Contribution, MembraneContribution
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.row_shifts import RowShifts
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.shifted_membrane import ShiftedCells, ShiftedMembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array

NEAR = 0.02
"""Shift, relative to the cell size, below which the mesh around the rows stays as it is, and turn
of the directions below which these do: the rest of the solve then has one energy, and converges."""


class ShiftContribution(Contribution):
    """Strain energy of the cells with a corner that shifts, which that of the plain cells excludes.

    Attributes: `energy`: the term; `numbering`: blocks of the shifts.
    """

    def __init__(
        self, scene: Scene, membrane: MembraneContribution, numbering: CableNumbering
    ) -> None:
        super().__init__(scene)
        self.numbering, self._membrane = numbering, membrane.energy
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

    def renew(self, unknowns: Unknowns) -> None:
        """Start from the membrane's present stress-free places. Directions that have hardly turned
        stay: renewed each time they would let the rows settle much more slowly. Collective."""
        scene, numbering = self.scene, self.numbering
        shape = scene.net.strip_shape()
        numbering.renew_places(unknowns, shape)
        rows = RowShifts.of(scene.cables, numbering.nodes, shape, scene.membrane)
        before = numbering.shifts
        if np.array_equal(rows.vertices, before.vertices):  # blocks are numbered for these
            turn = np.abs(rows.projectors - before.projectors).max()
            kept = before.projectors if turn < NEAR else rows.projectors
            numbering.shifts = replace(rows, projectors=kept)
        self.energy.renew(self._membrane)

    def read_scene(self, potential: Potential) -> None:
        self.numbering.place_shifts(potential.unknowns)
        self.numbering.hold(potential.unknowns)
        here = self.numbering.shift_blocks
        potential.x[here[here >= 0]] = 0.0

    def largest(self, potential: Potential) -> float:
        """Largest shift, relative to the cell size. Collective."""
        rows = self.numbering.shifts
        return float((norm(self.shifts(potential)) / rows.sizes).max(initial=0.0))

    def shifts(self, potential: Potential) -> Array:
        """Shifts (m, 3) of the stress-free places on all ranks (length). Collective."""
        numbering = self.numbering
        found = np.zeros((len(numbering.shift_blocks), 3))
        own = np.flatnonzero(numbering.owners[numbering.n_nodes :] == numbering.rank)
        found[own] = potential.x[numbering.shift_blocks[own]]
        self.scene.comm.Allreduce(MPI.IN_PLACE, found)
        return found
