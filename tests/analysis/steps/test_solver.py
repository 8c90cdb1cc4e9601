"""Load stepping, slack cables, the floor, options, and cables in awkward places."""

from __future__ import annotations

import gc
import warnings
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import FOIL, advanced, clamped
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    PathWarning,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.steps.loading import checked_target
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.laid_cable import polyline_length

CABLE = Cable(EA=32000.0)
ACROSS = [(0.0, 47.0), (100.0, 52.0)]
"""A path across the square through cells' interiors, its ends on the boundary."""


@pytest.fixture(scope="module")
def square(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    return meshes.rectangle(comm, 100.0, 100.0, 25.0, structured=True)


@pytest.fixture(scope="module")
def free_mesh(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    """The square without mesh lines that run through."""
    return meshes.rectangle(comm, 100.0, 100.0, 20.0)


def state(scene: Scene) -> list[np.ndarray]:
    """Displacements, positions of the cables, and what else a state has, as arrays."""
    scalars = [scene.pressure, *(x for c in scene.cables for x in (c.L0, c.length, c.tension))]
    return [
        scene.u.x.array.copy(),
        *(c.state.positions.copy() for c in scene.cables),
        np.array([*scalars, *scene.energies.values(), *(c.taut for c in scene.cables)]),
    ]


def assert_same(a: list[np.ndarray], b: list[np.ndarray], tolerance: float = 0.0) -> None:
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, rtol=tolerance, atol=100.0 * tolerance)


@pytest.mark.ranks
def test_a_failed_step_that_tightened_a_cable_can_be_followed_by_others(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS, L0=101.0)
    solver = advanced(Solver(scene, max_halvings=0), pressure=0.001)
    before = state(scene)
    assert not cable.taut

    real = Minimizer.solve

    def fails_with_a_taut_cable(self: Minimizer, *arguments: Any) -> Outcome:
        found = real(self, *arguments)
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


@pytest.mark.ranks
def test_an_interrupt_leaves_the_last_good_state(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS)
    solver = advanced(Solver(scene), pressure=0.005)
    before = state(scene)

    def interrupt(*arguments: object) -> None:
        scene.u.x.array[:] = 7.0
        raise Interrupted

    with monkeypatch.context() as patch:
        patch.setattr(EquilibriumSearch, "find", interrupt)
        with pytest.raises(Interrupted):
            solver.advance(pressure=0.01, move={cable: (0.0, 0.0, -5.0)})
    assert_same(state(scene), before)
    assert len(solver.steps) == 1


def test_movements_of_groups_add_up_and_need_hold_only_where_they_move(
    square: meshes.MembraneMesh,
) -> None:
    """Uniform biaxial stretch: left and right slide along y, front and back along x."""
    scene = Scene(square, FOIL)
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


@pytest.mark.ranks
@pytest.mark.parametrize("pressure", [0.0, 0.01])
def test_supports_that_move_alike_carry_all_with_them(
    free_mesh: meshes.MembraneMesh, pressure: float
) -> None:
    """Without a load nothing tells a slack membrane where to go; under load it is a state moved."""
    scene = clamped(free_mesh)
    cable = scene.lay_cable(CABLE, [(-10.0, 47.0, 0.0), (110.0, 52.0, 0.0)], L0=120.0)
    solver = advanced(Solver(scene), pressure=pressure)
    before = [scene.energies["membrane"], cable.tension, cable.state.positions, scene.positions()]
    before = [np.array(value) for value in before]
    way = np.array([3.0, -2.0, 40.0])
    done = solver.advance(move={"boundary": tuple(way), cable: tuple(way)}, steps=2)
    assert done.outcome.evaluations <= 3
    places = cable.state.positions - way, scene.positions() - way
    after = [scene.energies["membrane"], cable.tension, *places]
    for a, b in zip(after, before, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-7)


def test_a_part_of_the_supports_carries_nothing(free_mesh: meshes.MembraneMesh) -> None:
    scene = clamped(free_mesh)
    cable = scene.lay_cable(CABLE, [(-10.0, 47.0, 0.0), (110.0, 52.0, 0.0)], L0=120.0)
    up = (0.0, 0.0, 5.0)
    both: dict[object, tuple[float, float, float]] = {"boundary": up, cable: up}
    assert np.array_equal(checked_target(scene, None, both, {}).movements.rigid_translation, up)
    moves: list[dict[object, tuple[float, float, float]]] = [
        {"boundary": up}, {cable: up}, {"boundary": up, cable.start: up}, {}
    ]  # fmt: skip
    for move in moves:
        assert not checked_target(scene, None, move, {}).movements.rigid_translation.any()
    scene.floor(-1.0)
    assert not checked_target(scene, None, both, {}).movements.rigid_translation.any()


def test_moving_a_cable_and_its_end_adds_up(square: meshes.MembraneMesh) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS)
    ends = cable.state.positions[[0, -1]].copy()
    Solver(scene).advance(move={cable: (0, 0, -1), cable.start: (0, 2, 0)}, steps=2)
    moved = cable.state.positions[[0, -1]] - ends
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
    solver = advanced(Solver(other, prefix="own_"), pressure=0.01)
    assert solver.system.minimizer.tao.getType() == kind
    assert_same(state(other), state(usual), 1e-7)


