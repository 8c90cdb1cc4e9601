"""The arrays that results are written and drawn from: a triangulated surface and its lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError


@dataclass(frozen=True)
class Surface:
    """Triangles in space with data on their vertices and on themselves.

    Attributes
    ----------
    points : (n, 3) array of length
        Vertices, deformed.
    triangles : (m, 3) array of int
        Vertices of each triangle. A folded cell arrives as several triangles.
    point_data, cell_data : dict of (n,) or (n, c), and of (m,) or (m, c) arrays
        Values by name.
    homes : (n, 2) array of int, or None
        For pieces of a surface on several ranks that share points: the rank that each point belongs
        to, and its number among the points that belong to that rank. None: all belong to this one.
    """

    points: ArrayLike
    triangles: ArrayLike
    point_data: Mapping[str, ArrayLike] = field(default_factory=dict)
    cell_data: Mapping[str, ArrayLike] = field(default_factory=dict)
    homes: ArrayLike | None = None

    def checked(self) -> Surface:
        """Return the surface with plain arrays (float, int64), or raise.

        Raises
        ------
        InputError
            Where shapes disagree, an index points outside or a coordinate is not finite.
        """
        points = checked_points("surface points", self.points)
        triangles = np.asarray(self.triangles)
        if triangles.size == 0:
            triangles = np.empty((0, 3), dtype=np.int64)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise InputError(
                f"triangles have shape {triangles.shape} and type {triangles.dtype}; "
                "give integers of shape (m, 3)"
            )
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            raise InputError(
                f"triangles refer to vertices {triangles.min()} to {triangles.max()}, but there "
                f"are {len(points)} points; number them from 0 within this surface"
            )
        homes = None if self.homes is None else np.asarray(self.homes)
        if homes is not None and (homes.shape != (len(points), 2) or homes.dtype.kind not in "iu"):
            raise InputError(
                f"homes have shape {homes.shape} and type {homes.dtype}; give a rank and a number "
                f"for each point, integers of shape ({len(points)}, 2)"
            )
        return Surface(
            points,
            np.ascontiguousarray(triangles, dtype=np.int64),
            checked_data("point data", self.point_data, len(points)),
            checked_data("cell data", self.cell_data, len(triangles)),
            homes,
        )


@dataclass(frozen=True)
class Line:
    """A polyline in space, such as a cable, with data.

    Attributes
    ----------
    points : (k, 3) array of length
        Its corners, k >= 2.
    data : dict of float, (k,) or (k - 1,) array
        Values by name: one for the line, one per corner or one per segment.
    name : str
        What the line is called in pictures.
    """

    points: ArrayLike
    data: Mapping[str, ArrayLike] = field(default_factory=dict)
    name: str = ""

    def checked(self) -> Line:
        """Return the line with plain arrays, or raise.

        Raises
        ------
        InputError
            Where there are fewer than two points, or data of another length.
        """
        label = f"line {self.name!r}" if self.name else "line"
        points = checked_points(f"{label}: points", self.points)
        if len(points) < 2:
            raise InputError(f"{label} has {len(points)} points; give two or more")
        data: dict[str, NDArray[Any]] = {}
        for name, given in self.data.items():
            values = np.asarray(given)
            if values.dtype.kind not in "biuf":
                raise InputError(f"{label}: {name!r} is of type {values.dtype}; give numbers")
            if values.shape not in {(), (len(points),), (len(points) - 1,)}:
                raise InputError(
                    f"{label}: {name!r} has shape {values.shape}; give one value, one for each "
                    f"of the {len(points)} points or one for each of the {len(points) - 1} segments"
                )
            data[name] = values.astype(np.float64)
        return Line(points, data, self.name)


def checked_points(what: str, given: ArrayLike) -> Array:
    """Return points as an (n, 3) array of finite floats, or raise `InputError`."""
    points = np.ascontiguousarray(given, dtype=np.float64)
    if points.size == 0:
        return np.empty((0, 3))
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{what} have shape {points.shape}; give (n, 3)")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise InputError(f"{what}: number {bad[0]} is {points[bad[0]]}; give finite coordinates")
    return points


def checked_data(what: str, given: Mapping[str, ArrayLike], count: int) -> dict[str, NDArray[Any]]:
    """Return data by name as arrays with `count` rows, or raise `InputError`."""
    data: dict[str, NDArray[Any]] = {}
    for name, values in given.items():
        array = np.ascontiguousarray(values)
        if array.dtype.kind not in "biuf":
            raise InputError(f"{what} {name!r} is of type {array.dtype}; give real numbers")
        if array.ndim not in (1, 2) or len(array) != count:
            raise InputError(
                f"{what} {name!r} has shape {array.shape}; give ({count},) or ({count}, c)"
            )
        data[name] = array.astype(np.uint8) if array.dtype.kind == "b" else array
    return data
