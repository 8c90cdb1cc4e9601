"""Check the options of a solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from mpi4py import MPI

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError


@dataclass(frozen=True)
class Options:
    """Arguments of `crms_fenicsx.Solver` except the scene."""

    results: Path | None
    resume: bool | None
    prefix: str
    rtol: float
    max_halvings: int
    slide: bool
    verify: bool
    estimate: bool
    stability: Literal["warn", "refuse", "ignore"] = "warn"


def checked_options(comm: MPI.Intracomm, **given: Any) -> Options:
    """Check a solver's options. Collective."""
    checks.same(comm, "Solver", **given)
    options = Options(**given)
    results, resume, rtol = options.results, options.resume, options.rtol
    if not 0 < checks.finite("Solver: rtol", rtol) < 1:
        raise InputError(f"Solver: rtol = {rtol} must lie between 0 and 1, as 1e-9 does.")
    checks.options_prefix("Solver: prefix", options.prefix)
    if resume is not None and not isinstance(resume, bool):
        raise InputError(f"Solver: resume = {resume!r}; give True, False or None.")
    if resume is not None and results is None:
        raise InputError(
            f"Solver: resume = {resume}, but no results: give a folder, where checkpoints go, "
            'as in results="results/dome".'
        )
    checks.one_of("Solver: stability", options.stability, ("warn", "refuse", "ignore"))
    halvings = checks.whole("Solver: max_halvings", options.max_halvings, 0)
    folder = None if results is None else checks.file("Solver: results", results)
    return replace(options, results=folder, rtol=float(rtol), max_halvings=halvings)