@pytest.mark.ranks
@pytest.mark.parametrize("package", ["mumps", "superlu_dist"])
def test_the_factorisation_of_h0_is_an_option(
    square: meshes.MembraneMesh, options: Any, package: str
) -> None:
    usual, other = clamped(square), clamped(square)
    Solver(usual).advance(pressure=0.01)
    options("crms_h0_pc_factor_mat_solver_type", package)
    options("crms_h0_pc_type", "lu")
    solver = advanced(Solver(other), pressure=0.01)
    h0 = solver.system.minimizer.h0.pc
    assert (h0.getType(), h0.getFactorSolverType()) == ("lu", package)
    assert_same(state(other), state(usual), 1e-9)


def test_a_load_step_begins_with_the_h0_that_is_there(
    square: meshes.MembraneMesh, folder: Path
) -> None:
    """Not after it has been saved, as one that goes on from there has none, nor on a floor, which
    it may have left. It is the same equilibrium: to the tolerance in the end."""
    kept, saved, floored = clamped(square), clamped(square), clamped(square)
    floored.floor(-1.0)
    solvers = [Solver(scene) for scene in (kept, saved, floored)]
    steps = []
    for pressure in (0.01, 0.0101):
        steps = [solver.advance(pressure=pressure) for solver in solvers]
        solvers[1].save(folder / "point")
    assert [step.outcome.factorizations for step in steps] == [0, 1, 1]
    assert_same(state(saved), state(kept), 1e-9)
    assert_same(state(floored), state(kept), 1e-9)


def test_options_of_another_prefix_do_not_count(square: meshes.MembraneMesh, options: Any) -> None:
    options("other_tao_type", "bncg")
    options("crms_tao_blmvm_mat_lmvm_hist_size", "7")
    solver = advanced(Solver(clamped(square)), pressure=0.01)
    assert solver.system.minimizer.tao.getType() == "blmvm"
    assert PETSc.Options()["crms_tao_blmvm_mat_lmvm_hist_size"] == "7"  # not overwritten


@pytest.mark.ranks
def test_petsc_objects_are_freed(square: meshes.MembraneMesh) -> None:
    scene = clamped(square)
    solver = advanced(Solver(scene), pressure=0.01)
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


