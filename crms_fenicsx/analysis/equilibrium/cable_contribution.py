"""Cable points and cable tension."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.contribution import Contribution
from crms_fenicsx.analysis.equilibrium.kept_vertices import kept_vertices
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.clamping import end_step, placed
from crms_fenicsx.cabling.cables.element_tables import (
    CableTables,
    cable_tables,
    damping,
    held_points,
    holds_points,
)
from crms_fenicsx.cabling.cables.node_positions import NodePositions
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.row_shifts import RowShifts
from crms_fenicsx.energy.minimization.damping import Damping
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.cable_tension import CableTension
from crms_fenicsx.energy.terms.held_line import HeldLine
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import FrameBlocks
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, pointers
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length

if TYPE_CHECKING:
    from crms_fenicsx.energy.terms.axial_friction import CapstanTension
    from crms_fenicsx.energy.terms.side_contact import Facing, SideContact

logger = logging.getLogger("crms_fenicsx")

UNSMOOTHED = 1e-13
"""Least error of a cable's smoothed length, relative to its unstressed length, to correct."""


class CableContribution(Contribution):
    """Tension of the cables; recreated when cables are laid, tighten or slacken.

    Attributes: `numbering`: numbering of the cable points; `unknowns`: the layout with these
    points; `node_positions`: copies point positions to the cables; `taut`: the cables in tension;
    `tables`: this rank's elements of these, or None; `facing`, `contact`: vertices that face cables
    beside theirs, on all ranks, and their term, or None; `tension`, `sliding`: term of the taut
    cables that slide freely along their axis, and these; `capstan`, `gripped`: term of those with
    axial friction, and these; `clutches`, `slipping`: of those that may slip through clamps.
    """

    def __init__(
        self, scene: Scene, membrane: MembraneEnergy, frame: FrameBlocks | None, slide: bool
    ) -> None:
        super().__init__(scene)
        assert scene.net.strip is not None
        nodes, shifts = scene.net.nodes, RowShifts.none()
        self.facing = self._facing()
        if slide and any(cable.takes_line for cable in scene.cables):
            shape = scene.net.strip_shape()
            kept = kept_vertices(scene)
            shifts = RowShifts.of(scene.cables, nodes, shape, scene.membrane, kept)
        self.numbering = CableNumbering(
            scene.cables, scene.net.strip, scene.u, nodes, shifts, self.facing
        )
        self.unknowns = self.numbering.unknowns(frame)
        self.numbering.hold(self.unknowns)
        self.node_positions = NodePositions(self.numbering, self.unknowns)
        self.taut = [cable for cable in scene.cables if cable.taut]
        self.slipping = [
            cable for cable in self.taut if cable.may_slip and cable.state.law.axial is None
        ]
        self.sliding = [
            c for c in self.taut if c.state.law.axial is None and c not in self.slipping
        ]
        self.gripped = [cable for cable in self.taut if cable.state.law.axial is not None]
        # first part of each sliding cable among all parts, and the total number
        self.first_parts = pointers(
            np.array([len(c.part_lengths) for c in self.sliding], dtype=int)
        )
        self.tension: CableTension | None = None
        self.contact: SideContact | None = None
        self.capstan: CapstanTension | None = None
        self.clutches: CapstanTension | None = None
        self.tables: CableTables | None = None
        if self.taut:
            self.tables = cable_tables(self.numbering, membrane, scene.membrane.pressed)
            scene.membrane.refuse_folds(self.tables.folded.cells, "a cable has slid too far")

    def _facing(self, cells: int | None = None) -> Facing | None:
        """Vertices that face cables beside theirs within some cells, by default as many as in the
        contact term, on all ranks, with rows of nodes as blocks; None if none do. Collective."""
        if not self.scene.net.may_touch:
            return None
        from crms_fenicsx.cabling.contact.side_by_side import BESIDE, facing_on_mesh

        cells = BESIDE if cells is None else cells
        found = facing_on_mesh(self.scene.net, self.scene.materials.values(), cells)
        return found if len(found.least) else None

    @property
    def faces_all(self) -> bool:
        """Whether the contact term has all vertices that may touch in a solve from this mesh.
        Collective."""
        near = self._facing(1)
        if near is None or self.facing is None:
            return near is None
        from crms_fenicsx.cabling.contact.side_by_side import faces_all

        return faces_all(self.facing, near)

    def folds(self) -> CableTables | None:
        """The tables if some rank has folded cells; global sums need the same terms on all ranks.
        Collective."""
        if self.tables is None:
            return None
        own = len(self.tables.folded.cells)
        return self.tables if self.scene.comm.allreduce(own, op=MPI.SUM) > 0 else None

    def damping(self) -> Damping | None:
        """Damping of quasi-Newton steps of the cable points; None without tension."""
        return None if self.tables is None else damping(self.numbering, self.tables.segments)

    def terms(self) -> list[EnergyTerm]:
        """The terms in their order. Collective."""
        terms: list[EnergyTerm] = []
        if self.tables is not None and self.sliding:
            self.tension = self._tension_term(self.tables)
            terms.append(self.tension)
        if self.tables is not None and self.gripped:
            from crms_fenicsx.cabling.friction import axial
            from crms_fenicsx.energy.terms.axial_friction import CapstanTension

            for cable in self.gripped:
                axial.remap_axial(cable)
            grips = axial.grip_table(self.numbering, self.scene.net.strip_shape())
            held = axial.gripped_cables(self.numbering)
            chains = axial.chain_table(self.numbering, self.tables, held)
            self.capstan = CapstanTension(chains, grips, _whole_lengths(self.gripped))
            terms.append(self.capstan)
        if self.tables is not None and self.slipping:
            from crms_fenicsx.cabling.friction import axial
            from crms_fenicsx.energy.terms.axial_friction import CapstanTension

            at = {self.numbering.cables.index(own): own.clamped for own in self.slipping}
            chains = axial.chain_table(self.numbering, self.tables, at)
            grips = axial.clamp_grips(self.slipping)
            self.clutches = CapstanTension(chains, grips, _whole_lengths(self.slipping))
            terms.append(self.clutches)
        if self.facing is not None:
            terms.append(self._contact_term(self.facing))
        if holds_points(self.taut):
            shape, materials = self.scene.net.strip_shape(), self.scene.materials.values()
            terms.append(HeldLine(held_points(self.numbering, shape, materials)))
        return terms

    def _tension_term(self, tables: CableTables) -> CableTension:
        EA = self._stiffnesses()
        L0 = np.concatenate([cable.part_lengths for cable in self.sliding])
        starts = [own.state.law.step_start for own in self.sliding for _ in own.part_lengths]
        one = np.array([cable in self.sliding for cable in self.taut])
        mine, number = one[tables.cable], np.cumsum(one) - 1
        cable = number[tables.cable[mine]]
        part = self.first_parts[cable]
        node = self.numbering.nodes.place[tables.links[mine, 0]]
        for c, own in enumerate(self.sliding):
            if own.state.law.parts is not None:
                part[cable == c] += own.parts_of(node[cable == c])
        links = (tables.segments[mine], tables.eps[mine], part.astype(np.int32))
        if any(starts):
            from crms_fenicsx.energy.terms.paper.cable_elements import StepCableTension

            return StepCableTension(*links, EA, L0, starts)
        alone = np.concatenate([_parts_of_one_link(own) for own in self.sliding])
        return CableTension(*links, EA, L0, alone)

    def _contact_term(self, facing: Facing) -> EnergyTerm:
        """The contact of this rank's vertices with cables beside theirs."""
        from crms_fenicsx.energy.terms.side_contact import SideContact

        numbering = self.numbering
        own = facing.some(self._own_faces(facing))
        self.contact = SideContact(own.renumbered(numbering.node_blocks.astype(np.int32)))
        return self.contact

    def _own_faces(self, facing: Facing) -> Integers:
        """Which of the facing vertices this rank owns, (k,)."""
        first = facing.blocks[facing.pointers[:-1]]
        return np.flatnonzero(self.numbering.node_owners[first] == self.numbering.rank)

    def _stiffnesses(self) -> Array:
        """Axial stiffnesses of the parts of the sliding cables (force)."""
        EA = np.array([cable.cable.EA for cable in self.sliding], dtype=np.float64)
        return np.repeat(EA, np.diff(self.first_parts))

    def read_scene(self, potential: Potential) -> None:
        numbering, unknowns = self.numbering, self.unknowns
        own = numbering.blocks[numbering.blocks >= 0]
        places = unknowns.X.copy()
        numbering.place_points(places)
        potential.x[own] = places[own] - unknowns.X[own]
        unknowns.update_ghosts(potential.x_vector)  # far vertices too, which carry edge sliders
        numbering.edge_sliders.place(unknowns, potential.x)
        if self.tension is not None:
            self.tension.EA[:] = self._stiffnesses()
            self.tension.L0[:] = np.concatenate([cable.part_lengths for cable in self.sliding])
            self.tension.smoothing_length[:] = np.concatenate(
                [_smoothing(cable) for cable in self.sliding]
            )
        if self.capstan is not None:
            self.capstan.L0[:] = _whole_lengths(self.gripped)
        if self.facing is not None and self.contact is not None:
            from crms_fenicsx.cabling.contact.side_by_side import stiffnesses

            nodes, shape = numbering.nodes, self.scene.net.strip_shape()
            self.facing.stiffness[:] = stiffnesses(
                self.facing, nodes, shape, self.scene.materials.values()
            )
            self.contact.table.stiffness[:] = self.facing.stiffness[self._own_faces(self.facing)]
        if self.clutches is not None:
            from crms_fenicsx.cabling.friction.axial import clamp_grips

            self.clutches.renew(clamp_grips(self.slipping))
            self.clutches.L0[:] = _whole_lengths(self.slipping)

    def locate(self, potential: Potential) -> None:
        """Copy the positions of cable points to the scene, on all ranks. Collective."""
        self.node_positions.gather(potential.x)

    def write_scene(self, potential: Potential) -> None:
        self.locate(potential)
        own: dict[LaidCable, Array] = {}
        if self.tension is not None:
            forces = self.tension.tensions(potential.sums_of(self.tension))
            own.update(zip(self.sliding, np.split(forces, self.first_parts[1:-1]), strict=True))
        if self.clutches is not None:
            own.update(self._write_slips(self.clutches, potential))
        for cable in self.scene.cables:
            tensions = own.get(cable, 0.0 * cable.part_lengths)
            length = polyline_length(cable.state.positions[cable.contacts()])
            if cable.state.law.parts is None:
                cable.update(length=length, tension=float(tensions[0]))
                continue
            mean = float(tensions @ cable.part_lengths) / cable.L0
            parts = replace(cable.state.law.parts, tensions=tensions.copy())
            cable.update(length=length, tension=mean, parts=parts)

        if self.scene.clamps:
            self.scene.net.clamps = placed(self.scene.cables, self.scene.clamps)

    def _write_slips(self, term: CapstanTension, potential: Potential) -> dict[LaidCable, Array]:
        """Copy clamp slips to the cables, their energy to the scene; return the tensions."""
        tensions, lost = record_friction(self.scene, term, potential)
        found = {}
        for c, cable in enumerate(self.slipping):
            assert cable.state.law.parts is not None
            slips = term.slips[term.nodes_of(c)].copy()
            cable.update(parts=replace(cable.state.law.parts, slips=slips, loss=float(lost[c])))
            found[cable] = tensions[term.spans_of(c)]
        return found

    def renew_smoothing_length(self, potential: Potential) -> bool:
        """Correct the cable lengths for smoothing and return whether that changed them."""
        lengths: list[tuple[LaidCable, Array]] = []
        if self.tension is not None:
            parts_of = np.split(potential.sums_of(self.tension), self.first_parts[1:-1])
            lengths += zip(self.sliding, parts_of, strict=True)
        for term, cables in ((self.clutches, self.slipping), (self.capstan, self.gripped)):
            if term is not None:
                sums = potential.sums_of(term)
                lengths += [(cable, sums[term.spans_of(c)]) for c, cable in enumerate(cables)]
        changed = False
        for cable, own in lengths:
            if cable.state.law.axial is not None:
                length = float(own.sum()) - cable.state.law.smoothing_length
            else:
                own = own - _smoothing(cable) if cable in self.slipping else own
                length = float(own.sum())
                changed |= _renew_smoothing(cable, own)
            more = length - cable.length
            if abs(more) > UNSMOOTHED * cable.L0:
                logger.debug("%s: smoothing adds %.3g to its length", cable.name, more)
                cable.update(smoothing_length=cable.state.law.smoothing_length + more)
                changed = True
        return changed

    def commit(self) -> None:
        if self.tension is not None:
            for cable, first in zip(self.sliding, self.first_parts[:-1], strict=True):
                for start in self.tension.starts[first : first + 1]:  # empty without such cables
                    cable.update(step_start=start)
        if any(cable.may_slip for cable in self.taut):
            net = self.scene.net
            net.clamps = end_step(self.taut, net.clamps)
        for cable in self.scene.cables:
            cable.update(ends_before=cable.state.positions[[0, -1]])


