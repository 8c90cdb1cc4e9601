"""The level of a given amount of water on a surface."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

from crms_fenicsx.runtime.arrays import EPSILON, Array

TURNS = 200
"""Newton steps and bisections at most: from anywhere to the last digit they are some ten."""


def find_level(
    comm: MPI.Intracomm,
    fill: Callable[[float], None],
    sums: Array,
    volume: float,
    level: float,
) -> float:
    """Find the level at which water has a volume, by Newton's method. Collective.

    The volume is a convex function of the level where the surface lies under all of the water, so
    that Newton's steps come from above; where it does not, or is dry, they are kept in brackets.
    Units: sums (length cubed), volume (length cubed), level (length).
    """
    low, high, step = -float("inf"), float("inf"), volume ** (1 / 3)
    total = sums.copy()
    for _ in range(TURNS):
        fill(level)
        comm.Allreduce(sums, total, op=MPI.SUM)
        excess, area = float(total[-2]) - volume, float(total[-1])
        if excess > 0.0:
            high = min(high, level)
        else:
            low = max(low, level)
        if area > 0.0 and abs(excess) <= 8 * EPSILON * volume:
            return level
        newton = level - excess / area if area > 0.0 else float("inf")
        if low < newton < high:
            target = newton
        elif high - low < float("inf"):
            target = (low + high) / 2
        else:  # up to where there is a surface, or down to below it
            target, step = level + (step if excess <= 0.0 else -step), 2 * step
        if abs(target - level) <= 2 * EPSILON * max(abs(target), abs(level)):
            return target
        level = target
    return level
