"""Friction on membranes that give way: what sticks, slides, crosses, and goes back and forth."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cabled_square import PRESSURE, advanced, clamped, place, rotated_lattice, sheet
from friction_scene import friction_dome

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    Friction,
    FrictionWarning,
    IsotropicMembrane,
    LaidCable,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium import search
from crms_fenicsx.cabling.paths.path_change import PathChange
from crms_fenicsx.cabling.paths.sliding_with_friction import straighten_kinks
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.model.tolerances import BUDGET

MODEL_3 = OrthotropicMembrane(
    E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0, warp=(0.0, 1.0, 0.0)
)


def anchored(comm, friction, n: int = 9, kind: str = "unstructured"):
    """A cable across an inflated square, to anchors beside it and below."""
    scene = sheet(comm, n, kind)
    solver = advanced(Solver(scene), pressure=PRESSURE)
    cable = scene.lay_cable(
        Cable(EA=32000.0, friction=friction), [(-10.0, 30.0, -5.0), (110.0, 30.0, -5.0)]
    )
    solver.advance(L0={cable: 0.99 * cable.length})
    return scene, solver, cable


def model_3(comm, friction, structured: bool) -> tuple[Solver, LaidCable]:
    """The paper's, before its first load step."""
    scene = Scene(meshes.rectangle(comm, 100.0, 100.0, 10.0, structured=structured), MODEL_3)
    scene.fix("front")
    scene.fix("back")
    path = [(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)]
    return Solver(scene), scene.lay_cable(Cable(EA=47638.0, friction=friction), path)


@pytest.fixture(scope="module")
def dragged(comm) -> Callable[..., Any]:
    """The paper's model 3: down by 10 cm, then sideways by 10 cm. Each choice is solved once."""

    @functools.cache
    def solve(friction, steps: int = 2, structured: bool = False):
        solver, cable = model_3(comm, friction, structured)
        solver.advance(move={cable: (0.0, 0.0, -10.0)}, steps=2)
        solver.advance(move={cable: (0.0, 10.0, 0.0)}, steps=steps)
        return solver, cable

    return solve


def test_closed_cycle(comm) -> None:
    """There and back by 6 cm: the work of the anchors is what friction has dissipated.

    The work is summed by the trapezoidal rule over steps in which the cable comes loose, and the
    dissipation with each step's last forces: both are of first order in the steps.
    """
    errors = []
    for steps, ways in ((4, (6.0, -6.0, 6.0, -6.0)), (12, (6.0, -6.0))):
        scene, solver, cable = anchored(comm, 0.2, n=7)
        energy, work = scene.energy, 0.0
        force = cable.start.reaction + cable.end.reaction
        dissipated = [0.0]
        ends = []
        for way in ways:
            for _ in range(steps):
                solver.advance(move={cable: (0.0, way / steps, 0.0)})
                new = cable.start.reaction + cable.end.reaction
                work += float((force + new)[1]) / 2 * way / steps
                force = new
                dissipated.append(scene.dissipated)
            ends.append((cable.tension, scene.energy))
        assert np.all(np.diff(dissipated) >= 0.0)
        assert dissipated[-1] > 20.0 * len(ways)
        gained = scene.energy - energy
        errors.append(abs(gained + scene.dissipated - work) / scene.dissipated)
        # it does not come back to where it was, but a second round is as the first
        assert gained > 1.0
        np.testing.assert_allclose(ends[-1], ends[1], rtol=2e-4)
    assert errors[0] < 0.1 and errors[1] < errors[0] / 2


def test_closed_cycle_without_friction(comm) -> None:
    """The equilibrium depends on the loads alone."""
    scene, solver, cable = anchored(comm, 0.0)
    before = scene.energy, cable.tension
    for way in (6.0, -6.0):
        solver.advance(move={cable: (0.0, way, 0.0)}, steps=2)
    np.testing.assert_allclose((scene.energy, cable.tension), before, rtol=1e-8)
    assert scene.dissipated == 0.0
    assert "dissipated" not in solver.history.columns


