"""Rows of the benchmark: errors, the table as CSV, and the summary in Markdown."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path

import numpy as np

from accuracy.cases import CASES, Case, Laws
from accuracy.methods import METHODS
from accuracy.references import Reference, reference

LEVELS = (0.01, 0.001, 0.0001)
"""Errors to which the summary says the time."""

ERRORS = ("first_error", "second_error")


@dataclass(frozen=True)
class Row:
    """A run.

    Attributes
    ----------
    n, steps
        Mesh, and load steps of the step-wise laws (else 0).
    seconds, solving, wall
        Medians over `runs` runs of processor time, of its part after all that is done once (scene,
        forms, tables), and of wall time.
    of_finest
        Of a study of convergence the wall time relative to that of its finest level; else 1.
    reached
        Largest residual of a load step, relative to the force scale; without convergence
        that of the last evaluation.
    memory, base
        Peak memory of the process, and what it has before the first run (MiB).
    first, second
        Values of the case's two quantities; NaN if unknown.
    first_error, second_error
        Their errors relative to the references; of a run that did not converge, of the last
        energy that it has come to.
    """

    case: str
    method: str
    n: int
    steps: int
    unknowns: int
    converged: bool
    reason: str
    seconds: float
    solving: float
    wall: float
    of_finest: float
    runs: int
    iterations: int
    evaluations: int
    factorizations: int
    reached: float
    memory: float
    base: float
    first: float
    second: float
    first_error: float
    second_error: float

    def line(self) -> str:
        """For the terminal."""
        where = f"n = {self.n}" + (f", {self.steps} steps" if self.steps else "")
        head = f"{METHODS[self.method].title:>30.30} {where:>17}"
        if not self.converged:
            return f"{head}  {self.reason}"
        return (
            f"{head} {self.seconds:8.3f} s, solving {self.solving:8.3f} s"
            f"  errors {self.first_error:9.2e} {self.second_error:9.2e}"
            f" {self.iterations:7} iterations {self.evaluations:7} evaluations"
            f" {self.factorizations:5} factorisations {self.memory:6.0f} MiB"
        )


def compressible(method: str) -> bool:
    """Whether a method's membrane resists compression."""
    return METHODS[method].stepwise or METHODS[method].kind == "other program"


def references(case: Case, method: str) -> list[Reference]:
    """References of a case's two quantities."""
    return [reference(case.reference, q, compressible(method)) for q in case.quantities]


def row(name: str, method: str, n: int, laws: Laws, figures: dict) -> Row:
    """The row of a run."""

    def number(key: str) -> float:
        return float(figures.get(key, np.nan))

    case = CASES[name]
    values = [float(figures["found"].get(q, np.nan)) for q in case.quantities]
    pairs = zip(values, references(case, method), strict=True)
    errors = [abs(value / known.value - 1) for value, known in pairs]
    counts = [int(figures.get(k, 0)) for k in ("iterations", "evaluations", "factorizations")]
    return Row(
        name, method, n, laws.steps or 0, int(figures.get("unknowns", 0)), figures["converged"],
        figures["reason"], number("seconds"), number("solving"),
        number("wall"), number("of_finest"), int(figures.get("runs", 0)),
        *counts, number("reached"), number("memory"), number("base"), *values, *errors,
    )  # fmt: skip


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        names = [field.name for field in fields(Row)]
        writer.writerow(names)
        writer.writerows([getattr(r, name) for name in names] for r in rows)


def read_csv(path: Path) -> list[Row]:
    """The rows of a table; none where there is none."""
    if not path.exists():
        return []
    read = {"str": str, "int": int, "float": float, "bool": "True".__eq__}
    with path.open(newline="") as file:
        return [
            Row(**{field.name: read[str(field.type)](line[field.name]) for field in fields(Row)})
            for line in csv.DictReader(file)
        ]


def seconds_to(rows: Iterable[Row], level: float, error: str) -> float:
    """Time to an error, the row's `error`, on the straight lines between log-log points.

    Returns
    -------
    NaN if no run is as accurate; the coarsest run's time where that is accurate enough already.
    """
    points = [(getattr(r, error), r.seconds) for r in rows if r.converged]
    for k, (found, seconds) in enumerate(points):
        if found <= level:
            if k == 0:
                return seconds
            x, y = np.log(np.array([points[k - 1], (found, seconds)])).T
            return float(np.exp(np.interp(np.log(level), x[::-1], y[::-1])))
    return float("nan")


