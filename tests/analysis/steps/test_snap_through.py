"""Snap-throughs are told, between which loads they are, and nothing that is stable is."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, Scene, SnapThroughWarning, Solver, meshes
from crms_fenicsx.analysis.steps.increment_solver import Increment, IncrementSolver

RADIUS, HEIGHT, STIFFNESS, NU, PRESSURE = 20.0, 8.0, 800.0, 0.3, 1.5


def dome(comm: MPI.Intracomm, size: float, unit: float = 1.0, folder: Path | None = None) -> Solver:
    """An air dome with snow, inflated; `unit` is that of length."""
    mesh = meshes.spherical_cap(comm, RADIUS * unit, HEIGHT * unit, size * unit)
    fabric = IsotropicMembrane(E=STIFFNESS / unit, nu=NU, thickness=unit)
    scene = clamped(mesh, fabric)
    solver = advanced(Solver(scene, results=folder), pressure=PRESSURE / unit)
    scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
    return solver


def limit() -> float:
    """Snow at which the crown of the dome goes slack.

    The part of the dome inside of a material circle of the radius r, and of r0 when the snow was
    put on it, carries by its rim  2 pi r N sin(slope) = pi (p r^2 - s r0^2).  At the crown, where
    r / r0 is the ratio of stretches, N vanishes where p l^2 = s l0^2 with l = 1:  s = p / l0^2.
    Under the pressure alone N = p R / 2 and N = E t / (1 - nu) (l0^2 - 1) / 2. A computation with
    conical elements, of the whole dome, ends at 0.9629 p; this formula gives 0.9633 p.
    """
    curvature = (RADIUS**2 + HEIGHT**2) / (2 * HEIGHT)
    return PRESSURE / (1 + PRESSURE * curvature * (1 - NU) / STIFFNESS)


@pytest.mark.ranks
def test_a_dome_turns_inside_out(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """At the load of the closed form within 1 %, in one step that goes far beyond it."""
    solver = dome(comm, 4.0, folder=comm.bcast(tmp_path))
    scene = solver.scene
    solver.advance(load=0.9 * limit())
    calm = solver.snapshot()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SnapThroughWarning)
        step = solver.advance(load=1.3 * limit())
    told = comm.allreduce(sum(issubclass(one.category, SnapThroughWarning) for one in caught))
    assert told == 1
    (found,) = step.warnings
    low, high = found.loads["snow"]
    assert high - low <= 0.005 * high
    assert 0.99 * limit() < low < high < 1.01 * limit()
    assert "of 'snow' the equilibrium becomes unstable" in found.text
    assert "scene.floor(0)" in found.text
    assert scene.warnings == (found,)
    assert solver.summary().warnings == (found,)
    assert "snap-through" in repr(solver.summary())
    assert solver.history["warnings"][-1] == str(found)
    assert str(step.verification).startswith("equilibrium, but snap-through")
    solver.report(comm.bcast(tmp_path) / "report.html")
    if comm.rank == 0:
        page = (tmp_path / "report.html").read_text()
        assert '<div class="verdict failed">' in page
        assert "Current state: snap-through: between" in page
        assert "Current state: the roof has turned inside out" in page
        assert "Verified" not in page
    more = solver.advance(load=1.4 * limit())  # calm, but on the other side
    assert more.warnings == ()
    assert scene.warnings == (found,)
    solver.save(comm.bcast(tmp_path) / "point")
    solver.restore(calm)
    assert scene.warnings == ()
    other = Solver(Scene(scene.mesh, scene.materials[0]))
    other.load(comm.bcast(tmp_path) / "point")
    assert other.scene.warnings == (found,)
    assert other.steps[-2].warnings == (found,)


def test_it_lies_on_a_floor(comm: MPI.Intracomm) -> None:
    """In other units, and without the advice to put one."""
    solver = dome(comm, 4.0, unit=1e3)
    solver.scene.floor(0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SnapThroughWarning)
        step = solver.advance(load=1.1 * limit() / 1e3)
    (found,) = step.warnings
    assert "floor" not in found.text
    low, high = found.loads["snow"]
    assert 0.99 * limit() < 1e3 * low < 1e3 * high < 1.02 * limit()


@pytest.mark.parametrize("steps", [1, 3])
def test_a_flat_sheet_goes_through_stable_states(comm: MPI.Intracomm, steps: int) -> None:
    """From above its rim to below it, and where its flat state is next to unstable."""
    scene = sheet(
        comm, 8, material=IsotropicMembrane(E=1e3, nu=0.3, thickness=1.0, prestress=1.0), side=10.0
    )
    solver = advanced(Solver(scene), pressure=0.5)
    solver.advance(pressure=-0.5, steps=steps)
    solver.advance(pressure=0.0)
    scene.put_pond(10.0, level=1e-3)
    solver.advance(load=1.0, steps=steps)
    assert scene.ponds[0].volume > 10.0
    assert all(step.warnings == () for step in solver.steps)


def test_states_are_those_that_there_were_without_looking(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for bent in (True, False):
        if not bent:
            monkeypatch.setattr(
                "crms_fenicsx.analysis.equilibrium.system.is_convex_from", lambda *_: True
            )
        solver = dome(comm, 5.0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SnapThroughWarning)
            solver.advance(load=1.1 * limit())
        assert len(solver.steps[-1].warnings) == bent
        found.append((solver.scene.energy, len(solver.steps), solver.scene.u.x.array.copy()))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-9)  # MUMPS is not the same twice
    assert found[0][1] == found[1][1]
    np.testing.assert_allclose(found[0][2], found[1][2], atol=1e-5)


def test_the_interval_is_narrowed_past_a_load_without_equilibrium(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The solver fails half way, where the limit load is not."""
    solve, failed = IncrementSolver.solve, []

    def fails_half_way(self: IncrementSolver, *given: Any) -> Increment:
        found = solve(self, *given)
        if given[4] == 0.5:
            failed.append(given)
            return replace(found, outcome=replace(found.outcome, converged=False))
        return found

    monkeypatch.setattr(IncrementSolver, "solve", fails_half_way)
    solver = dome(comm, 5.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SnapThroughWarning)
        step = solver.advance(load=1.2 * limit())
    assert len(failed) == 1
    low, high = step.warnings[0].loads["snow"]
    assert high - low <= 0.005 * high
    assert 0.98 * limit() < low < high < 1.02 * limit()
