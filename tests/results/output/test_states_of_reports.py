"""Verdicts, models and pictures of a report are those of the states whose results it has."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI
from report_page import Page

from crms_fenicsx import Bar, Cable, ConvergenceError, InputError, IsotropicMembrane, Scene, Solver
from crms_fenicsx.design.study import adapt, convergence
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.tolerances import BUDGET


def fabric(E: float) -> IsotropicMembrane:
    return IsotropicMembrane(E=E, nu=0.3, thickness=1.0, prestress=2.0)


def roof(comm: MPI.Intracomm) -> Solver:
    """A square under snow, air, a cable and a bar, in equilibrium."""
    scene = sheet(comm, 4, material=fabric(1e3), side=10.0)
    scene.add_bar(Bar(100.0), (5.0, 5.0, 5.0), scene.vertex_at((5.0, 5.0, 0.0)), name="hanger")
    scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (10.0, 4.0)], tension=3.0, name="ridge")
    scene.put_load((0.0, 0.0, -1.0), name="snow")
    return advanced(Solver(scene), load=0.2, pressure=0.5)


def page_of(solver: Solver, path: Path, *found: object) -> Page:
    solver.report(path, *found, pictures=[])  # type: ignore[arg-type]
    solver.comm.barrier()
    return Page(path.read_text(encoding="utf-8"))


def verdict(page: Page) -> str:
    return next(
        word for word in page.words if re.match("(Not in eq|Not ver|Not acc|Verified)", word)
    )


def stretch(scene: Scene) -> None:
    scene.u.x.array[:] *= 1.5


def stretch_one_vertex(scene: Scene) -> None:
    """One that is free, on one rank only."""
    if scene.comm.rank == scene.comm.size - 1:
        own = scene.V.dofmap.index_map.size_local
        scene.u.x.array[np.flatnonzero(~scene.held[:own])[-1]] += 1e-9


CHANGES: dict[str, Callable[[Scene], object]] = {
    "material": lambda scene: scene.set_material(fabric(1e4)),
    "stiffness": lambda scene: scene.set_stiffness({scene.cables[0]: 1e3}),
    "load away": lambda scene: scene.remove_load("snow"),
    "bar": lambda scene: scene.add_bar(Bar(1.0), (5.0, 5.0, 6.0), scene.bars[0].start, L0=0.5),
    "bar away": lambda scene: scene.remove_bar("hanger"),
    "cable": lambda scene: scene.lay_cable(Cable(EA=2e3), [(3.0, 0.0), (4.0, 10.0)], tension=3.0),
    "cable away": lambda scene: scene.remove("ridge"),
    "supports": lambda scene: scene.fix(lambda x: x[0] > 6.0),
    "air": lambda scene: scene.seal(volume=1000.0),
    "floor": lambda scene: scene.floor(-50.0),
    "u": stretch,
    "u of one vertex": stretch_one_vertex,
}
KEPT: dict[str, Callable[[Scene], object]] = {
    "strengths": lambda scene: scene.set_strengths((80.0, 70.0)),
    "idle load": lambda scene: scene.put_load((0.0, 0.0, -1.0), name="drift"),
    "idle pond": lambda scene: scene.put_pond(10.0, level=50.0),
    "lone joint": lambda scene: scene.add_joint((0.0, 0.0, 9.0), held="xyz"),
}


@pytest.mark.ranks
@pytest.mark.parametrize("what", CHANGES)
def test_a_changed_scene_is_not_in_equilibrium(
    comm: MPI.Intracomm, folder: Path, what: str
) -> None:
    """Until the next load step, or until it is back in its state; on all ranks."""
    solver = roof(comm)
    assert solver.summary().in_equilibrium
    before = solver.snapshot()
    CHANGES[what](solver.scene)
    assert verdict(page_of(solver, folder / "now.html")).startswith("Not in equilibrium")
    assert 'class="verdict failed"' in (folder / "now.html").read_text(encoding="utf-8")
    summary = solver.summary()
    assert not summary.in_equilibrium
    assert not solver.results().in_equilibrium
    assert "not in equilibrium" in repr(summary)
    assert "not in equilibrium" in repr(solver.results())
    assert "not in equilibrium" in comm.bcast(repr(solver), root=comm.size - 1)
    for study in (
        solver.estimate_error,
        lambda: convergence(lambda mesh: solver, solver.scene.mesh),
        lambda: adapt(lambda mesh: solver, solver.scene.mesh),
    ):
        with pytest.raises(InputError, match="changed since its last load step"):
            study()
    solver.restore(before)
    assert solver.summary().in_equilibrium
    CHANGES[what](solver.scene)
    solver.advance()
    assert solver.summary().in_equilibrium
    assert "not in equilibrium" not in repr(solver.summary()) + repr(solver.results())


@pytest.mark.parametrize("what", KEPT)
def test_what_does_not_act_keeps_the_equilibrium(
    comm: MPI.Intracomm, folder: Path, what: str
) -> None:
    solver = roof(comm)
    KEPT[what](solver.scene)
    assert verdict(page_of(solver, folder / "now.html")).startswith("Verified")
    stretch(solver.scene)
    solver.scene.put_load((0.0, 0.0, -1.0), name="crew")
    assert not solver.summary().in_equilibrium


def test_a_term_of_ones_own_changes_the_equilibrium(comm: MPI.Intracomm) -> None:
    solver = roof(comm)
    scene = solver.scene
    n = scene.mesh.mesh.topology.index_map(2).size_local
    scene.add_term(ResidualStress(scene.u, np.zeros((n, 3, 3))))
    assert not solver.summary().in_equilibrium


def test_a_step_that_fails_leaves_what_was_verified(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also one that has found states on its way, as with wind, which turns."""
    solver = roof(comm)
    scene = solver.scene
    scene.put_wind(0.3, -0.8)
    other = Solver(scene, max_halvings=1)
    monkeypatch.setitem(vars(BUDGET), "follower_solves", 1)
    with pytest.raises(ConvergenceError, match="still turns"):
        other.advance(load={"wind": 1.0})
    assert solver.summary().in_equilibrium
    assert scene.versions.current.equilibrium.verification is solver.steps[0].verification


