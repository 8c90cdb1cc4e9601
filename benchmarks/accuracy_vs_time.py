"""Run time against error, for many cases and methods: a table, a figure per case and a summary.

    ./run python benchmarks/accuracy_vs_time.py [CASE ...] [--methods METHOD ...] [--quick]
                                                [--limit SECONDS] [--results FOLDER]

Each run is a process with one thread: after a warm-up on the coarsest mesh, which compiles and
loads everything, it repeats the case and takes the median. CPU time is measured from the mesh to
the equilibrium; on an idle machine it equals the wall time, which the table has too. A method that
does not converge within the limit on one mesh is not tried on finer ones. "Extrapolated" are limits
of `study.convergence` over three meshes, n the finest, timed with all of them; a table compares
them with a run on a mesh as fine, evaluations in units of those on that mesh. `accuracy/` has
cases, methods, references and figures; Kratos is included once `benchmarks/kratos/install` has run.

FOLDER (results/accuracy by default) then holds runs.csv, a figure CASE.png for each case and
summary.md; results of other cases stay. `--quick`, on coarse meshes, takes about two minutes, the
complete benchmark up to 25.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

from accuracy.cases import CASES, Laws
from accuracy.figure import draw
from accuracy.kratos import folder as kratos_folder
from accuracy.methods import METHODS, runs
from accuracy.report import Row, read_csv, row, summary, write_csv

LIMIT, QUICK_LIMIT = 20.0, 4.0
STARTING = 150.0
"""Seconds that a process may take beside its runs, with forms to compile."""


def measure(case: str, method: str, n: int, laws: Laws, limit: float) -> dict:
    """The figures of one run, from a fresh process."""
    steps = str(laws.steps or 0)
    command = [sys.executable, __file__, "--work", case, method, str(n), steps, str(limit)]
    environment = os.environ | {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    try:
        out = subprocess.run(
            command, capture_output=True, text=True, env=environment, timeout=8 * limit + STARTING
        )
    except subprocess.TimeoutExpired:
        return {"converged": False, "reason": "killed", "seconds": limit, "found": {}}
    lines = [line for line in out.stdout.splitlines() if line.startswith("FIGURES ")]
    if not lines:
        return {"converged": False, "reason": out.stderr.strip().splitlines()[-1], "found": {}}
    return json.loads(lines[-1].removeprefix("FIGURES "))


def benchmark(
    cases: list[str], methods: list[str], quick: bool, limit: float, folder: Path
) -> list[Row]:
    """Run cases, and write what there is after each; rows of other cases are kept."""
    rows = [r for r in read_csv(folder / "runs.csv") if r.case not in cases]
    for name in cases:
        case = CASES[name]
        print(f"\n{case.title}", flush=True)
        for key in methods:
            method, failed = METHODS[key], ""
            for n, laws in runs(case, method, quick):
                figures = {"converged": False, "reason": failed, "found": {}}
                if not failed:
                    figures = measure(name, key, n, laws, limit)
                rows.append(row(name, key, n, laws, figures))
                print(rows[-1].line(), flush=True)
                if not rows[-1].converged and not method.stepwise:
                    failed = failed or f"not tried, as it failed with n = {n}"
        write_csv(folder / "runs.csv", rows)
        own = [r for r in rows if r.case == name]
        draw(folder / f"{name.replace(', ', ' ').replace(' ', '_')}.png", case, own)
    return rows


def main() -> None:
    """Do what is asked for."""
    parser = argparse.ArgumentParser(description="Run time against error: see this file's head.")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--quick", action="store_true", help="coarse meshes only")
    parser.add_argument("--limit", type=float, help="seconds for a run")
    parser.add_argument("--results", type=Path, default=Path("results/accuracy"))
    given = parser.parse_args()
    if set(given.cases) - set(CASES):
        parser.error(f"there are no such cases: {', '.join(set(given.cases) - set(CASES))}")
    methods = list(given.methods)
    if "kratos" in methods and not kratos_folder().exists():
        print("without Kratos: benchmarks/kratos/install has not been run")
        methods.remove("kratos")
    given.results.mkdir(parents=True, exist_ok=True)
    limit = given.limit or (QUICK_LIMIT if given.quick else LIMIT)
    rows = benchmark(given.cases or list(CASES), methods, given.quick, limit, given.results)
    text = summary(rows)
    (given.results / "summary.md").write_text(text)
    print(f"\n{text}")


def work(case: str, method: str, n: str, steps: str, limit: str) -> None:
    """One run, in a process of its own."""
    from accuracy.worker import work as run

    print("FIGURES " + json.dumps(run(case, method, int(n), int(steps) or None, float(limit))))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(*sys.argv[2:])
    else:
        main()