@pytest.mark.ranks
def test_a_failed_increment_is_halved_and_grows_again(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pressure may grow by no more than 0.3 of the load at once, and not at all near its half."""
    direct = clamped(square)
    Solver(direct).advance(pressure=0.01)

    scene, tried, good = clamped(square), [], [0.0]
    real_find, real_commit = EquilibriumSearch.find, System.commit

    def find(self: EquilibriumSearch, h0_prestress: tuple[float, ...]) -> Outcome:
        share = scene.pressure / 0.01
        tried.append(share)
        outcome = real_find(self, h0_prestress)
        if share - good[-1] > 0.3:
            scene.u.x.array[:] += 1.0  # a state that is none
            return Outcome(False, "refused", 1.0, 0.1, 1, 1, 1)
        return outcome

    def commit(self: System) -> None:
        good.append(scene.pressure / 0.01)
        real_commit(self)

    monkeypatch.setattr(EquilibriumSearch, "find", find)
    monkeypatch.setattr(System, "commit", commit)
    solver = Solver(scene)
    last = solver.advance(pressure=0.01)
    assert tried == pytest.approx([1, 0.5, 0.25, 0.75, 0.5, 1, 0.75, 1])
    assert good == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert [step.halvings for step in solver.steps] == [2, 1, 1, 0]
    assert last is solver.steps[-1] and [s.number for s in solver.steps] == [1, 2, 3, 4]
    assert_same(state(scene), state(direct), 1e-8)
    # grown back to whole increments: five steps of 0.2 of the load need no halving
    before = len(tried)
    solver.advance(pressure=0.02, steps=5)
    assert len(tried) - before == 5


@pytest.mark.ranks
@pytest.mark.parametrize("max_halvings", [0, 2])
def test_giving_up_leaves_the_last_good_state(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch, max_halvings: int
) -> None:
    scene = clamped(square)
    solver = Solver(scene, max_halvings=max_halvings)
    cable = scene.lay_cable(CABLE, ACROSS)
    solver.advance(pressure=0.004, steps=2)
    before = state(scene)

    tried: list[float] = []
    real = EquilibriumSearch.find

    def find(self: EquilibriumSearch, h0_prestress: tuple[float, ...]) -> Outcome:
        tried.append(scene.pressure)
        real(self, h0_prestress)
        return Outcome(False, "stuck", 0.25, 0.125, 1, 1, 1)

    with monkeypatch.context() as patch:
        patch.setattr(EquilibriumSearch, "find", find)
        with pytest.raises(ConvergenceError) as error:
            solver.advance(pressure=0.008, L0={cable: 99.0})
    assert tried == pytest.approx([0.004 + 0.004 * 0.5**k for k in range(max_halvings + 1)])
    for words in ("step 3", "stuck", "0.25", "0.125", f"halved {max_halvings} times", "more steps"):
        assert words in str(error.value)
    assert_same(state(scene), before)
    assert len(solver.steps) == 2
    solver.advance(pressure=0.008, L0={cable: 99.0})  # and it can go on from there
    other = clamped(square)
    twin = other.lay_cable(CABLE, ACROSS)
    Solver(other).advance(pressure=0.008, L0={twin: 99.0})
    assert_same(state(scene), state(other), 1e-7)


def test_the_result_does_not_depend_on_steps_or_calls(free_mesh: meshes.MembraneMesh) -> None:
    """Total laws have no memory: neither the number of steps nor the order of loads counts."""
    results = []
    for calls in (
        [("both", 1)],
        [("both", 4)],
        [("pressure", 2), ("move", 3)],
        [("half", 1), ("both", 2)],
    ):
        scene = clamped(free_mesh)
        solver = Solver(scene, rtol=1e-11)
        cable = scene.lay_cable(CABLE, ACROSS)
        for load, steps in calls:
            up, down = scene.pressure, {cable: (0.0, 0.0, -5.0)}
            up = {"half": 0.005, "move": scene.pressure}.get(load, 0.01)
            moves = load in ("both", "move")
            solver.advance(pressure=up, move=down if moves else None, steps=steps)
        assert len(solver.steps) == sum(steps for _, steps in calls)
        assert cable.state.positions[0, 2] == pytest.approx(-5.0, abs=1e-12)
        results.append(state(scene))
    for other in results[1:]:
        assert_same(other, results[0], 1e-8)


def test_loads_continue_from_call_to_call(square: meshes.MembraneMesh) -> None:
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, ACROSS)
    solver = Solver(scene)
    start, end = cable.state.positions[0].copy(), cable.state.positions[-1].copy()
    seen = []
    real = System.commit
    with pytest.MonkeyPatch.context() as patch:

        def commit(self: System) -> None:
            seen.append((scene.pressure, cable.L0, cable.state.positions[0, 2]))
            real(self)

        patch.setattr(System, "commit", commit)
        L0 = cable.L0
        solver.advance(pressure=0.01, steps=2)
        solver.advance(L0={cable: 0.99 * L0}, steps=2)
        solver.advance(move={cable.start: (0.0, 0.0, -2.0)}, steps=2)
        solver.advance(pressure=0.004)
    expected = [
        (0.005, L0, 0.0),
        (0.01, L0, 0.0),
        (0.01, 0.995 * L0, 0.0),
        (0.01, 0.99 * L0, 0.0),
        (0.01, 0.99 * L0, -1.0),
        (0.01, 0.99 * L0, -2.0),
        (0.004, 0.99 * L0, -2.0),
    ]
    np.testing.assert_allclose(seen, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(cable.state.positions[0], start - [0, 0, 2.0], atol=1e-12)
    np.testing.assert_array_equal(cable.state.positions[-1], end)


def test_slack_and_taut_again(free_mesh: meshes.MembraneMesh) -> None:
    """A slack cable does nothing at all, and a taut one comes back to the same state."""
    scene, bare = clamped(free_mesh), clamped(free_mesh)
    Solver(bare).advance(pressure=0.01)
    solver = Solver(scene)
    cable = scene.lay_cable(CABLE, ACROSS, L0=106.0)
    taut = []
    for L0 in (106.0, 100.5, 106.0, 100.5, 106.0):
        solver.advance(pressure=0.01, L0={cable: L0})
        if L0 == 106.0:
            assert not cable.taut and cable.tension == 0.0
            assert scene.energy == pytest.approx(bare.energy, rel=1e-14)
            assert scene.energies["membrane"] == pytest.approx(bare.energies["membrane"], rel=1e-8)
        else:
            assert cable.taut and cable.tension > 20.0
            taut.append(state(scene))
    assert_same(taut[1], taut[0], 1e-8)


def pressure_forces(scene: Scene) -> np.ndarray:
    """Nodal forces p n A / 3 of the current cells on this rank's own vertices, one by one."""
    x, cells = scene.positions(), scene.V.dofmap.list
    force = fem.Function(scene.V)
    nodal = force.x.array.reshape(-1, 3)
    for a, b, c in cells[: scene.mesh.mesh.topology.index_map(2).size_local]:
        nodal[[a, b, c]] += scene.pressure * np.cross(x[b] - x[a], x[c] - x[a]) / 6
    force.x.scatter_reverse(la.InsertMode.add)
    return nodal[: scene.V.dofmap.index_map.size_local]


def test_the_floor_carries_what_is_pressed_on_it(free_mesh: meshes.MembraneMesh) -> None:
    scene = clamped(free_mesh)
    scene.floor(-4.0)
    solver = Solver(scene)
    for pressure in (-0.01, -0.02):
        step = solver.advance(pressure=pressure)
        assert step.halvings == 0 and step.outcome.iterations < 60
        system = solver.system
        n = system.unknowns.n_vertices
        system.potential.sum_up()
        internal = np.zeros_like(system.potential.x)  # of the membrane alone
        system.membrane.energy.add_gradient(system.potential.x, np.zeros(1), internal)
        system.potential.g[:] = internal
        system.unknowns.add_ghosts(system.potential.g_vector)
        carried = system.potential.g[:n] - pressure_forces(scene)  # by floor and rim
        z, rim = scene.positions()[:n, 2], scene.held[:n].all(axis=1)
        down = ~rim & (z <= -4.0 + 1e-9)
        total = scene.comm.allreduce
        assert total(int((z < -4.0 - 1e-9).sum())) == 0 and total(int(down.sum())) > 3
        scale = abs(pressure) * 100.0**2
        assert (np.abs(carried[~rim & ~down]) < 1e-8 * scale).all()
        assert (np.abs(carried[down, :2]) < 1e-8 * scale).all()  # without friction
        assert (carried[down, 2] > -1e-8 * scale).all()  # the floor only pushes
        # the pressure on the plan goes to the floor and to the rim
        assert total(carried[:, 2].sum()) == pytest.approx(scale, rel=1e-9)
        assert total(carried[down, 2].sum()) > 0.1 * scale


@pytest.mark.ranks
def test_a_floor_under_a_cable(free_mesh: meshes.MembraneMesh) -> None:
    scene = clamped(free_mesh)
    scene.floor(-4.0)
    solver = Solver(scene)
    cable = scene.lay_cable(CABLE, ACROSS, L0=100.9, hold="sleeve")  # the membrane hangs in it
    step = solver.advance(pressure=-0.02)
    assert step.halvings == 0 and cable.tension > 1.0
    assert cable.state.positions[:, 2].min() == pytest.approx(-4.0, abs=1e-9)
    lowest = scene.comm.allreduce(float(scene.positions()[:, 2].min()), op=MPI.MIN)
    assert lowest == pytest.approx(-4.0, abs=1e-9)


def test_two_materials_equal_their_own_strips(comm) -> None:
    """Two strips in series: the same force in both, so strains as the moduli say."""
    mesh = meshes.rectangle(MPI.COMM_SELF, 4.0, 1.0, 0.5, structured=True).mesh
    x, cells = mesh.geometry.x, geometry_dofmap(mesh)
    right = np.flatnonzero(x[cells].mean(axis=1)[:, 0] > 2.0)
    left = np.setdiff1d(np.arange(len(cells)), right)
    ends = {
        "left end": np.flatnonzero(x[:, 0] == 0.0),
        "right end": np.flatnonzero(x[:, 0] == 4.0),
        "corner": np.flatnonzero((x[:, 0] == 0.0) & (x[:, 1] == 0.0)),
    }
    both = meshes.from_arrays(
        comm, x, cells, parts={"left": left, "right": right}, point_groups=ends
    )
    soft = IsotropicMembrane(E=100.0, nu=0.0, thickness=0.1)
    stiff = OrthotropicMembrane(E1=400.0, E2=100.0, G12=50.0, nu21=0.0, thickness=0.1)
    scene = Scene(both, {"right": stiff, "left": soft})
    for group in ("left end", "right end"):
        scene.fix(group, "xz")
    scene.fix("corner", "y")
    scene.fix(lambda x: np.full(x.shape[1], True), "z")
    Solver(scene).advance(move={"right end": (0.04, 0.0, 0.0)})
    x = np.round(scene.V.tabulate_dof_coordinates()[:, 0], 9)
    u = scene.u.x.array.reshape(-1, 3)[:, 0]
    middle = u[x == 2.0]
    a = middle[0] / 2 if len(middle) else 0.0
    a = scene.comm.allreduce(a, op=MPI.MAX)
    b = 0.02 - a  # the stretches; first Piola stress E e (1 + a) is the same in both
    assert 10 * (a + a**2 / 2) * (1 + a) == pytest.approx(40 * (b + b**2 / 2) * (1 + b), rel=1e-9)
    np.testing.assert_allclose(u, np.where(x < 2, a * x, 2 * a + b * (x - 2)), atol=1e-10)


def test_a_prestressed_sheet_stands_under_its_own_stress(free_mesh: meshes.MembraneMesh) -> None:
    """Uniform prestress is in equilibrium; moved out of plane the sheet pulls back."""
    material = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=0.5)
    scene = clamped(free_mesh, material)
    solver = Solver(scene)
    assert solver.advance().outcome.iterations == 0
    assert np.abs(scene.u.x.array).max() < 1e-12 and abs(scene.energy) < 1e-9
    solver.advance(pressure=1e-4)  # small: a membrane of constant tension, p a^2 / S times .07367
    centre = scene.comm.allreduce(float(scene.u.x.array.max()), op=MPI.MAX)
    assert centre == pytest.approx(0.07367 * 1e-4 * 100.0**2 / 0.5, rel=0.05)


