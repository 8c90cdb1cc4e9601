"""Compensation adjusted until the sewn roof has the wanted section forces, or the wanted form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import cycle

import numpy as np

from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.patterns.pattern import Pattern
from crms_fenicsx.patterns.sewn import Comparison, SewnPiece, compare
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import (
    ConvergenceError,
    InputError,
    collective,
    raised_together,
)
from crms_fenicsx.solver import Solver

Build = Callable[[Pattern], Solver]
"""Makes scene and solver of a pattern, brings the loads on, and returns the solver."""


@dataclass(frozen=True)
class Adjusted:
    """An adjusted pattern.

    Attributes
    ----------
    pattern
        The pattern.
    solver
        The solver of the roof that is sewn of it.
    comparisons
        What was got before each update, and in the end.
    errors
        Largest difference from what was wanted, relative to it, each time.
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
    """Change compensation until the sewn roof is the wanted one. Collective.

    With `forces` the roof gets the compensation with which its mean section forces are the wanted
    ones. On a pneumatic roof these follow from pressure and shape, and compensation changes the
    shape: leave `forces` out there, and the roof gets the compensation with which its mean lengths
    along warp and weft are those of the wanted form.

    Parameters
    ----------
    pattern
        The pattern to begin with.
    build
        A function of a pattern that sews it, brings supports and loads on and returns the solver.
    forces
        Wanted section forces along warp and weft, or one for both (force per length).
    each
        Whether each piece gets a compensation of its own, for its own means.
    tolerance
        Largest difference of the means, relative to the larger wanted force, or of lengths.
    updates
        Most of them.

    Returns
    -------
    Adjusted
        The pattern, its solver, and what was got on the way.

    Raises
    ------
    InputError
        On all ranks: arguments that cannot be used, or a `build` that returns another roof.
    ConvergenceError
        On all ranks: the roof is not the wanted one after all updates.

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
    # logarithms of further stretches, and the changes that are called for there
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
    """The next step of a fixed-point iteration by D. G. Anderson (J. ACM 12, 1965), which learns
    how far the roof's edges give way."""
    depth = min(len(places) - 1, len(changes[-1]), 3)
    if depth == 0:
        return changes[-1]
    x, r = (np.diff(np.array(one[-depth - 1 :]), axis=0).T for one in (places, changes))
    parts, *_ = np.linalg.lstsq(r, changes[-1], rcond=None)
    return np.asarray(changes[-1] - (x + r) @ parts)


def _change(material: object, wanted: Array | None, got: SewnPiece) -> tuple[float, float]:
    """Logarithms of further stretches along warp and weft, were the edges rigid."""
    stretch = got.stretch  # what is too short is cut longer, and stretched less
    if wanted is not None:
        assert isinstance(material, MembraneMaterial)
        stretch = 1.0 + np.linalg.solve(material.stiffness[:2, :2], wanted - got.mean)
    warp, weft = map(float, np.log(stretch))
    return warp, weft


def _error(wanted: Array | None, got: SewnPiece) -> float:
    """Largest difference from what is wanted."""
    if wanted is None:
        return float(np.abs(got.stretch - 1.0).max())
    return float(np.abs(got.mean - wanted).max() / np.abs(wanted).max())
