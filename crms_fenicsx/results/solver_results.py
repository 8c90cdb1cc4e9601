"""What users ask a solver about its scene's current state."""

from __future__ import annotations

from abc import abstractmethod

from mpi4py import MPI

from crms_fenicsx.contact.contact_force import ContactForces, contact_forces
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Marker
from crms_fenicsx.results.cable_and_bar_results import CableResults, cable_results
from crms_fenicsx.results.error_estimate import ErrorEstimate, ErrorEstimator
from crms_fenicsx.results.membrane_results import MembraneResults, membrane_results
from crms_fenicsx.results.quantities import fields_of
from crms_fenicsx.results.reactions import Reactions, reactions
from crms_fenicsx.results.residual import Residual, Tangent, residual, tangent
from crms_fenicsx.results.summary import Summary, summary
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, collective
from crms_fenicsx.scene import Scene


class SolverResults:
    """The part of a solver that evaluates the current state."""

    comm: MPI.Intracomm
    _scene: Scene

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

    def fields(self) -> dict[str, Array]:
        """Internal: what `Scene.to_pyvista` shows of this rank's owned cells. Collective."""
        return fields_of(membrane_results(self.system))

    @collective
    def reactions(self, where: str | Marker) -> Reactions:
        """Forces that supports at a place exert on all that meets there, in the current state.

        Collective. What meets there is the membrane, and each end of a cable or a bar whose anchor
        or held joint is at one of the vertices, or on an edge between two of them.

        Parameters
        ----------
        where
            Vertices, as for `Scene.vertices`, or the name of a held joint, such as "start of mast".

        Returns
        -------
        Reactions
            Their sum, each part of it by name, and the force on each of this rank's vertices.

        Raises
        ------
        InputError
            As `Scene.vertices`.

        Examples
        --------
        >>> corner = solver.reactions("corner 1")
        >>> corner.total, corner.membrane, corner.parts["guy 1"]
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

    @collective
    def cable_forces(self) -> dict[str, CableResults]:
        """Tensions, contact and end forces of the cables, in the current state. Collective.

        Returns
        -------
        dict
            By the cables' names, the same on all ranks.

        Examples
        --------
        >>> for name, cable in solver.cable_forces().items():
        ...     print(f"{name}: {cable.least:.3g} to {cable.largest:.3g}")
        """
        return cable_results(self._scene)

    @collective
    def summary(self) -> Summary:
        """The current state by its extremes: plain numbers for tables and envelopes. Collective.

        Returns
        -------
        Summary
            The same on all ranks.
        """
        return summary(self.system)

    @collective
    def estimate_error(self) -> ErrorEstimate:
        """Estimate by how much the mesh makes the energy of the current state too high. Collective.

        It costs about as much as `results`. On the cases with references it is 0.4 to 2.6 times
        the true error (`tests/results/test_error_estimate.py`). What the sides of a polygon cut off
        a curved boundary is not in it.

        Returns
        -------
        ErrorEstimate
            For the whole membrane, and the shares of this rank's cells.

        Raises
        ------
        InputError
            On all ranks: the scene has been changed since its last load step, or there was none.

        Examples
        --------
        >>> solver.estimate_error().relative
        """
        self._scene.require_equilibrium("estimate_error")
        return ErrorEstimator(self._scene).of(self.system)

    @collective
    def residual(self) -> Residual:
        """Forces that are not balanced in the current state, to be destroyed. Collective.

        They are the slope of the potential energy: in equilibrium zero but at supports, where they
        are the supports' forces, and where a floor presses.

        Returns
        -------
        Residual
            As a function on `Scene.V`, of the joints, and as a vector of all unknowns.

        Examples
        --------
        >>> residual = solver.residual()
        >>> residual.vector.norm()  # without what is held
        >>> residual.destroy()
        """
        return residual(self.system)

    @collective
    def tangent(self) -> Tangent:
        """Second derivatives of the potential energy, to be destroyed. Collective.

        They are exact but for the terms that ``inexact`` names.

        Returns
        -------
        Tangent
            A matrix of PETSc for vectors as that of `residual`.

        Examples
        --------
        A step of Newton's method, of a membrane without cables:

        >>> residual, tangent = solver.residual(), solver.tangent()
        >>> ksp = PETSc.KSP().create(scene.comm)
        >>> ksp.setOperators(tangent.matrix, tangent.sparse)
        >>> step = residual.vector.duplicate()
        >>> ksp.solve(residual.vector, step)
        >>> owned = 3 * scene.V.dofmap.index_map.size_local
        >>> scene.u.x.array[:owned] -= step.array[:owned]
        >>> scene.u.x.scatter_forward()
        """
        return tangent(self.system)
