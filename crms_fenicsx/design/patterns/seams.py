"""Seams: lines along which the surface is cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.design.patterns.pattern_surface import PatternSurface, straight_line
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime.arguments import Axis, Positive, Vector, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import places_in_space
from crms_fenicsx.foundation.surface.flip_geodesic import shorten
from crms_fenicsx.foundation.surface.points import SurfacePoint
from crms_fenicsx.foundation.surface.trace import checked_route, trace


@dataclass(frozen=True)
class Seam:
    """A line on the surface, from rim to rim or closed.

    Attributes
    ----------
    name
        Name of the seam, and of the edges of pieces on both sides.
    points
        Vertices it passes and crossings with edges of the mesh.
    path
        Positions of these points (k, 3) (length).
    """

    name: str
    points: tuple[SurfacePoint, ...] = field(repr=False)
    path: Array = field(repr=False)

    @property
    def length(self) -> float:
        """Length of the seam (length)."""
        return float(arc_lengths(self.path)[-1])

    @property
    def closed(self) -> bool:
        """Whether the seam is closed."""
        return self.points[0] == self.points[-1]


Line = Seam | str
"""A seam, or the name of an edge group."""


def seam_of(surface: PatternSurface, name: str, points: Sequence[SurfacePoint]) -> Seam:
    """A seam through surface points."""
    if not isinstance(name, str) or not name.strip():
        raise PathError(f"the name of a seam is {name!r}, expected a text.")
    return Seam(name, tuple(points), surface.places(tuple(points)))


def points_of(surface: PatternSurface, call: str, line: Line) -> tuple[SurfacePoint, ...]:
    """The points of a seam or an edge group."""
    return line.points if isinstance(line, Seam) else surface.line_of_group(call, line)


@collective
def geodesic(mesh: MembraneMesh, points: ArrayLike, *, name: str) -> Seam:
    """Make a seam of shortest lines between points. Collective.

    As for cables with ``shortest=True``, the plane section through two points is pulled taut over
    the vertices of the mesh until it is straight in the surface, and so on the flat piece.

    Parameters
    ----------
    mesh
        The surface, such as `FoundForm.mesh`.
    points
        Two or more places in plan (k, 2) or in space (k, 3) (length).
    name
        Name of the seam.

    Raises
    ------
    PathError
        On all ranks: points off the surface, or that no plane section joins.

    Examples
    --------
    >>> seam = patterns.geodesic(found.mesh, [(3.0, 0.0), (3.0, 4.0)], name="seam 1")
    """
    surface = PatternSurface.of(mesh)
    route = checked_route(points)
    found: list[SurfacePoint] = []
    for k in range(len(route) - 1):
        ids = surface.target.ids
        section = trace(ids, surface.points, surface.cells, route[k : k + 2])
        anchor = section.end_anchor if section.start_anchor is None else section.start_anchor
        if anchor is not None:
            raise PathError(
                f"geodesic: the point {as_text(anchor)} does not lie on the surface; use one that "
                "does, or a place in plan."
            )
        leg = shorten(section.points, surface).points
        found += leg[1:] if found and found[-1] == leg[0] else leg
    return seam_of(surface, name, found)


@collective
def geodesic_along(mesh: MembraneMesh, start: Vector, direction: Vector, *, name: str) -> Seam:
    """Make a seam that runs straight through a point, from rim to rim. Collective.

    In the surface it turns neither left nor right: along the warp it follows the fabric.

    Parameters
    ----------
    mesh, name
        As for `geodesic`.
    start
        Point on the surface (3,) (length).
    direction
        Direction (3,), which is projected on the surface.

    Raises
    ------
    PathError
        On all ranks: a point off the surface, a direction normal to it, or a line that does not
        reach the rim.

    Examples
    --------
    >>> start, along = (3.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    >>> seam = patterns.geodesic_along(found.mesh, start, along, name="seam 1")
    """
    surface = PatternSurface.of(mesh)
    place, along = np.asarray(start), np.asarray(direction)
    found = places_in_space(surface.target, place[None], {})[0].point
    if found is None:
        raise PathError(f"geodesic_along: start = {as_text(place)} does not lie on the surface.")
    return seam_of(surface, name, straight_line(surface, found, along))


@collective
def plane_section(mesh: MembraneMesh, origin: Vector, normal: Axis, *, name: str) -> Seam:
    """Make a seam along the surface's section with a plane. Collective.

    Parameters
    ----------
    mesh, name
        As for `geodesic`.
    origin
        Point of the plane (3,) (length); of several lines, the nearest to it becomes the seam.
    normal
        Normal of the plane (3,).

    Raises
    ------
    PathError
        On all ranks: a plane that does not cut the surface.

    Examples
    --------
    >>> origin, normal = (3.0, 2.0, 0.5), (1.0, 0.0, 0.0)
    >>> middle = patterns.plane_section(found.mesh, origin, normal, name="middle")
    >>> len(patterns.cut(found.mesh, [middle]).pieces)
    2
    """
    surface = PatternSurface.of(mesh)
    point, across = np.asarray(origin), np.asarray(normal)
    lines = surface.crossings((surface.points - point) @ (across / np.linalg.norm(across)))
    if not lines:
        raise PathError(
            f"plane_section: the plane through {as_text(point)} with the normal {as_text(across)} "
            "does not cut the surface."
        )
    return seam_of(surface, name, _nearest(surface, lines, point))


def _nearest(
    surface: PatternSurface, lines: Sequence[tuple[SurfacePoint, ...]], point: Array
) -> tuple[SurfacePoint, ...]:
    """The line nearest to a point."""
    gaps = [np.linalg.norm(surface.places(line) - point, axis=1).min() for line in lines]
    return lines[int(np.argmin(gaps))]


@collective
def edge_line(mesh: MembraneMesh, group: str, *, name: str | None = None) -> Seam:
    """Make a seam of mesh edges. Collective.

    Parameters
    ----------
    mesh
        As for `geodesic`.
    group
        Name of a group of edges that form one line, open or closed.
    name
        Name of the seam; by default the group's.

    Raises
    ------
    InputError
        On all ranks: an unknown group.
    PathError
        On all ranks: a group that is not one line.

    Examples
    --------
    >>> rim = patterns.edge_line(found.mesh, "front")
    """
    surface = PatternSurface.of(mesh)
    points = surface.line_of_group("edge_line", group)
    return seam_of(surface, group if name is None else name, points)


@collective
def parallel(
    mesh: MembraneMesh, line: Line, distance: Positive, *, toward: Vector, name: str
) -> Seam:
    """Make a seam at a distance from a line, such as the width of the fabric. Collective.

    Distances are measured over the surface, and are linear between vertices.

    Parameters
    ----------
    mesh, name
        As for `geodesic`.
    line
        A seam, or the name of a group of edges, such as a side of the roof.
    distance
        Distance (length).
    toward
        Point (3,) (length) on the seam's side of `line`; of several lines at the distance, the
        nearest to it becomes the seam.

    Raises
    ------
    PathError
        On all ranks: no part of the surface is that far from the line.

    Examples
    --------
    >>> middle = (6.0, 2.0, 0.0)
    >>> seam = patterns.parallel(found.mesh, "left", 2.0, toward=middle, name="seam 1")
    """
    surface = PatternSurface.of(mesh)
    away = surface.distances(points_of(surface, "parallel", line))
    lines = surface.crossings(away - distance)
    if not lines:
        raise PathError(
            f"parallel: the surface ends {away.max():.6g} from the line, less than distance = "
            f"{distance:.6g}."
        )
    return seam_of(surface, name, _nearest(surface, lines, np.asarray(toward)))
