"""From a scene to a potential that can be minimised, and back to the scene's state."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.membrane import MembraneEnergy
from crms_fenicsx.energies.paper.step_history import StepHistory
from crms_fenicsx.energies.paper.step_pressure import StepPressure
from crms_fenicsx.energies.pressure import FollowerPressure
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.minimization.minimizer import Minimizer
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.model.laid_cable import polyline_length
from crms_fenicsx.scene import Scene

if TYPE_CHECKING:
    from crms_fenicsx.cables.element_tables import CableTables
    from crms_fenicsx.cables.numbering import Network
    from crms_fenicsx.energies.axial_friction import CapstanTension
    from crms_fenicsx.energies.cable_tension import CableTension
    from crms_fenicsx.energies.dead_load import DeadLoad
    from crms_fenicsx.energies.fold_penalty import KinkPenalty
    from crms_fenicsx.energies.folded_membrane import FoldedCells, FoldEnergy
    from crms_fenicsx.energies.lateral_friction import StickSlip
    from crms_fenicsx.energies.paper.friction_element import FrictionElementEnergy
    from crms_fenicsx.minimization.damping import Damping
    from crms_fenicsx.model.crossing import Member
    from crms_fenicsx.model.laid_cable import LaidCable

logger = logging.getLogger("crms_fenicsx")


UNSMOOTHED = 1e-13
"""How far the length that a cable's tension comes from may be from that of its polyline, relative
to its unstressed length."""


class System:
    """The potential of a scene, made of the terms that it needs and no others.

    Forms are compiled when a term is first needed. The layout of the unknowns and the cables'
    tables are made anew when cables are laid, become taut or slacken.

    Parameters
    ----------
    scene
        The scene; its current state is the first state.
    prefix
        PETSc options prefix.
    rtol
        Relative tolerance of the solver.
    """

    def __init__(self, scene: Scene, prefix: str, rtol: float) -> None:
        self.scene, self.prefix, self.rtol = scene, prefix, rtol
        self.membrane = self._membrane_term()
        self.plain_pressed = fem.Function(self.membrane.plain.function_space)
        self.pressure: FollowerPressure | StepPressure | None = None
        self.pressure_value = fem.Constant(scene.mesh.mesh, PETSc.ScalarType(0.0))
        self.network: Network | None = None
        self.tables: CableTables | None = None
        self.stick_slip: StickSlip | None = None
        self.friction_elements: FrictionElementEnergy | None = None
        self.tension: CableTension | None = None
        self.capstan: CapstanTension | None = None
        self.minimizer: Minimizer | None = None
        self._solved = True
        """Whether the last solve has converged; if not, the next one does without Newton's method,
        as it would most often fail in the same way, and slowly."""
        self.objective = 0.0
        """What the last solve has minimised; with friction more than the scene's energy."""
        self._folded_volume, self._folded_energy = np.zeros(1), np.zeros(1)
        self.rebuild()
        if scene.step_history is not None:
            self._take_step_history(scene.step_history)
        self.commits = scene.commits
        """How many load steps the scene had made when it and this system last agreed."""

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self.minimizer is not None:
            self.minimizer.destroy()
            self.potential.destroy()
            self.minimizer = None

    def expire(self) -> None:
        """Let the next solve begin with a rebuild."""
        self.built_for = -1

    def forget(self) -> None:
        """Let the next solve begin with a new H0."""
        if self.minimizer is not None:
            self.minimizer.forget()

    def rebuild(self) -> None:
        """Make layout, tables and solver anew for the scene as it is."""
        self.destroy()
        scene = self.scene
        self.tables = self.tension = self.capstan = None
        self.stick_slip = self.friction_elements = None
        if scene.cables:
            from crms_fenicsx.cables.crossings import arrange
            from crms_fenicsx.cables.node_positions import Whereabouts
            from crms_fenicsx.cables.numbering import Network

            assert scene.strip is not None
            scene.crossings = arrange(scene.cables, scene.strip, scene.crossings)
            self.network = Network(scene.cables, scene.strip, scene.u)
            self.unknowns = self.network.unknowns()
            self.network.hold(self.unknowns)
            self.whereabouts = Whereabouts(self.network, self.unknowns)
        else:
            self.network, self.unknowns = None, Unknowns(scene.V)
        blocks = self.unknowns.vertex_blocks()
        self.unknowns.held[blocks] = scene.held
        terms: list[EnergyTerm] = [self.membrane]
        self._set_plain(np.zeros(0, dtype=np.int32))
        if scene.pressure != 0.0 or self.pressure is not None or "pressure" in scene.energies:
            terms.append(self._pressure_term())
            terms += self._rim_terms()
        self.dead_load: DeadLoad | None = None
        if scene.dead_forces is not None:
            from crms_fenicsx.energies.dead_load import DeadLoad

            self.dead_load = DeadLoad(scene.dead_forces)
            terms.append(self.dead_load)
        if any(cable.taut for cable in scene.cables):
            terms += self._cable_terms()
        if all(term.name != "penalty" for term in terms):
            self._take_folded_history()
        if scene.floor_level is not None:
            lower = np.full_like(self.unknowns.X, -np.inf)
            lower[:, 2] = scene.floor_level - self.unknowns.X[:, 2]
            lower[self.unknowns.held] = -np.inf
            lower[self.unknowns.rails] = -np.inf
            self.unknowns.bounds = (lower, np.full_like(lower, np.inf))
        self.potential = Potential(self.unknowns, scene.u, terms, self._damping())
        self.minimizer = Minimizer(self.potential, self.prefix, self.rtol)
        self.built_for = scene.changes

    def _take_folded_history(self) -> None:
        """Give what folded cells have had in steps before to the plain ones: none is folded."""
        if self.scene.strain_law == "step":
            from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy

            assert isinstance(self.membrane, StepMembraneEnergy)
            self.membrane.energy_n += float(self._folded_energy[0])
            self._folded_energy[0] = 0.0
        if isinstance(self.pressure, StepPressure):
            self.pressure.volume_n += float(self._folded_volume[0])
            self._folded_volume[0] = 0.0

    def _membrane_term(self) -> MembraneEnergy:
        scene = self.scene
        if scene.strain_law == "total":
            return MembraneEnergy(scene.u, scene.materials, scene.cell_tags)
        from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy

        return StepMembraneEnergy(scene.u, scene.materials, scene.cell_tags)

    def _set_plain(self, folded: npt.NDArray[np.int32]) -> None:
        """Say which cells are folded, and so left to terms of their own."""
        plain = self.membrane.plain.x.array
        plain[:] = 1.0
        plain[folded] = 0.0
        self.plain_pressed.x.array[:] = plain * self.scene.pressed

    def _pressure_term(self) -> FollowerPressure | StepPressure:
        term = self.pressure
        if term is None:
            u, cells, value = self.scene.u, self.plain_pressed, self.pressure_value
            if self.scene.pressure_law == "total":
                term = FollowerPressure(u, cells, value, self.scene.centre)
            else:
                term = StepPressure(u, cells, value)
            self.pressure = term
        return term

    def _rim_terms(self) -> list[EnergyTerm]:
        """What closes the volume where the rim of the pressure slides in planes."""
        scene = self.scene
        if scene.pressure_law != "total":
            return []
        rim = scene.rim()
        if scene.comm.allreduce(len(rim.sliding), op=MPI.SUM) == 0:
            return []
        from crms_fenicsx.energies.pressure_rim import RimPressure

        return [RimPressure(rim, self.pressure_value, scene.centre)]

    def _cable_terms(self) -> list[EnergyTerm]:
        """Terms of the cables in tension; the cells that they fold leave the membrane term."""
        from crms_fenicsx.cables.element_tables import cable_tables

        assert self.network is not None
        self.tables = cable_tables(self.network, self.membrane, self.scene.pressed)
        folded = self.tables.folded
        self._set_plain(folded.cells)
        terms = self._tension_terms(self.network, self.tables)
        # Every rank has the same terms, so that sums line up; folds may be on some ranks only.
        if self.scene.comm.allreduce(len(folded.cells), op=MPI.SUM) > 0:
            terms += [self._fold_term(folded), self._penalty_term(self.tables)]
            if self.pressure is not None:
                terms.append(self._folded_pressure_term(self.tables))
        return terms + self._friction_terms(self.network)

    def _damping(self) -> Damping | None:
        if self.network is None or self.tables is None:
            return None
        from crms_fenicsx.cables.element_tables import damping

        return damping(self.network, self.tables.segments)

    def _friction_terms(self, network: Network) -> list[EnergyTerm]:
        """Terms of the cables in tension that friction holds back sideways."""
        laws = {
            cable.cable.sideways.law
            for cable in self.scene.cables
            if cable.taut and cable.cable.sideways is not None
        }
        if not laws:
            return []
        from crms_fenicsx.cables.strip_positions import StripShape
        from crms_fenicsx.friction.lateral import align

        for cable in self.scene.cables:
            if cable.taut:
                align(cable)
        shape = StripShape.of(self.scene)
        terms: list[EnergyTerm] = []
        if "coulomb" in laws:
            from crms_fenicsx.energies.lateral_friction import StickSlip
            from crms_fenicsx.friction.lateral_tables import slip_table

            self.stick_slip = StickSlip(slip_table(network, shape))
            terms.append(self.stick_slip)
        if "step" in laws:
            from crms_fenicsx.energies.paper.friction_element import FrictionElementEnergy
            from crms_fenicsx.friction.lateral_tables import element_table

            self.friction_elements = FrictionElementEnergy(element_table(network, shape))
            terms.append(self.friction_elements)
        return terms

    def renew_friction(self) -> None:
        """Bring the friction forces of the potential to those that the cables have. Collective."""
        if self.stick_slip is None is self.friction_elements and self.capstan is None:
            return
        from crms_fenicsx.cables.strip_positions import StripShape

        assert self.network is not None
        shape = StripShape.of(self.scene)
        if self.stick_slip is not None:
            from crms_fenicsx.friction.lateral_tables import slip_table

            self.stick_slip.renew(slip_table(self.network, shape))
        if self.friction_elements is not None:
            from crms_fenicsx.friction.lateral_tables import element_table

            self.friction_elements.renew(element_table(self.network, shape))
        if self.capstan is not None:
            from crms_fenicsx.friction.axial_tables import grip_table

            self.capstan.renew(grip_table(self.network, shape))

    def _tension_terms(self, network: Network, tables: CableTables) -> list[EnergyTerm]:
        """Terms of the cables with one tension, and of those that friction holds along."""
        taut = [cable for cable in self.scene.cables if cable.taut]
        self._sliding = [cable for cable in taut if cable.axial is None]
        self._gripped = [cable for cable in taut if cable.axial is not None]
        terms: list[EnergyTerm] = []
        if self._sliding:
            self.tension = self._tension_term(tables, taut)
            terms.append(self.tension)
        if self._gripped:
            from crms_fenicsx.cables.strip_positions import StripShape
            from crms_fenicsx.energies.axial_friction import CapstanTension
            from crms_fenicsx.friction.axial import align_axial
            from crms_fenicsx.friction.axial_tables import chain_table, grip_table

            for cable in self._gripped:
                align_axial(cable)
            grips = grip_table(network, StripShape.of(self.scene))
            L0 = np.array([cable.L0 + cable.excess for cable in self._gripped])
            self.capstan = CapstanTension(chain_table(network, tables), grips, L0)
            terms.append(self.capstan)
        return terms

    def _tension_term(self, tables: CableTables, taut: list[LaidCable]) -> CableTension:
        from crms_fenicsx.energies.cable_tension import CableTension
        from crms_fenicsx.energies.paper.step_cable import StepCableTension

        own = self._sliding
        EA, L0 = np.array([c.cable.EA for c in own]), np.array([c.L0 for c in own])
        starts = [cable.step_start for cable in own]
        one = np.array([cable.axial is None for cable in taut])
        mine, number = one[tables.cable], np.cumsum(one, dtype=np.int32) - np.int32(1)
        links = (tables.segments[mine], tables.eps[mine], number[tables.cable[mine]])
        return (
            StepCableTension(*links, EA, L0, starts)
            if any(starts)
            else CableTension(*links, EA, L0)
        )

    def _fold_term(self, folded: FoldedCells) -> FoldEnergy:
        from crms_fenicsx.energies.folded_membrane import FoldEnergy

        membrane = self.membrane
        if self.scene.strain_law == "total":
            self.folds = FoldEnergy(folded, membrane.stiffening)
        else:
            from crms_fenicsx.energies.paper.step_folded_membrane import StepFoldEnergy
            from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy

            assert isinstance(membrane, StepMembraneEnergy)
            self.folds = StepFoldEnergy(folded, membrane, self._folded_energy)
        return self.folds

    def _penalty_term(self, tables: CableTables) -> KinkPenalty:
        from crms_fenicsx.energies.fold_penalty import KinkPenalty

        if self.scene.literal_penalty is not None:
            self.kinks = KinkPenalty(tables.literal_penalty(self.scene.literal_penalty))
            return self.kinks
        materials = self.membrane.materials
        tags = self.membrane.material_tags(tables.folded.cells)
        moduli = np.array([materials[int(tag)].reference_modulus for tag in tags])
        self.kinks = KinkPenalty(tables.penalty(self.scene.penalty, moduli))
        return self.kinks

    def _folded_pressure_term(self, tables: CableTables) -> EnergyTerm:
        from crms_fenicsx.energies.folded_pressure import FoldedFollowerPressure
        from crms_fenicsx.energies.paper.step_folded_pressure import FoldedStepPressure

        if self.scene.pressure_law == "total":
            return FoldedFollowerPressure(tables.facets, self.pressure_value, self.scene.centre)
        return FoldedStepPressure(tables.facets, self.pressure_value, self._folded_volume)

    def _tiny_force(self) -> float:
        """A force that is nothing without any load; with one, forces are told from its own."""
        scene = self.scene
        dead = scene.dead_forces
        if scene.pressure != 0.0 or (dead is not None and scene.load * dead.intensity != 0.0):
            return 0.0
        materials = scene.materials.values()
        section = max(m.reference_modulus + float(m.prestress_vector.max()) for m in materials)
        return 1e-12 * section * scene.size

    def pull(self) -> None:
        """Take state and loads from the scene."""
        scene, potential = self.scene, self.potential
        self.pressure_value.value = scene.pressure
        if self.dead_load is not None:
            self.dead_load.factor = scene.load
        potential.x[self.unknowns.vertex_blocks()] = scene.u.x.array.reshape(-1, 3)
        if self.network is not None:
            for (c, k), number in self.network.numbers.items():
                block = self.network.blocks[number]
                if block >= 0:
                    potential.x[block] = scene.cables[c].positions[k] - self.unknowns.X[block]
            self.unknowns.update_ghosts(potential.x_vector)  # far vertices, with rails on them
            self.network.place_rails(self.unknowns, potential.x)
            if self.tension is not None:
                self.tension.L0[:] = [cable.L0 for cable in self._sliding]
                self.tension.excess[:] = [cable.excess for cable in self._sliding]
            if self.capstan is not None:
                self.capstan.L0[:] = [cable.L0 + cable.excess for cable in self._gripped]
        potential.place()

    def push(self) -> None:
        """Give the solved state back to the scene."""
        scene, network = self.scene, self.network
        self.potential.bring_up_to_date()
        scene.energies = self.potential.energies()
        self.objective = scene.energy
        if network is None:
            return
        self.whereabouts.tell(self.potential.x)
        for cable in scene.cables:
            cable.state.length = polyline_length(cable.positions[cable.contacts()])
            cable.state.tension = 0.0
        if self.tension is not None:
            forces = self.tension.tensions(self.potential.sums_of(self.tension))
            for cable, force in zip(self._sliding, forces, strict=True):
                cable.state.tension = float(force)
        if "friction" in scene.energies:  # the state has what it stores; the rest is heat
            from crms_fenicsx.cables.strip_positions import StripShape
            from crms_fenicsx.friction.lateral import energies

            shape = StripShape.of(scene)
            scene.energies["friction"] = sum(energies(c, shape)[0] for c in scene.cables)
        if self.capstan is not None:
            self._push_gripped(self.capstan)

    def renew_excess(self) -> bool:
        """Take from the cables' lengths what smoothing adds to them in the solved state.

        Says whether that has changed.
        """
        lengths: list[tuple[LaidCable, float]] = []
        if self.tension is not None:
            sums = self.potential.sums_of(self.tension)
            lengths += [(c, float(length)) for c, length in zip(self._sliding, sums, strict=True)]
        if self.capstan is not None:
            sums = self.potential.sums_of(self.capstan)
            for c, cable in enumerate(self._gripped):
                spans = sums[self.capstan.spans_of(c)]
                lengths.append((cable, float(spans.sum()) - cable.excess))
        changed = False
        for cable, length in lengths:
            more = length - cable.length
            if abs(more) > UNSMOOTHED * cable.L0:
                logger.debug("%s: smoothing adds %.3g to its length", cable.name, more)
                cable.state.excess += more
                changed = True
        return changed

    def _push_gripped(self, capstan: CapstanTension) -> None:
        """Give the state of the cables that friction holds along back to the scene."""
        from crms_fenicsx.friction.axial import found

        energies, sums = self.scene.energies, self.potential.sums_of(capstan)
        tensions, (stored, lost) = capstan.tensions(sums), capstan.friction(sums)
        for c, cable in enumerate(self._gripped):
            spans, nodes = capstan.spans_of(c), capstan.nodes_of(c)
            unstressed, slips = capstan.unstressed[spans], capstan.slips[nodes]
            found(cable, sums[spans], unstressed, tensions[spans], slips, float(lost[c]))
        energies["cables"] -= float(stored.sum() + lost.sum())
        energies["friction"] = energies.get("friction", 0.0) + float(stored.sum())

    def prepare(self) -> None:
        """Bring the potential up to date with the scene's parts and loads. Collective."""
        if self.built_for != self.scene.changes or (
            self.scene.pressure != 0.0 and self.pressure is None
        ):
            self.rebuild()
        elif self._gripped_elsewhere():
            self.rebuild()
        else:  # it still counts the slips of cables from where the last load step began
            self.renew_friction()

    def _gripped_elsewhere(self) -> bool:
        """Whether friction along some cable holds it at other nodes than the potential has."""
        held = [cable for cable in self.scene.cables if cable.axial is not None]
        if not held:
            return False
        from crms_fenicsx.friction.axial import is_aligned

        return not all(is_aligned(cable) for cable in held)

    def locate_cables(self) -> None:
        """Tell all ranks where the cables' points are."""
        if self.network is not None:
            self.whereabouts.tell(self.potential.x)

    def minimize(
        self, h0_prestress: tuple[float, ...], interrupt: Callable[[], bool] | None = None
    ) -> Outcome:
        """Minimise the potential from the state pulled; see `Minimizer.solve`."""
        assert self.minimizer is not None
        self.minimizer.atol = self._tiny_force()
        self.minimizer.newton = self._solved
        self.potential.begin_step()
        try:
            outcome = self.minimizer.solve(h0_prestress, interrupt)
            self._solved = outcome.converged
            return outcome
        except PETSc.Error as error:
            if error.__cause__ is not None:  # an error in a callback, or an interrupt
                raise error.__cause__ from None
            raise

    def caught_nodes(self, limit: float) -> set[Member]:
        """Fold points at which a folded edge has a kink of more than a limit (rad).

        Judged at the state last evaluated; not for the paper's literal penalty. Collective.
        """
        if self.tables is None or self.scene.literal_penalty is not None:
            return set()
        mine: set[Member] = set()
        if self.tables.kinks:
            sharp = np.flatnonzero(np.abs(self.kinks.residuals) > limit)
            mine = {self.tables.kinks[k][2] for k in sharp}
        return set().union(*self.scene.comm.allgather(mine))

    def caught_cables(self, limit: float) -> set[int]:
        """Numbers of the cables with caught nodes."""
        return {c for c, _ in self.caught_nodes(limit)}

    @property
    def has_history(self) -> bool:
        """Whether some law depends on the state at the start of a load step."""
        scene = self.scene
        return "step" in (scene.strain_law, scene.pressure_law) or any(
            cable.cable.law == "step" for cable in scene.cables
        )

    @property
    def is_outdated(self) -> bool:
        """Whether another system has made load steps of the scene since."""
        return self.commits != self.scene.commits

    def _step_history(self) -> StepHistory:
        cells, energy, pressure = None, 0.0, self.pressure
        if self.scene.strain_law == "step":
            from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy

            assert isinstance(self.membrane, StepMembraneEnergy)
            cells = self.membrane.history.x.array.reshape(-1, 6).copy()
            energy = self.membrane.energy_n
        volume = pressure.volume_n if isinstance(pressure, StepPressure) else 0.0
        return StepHistory(
            cells, energy, float(self._folded_energy[0]), volume, float(self._folded_volume[0])
        )

    def _take_step_history(self, history: StepHistory) -> None:
        """Go on from the load steps of another system of the same scene."""
        if history.cells is not None:
            from crms_fenicsx.energies.paper.step_membrane import StepMembraneEnergy

            assert isinstance(self.membrane, StepMembraneEnergy)
            self.membrane.history.x.array[:] = history.cells.ravel()
            self.membrane.energy_n = history.energy
        if isinstance(self.pressure, StepPressure):
            self.pressure.volume_n = history.volume
        self._folded_energy[0] = history.folded_energy
        self._folded_volume[0] = history.folded_volume
        self.expire()  # terms of folded cells have their state from the time when they are made

    def commit(self) -> None:
        """End a load step."""
        self.potential.commit()
        self.scene.commits += 1
        self.commits = self.scene.commits
        if "step" in (self.scene.strain_law, self.scene.pressure_law):
            self.scene.step_history = self._step_history()
        for cable in self.scene.cables:
            cable.state.ends_before = cable.positions[[0, -1]].copy()
        gripped = [cable for cable in self.scene.cables if cable.grip is not None]
        held_along = [cable for cable in self.scene.cables if cable.axial is not None]
        if not gripped and not held_along:
            return
        from crms_fenicsx.cables.strip_positions import StripShape

        shape = StripShape.of(self.scene)
        if gripped:
            from crms_fenicsx.friction.lateral import commit

            for cable in gripped:
                commit(cable, shape)
        if held_along:
            from crms_fenicsx.friction.axial import commit_axial

            for cable in held_along:
                commit_axial(cable, shape)
