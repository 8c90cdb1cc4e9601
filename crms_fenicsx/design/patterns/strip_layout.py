"""Automatic strip layout between two lines, each strip at most as wide as the fabric allows."""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np

from crms_fenicsx.design.patterns.pattern_surface import PatternSurface
from crms_fenicsx.design.patterns.seams import Line, Seam, points_of, seam_of
from crms_fenicsx.design.patterns.straight_walk import straight_walk
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, PathError, collective
from crms_fenicsx.foundation.surface.flip_geodesic import shorten
from crms_fenicsx.foundation.surface.points import SurfacePoint
from crms_fenicsx.model.materials import Direction, check_warp

MOST_STRIPS = 1000
"""Maximum number of strips between two lines."""

Points = tuple[SurfacePoint, ...]


@collective
def strips(
    mesh: MembraneMesh,
    first: Line,
    last: Line,
    width: float,
    *,
    kind: Literal["geodesic", "parallel"] = "geodesic",
    warp: Direction | None = None,
    allowance: float = 0.0,
    name: str = "seam",
) -> list[Seam]:
    """Make seams between two lines for the fewest strips of a given width. Collective.

    Seams divide the distance between the lines evenly; geodesic ones are then pulled taut between
    their ends, which saves fabric. Strips are added until the distance between neighbouring seams
    over the surface fits the width. `flatten` and the layout on the roll check the flat pieces.

    Parameters
    ----------
    mesh
        The surface, such as `FoundForm.mesh`.
    first, last
        Two lines, seams or names of groups of edges, such as two opposite sides of a hall.
    width
        Width of the roll (length).
    kind
        "geodesic", or "parallel": the lines of even distances themselves.
    warp
        Direction of the fabric (3,), or a function that returns directions (3, n) for points
        (3, n), which the seams follow from the middle of their lines to the rim on both sides.
    allowance
        Seam allowance on each side of a strip (length).
    name
        Names of the seams, with numbers from `first` on: "seam 1", "seam 2" ...

    Returns
    -------
    list of Seam
        The seams in order, without `first` and `last`; none if one strip is enough.

    Raises
    ------
    InputError
        On all ranks: a roll narrower than both allowances, or an invalid argument.
    PathError
        On all ranks: lines without seams between them, or a warp that leads from one line to the
        other.

    Examples
    --------
    >>> seams = patterns.strips(found.mesh, "front", "back", width=2.5, allowance=0.04)
    """
    surface = PatternSurface.of(
        "strips", mesh, first=first, last=last, width=width, kind=kind, warp=warp,
        allowance=allowance, name=name,
    )  # fmt: skip
    usable = usable_width("strips", width, allowance)
    if kind not in ("geodesic", "parallel"):
        raise InputError(f"strips: kind = {kind!r} is not known; use 'geodesic' or 'parallel'.")
    if warp is not None:
        check_warp("strips", warp)
    ends = [points_of(surface, "strips", line) for line in (first, last)]
    from_first, from_last = (surface.distances(points) for points in ends)
    whole = from_first + from_last
    if not np.isfinite(whole).all() or not whole.min() > 0.0:
        raise PathError(
            "strips: the lines first and last meet, or do not lie on one connected surface; give "
            "two apart from each other."
        )
    count = math.ceil(float(whole.min()) / usable * (1.0 - 1e-9))
    while count <= MOST_STRIPS:
        lines = [
            _line(surface, from_first / whole - k / count, whole, kind, warp)
            for k in range(1, count)
        ]
        if warp is not None and any(_crosses(surface, line, from_first / whole) for line in lines):
            raise PathError(
                "strips: the warp leads from first to last, so that seams along it make no strips "
                "between these; give two lines beside the warp."
            )
        widest = _largest_width(surface, [ends[0], *lines, ends[1]])
        if widest <= usable * (1.0 + 1e-9):
            return [seam_of(surface, f"{name} {k}", line) for k, line in enumerate(lines, 1)]
        count = max(count + 1, math.floor(count * widest / usable))
    raise PathError(
        f"strips: even {MOST_STRIPS} strips are wider than {usable:.6g}; give a wider roll."
    )


def usable_width(call: str, width: float, allowance: float) -> float:
    """Width of the roll less the allowances of both sides (length)."""
    roll = checks.positive(f"{call}: width", width)
    taken = checks.finite(f"{call}: allowance", allowance)
    if not 0.0 <= 2.0 * taken < roll:
        raise InputError(
            f"{call}: a roll {roll:.6g} wide with an allowance of {taken:.6g} on both sides leaves "
            "no fabric; the width must be more than twice the allowance."
        )
    return roll - 2.0 * taken


def _line(
    surface: PatternSurface, values: Array, whole: Array, kind: str, warp: Direction | None
) -> Points:
    """The zero line of `values`, where `first` and `last` are closest, straightened as `kind`
    requires or replaced by the line along the warp through its middle."""
    lines = surface.crossings(values)
    if not lines:
        raise PathError("strips: no line between first and last divides the surface there.")

    def apart(line: Points) -> float:
        return float(np.mean([np.dot(p.weights, whole[list(p.support)]) for p in line]))

    line = min(lines, key=apart)
    if warp is not None:
        return _along_warp(surface, line, warp)
    if kind == "parallel" or line[0] == line[-1]:
        return line
    return shorten(line, surface).points


def _along_warp(surface: PatternSurface, line: Points, warp: Direction) -> Points:
    """The line along the warp through the middle of another line, from rim to rim."""
    lengths = arc_lengths(surface.places(line))
    middle = line[int(np.abs(lengths - lengths[-1] / 2).argmin())]

    def at(place: Array, sense: float) -> Array:
        given = np.ravel(warp(place[:, None])) if callable(warp) else warp
        return sense * checks.vector("strips: warp", given)

    place = surface.places((middle,))[0]
    back, ahead = (
        straight_walk(surface, middle, at(place, sense), partial(at, sense=sense))
        for sense in (-1.0, 1.0)
    )
    return (*back[::-1], middle, *ahead)


def _crosses(surface: PatternSurface, line: Points, share: Array) -> bool:
    """Whether a line leads from distance share 0 to 1, from `first` to `last`."""
    start, end = (np.dot(p.weights, share[list(p.support)]) for p in (line[0], line[-1]))
    return bool(abs(start - end) > 1.0 - 1e-9)


def _largest_width(surface: PatternSurface, lines: list[Points]) -> float:
    """Largest distance of a line's points from the previous line."""
    return max(
        float(np.dot(p.weights, away[list(p.support)]))
        for before, line in pairwise(lines)
        for away in [surface.distances(before)]
        for p in line
    )
