"""Reliability and cost of error bars.

Cases of `benchmarks/accuracy` with independent references, each from a coarse mesh over three
levels of `study.convergence`. Errors and bars are in per cent of the reference; the last columns
give the time of the three levels in units of a run on the finest mesh, and the ratio of estimated
to true error of the first mesh's energy.

    ./run python benchmarks/error_bars.py [LEVELS]
"""

from __future__ import annotations

import sys

import numpy as np
from accuracy.cases import CASES, QUANTITIES, Laws, Run
from accuracy.references import reference

from crms_fenicsx import Solver
from crms_fenicsx.design.study import convergence
from crms_fenicsx.foundation.meshes import MembraneMesh

STUDIES = (
    ("circle", 8), ("circle", 16), ("square", 4), ("square", 8), ("cable on lines", 4),
    ("cable on lines", 8), ("cable anywhere", 5), ("cable anywhere", 9), ("sliding cable", 5),
    ("sliding cable", 9), ("model 2", 5), ("model 2", 9), ("model 3, smooth", 8),
    ("dome net", 7), ("dome net", 10), ("dome net", 14),
)  # fmt: skip
"""Cases, and cells a side of their first meshes."""


def effectivity(solver: Solver, name: str) -> float:
    """Estimated over true error of the energy."""
    truth = reference(name, "W").value
    return solver.estimate_error().total / (solver.scene.energy - truth)


def main() -> None:
    """Print the table."""
    levels = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    print(f"{'case':16}{'n':>4}  of{'first':>9}{'finest':>9}{'limit':>9}{'bar':>9}{'order':>7}"
          f"{'held':>6}{'time':>7}{'est.':>7}")  # fmt: skip
    held, ratios = [], []
    for case, n in STUDIES:
        spec = CASES[case]

        def build(mesh: MembraneMesh, run: Run = spec.run) -> Solver:
            return run(mesh, Laws())[0]

        solver = build(spec.mesh(n))  # compiles what will be needed, and gives the estimate
        wanted = {q: QUANTITIES[q] for q in "WTwV"}
        study = convergence(build, spec.mesh(n), levels, quantities=wanted)
        cost = sum(study.seconds) / study.seconds[-1]
        for quantity in ("W", "T", "w", "V"):
            try:
                known = reference(spec.reference, quantity)
            except KeyError:
                continue
            one = study[quantity]
            size = abs(known.value) / 100
            off = abs(one.limit - known.value)
            held.append(off <= one.bar + known.bar)
            ratios.append((one.bar / size, off / size))
            ends = [(value - known.value) / size for value in (one.values[0], one.values[-1])]
            print(f"{case:16}{n:>4}  {quantity}{ends[0]:10.3f}{ends[1]:9.3f}"
                  f"{(one.limit - known.value) / size:9.3f}{one.bar / size:9.3f}{one.order:7.2f}"
                  f"{'yes' if held[-1] else 'NO':>6}{cost:7.1f}"
                  + (f"{effectivity(solver, spec.reference):7.2f}" if quantity == "W" else ""),
                  flush=True)  # fmt: skip
    bars, errors = np.array(ratios).T
    print(f"bars hold {sum(held)} of {len(held)} references; the mean bar is "
          f"{bars.mean() / errors.mean():.1f} times the mean error of the limits")  # fmt: skip


if __name__ == "__main__":
    main()