def test_another_solver_and_a_scene_without_steps(comm: MPI.Intracomm, folder: Path) -> None:
    """The state is the scene's, whichever solver has found it."""
    solver = roof(comm)
    other = Solver(solver.scene)
    assert verdict(page_of(other, folder / "now.html")).startswith("Verified")
    other.advance(load=0.3)
    assert verdict(page_of(solver, folder / "now.html")).startswith("Verified")
    fresh = sheet(comm, 2, material=fabric(1e3), side=1.0)
    assert verdict(page_of(Solver(fresh), folder / "now.html")).startswith("Not in equilibrium")
    with pytest.raises(InputError, match="no load step has found"):
        Solver(fresh).estimate_error()


@pytest.mark.ranks
@pytest.mark.parametrize("changed", [False, True])
def test_checkpoints_know_whether_it_was_in_equilibrium(
    comm: MPI.Intracomm, folder: Path, changed: bool
) -> None:
    solver = roof(comm)
    if changed:
        solver.scene.remove_bar("hanger")
    solver.save(folder / "saved")
    again = roof(comm).scene
    other = Solver(again)
    other.load(folder / "saved")
    assert other.summary().in_equilibrium is not changed
    due = "Not in equilibrium" if changed else "Verified"
    assert verdict(page_of(other, folder / "now.html")).startswith(due)


