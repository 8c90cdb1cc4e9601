"""Lateral and axial friction of cables on the membrane."""

from __future__ import annotations

from crms_fenicsx.analysis.equilibrium.cable_contribution import CableContribution, record_friction
from crms_fenicsx.analysis.equilibrium.contribution import Contribution
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.friction import lateral
from crms_fenicsx.cabling.friction.axial import (
    end_axial_step,
    grip_table,
    is_aligned,
    store_solution,
)
from crms_fenicsx.cabling.friction.lateral import element_table, slip_table
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.axial_friction import CapstanTension
from crms_fenicsx.energy.terms.lateral_friction import LateralFriction
from crms_fenicsx.energy.terms.paper.cable_elements import FrictionElementEnergy
from crms_fenicsx.energy.terms.term import EnergyTerm


class FrictionContribution(Contribution):
    """Terms of lateral friction, and the state of all friction.

    Attributes: `stick_slip`, `elements`: terms of Coulomb's law and of the paper's friction
    elements; None without such cables.
    """

    def __init__(self, scene: Scene, cables: CableContribution) -> None:
        super().__init__(scene)
        self.cables = cables
        self.stick_slip: LateralFriction | None = None
        self.elements: FrictionElementEnergy | None = None

    @property
    def fits(self) -> bool:
        """Whether axial friction acts at the same nodes as in the potential."""
        return all(is_aligned(cable) for cable in self.scene.cables)

    def terms(self) -> list[EnergyTerm]:
        """The terms of lateral friction. Collective."""
        laws = {cable.cable.sideways.law for cable in self.cables.taut if cable.cable.sideways}
        if not laws:
            return []
        numbering, shape = self.cables.numbering, self.scene.net.strip_shape()
        lateral.note_rows(numbering)
        for cable in self.cables.taut:
            lateral.remap(cable)
            lateral.place_elements(cable, shape)
        terms: list[EnergyTerm] = []
        if "coulomb" in laws:
            self.stick_slip = LateralFriction(slip_table(numbering, shape))
            terms.append(self.stick_slip)
        if "step" in laws:
            self.elements = FrictionElementEnergy(element_table(numbering, shape))
            terms.append(self.elements)
        return terms

    def renew(self) -> None:
        """Update the terms' friction forces from the scene's cables. Collective."""
        capstan = self.cables.capstan
        if self.stick_slip is None is self.elements and capstan is None:
            return
        numbering, shape = self.cables.numbering, self.scene.net.strip_shape()
        if self.stick_slip is not None:
            self.stick_slip.renew(slip_table(numbering, shape))
        if self.elements is not None:
            self.elements.renew(element_table(numbering, shape))
        if capstan is not None:
            capstan.renew(grip_table(numbering, shape))

    def write_scene(self, potential: Potential) -> None:
        own = [term for term in (self.stick_slip, self.elements) if term is not None]
        if own:
            shape, energies = self.scene.net.strip_shape(), dict(self.scene.energies)
            for cable in self.scene.cables:
                lateral.note_sliding(cable, shape)
            # the state knows the stored part; the rest is heat
            energies["friction"] += sum(lateral.energies(c, shape)[0] for c in self.scene.cables)
            energies["friction"] -= sum(term.energy(potential.sums_of(term)) for term in own)
            self.scene.record(energies=energies)
        if self.cables.capstan is not None:
            self._write_gripped(self.cables.capstan, potential)

    def _write_gripped(self, capstan: CapstanTension, potential: Potential) -> None:
        """Copy the state of the cables with axial friction to the scene."""
        tensions, lost = record_friction(self.scene, capstan, potential)
        sums = potential.sums_of(capstan)
        for c, cable in enumerate(self.cables.gripped):
            spans, nodes = capstan.spans_of(c), capstan.nodes_of(c)
            unstressed, slips = capstan.unstressed[spans], capstan.slips[nodes]
            store_solution(cable, sums[spans], unstressed, tensions[spans], slips, float(lost[c]))

    def commit(self) -> None:
        gripped = [cable for cable in self.scene.cables if cable.state.law.lateral is not None]
        held_along = [cable for cable in self.scene.cables if cable.state.law.axial is not None]
        if not gripped and not held_along:
            return
        shape = self.scene.net.strip_shape()
        for cable in gripped:
            lateral.end_step(cable, shape)
        for cable in held_along:
            end_axial_step(cable, shape)
