"""The compared methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from accuracy.cases import Case, Laws

STEPS = (5, 10, 20, 40)
"""Load steps of the paper's step-wise laws, on one mesh. They tend to laws that differ by the order
of the strain: errors that are smaller than the mesh's are so by chance, where signs change."""

EASY = 1e-5
"""Tolerance of the minimisers without a Hessian, else 1e-9: nearer, L-BFGS stalls in rounding."""


@dataclass(frozen=True)
class Method:
    """A method.

    Attributes
    ----------
    title
        Its name in tables and figures.
    minimizer
        Name of a class of `accuracy.minimizers`; None for the package's own.
    stepwise
        Whether it takes the paper's step-wise laws, over numbers of load steps.
    kind
        "package", or the "other program" Kratos.
    rtol
        Tolerance.
    levels
        Meshes, each with half the cells' size of the one before, whose results are extrapolated.
    """

    title: str
    minimizer: str | None = None
    stepwise: bool = False
    kind: Literal["package", "other program"] = "package"
    rtol: float = 1e-9
    levels: int = 1


METHODS: dict[str, Method] = {
    "default": Method("crms_fenicsx"),
    "extrapolated": Method("crms_fenicsx, extrapolated", levels=3),
    "newton": Method("TAO Newton, exact Hessian", "Newton"),
    "blmvm": Method("BLMVM without H0", "WithoutH0", rtol=EASY),
    "scipy": Method("SciPy L-BFGS", "ScipyLBFGS", rtol=EASY),
    "step": Method("step-wise laws (other limit)", stepwise=True),
    "kratos": Method("Kratos", kind="other program"),
}


def runs(case: Case, method: Method, quick: bool) -> list[tuple[int, Laws]]:
    """Meshes and laws of a method's runs on a case, from short to long; empty if it cannot."""
    sizes = case.quick if quick else case.sizes
    if method.kind == "other program":
        return [(n, Laws()) for n in sizes] if case.outside else []
    if method.stepwise:
        if case.stepwise is None:
            return []
        n = case.quick[-1] if quick else case.stepwise
        return [(n, Laws(True, steps)) for steps in (STEPS[:1] if quick else STEPS)]
    if method.levels > 1:
        return [(n, Laws(rtol=method.rtol)) for n in finest(case, quick)]
    if method == METHODS["default"]:
        sizes = tuple(sorted({*sizes, *finest(case, quick)}))
    return [(n, Laws(rtol=method.rtol)) for n in sizes]


def finest(case: Case, quick: bool) -> list[int]:
    """The finest meshes of studies of convergence that begin with a case's first meshes."""
    found = [4 * n for n in case.sizes if 2 * n <= case.sizes[-1]]
    return found[: 1 if quick else 2]
