"""The terms that the user has added to the scene."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.contributions.contribution import Contribution
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.scene import Scene


class AddedTermsContribution(Contribution):
    """The terms of `Scene.add_term`."""

    @property
    def has_history(self) -> bool:
        return any(term.has_history for term in self.scene.terms)

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        return list(self.scene.terms)


def force_per_area(scene: Scene, potential: Potential) -> float:
    """Mean size of the forces of added terms (force per area) at the current state. Collective."""
    potential.bring_up_to_date()
    g, unknowns = potential.g, potential.unknowns  # free between two solves
    g[:] = 0.0
    for term in scene.terms:
        term.add_gradient(potential.x, potential.sums_of(term), g)
    unknowns.gather_forces(potential.g_vector, g)
    g[: unknowns.n_owned][unknowns.held[: unknowns.n_owned]] = 0.0
    sizes = np.linalg.norm(g[: unknowns.n_owned], axis=1)
    return float(scene.comm.allreduce(float(sizes.sum()))) / scene.membrane.size**2
