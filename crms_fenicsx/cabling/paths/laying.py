"""Laying of a cable: from the user's route to a polyline of typed nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.clamping import bonded_parts, bonds_of
from crms_fenicsx.cabling.cables.strip import NOBODY, Strip, StripShape
from crms_fenicsx.cabling.contact.lift_off import drape
from crms_fenicsx.cabling.paths.creased_surface import refuse_forks, refuse_places_behind
from crms_fenicsx.cabling.paths.path_change import fractions_of, nodes_of
from crms_fenicsx.cabling.paths.routes import cells_below, shortened, traced_over_holes
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface, arc_lengths_on
from crms_fenicsx.foundation.meshes.triangles import mix, vectors
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, ints
from crms_fenicsx.foundation.runtime.errors import InputError, PathError
from crms_fenicsx.foundation.surface.closest_point import Balls
from crms_fenicsx.foundation.surface.corridor import cell_between
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.foundation.surface.trace import route_points
from crms_fenicsx.model.cable import HOLDS, Cable, Hold
from crms_fenicsx.model.cable_state import CableLaw, CableNode, CableState, End, LaidAs, StepStart
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE


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


MeasuredOn = Literal["surface", "facets"]


def lay(
    net: CableNet,
    cable: Cable,
    path: Sequence[Sequence[float]] | Array,
    *,
    L0: float | None,
    tension: float | None,
    hold: Hold = "outside",
    layer: int,
    name: str | None,
    measured_on: MeasuredOn,
    shortest: bool = False,
    joints: tuple[str | None, str | None] = (None, None),
) -> LaidCable:
    """Trace the path, type its points, and add the cable; see `Scene.lay_cable`. Collective."""
    # not the number of a removed cable
    name = checks.new_name("lay_cable", "cable", name, (c.name for c in net.cables), net.laid + 1)
    if hold == "bonded" and cable.law == "step":
        raise InputError(
            f'lay_cable: {name!r} is bonded, but its law "step" has one tension for the whole '
            'cable; use law="total".'
        )
    _check_length(name, L0, tension)
    route, known, folds = unfolded(net, route_points(path))
    refuse_places_behind(net.membrane, route, name)
    try:
        way, covers = traced_over_holes(net.membrane, route, known, HOLDS[hold].sideways)
        if shortest:
            way = shortened(net.membrane, way, covers)
    except PathError as error:
        raise PathError(f"lay_cable: {name!r}: {error}") from None
    _refuse_joints_on_the_membrane(name, joints, way)
    strip = cells_below(net.membrane, way, covers)
    shape = StripShape.of(net.membrane, strip)
    refuse_forks(way, shape, name)
    nodes = nodes_of(way.points, strip, _ends(net.membrane, strip, way))
    positions = _positions(nodes, way, shape)
    in_fold = dict(zip(known.values(), folds, strict=False))
    folded = _put_in_folds(nodes, positions, in_fold, SAME_PLACE * net.membrane.size)
    off = np.array([k.point is not None and strip.over_hole(k.support) for k in nodes], dtype=bool)
    if HOLDS[hold].sideways and _follows_free_edge(way, strip):
        hold = "pocket"
    state = CableState(
        nodes, positions, fractions_of(nodes), off, np.full_like(positions, np.nan),
        CableLaw(_held_kind(cable, hold), L0=1.0, length=0.0, tension=0.0),
        LaidAs(hold, layer, joints),
    )  # fmt: skip
    laid = LaidCable(name, state)
    _refuse_folds(net.membrane, strip, laid)
    if laid.lifts_off:
        drape(laid, shape)
    length = polyline_length(laid.state.positions[laid.contacts()])
    if length == 0.0:
        raise PathError(f"lay_cable: the path of {name!r} has no length.")
    smooth = length
    if L0 is None and measured_on == "surface" and cable.law == "total" and hold != "bonded":
        smooth = _smooth_length(laid, shape, folded)
    L0 = smooth / (1 + (tension or 0.0) / cable.EA) if L0 is None else float(L0)
    force = cable.EA / L0 * max(smooth - L0, 0.0)
    laid.update(L0=L0, length=length, tension=force, taut=cable.law == "step" or force > 0)
    if cable.law == "step":
        laid.update(step_start=StepStart(force, length, force * (length - L0) / 2))
    if hold == "bonded":
        laid.update(bonds=bonds_of(laid))
        laid.update(parts=bonded_parts(laid))
    elif cable.along > 0:
        from crms_fenicsx.cabling.friction.axial import initial_state

        laid.update(axial=initial_state(laid, shape))
    if laid.cable.sideways is not None and laid.cable.sideways.law == "step":
        from crms_fenicsx.cabling.friction.lateral import start_elements
        from crms_fenicsx.cabling.friction.slip import material_curve

        start_elements(laid, material_curve(laid, shape), shape)
    net.add(laid, strip)
    return laid


def _held_kind(cable: Cable, hold: Hold) -> Cable:
    """The cable without friction in directions in which `hold` fixes it."""
    free = HOLDS[hold]
    if free.sideways or (cable.sideways is None and free.along):
        return cable
    if not free.along or not cable.along:
        return replace(cable, friction=0.0)
    assert isinstance(cable.friction, Friction)
    along = Friction(0.0, along=cable.along, tolerance=cable.friction.tolerance)
    return replace(cable, friction=along)


def _refuse_joints_on_the_membrane(
    name: str, joints: tuple[str | None, str | None], path: Path
) -> None:
    """Reject a cable that ends at a joint on the membrane."""
    for joint, anchor in zip(joints, (path.start_anchor, path.end_anchor), strict=True):
        if joint is not None and anchor is None:
            raise PathError(
                f"lay_cable: {name!r} ends at the joint {joint!r}, which lies on the membrane; let "
                "the bars end at a vertex there instead, scene.vertex_at(...), and the cable "
                "too."
            )


def _put_in_folds(
    nodes: Sequence[CableNode],
    positions: Array,
    in_fold: Mapping[SurfacePoint, Array],
    reach: float,
) -> set[SurfacePoint]:
    """Move nodes to the folds in `in_fold`, and return the points moved farther than `reach`."""
    moved = set[SurfacePoint]()
    for k, node in enumerate(nodes):
        if node.point is not None and node.point in in_fold:
            fold = in_fold[node.point]
            if np.linalg.norm(fold - positions[k]) > reach:
                moved.add(node.point)
            positions[k] = fold
    return moved


def _check_length(name: str, L0: float | None, tension: float | None) -> None:
    """Check the arguments for the length of a new cable."""
    if L0 is not None and tension is not None:
        raise InputError(f"lay_cable: {name!r} got both L0 and tension; pass one of them.")
    for key, value in (("L0", L0), ("tension", tension)):
        if value is not None:
            checks.positive(f"lay_cable: {name!r} with {key}", value)


def _follows_free_edge(path: Path, strip: Strip) -> bool:
    """Whether a path runs from vertex to vertex along free boundary edges of the membrane."""
    vertices = [point.support[0] for point in path.points if len(point.support) == 1]
    if len(vertices) < max(len(path.points), 2):
        return False
    table = EdgeTable.of(strip.cells)
    edges = np.sort([*pairwise(vertices)], axis=1)
    at_boundary = np.isin(edge_keys(edges), edge_keys(table.vertices[table.counts == 1]))
    held = any((int(a), int(b)) in strip.held_edges for a, b in edges)
    return bool(at_boundary.all()) and not held


def _smooth_length(cable: LaidCable, shape: StripShape, folded: Set[SurfacePoint]) -> float:
    """Length of a cable's path on the smooth surface through the vertices. Facets lie inside it: in
    a stiff membrane they shorten the path by as much as the cable's elastic strain."""
    vertices = shape.strip.vertices
    strip = shape.strip
    solid = strip.cells[strip.is_outer & (strip.owner != NOBODY)]
    surface = SmoothSurface.of(shape.current, np.searchsorted(vertices, solid))
    nodes = cable.contacts()
    on = np.array([
        node.point is not None and node.kind != "edge slider" and node.point not in folded
        for node in (cable.state.nodes[k] for k in nodes)
    ])  # fmt: skip
    found = [cable.interpolation(k) for k, is_on in zip(nodes, on, strict=True) if is_on]
    corners = np.array([(*(shape.strip.row_of[v] for v in ids), 0, 0)[:3] for ids, _ in found])
    weights = np.array([(*share, 0.0, 0.0)[:3] for _, share in found])
    points, normals = cable.state.positions[nodes], np.zeros((len(nodes), 3))
    if on.any():
        offsets, normals[on] = surface.raised(corners, weights)
        points[on] += offsets
    ends_on = on | np.array([cable.state.nodes[k].kind == "edge slider" for k in nodes])
    straight = (np.diff(nodes) > 1) | ~ends_on[:-1] | ~ends_on[1:]
    for i in np.flatnonzero(~straight):
        straight[i] = strip.over_hole(
            cell_between(
                cable.state.nodes[nodes[i]].support, cable.state.nodes[nodes[i + 1]].support
            )
        )
    return float(arc_lengths_on(points, normals, straight).sum())