def test_a_cable_laid_with_a_tension_has_it(free_mesh: meshes.MembraneMesh) -> None:
    """On a flat sheet that is held everywhere it keeps it; its unstressed length follows."""
    scene = clamped(free_mesh)
    cable = scene.lay_cable(CABLE, ACROSS, tension=50.0)
    length = float(np.hypot(100.0, 5.0))
    assert cable.taut and cable.tension == pytest.approx(50.0)
    assert cable.length == pytest.approx(length, rel=1e-12)
    assert cable.L0 == pytest.approx(length / (1 + 50.0 / CABLE.EA), rel=1e-12)
    step = Solver(scene).advance()
    assert cable.tension == pytest.approx(50.0, rel=1e-9)
    assert step.energies["cables"] == pytest.approx(50.0**2 * cable.L0 / (2 * CABLE.EA), rel=1e-9)


DIAGONAL = [(0.0, 0.0), (100.0, 100.0)]
AWKWARD = {
    "along a mesh line": ([(0, 50), (100, 50)], "avvvvva"),
    "along a diagonal": (DIAGONAL, "avvvvva"),
    "against the diagonals": ([(0, 100), (100, 0)], "avfvfvfvfva"),
    "vertices and edges mixed": ([(0, 25), (100, 75)], "avfvfva"),
    "from a mesh line off into cells": ([(0, 50), (50, 50), (100, 31)], None),
    "next to the boundary": ([(0, 1), (100, 6)], None),
    "on the boundary": ([(0, 0), (100, 0)], "avvvvva"),
    "near a mesh line": ([(0, 50.6), (100, 50.6)], None),
    "anchors off both sides": ([(-20, 47, -2), (120, 52, -2)], None),
    "one anchor off": ([(-20, 47, -2), (100, 52, 0)], None),
    "tied inside cells": ([(22, 46), (71, 52)], "tfffft"),
    "tied in one cell": ([(57, 53), (68, 59)], "tt"),
    "tied next to a vertex": ([(50.6, 50.3), (90, 53)], None),
}


