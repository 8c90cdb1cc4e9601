"""Straightest lines over the surface, by unfolding cells, or lines along a direction field."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crms_fenicsx.design.patterns.pattern_surface import PatternSurface
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.points import Edge, EdgePoint, Support, SurfacePoint, edge_of

ASIDE = 1e-6
"""Fraction of an edge by which a line that hits a vertex passes beside it."""


def straight_walk(
    surface: PatternSurface,
    start: SurfacePoint,
    direction: Array,
    direction_at: Callable[[Array], Array] | None = None,
) -> tuple[SurfacePoint, ...]:
    """Edge crossings from a point to the rim, none if the direction leaves the surface. A function
    `direction_at` of points (3,), if given, sets the direction in each cell."""
    at = surface.places((start,))[0]
    first = _first_cell(surface, start, direction)
    if first is None:
        return ()
    cell, along = first
    points: list[SurfacePoint] = []
    entered: Support = start.support if len(start.support) < 3 else ()
    for _ in range(4 * len(surface.cells)):
        edge, fraction = _exit(surface, cell, at, along, entered)
        points.append(EdgePoint(edge, fraction))
        at = surface.places((points[-1],))[0]
        beyond = [v for v in surface.opposite_vertices(edge) if v not in cell]
        if len(surface.opposite_vertices(edge)) != 2:
            return tuple(points)
        ahead = (*edge, beyond[0])
        if direction_at is None:
            along = _unfolded(surface, cell, edge, beyond[0], along)
        else:
            along = _within(surface, ahead, direction_at(surface.points[list(ahead)].mean(axis=0)))
        cell, entered = ahead, edge
    raise PathError(
        f"the line straight on from {as_text(surface.places((start,))[0])} does not come to a "
        "rim; give another direction."
    )


def _normal(surface: PatternSurface, cell: Support) -> Array:
    """Unit normal of a cell."""
    a, b, c = surface.points[list(cell)]
    normal = np.cross(b - a, c - a)
    return np.asarray(normal / np.linalg.norm(normal))


def _first_cell(
    surface: PatternSurface, start: SurfacePoint, direction: Array
) -> tuple[Support, Array] | None:
    """The cell at a point into which a direction leads, and the direction within it."""
    for row in sorted(surface.target.cells_at(start)):
        cell = tuple(surface.cells[row].tolist())
        normal, along = _normal(surface, cell), _within(surface, cell, direction)
        # on the inner side of the cell's sides at the point
        sides = [(cell[k], cell[(k + 1) % 3]) for k in range(3)]
        inward = [
            np.cross(normal, surface.points[b] - surface.points[a]) @ along
            for a, b in sides
            if {*start.support} <= {a, b}
        ]
        if all(value >= 0.0 for value in inward):
            return cell, along
    return None


def _within(surface: PatternSurface, cell: Support, direction: Array) -> Array:
    """Unit projection of a direction into a cell's plane."""
    normal = _normal(surface, cell)
    along = direction - (direction @ normal) * normal
    size = np.linalg.norm(along)
    if size <= 1e-6 * np.linalg.norm(direction):
        raise PathError(
            f"the direction {as_text(direction)} of a seam is normal to the surface near "
            f"{as_text(surface.points[list(cell)].mean(axis=0))}; give one that has a part in it."
        )
    return np.asarray(along / size)


def _exit(
    surface: PatternSurface, cell: Support, at: Array, along: Array, entered: Support
) -> tuple[Edge, float]:
    """The edge, and fraction along it, at which a straight line leaves a cell."""
    best: tuple[float, Edge, float] | None = None
    normal = _normal(surface, cell)
    for k in range(3):
        a, b = edge_of(cell[k], cell[(k + 1) % 3])
        if {*entered} & {a, b} == {*entered} != set():
            continue  # the side or vertex at which the line entered
        side = surface.points[b] - surface.points[a]
        across = np.cross(normal, side)
        speed = along @ across
        if speed == 0.0:
            continue
        s = (surface.points[a] - at) @ across / speed
        t = (at + s * along - surface.points[a]) @ side / (side @ side)
        outside = max(-t, t - 1.0, 0.0) + (s < 0.0)
        if best is None or outside < best[0]:
            best = outside, (a, b), t
    assert best is not None
    return best[1], float(np.clip(best[2], ASIDE, 1.0 - ASIDE))


def _unfolded(
    surface: PatternSurface, cell: Support, edge: Edge, beyond: int, along: Array
) -> Array:
    """A direction in a cell, rotated about an edge into the next cell's plane."""
    a, b = surface.points[list(edge)]
    axis = (b - a) / np.linalg.norm(b - a)
    (behind,) = set(cell) - set(edge)
    out, on = a - surface.points[behind], surface.points[beyond] - a
    out, on = out - (out @ axis) * axis, on - (on @ axis) * axis
    ahead = along @ out / np.linalg.norm(out)
    return np.asarray((along @ axis) * axis + ahead * on / np.linalg.norm(on))
