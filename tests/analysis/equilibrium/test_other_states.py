"""Of several equilibria of a wrinkled membrane the one of least energy is found, and it is told."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, SnapThroughWarning, Solver, meshes
from crms_fenicsx.analysis.steps import increment_solver


def cushion(comm: MPI.Intracomm, nx: int, ny: int, unit: float = 1.0) -> Solver:
    """A quarter of a rectangular cushion of two sheets; `unit` is that of length."""
    size = 0.4 * unit
    mesh = meshes.rectangle(comm, size, size * ny / nx, size / nx, structured=True)
    fabric = IsotropicMembrane(E=500e3 / unit**2, nu=0.3, thickness=0.6e-3 * unit)
    scene = Scene(mesh, fabric)
    scene.fix("left", "x")
    scene.fix("front", "y")
    scene.fix("right", "z")
    scene.fix("back", "z")
    return Solver(scene)


SCATTER = "scatter of the energy"


@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_the_least_energy_is_found_and_told(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, unit: float
) -> None:
    """At once and by way of four times the pressure."""
    found = []
    for searches, over in ((True, False), (True, True), (False, False)):
        if not searches:
            monkeypatch.setattr(increment_solver, "may_have_others", lambda system: False)
        solver = cushion(comm, 28, 20, unit)
        if over:
            solver.advance(pressure=16.0 / unit**2)
        verification = solver.advance(pressure=4.0 / unit**2).verification
        assert verification is not None
        found.append(solver.scene.energy / unit)
        (told,) = verification.doubtful or (None,)
        assert (told is not None) == searches
        if told is not None:
            assert told.name == SCATTER
            assert 1e-7 < told.value < 1e-4
            assert told.where.startswith("equilibria up to ")
            assert verification.passed
    assert found[0] == pytest.approx(found[1], rel=1e-8)
    assert found[0] < found[2] - 1e-6 * abs(found[2])


@pytest.mark.ranks
def test_one_equilibrium_is_left_as_it_is(comm: MPI.Intracomm) -> None:
    """Its energy is that without a search to the solver's tolerance."""
    solver = cushion(comm, 12, 12)
    step = solver.advance(pressure=4.0, steps=2)
    assert step.verification is not None
    assert step.verification[SCATTER].value < 1e-10
    assert not step.verification.doubtful
    with pytest.raises(KeyError):  # only at the loads asked for
        solver.steps[0].verification[SCATTER]  # type: ignore[index]


def test_it_is_not_looked_for_in_vain(comm: MPI.Intracomm) -> None:
    """In a taut sheet, or under a cable, whose friction and contacts depend on the history."""
    mesh = meshes.rectangle(comm, 1.0, 1.0, 0.25)
    for prestress, cable in ((1.0, False), (0.0, True)):
        scene = clamped(mesh, IsotropicMembrane(1e3, 0.3, 1.0, prestress=prestress))
        solver = Solver(scene)
        if cable:
            scene.lay_cable(Cable(EA=10.0), [(-0.4, 0.1, 0.0), (0.4, 0.1, 0.0)])
        step = solver.advance(pressure=0.1)
        assert step.verification is not None
        assert SCATTER not in [check.name for check in step.verification.checks]


def test_a_dome_does_not_snap_through_in_the_search(comm: MPI.Intracomm) -> None:
    """Under growing snow it is mostly wrinkled, and has less energy upside down from early on."""
    mesh = meshes.spherical_cap(comm, radius=10.0, height=5.0, size=2.0)
    scene = Scene(mesh, IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0))
    scene.fix("boundary")
    scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
    solver = Solver(scene)
    solver.advance(pressure=0.3)
    x, y, _ = scene.positions().T
    crown = int(np.argmin(np.hypot(x, y)))
    for snow in np.arange(0.05, 0.51, 0.05):
        with pytest.warns(SnapThroughWarning) if snow > 0.33 else nullcontext():
            solver.advance(load=snow)
        if scene.positions()[crown, 2] < 0.0:
            break
    assert snow == pytest.approx(0.35)