@pytest.mark.ranks
@pytest.mark.parametrize("case", list(AWKWARD))
def test_cables_in_awkward_places(square: meshes.MembraneMesh, case: str) -> None:
    """Laid on the flat sheet, inflated and tightened: equilibrium in few evaluations."""
    path, kinds = AWKWARD[case]
    scene = clamped(square)
    cable = scene.lay_cable(CABLE, path)
    found = "".join(node.kind[0] for node in cable.state.nodes)
    assert kinds is None or found == kinds
    solver = Solver(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        solver.advance(pressure=0.01)
        step = solver.advance(L0={cable: 0.998 * cable.L0})
    assert all(s.halvings == 0 and s.outcome.evaluations < 400 for s in solver.steps)
    assert cable.taut and cable.tension > 0.0
    L0 = 0.998 * polyline_length(reference_positions(scene, path))
    assert cable.L0 == pytest.approx(L0, rel=1e-9)
    assert cable.tension == pytest.approx(CABLE.EA * (cable.length / cable.L0 - 1), rel=1e-9)
    assert cable.length == pytest.approx(polyline_length(cable.state.positions), rel=1e-6)
    work = cable.tension * (cable.length - cable.L0) / 2
    assert step.energies["cables"] == pytest.approx(work, rel=1e-9)


def reference_positions(scene: Scene, path: Any) -> np.ndarray:
    """The route in space, with anchors straight to where they meet the boundary."""
    route = np.array(path, dtype=float)
    if route.shape[1] == 2:
        route = np.column_stack([route, np.zeros(len(route))])
        return route
    inner = route.copy()
    direction = route[-1] - route[0]
    for k, x in ((0, 0.0), (-1, 100.0)):
        share = (x - route[0, 0]) / direction[0]
        inner[k] = route[0] + share * direction
        inner[k, 2] = 0.0
    rows = [route[0], inner[0], inner[-1], route[-1]]
    return np.array(rows)


def test_a_cable_between_free_edges(free_mesh: meshes.MembraneMesh) -> None:
    """On a prestressed sheet that is held at two sides a cable draws the free ones together."""
    scene = Scene(free_mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=0.5))
    scene.fix("left")
    scene.fix("right")
    tie = scene.lay_cable(CABLE, [(31.0, 0.0), (53.0, 100.0)], tension=40.0)
    assert [tie.state.nodes[k].kind for k in (0, -1)] == ["tied", "tied"]
    sag = Solver(scene).advance()
    assert sag.halvings == 0
    # both ends moved inwards, on the edges that they are tied to
    assert tie.state.positions[0, 1] > 0.1 and tie.state.positions[-1, 1] < 99.9


