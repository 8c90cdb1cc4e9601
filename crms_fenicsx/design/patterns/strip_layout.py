"""Layout of strips: seams between two lines, and the distortion of pieces before flattening."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Literal

import numpy as np

from crms_fenicsx.design.patterns.compensation import warp_moduli
from crms_fenicsx.design.patterns.flattening import aligned, conformal
from crms_fenicsx.design.patterns.pattern import Materials, Warp, of_cells
from crms_fenicsx.design.patterns.pattern_surface import (
    ON_VERTEX,
    PatternSurface,
    straight_line,
)
from crms_fenicsx.design.patterns.pieces import Pieces
from crms_fenicsx.design.patterns.seams import Line, Seam, points_of, seam_of
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Finite, Positive, collective
from crms_fenicsx.foundation.runtime.arrays import Array, ints
from crms_fenicsx.foundation.runtime.errors import InputError, PathError, as_text, raised_together
from crms_fenicsx.foundation.surface.flip_geodesic import shorten
from crms_fenicsx.foundation.surface.points import SurfacePoint, VertexPoint
from crms_fenicsx.model.materials import Direction, check_warp
from crms_fenicsx.model.tolerances import SAME_PLACE

MOST_STRIPS = 1000
"""Maximum number of strips between two lines."""
STATIONS = 64
"""Number of sections at which a piece's width is measured."""


Points = tuple[SurfacePoint, ...]


@collective
def strips(
    mesh: MembraneMesh,
    first: Line,
    last: Line,
    width: Positive,
    *,
    kind: Literal["geodesic", "parallel"] = "geodesic",
    warp: Direction | None = None,
    allowance: Finite = 0.0,
    name: str = "seam",
) -> list[Seam]:
    """Make seams between two lines for the fewest strips of a given width. Collective.

    Seams divide the distance between the lines at equal shares, chosen so that the strips are alike
    in width; geodesic ones are then pulled taut between their ends, which saves fabric. Between
    lines that meet in a corner, such as two neighbouring edges of a sail, strips fan out from the
    corner. Strips are added until the distance between neighbouring seams over the surface fits the
    width. Where a seam touches an edge that curves inward, it ends, and another goes on from where
    it leaves. `flatten` and the layout on the roll check the flat pieces.

    Parameters
    ----------
    mesh
        The surface, such as `FoundForm.mesh`.
    first, last
        Two lines, seams or names of groups of edges, such as two opposite sides of a hall, or two
        that meet at one or both of their ends.
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
        On all ranks: lines without seams between them, or that meet elsewhere than at their ends,
        or a warp that leads from one line to the other.

    Examples
    --------
    >>> seams = patterns.strips(found.mesh, "front", "back", width=2.5, allowance=0.04)
    """
    surface = PatternSurface.of(mesh)
    usable = usable_width("strips", width, allowance)
    if warp is not None:
        check_warp("strips", warp)
    ends = [points_of(surface, "strips", line) for line in (first, last)]
    from_first, from_last = (surface.distances(points) for points in ends)
    whole = from_first + from_last
    _check_apart(surface, whole, ends)
    whole[whole <= SAME_PLACE * whole.max()] = 0.0
    part = from_first / np.where(whole > 0.0, whole, np.nan)
    fan = whole.min() == 0.0
    count = max(math.ceil(float(whole.min()) / usable * (1.0 - 1e-9)), 1)
    while count <= MOST_STRIPS:
        at, widest = np.linspace(0.0, 1.0, count + 1), np.inf
        while True:
            middles = (at[:-1] + at[1:]) / 2 if fan else at[:0]
            lines, inner = (
                [_line(surface, part - own, whole, kind, warp) for own in places]
                for places in (at[1:-1], middles)
            )
            if warp is not None:
                _check_across([*lines, *inner], part)
            across = _widths_of_strips(surface, [ends[0], *lines, ends[1]], inner)
            if across.max() <= usable * (1.0 + 1e-9):
                seams = chain.from_iterable(_off_the_rim(surface, line) for line in lines)
                return [seam_of(surface, f"{name} {k}", line) for k, line in enumerate(seams, 1)]
            if across.sum() > count * usable or across.max() >= widest:
                break  # strips that are alike would be too wide, or are as alike as can be
            widest, sums = across.max(), np.concatenate([[0.0], np.cumsum(across)])
            at = np.interp(np.linspace(0.0, sums[-1], count + 1), sums, at)
        count = max(count + 1, math.floor(across.sum() / usable))
    raise PathError(
        f"strips: even {MOST_STRIPS} strips are wider than {usable:.6g}; use a wider roll."
    )


