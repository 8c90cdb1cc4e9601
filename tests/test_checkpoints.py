"""Checkpoints: a run that goes on from one is the run that has not ended."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    Friction,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)

COMM = MPI.COMM_WORLD
FABRIC = OrthotropicMembrane(E1=300.0, E2=200.0, G12=40.0, nu21=0.2, thickness=0.08, warp=(1, 0, 0))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(COMM.bcast(str(tmp_path)))


def sheet(comm: MPI.Intracomm, n: int = 8, material: object = FABRIC, **options: object) -> Solver:
    """A flat square, nothing held yet."""
    mesh = meshes.rectangle(comm, 100.0, 100.0, size=100 / n, structured=True)
    return Solver(Scene(mesh, material, **options), rtol=1e-11)


def first_half(solver: Solver) -> None:
    """An inflated fabric with a floor and snow; three cables that cross, one of them rough, one
    smooth, one tied to the fabric at one end and drawn up at the other, so that it lifts off."""
    scene = solver.scene
    scene.fix("boundary")
    scene.floor(-1.0)
    scene.put_load((0.0, 0.0, -1e-3))
    solver.advance(pressure=0.01, load=1.0)
    rough = Friction(0.3, static=0.4, along=0.2)
    scene.lay_cable(Cable(9000.0, friction=rough), [(0, 33), (100, 41)], tension=15.0, name="rough")
    smooth = [(30.0, -20.0, 0.0), (42.0, 120.0, 0.0)]
    scene.lay_cable(Cable(9000.0), smooth, tension=15.0, level=1, name="smooth")
    scene.lay_cable(Cable(9000.0), [(70, 66), (0, 71)], tension=1.0, name="tied")
    solver.advance(move={scene.cable("tied").end: (-4.0, 0.0, 9.0)}, pressure=0.012)


def second_half(solver: Solver) -> None:
    scene = solver.scene
    rough, smooth, tied = (scene.cable(name) for name in ("rough", "smooth", "tied"))
    solver.advance(move={smooth: (9.0, 0.0, -6.0), rough: (0.0, 0.0, -5.0)}, load=2.0, steps=2)
    solver.advance(L0={tied: 0.99 * tied.L0}, pressure=0.01)


def same_run(one: Solver, other: Solver, rtol: float, counts: bool = True) -> None:
    """Both have come to the same, in all their steps."""
    assert one.history.columns == other.history.columns
    work = {"iterations", "evaluations", "factorizations", "solves", "flips"}
    for column in one.history.columns:
        if column in work and counts:
            np.testing.assert_array_equal(one.history[column], other.history[column], column)
        elif column not in work | {"seconds", "residual", "passes"}:
            scale = np.nanmax(np.abs(one.history[column]))
            np.testing.assert_allclose(
                other.history[column], one.history[column], rtol, rtol * scale, err_msg=column
            )
    assert [step.number for step in one.steps] == [step.number for step in other.steps]
    for a, b in zip(one.scene.cables, other.scene.cables, strict=True):
        assert [node.kind for node in a.nodes] == [node.kind for node in b.nodes]
        np.testing.assert_allclose(b.positions, a.positions, atol=100 * rtol * 100)
        np.testing.assert_array_equal(b.lifted, a.lifted)


def test_a_run_goes_on_as_if_it_had_not_ended(folder: Path) -> None:
    solver = sheet(COMM)
    first_half(solver)
    scene = solver.scene
    assert scene.crossings and scene.cable("tied").lifted.any()
    assert scene.cable("rough").grip is not None is not scene.cable("rough").axial
    solver.save(folder / "point")
    again = sheet(COMM)
    again.load(folder / "point")
    np.testing.assert_array_equal(again.scene.u.x.array, scene.u.x.array)
    assert again.scene.energies == scene.energies
    for name in ("true_forces", "folded"):
        here, there = (getattr(one.results(), name) for one in (solver, again))
        np.testing.assert_allclose(there, here, rtol=1e-12, atol=1e-12)
    second_half(solver)
    second_half(again)
    same_run(solver, again, 1e-10)
