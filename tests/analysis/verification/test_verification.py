"""The checks of a solved load step: each fails when what it looks at is wrong, and only then."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import PRESSURE, advanced, clamped, put, sheet
from grids import grid
from lined_roof import lined_roof, lined_scene
from mpi4py import MPI
from spoilt_states import checked, names

from crms_fenicsx import Cable, ConvergenceError, Friction, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.verification.verifier import Verifier

pytestmark = pytest.mark.usefixtures("comm")


def roped(comm: MPI.Intracomm, friction: float | Friction = 0.0) -> Solver:
    """An inflated square with a taut oblique cable, solved."""
    scene = sheet(comm, 7)
    scene.lay_cable(Cable(32000.0, friction=friction), [(0, 31), (100, 52)], L0=101.5)
    return advanced(Solver(scene), pressure=PRESSURE)


@pytest.mark.ranks
def test_sound_states_pass(comm: MPI.Intracomm) -> None:
    """With every kind of check, and a text that says so."""
    for friction in (0.0, 0.3, Friction(0.2, along=0.2)):
        step = roped(comm, friction).steps[-1]
        assert step.verification is not None and step.verification.passed
        assert str(step.verification).startswith("verified\n  values not finite ")
        work = step.verification["virtual work"]
        assert work.value < 0.05 * work.limit
    with pytest.raises(KeyError):
        step.verification["something else"]


def test_what_is_checked_stays_as_it_is(comm: MPI.Intracomm) -> None:
    """Bit by bit, and a run with it has the same answer as one without."""
    solver = roped(comm)
    scene, potential = solver.scene, solver.system.potential
    before = scene.u.x.array.copy(), potential.x.copy(), scene.cables[0].state.positions.copy()
    checked(solver)
    for a, b in zip(
        before, (scene.u.x.array, potential.x, scene.cables[0].state.positions), strict=True
    ):
        assert np.array_equal(a, b)
    results = []
    for verify in (True, False):
        scene = sheet(comm, 7)
        cable = scene.lay_cable(Cable(32000.0), [(0, 31), (100, 52)], L0=101.5)
        solver = advanced(Solver(scene, verify=verify), pressure=PRESSURE, steps=2)
        results.append([scene.energy, cable.tension, *cable.state.positions.ravel()])
        assert (solver.steps[-1].verification is not None) == verify
    if comm.size == 1:  # the order in which several add up forces is not always the same
        assert results[0] == results[1]
    np.testing.assert_allclose(results[0], results[1], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("Et", [1000.0, 2e-3])
def test_hardly_loaded_prestressed_sheets_are_verified(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, Et: float
) -> None:
    """However small the load is next to the prestress; a wrong energy is still found.

    The deflection is that of ``-2 laplace(w) = p``: a series, and in proportion to p.
    """
    odd = np.arange(1, 40, 2)
    i, j = np.meshgrid(odd, odd)
    signs = (-1.0) ** ((i + j) / 2 - 1) / (i * j * ((i / 6.0) ** 2 + (j / 4.0) ** 2))
    series, ratios = float(16 / np.pi**4 * signs.sum() / 2.0), []
    mesh = meshes.rectangle(comm, width=6.0, depth=4.0, size=0.5)
    material = IsotropicMembrane(E=Et, nu=0.3, thickness=1.0, prestress=2.0)
    for pressure in (1e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-2):
        scene = clamped(mesh, material)
        solver = Solver(scene, max_halvings=0)
        step = solver.advance(pressure=pressure)
        assert step.verification is not None and step.verification["virtual work"].limit < 2e-3
        w = comm.allreduce(float(scene.u.x.array[2::3].max(initial=0.0)), op=MPI.MAX)
        ratios.append(w / pressure)
        if pressure in (1e-9, 1e-6):
            own = next(t for t in solver.system.potential.terms if t.name == "pressure")
            energy = own.energy
            with monkeypatch.context() as patch:
                patch.setattr(own, "energy", lambda sums, energy=energy: 1.5 * energy(sums))
                assert names(checked(solver)) == {"virtual work"}
    assert ratios[0] == pytest.approx(series, rel=0.02)
    np.testing.assert_allclose(ratios[:-1], ratios[0], rtol=1e-6)
    assert ratios[-1] == pytest.approx(series, rel=0.02)


def test_a_soft_prestressed_sheet_at_rest_is_in_equilibrium(comm: MPI.Intracomm) -> None:
    """Its nodal forces are nothing but the rounding of the prestress."""
    material = IsotropicMembrane(E=1e-6, nu=0.3, thickness=1.0, prestress=2.0)
    scene = clamped(meshes.rectangle(comm, width=6.0, depth=4.0, size=0.5), material)
    assert Solver(scene, max_halvings=0).advance().outcome.evaluations < 5


@pytest.mark.parametrize("thin", [1e-2, 1e-5])
def test_slivers_raise_no_alarm(comm: MPI.Intracomm, thin: float) -> None:
    """A row of cells that the displacements of their neighbours would turn over."""
    lines = np.array([0.0, 20.0, 40.0, 40.0 + 20.0 * thin, 60.0, 80.0, 100.0])
    scene = clamped(meshes.from_arrays(comm, *grid(lines, lines[[0, 1, 2, 4, 5, 6]])))
    scene.lay_cable(Cable(32000.0), [(0, 31), (100, 52)], L0=101.0)
    solver = Solver(scene)
    step = solver.advance(pressure=PRESSURE)
    assert step.halvings == 0 and step.verification is not None and step.verification.passed


@pytest.mark.ranks
@pytest.mark.parametrize("term", ["membrane", "pressure", "cables"])
def test_an_energy_that_is_not_that_of_the_forces_is_found(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, term: str
) -> None:
    """By virtual work, and by nothing else: the forces are in balance."""
    solver = roped(comm)
    own = next(t for t in solver.system.potential.terms if t.name == term)
    energy = own.energy
    monkeypatch.setattr(own, "energy", lambda sums: 1.5 * energy(sums))
    assert names(checked(solver)) == {"virtual work"}


def test_what_is_not_verified_is_no_result(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scene stays at the last good state, and the error says what has failed."""
    scene = sheet(comm, 7)
    solver = Solver(scene, max_halvings=2)
    good = solver.advance(pressure=0.9 * PRESSURE).energy
    loads = Verifier._loads
    monkeypatch.setattr(Verifier, "_loads", lambda *system: 1.01 * loads(*system))
    with pytest.raises(
        ConvergenceError, match=r"not verified: unbalanced forces .* 2 times; 0\.00%"
    ):
        solver.advance(pressure=PRESSURE)
    assert scene.energy == good and len(solver.steps) == 1
    assert scene.pressure == 0.9 * PRESSURE


