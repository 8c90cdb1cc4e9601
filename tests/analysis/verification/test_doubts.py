"""A doubtful state is told wherever its results are looked at, with the range of its tensions."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, clamped, put
from mpi4py import MPI

from crms_fenicsx import Cable, DoubtWarning, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.analysis.steps.increment_solver import IncrementSolver
from crms_fenicsx.analysis.verification.doubts import tension_range
from crms_fenicsx.model.versions import last_doubt

pytestmark = pytest.mark.usefixtures("comm")


@contextmanager
def heard(comm: MPI.Intracomm) -> Iterator[list[str]]:
    """Texts of the warnings of a block, all of doubts, on all ranks."""
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield texts
    assert all(one.category is DoubtWarning for one in caught)
    assert all(one.filename == __file__ for one in caught)
    texts += comm.bcast([str(one.message) for one in caught])


def sheet(comm: MPI.Intracomm, n: int = 6) -> Scene:
    """An inflated disk."""
    return clamped(
        meshes.circle(comm, 30.0, 30.0 / n), IsotropicMembrane(E=300.0, nu=0.25, thickness=0.05)
    )


def zigzag(scene: Scene, solver: Solver) -> LaidCable:
    """A cable whose tension is far below pressure times the cells' size squared."""
    solver.advance(pressure=0.02)
    cable = scene.lay_cable(Cable(0.2), [(-29.9, 3.0), (29.5, -4.0)], name="thin")
    return cable


