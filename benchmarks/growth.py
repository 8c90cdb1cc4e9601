"""How the cost of a load step grows with the number of unknowns, and of cables.

A clamped square of 100 cm, E t = 24 kgf/cm, nu = 0.25, is inflated from flat to a follower pressure
of 0.008 kgf/cm2 and then to 0.01 kgf/cm2; each size in a process of its own. Tables, with the
exponents fitted to them:

unknowns
    Without cables, by the number of unknowns: up to 60 000 H0 is factorised, beyond that algebraic
    multigrid takes over.
cables
    Parallel straight cables (EA = 32000 kgf, 100 cm long) over one mesh.

    ./run python benchmarks/growth.py [unknowns] [cables] [--most 1e5] [--quick]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from typing import Any

import numpy as np
from skip import most_memory

WIDTHS = (10, 8, 12, 7, 7, 7, 8, 12, 7, 7, 7, 8)
"""Of the table's columns: scene, memory; seconds and counts of each load step."""


def run(n: int, cables: int) -> Any:
    """The figures of a fresh process."""
    command = [sys.executable, __file__, "--work", str(n), str(cables)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def make(n: int, cables: int) -> tuple[Any, float]:
    """The solver of a square with cables, and the seconds that it took to make."""
    from mpi4py import MPI

    from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

    began = time.perf_counter()
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / n, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    for k in range(cables):
        y = 100.0 * (k + 0.5) / cables + 0.3 * 100.0 / n
        scene.lay_cable(Cable(EA=32000.0), [(0.0, y), (100.0, y)], L0=100.0)
    return Solver(scene), time.perf_counter() - began


def work(n: int, cables: int) -> None:
    """One fresh process: both load steps with n cells a side."""
    make(4, min(cables, 1))[0].advance(pressure=0.008)  # compiles, or loads what is compiled
    before = most_memory()
    solver, seconds = make(n, cables)
    figures: dict[str, Any] = {"scene": seconds}
    for name, pressure in (("first", 0.008), ("second", 0.01)):
        began = time.perf_counter()
        done = solver.advance(pressure=pressure).outcome
        spent = time.perf_counter() - began
        counts = [done.iterations, done.evaluations, done.factorizations, done.solves]
        figures[name] = [spent, *counts]
    figures["unknowns"] = 3 * solver.system.unknowns.n_global
    figures["memory"] = most_memory() - before
    print(json.dumps(figures))


def table(label: str, keys: list[float], runs: list[Any]) -> None:
    """Figures by what grows, and their exponents."""
    print(f"\n{label:>10}{'scene, s':>10}{'MiB':>8}", end="")
    for name in ("first: s", "second: s"):
        print(f"{name:>12}{'iter.':>7}{'eval.':>7}{'fact.':>7}{'solves':>8}", end="")
    print()
    columns = []
    for key, own in zip(keys, runs, strict=True):
        columns.append([own["scene"], own["memory"], *own["first"], *own["second"]])
        print(f"{key:10.0f}{own['scene']:10.2f}{own['memory']:8.0f}", end="")
        for name in ("first", "second"):
            spent, *counts = own[name]
            print(
                f"{spent:12.2f}"
                + "".join(f"{n:{w}}" for n, w in zip(counts, (7, 7, 7, 8), strict=True)),
                end="",
            )
        print(flush=True)
    values = np.maximum(columns, 1e-3)
    slopes = np.polyfit(np.log(keys), np.log(values), 1)[0]
    print(
        f"{'exponent':>10}"
        + "".join(f"{slope:{w}.2f}" for slope, w in zip(slopes, WIDTHS, strict=True))
    )


def unknowns(most: float, quick: bool) -> None:
    """Sizes up to the most unknowns, without cables."""
    sizes = [n for n in (1e3, 1e4, 3e4, 1e5, 3e5, 1e6) if n <= 1.01 * most and (quick or n > 1e3)]
    runs = [run(round(np.sqrt(size / 3)) - 1, 0) for size in sizes]
    table("unknowns", [own["unknowns"] for own in runs], runs)


def cables(n: int, most: int) -> None:
    """Numbers of cables over one mesh."""
    counts = [count for count in (1, 2, 4, 8, 16, 32, 64) if count <= most]
    print(f"\n{n} cells a side, without a cable the second load step takes "
          f"{run(n, 0)['second'][0]:.2f} s")  # fmt: skip
    table("cables", counts, [run(n, count) for count in counts])


def main() -> None:
    """Print the tables asked for."""
    tables = ("unknowns", "cables")
    parser = argparse.ArgumentParser(description="Growth of cost: see the head of this file.")
    parser.add_argument("tables", nargs="*", help=f"which, of {', '.join(tables)}; default both")
    parser.add_argument("--most", type=float, default=1e5, help="most unknowns; 1e5")
    parser.add_argument("--quick", action="store_true", help="up to 3e4 unknowns and 8 cables")
    given = parser.parse_args()
    wanted = given.tables or tables
    if set(wanted) - set(tables):
        parser.error(f"there are no such tables: {', '.join(set(wanted) - set(tables))}")
    if "unknowns" in wanted:
        unknowns(3e4 if given.quick else given.most, given.quick)
    if "cables" in wanted:
        cables(32 if given.quick else 128, 8 if given.quick else 64)


if __name__ == "__main__":
    if "--work" in sys.argv:
        work(int(sys.argv[2]), int(sys.argv[3]))
    else:
        main()
