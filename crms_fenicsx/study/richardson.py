"""Where values on finer and finer meshes go, and how far that may be from the truth.

Errors of this package's elements fall with the square of the cells' size where the mesh resolves
what there is. Each halving then takes three quarters of the error away, and what is left is a
third of the last difference d (L. F. Richardson, 1911). The order p that the last two differences
show says whether it is so. The bar is P. J. Roache's (Perspective: a method for uniform reporting
of grid refinement studies, 1994) with the factors of safety of L. Eca and M. Hoekstra (A procedure
for the estimation of the numerical uncertainty of CFD calculations based on grid refinement
studies, 2014): the error by the order found, times 1.25 where that is the order expected, and
times 3 elsewhere. Two differences may agree by chance, or be small by chance where values go to
and fro. So what shows no order, or changed its direction between any levels, gets the error that
the greatest of all differences tells, each brought to the finest level by order 2, times 3.
`docs/benchmarks/cable_accuracy.md` says how often bars hold known limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

ORDER = 2.0
REGULAR = (1.2, 3.0)
"""Orders found between which the levels are taken to converge with order 2."""
NEAR, SAFE, SAFER = 0.3, 1.25, 3.0
"""How far the order found is from 2 at most for the first of the two factors of safety."""
FAR = 0.3
"""Differences, relative to the largest value, above which the first level shows no order."""
SAME = 1e-7
"""Differences, relative to the largest value, that the solver's tolerance makes."""


@dataclass(frozen=True)
class Extrapolated:
    """A value in the limit of fine meshes."""

    limit: float  # limit, bar: the value, and how far it may be from the truth, in 19 of 20 cases
    bar: float
    order: float  # order of convergence that the last three levels show; NaN where they show none
    regular: bool  # whether it is one that the bar counts on
    remark: str  # what to know of it, in words


def extrapolated(values: Sequence[float], size: float = 0.0) -> Extrapolated:
    """Extrapolate values on two levels or more, of which each has half the cells' size."""
    differences = [b - a for a, b in pairwise(values)]
    d, finest, scale = differences[-1], values[-1], max(size, *map(abs, values))
    least = SAME * scale
    if max(map(abs, differences)) <= least:
        return Extrapolated(finest, least, math.nan, True, "the same on all levels")
    limit = finest + d / (2**ORDER - 1)
    if len(differences) == 1:
        return Extrapolated(limit, abs(d), math.nan, False, "two levels show no order: 2 assumed")
    errors = [abs(x) / (2**ORDER - 1) / 2 ** (k * ORDER) for k, x in enumerate(differences[::-1])]
    widest, before = max(SAFER * max(errors), least), differences[-2]
    if before * d <= 0.0:
        remark = "no order: the levels go to and fro"
        return Extrapolated(finest, widest, math.nan, False, remark)
    order, remark = math.log2(before / d), ""
    if order <= 0.0:
        remark, widest = "no order: differences grow", max(widest, abs(d) + abs(before))
    elif order < REGULAR[0]:
        remark = "low order"
    elif order > REGULAR[1]:
        remark = "order too high: the coarsest is too coarse"
    elif abs(before) > FAR * scale:
        remark = "the coarsest is too coarse"
    elif any(a * b < 0.0 for a, b in pairwise(differences)):
        remark = "no order: coarser levels go to and fro"
    if remark:
        return Extrapolated(limit, widest, order, False, remark)
    error = abs(d) / (2 ** min(order, ORDER) - 1)
    bar = (SAFE if abs(order - ORDER) < NEAR else SAFER) * error
    return Extrapolated(limit, max(bar, least), order, True, "")