@pytest.mark.ranks
def test_a_doubt_is_told_in_all_places(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """And by restored and resumed states, with the same words on all ranks."""
    scene = sheet(comm)
    solver = Solver(scene, results=comm.bcast(str(tmp_path / "results")))
    cable = zigzag(scene, solver)
    before = solver.snapshot()
    with heard(comm) as texts:
        step = solver.advance()
    (one,) = scene.warnings
    assert texts == [f"step 2: {one.text}"]
    assert one.kind == "doubtful" and (one,) == step.warnings
    assert comm.allgather(one.text) == [one.text] * comm.size
    assert f"the tension of 'thin' is between 0 and {cable.tension:.3g}" in one.text
    assert "equilibrium, but doubtful" in repr(step)
    assert step.verification is not None and step.verification.passed
    assert one.text in repr(step.verification)
    assert one.text in repr(solver.summary())
    assert one.text in str(solver.history["warnings"][-1])
    (table,) = Path(comm.bcast(str(tmp_path / "results"))).glob("history.csv")
    assert one.text in table.read_text(encoding="utf-8")
    after = solver.snapshot()
    solver.restore(before)
    assert not scene.warnings
    solver.restore(after)
    assert scene.warnings == (one,)
    folder = comm.bcast(str(tmp_path / "saved"))
    solver.save(folder)
    again = Solver(sheet(comm))
    again.load(folder)
    assert again.scene.warnings == again.steps[-1].warnings == (one,)
    assert "doubtful" in repr(again.steps[-1])


def test_only_states_that_are_handed_out_are_told_of(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not those of searches, nor of parts of an increment."""
    scene = sheet(comm)
    solver = Solver(scene)
    zigzag(scene, solver)

    def search() -> None:
        with last_doubt(scene):
            for pressure in (0.021, 0.022, 0.023):
                solver.advance(pressure=pressure)

    def collective() -> None:  # two calls between the warning and the user
        search()

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        collective()
    assert [one.category for one in caught] == [DoubtWarning] * (comm.rank == 0)
    assert all(step.warnings for step in solver.steps[1:])

    solve, calls = IncrementSolver.solve, list[Any]()

    def failing(self: IncrementSolver, *args: Any) -> Any:
        found = solve(self, *args)
        calls.append(found)
        if len(calls) > 1:
            return found
        self._restore(args[2])
        outcome = dataclasses.replace(found.outcome, converged=False)
        return dataclasses.replace(found, outcome=outcome)

    monkeypatch.setattr(IncrementSolver, "solve", failing)
    with heard(comm) as texts:
        solver.advance(pressure=0.024)
    assert len(solver.steps) == 6 and solver.steps[-2].warnings
    assert [text[:7] for text in texts] == ["step 6:"]


@pytest.mark.parametrize("structured", [True, False])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_the_range_is_that_of_the_straight_string(
    comm: MPI.Intracomm, structured: bool, unit: float
) -> None:
    """On a rigid plane, where the least length is the distance of the ends, to 1e-7 of it."""
    mesh = meshes.rectangle(comm, 10.0 * unit, 10.0 * unit, unit, structured=structured)
    scene = Scene(mesh, IsotropicMembrane(E=1e6, nu=0.3, thickness=unit))
    scene.fix(lambda x: np.full(x.shape[1], True))
    ends = unit * np.array([(0.0, 2.3), (10.0, 6.8)])
    d = float(np.linalg.norm(ends[1] - ends[0]))
    cable = scene.lay_cable(Cable(EA=10.0), ends, L0=0.6 * d)
    Solver(scene).advance()
    shape = scene.net.strip_shape()
    low, high = tension_range(cable, shape)
    assert high - low < 1e-6 * 10.0
    for k, node in enumerate(cable.state.nodes):
        if node.kind == "fold":
            a, b = shape.current[np.searchsorted(shape.strip.vertices, node.support)]
            put(cable, "fractions", k, 0.5)
            put(cable, "positions", k, (a + b) / 2)
    longer = float(np.linalg.norm(np.diff(cable.line, axis=0), axis=1).sum()) - d
    assert longer > 0.01 * d
    low, high = tension_range(cable, shape)
    expected = max(cable.tension - 10.0 / cable.L0 * longer, 0.0)
    assert high == cable.tension
    assert low == pytest.approx(expected, abs=1e-7 * 10.0 / 0.6)
    assert expected > 0.0


@pytest.mark.parametrize("case", ["structured", "unstructured", "dome"])
def test_the_range_contains_the_tension_on_fine_cells(comm: MPI.Intracomm, case: str) -> None:
    """Of a cable longer than its way over the membrane by a small part of its strain."""
    tensions = []
    for cells in (6, 40):
        if case == "dome":
            mesh = meshes.spherical_cap(comm, 50.0, 20.0, size=100.0 / cells)
        else:
            straight = case == "structured"
            mesh = meshes.rectangle(comm, 100.0, 100.0, 100.0 / cells, structured=straight)
        scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
        solver = advanced(Solver(scene), pressure=0.02)
        ends = [(-49.9, 0.0), (47.0, -16.0)] if case == "dome" else [(0.0, 37.0), (100.0, 52.0)]
        cable = scene.lay_cable(Cable(0.5), ends)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtWarning)
            solver.advance()
        tensions.append((cable.tension, *tension_range(cable, scene.net.strip_shape())))
        if cells == 6:
            assert scene.warnings
    (_, low, high), (fine, *_) = tensions
    assert low <= fine <= high
    assert fine < 0.5 * high


@pytest.mark.ranks
def test_a_range_contains_that_of_ends_farther_up_the_slope(comm: MPI.Intracomm) -> None:
    """Ends given in plan lie inside facets, which are below the dome, and so too far apart."""
    lengths, ranges = [0.0], []
    for size, EA in ((1.0, 1e-4), (1.75, 200.0), (0.7, 200.0), (3.5, 20.0)):
        mesh = meshes.spherical_cap(comm, 10.0, 4.5, size=size)
        scene = clamped(mesh, IsotropicMembrane(E=200.0, nu=0.3, thickness=1.0, wrinkling=False))
        solver = advanced(Solver(scene), pressure=1.0)
        L0 = 0.995 * lengths[0] if lengths[0] else None
        cable = scene.lay_cable(Cable(EA), [(-6.3, 1.1), (7.1, -2.0)], L0=L0)
        lengths[0] = lengths[0] or cable.L0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtWarning)
            solver.advance()
        ranges.append(tension_range(cable, scene.net.strip_shape()))
    _, coarse, fine, _ = ranges
    assert 0.1 * fine[0] < coarse[0] < fine[0] < fine[1] < coarse[1]
    assert fine[1] < 0.8  # without what the ends add the coarse range began at 0.85
    (one,) = scene.warnings
    assert "its ends inside cells, if given in plan, lie too far down the slope" in one.text