def _refuse_folds(membrane: Membrane, strip: Strip, cable: LaidCable) -> None:
    """Reject a cable that would fold cells whose material has no compiled law. Collective."""
    edges = {node.point.edge for node in cable.state.nodes if isinstance(node.point, EdgePoint)}
    rows = {row for edge in edges - strip.held_edges for row in strip.rows(edge)}
    mine = [row for row in sorted(rows) if strip.owners[row] == membrane.comm.rank]
    membrane.refuse_folds(strip.local[mine].astype(np.int32), f"lay_cable: {cable.name!r}")


def _ends(membrane: Membrane, strip: Strip, path: Path) -> tuple[End, End]:
    """How the cable's first and last end are held."""
    held = {
        vertex: False for point in (path.points[0], path.points[-1]) for vertex in point.support
    }
    own = strip.owner == membrane.comm.rank
    dofs = membrane.V.dofmap.list[strip.local[own]]
    for vertex, dof in zip(strip.cells[own].ravel(), dofs.ravel(), strict=True):
        if int(vertex) in held:
            held[int(vertex)] = bool(membrane.held[dof].all())
    vertices = {
        v for part in membrane.comm.allgather(held) for v, is_held in part.items() if is_held
    }

    def end(anchor: object, point: SurfacePoint) -> End:
        if anchor is not None:
            return "off"
        if isinstance(point, VertexPoint):
            return "held" if point.vertex in vertices else "tied"
        on_edge = isinstance(point, EdgePoint) and point.edge in strip.held_edges
        return "held" if on_edge else "tied"

    return end(path.start_anchor, path.points[0]), end(path.end_anchor, path.points[-1])


def _positions(nodes: Sequence[CableNode], path: Path, shape: StripShape) -> Array:
    """Positions of nodes at laying; an anchor without a place of its own is at the path's end."""
    ends = {
        k: (path.points[k], anchor)
        for k, anchor in ((0, path.start_anchor), (-1, path.end_anchor))
        if nodes[k].kind == "anchor"
    }
    if 0 in ends:
        nodes = [CableNode("tied", ends[0][0]), *nodes[1:]]
    if -1 in ends:
        nodes = [*nodes[:-1], CableNode("tied", ends[-1][0])]
    found = [node.interpolation() for node in nodes]
    rows = np.array([[*(shape.strip.row_of[v] for v in ids), 0, 0][:3] for ids, _ in found])
    weights = np.array([[*share, 0.0, 0.0][:3] for _, share in found])
    positions = mix(weights, shape.current[rows])
    for k, (_, anchor) in ends.items():
        if anchor is not None:
            positions[k] = anchor
    return positions
