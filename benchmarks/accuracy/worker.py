"""One run of the benchmark in a separate process: results, times, counts and memory."""

from __future__ import annotations

import resource
import signal
import statistics
import time
import warnings
from typing import Any

import numpy as np

from accuracy.cases import CASES, QUANTITIES, Laws
from accuracy.methods import METHODS
from crms_fenicsx import ConvergenceError, FrictionWarning
from crms_fenicsx.equilibrium import system
from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.study import convergence

RUNS, ENOUGH = 5, 0.1
"""Repetitions, and part of the time limit after which there are no more."""

FIRST_LIMIT = 120.0
"""Seconds for a warm-up, which may have to compile."""


class OutOfTimeError(Exception):
    """The time limit is over."""


class Watch:
    """When a run began to solve, and what can be told if it did not end: evaluations, last energy.

    It begins to solve with its first evaluation of the energy, after all that is done once. `work`
    counts evaluations times unknowns.
    """

    def __init__(self) -> None:
        self.evaluations, self.work, self.energy = 0, 0, float("nan")
        self.first: float | None = None
        evaluate, sum_up = Potential.evaluate, Potential.sum_up

        def watched(potential: Potential, vertices: bool = True) -> float:
            self.evaluations += 1
            self.work += 3 * potential.unknowns.n_global
            self.energy = evaluate(potential, vertices)
            return self.energy

        def noted(potential: Potential, vertices: bool = True) -> None:
            self.first = time.process_time() if self.first is None else self.first
            sum_up(potential, vertices)

        Potential.evaluate = watched  # type: ignore[method-assign]
        Potential.sum_up = noted  # type: ignore[method-assign]


def work(case_name: str, method_name: str, n: int, steps: int | None, limit: float) -> dict:
    """Run a case by a method on a mesh of n cells, some times; the figures.

    Parameters
    ----------
    case_name, method_name
        Keys of `CASES` and `METHODS`.
    n
        The mesh.
    steps
        Load steps, for the step-wise laws.
    limit
        Seconds of processor time that a run may take.

    Returns
    -------
    What `report.row` reads: among others the medians ``seconds`` of processor time, ``solving``
    after all that is done once, and ``wall``.
    """
    case, method = CASES[case_name], METHODS[method_name]
    if method.kind == "other program":
        from accuracy.kratos import solve_with_kratos

        return solve_with_kratos(case, n, limit, RUNS, ENOUGH * limit)
    laws = Laws(method.stepwise, steps, method.rtol)
    if method.minimizer is not None:
        from accuracy import minimizers

        system.Minimizer = getattr(minimizers, method.minimizer)  # type: ignore[misc]
    warnings.simplefilter("ignore", FrictionWarning)
    signal.signal(signal.SIGPROF, _out_of_time)
    base = _peak()
    figures: dict[str, Any] = {"converged": False, "reason": "", "memory": 0.0}
    watch = Watch()
    spent: list[tuple[float, ...]] = []
    began = time.process_time()
    try:
        _timed(case_name, min(n, case.sizes[0]), laws, max(limit, FIRST_LIMIT))
        while not spent or (
            len(spent) < RUNS and sum(times[0] for times in spent) < ENOUGH * limit
        ):
            watch.evaluations, watch.work, watch.first = 0, 0, None
            began = time.process_time()
            times, solver, found = _timed(case_name, n, laws, limit, method.levels)
            solving = time.process_time() - (watch.first or began)
            spent.append((*times, solving))
        outcomes = [step.outcome for step in solver.steps]
        figures |= {
            "converged": True,
            "found": found,
            "iterations": sum(o.iterations for o in outcomes),
            "evaluations": sum(o.evaluations for o in outcomes),
            "factorizations": sum(o.factorizations for o in outcomes),
            "unknowns": 3 * solver.system.unknowns.n_global,
        }
        if method.levels > 1:  # all meshes, in evaluations on the finest one
            figures["evaluations"] = round(watch.work / figures["unknowns"])
    except (OutOfTimeError, ConvergenceError) as error:
        late = isinstance(error, OutOfTimeError)
        figures |= {
            "reason": f"no convergence in {limit:g} s" if late else str(error).split(";")[0],
            "found": {"W": watch.energy},
            "evaluations": watch.evaluations,
        }
        spent = spent or [(time.process_time() - began, *[float("nan")] * 3)]
    medians = (statistics.median(times) for times in zip(*spent, strict=True))
    names = ("seconds", "wall", "of_finest", "solving")
    return figures | dict(zip(names, medians, strict=True)) | {
        "runs": len(spent), "memory": _peak(), "base": base,
    }  # fmt: skip


def _timed(
    case_name: str, n: int, laws: Laws, limit: float, levels: int = 1
) -> tuple[Any, Any, dict]:
    """Processor and wall time, solver and results of a run; the first mesh is made before.

    Of several levels these are the limits, and the time is that of all of them; a third number is
    that time relative to the finest level's.
    """
    case = CASES[case_name]
    mesh = case.mesh(n >> (levels - 1))
    signal.setitimer(signal.ITIMER_PROF, limit)
    began = np.array([time.process_time(), time.perf_counter()])
    try:
        if levels == 1:
            (solver, found), seconds = case.run(mesh, laws), (1.0,)
        else:
            wanted = {q: QUANTITIES[q] for q in case.quantities}
            study = convergence(
                lambda mesh: case.run(mesh, laws)[0], mesh, levels, quantities=wanted
            )
            solver, found = study.finest, {q: study[q].limit for q in wanted}
            seconds = study.seconds
        times = np.array([time.process_time(), time.perf_counter()]) - began
        return (*times.tolist(), sum(seconds) / seconds[-1]), solver, found
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _out_of_time(*_: object) -> None:
    raise OutOfTimeError


def _peak() -> float:
    """Peak memory of this process so far (MiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
