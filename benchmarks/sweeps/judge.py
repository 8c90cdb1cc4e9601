"""A point of a sweep and its verdict: converged, refused, wrong or hanging."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from crms_fenicsx import ConvergenceError, InputError, Solver
from sweeps.guard import Hang, bounded
from sweeps.soundness import least_stiffness, tests

Verdict = Literal["converged", "refused", "REFUSED", "WRONG", "HANG"]
EVALUATIONS, SECONDS = 20_000, 60.0
"""What a point may take at most."""


class Judge:
    """Collects what a point has taken, and what is wrong with it.

    Attributes
    ----------
    iterations, evaluations, solves, halvings
        Of all load steps told to `solved`.
    drifts
        What should not change, its change and how large that may be.
    faults
        What is wrong, in words.
    """

    def __init__(self) -> None:
        self.iterations = self.evaluations = self.solves = self.halvings = 0
        self.drifts: list[tuple[str, float, float]] = []
        self.faults: list[str] = []

    def count(self, solver: Solver) -> None:
        """Count the work of a solver."""
        for step in solver.steps:
            self.iterations += step.outcome.iterations
            self.evaluations += step.outcome.evaluations
            self.solves += step.outcome.solves
            self.halvings += step.halvings

    def sound(
        self, solver: Solver, *, anew: bool = True, lying: bool = True, stable: bool = False
    ) -> None:
        """Look at a state from the outside; see `soundness.tests` and `least_stiffness`."""
        for what, value, allowed in tests(solver, anew=anew, lying=lying):
            self._compare(what, value, allowed)
        if stable:
            self._compare(*least_stiffness(solver))

    def solved(
        self, solver: Solver, *, anew: bool = True, lying: bool = True, stable: bool = False
    ) -> None:
        """Count the work of a solver that has come to its end, and look at its state."""
        self.count(solver)
        self.sound(solver, anew=anew, lying=lying, stable=stable)

    def drift(self, what: str, change: float, allowed: float) -> None:
        """Note a change of what should not change."""
        self.drifts.append((what, abs(float(change)), allowed))
        self._compare(what, abs(float(change)), allowed)

    def same(self, what: str, value: float, other: float, allowed: float) -> None:
        """Note the relative difference of what should be equal."""
        scale = max(abs(value), abs(other))
        self.drift(what, (value - other) / scale if scale > 0.0 else 0.0, allowed)

    def must(self, what: str, holds: bool) -> None:
        """Note a fault unless something holds."""
        if not holds:
            self.faults.append(what)

    def _compare(self, what: str, value: float, allowed: float) -> None:
        if not value <= allowed:  # NaN is no good value
            self.faults.append(f"{what}: {value:.2g} > {allowed:.2g}")


@dataclass(frozen=True)
class Point:
    """A point of a sweep.

    Attributes
    ----------
    label
        Which one it is.
    run
        Does it, and tells a judge.
    solvable
        Whether an equilibrium is known to exist, so that the solver should find it.
    quick
        Whether it is in the short version.
    """

    label: str
    run: Callable[[Judge], None]
    solvable: bool = True
    quick: bool = False


Sweep = Callable[[], Iterator[Point]]


@dataclass(frozen=True)
class Row:
    """A judged point, as in the table.

    Attributes
    ----------
    verdict
        "refused" with an error where there may be no equilibrium, "REFUSED" where there is one.
    iterations, evaluations, solves, halvings
        What it took.
    drift, allowed, of
        The change of what should be constant that comes nearest to what is allowed, and of what.
    remarks
        What is wrong, or the error.
    """

    sweep: str
    label: str
    verdict: Verdict
    iterations: int
    evaluations: int
    solves: int
    halvings: int
    drift: float
    allowed: float
    of: str
    seconds: float
    remarks: str

    def line(self) -> str:
        """For the terminal."""
        work = f"{self.iterations:6} {self.evaluations:6} {self.solves:5} {self.halvings:4}"
        drift = f"{self.drift:8.1e} of {self.allowed:7.1e} {self.of}" if self.of else ""
        text = f"{self.label:44.44} {self.verdict:9} {work} {drift:52} {self.seconds:5.1f} s"
        return text + (f"\n        {self.remarks}" if self.remarks else "")


def judged(sweep: str, point: Point) -> Row:
    """Run a point within its bounds."""
    judge, began = Judge(), time.perf_counter()
    verdict: Verdict = "converged"
    remarks = ""
    try:
        with bounded(EVALUATIONS, SECONDS), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # numbers that are none
            point.run(judge)
    except Hang as hang:
        verdict, remarks = "HANG", str(hang)
    except (ConvergenceError, InputError) as error:
        verdict, remarks = "REFUSED" if point.solvable else "refused", str(error)
    except Exception as error:  # not one that says what to do
        verdict, remarks = "WRONG", f"{type(error).__name__}: {error}"
    if judge.faults:
        verdict, remarks = "WRONG", "; ".join([*judge.faults, *filter(None, [remarks])])
    worst = max(judge.drifts, key=_share, default=("", np.nan, np.nan))
    return Row(
        sweep, point.label, verdict,
        judge.iterations, judge.evaluations, judge.solves, judge.halvings,
        worst[1], worst[2], worst[0], time.perf_counter() - began, remarks,
    )  # fmt: skip


def _share(drift: tuple[str, float, float]) -> float:
    _, change, allowed = drift
    if np.isnan(change):
        return np.inf
    return change / allowed if allowed > 0.0 else float(change > 0.0)
