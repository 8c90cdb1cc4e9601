"""Stages of erection: each starts from the one before, and what fails leaves nothing behind."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI
from scipy.optimize import root

from crms_fenicsx import (
    Bar,
    Cable,
    ConvergenceError,
    InputError,
    IsotropicMembrane,
    Scene,
    Solver,
    codes,
    meshes,
)
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.arrays import Array

TOP = (20.0, 0.0, 6.0)
FEET = {
    "mast": (20.0, 0.0, 0.0), "guy 1": (25.0, 0.0, 0.0), "guy 2": (17.0, 4.0, 0.0),
    "guy 3": (17.0, -4.0, 0.0), "prop": (18.0, 0.0, 0.0),
}  # fmt: skip
STIFFNESS = {"mast": 2e5, "guy 1": 1e4, "guy 2": 1e4, "guy 3": 1.5e4, "prop": 5e4}


def mast(comm: MPI.Intracomm) -> Solver:
    """A mast with three guys and a prop, beside a sheet."""
    scene = sheet(comm, 2, side=1.0)
    top = scene.add_joint(TOP, name="top")
    for name, foot in FEET.items():
        kind = Bar(EA=STIFFNESS[name], tension_only=name.startswith("guy"))
        scene.add_bar(kind, foot, top, name=name)
    return Solver(scene)


def forces(scene: Scene) -> dict[str, float]:
    return {bar.name: bar.force for bar in scene.bars}


def by_hand(L0: dict[str, float]) -> dict[str, float]:
    """Forces in the bars with the given unstressed lengths, from the balance of their top."""

    def elongated(x: Array) -> dict[str, tuple[float, Array]]:
        found = {}
        for name, unstressed in L0.items():
            way = np.array(FEET[name]) - x
            length = float(np.linalg.norm(way))
            force = STIFFNESS[name] * (length / unstressed - 1.0)
            if name.startswith("guy"):
                force = max(force, 0.0)
            found[name] = force, way / length
        return found

    found = root(lambda x: sum(f * way for f, way in elongated(x).values()), TOP, tol=1e-13)
    assert found.success
    return {name: force for name, (force, _) in elongated(found.x).items()}


@pytest.mark.ranks
@pytest.mark.parametrize("order", [("guy 1", "guy 2", "guy 3"), ("guy 3", "guy 1", "guy 2")])
def test_guys_are_tightened_one_after_the_other(
    comm: MPI.Intracomm, order: tuple[str, ...]
) -> None:
    """As the balance of the mast's top says, by hand, after each; then the prop goes."""
    solver = mast(comm)
    scene = solver.scene
    L0 = {name: float(np.linalg.norm(np.subtract(foot, TOP))) for name, foot in FEET.items()}
    bars = {bar.name: bar for bar in scene.bars}
    for name in order:
        L0[name] *= 0.995
        with solver.stage(f"{name} tightened"):
            solver.advance(L0={bars[name]: L0[name]})
        assert forces(scene) == pytest.approx(by_hand(L0), rel=1e-6, abs=1e-6)
    with solver.stage("prop removed"):
        scene.remove_bar("prop")
    del L0["prop"]
    assert forces(scene) == pytest.approx(by_hand(L0), rel=1e-6, abs=1e-6)
    names = [*(f"{name} tightened" for name in order), "prop removed"]
    assert list(solver.stages) == names == list(solver.history["case"])
    for k, (name, one) in enumerate(solver.stages.items(), 1):
        assert (one.name, one.stage, one.state) == (name, k, "erection")
        assert one.step.verification is not None and one.step.verification.passed
    solver.restore(solver.stages[names[0]].snapshot)
    assert "prop" in forces(scene)