def test_wrong_forces_of_the_pressure_are_no_balance(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where energy and gradient agree: the loads are told by areas and normals."""
    solver = roped(comm)
    solver.scene.air.update(pressure=1.001 * solver.scene.pressure)
    assert {"unbalanced forces"} <= names(checked(solver))


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("tension", "tension against length"),
        ("length", "tension against length"),
        ("node", "nodes off their edges"),
        ("fraction", "nodes off their edges"),
        ("end", "ends of cables off their place"),
        ("compressed", "compression"),
        ("slack", "slack cable too short"),
    ],
)
def test_a_spoiled_cable_is_found(comm: MPI.Intracomm, what: str, name: str) -> None:
    """Each by the check that is meant for it."""
    solver = roped(comm)
    cable = solver.scene.cables[0]
    k = next(k for k, node in enumerate(cable.state.nodes) if node.kind == "fold")
    edge = cable.state.nodes[k].interpolation()[0]
    assert len(edge) == 2

    def spoil() -> None:
        if what == "tension":
            cable.update(tension=cable.tension * 1.001)
        elif what == "length":
            cable.update(length=cable.length * (1 + 1e-6))
        elif what == "node":
            put(cable, "positions", (k, 0), cable.state.positions[k, 0] + 1e-3)
        elif what == "fraction":
            put(cable, "fractions", k, cable.state.fractions[k] + 1e-4)
        elif what == "end":
            put(cable, "positions", 0, cable.state.positions[0] + 1e-4)
        elif what == "compressed":
            cable.update(tension=-1.0)
        else:
            cable.update(taut=False)

    found = names(checked(solver, spoil))
    assert name in found
    # A moved node or end also makes the cable longer, and a compressed one has not the law's force.
    follows = {"tension against length", "pull at the ends", "nodes off their edges"}
    assert found - {"pull on the membrane"} <= {name} | follows
    if what in ("fraction", "tension", "length"):
        assert found <= {name, "pull at the ends"}


def test_a_cable_that_pulls_or_dives_is_found(comm: MPI.Intracomm) -> None:
    """The membrane pushed in around a cable that touches it, or out around one that does not."""
    solver = roped(comm)
    cable = solver.scene.cables[0]
    inner = [k for k in range(2, len(cable.state.nodes) - 2) if not cable.state.lifted[k]]

    def pull() -> None:
        put(
            cable,
            "positions",
            (inner, 2),
            cable.state.positions[inner, 2] - 25.0 * np.sin(np.linspace(0, np.pi, len(inner))),
        )

    def dive() -> None:
        put(cable, "positions", (inner, 2), cable.state.positions[inner, 2] - 1.0)

    found = checked(solver, pull)
    assert "pull on the membrane" in names(found)
    assert not found["pull on the membrane"].binding
    solver = roped(comm)
    cable = solver.scene.cables[0]
    put(cable, "lifted", inner, True)
    solver.system.rebuild()
    solver.system.read_scene()
    assert "depth below the membrane" in names(checked(solver, dive))


@pytest.mark.parametrize(("on_lines", "slide"), [(True, True), (True, False), (False, False)])
@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_the_pull_at_vertices_that_hold_a_cable_is_the_force_there(
    comm: MPI.Intracomm, on_lines: bool, slide: bool
) -> None:
    """On a line of the mesh, and without sliding: no turn farther away counts."""
    scene, (cable, *_) = lined_scene(lined_roof(comm), on_lines, hold="outside")
    solver = advanced(Solver(scene, slide=slide), pressure=4.0)
    k = len(cable.state.nodes) // 2
    assert [cable.state.nodes[n].kind for n in (k - 1, k, k + 1)] == ["vertex"] * 3
    normal = scene.net.strip_shape().normal(cable.state.nodes[k].support)
    found = checked(
        solver, lambda: put(cable, "positions", k, cable.state.positions[k] - 0.1 * normal)
    )
    ways = cable.state.positions[[k - 1, k + 1]] - cable.state.positions[k]
    pull = float(np.sum(ways @ normal / np.linalg.norm(ways, axis=1)))
    assert pull > 0.05
    assert found["pull on the membrane"].value == pytest.approx(pull, rel=1e-9)


@pytest.mark.parametrize("friction", [0.9, Friction(0.0, along=0.2)])
def test_too_much_friction_is_found(comm: MPI.Intracomm, friction: float | Friction) -> None:
    """Coefficients that were higher in the solve than they are said to be."""
    scene = sheet(comm, 7)
    cable = scene.lay_cable(
        Cable(32000.0, friction=friction), [(-4, 31, 4), (104, 52, 4)], L0=110.0
    )
    solver = advanced(Solver(scene), pressure=PRESSURE)
    solver.advance(move={cable: (0.0, 8.0, 2.0)})
    assert not checked(solver).failed
    less = Friction(1e-6) if cable.state.law.axial is None else Friction(0.0, along=1e-6)

    def spoil() -> None:
        cable.update(cable=Cable(32000.0, friction=less))

    found = names(checked(solver, spoil))
    axial = "friction along beyond its bound"
    assert found == {axial if cable.state.law.axial is not None else "friction beyond its bound"}


@pytest.mark.ranks
def test_moved_supports_and_a_floor_run_through_are_found(comm: MPI.Intracomm) -> None:
    """What the loads prescribe, and the obstacle."""
    scene = sheet(comm, 7)
    scene.floor(-1.0)
    solver = advanced(Solver(scene), pressure=-1e-3)
    assert not checked(solver).failed

    def push() -> None:
        scene.u.x.array.reshape(-1, 3)[scene.held.all(axis=1)] += 1e-5

    assert "supports off their place" in names(checked(solver, push))

    def sink() -> None:
        scene.u.x.array.reshape(-1, 3)[~scene.held.all(axis=1), 2] -= 1.0

    solver = advanced(Solver(scene), pressure=-1e-3)
    assert "depth below the floor" in names(checked(solver, sink))


@pytest.mark.ranks
def test_what_is_not_finite_is_found(comm: MPI.Intracomm) -> None:
    """Not a number compares as nothing; it must not pass for that."""
    solver = roped(comm)

    def spoil() -> None:
        put(solver.scene.cables[0], "positions", 3, np.nan)
        solver.system.potential.x[: solver.system.unknowns.n_owned] = np.nan

    found = names(checked(solver, spoil))
    assert found == {"values not finite"}


def test_points_of_a_draped_slack_cable_are_where_they_say(comm: MPI.Intracomm) -> None:
    """Drawn taut over the changing membrane its points change places on their edges."""
    scene: Scene = sheet(comm, 6, "unstructured")
    cable = scene.lay_cable(Cable(32000.0), [(-10.0, 37.0, 2.5), (110.0, 60.0, 3.4)], L0=140.0)
    solver = Solver(scene, verify=False)
    for pressure in (0.0, 0.01, 1e-4, 5e-3):
        solver.advance(pressure=pressure)
        assert not cable.taut
        found = checked(solver)
        assert found["nodes off their edges"].value < 1e-9, pressure


def test_virtual_work_of_an_energy_that_is_not_smooth_is_tried_again(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It falls with the displacements; that of a force that is not balanced does not."""
    solver = roped(comm)
    force, sizes, power = solver.steps[-1].outcome.scale, [], 1

    def crooked(self: Verifier, system: object, shake: object, size: float) -> float:
        sizes.append(size)
        return 3e-3 * 2 * size * force * (size / sizes[0]) ** power

    monkeypatch.setattr(Verifier, "_difference", crooked)
    for power in (1, 0):
        sizes.clear()
        assert names(checked(solver)) == (set() if power else {"virtual work"})
        assert len(sizes) == 2 and sizes[1] < 0.1 * sizes[0]