@pytest.mark.parametrize("gap", [8.0, 1.0, 0.1])
def test_two_cables_side_by_side_act_as_one(free_mesh: meshes.MembraneMesh, gap: float) -> None:
    """They share edges and cells; as the gap closes they are one of twice the stiffness."""
    scene, single = clamped(free_mesh), clamped(free_mesh)
    pair = [
        scene.lay_cable(CABLE, [(0.0, 47.0 + dy), (100.0, 50.0 + dy)]) for dy in (-gap / 2, gap / 2)
    ]
    one = single.lay_cable(Cable(2 * CABLE.EA), [(0.0, 47.0), (100.0, 50.0)])
    solver, other = Solver(scene), Solver(single)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        solver.advance(pressure=0.01)
        other.advance(pressure=0.01)
    assert solver.steps[0].halvings == 0
    tolerance = 0.02 * gap
    assert sum(c.tension for c in pair) == pytest.approx(one.tension, rel=tolerance)
    assert scene.energy == pytest.approx(single.energy, rel=tolerance)


def test_a_cable_that_runs_into_a_vertex_is_reported(square: meshes.MembraneMesh) -> None:
    """The route has a corner above two vertices; pulled straight it would pass below them."""
    scene = clamped(square)
    solver = advanced(Solver(scene, slide=False), pressure=0.01)
    cable = scene.lay_cable(CABLE, [(0.0, 51.0), (50.0, 52.0), (100.0, 31.0)])
    taut = cable.L0
    solver.advance(L0={cable: 1.01 * taut})
    assert cable.blocked == []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        solver.advance(L0={cable: 0.98 * taut}, steps=3)
    vertices = [(25.0, 50.0), (50.0, 50.0)]
    near = [
        np.linalg.norm(cable.state.positions[k, :2] - v) for k in cable.blocked for v in vertices
    ]
    assert cable.blocked and np.sum(np.array(near) < 2.0) == len(cable.blocked)
    for k in cable.blocked:
        assert cable.state.nodes[k].kind == "fold"
        assert min(cable.state.fractions[k], 1 - cable.state.fractions[k]) < 5e-3
    messages = [str(w.message) for w in caught if w.category is PathWarning]
    if scene.comm.rank == 0:
        last = messages[-1]
        for words in (
            "step 5",
            "'cable 1'",
            f"{len(cable.blocked)} mesh vertices",
            "blocked",
        ):
            assert words in last
        assert all(w.filename == __file__ for w in caught)
    else:
        assert messages == []


