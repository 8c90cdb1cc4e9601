"""Friction along cables: accuracy on a drum and on the inflated square, and cost.

    ./run python benchmarks/capstan.py

law
        A rope over half a drum is pulled until all of it slides: error of the ratio of its end
        tensions against exp(mu pi), on a regular and an irregular mesh.
    stick
        The rope, under tension, is pulled so little that it sticks on part of the drum, then let
        back: errors of the tension at the pulled end against the exact elastic solution.
    square
        A cable across the inflated square of 100 cm, anchored beyond it on both sides; one end is
        pulled down by 16 cm in two steps (coefficient 0.3 along, 0 or 0.3 sideways): tensions at
        both ends, dissipation, and the work of the second step, with and without friction along.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "scenes"))

from cabled_square import order, sheet
from roped_drum import WRAP, exact_tensions, roped

from crms_fenicsx import Cable, Friction, Solver

COMM = MPI.COMM_WORLD
SIZES = (10, 20, 40, 80)


def law() -> None:
    """Print the errors of the capstan's ratio."""
    print("law: error of T2/T1 by number of cells around the drum")
    for jitter in (0.0, 0.25):
        for mu in (0.1, 0.3, 1.0):
            errors = []
            for n in SIZES:
                scene, rope = roped(COMM, n, mu, jitter=jitter)
                Solver(scene).advance(move={rope.end: (0.0, 0.0, -0.1)})
                errors.append(rope.tensions[-1] / rope.tensions[0] / np.exp(mu * WRAP) - 1)
            line = "  ".join(f"{n}: {e:+.1e}" for n, e in zip(SIZES, errors, strict=True))
            print(f"  jitter {jitter:4}, mu {mu}:  {line}")


def stick() -> None:
    """Print the errors of the pulled end's tension."""
    print("stick: error of the tension at the pulled end, pulled / let back")
    pulls = (0.012, -0.008)
    for jitter in (0.0, 0.25):
        for mu in (0.3, 1.0):
            errors: list[list[float]] = []
            for n in SIZES:
                scene, rope = roped(COMM, n, mu, tension=5.0, jitter=jitter)
                solver = Solver(scene)
                errors.append([])
                for k, pull in enumerate(pulls, start=1):
                    solver.advance(move={rope.end: (0.0, 0.0, -pull)})
                    exact = exact_tensions(5.0, mu, pulls[:k])[-1]
                    errors[-1].append(rope.tensions[-1] / exact - 1)
            cells = zip(SIZES, errors, strict=True)
            line = "  ".join(f"{n}: {a:+.1e} / {b:+.1e}" for n, (a, b) in cells)
            rate = order([1 / n for n in SIZES], [abs(a) for a, _ in errors])
            print(f"  jitter {jitter:4}, mu {mu}:  {line}  order {rate:.1f}")


def square() -> None:
    """Print what friction does to a cable on the inflated square, and what it costs."""
    print("square: tensions at both ends")
    frictions = (0.0, Friction(0.0, along=0.3), Friction(0.3), Friction(0.3, along=0.3))
    for kind in ("structured", "unstructured"):
        for friction in frictions:
            for n in (9, 17, 33, 65):
                scene = sheet(COMM, n, kind)
                solver = Solver(scene)
                solver.advance(pressure=0.01)
                cable = scene.lay_cable(
                    Cable(32000.0, friction=friction), [(-20.0, 47.0, 0.0), (120.0, 51.0, 0.0)]
                )
                solver.advance(move={cable.end: (0.0, 0.0, -8.0)})
                began = time.perf_counter()
                outcome = solver.advance(move={cable.end: (0.0, 0.0, -8.0)}).outcome
                seconds = time.perf_counter() - began
                T = cable.tensions
                mu = friction.mu if isinstance(friction, Friction) else 0.0
                print(
                    f"  {kind:12} mu {mu}, along {cable.cable.along}, {n:2} cells a side: "
                    f"T {T[0]:9.4f} {T[-1]:9.4f}, dissipated {scene.dissipated:8.4f}; "
                    f"{outcome.passes} passes, {outcome.evaluations} evaluations, "
                    f"{outcome.factorizations} factorisations, {seconds:.2f} s"
                )


if __name__ == "__main__":
    law()
    stick()
    square()
