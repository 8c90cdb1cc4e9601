"""A script that was killed and is started again: it goes on, and comes to the same."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    Friction,
    InputError,
    IsotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.results.checkpoint.journal import Journal
from crms_fenicsx.results.output import History

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]

COMM = MPI.COMM_WORLD
CALLS, STEPS = 3, 5


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.fixture
def solves(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pressures at which an equilibrium was computed."""
    whole, seen = EquilibriumSearch.find, []

    def find(self: EquilibriumSearch, *arguments: Any) -> Any:
        seen.append(self.scene.pressure)
        return whole(self, *arguments)

    monkeypatch.setattr(EquilibriumSearch, "find", find)
    return seen


def scene_of(comm: MPI.Intracomm = COMM, **options: Any) -> Scene:
    mesh = meshes.rectangle(comm, 100.0, 100.0, size=25.0, structured=True)
    linear = "strain" in options
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=not linear)
    return Scene(mesh, foil, **options)


def script(
    folder: Path, resume: bool, comm: MPI.Intracomm = COMM, laws: str = "total", **changed: Any
) -> Solver:
    """A user's script; what is given by name is other than in the script that was interrupted."""
    given: dict[str, Any] = {
        "pressure": 0.01, "steps": 2, "move": (0.0, 0.0, -2.0), "L0": 0.995, "EA": 9000.0,
        "friction": 0.0, "along": 0.0, "path": [(0, 33), (100, 41)], "tension": 15.0,
        "hold": "outside", "held": "x", "floor": -1.0, "snow": -1e-3, "rtol": 1e-9,
        "name": "rough",
    } | changed  # fmt: skip
    scene = scene_of(comm, **({"strain": "step", "pressure": "step"} if laws == "step" else {}))
    scene.fix("boundary")
    scene.fix(lambda x: np.hypot(x[0] - 50.0, x[1] - 50.0) < 1.0, given["held"])
    scene.floor(given["floor"])
    solver = advanced(
        Solver(scene, results=folder / "out", resume=resume, rtol=given["rtol"]),
        pressure=given["pressure"],
        steps=given["steps"],
    )
    scene.put_load((0.0, 0.0, given["snow"]))
    friction = Friction(given["friction"], along=given["along"]) if laws == "total" else 0.0
    rough = scene.lay_cable(
        Cable(given["EA"], friction=friction, law=laws), given["path"], tension=given["tension"],
        hold=given["hold"], name=given["name"],
    )  # fmt: skip
    length = rough.L0
    solver.advance(move={rough.end: given["move"]}, load=1.0, steps=2)
    if laws == "total":
        assert rough is scene.cable(given["name"]) and rough.L0 == length
        solver.advance(L0={rough: given["L0"] * rough.L0}, pressure=0.012)
    else:
        solver.advance(pressure=0.012)
    assert rough in scene.cables
    return solver


