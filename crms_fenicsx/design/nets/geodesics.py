"""Nets of geodesics, along which frictionless cables stay in place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.paths.routes import traced
from crms_fenicsx.design.nets.assembly import assembled, checked_scene, route_of_call
from crms_fenicsx.design.nets.whole_surface import WholeSurface
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.meshes.edge_table import line_of
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, cross, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, collective
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

    Returns
    -------
    Net
        The net.

    Raises
    ------
    InputError
        On all ranks: unknown groups, groups that are closed or in pieces, or an invalid number.
    PathError
        A line that cannot be laid on the membrane.

    Examples
    --------
    >>> net = nets.geodesics_between(scene, [("left", "right"), ("front", "back")], n=6)
    >>> scene.lay_net(net, Cable(EA=20e3), tension=5.0)
    """
    call = "geodesics_between"
    scene = checked_scene(call, scene)
    checks.same(scene.comm, call, edges=edges, n=n)
    pairs = _checked_pairs(edges)
    given = [n] * len(pairs) if isinstance(n, int) else list(n)
    counts = [checks.whole(f"{call}: n", one, 1) for one in given]
    if len(counts) != len(pairs):
        raise InputError(
            f"{call}: n = {n!r} has {len(counts)} numbers for {len(pairs)} families; give one each."
        )
    surface = WholeSurface.of(scene.membrane)
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
    scene: Scene, lines: Sequence[Sequence[Sequence[float]] | Array], spacing: float
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

    Returns
    -------
    Net
        The net.

    Raises
    ------
    InputError
        On all ranks: a spacing larger than a line.
    PathError
        A line that leaves the membrane.

    Examples
    --------
    >>> net = nets.geodesics_across(scene, [[(-18, 0), (18, 0)], [(0, -18), (0, 18)]], spacing=3.0)
    """
    call = "geodesics_across"
    scene = checked_scene(call, scene)
    checks.same(scene.comm, call, lines=lines, spacing=spacing)
    spacing = checks.positive(f"{call}: spacing", spacing)
    routes = [route_of_call(call, line) for line in lines]
    surface = WholeSurface.of(scene.membrane)
    step = min(surface.size, spacing)
    families = []
    for number, route in enumerate(routes, start=1):
        path = traced(scene.membrane, route, {})
        points = path.positions(surface.strip.vertices, surface.points)
        along: Array = arc_lengths(points)
        if along[-1] < spacing:
            raise InputError(
                f"{call}: spacing = {spacing:g} is more than the length {along[-1]:.6g} of line "
                f"{number}; give a smaller one."
            )
        count = int(along[-1] / spacing * (1 + 1e-9))
        at = along[-1] / 2 + spacing * (np.arange(count) - (count - 1) / 2)
        family = []
        for s in at:
            k = min(int(np.searchsorted(along, s, side="right")), len(points) - 1)
            way = points[k] - points[k - 1]
            start = points[k - 1] + (s - along[k - 1]) / (along[k] - along[k - 1]) * way
            across = cross(surface.normal(start), way / norm(way))
            family.append(_both_ways(surface, start, across / norm(across), step))
        families.append(family)
    return assembled(call, surface, families, taut=True)


def _both_ways(surface: WholeSurface, start: Array, way: Array, step: float) -> Array:
    """Points (k, 3) of the straight line through a point in a direction, from rim to rim."""
    halves = []
    for sign in (-1.0, 1.0):
        first = surface.step(start, sign * way, step)
        if first is None:
            first = surface.rim_ahead(start, sign * way, step)
            halves.append([start] if first is None else [start, first])
        else:
            halves.append(surface.to_rim([start, first], step))
    return np.array([*halves[0][:0:-1], *halves[1]])


def _checked_pairs(edges: object) -> list[tuple[str, str]]:
    """Checked pairs of group names."""
    pairs = list(edges) if isinstance(edges, list | tuple) else []
    for pair in pairs:
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            pairs = []
            break
    if not pairs:
        raise InputError(
            f"geodesics_between: edges = {edges!r}; give pairs of groups of edges, "
            '[("left", "right"), ("front", "back")].'
        )
    return [(a, b) for a, b in pairs]


def _chain(surface: WholeSurface, name: str) -> Array:
    """Vertices of an edge group from end to end, (k, 3). Collective."""
    membrane = surface.membrane
    groups = membrane.mesh.edges
    if name not in groups:
        raise InputError(
            f"geodesics_between: the mesh has no group of edges {name!r}; it has "
            f"{', '.join(sorted(groups))}."
        )
    ids = membrane.vertex_ids[edge_ends(membrane.V)[groups[name]]]
    pairs = {(int(a), int(b)) for part in membrane.comm.allgather(np.sort(ids)) for a, b in part}
    chain, ends = line_of(sorted(pairs))
    if ends != 2 or len(chain) != len(pairs) + 1:
        what = "closed" if not ends else f"no single line: it has {ends} ends"
        raise InputError(
            f"geodesics_between: the group of edges {name!r} is {what}; name groups that are one "
            "line each."
        )
    return surface.points[np.searchsorted(surface.strip.vertices, chain)]


def _divided(points: Array, n: int) -> Array:
    """The n points that divide a polyline into n + 1 equal parts, (n, 3)."""
    along = arc_lengths(points)
    at = along[-1] * np.arange(1, n + 1) / (n + 1)
    return np.column_stack([np.interp(at, along, points[:, i]) for i in range(3)])
