"""What a solver tells of the state that it has found."""

from __future__ import annotations

from abc import abstractmethod

from mpi4py import MPI

from crms_fenicsx.contact.contact_force import ContactForces, contact_forces
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Marker
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.reactions import Reactions, reactions
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.scene import Scene


class FoundState:
    """The part of a solver that reads stresses and forces off the current state."""

    _scene: Scene
    comm: MPI.Intracomm

    @property
    @abstractmethod
    def system(self) -> System:
        """The potential of the scene."""

    @collective
    def results(self) -> MembraneResults:
        """Stresses, strains and state of the membrane's cells in the current state. Collective.

        Returns
        -------
        MembraneResults
            Values in this rank's cells.
        """
        return membrane_results(self.system)

    @collective
    def reactions(self, where: str | Marker) -> Reactions:
        """Forces that supports exert on the membrane, in the current state. Collective.

        Those on a cable's ends are not among them: ``cable.start.reaction``.

        Parameters
        ----------
        where
            Held vertices, as for `Scene.vertices`.

        Returns
        -------
        Reactions
            Their sum, and the force on each of this rank's vertices.

        Raises
        ------
        InputError
            As `Scene.vertices`.
        """
        return reactions(self.system, where)

    @collective
    def contact_forces(self, cable: LaidCable) -> ContactForces:
        """Forces of a cable on the membrane at its points, in the current state. Collective.

        Parameters
        ----------
        cable
            A cable of the scene.

        Returns
        -------
        ContactForces
            At the points of the cable's `line`; its ``line`` is the force per length of cable.

        Raises
        ------
        InputError
            It is no cable of this scene.
        """
        checks.same(self.comm, "contact_forces", cable=cable)
        if not any(cable is own for own in self._scene.cables):
            raise InputError(f"contact_forces: {cable!r} is not a cable of this scene.")
        return contact_forces(cable, self._scene.net.strip_shape()).at(cable.line_nodes())
