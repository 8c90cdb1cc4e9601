"""Rain that fills the hollows of a roof: closed forms, limits, and what stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI
from scipy.special import j0

from crms_fenicsx import IsotropicMembrane, Solver, meshes
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.results.rain import NAME

RADIUS, WEIGHT = 3.0, 10.0


def drum(comm: MPI.Intracomm, k: float, size: float, load: float) -> Solver:
    """A membrane whose tension stays as it is, with k R as given, under a small load."""
    tension = WEIGHT * (RADIUS / k) ** 2
    soft = IsotropicMembrane(E=1e-6, nu=0.3, thickness=1.0, prestress=tension, wrinkling=False)
    scene = clamped(meshes.ellipse(comm, RADIUS, RADIUS, size), soft)
    scene.put_load((0.0, 0.0, -load), name="weight", per="plan")
    solver = Solver(scene)
    solver.advance(load=1.0)
    return solver


@pytest.mark.ranks
@pytest.mark.parametrize("k", [1.0, 1.5], ids=str)
def test_water_up_to_the_rim_of_a_drum(comm: MPI.Intracomm, k: float) -> None:
    """It sinks by g/w (1/J0(kR) - 1) under a load g and the water up to its rim."""
    load, errors = 0.01, []
    for size in (0.6, 0.3):
        solver = drum(comm, k, size, load)
        scene, u = solver.scene, solver.scene.u.x.array.copy()
        check = solver.check_ponding(rain=1.0)
        assert check.settled and not check.dry, check
        errors.append(check.depth / (load / WEIGHT * (1 / j0(k) - 1)) - 1)
        assert np.array_equal(scene.u.x.array, u)  # and all is as before
        assert scene.factors == {"weight": 1.0}
        assert solver.case == ""
    assert abs(errors[1]) < 0.01
    assert abs(errors[1]) < abs(errors[0])
    lift = solver.reactions("boundary").total[2]
    solver.restore(check.snapshot)
    water = solver.reactions("boundary").total[2] - lift
    assert water == pytest.approx(WEIGHT * check.volumes[-1], rel=1e-3)
    assert scene.factors[NAME] == 1.0
    assert check.hollows[0].volume == pytest.approx(check.volumes[-1], rel=1e-3)


@pytest.mark.ranks
def test_water_that_gathers(comm: MPI.Intracomm) -> None:
    """Beyond k R = 2.4048 the rain alone is the limit: what does not settle is told soon."""
    solver = drum(comm, 2.6, 0.6, 0.01)
    check = solver.check_ponding(rain=10.0)
    assert not check.settled and not check.dry
    assert check.verdict.startswith("under weight 1: water of the volume ")
    assert "gathers in 1 hollow, up to" in check.verdict
    assert len(check.volumes) < 60
    little = solver.check_ponding(rain=1e-5)
    assert little.settled and not little.dry
    assert "takes all the rain" in little.verdict and "designed for" in little.verdict
    volume = little.volumes[-1]
    for words in (
        f"volume {volume:.4g}, weight {WEIGHT * volume:.4g},",
        f"up to {little.depth:.3g} deep at {as_text(little.hollows[0].at)},",
    ):
        assert words in little.verdict
    plan = np.pi * RADIUS**2
    assert little.volumes[-1] == pytest.approx(1e-5 * plan, rel=0.02)


@pytest.mark.ranks
def test_a_roof_that_sheds_water(comm: MPI.Intracomm) -> None:
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
    scene = clamped(meshes.spherical_cap(comm, radius=5.0, height=1.0, size=1.0), foil)
    solver = Solver(scene)
    solver.advance(pressure=0.5)
    with solver.branch("storm"):
        check = solver.check_ponding(rain=0.1)
    assert (check.dry, check.settled, check.depth) == (True, True, 0.0)
    assert check.verdict == "storm, under pressure 0.5: no water stands on the roof"
    assert len(solver.steps) == 1
