"""Cables along lines of the mesh: the parts of `benchmarks/lines.py`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Result = TypeVar("Result")


def timed(function: Callable[[], Result]) -> tuple[float, Result]:
    """CPU seconds of a call, and its result."""
    begin = time.process_time()
    found = function()
    return time.process_time() - begin, found


def limit(sizes: Sequence[float], values: Sequence[Any]) -> NDArray[np.float64]:
    """Values that meshes of these sizes lead to, by least squares in the square of the size."""
    found = np.asarray(values, dtype=float)
    fit: NDArray[np.float64] = np.polyfit(np.square(sizes), found.reshape(len(sizes), -1), 1)[1]
    return fit.reshape(found.shape[1:])
