"""How cables with friction change their path: over one vertex that they have run into at a time.

A cable with friction does not lie along a geodesic, and pulling it taut would let it slide where
it sticks. It changes its path only where friction gives way: a fold point that slides and has run
into a vertex is led around its other side, a node on a vertex leaves it when the cable pulls it
sideways by more than friction holds. The new path is kept if the energy falls, with the work of
friction in it; see `crms_fenicsx.equilibrium`.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.cable import CableNode, LaidCable
from crms_fenicsx.cables.contact_force import contact_forces
from crms_fenicsx.cables.corridor import Corridor, Support, corridor, flaw
from crms_fenicsx.cables.folded_surface import FoldedSurface
from crms_fenicsx.cables.grip import friction_forces
from crms_fenicsx.cables.intrinsic import Edge, MissingStars
from crms_fenicsx.cables.path import EdgePoint
from crms_fenicsx.cables.retrace import Retracer
from crms_fenicsx.cables.shorten import other_side, shorten
from crms_fenicsx.cables.strip import StripShape, grow

Array = npt.NDArray[np.float64]

NEAR = 0.025
"""Part of an edge: a sliding node as near as this to the vertex that it slides to has run into it.

There the lengths of the segments around are smoothed, which repels it from the vertex."""
BEYOND = 0.01
"""Part of an edge: where a path starts on the other side, off the smoothing."""
THERE_AND_BACK = 3
"""How often in a load step a cable is led around a vertex to either side: on each side friction may
have bounds with which the other one is better."""
SLACK, TINY = 0.05, 1e-5
"""By how much the pull must exceed the friction force, relative to it and to the tension."""


def give_way(paths: Retracer, most: int | None = None) -> int:
    """Lead cables with friction over the vertices that they have run into. Collective.

    Parameters
    ----------
    paths
        The scene's paths.
    most
        How many vertices each may pass; None: as many as it takes.

    Returns
    -------
    How many vertices the cable that has passed most has.
    """
    paths.offered = set()
    held = _held(paths.scene.cables)
    if not held:
        return 0
    shape, passed = StripShape.of(paths.scene), 0
    for cable in held.values():
        done = 0
        for vertex, to_left, _ in _run_into(cable, shape):
            if most is not None and done == most:
                break
            done += _pass(paths, cable, vertex, to_left)
        passed = max(passed, done)
    return passed


def _held(cables: Sequence[LaidCable]) -> dict[int, LaidCable]:
    """Cables that friction holds with known forces, by number."""
    return {
        c: cable
        for c, cable in enumerate(cables)
        if cable.taut and cable.grip is not None and cable.grip.known
    }


def relax(paths: Retracer, kinked: Iterable[tuple[int, int]]) -> bool:
    """Put caught fold points of cables with friction back on straight edges. Collective.

    Two points on edges that meet in a vertex may have closed in on each other away from it, so that
    the chord between them has no direction any more. Then edges are kinked, or the points are
    pulled and do not move. They go to where a string between the points around them would cross
    their edges.

    Parameters
    ----------
    paths
        The scene's paths.
    kinked
        Cables and their nodes at kinks, by number.

    Returns
    -------
    Whether any was moved that has not been before from the same place on the path.
    """
    shape, caught = StripShape.of(paths.scene), set(kinked)
    for c, cable in _held(paths.scene.cables).items():
        for *_, nodes in _run_into(cable, shape):
            caught |= {(c, k) for k in nodes if not cable.lifted[k]}
    moved = False
    for c, k in sorted(caught):
        cable = paths.scene.cables[c]
        if cable.slides_freely or not cable.nodes[k].slides:
            continue
        rim = cable.rim()
        i = rim.index(k)
        way = cable.name, tuple(_support(cable.nodes[m]) for m in rim[max(i - 1, 0) : i + 2])
        if way in paths.withheld:
            continue
        paths.withheld.add(way)
        contacts = [j for j, m in enumerate(rim) if not cable.lifted[m]]
        at = contacts.index(i)
        first, last = contacts[max(at - 2, 0)], contacts[min(at + 2, len(contacts) - 1)]
        moved |= _straighten(paths, cable, rim[first : last + 1])
    return moved


def _straighten(paths: Retracer, cable: LaidCable, part: list[int]) -> bool:
    """Pull a part of a cable taut between its ends, in the cells that it crosses."""
    path = dict(zip(cable.rim(), cable.path.points, strict=True))
    points = [path[k] for k in part]
    surface = paths.surface([v for point in points for v in point.support])
    if len(points) < 3 or flaw(corridor(points), surface.thirds):
        return False
    string = shorten(points, surface, max_flips=0).points
    for k, point in zip(part[1:-1], string[1:-1], strict=True):
        if cable.nodes[k].slides and isinstance(point, EdgePoint):
            fraction = min(max(point.fraction, BEYOND), 1 - BEYOND)
            cable.fractions[k] = fraction
            cable.positions[k] = surface.place(point.edge, fraction)
    return True


def _run_into(cable: LaidCable, shape: StripShape) -> list[tuple[int, bool, list[int]]]:
    """Vertices at which a cable may be held up: whether it is pulled to its left; its nodes there.

    What pulls is the part of the cable's force that friction does not carry. All nodes on edges at
    a vertex count as one: only their sum means anything. Some of them may have lifted off where the
    cable bends inward against the vertex.
    """
    grip = cable.grip
    assert grip is not None
    forces = contact_forces(cable, shape).lateral
    held = friction_forces(cable, shape)
    groups: dict[int, list[int]] = defaultdict(list)
    near: set[int] = set()
    for k in cable.rim():
        node = cable.nodes[k]
        if node.kind == "vertex":
            groups[_support(node)[0]].append(k)
            near.add(_support(node)[0])
        elif node.slides:
            fraction = float(cable.fractions[k])
            for vertex, away in zip(_support(node), (fraction, 1 - fraction), strict=True):
                groups[vertex].append(k)
                if away < NEAR:  # or beyond the edge's end
                    near.add(vertex)
    found: list[tuple[float, int, bool]] = []
    for vertex in near:
        rows = [
            row
            for k in groups[vertex]
            if (row := grip.row_of.get(_support(cable.nodes[k]))) is not None
        ]
        pull = sum(forces[k] for k in groups[vertex]) - held[rows].sum()
        least = SLACK * grip.bounds[rows].sum() + TINY * cable.tension
        if abs(pull) > least:
            found.append((least - abs(pull), vertex, bool(pull > 0)))
    return [(vertex, to_left, groups[vertex]) for _, vertex, to_left in sorted(found)]


def _pass(paths: Retracer, cable: LaidCable, vertex: int, to_left: bool) -> int:
    """Lead a cable around the other side of a vertex; return how many vertices it has passed."""
    surface = paths.surface([vertex])
    rim = cable.rim()
    supports: Corridor = tuple(_support(cable.nodes[k]) for k in rim)
    string, first = supports, 0
    joined = paths.with_anchors(cable, surface)
    anchors = sorted(joined.anchors)
    n = paths.scene.V.dofmap.index_map.size_global
    if n in anchors:
        string, first = ((n,), *string), 1
    if n + 1 in anchors:
        string = (*string, (n + 1,))
    for rings in itertools.count(1):
        try:
            upward = _counterclockwise(joined, vertex) != to_left
            found = other_side(string, joined, vertex, upward)
            break
        except MissingStars as missing:
            grow(paths.scene, missing.vertices, rings)
            joined = paths.with_anchors(cable, paths.surface())
    if found is None or any(len(s) != 2 for s in found.taken):
        return 0
    way = cable.name, (*found.left, *found.taken)
    if way in paths.withheld or way in paths.offered:
        return 0
    here = cable.name, vertex, to_left
    if min(paths.led[here], paths.led[cable.name, vertex, not to_left]) >= THERE_AND_BACK:
        return 0
    kept = found.corridor[first : len(found.corridor) - (n + 1 in anchors)]
    if any(max(s) >= n for s in kept):  # beside the membrane, between its boundary and an anchor
        return 0
    _adopt(paths, cable, rim, kept, vertex, joined)
    paths.offered.add(way)
    paths.led[here] += 1
    return 1


def _counterclockwise(surface: FoldedSurface, vertex: int) -> bool:
    """Whether the ring of a vertex is in the membrane's order, counterclockwise from outside."""
    ring = surface.membrane_ring(vertex).neighbours
    row = surface.strip.outer_rows((vertex, ring[0], ring[1]))[0]
    cell = surface.strip.corners[row]
    return cell[cell.index(vertex) - 2] == ring[0]


