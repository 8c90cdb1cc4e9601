"""Compensation adjusted until the sewn roof reaches the wanted section forces or form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import cycle

import numpy as np

from crms_fenicsx.design.patterns.pattern import Pattern
from crms_fenicsx.design.patterns.sewn import Comparison, SewnPiece, compare
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import (
    ConvergenceError,
    InputError,
    collective,
    raised_together,
)
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.solver import Solver

Build = Callable[[Pattern], Solver]
"""Function that sews a pattern, applies supports and loads and returns the solver."""


@dataclass(frozen=True)
class Adjusted:
    """An adjusted pattern.

    Attributes
    ----------
    pattern
        The pattern.
    solver
        Solver of the roof sewn from it.
    comparisons
        Comparisons before each update and at the end.
    errors
        Largest relative difference from the target in each comparison.
    """

    pattern: Pattern
    solver: Solver = field(repr=False)
    comparisons: tuple[Comparison, ...] = field(repr=False)
    errors: tuple[float, ...]


@collective
def adjust(
    pattern: Pattern,
    build: Build,
    *,
    forces: float | tuple[float, float] | None = None,
    each: bool = False,
    tolerance: float = 1e-4,
    updates: int = 10,
) -> Adjusted:
    """Adjust compensation until the sewn roof meets its target. Collective.

    With `forces` the target is the mean section forces. On a pneumatic roof these follow from
    pressure and shape, and compensation changes the shape: leave `forces` out there, and the target
    is the mean lengths of the form along warp and weft.

    Parameters
    ----------
    pattern
        Initial pattern.
    build
        Function of a pattern that sews it, applies supports and loads, and returns the solver.
    forces
        Wanted section forces along warp and weft, or one for both (force per length).
    each
        Whether to adjust the compensation of each piece by its own means.
    tolerance
        Largest difference of the mean lengths, or of the mean forces relative to the larger wanted
        one.
    updates
        Largest number of updates.

    Returns
    -------
    Adjusted
        The pattern, its solver, and the comparisons on the way.

    Raises
    ------
    InputError
        On all ranks: invalid arguments, or a `build` that returns another roof.
    ConvergenceError
        On all ranks: a roof that misses the target after all updates.

    Examples
    --------
    >>> def build(pattern):
    ...     scene = patterns.sew(pattern)
    ...     scene.fix("boundary")
    ...     solver = Solver(scene)
    ...     solver.advance()
    ...     return solver
    >>> patterns.adjust(pattern, build, forces=(2.0, 2.0)).pattern
    """
    if not isinstance(pattern, Pattern):
        raise InputError(f"adjust: pattern = {pattern!r}; give what patterns.flatten returned.")
    comm = pattern.comm
    checks.same(comm, "adjust", forces=forces, tolerance=tolerance, updates=updates)
    checks.positive("adjust: tolerance", tolerance)
    most = checks.whole("adjust: updates", updates, 0)
    if forces is not None and isinstance(pattern.material, Mapping):
        raise InputError("adjust: the roof has several materials; adjust its form, without forces.")
    found: list[Comparison] = []
    errors: list[float] = []
    names = [one.name for one in pattern.flat]
    # logarithms of the additional stretches, and the changes required at each iterate
    places: list[Array] = [np.zeros(2 * len(names) if each else 2)]
    changes: list[Array] = []
    while True:
        with raised_together(comm):
            solver = build(pattern)
            if not isinstance(solver, Solver):
                raise InputError(f"adjust: build returned {solver!r}; return a Solver.")
        found.append(compare(solver, pattern, forces))
        judged = found[-1].pieces if each else (found[-1].whole,)
        errors.append(max(_error(found[-1].wanted, one) for one in judged))
        if errors[-1] <= tolerance:
            return Adjusted(pattern, solver, tuple(found), tuple(errors))
        if len(errors) > most:
            raise ConvergenceError(
                f"adjust: after {most} updates of the compensation the roof still differs by "
                f"{errors[-1]:.2g} from the wanted one (before: {errors[0]:.2g})."
            )
        changes.append(
            np.array([_change(pattern.material, found[-1].wanted, one) for one in judged]).ravel()
        )
        step = _accelerated(places, changes)
        places.append(places[-1] + step)
        pairs = [(warp, weft) for warp, weft in np.exp(step).reshape(-1, 2)]
        pattern = pattern.adjusted(dict(zip(names, cycle(pairs), strict=False)))


def _accelerated(places: list[Array], changes: list[Array]) -> Array:
    """Next step of the fixed-point iteration with Anderson acceleration (D. G. Anderson, J. ACM 12,
    1965), which learns how flexible the roof's edges are."""
    depth = min(len(places) - 1, len(changes[-1]), 3)
    if depth == 0:
        return changes[-1]
    x, r = (np.diff(np.array(one[-depth - 1 :]), axis=0).T for one in (places, changes))
    parts, *_ = np.linalg.lstsq(r, changes[-1], rcond=None)
    return np.asarray(changes[-1] - (x + r) @ parts)


def _change(material: object, wanted: Array | None, got: SewnPiece) -> tuple[float, float]:
    """Logarithms of the additional stretches along warp and weft if the edges were rigid."""
    stretch = got.stretch  # a piece that is too short is cut longer, hence stretched less
    if wanted is not None:
        assert isinstance(material, MembraneMaterial)
        stretch = 1.0 + np.linalg.solve(material.stiffness[:2, :2], wanted - got.mean)
    warp, weft = map(float, np.log(stretch))
    return warp, weft


def _error(wanted: Array | None, got: SewnPiece) -> float:
    """Largest relative error of the section forces, or of the lengths."""
    if wanted is None:
        return float(np.abs(got.stretch - 1.0).max())
    return float(np.abs(got.mean - wanted).max() / np.abs(wanted).max())