def stop_after(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Let the run end after it has written some checkpoints."""
    whole, kept = Journal.keep, 0

    def keep(self: Journal, *arguments: Any) -> None:
        nonlocal kept
        whole(self, *arguments)
        kept += 1
        if kept == count:
            raise Killed

    monkeypatch.setattr(Journal, "keep", keep)


def killed(monkeypatch: pytest.MonkeyPatch, count: int, run: Callable[[], object]) -> None:
    with monkeypatch.context() as patch:
        stop_after(patch, count)
        with pytest.raises(Killed):
            run()
    COMM.barrier()


def numbers(solver: Solver) -> np.ndarray:
    """What a run has come to."""
    (cable,) = solver.scene.cables
    history = solver.history
    return np.array([cable.tension, cable.length, *history["energy"], *history["pressure"]])


@pytest.mark.parametrize("laws", ["total", "step"])
def test_interrupted_after_any_step(
    folder: Path, monkeypatch: pytest.MonkeyPatch, solves: list[float], laws: str
) -> None:
    whole = script(folder / "whole", False, laws=laws)
    assert len(whole.steps) == STEPS
    due = numbers(whole)
    del whole  # and with it the lock on its folder
    rtol = 1e-10 if COMM.size == 1 else 1e-6
    counts = range(1, STEPS + 1) if COMM.size == 1 else (2, 4)
    for count in counts if laws == "total" else (3,):
        place = folder / str(count)
        killed(monkeypatch, count, lambda place=place: script(place, False, laws=laws))
        solves.clear()
        again = script(place, True, laws=laws)
        assert len(solves) == STEPS - count, "what was done is not computed again"
        np.testing.assert_allclose(numbers(again), due, rtol=rtol)
        COMM.barrier()
        table = History.read(place / "out" / "history.csv")
        np.testing.assert_array_equal(table["energy"], again.history["energy"])
        assert (place / "out" / "surface.pvd").read_text().count("DataSet") == STEPS
        names = sorted(path.name for path in (place / "out" / "checkpoints").iterdir())
        assert names == ["0001", "0002", "0003"]
    COMM.barrier()
    solves.clear()
    np.testing.assert_array_equal(numbers(script(folder / "whole", True, laws=laws)), due)
    assert not solves


def test_interrupted_twice_and_resumed_on_other_processes(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = script(folder / "whole", False)
    killed(monkeypatch, 1, lambda: script(folder, False))
    killed(monkeypatch, 2, lambda: script(folder, True))
    if COMM.rank == 0:
        alone = numbers(script(folder, True, MPI.COMM_SELF))
        np.testing.assert_allclose(alone, numbers(whole), rtol=1e-6)
    COMM.barrier()
    np.testing.assert_allclose(numbers(script(folder, True)), numbers(whole), rtol=1e-6)


CHANGES: dict[str, tuple[Any, str]] = {
    "pressure": (0.011, "call 1 .*advance, pressure = 0.01, and now 0.011"),
    "steps": (3, "call 1 .*advance, steps = 2, and now 3"),
    "rtol": (1e-8, "call 1 .*solver, rtol = 1e-09, and now 1e-08"),
    "held": ("y", "call 1 .*scene, membrane, held"),
    "floor": (-2.0, "call 1 .*scene, floor = -1.0, and now -2.0"),
    "snow": (-2e-3, "call 2 .*scene, loads"),
    "EA": (9001.0, "call 2 .*scene, net, cables, rough, law, cable, EA = 9000.0, and now 9001.0"),
    "friction": (0.1, "call 2 .*cables, rough, law, cable, friction, mu = 0.0, and now 0.1"),
    "path": ([(0, 33), (100, 41.001)], "call 2 .*scene, net, cables, rough"),
    "tension": (16.0, "call 2 .*scene, net, cables, rough, law, (L0|tension)"),
    "hold": ("sleeve", "call 2 .*cables, rough, laid, hold = 'outside', and now 'sleeve'"),
    "name": ("smooth", "call 2 .*advance, move, end of the cable 'rough'"),
    "move": ((0.0, 0.0, -2.1), "call 2 .*advance, move, end of the cable 'rough' = .*-2.0"),
    "L0": (0.994, "call 3 .*advance, L0, cable 'rough'"),
}


def test_another_script_is_refused(folder: Path) -> None:
    script(folder, False)
    COMM.barrier()
    for name, (value, message) in CHANGES.items():
        with pytest.raises(InputError, match=message):
            script(folder, True, **{name: value})
    calls = folder / "out" / "checkpoints"
    with pytest.raises(InputError, match=r"delete .*0001 and those after"):
        script(folder, True, steps=1)
    if COMM.rank == 0:  # what the message says
        for call in calls.iterdir():
            shutil.rmtree(call)
    COMM.barrier()
    assert len(script(folder, True, steps=1).steps) == STEPS - 1


def test_from_some_call_on_anew(folder: Path, solves: list[float]) -> None:
    """The calls after one that is computed anew are, too, even if they are there."""
    script(folder, False)
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(folder / "out" / "checkpoints" / "0002")
    COMM.barrier()
    solves.clear()
    again = script(folder, True, tension=16.0)
    assert len(solves) == 3 and len(again.steps) == STEPS


def test_begun_anew(folder: Path, monkeypatch: pytest.MonkeyPatch, solves: list[float]) -> None:
    """Without resume the first step replaces what is there, and nothing before."""
    script(folder, False)
    calls = folder / "out" / "checkpoints"
    Solver(scene_of(), results=folder / "out", resume=False)
    COMM.barrier()
    assert len(list(calls.iterdir())) == CALLS
    killed(monkeypatch, 1, lambda: script(folder, False))
    assert [path.name for path in calls.iterdir()] == ["0001"]
    COMM.barrier()
    solves.clear()
    script(folder, True)
    assert len(solves) == STEPS - 1


def test_killed_while_old_calls_are_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is left is a run that can be resumed."""
    whole = numbers(script(folder / "good", False))
    removed = shutil.rmtree
    for count in range(1, CALLS + 1):
        place, left = folder / str(count), count
        COMM.barrier()
        if COMM.rank == 0:
            shutil.copytree(folder / "good", place)
        COMM.barrier()

        def until_killed(path: Path, **options: Any) -> None:
            nonlocal left
            left -= 1
            if left == 0:
                raise OSError("killed")
            removed(path, **options)

        with monkeypatch.context() as patch:
            patch.setattr(shutil, "rmtree", until_killed)
            with pytest.raises(InputError, match="killed"):
                script(place, False)
        COMM.barrier()
        np.testing.assert_allclose(numbers(script(place, True)), whole, rtol=1e-6)


def test_a_step_that_has_failed_fails_again(folder: Path, solves: list[float]) -> None:
    """A script that catches the error goes on as it did."""

    def run(resume: bool) -> Solver:
        scene = scene_of()
        scene.fix("boundary")
        solver = advanced(
            Solver(scene, results=folder / "out", resume=resume, max_halvings=0, rtol=1e-10),
            pressure=0.001,
        )
        if not resume:
            solver.system.minimizer.max_stages = 1
        with pytest.raises(ConvergenceError, match="step 2: no equilibrium"):
            solver.advance(pressure=0.1)
        if not resume:
            solver.system.minimizer.max_stages = 1000
        solver.advance(pressure=0.002)
        return solver

    energy = run(False).scene.energy
    COMM.barrier()
    solves.clear()
    assert run(True).scene.energy == pytest.approx(energy, rel=1e-13)
    assert not solves


def test_killed_within_a_stage(
    folder: Path, monkeypatch: pytest.MonkeyPatch, solves: list[float]
) -> None:
    """What was done is not computed again; stages have their states, names and limit states."""

    def run(place: Path, resume: bool) -> Solver:
        scene = scene_of()
        scene.fix("boundary")
        solver = Solver(scene, results=place, resume=resume)
        with solver.stage("inflated"):
            solver.advance(pressure=0.01, steps=2)
        with solver.stage("A1 tightened"):
            cable = scene.lay_cable(Cable(9000.0), [(0, 33), (100, 41)], tension=15.0, name="A1")
            solver.advance()
            solver.advance(L0={cable: 0.995 * cable.L0})
        with solver.stage("A1 away"):
            scene.remove("A1")
        return solver

    whole = run(folder / "whole", False)
    COMM.barrier()
    for count in (1, 3, 4) if COMM.size == 1 else (3,):
        place = folder / str(count)
        killed(monkeypatch, count, lambda place=place: run(place, False))
        solves.clear()
        again = run(place, True)
        assert len(solves) == 5 - count
        assert list(again.stages) == list(whole.stages)
        for one, known in zip(again.stages.values(), whole.stages.values(), strict=True):
            assert (one.stage, one.state) == (known.stage, "erection")
            assert one.step.energy == pytest.approx(known.step.energy, rel=1e-6)
            assert one.snapshot.tensions == pytest.approx(known.snapshot.tensions, rel=1e-6)
        COMM.barrier()
        cases = History.read(place / "history.csv")["case"]
        assert list(cases) == ["inflated"] * 2 + ["A1 tightened"] * 2 + ["A1 away"]


def test_halved_increments_go_on(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Interrupted between two halves of an increment."""
    whole, bad = EquilibriumSearch.find, []

    def find(self: EquilibriumSearch, *arguments: Any) -> Any:
        outcome = whole(self, *arguments)
        if self.scene.pressure == 0.01 and not bad:
            bad.append(1)
            object.__setattr__(outcome, "converged", False)
        return outcome

    monkeypatch.setattr(EquilibriumSearch, "find", find)

    def run(resume: bool) -> np.ndarray:
        scene = scene_of()
        scene.fix("boundary")
        solver = advanced(
            Solver(scene, results=folder / "out", resume=resume), pressure=0.02, steps=2
        )
        return np.asarray(solver.history["pressure"])

    killed(monkeypatch, 1, lambda: run(False))
    np.testing.assert_allclose(run(True), [0.005, 0.01, 0.02])


def test_resume_needs_a_folder() -> None:
    scene = scene_of()
    for value, message in ((True, "but no results"), (False, "but no results"), ("yes", "True, ")):
        with pytest.raises(InputError, match=message):
            Solver(scene, resume=value)  # type: ignore[arg-type]
    assert Solver(scene)._journal is None