@pytest.mark.ranks
def test_a_crane_lets_go_of_a_mast(comm: MPI.Intracomm) -> None:
    """The held top has what is missing to the balance; released, it moves until there is none."""
    scene = sheet(comm, 2, side=1.0)
    top = scene.add_joint(TOP, name="top", held="xyz")
    for name, foot in FEET.items():
        kind = Bar(EA=STIFFNESS[name], tension_only=name.startswith("guy"))
        scene.add_bar(kind, foot, top, name=name)
    solver = Solver(scene)
    ways = {name: np.subtract(foot, TOP) for name, foot in FEET.items()}
    L0 = {name: 0.999 * float(np.linalg.norm(way)) for name, way in ways.items()}
    with solver.stage("on the crane"):
        solver.advance(L0={bar: L0[bar.name] for bar in scene.bars})
    pulls = sum(
        STIFFNESS[name] * (1.0 / 0.999 - 1.0) * way / np.linalg.norm(way)
        for name, way in ways.items()
    )
    assert top.reaction == pytest.approx(-np.asarray(pulls), rel=1e-9)
    assert solver.reactions("top").total == pytest.approx(-np.asarray(pulls), rel=1e-9)
    with solver.stage("crane away"):
        scene.release("top")
    assert forces(scene) == pytest.approx(by_hand(L0), rel=1e-6, abs=1e-6)
    assert not top.held.any() and not top.reaction.any()
    verified = solver.stages["crane away"].step.verification
    assert verified is not None and verified.passed
    solver.restore(solver.stages["on the crane"].snapshot)
    assert top.held.all()


@pytest.mark.ranks
def test_a_strip_shrinks_when_its_end_is_released(comm: MPI.Intracomm) -> None:
    """Its prestress goes: S + E (s^2 - 1) / 2 = 0 for the stretch s, as nothing contracts."""
    E, S, width = 100.0, 3.0, 2.0
    material = IsotropicMembrane(E=E, nu=0.0, thickness=1.0, prestress=S, wrinkling=False)
    scene = Scene(meshes.rectangle(comm, 6.0, width, 0.5, structured=True), material)
    for where, directions in (("left", "x"), ("right", "x"), ("boundary", "y")):
        scene.fix(where, directions)
    scene.fix(lambda x: x[2] < 1.0, "z")
    solver = Solver(scene)
    with solver.stage("clamped"):
        pass
    assert solver.reactions("right").total == pytest.approx((S * width, 0.0, 0.0), abs=1e-9)
    with solver.stage("released"):
        scene.release("right", "x")
    moved = solver.results().function("displacement").x.array.reshape(-1, 3)[:, 0]
    least = comm.allreduce(float(moved.min(initial=0.0)), op=MPI.MIN)
    assert least == pytest.approx(6.0 * (np.sqrt(1.0 - 2.0 * S / E) - 1.0), rel=1e-7)
    assert solver.reactions("left").total[0] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(InputError, match="not held"):
        scene.release("right", "x")


@pytest.mark.ranks
def test_what_edges_in_place_hold_stays_held(comm: MPI.Intracomm) -> None:
    """Corners belong to two edges; cables with anchors of their own are named."""
    scene = sheet(comm, 4, side=4.0)
    n = comm.allreduce(int(scene.held[: scene.V.dofmap.index_map.size_local].all(axis=1).sum()))
    scene.release("left")
    left = comm.allreduce(int(scene.held[: scene.V.dofmap.index_map.size_local].sum()))
    assert left == 3 * (n - 3)
    with pytest.raises(InputError, match="only by edges that stay"):
        scene.release("front left")
    scene.lay_cable(Cable(EA=10.0), [(4.0, 1.7), (2.0, 0.0)], name="stay")
    with pytest.raises(InputError, match="after cables have been laid"):
        scene.release("back")
    joint = scene.add_joint((9.0, 0.0, 0.0), name="lone", held="xyz")
    for one, why in (("lone", "no bar"), (joint, "no bar")):
        with pytest.raises(InputError, match=why):
            scene.release(one)
    corner = Scene(scene.mesh, IsotropicMembrane(E=100.0, nu=0.3, thickness=1.0))
    for name in ("front left", "back left", "back right"):
        corner.fix(name)
    corner.lay_cable(Cable(EA=10.0), [(0.0, 0.0), (3.0, 2.9)], name="tie")
    with pytest.raises(InputError, match="'tie' has an anchor of its own"):
        corner.release("front left")
    assert corner.held.any()


