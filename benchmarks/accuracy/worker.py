"""One run of the benchmark, repeated on request in a process of its own: results, times, counts."""

from __future__ import annotations

import json
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from accuracy.cases import CASES, QUANTITIES, Laws
from accuracy.methods import METHODS
from crms_fenicsx import ConvergenceError, FrictionWarning
from crms_fenicsx.analysis.equilibrium import system
from crms_fenicsx.design.study import convergence
from crms_fenicsx.energy.minimization.potential import Potential

FIRST_LIMIT = 120.0
"""Seconds for a warm-up, which may have to compile."""


class OutOfTimeError(Exception):
    """The time limit is over."""


class Watch:
    """When a run began to solve, and what can be told if it did not end: evaluations, last energy.

    It begins to solve with its first evaluation of the energy, after all that is done once. `work`
    counts evaluations times unknowns. Once it is late, the next evaluation notes the residual that
    it has reached, relative to the force scale, and ends the run.
    """

    def __init__(self) -> None:
        self.evaluations, self.work, self.energy = 0, 0, float("nan")
        self.first: float | None = None
        self.is_late, self.reached = False, float("nan")
        evaluate, sum_up = Potential.evaluate, Potential.sum_up

        def watched(potential: Potential) -> float:
            self.evaluations += 1
            self.work += 3 * potential.unknowns.n_global
            self.energy = evaluate(potential)
            if self.is_late:
                free = ~potential.unknowns.held[: potential.unknowns.n_owned]
                residual = np.linalg.norm(potential.g[: len(free)][free])
                self.reached = float(residual / potential.evaluate_terms()[1])
                raise OutOfTimeError
            return self.energy

        def noted(potential: Potential) -> None:
            self.first = time.process_time() if self.first is None else self.first
            sum_up(potential)

        Potential.evaluate = watched  # type: ignore[method-assign]
        Potential.sum_up = noted  # type: ignore[method-assign]

    def ring(self, *_: object) -> None:
        """The signal that a run's time is over."""
        self.is_late = True


def serve(case_name: str, method_name: str, n: int, steps: int | None, limit: float) -> None:
    """Warm up, then do a run for each line of standard input, and print its figures (JSON)."""
    ours = METHODS[method_name].kind == "package"
    prepare = _package if ours else _other_program
    run = prepare(case_name, method_name, n, steps, limit)
    print("READY", flush=True)
    for _ in sys.stdin:
        print("FIGURES " + json.dumps(run()), flush=True)


def _other_program(
    case_name: str, method_name: str, n: int, steps: int | None, limit: float
) -> Callable[[], dict]:
    """What runs Kratos."""
    from accuracy.kratos import Kratos

    return Kratos(CASES[case_name], n, limit).run


def _package(
    case_name: str, method_name: str, n: int, steps: int | None, limit: float
) -> Callable[[], dict]:
    """What runs a case by a method of the package on a mesh of n cells.

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
    What does a run and returns what `report.row` reads: among others ``seconds`` of processor time,
    ``solving`` after all that is done once, and ``wall``.
    """
    case, method = CASES[case_name], METHODS[method_name]
    laws = Laws(method.stepwise, steps, method.rtol)
    if method.minimizer is not None:
        from accuracy import minimizers

        system.Minimizer = getattr(minimizers, method.minimizer)  # type: ignore[misc]
    warnings.simplefilter("ignore", FrictionWarning)
    base, watch = _peak(), Watch()
    signal.signal(signal.SIGPROF, watch.ring)
    with suppress(OutOfTimeError, ConvergenceError):
        _timed(case_name, min(n, case.sizes[0]), laws, max(limit, FIRST_LIMIT))

    def run() -> dict:
        watch.evaluations, watch.work, watch.first, watch.is_late = 0, 0, None, False
        began = time.process_time()
        figures: dict[str, Any] = {"converged": False, "reason": "", "base": base}
        try:
            times, solver, found = _timed(case_name, n, laws, limit, method.levels)
        except (OutOfTimeError, ConvergenceError) as error:
            late = isinstance(error, OutOfTimeError)
            return figures | {
                "reason": f"no convergence in {limit:g} s" if late else str(error).split(";")[0],
                "seconds": time.process_time() - began, "found": {"W": watch.energy},
                "evaluations": watch.evaluations, "reached": watch.reached, "memory": _peak(),
            }  # fmt: skip
        figures |= dict(zip(("seconds", "wall", "of_finest"), times, strict=True))
        outcomes = [step.outcome for step in solver.steps]
        figures |= {
            "solving": time.process_time() - (watch.first or began),
            "converged": True,
            "found": found,
            "iterations": sum(o.iterations for o in outcomes),
            "evaluations": sum(o.evaluations for o in outcomes),
            "factorizations": sum(o.factorizations for o in outcomes),
            "reached": max(o.residual / o.scale for o in outcomes),
            "unknowns": 3 * solver.system.unknowns.n_global,
            "memory": _peak(),
        }
        if method.levels > 1:  # all meshes, in evaluations on the finest one
            figures["evaluations"] = round(watch.work / figures["unknowns"])
        return figures

    return run


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


def _peak() -> float:
    """Peak memory of this process so far (MiB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
