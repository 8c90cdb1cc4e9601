"""Size arguments of the mesh generators: a general size, and smaller sizes near given lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import checked
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, MeshError

_MOST_CELLS = 2e7
_RANGE = 1e-100, 1e100
"""Range of lengths whose squares and cubes neither overflow nor underflow."""


def _length(what: str, value: object) -> float:
    """Return a positive number within `_RANGE`."""
    number = checks.positive(what, value)
    if not _RANGE[0] < number < _RANGE[1]:
        least, most = _RANGE
        raise InputError(
            f"{what} = {number:g} is outside the range of lengths, {least:g} to {most:g}; use "
            "other units."
        )
    return number


Length = Annotated[float, _length]
PlanPoint = Annotated[Sequence[float], partial(checks.vector, sizes=(2,))]


def check_size(what: str, size: float, shortest: float, area: float) -> None:
    """Refuse a mesh size that is too large for a shape, or would need too many cells."""
    if size > shortest:
        raise MeshError(
            f"{what} has size = {size}, more than its smallest extent {shortest:.6g}; "
            "choose a smaller size."
        )
    cells = area / (math.sqrt(3.0) / 4.0 * size**2)
    if cells > _MOST_CELLS:
        raise MeshError(
            f"{what} with size = {size} would need about {cells:.1e} cells, more than "
            f"{_MOST_CELLS:.0e}; choose a larger size."
        )


@checked
@dataclass(frozen=True)
class Refinement:
    """Smaller triangles near a line, for instance below a cable.

    Parameters
    ----------
    line
        Points (at least one) of a polyline. With two coordinates each, distances to it are measured
        in the plan; with three, in space. All points have the same number of coordinates.
    size
        Edge length of the triangles on the line (length).
    distance
        Distance from the line (length) over which the edge length grows linearly to the general
        size.

    Raises
    ------
    InputError
        If the line is not a list of points, or a size is not positive and finite.

    Examples
    --------
    >>> near = meshes.Refinement([(0.0, 0.0)], size=0.1, distance=1.0)  # a corner
    >>> mesh = meshes.rectangle(MPI.COMM_WORLD, 4.0, 4.0, size=1.0, refinements=[near])
    """

    line: Sequence[Sequence[float]]
    size: Length
    distance: Length

    def __post_init__(self) -> None:
        try:
            line = np.asarray(self.line, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            line = np.empty(0)
        if line.ndim != 2 or line.shape[0] < 1 or line.shape[1] not in (2, 3):
            raise InputError(
                f"the refinement's line is {self.line!r}; pass points (x, y), or all (x, y, z)."
            )
        if not np.isfinite(line).all():
            raise InputError(f"the refinement's line {self.line!r} is not finite.")


class TargetSize:
    """Target edge length as a function of position."""

    def __init__(self, general: float, refinements: Sequence[Refinement]) -> None:
        if not isinstance(refinements, Sequence) or not all(
            isinstance(one, Refinement) for one in refinements
        ):
            raise InputError(f"the refinements are {refinements!r}; pass a list of Refinement.")
        for one in refinements:
            if one.size > general:
                raise InputError(
                    f"a refinement has size {one.size}, more than the mesh's {general}; refine to "
                    "a smaller size."
                )
        rows = []
        for one in refinements:
            line = np.asarray(one.line, dtype=np.float64)
            counts = [1.0, 1.0, float(line.shape[1] == 3)]  # of x, y, z in distances
            line = np.pad(line, ((0, 0), (0, 3 - line.shape[1])))
            slope = (general - one.size) / one.distance
            ends = line[1:] if len(line) > 1 else line
            for start, end in zip(line, ends, strict=False):
                rows.append(np.concatenate([start, end - start, counts, [one.size, slope]]))
        self.general, self.refined = general, len(rows) > 0
        self.least = min([general, *(one.size for one in refinements)])
        columns = np.array(rows).reshape(-1, 11)
        self._start, self._along, self._weight = np.split(columns[:, :9], 3, axis=1)
        self._size, self._slope = columns[:, 9:].T
        squared = np.einsum("ij,ij->i", self._along, self._along)
        self._squared = np.where(squared > 0, squared, 1.0)

    def __call__(self, point: Array) -> float:
        """Target edge length at a point (3,)."""
        if not self.refined:
            return self.general
        offset = (point - self._start) * self._weight
        share = (np.einsum("ij,ij->i", offset, self._along) / self._squared).clip(0.0, 1.0)
        gap = offset - share[:, None] * self._along
        distance = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        return min(self.general, float((self._size + self._slope * distance).min()))
