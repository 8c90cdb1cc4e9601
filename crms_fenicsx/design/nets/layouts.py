"""Nets of geodesics, plane sections, great circles and given paths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.paths.routes import traced
from crms_fenicsx.design.nets.assembly import assembled
from crms_fenicsx.design.nets.whole_surface import WholeSurface, crossed
from crms_fenicsx.foundation.meshes.membrane_mesh import rows_of
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, cross, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Finite, Positive, checked, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, PathError
from crms_fenicsx.foundation.surface.trace import route_points
from crms_fenicsx.model.cable import Net


@collective
def geodesics_between(
    scene: Scene, edges: Sequence[tuple[str, str]], n: int | Sequence[int]
) -> Net:
    """Lay out a net of shortest paths between pairs of edges. Collective.

    The n lines of a family join points that divide both of its edges into n + 1 equal parts, each
    by the shortest path near the straight line in plan.

    Parameters
    ----------
    scene
        A scene, on whose current shape the net is laid out.
    edges
        Pairs of edge groups, one for each family, such as ``[("left", "right"), ("front",
        "back")]``. A group is one line with two ends.
    n
        Number of lines, for each family or for all.

    Raises
    ------
    InputError
        On all ranks: unknown groups, groups that are closed or in pieces, or an invalid number.
    PathError
        A line that cannot be laid on the membrane.

    Examples
    --------
    >>> roof = Scene(meshes.rectangle(MPI.COMM_WORLD, 30.0, 20.0, size=5.0), fabric)
    >>> net = nets.geodesics_between(roof, [("left", "right"), ("front", "back")], n=3)
    >>> cables = roof.lay_net(net, Cable(EA=20e3), tension=5.0)
    """
    call = "geodesics_between"
    surface = WholeSurface.of(call, scene)
    pairs = list(edges) if isinstance(edges, list | tuple) else []
    if not pairs or not all(isinstance(one, list | tuple) and len(one) == 2 for one in pairs):
        raise InputError(
            f'{call}: edges = {edges!r}, expected pairs of groups, as in [("left", "right")].'
        )
    given = [n] * len(pairs) if isinstance(n, int) else list(n)
    counts = [checks.whole(f"{call}: n", one, 1) for one in given]
    if len(counts) != len(pairs):
        raise InputError(f"{call}: n = {n!r} has {len(counts)} numbers for {len(pairs)} families.")
    families: list[list[Array]] = []
    for names, count in zip(pairs, counts, strict=True):
        starts, stops = [_divided(_chain(surface, name), count) for name in names]
        ends, others = (np.array([line[0], line[-1]]) for line in (starts, stops))
        if np.sum(norm(ends - others[::-1])) < np.sum(norm(ends - others)):
            stops = stops[::-1]
        families.append([*np.stack([starts, stops], axis=1)[:, :, :2]])
    return assembled(call, surface, families, taut=True)


@collective
def geodesics_across(
    scene: Scene, lines: Sequence[Sequence[Sequence[float]] | Array], spacing: Positive
) -> Net:
    """Lay out a net of geodesics that cross given lines at right angles. Collective.

    A family starts at equal distances along its line, centred on it, runs straight on to the rim on
    both sides, and is then pulled taut between its ends. Away from the line its spacing changes
    with the curvature: on a sphere of radius R as cos(s / R).

    Parameters
    ----------
    scene
        A scene, on whose current shape the net is laid out.
    lines
        Points of one line for each family, in plan, (k, 2), or in space, (k, 3) (length).
    spacing
        Distance between the geodesics of a family, along its line (length).

    Raises
    ------
    InputError
        On all ranks: a spacing larger than a line.
    PathError
        A line that leaves the membrane.

    Examples
    --------
    >>> axes = [[(-18, 0), (18, 0)], [(0, -18), (0, 18)]]
    >>> net = nets.geodesics_across(scene, axes, spacing=6.0)
    """
    call = "geodesics_across"
    surface = WholeSurface.of(call, scene)
    routes = [_route(call, line) for line in lines]
    step = min(surface.size, spacing)
    families = []
    for number, route in enumerate(routes, start=1):
        path = traced(scene.membrane, route, {})
        points = path.positions(surface.strip.vertices, surface.points)
        along: Array = arc_lengths(points)
        if along[-1] < spacing:
            raise InputError(
                f"{call}: spacing = {spacing:g} is more than the length {along[-1]:.6g} of line "
                f"{number}."
            )
        count = int(along[-1] / spacing * (1 + 1e-9))
        at = along[-1] / 2 + spacing * (np.arange(count) - (count - 1) / 2)
        family = []
        for s in at:
            k = min(int(np.searchsorted(along, s, side="right")), len(points) - 1)
            way = points[k] - points[k - 1]
            start = points[k - 1] + (s - along[k - 1]) / (along[k] - along[k - 1]) * way
            across = cross(surface.normal(start), way / norm(way))
            across /= norm(across)
            back, ahead = (surface.to_rim([start], step, sign * across) for sign in (-1.0, 1.0))
            family.append(np.array([*back[:0:-1], *ahead]))
        families.append(family)
    return assembled(call, surface, families, taut=True)


def _chain(surface: WholeSurface, name: str) -> Array:
    """Vertices of an edge group from end to end, (k, 3). Collective."""
    (chain,) = rows_of(surface.membrane.mesh, "geodesics_between", [name])
    return surface.points[np.searchsorted(surface.strip.vertices, chain)]


def _divided(points: Array, n: int) -> Array:
    """The n points that divide a polyline into n + 1 equal parts, (n, 3)."""
    along = arc_lengths(points)
    at = along[-1] * np.arange(1, n + 1) / (n + 1)
    return np.column_stack([np.interp(at, along, points[:, i]) for i in range(3)])


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

    Raises
    ------
    InputError
        On all ranks: arguments that are not finite, or a plane that does not meet the rim twice.
    PathError
        A line that cannot be laid on the membrane.

    Examples
    --------
    >>> angles = (np.pi / 4, -np.pi / 4)
    >>> net = nets.sections(scene, angles=angles, offsets=[-9, -3, 3, 9])
    """
    call = "sections"
    surface = WholeSurface.of(call, scene)
    middle = checks.vector(f"{call}: center", center, (2,))
    rim = surface.rim[:, :, :2]
    families = []
    for angle in angles:
        angle = checks.finite(f"{call}: angle", angle)
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        family = []
        for offset in offsets:
            offset = checks.finite(f"{call}: offset", offset)
            places = crossed(rim, (rim - middle) @ across - offset)
            if len(places) < 2:
                raise InputError(
                    f"{call}: the line with angle = {angle:g} and offset = {offset:g} does not "
                    "cross the membrane's rim twice; use a smaller offset."
                )
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

    Raises
    ------
    PathError
        On all ranks: a path that cannot be laid on the membrane.

    Examples
    --------
    >>> offsets = np.linspace(-15.0, 15.0, 7)
    >>> families = [
    ...     [nets.great_circle(20.0, 10.0, angle, s) for s in offsets] for angle in (0.0, 1.2)
    ... ]
    >>> net = nets.from_paths(scene, families)
    """
    call = "from_paths"
    surface = WholeSurface.of(call, scene)
    routes = [[_route(call, path) for path in family] for family in families]
    return assembled(call, surface, routes, taut=bool(shortest))


@checked
def great_circle(radius: Positive, height: Positive, angle: Finite, offset: Finite) -> Array:
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

    Examples
    --------
    >>> line = nets.great_circle(radius=20.0, height=10.0, angle=0.0, offset=5.0)
    >>> line.shape, line[16].round(2)
    ((33, 2), array([0.  , 7.91]))
    """
    for name, value in (("height", height), ("offset", abs(offset))):
        if value >= radius:
            raise InputError(f"great_circle: {name} = {value} must be less than {radius}.")
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


def _route(call: str, route: object) -> Array:
    """The points of a route, (k, 2) or (k, 3)."""
    try:
        return route_points(route)
    except PathError as error:
        raise PathError(f"{call}: {error}") from None
