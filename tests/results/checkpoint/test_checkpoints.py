"""Checkpoints: a run that goes on from one is the run that has not ended."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from same_state import assert_same_state

from crms_fenicsx import (
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.results.checkpoint.checkpoint_files import complete, replaced_folder
from crms_fenicsx.results.checkpoint.saving import signed
from crms_fenicsx.results.output import History

pytestmark = pytest.mark.usefixtures("comm")

COMM = MPI.COMM_WORLD
FABRIC = OrthotropicMembrane(E1=300.0, E2=200.0, G12=40.0, nu21=0.2, thickness=0.08, warp=(1, 0, 0))


def sheet(comm: MPI.Intracomm, n: int = 6, material: object = FABRIC, **options: object) -> Solver:
    """A flat square, nothing held yet."""
    mesh = meshes.rectangle(comm, 100.0, 100.0, size=100 / n, structured=True)
    return Solver(Scene(mesh, material, **options), rtol=1e-11)


def first_half(solver: Solver) -> None:
    """An inflated fabric with a floor and snow; three cables that cross, one of them rough, one
    smooth, one tied to the fabric at one end and drawn up at the other, so that it lifts off."""
    scene = solver.scene
    scene.fix("boundary")
    scene.floor(-1.0)
    scene.put_load((0.0, 0.0, -1e-3))
    solver.advance(pressure=0.01, load=1.0)
    rough = Friction(0.3, static=0.4, along=0.2)
    scene.lay_cable(Cable(9000.0, friction=rough), [(0, 33), (100, 41)], tension=15.0, name="rough")
    smooth = [(30.0, -20.0, 0.0), (42.0, 120.0, 0.0)]
    scene.lay_cable(Cable(9000.0), smooth, tension=15.0, layer=1, name="smooth")
    scene.lay_cable(Cable(9000.0), [(70, 66), (0, 71)], tension=1.0, name="tied")
    solver.advance(move={scene.cable("tied").end: (-4.0, 0.0, 9.0)}, pressure=0.012)


def second_half(solver: Solver) -> None:
    scene = solver.scene
    rough, smooth, tied = (scene.cable(name) for name in ("rough", "smooth", "tied"))
    solver.advance(move={smooth: (5.0, 0.0, -3.0), rough: (0.0, 0.0, -2.0)}, load=2.0)
    solver.advance(L0={tied: 0.995 * tied.L0}, pressure=0.011)


WORK = {"iterations", "evaluations", "factorizations", "solves", "flips", "passes"}


def same_run(one: Solver, other: Solver, rtol: float) -> None:
    """Both have come to the same, in all their steps."""
    assert one.history.columns == other.history.columns
    for column in one.history.columns:
        if column not in WORK | {"seconds", "residual"}:
            scale = np.nanmax(np.abs(one.history[column]))
            np.testing.assert_allclose(
                other.history[column], one.history[column], rtol, rtol * scale, err_msg=column
            )
    assert [step.number for step in one.steps] == [step.number for step in other.steps]
    for a, b in zip(one.scene.cables, other.scene.cables, strict=True):
        assert [node.kind for node in a.state.nodes] == [node.kind for node in b.state.nodes]
        np.testing.assert_allclose(b.state.positions, a.state.positions, atol=100 * rtol * 100)
        np.testing.assert_array_equal(b.state.lifted, a.state.lifted)


@pytest.mark.ranks
def test_a_run_goes_on_as_if_it_had_not_ended(folder: Path) -> None:
    solver = sheet(COMM)
    first_half(solver)
    scene = solver.scene
    assert scene.net.crossings and scene.cable("tied").state.lifted.any()
    rough = scene.cable("rough")
    assert rough.state.law.lateral is not None is not rough.state.law.axial
    rough.update(lateral=replace(rough.state.law.lateral, dissipated=0.25))  # also what is rare
    solver.save(folder / "point")
    again = sheet(COMM)
    again.load(folder / "point")
    on_mesh = () if COMM.size == 1 else ("membrane", "loads")  # ranks may divide it otherwise
    assert_same_state(again.scene.state, scene.state, but=on_mesh)
    again.save(folder / "point")  # one that has not gone on yet is saved as well
    again = sheet(COMM)
    again.load(folder / "point")
    stress = [
        COMM.allreduce(float((one.results().true_forces ** 2 * one.results().areas[:, None]).sum()))
        for one in (solver, again)
    ]
    assert stress[1] == pytest.approx(stress[0], rel=1e-12)
    tried, known = solver.search.tried, again.search.tried
    assert (known.refused, known.left) == (tried.refused, tried.left)
    assert any(tried.refused.values())
    for name, places in tried.at.items():
        np.testing.assert_array_equal(known.at[name], places)
    if COMM.size > 1:  # whose direct solvers never do the same twice; see the next test
        return
    second_half(solver)
    second_half(again)
    same_run(solver, again, 1e-9)  # the penalty's energy turns on the last digits of the places
    for column in sorted(WORK):
        np.testing.assert_array_equal(again.history[column], solver.history[column], column)


@pytest.mark.ranks
def test_saved_and_loaded_by_other_numbers_of_processes(folder: Path) -> None:
    """By all ranks and by two halves of them, and by one and by all."""
    if COMM.size == 1:
        pytest.skip("needs two ranks")
    solver = sheet(COMM)
    first_half(solver)
    solver.save(folder / "all")
    second_half(solver)
    halves = COMM.Split(int(COMM.rank < COMM.size // 2), COMM.rank)
    of_half = sheet(halves)
    of_half.load(folder / "all")
    second_half(of_half)
    same_run(solver, of_half, 1e-7)
    if COMM.rank == 0:
        alone = sheet(MPI.COMM_SELF)
        first_half(alone)
        alone.save(folder / "one")
    COMM.barrier()
    of_one = sheet(COMM)
    of_one.load(folder / "one")
    second_half(of_one)
    same_run(solver, of_one, 1e-7)
    halves.Free()


@pytest.mark.ranks
def test_laws_with_history(folder: Path) -> None:
    """The paper's laws know of all steps before: stresses, shapes, volume, tension."""

    def laid() -> Solver:
        linear = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
        solver = sheet(COMM, material=linear, strain="step", pressure="step")
        solver.scene.fix("boundary")
        return solver

    solver = laid()
    solver.advance(pressure=0.01, steps=3)
    cable = solver.scene.lay_cable(Cable(9000.0, law="step"), [(0, 33), (100, 41)], tension=20.0)
    solver.advance(move={cable.end: (0.0, 0.0, -2.0)})
    solver.save(folder / "point")
    again = laid()
    again.load(folder / "point")
    for one in (solver, again):
        one.advance(move={one.scene.cables[0].end: (0.0, 0.0, -2.0)}, pressure=0.012, steps=2)
    same_run(solver, again, 1e-10)
    forces = [
        COMM.allreduce(float((one.results().true_forces ** 2).sum())) for one in (solver, again)
    ]
    assert forces[1] == pytest.approx(forces[0], rel=1e-8)


