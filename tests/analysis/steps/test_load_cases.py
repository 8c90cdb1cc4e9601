"""Snapshots, branches and combinations of loads, all from one base state."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI

from crms_fenicsx import Cable, ConvergenceError, InputError, Scene, Solver, meshes
from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome

SNOW, WEIGHT = (0.0, 0.0, -2e-3), (0.0, 0.0, -1e-3)


def sheet(comm: MPI.Intracomm) -> Scene:
    return clamped(meshes.rectangle(comm, 100.0, 100.0, 25.0))


def roof(comm: MPI.Intracomm, folder: Path | None = None, resume: bool | None = None) -> Solver:
    """An inflated sheet under two cables that slide, one with friction, and three loads."""
    scene = sheet(comm)
    solver = advanced(Solver(scene, results=folder, resume=resume), pressure=0.01)
    scene.lay_cable(Cable(32000.0), [(0.0, 47.0), (100.0, 52.0)], tension=20.0, name="ridge")
    scene.lay_cable(Cable(9000.0, friction=0.2), [(44.0, 0.0), (53.0, 100.0)], name="cross")
    scene.put_load(SNOW, name="snow", per="plan")
    scene.put_load(WEIGHT, name="weight", per="material")
    scene.put_wind(3e-3, lambda x, n: 0.4 - 1.2 * x[0] / 100.0)
    solver.advance(load={"weight": 1.0})
    return solver


def tensions(solver: Solver) -> list[float]:
    return [cable.tension for cable in solver.scene.cables]


@pytest.mark.ranks
def test_a_branch_comes_back(comm: MPI.Intracomm) -> None:
    """State, loads, energies and cables are as before, and the next step has nothing to do."""
    solver = roof(comm)
    scene = solver.scene
    u, before, energy = scene.u.x.array.copy(), tensions(solver), scene.energy
    paths = [cable.line.copy() for cable in scene.cables]
    with solver.branch("snow"):
        solver.advance(load={"snow": 1.0}, steps=2)
        assert abs(tensions(solver)[0] - before[0]) > 1e-2 * before[0]
    assert np.array_equal(scene.u.x.array, u)
    assert tensions(solver) == before
    assert scene.energy == energy
    assert [load.factor for load in scene.loads] == [0.0, 1.0, 0.0]
    for cable, path in zip(scene.cables, paths, strict=True):
        assert np.array_equal(cable.line, path)
    straight_on = roof(comm)
    straight_on.advance()
    solver.advance()
    np.testing.assert_allclose(tensions(solver), tensions(straight_on), rtol=1e-6)
    cases = [row.get("case") for row in solver.history]
    assert cases == [None, None, "snow", "snow", None]


@pytest.mark.ranks
def test_what_is_changed_in_a_branch_is_undone(comm: MPI.Intracomm) -> None:
    """Cables laid and removed, supports, a floor and loads, also after an error."""
    solver = roof(comm)
    scene = solver.scene
    cables, held, names = scene.cables, scene.held.copy(), [load.name for load in scene.loads]
    with pytest.raises(ZeroDivisionError), solver.branch("repair"):
        scene.remove("ridge")
        scene.lay_cable(Cable(5000.0), [(0.0, 20.0), (100.0, 25.0)], name="new")
        scene.remove_load("snow")
        scene.put_load(SNOW, name="crew")
        scene.fix(lambda x: np.abs(x[0] - 50.0) < 15.0, "z")
        scene.floor(-50.0)
        solver.advance(load={"crew": 1.0})
        raise ZeroDivisionError
    assert scene.cables == cables
    assert np.array_equal(scene.held, held)
    assert [load.name for load in scene.loads] == names
    assert scene.floor_level is None
    straight_on = roof(comm)
    for one in (solver, straight_on):
        one.advance()
    np.testing.assert_allclose(tensions(solver), tensions(straight_on), rtol=1e-6)


def test_a_combination_is_what_a_run_of_its_own_gives(comm: MPI.Intracomm) -> None:
    """In any order, each from the base state; factors that are not named stay."""
    solver = roof(comm)
    before = tensions(solver)
    table = {
        "snow": {"snow": 1.0},
        "storm": {"wind": 1.2, "weight": 0.9, "pressure": 0.012},
        "both": {"snow": 0.5, "wind": 0.6},
    }
    found = solver.combine(table)
    assert list(found) == list(table)
    assert tensions(solver) == before
    for name, given in table.items():
        alone = roof(comm)
        factors = {load: factor for load, factor in given.items() if load != "pressure"}
        alone.advance(load=factors, pressure=given.get("pressure"))
        of_case = found[name].snapshot.tensions
        np.testing.assert_allclose(list(of_case.values()), tensions(alone), rtol=2e-5)
        assert found[name].step.energy == pytest.approx(alone.scene.energy, rel=1e-8)
        assert found[name].step.verification is not None
        assert found[name].step.verification.passed
    solver.restore(found["storm"].snapshot)
    assert solver.scene.pressure == 0.012
    assert tensions(solver) == list(found["storm"].snapshot.tensions.values())


@pytest.mark.ranks
def test_a_combination_without_equilibrium_is_named(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = advanced(Solver(sheet(comm), max_halvings=1), pressure=0.01)
    solver.scene.put_load(SNOW, name="snow")
    u = solver.scene.u.x.array.copy()
    monkeypatch.setattr(
        Minimizer, "solve", lambda self, *_: Outcome(False, "no", 1.0, 0.0, 1, 1, 1)
    )
    with pytest.raises(ConvergenceError, match="combination 'drift'"):
        solver.combine({"drift": {"snow": 1.0}})
    assert np.array_equal(solver.scene.u.x.array, u)
    assert solver.case == ""


def test_bad_combinations_are_refused_before_anything_is_computed(comm: MPI.Intracomm) -> None:
    solver = advanced(Solver(sheet(comm)), pressure=0.01)
    solver.scene.put_load(SNOW, name="snow")
    good = {"good": {"snow": 1.0}}
    for bad, words in (
        ({"case": {"rain": 1.0}}, "'case'.*no load 'rain'"),
        ({"case": {"snow": np.nan}}, "'case'.*'snow' = nan"),
        ({"case": {"pressure": "x"}}, "'case'.*pressure"),
        ({"case": 1.5}, "'case' = 1.5"),
        ({3: {"snow": 1.0}}, "a name = 3 is not a non-empty string"),
        ({"": {"snow": 1.0}}, "a name = '' is not a non-empty string"),
    ):
        with pytest.raises(InputError, match=words):
            solver.combine(good | bad)
    for bad in ({}, 3, None):
        with pytest.raises(InputError, match="combinations ="):
            solver.combine(bad)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="'pressure' means another thing"):
        solver.scene.put_load(SNOW, name="pressure")  # combinations could not tell them apart
    assert len(solver.steps) == 1


def test_bad_branches(comm: MPI.Intracomm) -> None:
    solver, other = Solver(sheet(comm)), Solver(sheet(comm))
    with solver.branch("a"), pytest.raises(InputError, match="within"), solver.branch("b"):
        pass
    with pytest.raises(InputError, match="another scene"):
        solver.restore(other.snapshot())
    with pytest.raises(InputError, match=r"is of type .*; pass a SceneState"):
        solver.restore(None)  # type: ignore[arg-type]


@pytest.mark.ranks
def test_a_run_with_combinations_resumes(comm: MPI.Intracomm, folder: Path) -> None:
    """Started again it takes all from the checkpoints, wind and its coefficients included."""

    def run(resume: bool) -> tuple[list[float], int]:
        solver = roof(comm, folder / "run", resume)
        found = solver.combine({"storm": {"wind": 1.0}, "snow": {"snow": 1.0}})
        evaluations = sum(solver.system.potential.evaluations for _ in (1,))
        values = [t for case in found.values() for t in case.snapshot.tensions.values()]
        return [*values, *tensions(solver)], evaluations

    first, _ = run(False)
    again, evaluations = run(True)
    np.testing.assert_allclose(again, first, rtol=1e-12)
    assert evaluations == 0


def test_reactions_after_a_branch_have_the_papers_pressure(
    comm: MPI.Intracomm, tmp_path: Path
) -> None:
    """Its forces, of plain and folded cells, are those of the state that was restored or loaded."""

    def inflated() -> Solver:
        return Solver(clamped(meshes.rectangle(comm, 100.0, 100.0, 25.0), pressure="step"))

    solver, folder = inflated(), Path(comm.bcast(str(tmp_path))) / "point"
    solver.advance(pressure=0.01, steps=2)
    solver.scene.lay_cable(Cable(9000.0), [(0.0, 43.0), (100.0, 52.0)], hold="sleeve")
    solver.advance(steps=4)
    before = solver.reactions("boundary").total
    assert before[2] < -80.0
    solver.restore(solver.snapshot())
    np.testing.assert_allclose(solver.reactions("boundary").total, before, atol=0.02)
    solver.save(folder)
    other = inflated()
    other.load(folder)
    np.testing.assert_allclose(other.reactions("boundary").total, before, atol=0.02)


def test_to_look_at_a_state_does_not_arrange_its_crossings_anew(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else results after `put_load` or `seal` would be of other paths than were solved for."""
    scene = sheet(comm)
    solver = advanced(Solver(scene), pressure=0.01)
    scene.lay_cable(Cable(32000.0), [(0.0, 47.0), (100.0, 52.0)], tension=20.0, name="ridge")
    scene.lay_cable(Cable(9000.0), [(44.0, 0.0), (53.0, 100.0)], tension=20.0)
    solver.advance()
    assert len(scene.net.crossings) == 1
    nodes, volume = [cable.state.nodes for cable in scene.cables], scene.volume
    with monkeypatch.context() as patch:

        def arrange(*_: object) -> None:
            raise AssertionError("the crossings were arranged")

        patch.setattr(CableNet, "arrange_crossings", arrange)
        scene.put_load(SNOW, name="more snow")
        tension = solver.summary().cables["ridge"].largest
        solver.restore(solver.snapshot())
        assert solver.summary().cables["ridge"].largest == tension
    assert [cable.state.nodes for cable in scene.cables] == nodes and scene.volume == volume
    scene.lay_cable(Cable(9000.0), [(0.0, 21.0), (100.0, 32.0)], tension=20.0)
    solver.summary()
    assert len(scene.net.crossings) == 2, "one has been laid"
    assert solver.advance().verification is not None