def roof(comm: MPI.Intracomm) -> Solver:
    """An inflated sheet under a cable, with a prop, a load and strengths."""
    scene = sheet(comm, 4, side=10.0)
    scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (10.0, 4.0)], tension=3.0, name="A5")
    scene.put_load((0.0, 0.0, -0.02), name="crew")
    scene.set_strengths((9.0, 9.0), cables=codes.CableDesign(breaking=30.0))
    solver = Solver(scene)
    solver.advance(pressure=0.2)
    return solver


@pytest.mark.ranks
def test_a_stage_has_its_limit_state_and_displacements(comm: MPI.Intracomm) -> None:
    """In the block and in its state; not after it, nor in combinations from there."""
    solver = roof(comm)
    scene = solver.scene
    with solver.stage("crew") as before:
        assert before.tensions == {"A5": scene.cable("A5").tension}
        solver.advance(load={"crew": 1.0})
        within = solver.summary()
    places = scene.positions().copy()
    with solver.stage("low pressure"):
        solver.advance(pressure=0.18)
    moved = np.linalg.norm(scene.positions() - places, axis=1).max(initial=0.0)
    summary = solver.summary()
    assert (within.state, summary.state) == ("erection", "ULS")
    assert summary.deflection is None and within.deflection is not None
    solver.restore(solver.stages["low pressure"].snapshot)
    deflection = solver.summary().deflection
    assert deflection is not None
    assert deflection.value == pytest.approx(comm.allreduce(float(moved), op=MPI.MAX), rel=1e-9)
    with solver.stage("again"):
        pass
    assert solver.summary().state == "ULS"
    found = solver.combine({"A5 lost": {"without": ["A5"], "state": "accidental"}})
    assert found["A5 lost"].stage == 0
    table = solver.judge(solver.stages | found)
    assert [(state, name) for state, name, check in table.rows if check.what == "cable"] == [
        ("erection", "crew" if within.cables["A5"].largest > scene.cable("A5").tension
         else "low pressure")
    ]  # fmt: skip
    assert {state for state, *_ in table.rows} == {"erection", "accidental"}


@pytest.mark.ranks
def test_a_cable_is_lost_in_a_stage_or_in_a_combination(comm: MPI.Intracomm) -> None:
    """With the same result; the structure stays as it is after the stage only."""
    solver = roof(comm)
    found = solver.combine({"gone": {"without": ["A5"], "state": "accidental"}})["gone"]
    assert len(solver.scene.cables) == 1
    with solver.stage("A5 lost", state="accidental"):
        solver.scene.remove("A5")
    assert not solver.scene.cables
    lost = solver.stages["A5 lost"]
    assert lost.state == found.state == "accidental"
    assert lost.step.energy == pytest.approx(found.step.energy, rel=1e-10)
    np.testing.assert_allclose(lost.snapshot.u, found.snapshot.u, atol=1e-7)
    with solver.stage("repaired"):
        solver.scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (10.0, 4.0)], tension=3.0, name="A5")
    assert solver.stages["repaired"].snapshot.tensions["A5"] > 0.0


