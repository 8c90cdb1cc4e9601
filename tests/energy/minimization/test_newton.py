"""Newton's method where stages are slow, and the paper's plain quasi-Newton method (2.7), by the
option ``-crms_h0 false``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, clamped, square
from mpi4py import MPI
from petsc4py import PETSc
from term_scene import cable_square, displaced

from crms_fenicsx import Cable, Solver
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.strategy import STRATEGY


@pytest.mark.ranks
def test_newton_steps_lead_to_the_same_state(comm: MPI.Intracomm) -> None:
    """They count among the iterations."""
    strategies = STRATEGY, replace(STRATEGY, patience=1, stubborn=0.0, stage_lengths=(3,))
    outcomes, states = [], []
    for strategy in strategies:
        system = cable_square(comm)
        potential, n = system.potential, system.unknowns.n_owned
        shake = displaced(system.unknowns, 0.3, stretch=1.03)
        potential.x[:n] += shake * ~system.unknowns.held[:n]
        potential.place()
        minimizer = Minimizer(potential, strategy=strategy)
        outcomes.append(minimizer.solve())
        states.append(potential.x[:n].copy())
        minimizer.destroy()
    assert all(outcome.converged for outcome in outcomes)
    assert 0 == outcomes[0].newton_steps < outcomes[1].newton_steps < outcomes[1].iterations
    np.testing.assert_allclose(states[1], states[0], atol=1e-6)


@pytest.fixture
def plain() -> Iterator[str]:
    """The prefix of solvers without H0."""
    options = PETSc.Options()
    options["plain_h0"] = "false"
    yield "plain_"
    options.delValue("plain_h0")


def tightened(comm: MPI.Intracomm, prefix: str, rtol: float = 1e-9) -> tuple[Solver, float]:
    """Model 2 on coarse cells, and the tension of its cable."""
    scene = clamped(square(comm, 7))
    solver = advanced(Solver(scene, prefix=prefix, rtol=rtol), pressure=0.01)
    cable = scene.lay_cable(Cable(32000.0), [(-80.0, 50.0, 0.0), (180.0, 50.0, 0.0)])
    solver.advance(move={cable: (0.0, 0.0, -15.0)}, steps=2)
    return solver, cable.tension


@pytest.mark.ranks
def test_same_state_without_h0(comm: MPI.Intracomm, plain: str) -> None:
    """To the tolerance at which it ends; by BLMVM alone."""
    solver, tension = tightened(comm, plain)
    with_h0, expected = tightened(comm, "crms_")
    assert tension == pytest.approx(expected, rel=1e-5)
    assert solver.scene.energy == pytest.approx(with_h0.scene.energy, rel=1e-6)
    for step in solver.steps:
        outcome = step.outcome
        assert outcome.factorizations == outcome.newton_steps == outcome.local_steps == 0
        assert outcome.residual <= outcome.tolerance == pytest.approx(1e-6 * outcome.scale)
        assert step.verification is not None and step.verification.passed
    effort = sum(step.outcome.evaluations for step in solver.steps)
    assert effort > 5 * sum(step.outcome.evaluations for step in with_h0.steps)


def test_a_larger_tolerance_counts(comm: MPI.Intracomm, plain: str) -> None:
    solver, _ = tightened(comm, plain, rtol=1e-4)
    outcome = solver.steps[-1].outcome
    assert outcome.tolerance == pytest.approx(1e-4 * outcome.scale)
