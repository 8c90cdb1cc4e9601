"""Checks of the arguments that the mesh generators share."""

from __future__ import annotations

import math
from collections.abc import Sequence

from crms_fenicsx.runtime.errors import InputError, MeshError

_MOST_CELLS = 2e7
_RANGE = 1e-100, 1e100
"""Lengths whose squares, and the squares of these, are numbers as well."""


def check_positive(what: str, **numbers: float) -> None:
    """Refuse lengths that are not positive and finite, or beyond all measure, by their names."""
    for name, value in numbers.items():
        try:
            good = _RANGE[0] < value < _RANGE[1]
        except (TypeError, ValueError):
            good = False
        if not good:
            raise InputError(f"{what} has {name} = {value!r}: give a positive, finite number")


def check_size(what: str, size: float, shortest: float, area: float) -> None:
    """Refuse a mesh size that is too large for a shape, or would need far too many cells.

    Units: size (length), shortest (length).
    """
    check_positive(what, size=size)
    if size > shortest:
        raise MeshError(
            f"{what} has size = {size}, more than its smallest extent {shortest:.6g}: "
            "choose a smaller size"
        )
    cells = area / (math.sqrt(3.0) / 4.0 * size**2)
    if cells > _MOST_CELLS:
        raise MeshError(
            f"{what} with size = {size} would need about {cells:.1e} cells, more than "
            f"{_MOST_CELLS:.0e}: choose a larger size"
        )


def check_point(what: str, point: Sequence[float]) -> tuple[float, float]:
    """Return the two coordinates of a point in the plan."""
    try:
        x, y = (float(value) for value in point)
        good = math.isfinite(x) and math.isfinite(y)
    except (TypeError, ValueError, OverflowError):
        good = False
    if not good:
        raise InputError(f"{what} is {point!r}: give two finite coordinates (x, y)")
    return x, y