@pytest.mark.parametrize("via", [20.0, 52.0, 66.0])
def test_a_cable_that_slides_forgets_the_way_it_was_laid(
    square: meshes.MembraneMesh, via: float
) -> None:
    """It passes vertices to where it is straight on the membrane, and no warning is given.

    Laid the straight way it need not; held in the cells of these ways it is much tighter.
    """
    found = []
    for y, slide in ((41.0, True), (via, True), (via, False)):
        scene = clamped(square)
        solver = advanced(Solver(scene, slide=slide), pressure=0.01)
        cable = scene.lay_cable(CABLE, [(0.0, 51.0), (50.0, y), (100.0, 31.0)], L0=100.5)
        with warnings.catch_warnings():
            if not slide:
                warnings.simplefilter("ignore", PathWarning)
            solver.advance()
        found.append((cable.tension, scene.energy, cable.blocked))
    straight, slid, blocked = found
    assert slid[:2] == pytest.approx(straight[:2], rel=1e-8)
    assert not slid[2]
    assert blocked[2] and blocked[1] > slid[1] + 100.0 and blocked[0] > 1.2 * slid[0]


@pytest.mark.parametrize("share", [1e-8, 1e-4])
def test_small_loads_are_solved_as_exactly_as_large_ones(square, share: float) -> None:
    """A prestressed sheet that hardly moves is a linear membrane: its energy goes with p^2 / S."""

    def scaled(share: float) -> float:
        stress, pressure = share * 24.0, 1e-2 * share**1.5 * 0.24
        material = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=stress)
        scene = clamped(square, material)
        Solver(scene).advance(pressure=pressure)
        return scene.energy * stress / pressure**2

    assert scaled(share) == pytest.approx(scaled(1.0), rel=1e-5)


