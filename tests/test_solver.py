"""Load stepping, slack cables, the floor, options, and cables in awkward places."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    IsotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.minimizer import Minimizer, Outcome
from crms_fenicsx.system import System

MATERIAL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
CABLE = Cable(EA=32000.0)
ACROSS = [(0.0, 47.0), (100.0, 52.0)]
"""A path across the square through cells' interiors, its ends on the boundary."""


@pytest.fixture(scope="module")
def square() -> meshes.MembraneMesh:
    return meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 25.0, structured=True)


@pytest.fixture(scope="module")
def free_mesh() -> meshes.MembraneMesh:
    """The square without mesh lines that run through."""
    return meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 20.0)


def clamped(mesh: meshes.MembraneMesh, **settings: Any) -> Scene:
    scene = Scene(mesh, MATERIAL, **settings)
    scene.fix("boundary")
    return scene


def state(scene: Scene) -> list[np.ndarray]:
    """Displacements, positions of the cables, and what else a state has, as arrays."""
    scalars = [scene.pressure, *(x for c in scene.cables for x in (c.L0, c.length, c.tension))]
    return [
        scene.u.x.array.copy(),
        *(c.positions.copy() for c in scene.cables),
        np.array([*scalars, *scene.energies.values(), *(c.taut for c in scene.cables)]),
    ]


def assert_same(a: list[np.ndarray], b: list[np.ndarray], tolerance: float = 0.0) -> None:
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, rtol=tolerance, atol=100.0 * tolerance)


def test_a_failed_step_that_tightened_a_cable_can_be_followed_by_others(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS, L0=101.0)
    solver = Solver(scene, max_halvings=0)
    solver.advance(pressure=0.001)
    before = state(scene)
    assert not cable.taut

    real = Minimizer.solve

    def fails_with_a_taut_cable(self: Minimizer, h0_prestress: tuple[float, ...]) -> Outcome:
        found = real(self, h0_prestress)
        return Outcome(False, "refused", 1.0, 0.1, 1, 1, 1) if cable.taut else found

    with monkeypatch.context() as patch:
        patch.setattr(Minimizer, "solve", fails_with_a_taut_cable)
        with pytest.raises(ConvergenceError, match="refused"):
            solver.advance(L0={cable: 98.0})
    assert_same(state(scene), before)
    solver.advance(pressure=0.0012)
    assert not cable.taut
    solver.advance(L0={cable: 98.0})
    assert cable.taut and cable.tension > 0


class Interrupted(BaseException):
    """Not an Exception, as a keyboard interrupt."""


def test_an_interrupt_leaves_the_last_good_state(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS)
    solver = Solver(scene)
    solver.advance(pressure=0.005)
    before = state(scene)

    def interrupt(*arguments: object) -> None:
        scene.u.x.array[:] = 7.0
        raise Interrupted

    with monkeypatch.context() as patch:
        patch.setattr(System, "solve", interrupt)
        with pytest.raises(Interrupted):
            solver.advance(pressure=0.01, move={cable: (0.0, 0.0, -5.0)})
    assert_same(state(scene), before)
    assert len(solver.steps) == 1