def _adopt(
    paths: Retracer,
    cable: LaidCable,
    rim: list[int],
    supports: Corridor,
    vertex: int,
    surface: FoldedSurface,
) -> None:
    """Give a cable a path around a vertex; all nodes that it had stay where they are."""
    grow(paths.scene, [v for support in supports for v in support])
    strip = paths.scene.strip
    assert strip is not None
    old = {_support(cable.nodes[k]): k for k in rim}
    least = BEYOND * (1 + 0.02 * paths.scene.cables.index(cable))

    def kept(k: int) -> tuple[CableNode, Array, float, bool]:
        fraction, lifted = float(cable.fractions[k]), bool(cable.lifted[k])
        return cable.nodes[k], cable.positions[k], fraction, lifted

    def new(edge: Edge) -> tuple[CableNode, Array, float, bool]:
        fraction = least if edge[0] == vertex else 1 - least
        point = EdgePoint(edge, fraction)
        node = CableNode("rail" if edge in strip.held_edges else "fold", point)
        return node, surface.place(edge, fraction), fraction, False

    last = len(cable.nodes) - 1
    rows = [kept(0)] if rim[0] > 0 else []  # an anchor
    rows += [kept(old[s]) if s in old else new((s[0], s[1])) for s in supports]
    rows += [kept(last)] if rim[-1] < last else []
    nodes, positions, fractions, lifted = zip(*rows, strict=True)
    cable.set_nodes(nodes, np.array(positions), np.array(fractions), np.array(lifted))
    rim = cable.rim()
    added = [i for i, k in enumerate(rim) if _support(cable.nodes[k]) not in old]
    if added:  # along the membrane's boundary there may only be fewer
        _straighten(paths, cable, rim[max(added[0] - 1, 0) : added[-1] + 2])


def _support(node: CableNode) -> Support:
    assert node.point is not None
    return node.point.support
