"""A cable's way past vertices of the mesh: around them on the side where it did not go.

The path crosses the edges on that side, at first next to the vertices, where a string between the
points that stay crosses them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.geodesics.corridor import Corridor, corridor, why_invalid
from crms_fenicsx.geodesics.flip_geodesic import shorten
from crms_fenicsx.geodesics.vertex_flip import other_side
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BEYOND
from crms_fenicsx.paths.creased_surface import CreasedSurface
from crms_fenicsx.paths.held_vertices import Run
from crms_fenicsx.paths.path_change import PathChange
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import MeshError
from crms_fenicsx.surface.intrinsic import MissingCells
from crms_fenicsx.surface.points import Edge, EdgePoint


def pass_run(change: PathChange, number: int, run: Run, shape: StripShape | None = None) -> bool:
    """Move a cable past the vertices of a run; say whether any path goes there. Collective."""
    cable = change.net.cables[number]
    found = way_past(change, cable, run, shape)
    if found is None:
        return False
    adopt(change, cable, found)
    return True


@dataclass(frozen=True)
class WayPast:
    """A way past a run of vertices."""

    supports: Corridor  # what the path goes through, between the cable's anchors
    vertices: frozenset[int]  # those that it passes
    replaced: Corridor  # what it does not go through any more, and what it does instead
    surface: CreasedSurface  # the surface, with the anchors


def way_past(
    change: PathChange, cable: LaidCable, run: Run, shape: StripShape | None = None
) -> WayPast | None:
    """Find the way of a cable past a run. Collective.

    Returns None where there is none for any of the vertices.
    """
    string: Corridor = tuple(cable.nodes[k].support for k in cable.path_nodes())
    joined = change.with_anchors(cable, change.surface(run.vertices, like=shape))
    n = change.n_vertices
    first, last = n in joined.anchors, n + 1 in joined.anchors
    string = (((n,),) if first else ()) + string + (((n + 1,),) if last else ())
    replaced: Corridor = ()
    passed = set()
    for vertex in run.vertices:
        found = None
        for rings in itertools.count(1):
            try:
                upward = _counterclockwise(joined, vertex) != run.to_left
                found = other_side(string, joined, vertex, upward)
                break
            except MissingCells as missing:
                change.net.grow_strip(missing.vertices, rings)
                joined = change.with_anchors(cable, change.surface())
            except MeshError:
                break  # where several sheets of membrane meet the vertex holds
        # Beside the membrane, between its boundary and an anchor, no cable lies.
        if found is None or any(len(s) != 2 or max(s) >= n for s in found.taken):
            continue
        string, replaced = found.corridor, (*replaced, *found.left, *found.taken)
        passed.add(vertex)
    if not passed:
        return None
    kept = string[first : len(string) - last]
    return WayPast(kept, frozenset(passed), replaced, joined)


def adopt(change: PathChange, cable: LaidCable, way: WayPast) -> None:
    """Give a cable a way past vertices; all nodes that it had stay where they are."""
    supports, on_path = way.supports, cable.path_nodes()
    change.net.grow_strip([v for support in supports for v in support])
    strip = change.net.strip
    assert strip is not None
    old = {cable.nodes[k].support: k for k in on_path}
    least = BEYOND * (1 + 0.02 * change.net.cables.index(cable))

    def kept(k: int) -> tuple[CableNode, Array, float, bool]:
        fraction, lifted = float(cable.fractions[k]), bool(cable.lifted[k])
        return cable.nodes[k], cable.positions[k], fraction, lifted

    def new(edge: Edge) -> tuple[CableNode, Array, float, bool]:
        fraction = least if edge[0] in way.vertices else 1 - least
        point = EdgePoint(edge, fraction)
        node = CableNode("rail" if edge in strip.held_edges else "fold", point)
        return node, way.surface.place(edge, fraction), fraction, False

    last = len(cable.nodes) - 1
    rows = [kept(0)] if on_path[0] > 0 else []  # an anchor
    rows += [kept(old[s]) if s in old else new((s[0], s[1])) for s in supports]
    rows += [kept(last)] if on_path[-1] < last else []
    nodes, positions, fractions, lifted = zip(*rows, strict=True)
    cable.set_nodes(nodes, np.array(positions), np.array(fractions), np.array(lifted))
    on_path = cable.path_nodes()
    added = [i for i, k in enumerate(on_path) if cable.nodes[k].support not in old]
    if added:  # along the membrane's boundary there may only be fewer
        part = on_path[max(added[0] - 1, 0) : added[-1] + 2]
        straighten(change, cable, part, way.surface.shape)


def straighten(
    change: PathChange, cable: LaidCable, part: list[int], shape: StripShape | None = None
) -> bool:
    """Pull a part of a cable, given by nodes, taut between its ends, in the cells that it crosses.

    Collective. Says whether that can be done. The positions of the vertices around are gathered
    where they are not known.
    """
    points = cable.points(part)
    surface = change.surface([v for point in points for v in point.support], like=shape)
    if len(points) < 3 or why_invalid(corridor(points), surface.opposite_vertices):
        return False
    string = shorten(points, surface, max_flips=0).points
    positions, fractions = cable.positions.copy(), cable.fractions.copy()
    for k, point in zip(part[1:-1], string[1:-1], strict=True):
        if cable.nodes[k].slides and isinstance(point, EdgePoint):
            fraction = min(max(point.fraction, BEYOND), 1 - BEYOND)
            fractions[k] = fraction
            positions[k] = surface.place(point.edge, fraction)
    cable.update(positions=positions, fractions=fractions)
    return True


def _counterclockwise(surface: CreasedSurface, vertex: int) -> bool:
    """Whether the ring of a vertex is in the membrane's order, counterclockwise from outside."""
    ring = surface.membrane_ring(vertex).neighbours
    row = surface.strip.outer_rows((vertex, ring[0], ring[1]))[0]
    cell = surface.strip.corners[row]
    return cell[cell.index(vertex) - 2] == ring[0]
