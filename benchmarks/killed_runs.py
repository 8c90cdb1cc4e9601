"""Runs that are killed at random moments, and resumed; a full disk; a rank that dies.

    ./run python benchmarks/killed_runs.py [KILLS [SEED]]

A small run with two cables, load steps in three calls of `advance`, pictures in between and
checkpoints is ended by SIGKILL, mostly on one process, every fourth time on three, of which one or
all are killed, or mpirun alone. Half of the kills come at random times, the others at random times
after a random write has begun. Then all files with their final names are read completely, and the
run is resumed: some runs are killed again, those on three processes resume on another number. The
results are compared with an uninterrupted run. Prints the times of the kills and the findings, and
fails if a file is damaged or a result differs.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "scenes"))

from vtu_file import read_vtu

from crms_fenicsx import Cable, Friction, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import History, draw

PHASES = ("start", "solve", "results", "checkpoint", "picture", "replay", "between")
"""What a run is doing."""
SERIAL, PARALLEL = 1e-10, 1e-6
"""Relative differences that are rounding, of a resumed run on one and on several processes; in a
step the forces are balanced to 1e-9, and direct solvers on several never do the same twice."""


class Watched:
    """Tells other processes what a run is doing, in a file that outlives it."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(2 * len(PHASES)))
        with open(path, "r+b") as file:
            self.memory = mmap.mmap(file.fileno(), 2 * len(PHASES))
        self.stack = ["start"]

    def watch(self, owner: object, name: str, phase: str) -> None:
        """Let calls of a method of a class, or of a function of a module, be a phase."""
        whole = getattr(owner, name)

        def watched(*arguments: Any, **options: Any) -> Any:
            self.stack.append(phase)
            self.tell(phase)
            try:
                return whole(*arguments, **options)
            finally:
                self.stack.pop()
                self.tell(self.stack[-1] if len(self.stack) > 1 else "between")

        setattr(owner, name, watched)

    def tell(self, phase: str) -> None:
        """Count the entries of the phase, and say which it is now."""
        number = PHASES.index(phase)
        self.memory[len(PHASES) + number] = min(self.memory[len(PHASES) + number] + 1, 255)
        self.memory[0] = number


def phase_of(path: Path) -> tuple[str, dict[str, int]]:
    """What a run is doing, and how often it has begun each phase."""
    if not path.exists() or path.stat().st_size < 2 * len(PHASES):
        return "start", dict.fromkeys(PHASES, 0)
    found = path.read_bytes()
    return PHASES[found[0]], dict(zip(PHASES, found[len(PHASES) :], strict=True))


