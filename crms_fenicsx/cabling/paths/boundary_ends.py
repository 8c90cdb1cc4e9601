"""Cable ends at moved anchors: where they meet the membrane's boundary.

A cable held at a place on a held edge ends there. If its anchor moves along the boundary, the
path's end follows from edge to edge; if it moves off, the cable continues through the air and
slides along the edge that it passes; if it returns, the cable ends at the boundary again. If the
anchor comes to lie above the membrane, as when the edge is moved under it, the path ends in the
cell below, and follows it; if below the membrane, the cable bends around the edge.
"""

from __future__ import annotations

import itertools

import numpy as np
from dolfinx.mesh import entities_to_geometry
from mpi4py import MPI

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.lift_off import size_at
from crms_fenicsx.cabling.contact.span_projection import project_span
from crms_fenicsx.cabling.paths.path_change import PathChange
from crms_fenicsx.foundation.meshes.triangles import closest_on_segments, cross
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.runtime.errors import PathError, as_text
from crms_fenicsx.foundation.surface.corridor import cell_between
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    Edge,
    EdgePoint,
    SurfacePoint,
    VertexPoint,
    edge_of,
)
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import BUDGET, SAME_PLACE, TOL


def renew_ends(change: PathChange) -> bool:
    """Move the ends of all paths off lines of the mesh to moved anchors, and return whether any
    changed. Collective."""
    changed = False
    shape = change.net.strip_shape()
    for cable in change.net.cables:
        if cable.state.laid.line is not None:
            continue
        for last in (False, True):
            if _renew(change, cable, last, shape):  # it may lie over other cells now
                changed, shape = True, change.net.strip_shape()
        if cable.taut and any(_moved_aside(cable, k, shape) for k in (0, -1)):
            cable.update(path_is_geodesic=False)
    return changed


def refuse_ends_along_rim(net: CableNet) -> None:
    """Refuse anchors of cables on lines of the mesh that have moved to other places of the
    boundary: the cables' ends stay on their lines. Collective."""
    on_lines = [cable for cable in net.cables if cable.state.laid.line is not None]
    if not on_lines:
        return
    shape = net.strip_shape()
    for cable in on_lines:
        for k, beside in ((0, 1), (-1, -2)):
            if cable.state.nodes[k].kind != "anchor":
                continue
            there = shape.mean(*cable.interpolation(beside))
            place, reach = cable.state.positions[k], SAME_PLACE * cable.length
            if np.linalg.norm(place - there) > reach and _edge_at(net.membrane, place, reach):
                raise PathError(
                    f"the end of {cable.name!r} has moved along the boundary to {as_text(place)}, "
                    "but a cable along a line of the mesh ends with it; move it off the membrane, "
                    "or with the edge, or lay the cable by its path."
                )


def _moved_aside(cable: LaidCable, k: int, shape: StripShape) -> bool:
    """Whether an anchor has left the vertical plane of its cable since the last equilibrium, so
    that the old path would draw the cable into the membrane sideways."""
    if cable.state.nodes[k].kind != "anchor" or cable.state.memory.ends_before is None:
        return False
    way = cable.state.positions[k] - cable.state.memory.ends_before[k]
    if not way.any():
        return False
    contacts = cable.contacts()[1:] if k == 0 else cable.contacts()[-2::-1]
    chords = cable.state.positions[contacts] - cable.state.memory.ends_before[k]
    # An end on the boundary occurs twice, as an anchor and as the path's first point.
    apart = np.linalg.norm(chords, axis=1) > SAME_PLACE * cable.length
    beside, along = contacts[np.argmax(apart)], chords[np.argmax(apart)]
    point = cable.state.nodes[beside].point or cable.state.nodes[1].point
    assert point is not None
    aside = cross(along, shape.normal(point.support))
    length = float(np.linalg.norm(aside))
    return abs(float(way @ aside)) > TOL.stays * size_at(shape, point.support) * length


def _renew(change: PathChange, cable: LaidCable, last: bool, shape: StripShape) -> bool:
    anchor, beside = (-1, -2) if last else (0, 1)
    node = cable.state.nodes[beside]
    if cable.state.nodes[anchor].kind != "anchor":
        return False
    led = False
    if isinstance(node.point, CellPoint):
        # pulled taut to the old place the path would go back and forth
        before, now = cable.state.memory.ends_before, cable.state.positions[anchor]
        moved = 0.0 if before is None else float(np.linalg.norm(now - before[anchor]))
        led = moved > SAME_PLACE * cable.length and _lead(change, cable, last)
        node = cable.state.nodes[beside]
        if isinstance(node.point, CellPoint):
            return led
        if led:
            shape = change.net.strip_shape()
    there = cable.state.positions[beside]
    if not cable.state.lifted[beside]:  # its edge may have moved since the last step
        there = shape.mean(*node.interpolation())
    away = float(np.linalg.norm(cable.state.positions[anchor] - there))
    if away <= SAME_PLACE * cable.length and node.kind != "edge slider":
        return False
    found = _edge_at(change.net.membrane, cable.state.positions[anchor], SAME_PLACE * cable.length)
    if found is None:
        if node.kind == "tied" and _lead(change, cable, last, over=True):
            return True
        if node.kind != "tied":
            return led
        nodes = list(cable.state.nodes)  # moved off, it now slides along its edge
        nodes[beside] = CableNode("edge slider", node.point)
        cable.update(nodes=tuple(nodes))
        return True
    points = list(cable.path.points)
    points = points[::-1] if last else points
    way = _way(change, points, *found)
    first, second = cable.ends
    if last:
        change.move_ends(cable, way[::-1], (first, "held"))
    else:
        change.move_ends(cable, way, ("held", second))
    return True


