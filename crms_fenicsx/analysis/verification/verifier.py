"""Verify a solved load step by other means than the solver's.

The solver reduces the energy's gradient to zero. The checks test what holds in any equilibrium:
virtual work, by differences of the energy instead of the gradient; loads, by areas and normals of
the current triangles instead of the forms; balance of reactions and loads in forces and moments;
prescribed positions of supports and anchors. `analysis.verification.cable_checks` checks the
cables.

A state that fails is rejected: `Solver.advance` goes back and halves the increment, as if the solve
had not converged, and finally raises a `ConvergenceError` that names the failed check.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.cable_forces import plain_vertices, section_forces
from crms_fenicsx.analysis.verification.report import ROUNDED, UNBALANCED, Check, Verification
from crms_fenicsx.cabling.cables.clamping import smallest_slip
from crms_fenicsx.energy.minimization.outcome import Outcome, is_unstressed
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes.triangles import area_vectors
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans

if TYPE_CHECKING:
    from crms_fenicsx.analysis.verification.cable_checks import CableVerifier

VIRTUAL_DISPLACEMENT = 1e-5
"""Size of the virtual displacements: the change of nodal forces that they cause in a membrane of
stiffness E t and its prestress, relative to the scene's force.

Where the energy is smooth, its difference is of second order in them; where it is not, as in cells
about to turn slack, the error is at most `VIRTUAL_DISPLACEMENT` times the scene's force.
"""
LARGEST_DISPLACEMENT = 1e-6
"""Largest virtual displacement, relative to the cell size: beside very tight cables the membrane's
stiffness is no measure."""
SMALLEST_SLIP = 0.01
"""Largest virtual displacement, relative to the smallest slip that mobilises axial friction: beyond
it the energy is not smooth."""
FINER = 16.0
"""Factor by which virtual displacements are reduced while the virtual work is too large: the error
of an energy that is not smooth falls with them."""
VIRTUAL_WORK = 1e-3
"""Largest virtual work, relative to the scene's force, without rounding. A hundred times what
`VIRTUAL_DISPLACEMENT` explains, as edges near cable points are stiffer than the membrane."""
VISIBLE = 0.1
"""Part of it that rounding may take, unless displacements would become too large."""
BALANCE = 1e-7
"""Largest relative imbalance of forces."""
SPREAD = 8.0
"""Standard deviations that bound a sum of unbalanced forces with random signs."""
GEOMETRIC_TERMS = "pressure", "dead load", "pond", "bars"
"""Terms whose forces the balance computes from the geometry."""


class Verifier:
    """Checks load steps of a scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.comm = scene, scene.comm
        self._random = np.random.default_rng((2026, scene.comm.rank))
        self._prescribed: tuple[Array, Array] = np.zeros((0, 3)), np.zeros((0, 2, 3))
        self._joints: list[Array] = []
        self._cables: CableVerifier | None = None
        self._share: Array | None = None
        self._least = 1.0

    def begin(self) -> None:
        """Record a load step's prescribed positions, after its loads are set."""
        scene = self.scene
        u = scene.u.x.array.reshape(-1, 3)[scene.held]
        ends = [cable.state.positions[[0, -1]] for cable in scene.cables]
        self._prescribed = u, np.array(ends).reshape(-1, 2, 3)
        self._joints = [joint.position for joint in scene.joints]

    def check(self, system: System, outcome: Outcome, more: Sequence[Check] = ()) -> Verification:
        """Check a solved state without changing it; adds checks made before. Collective."""
        began = time.perf_counter()
        force = max(outcome.scale, 1e-300)
        checks = [self._finite(system)]
        if not checks[0].passed:  # the other checks would divide by NaN
            return Verification(tuple(checks), time.perf_counter() - began)
        loads = self._loads(system)
        checks += self._balance(system, outcome, force, loads)
        if system.bars is not None:
            from crms_fenicsx.analysis.verification.frame_checks import check_frame

            checks += check_frame(system, system.bars)
        if self.scene.cables:
            if self._cables is None:
                from crms_fenicsx.analysis.verification.cable_checks import CableVerifier

                self._cables = CableVerifier()
            checks += self._cables.check(system, self._prescribed[1], loads)
        if all(check.passed for check in checks if check.binding):
            checks.append(self._virtual_work(system, outcome, force))
        checks += more
        found = Verification(tuple(checks), time.perf_counter() - began)
        if found.passed and found.doubtful:
            from crms_fenicsx.analysis.verification.doubts import doubt

            cables = {} if self._cables is None else self._cables.doubts
            found = replace(found, warnings=(doubt(self.scene, found.doubtful, cables),))
        return found

    def _finite(self, system: System) -> Check:
        """Number of positions and energies that are not finite."""
        state = system.potential.x, *(cable.state.positions for cable in self.scene.cables)
        bad = sum(int(np.count_nonzero(~np.isfinite(values))) for values in state)
        bad += sum(not np.isfinite(energy) for energy in self.scene.energies.values())
        return Check("values not finite", float(self.comm.allreduce(bad)), 0.0)

    def _virtual_work(self, system: System, outcome: Outcome, force: float) -> Check:
        """Energy difference along a random displacement of unit variance."""
        potential, unknowns = system.potential, system.unknowns
        n, scene = unknowns.n_owned, self.scene
        materials = scene.materials.values()
        modulus = max(m.reference_modulus for m in materials)
        prestress = max(float(np.abs(m.prestress_vector).max()) for m in materials)
        cells = scene.mesh.mesh.topology.index_map(2).size_global
        size = force / ((modulus + prestress) * np.sqrt(3.0 * unknowns.n_global))
        step = VIRTUAL_DISPLACEMENT * size
        largest = LARGEST_DISPLACEMENT * scene.membrane.size / np.sqrt(cells)
        for axial in (cable.state.law.axial for cable in scene.cables if cable.taut):
            if axial is not None:
                slip = float(axial.eps[axial.bounds > 0.0].min(initial=np.inf))
                largest = min(largest, SMALLEST_SLIP * slip)
        if scene.clamps:
            largest = min(largest, SMALLEST_SLIP * smallest_slip(scene.cables))
        shake: Array = (self._random.random((n, 3)) - 0.5) * np.sqrt(12.0)
        self._spare_small_cells(system, scene.membrane.size / np.sqrt(cells), shake)
        fixed: Booleans = np.array(unknowns.held[:n])
        if unknowns.bounds is not None:
            fixed |= potential.x[:n] <= unknowns.bounds[0][:n]
        shake[fixed] = 0.0
        rounding = EPSILON * np.sqrt(cells) * self._cancelling()
        # Take displacements large enough to exceed rounding. Where the energy is not smooth, the
        # error falls with their size.
        size = min(max(step, rounding / (VISIBLE * VIRTUAL_WORK * force)), largest)
        found, before = Check("virtual work", np.inf, 0.0), np.inf
        while size > 0.9 * min(step, largest) / FINER:
            work = self._difference(system, shake, size)
            limit = VIRTUAL_WORK + (SPREAD * outcome.residual + rounding / size) / force
            value = abs(work) / (2 * size * force)
            if value > 0.5 * before:  # an unbalanced force works along any displacement
                break
            found, before = Check("virtual work", value, float(limit)), value
            if found.passed:
                break
            size /= FINER
        return found

    def _cancelling(self) -> float:
        """Sum of energies, and of forces times lengths, whose rounding enters the virtual work."""
        scene, energies = self.scene, self.scene.energies
        reach = 1.0
        if not scene.cables:
            largest = float(np.abs(scene.u.x.array).max(initial=0.0))
            reach = 4 * self.comm.allreduce(largest, op=MPI.MAX) / scene.membrane.size
        forces = section_forces(scene) * reach * scene.membrane.size
        forces += sum(abs(cable.tension) * cable.length for cable in scene.cables)
        forces += sum(abs(bar.force) * bar.length for bar in scene.bars)
        return float(forces + sum(abs(energy) for energy in energies.values()))

    def _difference(self, system: System, shake: Array, size: float) -> float:
        """Energy difference between displacements +size and -size."""
        potential, unknowns = system.potential, system.unknowns
        n = unknowns.n_owned
        start, change = potential.x.copy(), np.zeros(len(potential.terms))
        for step in (size, -size):
            potential.x[:n] = start[:n] + step * shake
            potential.place()
            potential.sum_up()
            values = np.array([t.energy(potential.sums_of(t)) for t in potential.terms])
            change += np.sign(step) * values
        potential.x[:] = start
        potential.place()
        return float(change.sum())

    def _spare_small_cells(self, system: System, size: float, shake: Array) -> None:
        """Reduce displacements of vertices of small or thin cells, and of cable points most."""
        scene, unknowns = self.scene, system.unknowns
        if self._share is None:  # on all ranks, also those without vertices
            mesh = scene.mesh.mesh
            cells = scene.V.dofmap.list
            corners = scene.membrane.stress_free[cells]
            sides = np.roll(corners, -1, axis=1) - corners
            areas = np.linalg.norm(area_vectors(mesh), axis=1)
            longest = np.linalg.norm(sides, axis=-1).max(axis=1, initial=0.0)
            g = system.potential.g  # free between two solves
            g[:] = 0.0
            values = np.zeros((unknowns.n_vertices + unknowns.n_ghost_vertices, 3))
            np.add.at(values[:, 0], cells, (longest / (2 * areas))[:, None])
            unknowns.add_to_vertices(values, g)
            unknowns.gather_forces(system.potential.g_vector, g)
            # Six cells of the usual height around a vertex give the share 1.
            narrow = g[: unknowns.n_vertices, 0]
            self._share = np.asarray(6.0 / np.maximum(size * narrow, 6.0))
            smallest = float(self._share.min(initial=1.0))
            self._least = self.comm.allreduce(smallest, op=MPI.MIN)
        shake[: unknowns.n_vertices] *= self._share[:, None]
        shake[unknowns.n_vertices :] *= self._least

    def _balance(self, system: System, outcome: Outcome, force: float, loads: Array) -> list[Check]:
        """Balance of free nodes, and of reactions with loads that come from the geometry."""
        scene, potential, unknowns = self.scene, system.potential, system.unknowns
        n, size = unknowns.n_owned, scene.membrane.size
        x = unknowns.X + potential.x
        plain, g = plain_vertices(system), potential.g  # free between two solves
        g[:] = -loads
        unknowns.gather_forces(potential.g_vector, g)
        on_plain = np.sum(g[plain] ** 2)
        g[:] = -loads
        for term in potential.terms:
            if term.name not in GEOMETRIC_TERMS and term not in scene.terms:
                term.add_gradient(potential.x, potential.sums_of(term), g)
        if system.bars is not None:
            system.bars.add_pulls(g, -1.0)
        g[unknowns.shifts] = 0.0  # forces on stress-free places are no loads
        unknowns.gather_forces(potential.g_vector, g)
        supports = np.where(unknowns.held[:n], g[:n], 0.0)
        supports += self._obstacle(system)
        sliders = unknowns.sliders[unknowns.sliders < n]
        supports[sliders] = g[sliders]
        unknowns.project(g)
        supports[sliders] -= g[sliders]
        free = g[:n] - supports
        free[sliders] = g[sliders]
        shifts = unknowns.shifts[unknowns.shifts < n]  # with the supports' forces of held vertices
        supports[shifts] += free[shifts]
        free[shifts] = 0.0
        local = np.concatenate([
            supports.sum(axis=0), _moment(x[:n] - scene.membrane.centre, supports),
            loads.sum(axis=0), _moment(x - scene.membrane.centre, loads),
            [np.abs(supports).sum(), np.abs(loads).sum(), np.sum(free * free)],
            [np.sum(free[plain] ** 2), on_plain],
        ])  # fmt: skip
        total = np.zeros_like(local)
        self.comm.Allreduce(local, total)
        # Bound of the sum of m unbalanced forces with random signs.
        rounding = SPREAD * potential.rounding()
        unbalanced = SPREAD * outcome.residual + rounding + EPSILON * SPREAD * float(total[12])
        all_loads = max(float(total[13]), force)
        limit = BALANCE + unbalanced / all_loads
        modulus = max(m.reference_modulus for m in scene.materials.values())
        section, stored = section_forces(scene), abs(scene.energies.get("membrane", 0.0))
        own = max(float(np.sqrt(total[16])) or section, 1e-300)
        unbalanced_own = float(np.sqrt(total[15]))
        if total[16] == 0.0 and is_unstressed(section, stored, modulus * size, size):
            unbalanced_own = 0.0
        worst = self._position_errors(unknowns)
        checks = [
            Check("unbalanced forces", float(np.sqrt(total[14])) / force,
                  BALANCE + SPREAD * outcome.residual / force),
            Check("unbalanced forces of the membrane", unbalanced_own / own,
                  UNBALANCED + rounding / own, binding=False),
            Check("sum of supports and loads", _norm(total[:3] + total[6:9]) / all_loads, limit),
            Check("supports off their place", worst[0] / worst[2], ROUNDED),
        ]  # fmt: skip
        laws = [cable.cable.sideways for cable in scene.cables if cable.taut]
        if not any(friction is not None and friction.law == "step" for friction in laws):
            # The paper's friction elements are exempt: their forces do not rotate with the shape.
            moment = _norm(total[3:6] + total[9:12])
            checks.append(Check("moment of supports and loads", moment / (all_loads * size), limit))
        if scene.floor_level is not None:
            checks.append(Check("depth below the floor", worst[1] / worst[2], ROUNDED))
        return checks

    def _position_errors(self, unknowns: Unknowns) -> Array:
        """Errors of support positions, depth below the floor, and distance from the origin."""
        scene, (moved, _) = self.scene, self._prescribed
        away = float(
            np.max(np.abs(scene.u.x.array.reshape(-1, 3)[scene.held] - moved), initial=0.0)
        )
        for joint, place in zip(scene.joints, self._joints, strict=True):
            away = max(away, float(np.max(np.abs(joint.position - place)[joint.held], initial=0.0)))
        under = 0.0
        if scene.floor_level is not None:
            heights = scene.positions()[~scene.held[:, 2], 2]
            under = float(np.max(scene.floor_level - heights, initial=0.0))
        far = max(scene.membrane.size, float(np.abs(unknowns.X).max(initial=0.0)))
        worst = np.nan_to_num([away, under, far], nan=np.inf)  # MPI's maximum of NaN is undefined
        self.comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
        return worst

    def _loads(self, system: System) -> Array:
        """This rank's nodal forces of pressure, loads, ponds and added terms, (n_local, 3)."""
        scene, unknowns = self.scene, system.unknowns
        loads = np.zeros((unknowns.n_local, 3))
        if scene.pressure_law == "total":
            if scene.pressure != 0.0:
                corners, vectors = system.pressed_facets()
                blocks = corners.ravel()
                for i in range(3):
                    share = np.repeat(vectors[:, i] * (scene.pressure / 3), 3)
                    loads[:, i] = np.bincount(blocks, share, unknowns.n_local)
        else:
            for term in system.potential.terms:
                if term.name == "pressure":
                    term.add_gradient(system.potential.x, system.potential.sums_of(term), loads)
            loads *= -1.0
        for load in scene.loads:
            unknowns.add_to_vertices(load.factor * load.forces, loads)
        if system.bars is not None:
            system.bars.add_loads(loads)
        if system.ponds is not None:
            system.ponds.add_pressure(system.potential, loads, 1.0)
        for term in scene.terms:
            added = np.zeros_like(loads)
            term.add_gradient(system.potential.x, system.potential.sums_of(term), added)
            loads -= added
        return loads

    def _obstacle(self, system: System) -> Array:
        """Contact forces (n, 3) of the floor, which only pushes."""
        potential, unknowns = system.potential, system.unknowns
        n = unknowns.n_owned
        forces = np.zeros((n, 3))
        if unknowns.bounds is not None:
            on = (potential.x[:n] <= unknowns.bounds[0][:n]) & (potential.g[:n] > 0.0)
            forces[on] = potential.g[:n][on]
        return forces


def _moment(at: Array, forces: Array) -> Array:
    """Sum of the moments (3,) of forces (n, 3) at places (n, 3)."""
    (x, y, z), (a, b, c) = at.T, forces.T
    return np.array([y @ c - z @ b, z @ a - x @ c, x @ b - y @ a])


def _norm(vector: Array) -> float:
    return float(np.linalg.norm(vector))