def scene_of(comm: MPI.Intracomm) -> Scene:
    """The membrane of the run."""
    mesh = meshes.rectangle(comm, 100.0, 100.0, size=100 / 8, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    return scene


def run(folder: Path, resume: bool) -> None:
    """The run, in a process of its own; its result is a line of numbers."""
    from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
    from crms_fenicsx.results.checkpoint.journal import Journal
    from crms_fenicsx.results.output.recorder import Recorder

    comm = MPI.COMM_WORLD
    (folder / f"pid{comm.rank}").write_text(str(os.getpid()))
    if comm.rank == 0:
        watched = Watched(folder / "phase")
        watched.watch(EquilibriumSearch, "find", "solve")
        watched.watch(Recorder, "write", "results")
        watched.watch(Journal, "keep", "checkpoint")
        watched.watch(Journal, "begin", "replay")
        watched.watch(sys.modules[__name__], "draw", "picture")
    scene = scene_of(comm)
    solver = Solver(scene, results=folder / "out", resume=resume)
    solver.advance(pressure=0.01, steps=2)
    draw(solver, folder / "out" / "inflated.png", dpi=50)
    rough = scene.lay_cable(Cable(9000.0, friction=Friction(0.3)), [(0, 33), (100, 41)], tension=15)
    smooth = scene.lay_cable(Cable(9000.0), [(30, -20, 0), (42, 120, 0)], tension=15.0)
    solver.advance(move={smooth: (5.0, 0.0, -3.0), rough.end: (0.0, 0.0, -2.0)}, steps=3)
    solver.advance(L0={rough: 0.995 * rough.L0}, pressure=0.012, steps=2)
    draw(solver, folder / "out" / "tightened.png", dpi=50)
    if comm.rank == 0:
        numbers = (rough.tension, smooth.tension, scene.energy, *solver.history["energy"])
        print("result", *map(repr, map(float, numbers)), flush=True)


def started(folder: Path, ranks: int, resume: bool) -> subprocess.Popen[str]:
    """Start the run."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    words = [sys.executable, __file__, "--run", str(folder), *["--resume"] * resume]
    (folder / "phase").unlink(missing_ok=True)
    own = {name: text for name, text in os.environ.items() if not name.startswith(("OMPI_C", "PM"))}
    return subprocess.Popen(
        [*launcher, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=own
    )


def result(process: subprocess.Popen[str]) -> np.ndarray:
    """What a run that ends by itself has come to."""
    said, errors = process.communicate(timeout=120)
    lines = [line for line in said.splitlines() if line.startswith("result")]
    if process.returncode or not lines:
        raise RuntimeError(f"the run ended with {process.returncode}: {errors[-3000:]}")
    return np.array(list(map(float, lines[0].split()[1:])))


def kill(
    process: subprocess.Popen[str],
    folder: Path,
    ranks: int,
    seconds: float,
    rng: np.random.Generator,
) -> str | None:
    """End a run at a random moment; returns what it was doing, None if it had ended before."""
    writes = rng.random() < 0.5
    phase, number = str(rng.choice(["checkpoint", "results", "picture"])), int(rng.integers(1, 8))
    number = min(number, 2) if phase == "picture" else number
    wait, begun = rng.random() * (0.04 if writes else seconds), None
    while begun is None or time.monotonic() < begun + wait:
        if process.poll() is not None:
            break
        _, counts = phase_of(folder / "phase")
        if begun is None and (counts[phase] >= number if writes else sum(counts.values()) > 0):
            begun = time.monotonic()
        time.sleep(0.0005)
    doing, _ = phase_of(folder / "phase")
    own = [int(path.read_text()) for path in folder.glob("pid*")]
    choices = [own] if ranks == 1 else [own, [int(rng.choice(own))], [process.pid]]
    victims = choices[int(rng.integers(len(choices)))]
    ended = process.poll() is not None
    for victim in [] if ended else victims:
        try:
            os.kill(victim, signal.SIGKILL)
        except ProcessLookupError:
            ended = True
    process.communicate(timeout=60)
    deadline = time.monotonic() + 60.0
    while any(map(alive, own)):  # the other ranks end as well
        if time.monotonic() > deadline:
            raise RuntimeError(f"of the processes {own} some go on after {victims} were killed")
        time.sleep(0.01)
    return None if ended else doing


def alive(process: int) -> bool:
    """Whether a process runs: it is there, and not only waiting for its parent to notice."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def damaged(folder: Path) -> list[str]:
    """Files of a run that have their names and cannot be read, or are not what they should be."""
    from matplotlib.image import imread

    found = []

    def check(name: object, read: Callable[[], object]) -> None:
        try:
            read()
        except Exception as error:
            found.append(f"{name}: {error!r}")

    out = folder / "out"
    if (out / "history.csv").exists():
        check("history.csv", lambda: History.read(out / "history.csv")["energy"])
    for series in out.glob("*.pvd"):
        check(series.name, lambda series=series: ElementTree.parse(series))
        for entry in ElementTree.parse(series).getroot().iter("DataSet"):
            check(entry.attrib["file"], lambda entry=entry: read_vtu(out / entry.attrib["file"]))
    for step in out.glob("steps/[sc]*.vtu"):
        check(step.name, lambda step=step: read_vtu(step))
    for picture in out.glob("[a-z]*.png"):
        check(picture.name, lambda picture=picture: imread(picture))
    for place in {path.name.removeprefix(".old-") for path in out.glob("checkpoints/*")}:
        if place.isdigit():
            load = lambda place=place: Solver(scene_of(MPI.COMM_SELF)).load(  # noqa: E731
                out / "checkpoints" / place
            )
            check(f"checkpoints/{place}", load)
    return found


def difference(found: np.ndarray, due: np.ndarray) -> float:
    """Largest relative difference of tensions and energies."""
    if len(found) != len(due):
        return np.inf
    return float(np.max(np.abs(found - due) / np.abs(due)))


def killed_runs(top: Path, kills: int, seed: int) -> int:
    """Kill runs; returns how many went wrong."""
    (top / "whole").mkdir()
    due = result(started(top / "whole", 1, False))
    seconds = {}
    for ranks in (1, 3):
        again = top / f"again{ranks}"
        again.mkdir()
        began = time.monotonic()
        result(started(again, ranks, False))
        seconds[ranks] = time.monotonic() - began
    fell: Counter[str] = Counter()
    bad, worst, wrong, number = [], {1: 0.0, 3: 0.0}, 0, 0
    print(f"{'kill':>4} {'ranks':>5} {'resumed':>7} {'in':10} {'damaged':>7} {'difference':>10}")
    while sum(fell.values()) < kills:
        rng = np.random.default_rng((seed, number))
        ranks = 3 if number % 4 == 3 else 1
        folder = top / f"run{number}"
        folder.mkdir()
        number += 1
        where, resume = [], False
        for _ in range(1 + (rng.random() < 0.25)):
            process = started(folder, ranks, resume)
            doing = kill(process, folder, ranks, seconds[ranks] * 0.8, rng)
            resume = True
            if doing is not None:
                where.append(doing)
                fell[doing] += 1
                bad += damaged(folder)
        then = int(rng.integers(1, 4)) if ranks > 1 else 1
        apart = difference(result(started(folder, then, True)), due)
        bad += damaged(folder)
        several = max(ranks, then)
        worst[3 if several > 1 else 1] = max(worst[3 if several > 1 else 1], apart)
        good = apart <= (PARALLEL if several > 1 else SERIAL)
        wrong += not good
        print(f"{sum(fell.values()):4} {ranks:5} {then:7} {'+'.join(where) or 'ended':10} "
              f"{len(bad):7} {apart:10.1e}{'' if good else '  differs'}", flush=True)  # fmt: skip
        shutil.rmtree(folder)
    print("\nkills while:", ", ".join(f"{phase} {n}" for phase, n in fell.most_common()))
    print(f"files damaged: {len(bad)}", *bad, sep="\n")
    print(f"largest difference: {worst[1]:.1e} on one process, {worst[3]:.1e} on several")
    return wrong + len(bad)


def full_disk(top: Path) -> int:
    """A disk that is full at some write; with more space the run is resumed."""
    small, wrong = top / "small", 0
    small.mkdir()
    due = result(started_on_disk(top, small, None, False))
    clear(small)
    mounted = mount(small, 64)
    kind = "a small disk" if mounted else "a limit for the size of files"
    print(f"\na full disk, tried with {kind}:")
    try:
        for size in (40, 56, 72, 88, 104, 120, 136, 152, 168):
            clear(small)
            if mounted:
                mount(small, size, again=True)
            process = started_on_disk(top, small, None if mounted else size * 60, False)
            _, errors = process.communicate(timeout=120)
            last = errors.strip().splitlines()[-1] if errors.strip() else "ended well"
            told = process.returncode == 0 or "InputError" in last
            bad = damaged(small)
            if mounted:
                mount(small, 64_000, again=True)
            apart = difference(result(started_on_disk(top, small, None, True)), due)
            good = told and not bad and apart <= SERIAL
            wrong += not good
            print(f"{size:4}: {last[:120]}; damaged {len(bad)}; resumed: {apart:.1e}"
                  f"{'' if good else '  WRONG'}", flush=True)  # fmt: skip
    finally:
        if mounted:
            ctypes.CDLL(None).umount(os.fsencode(small))
    return wrong


def mount(folder: Path, size: int, again: bool = False) -> bool:
    """Make a folder a disk of some size (KiB); returns whether the system lets us."""
    options, remount = f"size={size}k".encode(), 32
    flags = remount if again else 0
    mounted = ctypes.CDLL(None).mount(b"none", os.fsencode(folder), b"tmpfs", flags, options)
    return bool(mounted == 0)


def clear(folder: Path) -> None:
    """Remove what is in a folder."""
    for path in folder.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def started_on_disk(top: Path, folder: Path, most: int | None, resume: bool) -> Any:
    """Start a run that leaves results only in a folder, with a limit for their sizes (bytes)."""
    import resource

    def limit() -> None:
        if most is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    words = [sys.executable, __file__, "--plain", str(folder), *["--resume"] * resume]
    return subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=limit, cwd=top
    )


def plain(folder: Path, resume: bool) -> None:
    """A run without pictures."""
    solver = Solver(scene_of(MPI.COMM_WORLD), results=folder / "out", resume=resume)
    solver.advance(pressure=0.01, steps=3)
    cable = solver.scene.lay_cable(Cable(9000.0), [(30, -20, 0), (42, 120, 0)], tension=15.0)
    solver.advance(move={cable: (5.0, 0.0, -3.0)}, steps=3)
    print("result", *map(repr, map(float, (cable.tension, *solver.history["energy"]))))


def main(kills: int = 50, seed: int = 0) -> int:
    """Kill runs, and fill disks; returns how many went wrong."""
    with tempfile.TemporaryDirectory() as name:
        return killed_runs(Path(name), kills, seed) + full_disk(Path(name))


if __name__ == "__main__":
    if "--run" in sys.argv:
        run(Path(sys.argv[2]), "--resume" in sys.argv)
    elif "--plain" in sys.argv:
        try:
            plain(Path(sys.argv[2]), "--resume" in sys.argv)
        except InputError as error:
            raise SystemExit(f"InputError: {error}") from None
    else:
        raise SystemExit(main(*map(int, sys.argv[1:])) > 0)
