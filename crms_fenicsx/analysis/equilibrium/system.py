"""Conversion of a scene to a potential to minimise, and of the solution to the scene's state."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.analysis.equilibrium.contribution import (
    Contribution,
    MembraneContribution,
    MembraneLoadsContribution,
    PressureContribution,
    force_per_area,
    hold,
    unloaded_scales,
)
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.row_shifts import SETTLED
from crms_fenicsx.energy.minimization.minimizer import Interrupt, Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.stability import is_convex_from
from crms_fenicsx.energy.terms.pressure import FollowerPressure
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.model.cable_state import NodeId
from crms_fenicsx.model.laid_cable import LaidCable

if TYPE_CHECKING:
    from crms_fenicsx.analysis.equilibrium.cable_contribution import CableContribution
    from crms_fenicsx.analysis.equilibrium.fold_contribution import FoldContribution
    from crms_fenicsx.analysis.equilibrium.frame_contribution import BarContribution
    from crms_fenicsx.analysis.equilibrium.friction_contribution import FrictionContribution
    from crms_fenicsx.analysis.equilibrium.pond_contribution import PondContribution
    from crms_fenicsx.analysis.equilibrium.row_sliding import RowSliding
    from crms_fenicsx.analysis.equilibrium.shift_contribution import ShiftContribution
    from crms_fenicsx.cabling.cables.element_tables import CableTables

FAR = 0.01
"""Movement in a minimisation, relative to the membrane's size, above which snap-through is checked:
most load steps of an erected structure move less."""

ENDLESS = 10.0
"""Movement under water, relative to the membrane's size, above which no equilibrium is expected: no
fabric stretches so far."""


class System:
    """The potential of a scene, assembled from the contributions of its features.

    Forms are compiled when a term is first needed. The layout of the unknowns and the cable tables
    are recreated when cables are laid, tighten or slacken.

    Attributes: `parts`: contributions of the scene's features, in the order of their terms;
    `membrane`, `pressure`, `cables`, `folds`, `friction`, `bars`, `ponds`, `shifts`: some of them,
    the last six None if absent; `slide`: whether cables slide sideways; `unknowns`, `potential`:
    the layout, and the sum of the terms over it; `rows_rest`: whether rows that slide had come to
    rest in the last solve; `objective`: minimum of the last solve, with friction more than the
    scene's energy (force x length).
    """

    def __init__(self, scene: Scene, prefix: str, rtol: float, slide: bool = True) -> None:
        self.scene, self.prefix, self.rtol, self.slide = scene, prefix, rtol, slide
        # As long as one object is there PETSc keeps its duplicate of the communicator: to make it
        # again for each layout takes longer than a solve of some hundred unknowns.
        self._lasting = PETSc.Vec().createMPI(0, comm=scene.comm)
        self.membrane = MembraneContribution(scene)
        self.pressure = PressureContribution(scene, self.membrane)
        self._loads = MembraneLoadsContribution(scene)
        self.cables: CableContribution | None = None
        self.folds: FoldContribution | None = None
        self.friction: FrictionContribution | None = None
        self.bars: BarContribution | None = None
        self.ponds: PondContribution | None = None
        self.shifts: ShiftContribution | None = None
        self.parts: list[Contribution]
        self.unknowns: Unknowns
        self.potential: Potential
        self.minimizer: Minimizer | None = None
        self._rows: RowSliding | None = None
        self.rows_rest, self.holds_rows = True, False
        self._solved = True
        """Whether the last solve converged; if not, the next one does without Newton's method,
        which would most often fail in the same way, and slowly."""
        self.objective = 0.0
        # number of the model that the potential is of, and whether its crossings were arranged then
        self._built_for = -1, False
        self.update()

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self.minimizer is not None:
            self.minimizer.destroy()
            self.potential.destroy()
            self.minimizer = None
            del self.potential, self.parts  # free their memory before the next ones
            self.cables = self.folds = self.friction = self.bars = self.ponds = self.shifts = None

    def invalidate(self) -> None:
        """Make the next solve start with a rebuild."""
        self._built_for = -1, False

    def reset_h0(self) -> None:
        """Make the next solve start with a new H0."""
        if self.minimizer is not None:
            self.minimizer.reset_h0()

    def rebuild(self, arrange: bool = True) -> None:
        """Recreate layout, terms and minimiser for the current scene. Collective. Without `arrange`
        the crossings stay as in the solve that led to this state, for inspection."""
        self.destroy()
        self.invalidate()
        scene = self.scene
        if arrange:
            scene.net.arrange_crossings()
        if scene.frame:
            from crms_fenicsx.analysis.equilibrium.frame_contribution import BarContribution

            self.bars = BarContribution(scene)
        frame = None if self.bars is None else self.bars.blocks
        folds = damping = None
        if scene.cables:
            from crms_fenicsx.analysis.equilibrium.cable_contribution import CableContribution

            self.cables = CableContribution(
                scene, self.membrane.energy, frame, self.slide and not self.holds_rows
            )
            self.unknowns, folds = self.cables.unknowns, self.cables.folds()
            damping = self.cables.damping()
        else:
            self.unknowns = Unknowns(scene.V) if frame is None else frame.layout(scene.V)
        hold(scene, self.unknowns)
        terms = self.membrane.terms(self.unknowns, folds) + self.pressure.terms(folds)
        terms += self._loads.terms()
        self.parts = [self.membrane, self.pressure, self._loads]
        if self.cables is not None:
            terms += self._terms_of_cables(self.cables, folds)
        if self.bars is not None:
            terms += self.bars.terms(self.unknowns)
            damping = self.bars.damping(damping)
            self.parts.append(self.bars)
        if scene.ponds:
            from crms_fenicsx.analysis.equilibrium.pond_contribution import PondContribution

            self.ponds = PondContribution(scene, self.membrane, self.cables)
            terms += self.ponds.terms(self.unknowns)
            self.parts.append(self.ponds)
        self.potential = Potential(self.unknowns, scene.u, [*terms, *scene.terms], damping)
        self.minimizer = Minimizer(self.potential, self.prefix, self.rtol)
        self._built_for = scene.versions.model_version, arrange or not scene.cables

    def _terms_of_cables(
        self, cables: CableContribution, folds: CableTables | None
    ) -> list[EnergyTerm]:
        """Terms of cables, the cells that they fold, and friction. Collective."""
        scene, terms = self.scene, cables.terms()
        self.parts.append(cables)
        if folds is not None:
            from crms_fenicsx.analysis.equilibrium.fold_contribution import FoldContribution

            self.folds = FoldContribution(
                scene, self.membrane, self.pressure, cables.numbering, folds
            )
            terms += self.folds.terms
            self.parts.append(self.folds)
        if len(cables.numbering.shifts.nodes):
            from crms_fenicsx.analysis.equilibrium.shift_contribution import ShiftContribution

            self.shifts = ShiftContribution(scene, self.membrane, cables.numbering, self._rows_stay)
            terms.append(self.shifts.energy)
            self.parts.append(self.shifts)
        if scene.net.has_friction or any(
            cable.state.law.axial is not None for cable in scene.cables
        ):
            from crms_fenicsx.analysis.equilibrium.friction_contribution import FrictionContribution

            self.friction = FrictionContribution(scene, cables)
            terms += self.friction.terms()
            self.parts.append(self.friction)
        return terms

    def prepare(self) -> None:
        """Bring the potential up to date with the scene's parts and loads. Collective."""
        built = self._built_for == (self.scene.versions.model_version, True)
        fits = self.friction is None or self.friction.fits
        if not built or not fits or self.pressure.is_missing:
            self.rebuild()
        else:  # the potential still counts slips from the start of the last step
            self.renew_friction()

    def read_scene(self) -> None:
        """Copy state and loads from the scene."""
        for part in self.parts:
            part.read_scene(self.potential)
        self.potential.place()

    def largest_shift(self) -> float:
        """Largest shift of a stress-free place in the last solve, relative to the cell size.
        Collective."""
        return 0.0 if self.shifts is None else self.unknowns.largest_shift(self.potential.x)

    def begin_rows(self) -> None:
        """Begin a load step: lines are held until the structure stands under its loads and contacts
        have settled; on the way there rows would slide far, and back."""
        self.holds_rows = self.slide and any(cable.takes_line for cable in self.scene.cables)
        if self.shifts is not None:
            self.invalidate()
        if self._rows is not None:
            self._rows.begin()

    def follow_rows(self, begins: bool, solved: bool) -> float:
        """Move the scene's stress-free mesh by the shifts of the last solve; return the largest, as
        `largest_shift`. `begins`, `solved`: see `RowSliding.follow`. Collective."""
        way = 0.0
        if self.shifts is not None:
            if self._rows is None:
                from crms_fenicsx.analysis.equilibrium.row_sliding import RowSliding

                self._rows = RowSliding(self.scene)
            way = self._rows.follow(self.shifts, self.potential, begins, solved)
        self.rows_rest = way <= SETTLED
        return way

    def release(self) -> None:
        """Free all PETSc objects, for good."""
        self.destroy()
        self._lasting.destroy()
        if self._rows is not None:
            self._rows.destroy()

    def release_rows(self) -> None:
        """Let rows that stay for the rest of the load step shift again, so that checks judge them.
        Collective."""
        if self._rows is not None and self._rows.motions.rest:
            self._rows.motions.rest = False
            if self.shifts is not None:
                self.renew_base()

    @property
    def _rows_stay(self) -> bool:
        """Whether all rows stay for the rest of the load step."""
        return self._rows is not None and self._rows.motions.rest

    @property
    def collapse(self) -> str:
        """Why the last motion of the mesh cannot be used; "" if it can."""
        return "" if self._rows is None else self._rows.collapse

    def renew_base(self, held: bool = False) -> None:
        """Start from the stress-free places that the membrane has now, with all rows `held` there
        or with those that shift. Collective."""
        assert self.shifts is not None and self.cables is not None
        if not self.cables.faces_all:  # rows have come near each other
            self.rebuild()
            self.read_scene()
            return
        self.membrane.renew_places()
        if isinstance(self.pressure.term, FollowerPressure):
            self.pressure.renew_places(self.pressure.term)
        self.shifts.renew(self.unknowns, held or self._rows_stay)
        for term in self.scene.terms:
            term.attach(self.unknowns)
        self.read_scene()
        self.renew_friction()
        self._built_for = self.scene.versions.model_version, True

    def settle(self) -> Outcome:
        """Bring the membrane into balance on rows that are held where they lie, after shifts at
        the solver's tolerance. Collective."""
        self.renew_base(held=True)
        outcome = self.minimize((0.0,))
        self.write_scene()
        self.renew_base()
        return outcome

    def update(self) -> None:
        """Bring the potential to the scene's state for inspection."""
        known = self._built_for[0] == self.scene.versions.model_version
        if not known:
            self.rebuild(self.scene.net.arranged != self.scene.net.cables)
        self.read_scene()
        if not known:  # step-wise laws have no forces before a step begins
            self.potential.begin_step()

    def added_force_per_area(self) -> float:
        """Mean size of the forces of ponds and user terms (force per area). Collective."""
        if not self.scene.terms and not self.scene.ponds:
            return 0.0
        self.update()
        of_terms = force_per_area(self.scene, self.potential) if self.scene.terms else 0.0
        return of_terms + (0.0 if self.ponds is None else self.ponds.force_per_area(self.potential))

    def locate_cables(self) -> None:
        """Copy the positions of cable points and joints to the scene, on all ranks. Collective."""
        for part in (self.cables, self.bars):
            if part is not None:
                part.locate(self.potential)

    def write_scene(self) -> None:
        """Copy the solved state to the scene. Collective."""
        self.potential.bring_up_to_date()
        self.scene.record(energies=self.potential.energies())
        self.objective = self.scene.energy
        for part in self.parts:
            part.write_scene(self.potential)

    def forces_beside(self) -> dict[LaidCable, Array]:
        """Forces (n, 3) at the nodes of cables that touch others side by side; none without
        diameters. Collective."""
        if not self.scene.net.may_touch:
            return {}
        from crms_fenicsx.cabling.contact.side_by_side import forces_beside

        return forces_beside(self.scene.net, self.scene.materials.values())

    def renew_friction(self) -> None:
        """Update the potential's friction forces from the cables. Collective."""
        if self.friction is not None:
            self.friction.renew()

    def renew_smoothing_length(self) -> bool:
        """Correct the cable lengths for smoothing and return whether that changed them."""
        return self.cables is not None and self.cables.renew_smoothing_length(self.potential)

    def minimize(
        self, h0_prestress: tuple[float, ...], interrupt: Interrupt | None = None
    ) -> Outcome:
        """Minimise the potential from the state read; see `Minimizer.solve`."""
        assert self.minimizer is not None
        self.minimizer.atol, self.minimizer.stiffness = unloaded_scales(self.scene)
        self.minimizer.size = self.scene.membrane.size
        self.minimizer.newton = self._solved
        if self.ponds is not None:
            self.minimizer.reach = ENDLESS * self.scene.membrane.size
        self.potential.begin_step()
        start = self.potential.x.copy()
        try:
            outcome = self.minimizer.solve(h0_prestress, interrupt)
        except PETSc.Error as error:
            if error.__cause__ is not None:  # an error in a callback, or an interrupt
                raise error.__cause__ from None
            raise
        self._solved = outcome.converged
        if not outcome.converged and self._rows is not None:
            outcome = replace(outcome, reason=outcome.reason + self._rows.narrowed())
        far = outcome.converged and self._moved(start) > FAR * self.scene.membrane.size
        return replace(outcome, nonconvex=far and not is_convex_from(self.potential, start))

    def _moved(self, start: Array) -> float:
        """Largest movement (length) of a vertex or joint since a start. Collective."""
        way = self.potential.x - start
        points = [way[: self.unknowns.n_vertices]]
        if self.bars is not None:
            points.append(way[self.bars.blocks.joint_blocks])
        squares = np.concatenate([np.einsum("ni,ni->n", some, some) for some in points])
        largest = float(squares.max(initial=0.0))
        return float(self.scene.comm.allreduce(largest, op=MPI.MAX)) ** 0.5

    def pressed_facets(self) -> tuple[Integers, Array]:
        """Corners (n, 3) and weighted area vectors (n, 3) of this rank's pressurised facets."""
        dofs = self.scene.V.dofmap.list[self.pressure.cells.x.array > 0.5]
        corners = self.unknowns.vertex_blocks()[dofs]
        weights: Array = np.ones(len(dofs))
        if self.cables is not None and self.cables.tables is not None:
            facets = self.cables.tables.facets
            corners = np.concatenate([corners, facets.corners])
            weights = np.concatenate([weights, facets.weights])
        # By components: numpy takes five times as long on rows of three.
        places = np.ascontiguousarray((self.unknowns.X + self.potential.x).T)
        start = places.take(corners[:, 0], axis=1)
        (a, b, c), (d, e, f) = (places.take(corners[:, k], axis=1) - start for k in (1, 2))
        vectors = np.array([b * f - c * e, c * d - a * f, a * e - b * d])
        vectors *= weights / 2
        return corners, vectors.T

    def kinked_nodes(self, limit: float) -> set[NodeId]:
        """Fold points with an edge kink above a limit (rad). Collective."""
        return set() if self.folds is None else self.folds.kinked_nodes(limit)

    def kinked_cables(self, limit: float) -> set[int]:
        """Numbers of the cables with caught nodes."""
        return {c for c, _ in self.kinked_nodes(limit)}

    @property
    def has_history(self) -> bool:
        """Whether some law depends on the state at the start of a load step."""
        scene = self.scene
        stepwise = scene.strain_law == "step" or scene.pressure_law != "total"
        stepwise |= any(cable.cable.law == "step" for cable in scene.cables)
        return stepwise or any(term.has_history for term in scene.terms)

    def commit(self) -> None:
        """End a load step. Collective."""
        self.potential.commit()
        self.scene.versions.change_state()
        for part in self.parts:
            part.commit()