def summary(rows: Sequence[Row]) -> str:
    """Markdown: times to errors below that of the coarsest mesh ("finer": on a finer mesh than
    those of the benchmark; "no": it has not converged on a mesh as fine), then work on the
    default's second finest mesh."""
    methods = list(dict.fromkeys(r.method for r in rows if not METHODS[r.method].stepwise))
    titles = " | ".join(METHODS[m].title for m in methods)
    lines = [f"| seconds to an error of | {titles} |", "|---" * (1 + len(methods)) + "|"]
    for name in dict.fromkeys(r.case for r in rows):
        case = CASES[name]
        for (error, quantity), level in product(zip(ERRORS, case.quantities, strict=True), LEVELS):
            cells = []
            for method in methods:
                own = [r for r in rows if (r.case, r.method) == (name, method)]
                t = seconds_to(own, level, error)
                short = "no" if any(not r.converged for r in own) else "finer"
                cells.append(f"{t:.2g}" if np.isfinite(t) else (short if own else ""))
            first = next(r for r in rows if r.case == name)
            if getattr(first, error) > level and not {*cells} <= {"", "no", "finer"}:
                what = f"{case.title}, {100 * level:g} % of {quantity}"
                lines.append(f"| {what} | " + " | ".join(cells) + " |")
    lines += ["", f"| work: iterations, evaluations, factorisations | n | {titles} |"]
    lines.append("|---" * (2 + len(methods)) + "|")
    for name in dict.fromkeys(r.case for r in rows):
        found = {(r.method, r.n): r for r in rows if r.case == name and r.converged}
        sizes = [n for m, n in found if m == "default"]
        if not sizes:
            continue
        n = sorted(sizes)[-2 if len(sizes) > 2 else -1]
        cells = []
        for method in methods:
            own = found.get((method, n))
            work = (own.iterations, own.evaluations, own.factorizations) if own else ()
            cells.append(", ".join(map(str, work)))
        lines.append(f"| {CASES[name].title} | {n} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, *_tolerances(rows), *_gains(rows)]) + "\n"


def _tolerances(rows: Sequence[Row]) -> list[str]:
    """Work and residuals of the minimisers whose tolerance is larger than the package's."""
    lines = ["", "| case | method | n | evaluations | s | residual | |", "|---" * 7 + "|"]
    for r in rows:
        if METHODS[r.method].rtol > 1e-9 and np.isfinite(r.reached):
            what = "converged" if r.converged else r.reason
            lines.append(
                f"| {CASES[r.case].title} | {METHODS[r.method].title} | {r.n} | {r.evaluations} | "
                f"{r.seconds:.2g} | {r.reached:.1e} | {what} |"
            )
    return lines


def _gains(rows: Sequence[Row]) -> list[str]:
    """What extrapolation gains and costs, beside a run on a mesh as fine, and its finest level."""
    lines = [
        "",
        "| case, errors of | n | of | mesh n | limit | ratio | time, relative | to its finest | "
        "evaluations |",
        "|---" * 9 + "|",
    ]
    runs = {(r.case, r.method, r.n): r for r in rows if r.converged}
    for (name, method, n), limit in runs.items():
        mesh = runs.get((name, "default", n))
        if method != "extrapolated" or mesh is None:
            continue
        spent = limit.seconds / mesh.seconds, limit.evaluations / mesh.evaluations
        errors = zip(ERRORS, CASES[name].quantities, strict=True)
        for error, quantity in errors:
            of_mesh, of_limit = getattr(mesh, error), getattr(limit, error)
            lines.append(
                f"| {CASES[name].title} | {n} | {quantity} | {of_mesh:.1e} | {of_limit:.1e} | "
                f"{of_mesh / of_limit:.3g} | {spent[0]:.2f} | {limit.of_finest:.2f} | "
                f"{spent[1]:.2f} |"
            )
    return lines