def record_friction(
    scene: Scene, term: CapstanTension, potential: Potential
) -> tuple[Array, Array]:
    """Count the energy that a term's friction stores as the scene's friction; return the tensions
    of its spans and the energy that each cable has lost."""
    sums, energies = potential.sums_of(term), dict(scene.energies)
    tensions, (stored, lost) = term.tensions(sums), term.friction(sums)
    energies["cables"] -= term.friction_potential
    energies["friction"] = energies.get("friction", 0.0) + float(stored.sum())
    scene.record(energies=energies)
    return tensions, lost


def _renew_smoothing(cable: LaidCable, lengths: Array) -> bool:
    """Correct the smoothing lengths of a cable's parts and return whether they changed."""
    if cable.state.law.parts is None:
        return False
    added = lengths - current_lengths(cable)
    cable.update(
        parts=replace(cable.state.law.parts, smoothing=cable.state.law.parts.smoothing + added)
    )
    return bool(np.any(np.abs(added) > UNSMOOTHED * cable.L0))


def _smoothing(cable: LaidCable) -> Array:
    """Length that smoothing adds to each part of a cable between clamps (length)."""
    return (
        np.array([cable.state.law.smoothing_length])
        if cable.state.law.parts is None
        else cable.state.law.parts.smoothing
    )


def _whole_lengths(cables: Sequence[LaidCable]) -> Array:
    """Unstressed lengths with what smoothing adds, of cables with friction or slipping clamps."""
    return np.array(
        [
            cable.L0 + cable.state.law.smoothing_length
            if cable.state.law.axial is not None or cable.state.law.parts is None
            else cable.L0 + float(cable.state.law.parts.smoothing.sum())
            for cable in cables
        ]
    )


def _parts_of_one_link(cable: LaidCable) -> Booleans:
    """Whether each part of a bonded cable runs straight between two consecutive contacts."""
    if cable.state.laid.bonds is None:
        return np.zeros(len(cable.part_lengths), dtype=bool)
    return np.bincount(cable.parts_of(cable.contacts()[:-1]), minlength=len(cable.part_lengths)) < 2


def current_lengths(cable: LaidCable) -> Array:
    """Current lengths of a cable's parts between clamps (length)."""
    contacts = cable.contacts()
    sizes = norm(np.diff(cable.state.positions[contacts], axis=0))
    return np.bincount(cable.parts_of(contacts[:-1]), sizes, len(cable.part_lengths)).astype(
        np.float64
    )
