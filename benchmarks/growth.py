"""Growth of a load step's cost with the number of unknowns and of cables.

Each size is a separate process with two load steps from the stress-free shape: the first inflation
to 0.8 (the cap: 0.6) of the pressure, and on to all of it. Tables, with fitted exponents:

square
    A clamped flat square of 100 cm, E t = 24 kgf/cm, nu = 0.25, 0.01 kgf/cm2. It wrinkles in its
    corners, more finely on finer meshes.
cap
    The roof of `demos/air_dome.py` without cables, in tension everywhere, 0.5 kPa.
cables
    Parallel straight cables (EA = 32000 kgf, 100 cm long) over the square with 64 cells a side.

    ./run python benchmarks/growth.py [square] [cap] [cables] [--most 1e5] [--cables 16] [--quick]

H0 is factorised up to a million unknowns, and with cables always. Times are CPU times.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from parallel import roof
from skip import fresh, most_memory

PRESSURES = {"square": (0.008, 0.01), "cap": (0.3, 0.5)}
WIDTHS = (10, 10, 7, 7, 7, 8, 10, 7, 7, 7, 8, 8)
"""Of the tables' columns: the scene; seconds and counts of both load steps; memory."""


def run(shape: str, size: float, cables: int = 0) -> Any:
    """The figures of a fresh process."""
    return fresh([__file__, "--work", shape, str(size), str(cables)])


def make(shape: str, unknowns: float, cables: int) -> Any:
    """The solver of a scene."""
    if shape == "cap":
        return roof(unknowns, 0, slide=True)[1]
    from mpi4py import MPI

    from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

    n = round(np.sqrt(unknowns / 3)) - 1
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / n, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    for k in range(cables):
        y = 100.0 * ((k + 0.5) / cables + 0.3 / n)
        scene.lay_cable(Cable(EA=32000.0), [(0.0, y), (100.0, y)], L0=100.0)
    return Solver(scene)


def work(shape: str, unknowns: float, cables: int) -> None:
    """One fresh process: a scene and its two load steps."""
    pressures = PRESSURES[shape]
    make(shape, 100.0, min(cables, 1)).advance(pressure=pressures[0])  # compiles what it needs
    before, began = most_memory(), time.process_time()
    solver = make(shape, unknowns, cables)
    figures = [time.process_time() - began]
    for pressure in pressures:
        began = time.process_time()
        done = solver.advance(pressure=pressure).outcome
        figures += [time.process_time() - began, done.iterations, done.evaluations]
        figures += [done.factorizations, done.solves]
    figures += [most_memory() - before, 3 * solver.system.unknowns.n_global]
    print(json.dumps(figures))


def table(label: str, runs: Iterable[tuple[float | None, Any]]) -> None:
    """Figures by what grows (None: the unknowns), and their exponents."""
    names = ("scene, s", *(("{}: s", "iter.", "eval.", "fact.", "solves") * 2), "MiB")
    heads = [n.format("first" if k < 5 else "second") for k, n in enumerate(names)]
    print("\n" + f"{label:>14}" + "".join(f"{h:>{w}}" for h, w in zip(heads, WIDTHS, strict=True)))
    keys, rows = [], []
    for key, (*figures, unknowns) in runs:
        keys.append(unknowns if key is None else key)
        rows.append(figures)
        digits = (2 if isinstance(figure, float) else 0 for figure in figures)
        cells = zip(figures, WIDTHS, digits, strict=True)
        print(f"{keys[-1]:14.0f}" + "".join(f"{f:{w}.{d}f}" for f, w, d in cells), flush=True)
    slopes = np.polyfit(np.log(keys), np.log(np.maximum(rows, 1e-3)), 1)[0]
    exponents = "".join(f"{slope:{w}.2f}" for slope, w in zip(slopes, WIDTHS, strict=True))
    print(f"{'exponent':>14}{exponents}")


def main() -> None:
    """Print the tables asked for."""
    tables = ("square", "cap", "cables")
    parser = argparse.ArgumentParser(description="Growth of cost: see the head of this file.")
    parser.add_argument("tables", nargs="*", help=f"which, of {', '.join(tables)}; default all")
    parser.add_argument("--most", type=float, default=1e5, help="most unknowns; 1e5")
    parser.add_argument("--cables", type=int, default=16, help="most cables; 16")
    parser.add_argument("--quick", action="store_true", help="up to 3e4 unknowns and 4 cables")
    given = parser.parse_args()
    wanted = given.tables or tables
    if set(wanted) - set(tables):
        parser.error(f"there are no such tables: {', '.join(set(wanted) - set(tables))}")
    most, cables = (3e4, 4) if given.quick else (given.most, given.cables)
    sizes = [size for size in (3e3, 1e4, 3e4, 1e5, 3e5, 1e6) if size <= most]
    counts = [2**k for k in range(7) if 2**k <= cables]
    for shape in ("square", "cap"):
        if shape in wanted:
            table(f"{shape}, unkn.", ((None, run(shape, size)) for size in sizes))
    if "cables" in wanted:
        unknowns = 3 * 65.0**2
        table("cables", ((count, run("square", unknowns, count)) for count in counts))
        print(f"{'none: second':>14}{run('square', unknowns)[6]:10.2f} s")


if __name__ == "__main__":
    if "--work" in sys.argv:
        work(sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))
    else:
        main()