@pytest.mark.parametrize("EA, L0", [(1e7, 10.0), (1e7, 1.0), (32000.0, 0.01)])
def test_cable_with_far_more_tension_than_load(square, EA: float, L0: float) -> None:
    """What rounding leaves of its tension is more than the tolerance of the load's forces."""
    scene = clamped(square)
    cable = scene.lay_cable(Cable(EA), ACROSS, L0=L0)
    step = Solver(scene).advance(pressure=0.01)
    assert step.halvings == 0
    length = float(np.linalg.norm(np.subtract(*ACROSS)))
    assert cable.tension == pytest.approx(EA * (length / L0 - 1), rel=1e-5)


def test_loads_that_cancel_on_their_way_are_none(square) -> None:
    """0.01 - 2/3 0.015 is not zero in floating point, and would be a load for what is slack."""
    scene = clamped(square)
    scene.floor(0.0)
    solver = advanced(Solver(scene), pressure=0.01)
    solver.advance(pressure=-0.005, steps=3)
    pressures = [row["pressure"] for row in solver.history]
    assert pressures[2] == 0.0
    assert abs(scene.positions()[:, 2]).max(initial=0.0) < 1e-9


@pytest.mark.ranks
def test_what_is_not_finite_ends_a_solve(
    square: meshes.MembraneMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also an energy that is not, with forces that are; the step is halved, and then given up."""
    scene = clamped(square)
    solver = Solver(scene, max_halvings=1)
    good = solver.advance(pressure=0.005).energy
    own = Potential.evaluate_terms
    monkeypatch.setattr(Potential, "evaluate_terms", lambda self: (np.nan, own(self)[1]))
    with pytest.raises(ConvergenceError, match=r"energy or gradient not finite.* halved 1 times"):
        solver.advance(pressure=0.01)
    assert scene.energy == good
    monkeypatch.undo()
    assert solver.advance(pressure=0.01).outcome.converged


def test_a_step_in_which_two_states_take_turns_is_refused_by_the_cables_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Solves under turning pressure that return to a state before end, and halvings do, too."""
    scene = Scene(meshes.rectangle(MPI.COMM_SELF, 4.0, 4.0, 2.0), FOIL, pressure="lagged")
    scene.fix("left")
    for name, y in (("lower", 1.3), ("upper", 2.7)):
        scene.lay_cable(CABLE, [(0.0, y), (4.0, y)], name=name)
    calls = 0

    def turning(search: EquilibriumSearch, h0_prestress: tuple[float, ...]) -> Outcome:
        nonlocal calls
        calls += 1
        for cable, tensions in zip(search.scene.cables, [(3.0, 5.0), (7.0, 7.0)], strict=True):
            cable.update(tension=tensions[calls % 2])
        return Outcome(True, "", 0.0, 1.0, 1, 1, 0)

    monkeypatch.setattr(EquilibriumSearch, "find", turning)
    with pytest.raises(ConvergenceError, match=r"lower: .* alternate; lay them farther") as e:
        Solver(scene).advance(pressure=1.0)
    assert "upper" not in str(e.value)
    assert "halved 3 times" in str(e.value)
    assert calls == 4 * 4
