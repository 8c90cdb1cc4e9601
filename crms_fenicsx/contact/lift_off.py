"""Lift-off and recontact: where a cable touches the membrane, and its gap elsewhere.

A cable lies on the outside of the membrane and can push it in, but not pull it out. Where its two
parts at a point pull outward together, it is let go there and passes straight above; where the
straight cable would run below the membrane, it touches down again. The same holds between two
cables that cross: the upper one cannot pull the lower one up.

Points that are let go and touch down again in one solve stay where they touch, so that the set of
contacts cannot flicker.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.meshes.triangles import arc_lengths, cross, dot, norm
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length
from crms_fenicsx.model.tolerances import INSIDE, PAST, SAME_PLACE
from crms_fenicsx.runtime.arrays import Array, flags
from crms_fenicsx.surface.points import CellPoint, Edge, EdgePoint, VertexPoint


class Gap(NamedTuple):
    """The place of the membrane under a free span, at one of the cable's nodes."""

    gap: float  # height of the span above it, along the membrane's normal (length)
    fraction: float  # on the edge; NaN at a vertex
    place: Array  # place, above: (3,) the place, and the point of the span above it
    above: Array
    # whether the place is on the edge and the point on the span, both within their ends. A span
    # that passes a vertex on the other side, just beyond the edge's end, counts as well: paths keep
    # that far off vertices, so that they need not tell the two sides.
    inside: bool
    # the vertex at the edge's end beyond which the span passes, not far off it; -1 if it does not
    past: int = -1


def size_at(shape: StripShape, support: tuple[int, ...]) -> float:
    """Size of the cells around a vertex or an edge (length)."""
    return float(shape.normals_and_sizes([support])[1][0])


def under(
    node: CableNode,
    span: tuple[Array, Array],
    shape: StripShape,
    bends: Sequence[Array] = (),
    reach: float = PAST,
) -> Gap:
    """The place of the membrane on a node's edge or vertex that a free span passes."""
    assert node.point is not None
    support = node.point.support
    normal = shape.normal(support)
    start, end = span
    line = [shape.at(support[0]), *bends, shape.at(support[-1])]
    if len(support) == 1:
        t = float((line[0] - start) @ (end - start) / ((end - start) @ (end - start)))
        above = start + min(max(t, 0.0), 1.0) * (end - start)
        gap = float((above - line[0]) @ normal)
        return Gap(gap, np.nan, line[0], above, 0.0 < t < 1.0)
    sizes = [float(np.linalg.norm(b - a)) for a, b in pairwise(line)]
    found: Gap | None = None
    before, best = 0.0, (True, np.inf)
    for (a, b), size in zip(pairwise(line), sizes, strict=True):
        s, t = apparent_crossing(a, b, start, end, normal)
        first, last = before == 0.0, before + size >= sum(sizes) * (1 - 1e-12)
        inside = (s > -INSIDE or not first) and (s < 1 + INSIDE or not last) and 0.0 < t < 1.0
        other = (s < 0.0 and not first) or (s > 1.0 and not last)  # it passes another part
        past = -1
        if 0.0 < t < 1.0 and not inside:
            past = support[0] if first and -reach < s < 0.0 else past
            past = support[1] if last and 1.0 < s < 1 + reach else past
        s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
        place, above = a + s * (b - a), start + t * (end - start)
        fraction = (before + s * size) / sum(sizes)
        gap = float((above - place) @ normal)
        if found is None or (other, gap) < best:
            best = other, gap
            found = Gap(gap, fraction, place, above, inside, past)
        before += size
    assert found is not None
    return found


def apparent_crossing(a: Array, b: Array, c: Array, d: Array, normal: Array) -> tuple[float, float]:
    """Where the lines ab and cd cross, seen along the normal: their parameters."""
    u, v = (x - (x @ normal) * normal for x in (b - a, d - c))
    w = (c - a) - ((c - a) @ normal) * normal
    area = float(cross(u, v) @ normal)
    if abs(area) <= 1e-12 * float(np.linalg.norm(u) * np.linalg.norm(v)):
        return 0.5, 0.5  # the span runs along the edge
    return float(cross(w, v) @ normal) / area, float(cross(w, u) @ normal) / area


def spans(cable: LaidCable) -> Iterator[tuple[int, int]]:
    """Pairs of contacts between which the cable is off the membrane."""
    for a, b in pairwise(cable.contacts()):
        if b - a > 1:
            yield a, b


