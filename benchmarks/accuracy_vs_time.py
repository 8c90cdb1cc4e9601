"""Run time against error, for many cases and methods: a table, a figure per case and a summary.

    ./run python benchmarks/accuracy_vs_time.py [CASE ...] [--methods METHOD ...] [--quick]
                                    [--limit SECONDS] [--results FOLDER] [--pictures FOLDER]

Each method on each mesh is a process with one thread. After a warm-up on the coarsest mesh, which
compiles and loads everything, the methods of a mesh run in turns, so that other work on the machine
hits all of them alike, and medians are taken. CPU time is measured from the mesh to the
equilibrium; on an idle machine it equals the wall time, which the table has too. A method that does
not converge within the limit on one mesh is not tried on finer ones. "Extrapolated" are limits of
`study.convergence` over three meshes, n the finest, timed with all of them; a table compares them
with a run on a mesh as fine, evaluations in units of those on that mesh. `accuracy/` has cases,
methods, references and figures; Kratos is included once `benchmarks/kratos/install` has run.

The results folder (results/accuracy by default) then holds runs.csv and summary.md, the other one
(the same by default) a figure CASE.png for each case; results of other cases stay. `--quick`, on
coarse meshes, takes about five minutes, the complete benchmark up to an hour.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from accuracy.cases import CASES, Laws
from accuracy.figure import draw
from accuracy.kratos import folder as kratos_folder
from accuracy.methods import METHODS, runs
from accuracy.report import Row, read_csv, row, summary, write_csv

LIMIT, QUICK_LIMIT = 20.0, 4.0
STARTING = 150.0
"""Seconds that a process may take beside its runs, with forms to compile."""

TURNS, ENOUGH = 5, 0.1
"""Runs of each method on a mesh, and part of the time limit after which there are no more."""

MEDIANS = ("seconds", "wall", "of_finest", "solving")
Runs = Sequence[tuple[str, Laws]]


class Worker:
    """A process that repeats a method's run on a mesh."""

    def __init__(self, case: str, method: str, n: int, laws: Laws, limit: float) -> None:
        self.limit, self.found = limit, list[dict]()
        steps = str(laws.steps or 0)
        command = [sys.executable, __file__, "--work", case, method, str(n), steps, str(limit)]
        one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
        self._process = subprocess.Popen(
            command, text=True, env=os.environ | one,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._read("READY")

    @property
    def goes_on(self) -> bool:
        """Whether it is to run again."""
        spent = sum(own.get("seconds", self.limit) for own in self.found)
        converged = all(own["converged"] for own in self.found)
        return len(self.found) < TURNS and spent < ENOUGH * self.limit and converged

    def run(self) -> None:
        """Run once more."""
        with contextlib.suppress(BrokenPipeError):  # then nothing will be read either
            print(file=self._process.stdin, flush=True)
        line = self._read("FIGURES ")
        lost = {"converged": False, "reason": "killed", "seconds": self.limit, "found": {}}
        self.found.append(json.loads(line.removeprefix("FIGURES ")) if line else lost)

    def end(self) -> dict:
        """End the process; the figures, with medians of times."""
        self._process.communicate()
        kept = [own for own in self.found if own["converged"]] or self.found
        medians = {
            name: statistics.median(own[name] for own in kept)
            for name in MEDIANS
            if name in kept[0]
        }
        return self.found[-1] | medians | {"runs": len(self.found)}

    def _read(self, word: str) -> str:
        """The next line that begins with a word; empty if the process ends or takes too long."""
        assert self._process.stdout is not None
        timer = threading.Timer(8 * self.limit + STARTING, self._process.kill)
        timer.start()
        lines = iter(self._process.stdout.readline, "")
        found = next((line for line in lines if line.startswith(word)), "")
        timer.cancel()
        return found


def in_turns(case: str, n: int, which: Runs, limit: float) -> list[dict]:
    """The figures of methods on a mesh, which run in turns."""
    workers = [Worker(case, method, n, laws, limit) for method, laws in which]
    while any(worker.goes_on for worker in workers):
        for worker in workers:
            if worker.goes_on:
                worker.run()
    return [worker.end() for worker in workers]


def benchmark(
    cases: list[str], methods: list[str], quick: bool, limit: float, folders: tuple[Path, Path]
) -> list[Row]:
    """Run cases, and write what there is after each; rows of other cases are kept."""
    results, pictures = folders
    rows = [r for r in read_csv(results / "runs.csv") if r.case not in cases]
    for name in cases:
        case, own, failed = CASES[name], list[Row](), dict[str, str]()
        print(f"\n{case.title} (load average {os.getloadavg()[0]:.1f})", flush=True)
        wanted = {(n, m, laws) for m in methods for n, laws in runs(case, METHODS[m], quick)}
        for n in sorted({n for n, _, _ in wanted}):
            which = [(m, laws) for k, m, laws in wanted if k == n]
            which.sort(key=lambda one: (methods.index(one[0]), one[1].steps or 0))
            tried = [one for one in which if one[0] not in failed]
            for (m, laws), figures in zip(tried, in_turns(name, n, tried, limit), strict=True):
                own.append(row(name, m, n, laws, figures))
                if not own[-1].converged and not METHODS[m].stepwise:
                    failed[m] = f"not tried, as it failed with n = {n}"
                print(own[-1].line(), flush=True)
            for m, laws in which:
                if (m, laws) not in tried:
                    missing = {"converged": False, "reason": failed[m], "found": {}}
                    own.append(row(name, m, n, laws, missing))
        own.sort(key=lambda r: methods.index(r.method))
        rows += own
        write_csv(results / "runs.csv", rows)
        draw(pictures / f"{name.replace(', ', ' ').replace(' ', '_')}.png", case, own)
    return rows


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description="Run time against error: see this file's head.")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--quick", action="store_true", help="coarse meshes only")
    parser.add_argument("--limit", type=float, help="seconds for a run")
    parser.add_argument("--results", type=Path, default=Path("results/accuracy"))
    parser.add_argument("--pictures", type=Path, help="folder of figures")
    given = parser.parse_args()
    if set(given.cases) - set(CASES):
        parser.error(f"there are no such cases: {', '.join(set(given.cases) - set(CASES))}")
    methods = list(given.methods)
    if "kratos" in methods and not kratos_folder().exists():
        print("without Kratos: benchmarks/kratos/install has not been run")
        methods.remove("kratos")
    folders = given.results, given.pictures or given.results
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
    limit = given.limit or (QUICK_LIMIT if given.quick else LIMIT)
    rows = benchmark(given.cases or list(CASES), methods, given.quick, limit, folders)
    text = summary(rows)
    (given.results / "summary.md").write_text(text)
    print(f"\n{text}")


def work(case: str, method: str, n: str, steps: str, limit: str) -> None:
    """Runs on request, in a process of its own."""
    from accuracy.worker import serve

    serve(case, method, int(n), int(steps) or None, float(limit))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(*sys.argv[2:])
    else:
        main()