def inflated(folder: Path | None = None) -> Solver:
    """The smallest run with a cable that there is, and a dead load."""
    solver = sheet(COMM, 3)
    if folder is not None:
        solver = Solver(solver.scene, results=folder)
    solver.scene.fix("boundary")
    solver.scene.put_load((0.0, 0.0, 0.01))
    solver.advance(pressure=0.01, load=1.0)
    solver.scene.lay_cable(Cable(9000.0, friction=0.2), [(0, 33), (100, 41)], tension=20.0)
    solver.advance()
    return solver


def test_results_go_on(folder: Path) -> None:
    solver = inflated(folder / "out")
    solver.save(folder / "out" / "point")
    solver.advance(pressure=0.02, steps=2)  # lost: the run is killed
    del solver
    again = Solver(sheet(COMM, 3).scene, results=folder / "out")
    again.load(folder / "out" / "point")
    again.advance(pressure=0.015)
    COMM.barrier()
    assert [path.name for path in sorted((folder / "out" / "steps").iterdir())] == [
        *("cables_000001.vtu", "cables_000002.vtu"),
        *(f"surface_{k:06d}.vtu" for k in range(3)),
    ]
    text = (folder / "out" / "surface.pvd").read_text()
    assert [f'timestep="{time}"' in text for time in ("1.0", "2.0", "3.0", "4.0")] == [1, 1, 1, 0]
    np.testing.assert_array_equal(
        History.read(folder / "out" / "history.csv")["energy"], again.history["energy"]
    )
    COMM.barrier()
    del again
    other = Solver(sheet(COMM, 3).scene, results=folder / "out")
    other.scene.fix("boundary")
    other.advance(pressure=0.5)
    other.advance(pressure=0.6)
    del other
    elsewhere = Solver(sheet(COMM, 3).scene, results=folder / "out")  # the files are not its own
    elsewhere.load(folder / "out" / "point")
    elsewhere.advance()
    COMM.barrier()
    text = (folder / "out" / "surface.pvd").read_text()
    assert text.count("DataSet") == 1 and 'timestep="3.0"' in text


