"""Ctrl-C and SIGTERM in the middle of a load step, on all processes or on some; mpirun killed."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from mpi4py import MPI
from processes import MPIRUN, ROOT, run

from crms_fenicsx.foundation.runtime import interrupt

SCRIPT = """
import gc, os, signal, sys, time, weakref
from mpi4py import MPI
from crms_fenicsx import IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.runtime import errors, interrupt
from crms_fenicsx.energy.minimization.potential import Potential

errors.PATIENCE = 5.0
comm, evaluations, whole = MPI.COMM_WORLD, 0, Potential.evaluate
mesh = meshes.rectangle(comm, 100.0, 100.0, 25.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
solver = Solver(scene, results={folder!r}, resume={resume})

def evaluate(self):
    global evaluations
    if len(solver.steps) == 1:
        evaluations += 1
        for number, rank, after in {signals}:
            if comm.rank == rank % comm.size and evaluations == after:
                os.kill(os.getpid(), number)
    try:
        return whole(self)
    except BaseException:  # a collection of garbage is due while PETSc passes the exception on
        collects = gc.isenabled()
        gc.disable()
        evaluate.litter = [litter() for _ in range(5000)]
        if collects:
            gc.enable()
        raise

class Cycle:
    def __init__(self):
        self.me = self

def litter():
    return weakref.ref(Cycle(), lambda reference: None)

Potential.evaluate = evaluate
try:
    solver.advance(pressure=0.01, steps=2)
except BaseException as error:
    assert scene.pressure == 0.005 and len(solver.steps) == 1, (scene.pressure, solver.steps)
    assert len(set(comm.allgather(evaluations))) == 1
    assert all(signal.getsignal(n) is usual for n, usual in interrupt.USUAL.items())
    if {catch}:
        Potential.evaluate = whole
        solver.advance(pressure=0.01)
    else:
        raise
print("energy", repr(scene.energy))
"""


def script(folder: Path, signals: list[tuple[int, int, int]], *launcher: str, resume: bool = False,
           catch: bool = False) -> subprocess.CompletedProcess[str]:  # fmt: skip
    """Run a program to which signals come: (signal, rank, evaluation)."""
    text = SCRIPT.format(folder=str(folder), signals=signals, resume=resume, catch=catch)
    return run(text, *launcher)


def energy(done: subprocess.CompletedProcess[str]) -> float:
    assert done.returncode == 0, done.stderr
    return float(done.stdout.split()[1])


@pytest.fixture(scope="module")
def due(tmp_path_factory: pytest.TempPathFactory) -> float:
    """The energy to which the program comes without any signal."""
    return energy(script(tmp_path_factory.mktemp("whole"), []))


@pytest.mark.parametrize("launcher", [(), MPIRUN], ids=["one process", "three processes"])
def test_stopped_and_resumed(tmp_path: Path, launcher: tuple[str, ...], due: float) -> None:
    """By Ctrl-C, which reaches the processes at different moments, or not all of them."""
    signals = [(int(signal.SIGINT), 0, 5)] + [(int(signal.SIGINT), 2, 7)] * bool(launcher)
    stopped = script(tmp_path, signals, *launcher)
    assert stopped.returncode != 0 and "energy" not in stopped.stdout
    assert stopped.stderr.count("stopped by SIGINT") == 1
    assert "KeyboardInterrupt" in stopped.stderr and "AssertionError" not in stopped.stderr
    resumed = script(tmp_path, [], *launcher, resume=True)
    assert energy(resumed) == pytest.approx(due, rel=1e-9)


def test_batch_systems_end_a_job(tmp_path: Path) -> None:
    """SIGTERM on one process of three ends all; the exit status is that of the signal."""
    stopped = script(tmp_path, [(int(signal.SIGTERM), 1, 5)], *MPIRUN)
    assert stopped.returncode == 128 + signal.SIGTERM, stopped.stderr
    assert stopped.stderr.count("stopped by SIGTERM") == 1
    assert "AssertionError" not in stopped.stderr


def test_a_script_that_catches_it_goes_on(tmp_path: Path, due: float) -> None:
    gone_on = script(tmp_path, [(int(signal.SIGINT), 0, 5)], catch=True)
    assert energy(gone_on) == pytest.approx(due, rel=1e-9)


def test_the_second_one_kills(tmp_path: Path) -> None:
    stopped = script(tmp_path, [(int(signal.SIGINT), 0, 5)] * 2)
    assert stopped.returncode == -signal.SIGINT and "stopped" not in stopped.stderr


def test_handlers_of_others_stay() -> None:
    """Only Python's own are taken over, in the main thread, and given back."""
    own = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with interrupt.postponed(MPI.COMM_SELF):
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGINT) is interrupt._note
    finally:
        signal.signal(signal.SIGTERM, own)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    seen: list[object] = []

    def elsewhere() -> None:
        with interrupt.postponed(MPI.COMM_SELF):
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


def test_a_signal_after_the_last_evaluation_is_not_lost() -> None:
    with pytest.raises(KeyboardInterrupt), interrupt.postponed(MPI.COMM_SELF):
        signal.raise_signal(signal.SIGINT)
    assert not interrupt.noted()
    with pytest.raises(SystemExit) as caught, interrupt.postponed(MPI.COMM_SELF):
        signal.raise_signal(signal.SIGTERM)
    assert caught.value.code == 143


ENDLESS = """
import os
from mpi4py import MPI
from crms_fenicsx import IsotropicMembrane, Scene, Solver, meshes

mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 25.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
solver = Solver(scene, results={folder!r}, resume=True)
solver.advance(pressure=0.01)
if {alive!r}:
    alive = open({alive!r}, "w")
    print(os.getpid(), file=alive, flush=True)
while {alive!r}:
    solver.advance(pressure=0.01)
print("energy", repr(scene.energy))
"""


def test_ranks_of_a_killed_mpirun_end(tmp_path: Path) -> None:
    """Each has a pipe open, which is at its end when all of them are; then the run goes on."""
    pipe, folder = str(tmp_path / "alive"), str(tmp_path / "out")
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    words = [*MPIRUN, sys.executable, "-c", ENDLESS.format(folder=folder, alive=pipe)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    told = b""
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE) as mpirun:
        while told.count(b"\n") < 3:
            assert mpirun.poll() is None, mpirun.communicate()[1].decode()
            time.sleep(0.05)
            told += read(reader)
        mpirun.kill()
    ended = bool(select.select([reader], [], [], 60.0)[0]) and read(reader) == b""
    os.close(reader)
    for rank in [] if ended else told.split():
        os.kill(int(rank), signal.SIGKILL)
    assert ended, "the ranks outlive mpirun by a minute"
    energy(run(ENDLESS.format(folder=folder, alive="")))


def read(pipe: int) -> bytes:
    """What has been written into a pipe by now; nothing, too, where nobody has it open."""
    try:
        return os.read(pipe, 1000)
    except BlockingIOError:
        return b""


def test_broken_pipes_are_errors_of_python() -> None:
    """PETSc would abort, and MPI wait for ever if it was writing of an abort itself."""
    done = run("import crms_fenicsx, os; r, w = os.pipe(); os.close(r); os.write(w, b'a')")
    assert "BrokenPipeError" in done.stderr and done.returncode == 1, done.stderr
