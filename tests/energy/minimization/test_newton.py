"""Newton's method: when it takes the second derivatives, and relaxation after a full step; and the
paper's plain quasi-Newton method (2.7), by the option ``-crms_h0 false``."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
from cabled_square import advanced, clamped, sheet, square
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx import Cable, Solver
from crms_fenicsx.energy.minimization.newton import NewtonMethod
from crms_fenicsx.energy.minimization.strategy import STRATEGY


class Relaxation:
    """Relaxes to the given energies, one after another."""

    has_points = True

    def __init__(self, energies: list[float]) -> None:
        self.energies, self.count = energies, 0

    def relax_points(self, tolerance: float) -> bool:
        """Take the next energy, if there is one."""
        self.count += 1
        return self.count <= len(self.energies)


def method(energies: list[float] | None = None) -> tuple[NewtonMethod, Relaxation]:
    """A method on such energies, and what relaxes."""
    relaxation = Relaxation(energies or [])
    potential = SimpleNamespace(energy=lambda: relaxation.energies[relaxation.count - 1])
    arguments = cast(tuple[Any, Any, Any], (potential, SimpleNamespace(), relaxation))
    return NewtonMethod(*arguments, STRATEGY), relaxation


def test_second_derivatives_come_early_where_steps_make_little_progress() -> None:
    """And only until such a step fails or is shortened."""
    own, _ = method()
    found = []
    for residual in (0.15, 0.08, 0.07, 0.06, 0.05):  # the third and the fifth after a slow step
        assert own.is_quick(residual, 1.0)
        found.append(own.wants_exact(residual, 1.0))
    assert found == [False, False, True, False, True]
    own._tries_early = False
    assert not any(own.wants_exact(residual, 1.0) for residual in (0.049, 0.048, 0.047))
    assert own.wants_exact(0.9 * STRATEGY.exact, 1.0)


def test_second_derivatives_come_back_where_h0_stalls() -> None:
    """After two failures they are given up, and tried again when H0 does no better."""
    own, _ = method()
    assert own.is_quick(0.1, 1.0)
    own._failed = 2
    assert not own.is_quick(0.1, 1.0)
    assert not own.wants_exact(1e-3, 1.0)
    own.take_over(0.1, 0.1, 1.0)
    for count in range(STRATEGY.newton_stages):
        assert not own.trusts_exact, count
        own.check_progress(0.09)
    assert own.trusts_exact
    assert own.wants_exact(1e-3, 1.0)
    own._failed += 1  # one failure suffices now
    assert not own.is_quick(0.1, 1.0)
    assert not own.trusts_exact


@pytest.mark.parametrize(
    ("part", "energies", "count", "change"),
    [
        (1.0, [5.0, 2.0, -1.0, -9.0], 3, -1.0),  # until the energy has fallen
        (1.0, [5.0, 4.9, 1.0], 2, 4.9),  # until that gains less than a tenth
        (1.0, [0.8**k for k in range(20)], STRATEGY.full_rounds, 0.8 ** (STRATEGY.full_rounds - 1)),
        (1.0, [5.0], 2, 5.0),  # until the points are balanced
        (0.5, [5.0, 2.0, -1.0], 1, 5.0),
    ],
)
def test_points_are_relaxed_on_after_full_steps(
    part: float, energies: list[float], count: int, change: float
) -> None:
    """As long as that lowers the energy towards what the step must reach."""
    own, relaxation = method(energies)
    assert own._relax(10.0, 0.0, -0.5, part) == pytest.approx(change)
    assert relaxation.count == count


@pytest.mark.parametrize("crossing", [False, True])
def test_outcomes_count_newton_steps(
    comm: MPI.Intracomm, crossing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over all minimisations of a load step, among its iterations."""
    made, step = [], NewtonMethod.step

    def counted(own: NewtonMethod, *arguments: Any) -> bool:
        made.append(own)
        return step(own, *arguments)

    monkeypatch.setattr(NewtonMethod, "step", counted)
    scene = sheet(comm, 10)
    if crossing:
        scene.lay_cable(Cable(EA=32000.0), [(0.0, 34.0), (100.0, 34.0)], L0=100.0)
        scene.lay_cable(Cable(EA=32000.0), [(43.0, 0.0), (43.0, 100.0)], L0=100.0)
    outcome = Solver(scene).advance(pressure=0.01).outcome
    assert outcome.newton_steps == len(made)
    assert (0 < outcome.newton_steps < outcome.iterations) == crossing
    assert (outcome.solves > 1) == crossing


@pytest.mark.ranks
def test_cables_along_mesh_lines_need_no_newton_steps(comm: MPI.Intracomm) -> None:
    """They have no points to relax: quasi-Newton stages take fewer factorisations."""
    outcomes = []
    for y, x in ((34.0, 43.0), (30.0, 40.0)):  # across the cells, and along their edges
        scene = sheet(comm, 10)
        scene.lay_cable(Cable(EA=32000.0), [(0.0, y), (100.0, y)], L0=100.0)
        scene.lay_cable(Cable(EA=32000.0), [(x, 0.0), (x, 100.0)], L0=100.0)
        solver = advanced(Solver(scene, slide=False), pressure=0.01)
        outcomes.append(solver.advance(pressure=0.03).outcome)
    folded, rows = outcomes
    assert folded.newton_steps > 0 == rows.newton_steps == rows.local_steps
    assert rows.factorizations < folded.factorizations


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
