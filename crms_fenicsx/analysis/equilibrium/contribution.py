"""Protocol for the contribution of a physical feature to the potential, and user terms."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.model.cable_state import NodeId


class Contribution:
    """One feature of a scene: its energy terms, and the data exchange between these and the scene.
    Methods do nothing by default. All are called on all ranks, in the order of the terms."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @property
    def is_stale(self) -> bool:
        """Whether its terms no longer fit the scene and must be recreated. Collective."""
        return False

    @property
    def has_history(self) -> bool:
        """Whether it depends on the state at the start of a load step."""
        return False

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        """Create its terms for a layout, the same on all ranks. Collective."""
        return []

    def read_scene(self, potential: Potential) -> None:
        """Copy loads, parameters and state from the scene to terms and potential."""

    def locate(self, potential: Potential) -> None:
        """Copy the positions of cable points from the potential to the scene. Collective."""

    def write_scene(self, potential: Potential) -> None:
        """Copy the solved state to the scene, whose `energies` are the potential's."""

    def renew_friction(self) -> None:
        """Update the terms' friction forces from the scene's cables. Collective."""

    def renew_smoothing_length(self, potential: Potential) -> bool:
        """Correct the cable lengths for smoothing and return whether that changed them."""
        return False

    def kinked_nodes(self, limit: float) -> set[NodeId]:
        """Fold points with an edge kink above a limit (rad). Collective."""
        return set()

    def commit(self) -> None:
        """End a load step at the scene's current state. Collective."""


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
    g, unknowns = potential.g, potential.unknowns  # not in use between two solves
    g[:] = 0.0
    for term in scene.terms:
        term.add_gradient(potential.x, potential.sums_of(term), g)
    unknowns.gather_forces(potential.g_vector, g)
    g[: unknowns.n_owned][unknowns.held[: unknowns.n_owned]] = 0.0
    sizes = np.linalg.norm(g[: unknowns.n_owned], axis=1)
    return float(scene.comm.allreduce(float(sizes.sum()))) / scene.membrane.size**2
