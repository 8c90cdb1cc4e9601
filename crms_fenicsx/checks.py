"""Checks of numbers that users give: what is wrong with them, by name, value and remedy."""

from __future__ import annotations

import math
import operator

import numpy as np
import numpy.typing as npt

from crms_fenicsx.errors import InputError

Array = npt.NDArray[np.float64]


def finite(what: str, value: object) -> float:
    """Return a finite number.

    Parameters
    ----------
    what
        Owner and name of the value, as in "Cable: EA".
    value
        What the user gave.

    Raises
    ------
    InputError
        If it is no number, or not a finite one. Texts are no numbers.
    """
    try:
        if isinstance(value, str | bytes) or np.ndim(value) != 0:  # type: ignore[arg-type]
            raise TypeError
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"{what} = {value!r} is no number; give a finite one.") from None
    if not math.isfinite(number):
        raise InputError(f"{what} = {value!r} is not finite; give a finite number.")
    return number


def positive(what: str, value: object) -> float:
    """Return a positive, finite number; `what` and errors as for `finite`."""
    number = finite(what, value)
    if number <= 0:
        raise InputError(f"{what} = {value!r} is not positive; give a positive number.")
    return number


def whole(what: str, value: object, least: int) -> int:
    """Return a whole number that is `least` or more; `what` and errors as for `finite`."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if isinstance(value, bool) or number < least:
        raise InputError(f"{what} = {value!r} must be a whole number, {least} or more.")
    return number


def vector(what: str, value: object) -> Array:
    """Return three finite numbers, (3,); `what` and errors as for `finite`."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        raise InputError(f"{what} = {value!r} must be three finite numbers (x, y, z).")
    return numbers
