"""Water on plain and folded cells of the membrane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crms_fenicsx.analysis.equilibrium.cable_contribution import CableContribution
from crms_fenicsx.analysis.equilibrium.contribution import (
    Contribution,
    MembraneContribution,
)
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.element_tables import facets_of
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.folded_pressure import Facets
from crms_fenicsx.energy.terms.ponding import Ponding
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.membrane_load import Pond


class PondContribution(Contribution):
    """The ponds of `Scene.put_pond`; recreated with the folded cells.

    Attributes: `ponds`: the terms, in the order of the scene's ponds.
    """

    def __init__(
        self, scene: Scene, membrane: MembraneContribution, cables: CableContribution | None
    ) -> None:
        super().__init__(scene)
        self.membrane, self.cables = membrane, cables
        self.ponds: list[Ponding] = []

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        """The terms over a layout."""
        datum = float(self.scene.membrane.centre[2])
        self.ponds = [
            Ponding(pond, self._facets(pond, unknowns), datum) for pond in self.scene.ponds
        ]
        return list(self.ponds)

    def _facets(self, pond: Pond, unknowns: Unknowns) -> Facets:
        """This rank's plain cells, and facets of folded cells, that a pond can cover."""
        membrane = self.scene.membrane
        cells, own = pond.cells(membrane), membrane.mesh.mesh.topology.index_map(2).size_local
        plain = cells[:own] & (self.membrane.energy.plain.x.array[:own] > 0.5)
        corners = unknowns.vertex_blocks()[membrane.V.dofmap.list[:own][plain]]
        weights: Array = np.ones(len(corners))
        if self.cables is not None and self.cables.tables is not None:
            folded = facets_of(self.cables.numbering, cells)
            corners = np.concatenate([corners, folded.corners])
            weights = np.concatenate([weights, folded.weights])
        return Facets(corners, weights, np.zeros((0, 3), dtype=np.int32))

    def read_scene(self, potential: Potential) -> None:
        for term, pond in zip(self.ponds, self.scene.ponds, strict=True):
            term.pond, term.level = pond, pond.level

    def write_scene(self, potential: Potential) -> None:
        ponds = tuple(
            replace(
                term.pond,
                level=term.level,
                volume=term.pond.volume
                if term.pond.given == "volume"
                else float(potential.sums_of(term)[1]),
            )
            for term in self.ponds
        )
        self.scene.loads.update(ponds=ponds)

    def add_pressure(self, potential: Potential, g: Array, factor: float) -> None:
        """Add the water's forces on the membrane, times a factor, to `g`, (n_local, 3)."""
        for term in self.ponds:
            term.add_pressure(potential.x, g, factor)

    def force_per_area(self, potential: Potential) -> float:
        """Weight of the water over the membrane's area (force per area). Collective."""
        potential.bring_up_to_date()
        weight = sum(
            term.pond.factor * term.pond.weight * float(potential.sums_of(term)[1])
            for term in self.ponds
        )
        return abs(weight) / self.scene.membrane.size**2
