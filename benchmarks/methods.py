"""What solves each load step: counts by method, and what the methods made for cables bring.

    ./run python benchmarks/methods.py [SCENE ...] [--turns N]

A scene is a demo with its argument, if any ("air_dome 10000"), or a case of
`benchmarks/accuracy/cases.py` on n cells ("model 3, smooth: 34"). Its first line has the counts of
BLMVM's iterations, Newton steps, Newton steps of patches (relaxation),
evaluations of energy and gradient, factorisations and minimisations, and the processor time of all
load steps. The second line has the same with BLMVM and H0 alone: under cables without second
derivatives and without relaxation. Both run in turns in one process, after a
first run that compiles everything; times are medians. Both lines have the energies at the end, of
each solver: where these differ, cables took other paths.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import runpy
import statistics
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

from accuracy import cases
from accuracy.minimizers import H0Alone

import crms_fenicsx
from crms_fenicsx import ConvergenceError, Solver
from crms_fenicsx.analysis.equilibrium import system
from crms_fenicsx.energy.minimization.minimizer import Minimizer

DEMOS = (
    "inflated_square", "sliding_cable", "friction_experiment", "capstan", "cable_net",
    "air_dome 10000",
)  # fmt: skip
CASES = [
    f"{name}: {n}"
    for name, meshes in (
        ("cable anywhere", (33, 65, 97)), ("sliding cable", (33, 65, 97)),
        ("model 3, smooth", (16, 24, 34)),
    )
    for n in meshes
]  # fmt: skip
HEAD = ("BLMVM", "Newton", "local", "evaluations", "factorisations", "solves")


class Watched(Solver):
    """A solver that is remembered, with the processor time of its load steps."""

    all: list[Watched]
    seconds: float

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        Watched.all.append(self)

    def advance(self, *arguments: Any, **options: Any) -> Any:
        """As `Solver.advance`."""
        began = time.process_time()
        try:
            return super().advance(*arguments, **options)
        finally:
            Watched.seconds += time.process_time() - began


def run(scene: str, minimizer: type[Minimizer]) -> tuple[float, list[int], list[float], str]:
    """Run a scene: seconds, counts, energies at the ends of its solvers, and how it ended."""
    Watched.all, Watched.seconds, ended = [], 0.0, ""
    system.Minimizer = minimizer  # type: ignore[attr-defined]
    crms_fenicsx.Solver = cases.Solver = Watched  # type: ignore[attr-defined]
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        os.chdir(folder)
        try:
            play(scene)
        except (AssertionError, ConvergenceError) as error:
            ended = str(error).strip().splitlines()[0]
        finally:
            os.chdir(before)
    outcomes = [step.outcome for solver in Watched.all for step in solver.steps]
    newton = sum(o.newton_steps for o in outcomes)
    counts = [sum(o.iterations for o in outcomes) - newton, newton]
    for what in ("local_steps", "evaluations", "factorizations", "solves"):
        counts.append(sum(getattr(o, what) for o in outcomes))
    energies = [solver.steps[-1].energy for solver in Watched.all if solver.steps]
    return Watched.seconds, counts, energies, ended


def play(scene: str) -> None:
    """Do the load steps of a demo or of a case."""
    name, _, n = scene.partition(": ")
    if n:
        case = cases.CASES[name]
        case.run(case.mesh(int(n)), cases.Laws())
        return
    demo, *arguments = name.split()
    path = Path(__file__).resolve().parents[1] / "demos" / f"{demo}.py"
    sys.argv = [str(path), *arguments]
    runpy.run_path(str(path), run_name="__main__")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Counts by method: see the head of this file.")
    known = "; ".join([*DEMOS, *CASES])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"by default {known}")
    parser.add_argument("--turns", type=int, default=3)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    kinds = {"default": Minimizer, "H0 alone": H0Alone}
    print(f"{'':36}{'s CPU':>8}{'ratio':>7}" + "".join(f"{word:>15}" for word in HEAD) + "  W")
    for scene in given.scenes or [*DEMOS, *CASES]:
        run(scene, Minimizer)
        runs: dict[str, list[Any]] = {kind: [] for kind in kinds}
        for turn in range(given.turns):
            for kind in list(kinds) if turn % 2 == 0 else list(kinds)[::-1]:
                runs[kind].append(run(scene, kinds[kind]))
        first = statistics.median(one[0] for one in runs["default"])
        for kind, own in runs.items():
            seconds = statistics.median(one[0] for one in own)
            _, counts, energies, ended = own[-1]
            print(f"{scene:22}{kind:14}{seconds:8.2f}{seconds / first:7.2f}"
                  + "".join(f"{count:15}" for count in counts)
                  + "".join(f"  {energy:.6f}" for energy in energies)
                  + f"  {ended}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