@pytest.mark.ranks
def test_a_stage_without_equilibrium_is_named_and_undone(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where an error is raised in the block, and where a first load step was good."""
    solver = roof(comm)
    scene, u = solver.scene, solver.scene.u.x.array.copy()
    with pytest.raises(ZeroDivisionError), solver.stage("crew"):
        solver.advance(load={"crew": 1.0})
        scene.remove("A5")
        raise ZeroDivisionError
    with monkeypatch.context() as patch, pytest.raises(ConvergenceError) as error:
        patch.setattr(Minimizer, "solve", lambda self, *_: Outcome(False, "no", 1.0, 0.0, 1, 1, 1))
        with solver.stage("A5 away"):
            scene.remove("A5")
    assert str(error.value).startswith("stage 'A5 away': step 3: no equilibrium")
    assert "back in the state before this stage" in str(error.value)
    assert scene.cables and scene.in_equilibrium()
    assert scene.factors["crew"] == 0.0
    np.testing.assert_array_equal(scene.u.x.array, u)
    assert (solver.stages, solver.case, scene.case.base) == ({}, "", None)
    with solver.stage("A5 away"):
        scene.remove("A5")
    assert [one.stage for one in solver.stages.values()] == [1]


def test_a_stage_that_changes_nothing_is_solved_and_verified(comm: MPI.Intracomm) -> None:
    solver = roof(comm)
    with solver.stage("as it stands"):
        pass
    step = solver.stages["as it stands"].step
    assert step.number == 2 and step.verification is not None and step.verification.passed


@pytest.mark.ranks
@pytest.mark.parametrize("further", [False, True])
def test_a_state_restored_within_a_stage_is_that_of_its_step(
    comm: MPI.Intracomm, further: bool
) -> None:
    """Neither its step nor its limit state are those of another one; as without the detour."""
    solver, found = roof(comm), roof(comm)
    with solver.stage("crew", state="accidental") as before:
        solver.advance(load={"crew": 2.0})
        solver.restore(before)
        if further:
            solver.advance(load={"crew": 1.0})
    with found.stage("crew", state="accidental"):
        found.advance(load={"crew": float(further)})
    stage, direct = solver.stages["crew"], found.stages["crew"]
    assert stage.state == direct.state == "accidental"
    assert stage.base is before and stage.snapshot.case.base is before
    assert stage.step.energy == solver.scene.energy == pytest.approx(direct.step.energy, rel=1e-9)
    assert len(found.steps) == 2


def test_stages_lead_to_each_other(comm: MPI.Intracomm) -> None:
    """One after an earlier state than the last stage's is refused, until those between are gone."""
    solver = roof(comm)
    for k in (1, 2, 3):
        with solver.stage(f"crew {k}"):
            solver.advance(load={"crew": float(k)})
    for earlier in (solver.stages["crew 1"].snapshot, solver.stages["crew 1"].base):
        solver.restore(earlier)
        solver.combine({"gust": {}})  # states of erection may have combinations
        with pytest.raises(InputError, match=r"earlier state.*\(.*'crew 2', 'crew 3'\)"):
            with solver.stage("other"):
                raise AssertionError
    assert list(solver.stages) == ["crew 1", "crew 2", "crew 3"]
    solver.restore(solver.stages["crew 3"].snapshot)
    with solver.stage("crew 4"):
        solver.advance(load={"crew": 4.0})
    assert solver.stages["crew 4"].stage == 4
    solver.restore(solver.stages["crew 1"].snapshot)
    solver.advance(load={"crew": 1.5})
    for k in (2, 3, 4):
        del solver.stages[f"crew {k}"]
    with solver.stage("other"):
        solver.advance(load={"crew": 2.5})
    assert [one.stage for one in solver.stages.values()] == [1, 2]


def test_bad_stages_are_refused_before_anything_is_computed(comm: MPI.Intracomm) -> None:
    solver = roof(comm)
    with solver.stage("crew"):
        solver.advance(load={"crew": 1.0})
    for name, state, words in (
        ("", "erection", "stage: name = ''"),
        (3, "erection", "stage: name = 3"),
        ("crew", "erection", "'crew' is a stage already"),
        ("next", "raising", "stage: 'next': state = 'raising'"),
    ):
        with pytest.raises(InputError, match=words), solver.stage(name, state=state):  # type: ignore[arg-type]
            raise AssertionError
    with solver.branch("gust"), pytest.raises(InputError, match="'next' is within 'gust'"):
        with solver.stage("next"):
            raise AssertionError
    for call in (lambda: solver.combine({"gust": {}}), lambda: solver.stage("b").__enter__()):
        with pytest.raises(InputError, match="within"), solver.stage("next"):
            call()
    short = codes.FabricDesign((9.0, 9.0), gamma_M={"ULS": 1.4})
    solver.scene.set_strengths(short)
    with pytest.raises(InputError, match=r"stage: 'next': .*erection"), solver.stage("next"):
        raise AssertionError
    known = codes.FabricDesign((9.0, 9.0), gamma_M=1.4, duration={"permanent": 1.5, "crew": 1.2})
    solver.scene.set_strengths(known)
    solver.scene.put_load((0.0, 0.0, -0.01), name="crane")
    with pytest.raises(InputError, match=r"stage: 'crane': .*'crane'"), solver.stage("crane"):
        solver.advance(load={"crane": 1.0})
    assert list(solver.stages) == ["crew"] and solver.scene.factors["crane"] == 0.0
    assert solver.case == ""
