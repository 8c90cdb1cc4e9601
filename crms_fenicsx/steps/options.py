"""Check the options of a solver."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mpi4py import MPI

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError


@dataclass(frozen=True)
class Options:
    """How a solver works: the arguments of `crms_fenicsx.Solver` but for the scene."""

    results: Path | None
    resume: bool | None
    prefix: str
    rtol: float
    max_halvings: int
    slide: bool
    verify: bool
    estimate: bool
    stability: Literal["warn", "refuse", "ignore"] = "warn"


def checked_options(
    comm: MPI.Intracomm,
    *,
    results: str | Path | None,
    resume: bool | None,
    prefix: str,
    rtol: float,
    max_halvings: int,
    slide: bool,
    verify: bool,
    estimate: bool,
    stability: Literal["warn", "refuse", "ignore"],
) -> Options:
    """Check options that a user gives to a solver. Collective."""
    checks.same(
        comm, "Solver", results=results, resume=resume, prefix=prefix, rtol=rtol,
        max_halvings=max_halvings, slide=slide, verify=verify, estimate=estimate,
        stability=stability,
    )  # fmt: skip
    if not 0 < checks.finite("Solver: rtol", rtol) < 1:
        raise InputError(f"Solver: rtol = {rtol} must lie between 0 and 1, as 1e-9 does.")
    if not isinstance(prefix, str) or prefix.startswith("-"):
        raise InputError(
            f"Solver: prefix = {prefix!r} is no options prefix; give a text without the "
            'leading hyphen, as in "crms_".'
        )
    folder = None if results is None else checks.file("Solver: results", results)
    if resume is not None and not isinstance(resume, bool):
        raise InputError(f"Solver: resume = {resume!r}; give True, False or None.")
    if resume is not None and results is None:
        raise InputError(
            f"Solver: resume = {resume}, but no results: give a folder, where checkpoints go, "
            'as in results="results/dome".'
        )
    if stability not in ("warn", "refuse", "ignore"):
        raise InputError(
            f"Solver: stability = {stability!r} is not known; use 'warn', 'refuse' or 'ignore'."
        )
    halvings = checks.whole("Solver: max_halvings", max_halvings, 0)
    flags = bool(slide), bool(verify), bool(estimate)
    return Options(folder, resume, prefix, float(rtol), halvings, *flags, stability)
