"""Rows of vertices that slide sideways with their cables: energy of the cells beside them, and the
stress-free mesh that follows."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.contribution import Contribution, MembraneContribution
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.row_shifts import RowShifts
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.shifted_membrane import ShiftedCells, ShiftedMembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.model.cable import HOLDS


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
        resting: Integers,
    ) -> None:
        super().__init__(scene)
        self.numbering, self._membrane = numbering, membrane.energy
        numbering.shifts = numbering.shifts.but(resting)
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

    def renew(self, unknowns: Unknowns, resting: Integers) -> None:
        """Start from the membrane's present stress-free places; the vertices `resting` (m,) stay
        there. Collective."""
        scene, numbering = self.scene, self.numbering
        shape = scene.net.strip_shape()
        numbering.renew_places(unknowns, shape)
        now = RowShifts.of(
            scene.cables, numbering.nodes, shape, scene.membrane, kept_vertices(scene)
        )
        numbering.shifts = numbering.shifts.renewed(now).but(resting)
        self.energy.renew(self._membrane)

    def read_scene(self, potential: Potential) -> None:
        self.numbering.place_shifts(potential.unknowns)
        self.numbering.hold(potential.unknowns)
        here = self.numbering.shift_blocks
        potential.x[here[here >= 0]] = 0.0
        table = self.energy.table
        table.weights[:] = 0.0
        for load in self.scene.loads:
            if load.material is not None:
                table.weights[:] += load.factor * load.material[table.cells]

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


def kept_vertices(scene: Scene) -> Booleans:
    """Whether the stress-free place of each local vertex (n,) must stay for what is fixed to the
    material there: ends of bars and cables, bonded cables and those that cross edges, and loads on
    vertices, but for fields of them: where such a load acts on all vertices around. Collective."""
    V, ids = scene.V, {vertex.number for vertex in scene.frame.vertices}
    for cable in scene.cables:
        fixed = cable.state.laid.line is None or not HOLDS[cable.hold].along
        nodes = cable.state.nodes if fixed else (cable.state.nodes[0], cable.state.nodes[-1])
        for point in (node.point for node in nodes):
            ids |= set() if point is None else set(point.support)
    kept = np.isin(scene.membrane.vertex_ids, [*ids])
    dofs = V.dofmap.list[: V.mesh.topology.index_map(2).size_local]
    for load in scene.loads:
        if load.at_vertices:
            on = _on_any_rank(V, norm(load.forces) > 0.0)
            rims = np.zeros(len(kept), dtype=bool)
            rims[dofs[~on[dofs].all(axis=1)]] = True
            kept |= on & _on_any_rank(V, rims)
    return kept


def _on_any_rank(V: fem.FunctionSpace, flags: Booleans) -> Booleans:
    """Logical OR over the ranks of the flags (n,) of each vertex. Collective."""
    sums = la.vector(V.dofmap.index_map, 1, dtype=np.float64)
    sums.array[:] = flags
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return np.asarray(sums.array > 0.0)
