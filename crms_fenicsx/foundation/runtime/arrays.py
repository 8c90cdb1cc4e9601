"""Array types, and operations on ragged lists stored in one array."""

from __future__ import annotations

from enum import Enum
from typing import cast

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Booleans = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int32]
"""Local indices, in the integer type of DOLFINx and PETSc."""
Integers = npt.NDArray[np.int64]
"""Global indices."""

EPSILON = float(np.finfo(float).eps)
"""Machine epsilon of float64."""


def pointers(counts: npt.NDArray[np.integer]) -> Integers:
    """CSR pointers (n + 1,) of n consecutive lists with `counts` (n,) members."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])


def runs(first: Integers, counts: Integers) -> Integers:
    """Concatenated integer ranges: `counts` numbers from `first` on, for each of n ranges."""
    ends = np.cumsum(counts)
    return np.repeat(first - ends + counts, counts) + np.arange(counts.sum())


def floats(values: Array) -> list[float]:
    """A vector (n,) as a list of Python floats, which loops read faster."""
    return cast(list[float], values.tolist())


def ints(values: npt.NDArray[np.integer]) -> list[int]:
    """An integer array (n,) as a list of Python ints."""
    return cast(list[int], values.tolist())


def flags(values: Booleans) -> list[bool]:
    """A Boolean array (n,) as a list of Python bools."""
    return cast(list[bool], values.tolist())


class Rows(Enum):
    """Entities of the rows of a distributed array; files store them in the mesh's numbering."""

    VERTICES = "vertices by degree of freedom, with ghosts"
    SHARES = "what this rank gives to its vertices, with ghosts; sums over the ranks count"
    EDGES = "edges, with ghosts, of which some are marked"
    CELLS = "this rank's cells"


UNSAVED = object()
"""Marks, in type hints, the fields that are not saved to files."""