def usable_width(call: str, width: float, allowance: float) -> float:
    """Width of the roll less the allowances of both sides (length)."""
    if not 0.0 <= 2.0 * allowance < width:
        raise InputError(
            f"{call}: a roll {width:.6g} wide with an allowance of {allowance:.6g} on both sides "
            "leaves no fabric; the width must be more than twice the allowance."
        )
    return width - 2.0 * allowance


def _at(point: SurfacePoint, values: Array) -> float:
    """Vertex values (n,), linear between vertices, at a point."""
    return float(np.dot(point.weights, values[list(point.support)]))


def _line(
    surface: PatternSurface, values: Array, whole: Array, kind: str, warp: Direction | None
) -> Points:
    """The zero line of `values`, where `first` and `last` are closest, straightened as `kind`
    requires or replaced by the line along the warp through its middle."""
    lines = surface.crossings(values)
    if not lines:
        raise PathError("strips: no line between first and last divides the surface there.")
    line = min(lines, key=lambda line: float(np.mean([_at(p, whole) for p in line])))
    line = (*_corner(surface, line[0], whole), *line, *_corner(surface, line[-1], whole))
    if warp is not None:
        return _along_warp(surface, line, warp)
    if kind == "parallel" or line[0] == line[-1]:
        return line
    return shorten(line, surface).points


def _widths_of_strips(
    surface: PatternSurface, lines: Sequence[Points], middles: Sequence[Points]
) -> Array:
    """Largest widths of strips between lines: from either line to the other, or for wedges, which
    are narrower than that, the sum of those on both sides of their middle lines."""
    away = [surface.distances(line) for line in middles or lines]
    widths = list[float]()
    for k, (before, beyond) in enumerate(pairwise(lines)):
        after = [_at(p, away[k]) for p in beyond]
        back = [_at(p, away[k if middles else k + 1]) for p in before]
        widths.append(max(after) + max(back) if middles else max(*after, *back))
    return np.array(widths)


def _check_across(lines: Sequence[Points], part: Array) -> None:
    """Refuse seams along the warp that lead from first to last, at parts (n,) of their distance."""
    ends_at = [[_at(p, part) for p in (line[0], line[-1])] for line in lines]
    if any(abs(a - b) > 1.0 - 1e-9 for a, b in ends_at):
        raise PathError(
            "strips: the warp leads from first to last, so that seams along it make no strips "
            "between these; use two lines beside the warp."
        )


def _check_apart(surface: PatternSurface, whole: Array, ends: Sequence[Points]) -> None:
    """Refuse lines on two surfaces, or that meet but at their ends."""
    if not np.isfinite(whole).all():
        raise PathError("strips: first and last do not lie on one connected surface.")
    one, other = ({line[k].support for k in (0, -1) if line[0] != line[-1]} for line in ends)
    for v in ints(np.flatnonzero(whole <= SAME_PLACE * whole.max())):
        if (v,) not in one & other:
            raise PathError(
                f"strips: first and last meet at {as_text(surface.points[v])}, which is not an end "
                "of both; use lines that have a corner in common at most."
            )


def _corner(surface: PatternSurface, end: SurfacePoint, whole: Array) -> Points:
    """The vertex beside the end of a line at which first and last meet, if there is one."""
    around = {int(v) for row in surface.target.cells_with(end.support) for v in surface.cells[row]}
    return tuple(VertexPoint(v) for v in sorted(around) if whole[v] == 0.0)[:1]