@pytest.mark.ranks
def test_a_resumed_run_writes_the_same_report(comm: MPI.Intracomm, folder: Path) -> None:
    """With its doubts and checks of equilibrium, of combinations and of stages of erection."""

    def run(name: str, resume: bool) -> str:
        scene = sheet(comm, 4, material=fabric(1e3), side=10.0)
        scene.put_load((0.0, 0.0, -1.0), name="snow")
        scene.set_strengths((5.0, 5.0))
        solver = Solver(scene, results=folder / "run", resume=resume)
        with solver.stage("laid"):
            scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (10.0, 4.0)], tension=3.0, name="ridge")
        step = solver.advance(load=0.2, pressure=0.5)
        assert step.verification is not None and step.verification.passed
        found = solver.combine({"calm": {}, "snow": {"snow": 0.6}}) | solver.stages
        page_of(solver, folder / name, found)
        text = (folder / name).read_text(encoding="utf-8")
        return re.sub(r"\d\d:\d\d UTC", "", text)

    first, again = run("first.html", resume=False), run("again.html", resume=True)
    assert first.splitlines() == again.splitlines()
    assert "finer cells may change" in first and "Requirements of equilibrium" in first


def images(path: Path) -> list[str]:
    return re.findall(r"<img[^>]*>", path.read_text(encoding="utf-8"))


def captions(path: Path) -> list[str]:
    return re.findall("<figcaption>(.*?)</figcaption>", path.read_text(encoding="utf-8"))


def test_the_report_has_the_model_and_the_base_state_of_its_combinations(
    comm: MPI.Intracomm, folder: Path
) -> None:
    solver = roof(comm)
    scene = solver.scene
    found = solver.combine({"LC0": {}, "snow": {"snow": 0.6}})
    base: Array = scene.u.x.array.copy()
    np.testing.assert_allclose(found["LC0"].snapshot.u, base, atol=1e-7)
    first = page_of(solver, folder / "first.html", found)
    solver.restore(found["snow"].snapshot)
    scene.remove("ridge")
    scene.remove_load("snow")
    scene.put_load((0.0, 0.0, -9.0), name="snow")
    scene.set_material(fabric(7e3))
    second = page_of(solver, folder / "second.html", found)
    assert first.tables == second.tables
    assert verdict(second).startswith("Verified")
    assert captions(folder / "second.html")[0].startswith("The model in its base state;")
    if comm.rank == 0:
        assert images(folder / "first.html")[0] == images(folder / "second.html")[0]
    assert not solver.summary().in_equilibrium  # the scene is as before the report
    assert [cable.name for cable in scene.cables] == []


def test_combinations_of_models_that_differ_are_refused(comm: MPI.Intracomm, folder: Path) -> None:
    """What has only been added, as the air of a sealed hall, is told with its combinations."""
    solver = roof(comm)
    found = solver.combine({"calm": {"snow": 0.1}})
    solver.scene.seal(volume=1000.0)
    found |= solver.combine({"gust": {"snow": 0.3}})
    page = page_of(solver, folder / "both.html", found)
    (air,) = (row for row in page.tables["Mesh and theory"] if row[0] == "Air")
    assert air[1].startswith("gust: sealed at")
    assert captions(folder / "both.html")[0].startswith("The model in the base state of calm")
    solver.scene.set_material(fabric(7e3))
    found |= solver.combine({"stiff": {"snow": 0.3}})
    with pytest.raises(InputError, match="materials of the combinations calm and stiff differ"):
        solver.report(folder / "three.html", found, pictures=[])
    assert not (folder / "three.html").exists()


def test_base_states_other_than_the_first_are_told(comm: MPI.Intracomm, folder: Path) -> None:
    solver = roof(comm)
    found = solver.combine({"calm": {}, "snow": {"snow": 0.3}})
    solver.advance(load={"snow": 0.25}, pressure=0.4)
    found |= solver.combine({"gust": {"snow": 0.3}, "more": {"snow": 0.4}})
    page = page_of(solver, folder / "both.html", found)
    text = "Base state of gust, more instead of LC0: inner pressure 0.4000, snow 0.2500."
    assert text in page.words
    page = page_of(solver, folder / "one.html", {"gust": found["gust"]})
    assert not any("instead of LC0" in word for word in page.words)