PULL = 1e-6
"""Outward force, relative to the tension, from which on a cable is let go."""
DEPTH = 1e-6
"""Depth below the membrane, relative to the cells' size, from which on a cable touches down."""
NEARLY = 0.05
"""Height above the membrane, relative to the cells' size, up to which a cable may touch it once it
has folded it: folds bulge."""
SUNK = 0.02
"""Depth below the membrane, relative to the cells' size, that is no error of the mesh any more."""


def may_lift(cable: LaidCable) -> Iterator[int]:
    """Nodes at which a cable may leave the membrane: all but its ends and its crossings."""
    for k, node in enumerate(cable.nodes[1:-1], start=1):
        if not node.touches_cable:
            yield k


def is_foot(cable: LaidCable, k: int) -> bool:
    """Whether a node only marks the place under an anchor, where no cable can touch."""
    nodes = cable.nodes
    in_cell = isinstance(nodes[k].point, CellPoint)
    return in_cell and "anchor" in (nodes[k - 1].kind, nodes[k + 1].kind)


def outward_pulls(cable: LaidCable, nodes: Sequence[int], normals: Array, reaches: Array) -> Array:
    """Forces of the cable around some of its nodes along the normals, relative to the tension.
    Points close together, as those around a vertex, share one contact: what counts is the turn of
    the cable between a distance `reach` before and after the node, but not that at a crossing,
    where another cable presses. Shapes: nodes (n,), normals (n, 3), reaches (n,). Returns (n,)
    forces, positive outward; -1 where the cable lies on its anchor, or on another cable."""
    contacts = cable.contacts()
    x, i = cable.positions[contacts], np.searchsorted(contacts, nodes)
    arc = arc_lengths(x)
    all_nodes = cable.nodes
    crossings = [m for m, k in enumerate(contacts) if all_nodes[k].touches_cable]
    stops = np.array([0, *crossings, len(contacts) - 1])
    before = stops[np.searchsorted(stops, i) - 1]
    after = stops[np.searchsorted(stops, i, side="right")]
    near = np.stack(
        [np.maximum(arc[i] - reaches, arc[before]), np.minimum(arc[i] + reaches, arc[after])]
    )
    pulls = np.full(len(i), -1.0)
    free = np.abs(near - arc[i]).min(axis=0) > SAME_PLACE * arc[-1]
    i, near = i[free], near[:, free]
    ways = np.stack([np.interp(near, arc, x[:, m]) for m in range(3)], axis=2) - x[i]
    pulls[free] = dot((ways / norm(ways)[..., None]).sum(axis=0), normals[free])
    return pulls


def released(cable: LaidCable, shape: StripShape, covered: Set[int] = frozenset()) -> list[int]:
    """Nodes at which the cable pulls the membrane outward."""
    if cable.sleeve:
        return []
    nodes, lifted = cable.nodes, flags(cable.lifted)
    on = [k for k in may_lift(cable) if not lifted[k]]
    if covered:
        on = [k for k in on if len(nodes[k].support) > 1 or nodes[k].support[0] not in covered]
    normals, sizes = shape.normals_and_sizes([nodes[k].support for k in on])
    up = flags(outward_pulls(cable, on, normals, sizes) > PULL)
    feet = [k for k in (*on[:1], *on[-1:]) if is_foot(cable, k)]  # next to the ends, if anywhere
    return [k for k, pulls in zip(on, up, strict=True) if pulls or k in feet]


def captured(
    cable: LaidCable,
    shape: StripShape,
    bends: Mapping[Edge, Sequence[Array]],
    height: float = -DEPTH,
) -> dict[int, Gap]:
    """Nodes at which a free span runs below the membrane, with the places where it touches.

    Or, with a height relative to the cells' size, where it runs less than that above it.

    Where the path leads around a vertex and the span passes it on the other side, beyond the ends
    of all the edges that the path crosses there, no edge has the span above or below itself: then
    it touches near the vertex. The path lies in one plane under the span, and each edge is looked
    at along its own normal, so that this happens where the membrane is steep.

    Leaves the positions of lifted nodes on their span.
    """
    found = {}
    positions, fractions = cable.positions.copy(), cable.fractions.copy()
    for a, b in spans(cable):
        span = (positions[a], positions[b])
        passed: dict[int, Gap] = {}
        for k in range(a + 1, b):
            node = cable.nodes[k]
            if node.kind == "crossing" or is_foot(cable, k):
                positions[k] = span[0] + (k - a) / (b - a) * (span[1] - span[0])
                continue
            assert node.point is not None
            support = node.point.support
            on_edge = bends.get((support[0], support[1]), ()) if len(support) == 2 else ()
            place = under(node, span, shape, on_edge)
            positions[k] = place.above
            if node.slides:  # so that the path stays below the span
                fractions[k] = min(max(place.fraction, INSIDE), 1 - INSIDE)
            if place.gap < height * size_at(shape, support):
                if place.inside:
                    found[k] = place
                elif height < 0.0 and place.past >= 0:
                    passed[k] = place
        found |= {k: place for k, place in passed.items() if _passed_by_all(cable, k, passed)}
    cable.update(positions=positions, fractions=fractions)
    return found