def _off_the_rim(surface: PatternSurface, line: Points) -> list[Points]:
    """The parts of a line between the points at which it touches the rim, as a taut one does where
    an edge of the roof curves inward."""
    if line[0] == line[-1]:
        return [line]
    points = list[SurfacePoint]()
    for p in line:
        vertex = VertexPoint(p.support[int(np.argmax(p.weights))])
        touches = max(p.weights) >= 1.0 - ON_VERTEX and surface.on_rim(vertex)
        if not points or not touches or points[-1] != vertex:
            points.append(vertex if touches else p)
    stops = [k for k, p in enumerate(points) if k in (0, len(points) - 1) or surface.on_rim(p)]
    return [
        tuple(points[a : b + 1]) for a, b in pairwise(stops)
        if b > a + 1 or len({*points[a].support, *points[b].support}) > 2
        or len(surface.target.cells_with(points[a].support, points[b].support)) > 1
    ]  # fmt: skip


def _along_warp(surface: PatternSurface, line: Points, warp: Direction) -> Points:
    """The line along the warp through the middle of another line, from rim to rim."""
    lengths = arc_lengths(surface.places(line))
    middle = line[int(np.abs(lengths - lengths[-1] / 2).argmin())]

    def at(place: Array) -> Array:
        given = np.ravel(warp(place[:, None])) if callable(warp) else warp
        return checks.vector("strips: warp", given)

    return tuple(straight_line(surface, middle, at))


@dataclass(frozen=True)
class Estimate:
    """Estimate of the distortion of a flat piece.

    Attributes
    ----------
    width
        Largest width across the warp (length).
    curvature
        Mean Gaussian curvature (1 / length squared).
    strain
        Largest strain, ``|K| W**2 / 12``.
    energy
        Energy per area, ``E t K**2 W**4 / 1440`` with E t along the warp and the mean of W**4 over
        the piece (force per length).
    """

    width: float
    curvature: float
    strain: float
    energy: float


@collective
def estimates(
    pieces: Pieces, material: Materials, *, warp: Warp | None = None
) -> dict[str, Estimate]:
    """Estimate the strains of pieces before they are laid flat. Collective.

    Parameters
    ----------
    pieces
        Pieces from `cut`.
    material, warp
        As of `flatten`.

    Returns
    -------
    dict of str to Estimate
        Estimates by names of pieces.

    Raises
    ------
    InputError
        On all ranks: invalid arguments.

    Examples
    --------
    >>> {name: one.strain for name, one in patterns.estimates(pieces, fabric).items()}
    """
    stiffness, warps = of_cells(pieces, material, warp)
    found = {}
    with raised_together(pieces.comm):
        for piece in pieces.pieces:
            flat = aligned(piece, conformal(piece.points, piece.triangles), warps)
            widths, K = _widths(flat[piece.outline]), piece.curvature
            modulus = float(piece.areas @ warp_moduli(stiffness[piece.cells])) / piece.area
            fourth = float(np.sum(widths**5) / np.sum(widths))
            widest = float(widths.max())
            found[piece.name] = Estimate(
                widest, K, abs(K) * widest**2 / 12.0, modulus * K**2 * fourth / 1440.0
            )
    return found


def _widths(outline: Array) -> Array:
    """Widths (STATIONS,) of a closed outline (n, 2) at equidistant sections across x."""
    low, high = outline[:, 0].min(), outline[:, 0].max()
    stations = low + (high - low) * (np.arange(STATIONS) + 0.5) / STATIONS
    least, most = np.full(STATIONS, np.inf), np.full(STATIONS, -np.inf)
    for a, b in pairwise(np.concatenate([outline, outline[:1]])):
        within = (stations - a[0]) * (stations - b[0]) <= 0.0
        if a[0] == b[0] or not within.any():
            continue
        y = a[1] + (stations[within] - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
        least[within], most[within] = np.minimum(least[within], y), np.maximum(most[within], y)
    return most - least
