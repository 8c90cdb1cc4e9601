"""Nets of plane sections, great circles and user-defined paths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.nets.assembly import assembled, checked_scene, route_of_call
from crms_fenicsx.design.nets.whole_surface import WholeSurface
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.refinement import check_positive
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, collective
from crms_fenicsx.model.cable import Net


@collective
def sections(
    scene: Scene,
    angles: Sequence[float],
    offsets: Sequence[float],
    *,
    center: Sequence[float] = (0.0, 0.0),
    shortest: bool = False,
) -> Net:
    """Lay out a net that is straight in plan: sections of the membrane with vertical planes.

    Collective. On an air hall such cables are longer than the shortest paths between their ends and
    slide towards these unless friction or clamps hold them.

    Parameters
    ----------
    scene
        A scene, on whose current shape the net is laid out.
    angles
        Direction of each family in plan, from the x axis (rad).
    offsets
        Distances of each family's lines from `center`, to the left of its direction (length).
    center
        Point in plan, (2,) (length).
    shortest
        Whether to pull the lines taut between their ends on the rim.

    Returns
    -------
    Net
        The net.

    Raises
    ------
    InputError
        On all ranks: arguments that are not finite, or a plane that does not meet the rim twice.
    PathError
        A line that cannot be laid on the membrane.

    Examples
    --------
    >>> net = nets.sections(scene, angles=(np.pi / 4, -np.pi / 4), offsets=[-9, -3, 3, 9])
    """
    call = "sections"
    scene = checked_scene(call, scene)
    checks.same(scene.comm, call, angles=angles, offsets=offsets, center=center, shortest=shortest)
    middle = checks.vector(f"{call}: center with z = 0", [*center, 0.0])[:2]
    surface = WholeSurface.of(scene.membrane)
    table = EdgeTable.of(surface.cells)
    rim = surface.points[table.vertices[table.counts == 1]][:, :, :2]
    families = []
    for angle in angles:
        angle = checks.finite(f"{call}: angle", angle)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        family = []
        for offset in offsets:
            offset = checks.finite(f"{call}: offset", offset)
            height = (rim - middle) @ across - offset
            cut = (height[:, 0] >= 0.0) != (height[:, 1] >= 0.0)
            if np.count_nonzero(cut) < 2:
                raise InputError(
                    f"{call}: the line with angle = {angle:g} and offset = {offset:g} does not "
                    "cross the membrane's rim twice; give a smaller offset."
                )
            ends, (first, second) = rim[cut], height[cut].T
            places = ends[:, 0] + (first / (first - second))[:, None] * (ends[:, 1] - ends[:, 0])
            order = np.argsort(places @ along)
            family.append(places[order[[0, -1]]])
        families.append(family)
    return assembled(call, surface, families, taut=bool(shortest))


@collective
def from_paths(scene: Scene, families: Sequence[Sequence[Array]], *, shortest: bool = False) -> Net:
    """Make a net of given paths. Collective.

    Parameters
    ----------
    scene
        A scene, on whose current shape the net is laid out.
    families
        Paths of each family, as for `Scene.lay_cable`, (k, 2) or (k, 3) (length).
    shortest
        Whether to pull the lines taut between their ends.

    Returns
    -------
    Net
        The net.

    Raises
    ------
    PathError
        On all ranks: a path that cannot be laid on the membrane.

    Examples
    --------
    >>> offsets = np.linspace(-15.0, 15.0, 7)
    >>> net = nets.from_paths(
    ...     scene,
    ...     [[nets.great_circle(20.0, 10.0, angle, s) for s in offsets] for angle in (0.0, 1.2)],
    ... )
    """
    call = "from_paths"
    scene = checked_scene(call, scene)
    checks.same(scene.comm, call, families=families, shortest=shortest)
    routes = [[route_of_call(call, path) for path in family] for family in families]
    return assembled(call, WholeSurface.of(scene.membrane), routes, taut=bool(shortest))


def great_circle(radius: float, height: float, angle: float, offset: float) -> Array:
    """Return the shortest path over a spherical cap between two points of its rim.

    Parameters
    ----------
    radius, height
        As for `meshes.spherical_cap`; the cap is less than a hemisphere. Its centre is the origin.
    angle
        Direction in plan of the line between the two points of the rim, from the x axis (rad).
    offset
        Distance of that line from the rim's centre, to its left (length).

    Returns
    -------
    ndarray
        Points in plan, shape (33, 2).

    Raises
    ------
    InputError
        An argument that is not finite, a length that is not positive, a cap that is too high, or a
        line beyond it.
    """
    check_positive("the great circle", radius=radius, height=height)
    angle, offset = (
        checks.finite(f"the great circle: {name}", value)
        for name, value in (("angle", angle), ("offset", offset))
    )
    for name, value in (("height", height), ("offset", abs(offset))):
        if value >= radius:
            raise InputError(f"the great circle has {name} = {value}: give less than {radius}")
    sphere = (radius**2 + height**2) / (2 * height)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    half = np.sqrt(radius**2 - offset**2)
    ends = [offset * across + side * half * along for side in (-1, 1)]
    start, end = (np.append(point, sphere - height) / sphere for point in ends)
    turn = np.arccos(start @ end)
    s = np.linspace(0.0, turn, 33)[:, None]
    way = sphere * (np.sin(turn - s) * start + np.sin(s) * end)[:, :2] / np.sin(turn)
    return np.asarray(way)
