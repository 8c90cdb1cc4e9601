"""Load stepping, slack cables, the floor, options, and cables in awkward places."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    InputError,
    IsotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.minimizer import Minimizer, Outcome
from crms_fenicsx.potential import Potential
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


def test_movements_of_groups_add_up_and_need_hold_only_where_they_move(
    square: meshes.MembraneMesh,
) -> None:
    """Uniform biaxial stretch: left and right slide along y, front and back along x."""
    scene = Scene(square, MATERIAL)
    for sides, direction in ((("left", "right"), "x"), (("front", "back"), "y")):
        for side in sides:
            scene.fix(side, direction)
    scene.fix("boundary", "z")
    a, b = 0.02, 0.03
    Solver(scene).advance(move={"right": (100 * a, 0, 0), "back": (0, 100 * b, 0)}, steps=2)
    X = scene.V.tabulate_dof_coordinates()
    np.testing.assert_allclose(scene.u.x.array.reshape(-1, 3), X * (a, b, 0.0), atol=1e-9)
    e1, e2 = a + a**2 / 2, b + b**2 / 2
    D, nu = 24.0 / (1 - 0.25**2), 0.25
    energy = D / 2 * (e1**2 + e2**2 + 2 * nu * e1 * e2) * 100.0**2
    assert scene.energy == pytest.approx(energy, rel=1e-12)


def test_moving_a_cable_and_its_end_adds_up(square: meshes.MembraneMesh) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS)
    ends = cable.positions[[0, -1]].copy()
    Solver(scene).advance(move={cable: (0, 0, -1), cable.start: (0, 2, 0)}, steps=2)
    moved = cable.positions[[0, -1]] - ends
    np.testing.assert_allclose(moved, [(0, 2, -1), (0, 0, -1)], rtol=0, atol=1e-12)


def test_absurd_loads_end_in_a_convergence_error(square: meshes.MembraneMesh) -> None:
    scene = clamped(square)
    with pytest.raises(ConvergenceError, match="step 1"):
        Solver(scene, max_halvings=1).advance(pressure=1e300)
    assert scene.pressure == 0.0


@pytest.fixture
def options():
    """Set options of PETSc for one test."""
    database, names = PETSc.Options(), []

    def put(name: str, value: str) -> None:
        names.append(name)
        database[name] = value

    yield put
    for name in names:
        database.delValue(name)


@pytest.mark.parametrize(
    ("kind", "with_floor"), [("nls", False), ("nm", False), ("lmvm", True), ("cg", True)]
)
def test_minimisers_that_do_not_fit_are_refused(
    square: meshes.MembraneMesh, options: Any, kind: str, with_floor: bool
) -> None:
    scene = clamped(square)
    if with_floor:
        scene.floor(-1.0)
    options("odd_tao_type", kind)
    with pytest.raises(InputError, match=f"-odd_tao_type {kind} .*choose one of blmvm"):
        Solver(scene, prefix="odd_").advance(pressure=-0.01)
    assert scene.pressure == 0.0


@pytest.mark.parametrize("kind", ["lmvm", "bncg"])
def test_other_minimisers_find_the_same(
    square: meshes.MembraneMesh, options: Any, kind: str
) -> None:
    usual, other = clamped(square), clamped(square)
    Solver(usual).advance(pressure=0.01)
    options("own_tao_type", kind)
    solver = Solver(other, prefix="own_")
    solver.advance(pressure=0.01)
    assert solver.system.minimizer.tao.getType() == kind
    assert_same(state(other), state(usual), 1e-7)


@pytest.mark.parametrize("package", ["mumps", "superlu_dist"])
def test_the_factorisation_of_h0_is_an_option(
    square: meshes.MembraneMesh, options: Any, package: str
) -> None:
    usual, other = clamped(square), clamped(square)
    Solver(usual).advance(pressure=0.01)
    options("crms_h0_pc_factor_mat_solver_type", package)
    options("crms_h0_pc_type", "lu")
    solver = Solver(other)
    solver.advance(pressure=0.01)
    h0 = solver.system.minimizer.tao.getLMVMH0KSP().getPC()
    assert (h0.getType(), h0.getFactorSolverType()) == ("lu", package)
    assert_same(state(other), state(usual), 1e-9)


def test_options_of_another_prefix_do_not_count(square: meshes.MembraneMesh, options: Any) -> None:
    options("other_tao_type", "bncg")
    options("crms_tao_blmvm_mat_lmvm_hist_size", "7")
    solver = Solver(clamped(square))
    solver.advance(pressure=0.01)
    assert solver.system.minimizer.tao.getType() == "blmvm"
    assert PETSc.Options()["crms_tao_blmvm_mat_lmvm_hist_size"] == "7"  # not overwritten


def test_petsc_objects_are_freed(square: meshes.MembraneMesh) -> None:
    scene = clamped(square)
    solver = Solver(scene)
    solver.advance(pressure=0.01)
    old = solver.system.minimizer, solver.system.potential
    scene.lay_cable(CABLE, ACROSS, tension=10.0)
    solver.advance()
    new = solver.system.minimizer, solver.system.potential

    def objects(minimizer: Minimizer, potential: Potential) -> list[Any]:
        vectors = [minimizer._x, minimizer._g, minimizer._x0, potential.x_vector]
        return [minimizer.tao, minimizer.h0.matrix, potential.g_vector, *vectors]

    assert all(petsc.handle == 0 for petsc in objects(*old))
    assert all(petsc.handle != 0 for petsc in objects(*new))
    gone = weakref.ref(new[0])
    del new, solver
    gc.collect()
    assert gone() is None  # nothing keeps a dropped solver's objects
