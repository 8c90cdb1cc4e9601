"""Ctrl-C and SIGTERM in the middle of a load step, on all processes or on some."""

from __future__ import annotations

import signal
import subprocess
import threading
from pathlib import Path

import pytest
from mpi4py import MPI
from processes import MPIRUN, run

from crms_fenicsx.runtime import interrupt

SCRIPT = """
import os, signal, sys, time
from mpi4py import MPI
from crms_fenicsx import IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.runtime import errors, interrupt
from crms_fenicsx.minimization.potential import Potential

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
    return whole(self)

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
    assert stopped.returncode == 128 + signal.SIGTERM
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