def test_the_base_state_of_a_loaded_state(comm: MPI.Intracomm, folder: Path) -> None:
    """Of a report without combinations: the state in which loads were first brought on."""
    scene = sheet(comm, 4, material=fabric(1e3), side=10.0)
    scene.put_load((0.0, 0.0, -1.0), name="snow")
    solver = advanced(Solver(scene), pressure=0.5)
    solver.draw(folder / "base.png", dpi=50)
    page_of(solver, folder / "base.html")
    assert captions(folder / "base.html")[0].startswith("The model in its current state;")
    solver.advance(load=1.0)
    page_of(solver, folder / "loaded.html")
    first = captions(folder / "loaded.html")[0]
    assert first.startswith("The model in its base state, before its loads;")
    if comm.rank == 0:
        one, other = (
            re.search("src=.*?>", images(folder / f"{name}.html")[0])[0]  # type: ignore[index]
            for name in ("base", "loaded")
        )
        assert one == other


def test_combinations_say_what_they_change(comm: MPI.Intracomm, folder: Path) -> None:
    """The factor of the prestress, what is missing, the limit state and the pressure."""
    solver = roof(comm)
    table = {
        "tight": {"snow": 0.3, "prestress": 1.35},
        "torn": {"snow": 0.1, "state": "accidental", "without": ["ridge", "hanger"]},
        "fans": {"snow": 0.3, "state": "frequent", "pressure": 0.7},
    }
    page = page_of(solver, folder / "changed.html", solver.combine(table))
    (heads, *rows) = page.tables["Inner pressure and factors of the loads"]
    assert heads == [
        "Case", "Combination", "Limit state", "Prestress", "Without", "Inner pressure", "snow"
    ]  # fmt: skip
    assert [row[1:] for row in rows] == [
        ["base state", "\u2013", "1.000", "\u2013", "0.5000", "0.2000"],
        ["tight", "ULS", "1.350", "\u2013", "0.6750", "0.3000"],
        ["torn", "accidental", "1.000", "ridge, hanger", "0.5000", "0.1000"],
        ["fans", "frequent", "1.000", "\u2013", "0.7000", "0.3000"],
    ]
    page = page_of(solver, folder / "same.html", solver.combine({"snow": {"snow": 0.3}}))
    heads = page.tables["Inner pressure and factors of the loads"][0]
    assert "Prestress" not in heads and "Without" not in heads


def test_more_prestress_alone_is_not_the_base_state(comm: MPI.Intracomm, folder: Path) -> None:
    """Nor is a missing cable: LC0 is the state in operation, from which deflections count."""
    solver = roof(comm)
    changed = {"tight": {"snow": 0.2, "prestress": 1.35}, "torn": {"without": ["ridge"]}}
    table = "Inner pressure and factors of the loads"
    (_, *rows) = page_of(solver, folder / "base.html", solver.combine(changed)).tables[table]
    assert [row[:2] for row in rows] == [["LC0", "base state"], ["LC1", "tight"], ["LC2", "torn"]]
    found = solver.combine(changed | {"as it is": {}})
    (_, *rows) = page_of(solver, folder / "own.html", found).tables[table]
    assert [row[:2] for row in rows] == [["LC0", "as it is"], ["LC1", "tight"], ["LC2", "torn"]]


@pytest.mark.ranks
def test_slack_cables_are_named(comm: MPI.Intracomm, folder: Path) -> None:
    """In the tables of tensions, in place of a number, and beside their envelope."""
    solver = roof(comm)
    (ridge,) = solver.scene.cables
    found = solver.combine({"Snow": {"snow": 0.3}})
    with solver.stage("loosened"):
        solver.advance(L0={ridge: 1.3 * ridge.L0})
    page = page_of(solver, folder / "slack.html", found | solver.stages)
    tensions = {row[0]: row[1] for row in page.tables["Largest tensions of the cables"][1:]}
    assert tensions["loosened"] == "slack" and float(tensions["Snow"]) > 1.0
    loose = solver.combine({"Snow": {"snow": 0.3}})
    tables = page_of(solver, folder / "loose.html", loose).tables
    (caption,) = (name for name in tables if name.startswith("Envelope of the cables' tensions"))
    assert tables[caption][0][-1] == "Slack in" and tables[caption][1][-1] in ("all", "Snow")
