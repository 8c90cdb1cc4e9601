"""Random scenes: each converges, or is refused with an error that states the remedy.

    ./run python benchmarks/fuzz.py --scenes 0 5000 --to results/fuzz.jsonl
    ./run python benchmarks/fuzz.py --features --scenes 0 500 --to results/features.jsonl
    ./run python benchmarks/fuzz.py --scene 1234     one again, with details
    ./run python benchmarks/fuzz.py --report results/fuzz.jsonl
    ./run mpirun -n 3 python -m mpi4py benchmarks/fuzz.py --scenes 0 200 --against FILE
    ./run python benchmarks/fuzz.py --leaks 1000     PETSc's objects and memory over load steps

A scene follows from its number: a membrane with cables (`fuzzing.scenes`), or with `--features` one
with bars, air, water, loads and load cases too (`fuzzing.feature_scenes`). Checked are: only the
package's own errors and warnings, only finite numbers, no hanging; verification of each load step;
tensions and dissipation not negative (`fuzzing.checks`); and the same answer from twins in other
units, or turned, renumbered, loaded in more steps, stopped, saved and so on (`fuzzing.twins`). With
features supports must balance loads, and derivatives be right; without, energies must fall during
minimisation, and no state beside the equilibrium have less. Slack membranes and nets have several
equilibria: a twin that ends in another one is noted with its energy, and is no failure.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
import os
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from fuzzing.checks import Result
from fuzzing.feature_scenes import feature_scene
from fuzzing.runs import run
from fuzzing.scenes import SceneData, scene
from fuzzing.twins import compare
from mpi4py import MPI


def scenes(
    numbers: Iterable[int], draw: Callable[[int], SceneData], given: argparse.Namespace
) -> list[Result]:
    """Run scenes, write a line for each, and compare with the lines of an earlier run."""
    comm = MPI.COMM_WORLD
    earlier = {one.number: one for one in lines(given.against)} if given.against else {}
    ranks = (lambda x: np.full(len(x), comm.size - 1)) if given.empty else None
    results = []
    for number in numbers:
        data = draw(number)
        if given.against or given.twins is not None:
            data = dataclasses.replace(data, twins=tuple(given.twins or ()))
        result = run(data, ranks=ranks)
        if number in earlier:
            was = earlier[number]
            stops = [(one.text, len(one.answers)) for one in (was, result)]
            if stops[0] != stops[1]:
                result.notes.append(f"processes: ended by {stops[0]} and {stops[1]}")
            elif result.answers:
                compare("processes", data, result, was)
        results.append(result)
        if comm.rank == 0 and given.to is not None:
            given.to.parent.mkdir(parents=True, exist_ok=True)
            with given.to.open("a", encoding="utf-8") as file:
                file.write(json.dumps(dataclasses.asdict(result)) + "\n")
        if comm.rank == 0 and result.problems:
            print(number, result.kind, data.twins, result.names, result.problems, flush=True)
    return results


def lines(path: Path) -> list[Result]:
    """The results of an earlier run."""
    return [Result(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def report(results: list[Result]) -> None:
    """Print tables of outcomes, refusals, failures and notes."""
    kinds = sorted({r.kind for r in results})
    outcomes = ("converged", "refused", "failed")
    print(f"{'mesh':20}" + "".join(f"{o:>12}" for o in outcomes))
    for kind in [*kinds, "all"]:
        own = [r.outcome for r in results if kind in ("all", r.kind)]
        print(f"{kind:20}" + "".join(f"{own.count(o):12}" for o in outcomes))
    seconds = np.array([r.seconds for r in results])
    spent = sum(r.verification for r in results)
    print(f"\n{len(results)} scenes, {sum(r.steps for r in results)} load steps, "
          f"{sum(r.evaluations for r in results)} evaluations, {seconds.sum():.0f} s; the "
          f"longest {seconds.max():.0f} s; {sum(r.halvings for r in results)} halvings; "
          f"verification {spent / seconds.sum():.1%} of it")  # fmt: skip
    print("\nrefusals")
    for text, n in Counter(r.text for r in results if r.text).most_common():
        print(f"{n:6}  {text}")
    print("\nnotes")
    notes = [(r.number, note.split(", energ")[0]) for r in results for note in r.notes]
    for text, n in Counter(note for _, note in notes).most_common():
        examples = [number for number, note in notes if note == text][:4]
        print(f"{n:6}  {text}   {examples}")
    print("\nfailures")
    for r in results:
        for problem in dict.fromkeys(r.problems):
            print(f"{r.number:6}  {problem}")


SLIDING = ("no cable", "cable that slides", "friction")


def leaks(steps: int) -> None:
    """PETSc's objects that are never destroyed, and memory, after half of the steps and all."""
    print(f"{'never destroyed':20}{'steps':>7}{'objects':>9}{'created':>9}{'MiB':>8}")
    for what in SLIDING:
        for n in (steps // 2, steps):
            with tempfile.TemporaryDirectory() as folder:
                log = Path(folder) / "log"
                done = subprocess.run(
                    [sys.executable, __file__, "--slide", what, str(n)],
                    env={**os.environ, "PETSC_OPTIONS": f"-log_view :{log}"},
                    capture_output=True, text=True, check=True,
                )  # fmt: skip
                text = log.read_text(encoding="utf-8")
            created = destroyed = 0
            for line in text.split("Object Type")[1].split("=====")[0].splitlines()[1:]:
                words = line.split()
                if len(words) >= 3 and words[-1].isdigit() and words[-2].isdigit():
                    created, destroyed = created + int(words[-2]), destroyed + int(words[-1])
            memory = float(done.stdout.split()[-1])
            print(f"{what:20}{n:7}{created - destroyed:9}{created:9}{memory:8.1f}", flush=True)


def slide(what: str, steps: int) -> None:
    """Load steps back and forth; prints the most memory that they took."""
    from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 12.5, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    cables = []
    if what != "no cable":
        cable = Cable(EA=32000.0, friction=0.2 if what == "friction" else 0.0)
        cables = [scene.lay_cable(cable, [(-5.0, 35.0, 2.0), (105.0, 42.0, 2.0)], L0=109.0)]
    solver = Solver(scene)
    for k in range(steps):
        way = (0.0, float(4.0 * np.cos(k)), 0.0)
        pressure = float(0.01 * (1 + 0.3 * np.sin(k)))
        solver.advance(pressure=pressure, move=dict.fromkeys(cables, way))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description="Random scenes: see the head of this file.")
    parser.add_argument("--features", action="store_true", help="scenes of many features at once")
    parser.add_argument("--scenes", nargs=2, type=int, metavar=("FIRST", "END"))
    parser.add_argument("--scene", type=int, help="one scene, in detail")
    parser.add_argument("--to", type=Path, help="file to which a line is added for each scene")
    parser.add_argument("--against", type=Path, help="results to compare with, without twins")
    parser.add_argument("--twins", nargs="*", help="which, instead of each scene's own")
    parser.add_argument("--empty", action="store_true", help="leave the first rank without cells")
    parser.add_argument("--report", type=Path, nargs="+", help="files of results")
    parser.add_argument("--leaks", type=int, metavar="STEPS")
    parser.add_argument("--slide", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    draw = feature_scene if given.features else scene
    if given.slide:
        slide(given.slide[0], int(given.slide[1]))
    if given.leaks:
        leaks(given.leaks)
    if given.scene is not None:
        logging.basicConfig(level=logging.DEBUG, stream=sys.stdout)
        data = draw(given.scene)
        print(dataclasses.replace(data, points=data.points[:2], cells=data.cells[:2]))
        for result in scenes([given.scene], draw, given):
            print(json.dumps(dataclasses.asdict(result), indent=1))
    results = scenes(range(*given.scenes), draw, given) if given.scenes else []
    for path in given.report or []:
        results += lines(path)
    if results and MPI.COMM_WORLD.rank == 0:
        report(results)


if __name__ == "__main__":
    main()
