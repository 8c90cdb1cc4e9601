"""Numbers, texts and lists of them, as JSON has them, from arrays and back, to the last digit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from crms_fenicsx.runtime.arrays import Array

Plain = dict[str, Any]


def listed(values: npt.ArrayLike) -> Any:
    """An array as lists, with None where it has NaN, which JSON does not know."""
    array = np.asarray(values)
    lists = array.tolist()
    return _without_nan(lists) if array.dtype.kind == "f" else lists


def _without_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_without_nan(one) for one in value]
    return None if math.isnan(value) else value


def floats(lists: object, *shape: int) -> Array:
    """Lists as an array of floats.

    Parameters
    ----------
    lists
        As `listed` gives them.
    *shape
        The shape it must have; -1: any.

    Raises
    ------
    ValueError
        Another shape.
    """
    array = np.array(lists, dtype=np.float64)
    if array.size == 0 and 0 in (wanted := tuple(max(n, 0) for n in shape)):
        array = array.reshape(wanted)
    if len(array.shape) != len(shape) or any(
        n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)
    ):
        raise ValueError(f"numbers of shape {array.shape} where {shape} are due")
    return array


def integers(lists: object) -> tuple[int, ...]:
    """A list of whole numbers.

    Raises
    ------
    ValueError
        Something else.
    """
    if not isinstance(lists, list) or not all(type(n) is int for n in lists):
        raise ValueError(f"{lists!r} where whole numbers are due")
    return tuple(lists)