def test_steps(dragged) -> None:
    """Model 3 hardly depends on the number of steps."""
    values = []
    for steps in (2, 4, 8):
        solver, cable = dragged(0.7, steps=steps)
        values.append((cable.tension, place(cable, 50.0)[1], solver.scene.dissipated))
        assert np.all(np.diff(np.nan_to_num(solver.history["dissipated"])) >= 0.0)
    tension, y, dissipated = np.array(values).T
    assert np.ptp(tension) < 1e-3 * tension[-1]
    assert np.ptp(y) < 6e-3  # of a way of 5.9
    assert np.ptp(dissipated) < 0.02 * dissipated[-1]
    assert abs(dissipated[2] - dissipated[1]) < abs(dissipated[1] - dissipated[0])


def test_slip_tolerance_has_a_plateau(dragged) -> None:
    tensions, ways = [], []
    for tolerance in (1e-5, 1e-3, 1e-2):
        _, cable = dragged(Friction(0.7, tolerance=tolerance))
        tensions.append(cable.tension)
        ways.append(place(cable, 50.0)[1])
    assert np.ptp(tensions) < 1e-3 * tensions[0]
    assert np.ptp(ways) < 0.02


def test_friction_holds_back(dragged) -> None:
    """The more friction, the less the cable slides and the tighter it gets; a lot holds it."""
    ways, tensions = [], []
    for mu in (0.0, 0.3, 0.7, 5.0):
        _, cable = dragged(mu)
        fabric = cable.state.reference_positions[np.isfinite(cable.state.reference_positions[:, 0])]
        order = np.argsort(fabric[:, 0])
        ways.append(float(np.interp(50.0, *fabric[order, :2].T)))
        tensions.append(cable.tension)
    assert ways[0] > ways[1] > ways[2] > ways[3]
    assert ways[0] == pytest.approx(59.8, abs=0.1)
    assert ways[3] == pytest.approx(50.0, abs=0.01)
    assert tensions == sorted(tensions)


def test_cable_along_mesh_lines_leaves_them(dragged) -> None:
    """It begins on the mesh's vertices, and slides as one that lies anywhere."""
    _, along = dragged(0.7, structured=True)
    _, anywhere = dragged(0.7)
    assert along.tension == pytest.approx(anywhere.tension, rel=0.01)
    assert place(along, 50.0)[1] == pytest.approx(place(anywhere, 50.0)[1], abs=0.1)


@pytest.mark.parametrize(
    "kinds",
    [
        ("structured", "rotated"),
        pytest.param(("structured", "unstructured", "rotated"), marks=pytest.mark.slow),
    ],
    ids=["two", "three"],
)
def test_meshes_agree(comm, kinds: tuple[str, ...]) -> None:
    """Slid by more than a cell over different kinds of mesh."""
    found = []
    for kind in kinds:
        scene, solver, cable = anchored(comm, 0.3, n=13, kind=kind)
        solver.advance(move={cable: (0.0, 10.0, 0.0)}, steps=2)
        found.append((cable.tension, *place(cable, 50.0)[1:], scene.dissipated))
    tension, y, z, dissipated = np.array(found).T
    assert np.ptp(tension) < 0.03 * tension[0]
    assert np.ptp(y) < 0.1
    assert np.ptp(z) < 0.05
    assert np.ptp(dissipated) < 0.04 * dissipated[0]


def test_vanishing_friction(comm) -> None:
    """With next to no friction the cable is where one without is."""
    results = []
    for mu in (0.0, 1e-6):
        scene, solver, cable = anchored(comm, mu)
        solver.advance(move={cable: (0.0, 6.0, 0.0)}, steps=3)
        results.append((cable.tension, place(cable, 50.0)[1], scene.energy))
    np.testing.assert_allclose(results[1], results[0], rtol=1e-5)


@pytest.mark.ranks
def test_idle_steps(comm) -> None:
    """Nothing moves where nothing changes."""
    scene, solver, cable = anchored(comm, 0.2)
    solver.advance(move={cable: (0.0, 6.0, 0.0)}, steps=3)
    before, tension, dissipated = cable.state.positions.copy(), cable.tension, scene.dissipated
    for _ in range(6):
        solver.advance()
    size = 100.0 / 9
    assert np.abs(cable.state.positions - before).max() < 0.2 * 3e-3 * size
    assert cable.tension == pytest.approx(tension, rel=1e-4)
    assert scene.dissipated - dissipated < 1e-3 * dissipated