@pytest.mark.ranks
def test_rank_0_gives_the_order(comm: MPI.Intracomm, folder: Path) -> None:
    """Of combinations, their loads, and what is compared on finer meshes."""
    last = comm.rank == comm.size - 1
    table = {
        "snow": {"snow": 0.5, "weight": 0.5, "pressure": 0.012}, "LC0": {}, "light": {"weight": 0.5}
    }  # fmt: skip
    turned = {name: dict(reversed(given.items())) for name, given in reversed(table.items())}
    solver, other = Solver(sheet(comm)), Solver(sheet(comm))
    energies = []
    for one, given in ((solver, table), (other, turned if last else table)):
        one.advance(pressure=0.01)
        one.scene.put_load(SNOW, name="snow", per="plan")
        one.scene.put_load(WEIGHT, name="weight", per="material")
        found = one.combine(given)
        assert list(found) == comm.bcast(list(given))
        energies.append([case.step.energy for case in found.values()])
        mine = dict(reversed(found.items())) if last else found
        one.report(folder / "r.html", mine, pictures=[])
    if comm.size > 1:  # but for what rounds otherwise in each factorisation on several processes
        np.testing.assert_allclose(energies[0], energies[1], rtol=1e-13)
    assert min(np.ptp(energies, axis=1)) > 0.0


def test_a_combination_of_nothing_is_the_base_state(comm: MPI.Intracomm) -> None:
    solver = roof(comm)
    before, energy = tensions(solver), solver.scene.energy
    found = solver.combine({"LC0": {}, "snow": {"snow": 1.0}})
    np.testing.assert_allclose(list(found["LC0"].snapshot.tensions.values()), before, rtol=1e-6)
    assert found["LC0"].step.energy == pytest.approx(energy, rel=1e-9)
    assert found["LC0"].base is found["snow"].base
    assert tensions(solver) == before