@pytest.mark.ranks
def test_another_scene_is_refused(folder: Path) -> None:
    inflated().save(folder / "point")
    moved = meshes.rectangle(COMM, 100.0, 100.001, size=100 / 3, structured=True)
    for scene, message in (
        (sheet(COMM, 4).scene, "number of vertices 16, and here 25"),
        (Scene(moved, FABRIC), "another mesh: its vertex"),
        (sheet(COMM, 3, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)).scene, "materials"),
        (sheet(COMM, 3, penalty=0.2).scene, "penalty 0.1, and here 0.2"),
        (sheet(COMM, 3, pressure="step").scene, "pressure 'total', and here 'step'"),
    ):
        u = scene.u.x.array.copy()
        with pytest.raises(InputError, match=message):
            Solver(scene).load(folder / "point")
        np.testing.assert_array_equal(scene.u.x.array, u)
        assert not scene.cables and not scene.held.any() and not scene.membrane.held_edges.any()
    begun = inflated()
    with pytest.raises(InputError, match="2 load steps already"):
        begun.load(folder / "point")
    with pytest.raises(InputError, match="no cable 'ridge'; there are 'cable 1'"):
        begun.scene.cable("ridge")


BROKEN = {
    "truncated": ("membrane.u.npy", lambda path: path.write_bytes(path.read_bytes()[:-1])),
    "no header": ("membrane.u.npy", lambda path: path.write_bytes(b"\x93NUMPY")),
    "type": ("membrane.held.npy", lambda path: np.save(path, np.zeros((16, 3)))),
    "shape": ("loads.loads.0.forces.npy", lambda path: np.save(path, np.zeros((3, 16)))),
    "by columns": ("positions.npy", lambda path: np.save(path, np.zeros((16, 3), order="F"))),
    "huge": ("membrane.u.npy", lambda path: declare(path, (10**15, 3))),
    "huge edges": ("state.json", lambda path: change(path, "edges", 10**15)),
    "pickled": ("membrane.u.npy", lambda path: np.save(path, np.array([{}, print], object))),
    "not finite": ("membrane.u.npy", lambda path: np.save(path, np.full((16, 3), np.nan))),
    "missing": ("membrane.held_edges.npy", Path.unlink),
    "no state": ("state.json", Path.unlink),
    "no text": ("state.json", lambda path: path.write_bytes(b"\xff\xfe\x00")),
    "no JSON": ("state.json", lambda path: path.write_text('{"format": ')),
    "nested": ("state.json", lambda path: path.write_text("[" * 100000)),
    "no object": ("state.json", lambda path: path.write_text("[1, 2]")),
    "other version": ("state.json", lambda path: path.write_text('{"format": "9"}')),
    "no loads": ("state.json", lambda path: change(path, "pressure", None)),
    "no kind": ("state.json", lambda path: change(path, "kind", "knot")),
    "a long text that is none": (
        "state.json",
        lambda path: path.write_bytes(b'"' + b"a" * 9999 + b"\xff"),
    ),
    "not finite state": ("state.json", lambda path: rewrite(path, '"load": 1.0', '"load": 1e999')),
    "not a number": ("state.json", lambda path: rewrite(path, '"load": 1.0', '"load": NaN')),
    "another digit": ("state.json", lambda path: rewrite(path, '"load": 1.0', '"load": 1.5')),
    "flipped bit": ("membrane.u.npy", lambda path: flip(path)),
    "pipe": ("state.json", lambda path: (path.unlink(), os.mkfifo(path))),
    "device": ("membrane.held.npy", lambda path: (path.unlink(), path.symlink_to("/dev/zero"))),
}