@pytest.mark.ranks
def test_crossing_cables(comm) -> None:
    """Two cables with friction that cross: next to none of it is none, a lot of it holds both."""
    found = []
    for mu in (0.0, 1e-6, 2.0):
        scene = sheet(comm, 9, "unstructured")
        solver = Solver(scene)
        cable = Cable(EA=32000.0, friction=mu)
        across = scene.lay_cable(cable, [(0.0, 30.0), (100.0, 30.0)], L0=100.0)
        scene.lay_cable(cable, [(50.0, 0.0), (50.0, 100.0)], L0=100.5, layer=1)
        solver.advance(pressure=PRESSURE, steps=2)
        solver.advance(move={across: (0.0, 0.0, -3.0)}, steps=2)
        solver.advance(move={across: (0.0, 0.0, 3.0)}, steps=2)
        found.append((*(c.tension for c in scene.cables), scene.energy))
        if mu:
            assert np.all(np.diff(np.nan_to_num(solver.history["dissipated"])) >= 0.0)
        assert scene.net.crossings
    # Friction changes paths otherwise than free sliding does, so that contacts may differ at first.
    np.testing.assert_allclose(found[1], found[0], rtol=1e-2)
    assert np.abs(np.array(found[2]) / found[0] - 1).max() < 0.2


def lattice_result(comm, x: np.ndarray, cells: np.ndarray, unit: float = 1.0) -> list[float]:
    """Tension and energies of a cable dragged over a lattice, units of force and length smaller."""
    mesh = meshes.from_arrays(comm, x * unit, cells)
    scene = clamped(mesh, IsotropicMembrane(E=300.0 / unit, nu=0.25, thickness=0.08 * unit))
    solver = advanced(Solver(scene), pressure=PRESSURE / unit)
    path = np.array([(-10.0, 30.0, -5.0), (110.0, 30.0, -5.0)]) * unit
    cable = scene.lay_cable(Cable(EA=32000.0 * unit, friction=0.2), path)
    solver.advance(L0={cable: 0.99 * cable.length})
    solver.advance(move={cable: (0.0, 6.0 * unit, 0.0)}, steps=2)
    return [cable.tension / unit, scene.energy / unit**2, scene.dissipated / unit**2]


@pytest.mark.ranks
def test_invariance(comm) -> None:
    """The equilibrium is that of the lag's tolerance, in whatever order things are tried."""
    points, cells = rotated_lattice(9)
    expected = lattice_result(comm, points, cells)
    mirrored = lattice_result(comm, points * [-1.0, 1.0] + [100.0, 0.0], cells[:, ::-1])
    order = np.random.default_rng(1).permutation(len(points))
    renumbered = lattice_result(comm, points[order], np.argsort(order)[cells])
    in_other_units = lattice_result(comm, points, cells, 100.0)
    for found in (mirrored, renumbered, in_other_units):
        np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.ranks
def test_ends_that_move_along_the_boundary_and_off_it(comm) -> None:
    """The boundary presses on the cable's end much more than the rest does on all of it."""
    scene = sheet(comm, 9, "unstructured")
    solver = advanced(Solver(scene), pressure=PRESSURE)
    cable = scene.lay_cable(Cable(EA=32000.0, friction=0.2), [(0.0, 30.0), (100.0, 30.0)])
    solver.advance(L0={cable: 100.0})
    for way in ((0.0, 10.0, 0.0), (0.0, 0.0, -1.0), (0.0, -10.0, 1.0)):
        step = solver.advance(move={cable: way}, steps=2)
        assert step.halvings == 0
    assert cable.ends == ("held", "held")
    assert 29.6 < place(cable, 50.0)[1] < 30.6  # it lags behind; without friction 29.6
    assert np.all(np.diff(np.nan_to_num(solver.history["dissipated"])) >= 0.0)