def _lead(change: PathChange, cable: LaidCable, last: bool, over: bool = False) -> bool:
    """Extend or shorten a path to the cell below its anchor, or to where it leaves the membrane.
    With `over`, not to a cell above the anchor."""
    anchor, beside = (-1, -2) if last else (0, 1)
    place, foot = cable.state.positions[anchor], cable.state.nodes[beside]
    ids, weights = foot.interpolation()
    for rings in itertools.count(1):
        shape = change.surface(ids).shape
        try:
            start = shape.mean(ids, weights)
            way = project_span(shape, foot, start, cable.state.nodes[anchor], place)
            break
        except MissingCells as missing:
            change.net.grow_strip(missing.vertices, rings)
    if way is None or set(way[-1].support) == set(ids):
        return False
    if over and isinstance(way[-1], CellPoint):
        up = place - shape.mean(way[-1].support, way[-1].weights)
        if up @ shape.normal(way[-1].support) < -SAME_PLACE * cable.length:
            return False
    points = list(cable.path.points)
    ends = list(cable.ends)
    ends[anchor] = "held" if isinstance(way[-1], CellPoint) else "off"
    points = points if last else points[::-1]
    # An end on the rim of a hole that the cable spans is passed.
    onward = cell_between(points[-2].support, way[0].support)
    points = [*(points[:-1] if shape.strip.rows(onward) else points), *way]
    on = [point for point in points if not shape.strip.over_hole(point.support)]
    if points[-1] not in on and len(on) < 2:
        raise PathError(
            f"an end of {cable.name!r} has been moved to {place}, over a hole, and the cable "
            "leaves the membrane; move it elsewhere, or lay the cable anew."
        )
    points = points if last else points[::-1]
    change.move_ends(cable, points, (ends[0], ends[1]))
    return True


def _edge_at(membrane: Membrane, place: Array, tolerance: float) -> tuple[Edge, float] | None:
    """Held boundary edge at a place, and the fraction on it; None if there is none."""
    mesh = membrane.mesh.mesh
    boundary = membrane.mesh.edges["boundary"]
    boundary = boundary[membrane.held_edges[boundary]]
    behind = mesh.topology.connectivity(2, 1).array.reshape(-1, 3)[membrane.mesh.hidden]
    boundary = np.setdiff1d(boundary, behind)
    nodes = np.zeros((0, 2), dtype=np.int32)
    if len(boundary):  # DOLFINx divides by the number
        nodes = entities_to_geometry(mesh, 1, boundary).reshape(-1, 2)
    cells = geometry_dofmap(mesh)
    dof_of = np.zeros(len(mesh.geometry.x), dtype=np.int64)
    dof_of[cells] = membrane.V.dofmap.list
    ends = membrane.positions()[dof_of[nodes]]
    s, _, gaps = closest_on_segments(ends[:, 0], ends[:, 1] - ends[:, 0], place)
    k = int(np.argmin(gaps)) if len(gaps) else -1
    least = float(gaps[k]) if k >= 0 else np.inf
    gap, rank = membrane.comm.allreduce((least, membrane.comm.rank), op=MPI.MINLOC)
    if gap > tolerance:
        return None
    ids = mesh.geometry.input_global_indices
    mine = None
    if membrane.comm.rank == rank:
        a, b = (int(ids[node]) for node in nodes[k])
        mine = (edge_of(a, b), float(s[k] if a < b else 1 - s[k]))
    found: tuple[Edge, float] = membrane.comm.bcast(mine, root=rank)
    return found


def _way(
    change: PathChange, points: list[SurfacePoint], edge: Edge, fraction: float
) -> list[SurfacePoint]:
    """The path with its first point moved along the boundary to a place on `edge`."""
    ends = [p for p, at in zip(edge, (0.0, 1.0), strict=True) if abs(fraction - at) < 1e-9]
    first: SurfacePoint = VertexPoint(ends[0]) if ends else EdgePoint(edge, fraction)
    if first == points[0] or (not ends and points[0].support == edge):
        return [first, *points[1:]]
    best: list[SurfacePoint] | None = None
    for side in (0, 1):
        way = _walk(change, points, first, side)
        if way is not None and (best is None or len(way) < len(best)):
            best = way
    if best is None:
        raise PathError(
            f"an anchor has been moved to {first} of the membrane's boundary, which the cable "
            "cannot reach along the boundary; lay it anew."
        )
    return best


def _walk(
    change: PathChange, points: list[SurfacePoint], goal: SurfacePoint, side: int
) -> list[SurfacePoint] | None:
    """Move the path's first point along the boundary; None if it does not reach the goal."""
    start, rest = points[0].support, list(points[1:])
    at = start[0] if len(start) == 1 else start[side]
    behind = start[1 - side] if len(start) == 2 else -1
    for _ in range(BUDGET.boundary_edges):
        surface = change.surface([at])
        around = list(surface.ring(at).neighbours)
        if behind < 0:  # from a vertex: one of its two ways
            around = around[::-1] if side else around
            entry = [around.index(v) for v in rest[0].support if v != at]
            spokes = around[1 : min(entry) + len(entry) - 1]
            onward = around[0]
        else:
            around = around if around[-1] == behind else around[::-1]
            spokes = around[1:-1]
            onward = around[0]
        if goal.support == (at,):
            return [goal, *rest]
        rest = [EdgePoint(edge_of(at, v), 0.5) for v in spokes] + rest
        if goal.support == edge_of(at, onward):
            return [goal, *rest]
        behind, at = at, onward
    return None
