"""One writer per folder: other solvers and processes are refused before they compute anything."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import InputError, Solver
from crms_fenicsx.foundation.runtime import files
from crms_fenicsx.results.output import History

pytestmark = pytest.mark.ranks

HOLDER = """
import fcntl, os, sys, time
file = open(sys.argv[1], "a")
fcntl.flock(file, fcntl.LOCK_EX)
print("locked", flush=True)
time.sleep(float(sys.argv[2]))
os._exit(9)
"""


def solver_of(comm: MPI.Intracomm, folder: Path | str, cells: int = 2, **options: bool) -> Solver:
    scene = sheet(comm, cells, side=1.0)
    return Solver(scene, results=folder, **options)


def files_in(comm: MPI.Intracomm, folder: Path) -> dict[str, bytes]:
    comm.barrier()
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_two_solvers_one_folder(comm: MPI.Intracomm, folder: Path) -> None:
    first, second = solver_of(comm, folder / "out"), solver_of(comm, folder / "out", 3)
    first.advance(pressure=1.0)
    before = files_in(comm, folder)
    with pytest.raises(InputError, match=r"out has results of another solver.*process \d+ on "):
        second.advance(pressure=2.0)
    assert not second.steps and second.scene.pressure == 0.0
    assert files_in(comm, folder) == before
    first.advance(pressure=2.0)
    first.save(folder / "point")
    again = solver_of(comm, folder / "out")
    with pytest.raises(InputError, match="out has results of another solver"):
        again.load(folder / "point")
    assert again.scene.pressure == 0.0
    del first
    again.load(folder / "point")
    again.advance(pressure=3.0)
    assert len(History.read(folder / "out" / "history.csv")) == 3
    del again
    second.advance(pressure=2.0)
    comm.barrier()
    assert len(History.read(folder / "out" / "history.csv")) == 1


def test_the_frames_of_an_error_keep_no_folder(comm: MPI.Intracomm, folder: Path) -> None:
    """They and the error refer to each other, and to the solver."""

    def failing() -> None:
        solver = solver_of(comm, folder)
        solver.advance(pressure=1.0)
        try:
            solver.advance(pressure="much")  # type: ignore[arg-type]
        except InputError as error:
            kept = error
            assert kept.__traceback__ is not None

    failing()
    solver_of(comm, folder).advance(pressure=1.0)


def holder(folder: Path, seconds: float) -> subprocess.Popen[str]:
    """Another process that has the lock until it ends."""
    words = [sys.executable, "-c", HOLDER, str(folder / ".lock"), str(seconds)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "locked\n"
    return process


def test_another_process(tmp_path: Path) -> None:
    """It is refused while that lives, and gets the folder when it is killed."""
    with holder(tmp_path, 60.0) as process:
        solver = solver_of(MPI.COMM_SELF, tmp_path)
        with pytest.raises(InputError, match="results of another solver"):
            solver.advance(pressure=1.0)
        process.kill()
        process.wait()
        solver.advance(pressure=1.0)


def test_a_run_that_goes_on_waits_for_the_end_of_the_one_before(tmp_path: Path) -> None:
    """Killing mpirun leaves its processes for half a second."""
    with holder(tmp_path, 0.5):
        solver_of(MPI.COMM_SELF, tmp_path, resume=True).advance(pressure=1.0)


def test_trials_of_two_processes_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The other one has removed the file with which this one tries whether it can write."""
    monkeypatch.setattr(Path, "touch", lambda path: None)
    files.make_writable(tmp_path)


def test_a_folder_that_is_gone_is_no_full_disk(comm: MPI.Intracomm, folder: Path) -> None:
    solver = solver_of(comm, folder / "out")
    solver.advance(pressure=1.0)
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(folder / "out")
    comm.barrier()
    with pytest.raises(InputError, match=r"No such file.*folder was removed") as told:
        solver.advance(pressure=2.0)
    assert "free some space" not in str(told.value)


def test_the_script_goes_to_another_folder(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results stay where they were wanted."""
    monkeypatch.chdir(folder)
    solver = solver_of(comm, "out", resume=False)
    history = History("own/history.csv", comm)
    (folder / "elsewhere").mkdir(exist_ok=True)
    os.chdir("elsewhere")
    solver.advance(pressure=1.0)
    history.append({"step": 1})
    comm.barrier()
    assert len(History.read(folder / "out" / "history.csv")) == 1
    assert len(History.read(folder / "own" / "history.csv")) == 1
    assert (folder / "out" / "surface.pvd").exists() and (folder / "out" / "checkpoints").exists()
    comm.barrier()
    assert not any(Path.cwd().iterdir())