def declare(path: Path, shape: tuple[int, ...]) -> None:
    with open(path, "wb") as file:
        header = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)


def rewrite(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[200] ^= 1
    path.write_bytes(data)


def change(path: Path, name: str, value: object) -> None:
    data = json.loads(path.read_text())["content"]
    state = data["state"]
    cable = next(iter(state["net"]["cables"].values()))
    if name == "edges":
        state["membrane"]["held_edges"]["rows"] = value
    elif name == "kind":
        cable["nodes"][1]["kind"] = value
    else:
        state["air"][name] = value
    path.write_text(signed(data))


@pytest.mark.ranks
def test_broken_files_are_named(folder: Path) -> None:
    solver = inflated()
    solver.save(folder / "good")
    fresh = sheet(COMM, 3)
    for case, (name, spoil) in BROKEN.items():
        if COMM.rank == 0:
            shutil.copytree(folder / "good", folder / case)
            spoil(folder / case / name)
        COMM.barrier()
        with pytest.raises(InputError, match=rf"{case}/({name}|membrane.held_edges\.npy)"):
            fresh.load(folder / case)
        assert not fresh.scene.cables and not fresh.steps, case
        assert not fresh.scene.membrane.held_edges.any(), case
    fresh.load(folder / "good")
    assert fresh.scene.energies == solver.scene.energies


def test_what_is_no_checkpoint_is_not_replaced(folder: Path) -> None:
    if COMM.rank == 0:
        (folder / "results").mkdir()
        (folder / "results" / "history.csv").write_text("step")
        (folder / "file").write_text("")
    COMM.barrier()
    solver = sheet(COMM, 3)
    for name, message in (
        ("results", "results is not a checkpoint"),
        ("file", "file is not a checkpoint"),
        ("file/point", "cannot be written"),
    ):
        with pytest.raises(InputError, match=message):
            solver.save(folder / name)
    solver.save(folder / "point")
    COMM.barrier()
    assert sorted(path.name for path in folder.iterdir()) == ["file", "point", "results"]


class Killed(BaseException):
    pass


@pytest.mark.ranks
def test_killed_at_any_moment_one_checkpoint_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each change of the file system in turn is the last that the run makes."""
    if COMM.rank > 0:
        pytest.skip("one process is enough")
    folder, left = tmp_path / "point", 0

    def until_killed(change):
        def changed(*arguments, **options):
            nonlocal left
            left -= 1
            if left == 0:
                raise Killed
            if left > 0:
                change(*arguments, **options)

        return changed

    def write(text: str) -> None:
        with replaced_folder(folder, MPI.COMM_SELF, "state") as partial:
            (partial / "state").write_text(text)
            (partial / "field").write_text(text)

    last, written = "0", 0
    write(last)
    for killed in range(1, 20):
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", until_killed(os.replace))
            patch.setattr(shutil, "rmtree", until_killed(remove_halfway))
            patch.setattr(Path, "mkdir", until_killed(Path.mkdir))
            patch.setattr(Path, "write_text", until_killed(Path.write_text))
            left = killed
            try:
                write(str(killed))
                written += 1
            except Killed:
                pass
        found = {(complete(folder) / name).read_text() for name in ("state", "field")}
        assert found in ({last}, {str(killed)}), killed
        (last,) = found
        if not killed % 3:  # the next run repairs what this one has left
            write(last)
            assert [path.name for path in tmp_path.iterdir()] == ["point"]
    assert written > 3


def remove_halfway(folder: Path, **options: object) -> None:
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