def _passed_by_all(cable: LaidCable, k: int, passed: Mapping[int, Gap]) -> bool:
    """Whether a span passes a vertex beyond the ends of all the edges around it on the path."""
    vertex = passed[k].past

    def around(n: int) -> bool:
        point = cable.nodes[n].point
        return isinstance(point, EdgePoint) and vertex in point.edge

    first = last = k
    while around(first - 1):
        first -= 1
    while around(last + 1):
        last += 1
    return all(n in passed and passed[n].past == vertex for n in range(first, last + 1))


def sunk(cables: Sequence[LaidCable], shape: StripShape) -> set[int]:
    """Numbers of cables with a span that runs deep below the membrane beside a vertex. Beyond the
    ends of edges, so that no edge of its path can stop it, and maybe far beyond where it ends at
    another cable, and their crossing has slid out of its cell."""
    found = set()
    for c, cable in enumerate(cables):
        if not cable.taut or cable.sleeve:
            continue
        for a, b in spans(cable):
            span = (cable.positions[a], cable.positions[b])
            for k in range(a + 1, b):
                node = cable.nodes[k]
                if node.kind == "crossing" or is_foot(cable, k):
                    continue
                assert node.point is not None
                place = under(node, span, shape, reach=np.inf)
                deep = -SUNK * size_at(shape, node.point.support)
                if place.past < 0 or place.gap >= deep:
                    continue
                # Over an edge that hardly turns aside from it the span passes the edge's line far
                # from here: at the vertex it must be as deep.
                vertex = CableNode("vertex", VertexPoint(place.past))
                if under(vertex, span, shape).gap < deep:
                    found.add(c)
    return found


def lift(cable: LaidCable, nodes: Sequence[int]) -> None:
    """Let the cable leave the membrane at some nodes."""
    lifted = cable.lifted.copy()
    lifted[nodes] = True
    cable.update(lifted=lifted)


def touch(cable: LaidCable, places: Mapping[int, Gap]) -> None:
    """Let the cable touch the membrane at some nodes."""
    lifted, positions, fractions = (
        array.copy() for array in (cable.lifted, cable.positions, cable.fractions)
    )
    for k, place in places.items():
        lifted[k] = False
        positions[k] = place.place
        if cable.nodes[k].slides:
            fractions[k] = min(max(place.fraction, INSIDE), 1 - INSIDE)
    cable.update(lifted=lifted, positions=positions, fractions=fractions)


def link_at(cable: LaidCable, k: int) -> tuple[Array, Array]:
    """Ends of the straight part of a cable after its node k, crossings not counted."""
    own = [i for i, node in enumerate(cable.nodes) if node.kind != "crossing"]
    contacts = cable.contacts()
    first = max(i for i in contacts if i <= own[k])
    last = min(i for i in contacts if i >= own[k + 1])
    return cable.positions[first], cable.positions[last]


def drape(cable: LaidCable, shape: StripShape) -> None:
    """Find the contacts of a cable that is pulled over the membrane as if that were rigid."""
    for _ in range(len(cable.nodes) + 1):
        free = released(cable, shape)
        lift(cable, free)
        places = {} if free else captured(cable, shape, {})
        touch(cable, places)
        positions = cable.positions.copy()
        for k in places:  # nothing moves it from there to where it says that it is
            positions[k] = shape.mean(*cable.interpolation(k))
        cable.update(positions=positions)
        if not free and not places:
            return


def flat_length(cable: LaidCable, shape: StripShape) -> float:
    """Length of the polyline that a cable would have on cells that it did not fold (length)."""
    points = []
    for k in cable.contacts():
        if cable.nodes[k].kind == "anchor":
            points.append(cable.positions[k])
        elif cable.nodes[k].kind != "crossing":
            points.append(shape.mean(*cable.interpolation(k)))
    return polyline_length(np.array(points))