def test_what_was_rejected_is_not_tried_again_where_nothing_has_moved(comm) -> None:
    """Ways past vertices were, in each load step, at twice what the step itself takes."""
    scene = sheet(comm, 7, "unstructured")
    solver = advanced(Solver(scene), pressure=PRESSURE)
    path = [(-3.0, 72.215, 0.0), (103.0, 37.209, 0.0)]
    cable = scene.lay_cable(Cable(EA=32000.0, friction=Friction(0.3)), path)
    solver.advance(L0={cable: 0.99 * cable.L0}, move={cable.start: (0.0, 2.063, 0.0)})
    energy = scene.energy
    outcome = solver.advance().outcome
    assert outcome.solves == outcome.passes
    assert scene.energy == pytest.approx(energy, rel=1e-6)


def test_caught_points_are_put_back_once_where_the_cable_is() -> None:
    """In each pass of the friction forces it cost as much as the pass, and was rejected again."""
    scene, _ = friction_dome()
    cable = scene.cables[0]
    assert cable.state.law.lateral is not None
    cable.update(lateral=replace(cable.state.law.lateral, known=True))
    caught = [(0, next(k for k in cable.contacts() if cable.state.nodes[k].slides))]
    change, tried = PathChange(scene.net), TriedPaths()
    for _ in range(2):
        tried.begin_step()
        tried.forget_moved(scene.cables)
        assert straighten_kinks(change, tried, caught)
        tried.rejected.clear()
        assert not straighten_kinks(change, tried, caught)
        tried.end_step(scene.cables)
        tried.begin_step()
        tried.forget_moved(scene.cables)
        assert not straighten_kinks(change, tried, caught)
        cable.update(positions=cable.state.positions + 1e-3 * cable.length)


@pytest.mark.ranks
def test_refused_step_leaves_no_trace(comm, monkeypatch) -> None:
    """After a step that fails, friction knows nothing of it."""
    scene, solver, cable = anchored(comm, 0.2)
    solver.advance(move={cable: (0.0, 3.0, 0.0)})
    before = cable.state.law.lateral, scene.energy, cable.state.positions.copy()
    monkeypatch.setitem(vars(BUDGET), "passes", 1)
    with pytest.raises(ConvergenceError, match="friction forces still change by"):
        Solver(scene, max_halvings=0).advance(move={cable: (0.0, 3.0, 0.0)})
    assert cable.state.law.lateral is before[0]
    assert scene.energy == before[1]
    np.testing.assert_array_equal(cable.state.positions, before[2])


def test_slack_cable_has_no_grip(comm) -> None:
    """It lies where it is, and sticks there again when it is tightened."""
    scene, solver, cable = anchored(comm, 0.2)
    length = cable.L0
    solver.advance(L0={cable: 1.05 * length})
    assert not cable.taut and "friction" not in scene.energies
    solver.advance(L0={cable: length})
    assert cable.taut and cable.tension > 1.0


def half_way(comm, friction: Friction, steps: int, structured: bool) -> tuple[Solver, LaidCable]:
    """Model 3 pressed down in as many steps as dragged aside by 5 cm."""
    solver, cable = model_3(comm, friction, structured)
    for way in ((0.0, 0.0, -10.0), (0.0, 5.0, 0.0)):
        solver.advance(move={cable: way}, steps=steps)
    return solver, cable


HELD = pytest.mark.filterwarnings("ignore::crms_fenicsx.FrictionWarning")


@HELD
def test_element_of_the_paper_converges_with_order_one(comm) -> None:
    """As the force lags a step behind the tension; on two meshes to one tension. Its work is never
    negative. In the contact force the sideways turn counts too: mu acts like tan(asin(mu))."""
    limits = []
    for structured in (True, False):
        steps, tensions = (4, 8, 16, 32), []
        for n in steps:
            solver, cable = half_way(comm, Friction(0.7, law="step"), n, structured)
            assert np.all(np.diff(solver.history["dissipated"]) >= 0.0)
            assert all(step.outcome.passes == 0 for step in solver.steps)
            tensions.append(cable.tension)
        limits.append(tensions[-1])
    assert limits[0] == pytest.approx(limits[1], rel=0.01)
    # of the gmsh mesh, on which hardly a vertex is passed: with the limit extrapolated
    errors = 2 * tensions[-1] - tensions[-2] - np.array(tensions[:-1])
    rate = np.polyfit(np.log(steps[:-1]), np.log(errors), 1)[0]
    assert rate == pytest.approx(-1.0, abs=0.25)
    _, steeper = half_way(comm, Friction(np.tan(np.arcsin(0.7))), 4, False)
    assert limits[1] == pytest.approx(steeper.tension, rel=0.04)


