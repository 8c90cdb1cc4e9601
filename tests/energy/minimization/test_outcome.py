"""What the potential knows of its state; when a minimisation is given up for want of progress, and
what counts as free of stress."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI
from term_scene import cable_square, displaced

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.contribution import unloaded_scales
from crms_fenicsx.energy.minimization.outcome import (
    NO_STRAIN,
    Stalling,
    is_unstressed,
)
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import STRATEGY


def stage_of_end(residuals: np.ndarray, energies: np.ndarray, per_stage: int = 1) -> float:
    """Stage at which the solve is given up; infinite if it is not."""
    stalling = Stalling(STRATEGY)
    for k, (residual, energy) in enumerate(zip(residuals, energies, strict=True)):
        if stalling.ends(k / per_stage, residual, energy):
            return k / per_stage
    return np.inf


K = np.arange(8 * STRATEGY.stall)


def test_residual_and_energy_that_stand_still_end_a_solve() -> None:
    """After a number of stages, however the residual jumps, also by Newton's method."""
    residuals = 1e-3 * (1.5 + np.sin(7.0 * K)) / 1.5
    energies = np.full(len(K), 40.0)
    assert 0 < stage_of_end(residuals, energies) - STRATEGY.stall <= 10
    assert stage_of_end(residuals, energies, 8) == np.inf  # these are fewer stages


def test_slow_fall_of_the_residual_is_progress() -> None:
    """By half in fewer stages than `STRATEGY.stall`, not in more."""
    energies = np.full(len(K), -3.0)
    assert stage_of_end(0.5 ** (K / (0.8 * STRATEGY.stall)), energies) == np.inf
    assert stage_of_end(0.5 ** (K / (1.5 * STRATEGY.stall)), energies) < 2 * STRATEGY.stall


def test_fall_of_the_energy_is_progress() -> None:
    """Relative to it, of whichever sign, also where it fades, and not by less."""
    residuals = np.full(len(K), 1e-3)
    for energy in (40.0, -40.0):
        for rate, ends in ((2.0, False), (0.5, True)):
            energies = energy - abs(energy) * rate * STRATEGY.least_fall / STRATEGY.stall * K
            assert (stage_of_end(residuals, energies) < np.inf) == ends
    assert stage_of_end(residuals, 1e-9 * 0.9**K) == np.inf


E, SIZE = 700.0, 30.0
"""Stiffness (force per length) and size of a strip as long as wide."""


@pytest.mark.parametrize("strain, expected", [(0.5, True), (0.99, True), (1.01, False), (9, False)])
def test_strip_in_uniform_tension(strain: float, expected: bool) -> None:
    """Its force and its energy reach the limit at the same strain."""
    strain *= NO_STRAIN
    forces, energy = E * strain * SIZE, 0.5 * E * (strain * SIZE) ** 2
    assert is_unstressed(forces, energy, E * SIZE, SIZE) == expected
    assert is_unstressed(0.0, energy, E * SIZE, SIZE) == expected
    assert is_unstressed(forces, 0.0, E * SIZE, SIZE) == expected


def test_prestress_is_stress_without_energy() -> None:
    """The energy is zero where the membrane is laid, and falls below where it may shrink."""
    for energy in (0.0, -1.0):
        assert not is_unstressed(1e-3 * E * SIZE, energy, E * SIZE, SIZE)
        assert is_unstressed(0.0, energy, E * SIZE, SIZE)


def test_weakest_part_sets_the_limit(comm: MPI.Intracomm) -> None:
    """A strain that a weak cable or bar feels is nothing to the membrane."""
    scene = sheet(comm, 4)
    tolerance, membrane = unloaded_scales(scene)
    assert 0.0 < tolerance < NO_STRAIN * membrane
    EA = 1e-5 * membrane
    scene.lay_cable(Cable(EA), [(0.0, 50.0), (100.0, 50.0)], tension=1e-9)
    assert unloaded_scales(scene)[1] == EA
    scene.add_bar(Bar(0.5 * EA), (0.0, 0.0, 9.0), (9.0, 0.0, 9.0))
    assert unloaded_scales(scene)[1] == 0.5 * EA


def test_loads_set_the_scale(comm: MPI.Intracomm) -> None:
    """Under the smallest pressure nothing but a state without any forces counts."""
    scene = sheet(comm, 4)
    Solver(scene).advance(pressure=1e-9)
    tolerance, stiffness = unloaded_scales(scene)
    assert tolerance == stiffness == 0.0
    assert not is_unstressed(1e-300, 0.0, stiffness, SIZE)


@pytest.mark.parametrize("strain", [3e-8, 1e-6])
def test_small_strain_is_solved(comm: MPI.Intracomm, strain: float) -> None:
    """Above the limit, without loads: a strip is in uniform tension."""
    L, H, stiffness = 2.0, 1.0, 1000.0
    mesh = meshes.rectangle(comm, L, H, H / 4)
    scene = Scene(mesh, IsotropicMembrane(E=stiffness, nu=0.0, thickness=1.0))
    scene.fix("left")
    scene.fix("right")
    scene.fix(lambda x: x[2] < 1.0, "z")
    solver = advanced(Solver(scene), move={"right": (L * strain, 0.0, 0.0)})
    assert scene.energy == pytest.approx(0.5 * stiffness * strain**2 * L * H, rel=1e-5, abs=0.0)
    force = solver.reactions("right").total[0]
    assert force == pytest.approx(stiffness * strain * H, rel=1e-5, abs=0.0)


def shaken(comm: MPI.Intracomm) -> tuple[Potential, list]:
    """A potential of a membrane with cables, and two states as the minimiser asks for them."""
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    states = []
    for size in (0.5, 0.6):
        X = potential.x_vector.duplicate()
        X.array[:] = (displaced(system.unknowns, size) * ~system.unknowns.held[:n]).ravel()
        states.append(X)
    return potential, states


@pytest.mark.ranks
def test_the_state_that_was_evaluated_last_is_not_evaluated_again(comm: MPI.Intracomm) -> None:
    potential, (a, b) = shaken(comm)
    G = a.duplicate()
    energy = potential.objective_gradient(None, a, G)
    gradient = G.array.copy()
    count = potential.evaluations
    potential.place(a)
    again, _ = potential.evaluate_terms()
    potential.free_gradient(G)
    assert potential.evaluations == count
    np.testing.assert_allclose(again, energy, rtol=1e-13)
    np.testing.assert_allclose(G.array, gradient, rtol=1e-12, atol=1e-12 * np.abs(gradient).max())
    # another state is, also if it was evaluated before the last one
    potential.objective_gradient(None, b, G)
    potential.place(a)
    np.testing.assert_allclose(potential.evaluate_terms()[0], energy, rtol=1e-13)
    assert potential.evaluations == count + 2


@pytest.mark.ranks
def test_a_state_placed_by_hand_is_evaluated(comm: MPI.Intracomm) -> None:
    potential, (a, b) = shaken(comm)
    G = a.duplicate()
    first = potential.objective_gradient(None, a, G)
    other = potential.objective_gradient(None, b, G)
    assert abs(other - first) > 1e-6 * abs(first)
    potential.x_vector.array[:] = a.array
    potential.place()
    assert abs(potential.evaluate_terms()[0] - first) < 1e-12 * abs(first)
    potential.place(b)  # asked for before, but not there any more
    assert abs(potential.evaluate_terms()[0] - other) < 1e-12 * abs(other)
