"""Types of arrays, and of lists of different lengths in one array."""

from __future__ import annotations

from enum import Enum
from typing import cast

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Booleans = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int32]
"""Local numbers, as DOLFINx and PETSc take them."""
Integers = npt.NDArray[np.int64]
"""Global numbers."""

EPSILON = float(np.finfo(float).eps)
"""Relative spacing of floating-point numbers."""


def pointers(counts: npt.NDArray[np.integer]) -> Integers:
    """Where lists of `counts` (n,) members begin, one after the other, and the end, (n + 1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])


def runs(first: Integers, counts: Integers) -> Integers:
    """The numbers from `first` on, `counts` of them, for each of n such runs, in one array."""
    ends = np.cumsum(counts)
    return np.repeat(first - ends + counts, counts) + np.arange(counts.sum())


def floats(values: Array) -> list[float]:
    """The numbers of a vector (n,), which loops read faster."""
    return cast(list[float], values.tolist())


def ints(values: npt.NDArray[np.integer]) -> list[int]:
    """The same of whole numbers (n,)."""
    return cast(list[int], values.tolist())


def flags(values: Booleans) -> list[bool]:
    """The same of Booleans (n,)."""
    return cast(list[bool], values.tolist())


class Rows(Enum):
    """What the rows of a distributed array belong to: files have them in the mesh's own numbers."""

    VERTICES = "vertices by degree of freedom, with ghosts"
    SHARES = "what this rank gives to its vertices, with ghosts; sums over the ranks count"
    EDGES = "edges, with ghosts, of which some are marked"
    CELLS = "this rank's cells"


UNSAVED = object()
"""Marks fields, in their type hints, that files do not keep."""