def test_points_that_the_element_of_the_paper_holds_are_told(comm) -> None:
    """Once, when they begin to be held."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        half_way(comm, Friction(0.7, law="step"), 4, False)
    words = [str(one.message) for one in told if one.category is FrictionWarning]
    assert len(words) == (comm.rank == 0) and all("hold it at" in text for text in words)


@HELD
def test_element_of_the_paper_goes_to_and_fro(comm) -> None:
    """Back at the start of its way it has lost as much energy again, and no less."""
    solver, cable = half_way(comm, Friction(0.3, law="step"), 4, False)
    there = solver.scene.dissipated
    solver.advance(move={cable: (0.0, -5.0, 0.0)}, steps=4)
    assert solver.scene.dissipated > 1.2 * there > 0.0
    assert np.all(np.diff(solver.history["dissipated"]) >= 0.0)


@HELD
def test_lost_energy_stays_lost_when_a_cable_lifts_off(comm) -> None:
    """As it goes slack it has friction elements at fewer points than before."""
    scene = sheet(comm, 7)
    solver = advanced(Solver(scene), pressure=PRESSURE)
    cable = scene.lay_cable(
        Cable(EA=32000.0, friction=Friction(0.3, law="step")), [(-80.0, 47.0, 0), (180.0, 47.0, 0)]
    )
    for y, z in ((0.0, -5.0), (0.0, -5.0), (2.0, 0.0), (2.0, 0.0), (0.0, 9.9), (0.0, 3.0)):
        solver.advance(move={cable: (0.0, y, z)})
    assert not cable.taut
    lost = solver.history["dissipated"][1:]  # before there was no cable
    assert np.all(np.diff(lost) >= 0.0)
    assert lost[-1] > 0.0


def test_contact_force_per_length(comm) -> None:
    """What presses on the membrane is the cable's tension times its curvature: a flat arc's sum."""
    _, solver, cable = anchored(comm, 0.0, n=17)
    line = solver.contact_forces(cable).line
    x = cable.line
    on = np.isfinite(line) & (np.abs(x[:, 0] - 50.0) < 30.0)
    assert np.all(line[on] > 0.0)
    # the pull down of the cable's two ends at x = 20 and 80, by its slopes there
    arc, z = x[on, 0], x[on, 2]
    fit = np.polyfit(arc - 50.0, z, 4)
    slope = np.polyval(np.polyder(fit), [-30.0, 30.0])
    pull = cable.tension * -np.diff(slope / np.sqrt(1 + slope**2))[0]
    total = np.trapezoid(line[on], arc)
    assert total == pytest.approx(pull * (arc[-1] - arc[0]) / 60.0, rel=0.1)


class Circling:
    """A cable of which the friction forces change by so much in each pass."""

    settled = 1e-3

    def __init__(self, change: float) -> None:
        self.change = change

    def renew(self, shape: Any) -> float:
        """Their change."""
        return self.change


@pytest.mark.parametrize("change", [0.01, 0.5])
def test_forces_that_go_round_in_circles_are_told(comm, monkeypatch, change: float) -> None:
    """Crude ones with a warning; if they are nothing at all the step has not converged."""
    _, solver, cable = anchored(comm, Friction(0.2))
    lags = [Circling(change)]
    monkeypatch.setattr(search.FrictionLoop, "_friction_iterations", lambda self: lags)
    if change > 0.1:
        with pytest.raises(ConvergenceError, match=r"friction forces still change by 50\.0% after"):
            solver.advance(L0={cable: 0.985 * cable.length})
        return
    told = pytest.warns(FrictionWarning, match=r"accurate only to 1\.0% of their sum")
    with told if comm.rank == 0 else nullcontext():
        step = solver.advance(L0={cable: 0.985 * cable.length})
    assert step.outcome.unsettled == change
    assert step.outcome.passes == BUDGET.patience + 1
