"""Laying of cables: from routes, or along lines of the mesh, to polylines of typed nodes.

Along a line, a named group of edges that form one open line, nothing is searched. The path is the
row of its vertices, and the rows of a net and the cells around them are gathered once for all.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.strip import StripShape, cells_at, own_surface
from crms_fenicsx.cabling.paths.creased_surface import refuse_forks, refuse_places_behind
from crms_fenicsx.cabling.paths.placing import (
    MeasuredOn,
    MembraneBelow,
    check_distance,
    check_law,
    put,
)
from crms_fenicsx.cabling.paths.routes import cells_below, shortened, traced_over_holes
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, rows_of
from crms_fenicsx.foundation.meshes.triangles import closest_on_segments, norm, vectors
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, floats, ints
from crms_fenicsx.foundation.runtime.errors import InputError, PathError, as_text
from crms_fenicsx.foundation.surface.closest_point import ON_SURFACE, Balls, feet_of
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import SurfacePoint, VertexPoint
from crms_fenicsx.foundation.surface.trace import route_points
from crms_fenicsx.model.cable import HOLDS, Cable, Hold, Net
from crms_fenicsx.model.cable_state import LaidAs
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE

logger = logging.getLogger("crms_fenicsx")


def unfolded(net: CableNet, route: Array) -> tuple[Array, dict[int, SurfacePoint], list[Array]]:
    """Map a route in space (k, 3) from points on other cables to unfolded cells. Collective.
    Returns route (m, 3): without points at crossings inside cells, which paths do not contain, and
    with those at other cable points moved to the unfolded cells; known: surface points of these, by
    rows of the route; folds: their positions in the folds, in the order of `known`."""
    if route.shape[1] == 2 or net.strip is None:
        return route, {}, []
    contacts: list[tuple[LaidCable, int]] = []
    positions: list[Array] = [np.zeros((0, 3))]
    for cable in net.cables:
        on = [k for k, node in enumerate(cable.state.nodes) if node.point is not None]
        here = [k for k, lifted in zip(on, cable.state.lifted[on], strict=True) if not lifted]
        contacts += [(cable, k) for k in here]
        positions.append(cable.state.positions[here])
    x, reach = np.concatenate(positions), SAME_PLACE * net.membrane.size
    target, contact = Balls(x, np.zeros(len(x))).within(route, np.full(len(route), reach))
    if not len(target):
        return route, {}, []
    first_at: dict[int, int] = {}
    for row, at in zip(ints(target), ints(contact), strict=True):
        first_at.setdefault(row, at)
    shape = net.strip_shape()
    rows: list[Array] = []
    known: dict[int, SurfacePoint] = {}
    folds: list[Array] = []
    for i, place in enumerate(vectors(route)):
        if i in first_at:
            cable, k = contacts[first_at[i]]
            if cable.state.nodes[k].kind == "crossing":
                continue
            known[len(rows)] = cable.point(k)
            folds.append(x[first_at[i]])
            place = shape.mean(*cable.interpolation(k))
        rows.append(place)
    return np.array(rows), known, folds


def lay(
    net: CableNet,
    cable: Cable,
    path: Sequence[Sequence[float]] | Array | None,
    laid_as: LaidAs,
    *,
    L0: float | None,
    tension: float | None,
    name: str | None,
    measured_on: MeasuredOn,
    shortest: bool = False,
) -> LaidCable:
    """Trace the path, type its points, and add the cable; see `Scene.lay_cable`. Collective."""
    if laid_as.line is not None:
        if shortest:
            raise InputError(
                f"lay_cable: along = {laid_as.line!r} leaves no other path, so pass no `shortest`."
            )
        ends = None if path is None else route_points(path)
        one = Along(laid_as.line if name is None else name, laid_as, ends)
        return lay_along(net, cable, [one], L0, tension, measured_on)[0]
    if path is None:
        raise PathError(
            "lay_cable: neither path nor along; pass the points of a path, or a line of the mesh."
        )
    # not the number of a removed cable
    name = checks.new_name("lay_cable", "cable", name, (c.name for c in net.cables), net.laid + 1)
    check_law(name, cable, laid_as, L0, tension)
    route, known, folds = unfolded(net, route_points(path))
    refuse_places_behind(net.membrane, route, name)
    slides = HOLDS[laid_as.hold].sideways
    try:
        way, covers = traced_over_holes(net.membrane, route, known, slides)
        if shortest:
            way = shortened(net.membrane, way, covers)
    except PathError as error:
        raise PathError(f"lay_cable: {name!r}: {error}") from None
    strip = cells_below(net.membrane, way, covers)
    shape = StripShape.of(net.membrane, strip)
    refuse_forks(way, shape, name)
    below = MembraneBelow.of(
        net.membrane, shape, [way], dict(zip(known.values(), folds, strict=False))
    )
    laid = put(below, name, cable, way, laid_as, L0=L0, tension=tension, measured_on=measured_on)
    net.add([laid], strip)
    return laid


def has_lines(mesh: MembraneMesh, net: Net) -> bool:
    """Whether a mesh has the lines of a net, by their names; some of them are an error."""
    lacking = [line.name for line in net.lines if line.name not in mesh.edges]
    if len(lacking) == len(net.lines):
        if mesh.comm.rank == 0:
            logger.info(
                "lay_net: the cables fold the cells that they cross, as the mesh does not have the "
                "net's lines; meshes.along(mesh, net.paths) makes one that has them"
            )
        return False
    if lacking:
        raise InputError(
            f"lay_net: the mesh has some lines of the net, but not {', '.join(lacking)}; make one "
            "that has all, meshes.along(mesh, net.paths), or one without lines of these names."
        )
    return True


@dataclass(frozen=True)
class Along:
    """A cable to be laid along a line of the mesh."""

    name: str
    laid_as: LaidAs
    # (k, 2) or (k, 3), from its start to its end, perhaps beyond the line to anchors (length)
    route: Array | None = None
    of_net: bool = False  # whether the route is that of a net's line, on which it must lie


def lay_along(
    net: CableNet,
    cable: Cable,
    lines: Sequence[Along],
    L0: float | None = None,
    tension: float | None = None,
    measured_on: MeasuredOn = "surface",
) -> tuple[LaidCable, ...]:
    """Lay cables along lines of the mesh; see `Scene.lay_cable`. Collective."""
    membrane, taken = net.membrane, {one.name for one in net.cables}
    rows = rows_of(membrane.mesh, "lay_cable", [one.laid_as.line or "" for one in lines])
    for one in lines:
        checks.new_name("lay_cable", "cable", one.name, taken)
        taken.add(one.name)
        check_law(one.name, cable, one.laid_as, L0, tension)
    strip = cells_at(membrane, list(chain.from_iterable(rows)))
    shape = StripShape.of(membrane, strip)
    ways = [_way(membrane, shape, *both) for both in zip(lines, rows, strict=True)]
    below = MembraneBelow.of(membrane, shape, ways)
    laid = tuple(
        put(
            below,
            one.name,
            cable,
            way,
            one.laid_as,
            L0=L0,
            tension=tension,
            measured_on=measured_on,
        )
        for one, way in zip(lines, ways, strict=True)
    )
    check_distance(membrane, [*net.cables, *laid], len(laid))
    net.add(laid, strip)
    return laid


def lay_net(
    net: CableNet, layout: Net, cable: Cable, tension: float | None, hold: Hold
) -> tuple[LaidCable, ...]:
    """Lay cables along the lines of the mesh that are those of a layout. Collective."""
    lines = [
        Along(one.name, LaidAs(hold, line=one.name), one.path, of_net=True) for one in layout.lines
    ]
    return lay_along(net, cable, lines, tension=tension)


def _way(membrane: Membrane, shape: StripShape, one: Along, row: list[int]) -> Path:
    """The path of a cable along a row of vertices, in the direction of its route, with its anchors.
    Collective."""
    strip, line = shape.strip, one.laid_as.line
    for a, b in pairwise(row) if strip.hidden else ():
        if not strip.outer_rows((a, b)):
            raise PathError(
                f"lay_cable: {one.name!r} along {line!r} comes to {as_text(shape.at(a))} on a part "
                "of the membrane behind a seam, where no cable can be laid; lead the line over the "
                "outer side, or turn that part with the `outside` of the mesh."
            )
    points = tuple(VertexPoint(vertex) for vertex in row)
    if one.route is None:
        unit = SAME_PLACE * membrane.size
        first, last = (np.round(shape.stress_free_at(row[k]) / unit) for k in (0, -1))
        return Path(points if tuple(first) <= tuple(last) else points[::-1])
    if one.of_net:
        _refuse_elsewhere(one, row, shape)
    given, ends = one.route[[0, -1]], np.array([shape.at(row[k]) for k in (0, -1)])
    reaches = [norm(shape.at(row[a]) - shape.at(row[b])) for a, b in ((0, 1), (-1, -2))]
    if given.shape[1] == 2:
        given, ends = np.pad(given, ((0, 0), (0, 1))), ends * (1.0, 1.0, 0.0)
    apart = norm(given[:, None] - ends)
    at = apart.argmin(axis=1)
    if at[0] == at[1]:
        raise InputError(
            f"lay_cable: both ends of the path of {one.name!r} are nearer to the same end of the "
            f"line {line!r}, {as_text(ends[at[0]])}; pass a point at each end, or no path."
        )
    anchors = [
        None if one.of_net else _anchor(membrane, one, given[k], ends[at[k]], reaches[at[k]])
        for k in (0, 1)
    ]
    return Path(points if at[0] == 0 else points[::-1], *anchors)


def _anchor(
    membrane: Membrane, one: Along, given: Array, end: Array, reach: float
) -> tuple[float, float, float] | None:
    """The anchor beyond an end (3,) of a line, if the first or last point (3,) is one; `reach` is
    the length of the line's edge there (length). Collective."""
    away = norm(given - end)
    if away <= ON_SURFACE * reach:
        return None
    assert one.route is not None
    if one.route.shape[1] == 3:
        positions, cells = own_surface(membrane)
        (foot,) = feet_of(positions, cells, given[None], membrane.comm)
        if foot.distance > ON_SURFACE * foot.size:
            x, y, z = floats(given)
            return x, y, z
    if away <= reach:
        return None
    raise InputError(
        f"lay_cable: the path of {one.name!r} ends at {as_text(given)}, {away:.3g} from the end "
        f"{as_text(end)} of the line {one.laid_as.line!r}; end it there or at an anchor off the "
        "membrane, or pass no path."
    )


def _refuse_elsewhere(one: Along, row: list[int], shape: StripShape) -> None:
    """Refuse a line of a net that does not lie where that of the mesh lies, now or stress-free."""
    assert one.route is not None
    some = [shape.strip.row_of[vertex] for vertex in (*row[:: max(len(row) // 8, 1)], row[-1])]
    start, way = one.route[:-1], np.diff(one.route, axis=0)
    whole = shape.stress_free[[shape.strip.row_of[vertex] for vertex in row]]
    reach = float(norm(np.diff(whole, axis=0)).max())
    away = np.inf
    for x in (shape.stress_free[some], shape.current[some]):
        aside = closest_on_segments(start, way, x[:, None])[2].min(axis=1)
        beyond = norm(one.route[[0, -1], None] - x[[0, -1]]).min(axis=1)
        away = min(away, float(max(aside.max(), beyond.max())))
    if away > reach:
        raise InputError(
            f"lay_net: the line {one.name!r} of the net lies up to {away:.3g} from that of the "
            "mesh; lay the net that the mesh was made for, or make a mesh for this one, "
            "meshes.along(mesh, net.paths)."
        )
