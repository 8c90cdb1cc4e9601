"""Equivalent contact force of a cable on the membrane (section 3.2), also per length.

The paper computes it from the turning angle theta of the cable at a sliding node,

    N = 2 T sin(theta/2) inside the membrane,   N = T tan(theta/2) at its boundary   (3.2-1, 2).

A cable restrained by friction also turns sideways, which exerts no pressure. By default only the
component along the membrane's normal counts. Fold points, and so their forces, are irregularly
spaced; what converges is the force per length of cable. So forces are integrated along the cable,
smoothed over a few cells, and each node gets the share of its stretch of cable.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.lift_off import size_at
from crms_fenicsx.foundation.meshes.triangles import arc_lengths, cross, dot, norm
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Integers
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.surface.points import EdgePoint, Support, VertexPoint
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


@dataclass(frozen=True, repr=False)
class ContactForces:
    """Forces of a cable in tension on the membrane at its nodes; zero off the membrane.

    Attributes
    ----------
    normal, lateral : (n,)
        Force along the outward normal of the membrane, positive if the cable presses, and lateral
        force in the surface, positive to the left seen from outside (force).
    bearing : (n,)
        Share of the smoothed normal force of each node's stretch of cable (force).
    beside : (n, 3)
        Force of cables that touch it side by side (force), which the membrane does not get.
    line : (n,)
        Smoothed normal force per length of cable (force per length); NaN off the membrane.
    """

    normal: Array
    lateral: Array
    bearing: Array
    line: Array
    beside: Array

    def __repr__(self) -> str:
        """One line."""
        points = counted(len(self.normal), "point")
        return f"ContactForces({points}, {span(self.line)} per length)"

    def at(self, nodes: Sequence[int]) -> ContactForces:
        """Contact forces at some nodes."""
        return ContactForces(*(getattr(self, field.name)[nodes] for field in fields(self)))


def held_nodes(cable: LaidCable) -> list[int]:
    """Nodes where friction may act: contacts with the membrane between the cable's ends."""
    return [
        k
        for k in cable.contacts()
        if cable.state.nodes[k].kind in ("fold", "edge slider", "vertex")
        and 0 < k < len(cable.state.nodes) - 1
    ]


def supports_of(cable: LaidCable) -> Sequence[Support]:
    """Supports on the mesh of the nodes where friction may act."""
    return [cable.state.nodes[k].support for k in held_nodes(cable)]


def contact_forces(
    cable: LaidCable, shape: StripShape, beside: Array | None = None
) -> ContactForces:
    """Contact forces of a cable in its current shape, with its current tension, and with forces of
    cables `beside` it (n, 3) on its nodes.

    With e the direction of the edge at a node, t1 and t2 those of the cable before and after, and t
    their mean, ``normal = -(T2 t2 - T1 t1) . n`` with n = e x t outward; the tensions T1 and T2
    differ with axial friction. At a crossing the upper cable presses on the lower one, not on the
    membrane; the lower one transfers that force beside the crossing.
    """
    n = len(cable.state.nodes)
    beside = np.zeros((n, 3)) if beside is None else beside
    normal, lateral, bearing = np.zeros((3, n))
    line = np.full(n, np.nan)
    if not cable.taut:
        return ContactForces(normal, lateral, bearing, line, beside)
    nodes, before, after = _turns_on_membrane(cable)
    up, left = directions(cable, nodes, shape, before, after)
    pull = _pulls(cable, nodes, before, after) + beside[nodes]
    normal[nodes], lateral[nodes] = -dot(pull, up), dot(pull, left)
    for run in runs(cable):
        _smooth_line_load(cable, run, shape, normal, bearing, line)
    if not cable.lifts_off:  # it bears from below as well
        return ContactForces(normal, lateral, np.abs(bearing), np.abs(line), beside)
    return ContactForces(normal, lateral, np.maximum(bearing, 0.0), line, beside)


def wrap_angles(cable: LaidCable, shape: StripShape) -> Array:
    """Wrap angle of the cable at each node, (n,). On the membrane it is the turn in the normal
    direction, smoothed like the normal force; zero where the cable would pull the membrane. A
    pocket, or a line that is held, also guides the cable sideways: there the whole turn counts."""
    nodes, before, after = _turns_on_membrane(cable)
    up, left = directions(cable, nodes, shape, before, after)
    guided = cable.keeps_line and cable.state.law.lateral is None
    ways = [up, left] if guided else [up]
    parts = np.array([dot(before - after, way) for way in ways])
    chord = np.linalg.norm(parts, axis=0)  # of the unit circle
    parts *= 2 * np.arcsin(np.minimum(chord / 2, 1.0)) / np.where(chord > 0.0, chord, 1.0)
    angles = np.zeros((len(ways), len(cable.state.nodes)))
    wrap = np.zeros_like(angles)
    angles[:, nodes] = parts
    line = np.zeros(len(cable.state.nodes))
    for run in runs(cable):
        for way in range(len(ways)):
            _smooth_line_load(cable, run, shape, angles[way], wrap[way], line)
    return (
        np.asarray(np.linalg.norm(wrap, axis=0))
        if not cable.lifts_off
        else np.maximum(wrap[0], 0.0)
    )


def paper_forces(cable: LaidCable) -> Array:
    """Equivalent contact force of the paper at each node, (n,) (force): (3.2-1) inside the
    membrane, (3.2-2) next to an anchor; zero at zero angle and finite up to, or just below, pi."""
    forces = np.zeros(len(cable.state.nodes))
    if not cable.taut:
        return forces
    contacts = cable.contacts()
    for k, (before, after) in turns(cable).items():
        if cable.state.nodes[k].kind == "crossing":
            continue
        # |t2 - t1| = 2 sin(theta/2) and |t2 + t1| = 2 cos(theta/2) avoid the angle and its sine.
        sine = float(np.linalg.norm(after - before)) / 2
        cosine = float(np.linalg.norm(after + before)) / 2
        i = contacts.index(k)
        beside = {cable.state.nodes[contacts[i - 1]].kind, cable.state.nodes[contacts[i + 1]].kind}
        if "anchor" in beside:
            forces[k] = cable.tension * sine / max(cosine, EPSILON)
        else:
            forces[k] = 2 * cable.tension * sine
    return forces


def forces_at(
    cable: LaidCable, nodes: Sequence[int], shape: StripShape, beside: Array | None = None
) -> tuple[Array, Array]:
    """Normal and lateral forces (m,) of a cable on the membrane at `nodes` (m,), as in
    `contact_forces`."""
    turned, before, after = _turns(cable)
    wanted = np.asarray(nodes, dtype=np.int64)
    at = np.minimum(np.searchsorted(turned, wanted), max(len(turned) - 1, 0))
    rows = np.flatnonzero(turned[at] == wanted) if len(turned) else np.zeros(0, dtype=np.int64)
    found, before, after = wanted[rows], before[at[rows]], after[at[rows]]
    up, left = directions(cable, found, shape, before, after)
    pull = _pulls(cable, found, before, after)
    pull = pull if beside is None else pull + beside[found]
    normal, lateral = np.zeros((2, len(nodes)))
    normal[rows], lateral[rows] = -dot(pull, up), dot(pull, left)
    return normal, lateral


def _turns_on_membrane(cable: LaidCable) -> tuple[Integers, Array, Array]:
    """Inner contacts with the membrane, and the cable's directions before and after, (m, 3)."""
    nodes, before, after = _turns(cable)
    on = np.array([cable.state.nodes[k].kind != "crossing" for k in nodes], dtype=bool)
    return nodes[on], before[on], after[on]


def _pulls(cable: LaidCable, nodes: Integers, before: Array, after: Array) -> Array:
    """Forces of the cable at nodes, with its directions before and after them, (m, 3)."""
    contacts = cable.contacts()
    first, last = np.zeros((2, len(cable.state.nodes), 1))
    first[contacts[1:], 0], last[contacts[:-1], 0] = cable.part_tensions, cable.part_tensions
    return np.asarray(last[nodes] * after - first[nodes] * before)


def turns(cable: LaidCable) -> dict[int, tuple[Array, Array]]:
    """Directions of the cable before and after each of its inner contacts."""
    nodes, before, after = _turns(cable)
    return {int(k): (before[i], after[i]) for i, k in enumerate(nodes)}


def _turns(cable: LaidCable) -> tuple[Integers, Array, Array]:
    """The nodes of `turns`, ascending, and the directions, (m, 3) and (m, 3)."""
    contacts = np.array(cable.contacts(), dtype=np.int64)
    steps = np.diff(cable.state.positions[contacts], axis=0)
    # Coincident points have no direction between them; the next step has.
    (long,) = np.nonzero(norm(steps))
    ways = steps[long] / norm(steps[long])[:, None]
    inner = np.arange(1, len(contacts) - 1)
    first = np.searchsorted(long, inner)  # next step of nonzero length
    has = (first > 0) & (first < len(long))
    return contacts[inner[has]], ways[first[has] - 1], ways[first[has]]


def directions(
    cable: LaidCable, nodes: Sequence[int] | Integers, shape: StripShape, before: Array,
    after: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Outward unit normals (m, 3) at `nodes` (m,), perpendicular to edge and cable, and directions
    (m, 3) to the cable's left; before, after (m, 3). At a vertex the normal bisects the angle
    between the two sides of the membrane."""
    if len(nodes) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    points = [cable.state.nodes[k].point for k in nodes]
    outside, _ = shape.normals_and_sizes([point.support for point in points if point is not None])
    along = before + after
    size = norm(along)[:, None]
    along = np.where(size > 0.0, along / np.where(size > 0.0, size, 1.0), before)
    up = outside - dot(outside, along)[:, None] * along
    slides = np.array([cable.state.nodes[k].slides for k in nodes])
    if slides.any():
        square = cross(edge_directions(cable, np.asarray(nodes)[slides], shape), along[slides])
        square *= np.where(dot(square, outside[slides]) > 0.0, 1.0, -1.0)[:, None]
        up[slides] = np.where(norm(square)[:, None] > TOL.oblique, square, up[slides])
    up /= norm(up)[:, None]
    left = cross(up, along)
    at_vertex = np.array([cable.state.nodes[k].kind == "vertex" for k in nodes])
    if at_vertex.any():
        vertices = [p.vertex for p in points if isinstance(p, VertexPoint)]
        left[at_vertex] = _left_at_vertices(vertices, shape, along[at_vertex], left[at_vertex])
        up[at_vertex] = cross(along[at_vertex], left[at_vertex])
    return up, left


def _left_at_vertices(
    vertices: Sequence[int], shape: StripShape, along: Array, left: Array
) -> Array:
    """Directions to the left of a cable at vertices, perpendicular to it, averaged over the surface
    on both sides. If the membrane pulls equally on both sides, perpendicular to the cable, the
    resultant has no component in this direction, whatever the cells. At the boundary `left` is
    returned. Shapes: vertices (m,), along, left (m, 3)."""
    strip = shape.strip
    around = [strip.solid_rows((vertex,)) for vertex in vertices]
    of = np.repeat(np.arange(len(vertices)), [len(rows) for rows in around])
    cells = strip.cells[list(itertools.chain.from_iterable(around))]
    centres = np.asarray(vertices)[of, None]
    others = cells[cells != centres].reshape(-1, 2)
    row_of = np.searchsorted(strip.vertices, others)
    sides = shape.current[row_of] - shape.current[np.searchsorted(strip.vertices, centres)]
    sides /= norm(sides)[..., None]
    # Cells cut by the plane perpendicular to the cable.
    ahead = np.asarray(dot(sides, along[of][:, None]))
    cut = np.where(ahead[:, 0] * ahead[:, 1] <= 0.0, 1.0, 0.0)[:, None]
    ways = cut * (sides[:, 0] * np.abs(ahead[:, 1:]) + sides[:, 1] * np.abs(ahead[:, :1]))
    means = np.zeros((2, len(vertices), 3))
    np.add.at(means, (np.where(dot(ways, left[of]) > 0.0, 0, 1), of), ways)
    sizes = norm(means)
    both = (sizes > 0.0).all(axis=0)
    means /= np.where(sizes > 0.0, sizes, 1.0)[..., None]
    mean = means[0] - means[1]
    size = norm(mean)
    both &= size > 0.0
    return np.where(both[:, None], mean / np.where(both, size, 1.0)[:, None], left)


def edge_directions(cable: LaidCable, nodes: Sequence[int] | Integers, shape: StripShape) -> Array:
    """Directions of the edges of sliding nodes: means of their two halves, (m, 3)."""
    edges = [
        point.edge for k in nodes if isinstance(point := cable.state.nodes[k].point, EdgePoint)
    ]
    ends = shape.current[np.searchsorted(shape.strip.vertices, np.array(edges))]
    x = cable.state.positions[nodes]
    # An edge slider's edge is straight, and the slider may lie beyond its end.
    edge_sliders = np.array([cable.state.nodes[k].kind == "edge slider" for k in nodes])[:, None]
    halves = np.stack(
        [np.where(edge_sliders, ends[:, 1] - ends[:, 0], x - ends[:, 0]), ends[:, 1] - x]
    )
    halves[1] = np.where(edge_sliders, 0.0, halves[1])
    sizes = norm(halves)[..., None]
    edge = (halves / np.where(sizes > 0.0, sizes, 1.0)).sum(axis=0)
    return np.asarray(edge / norm(edge)[:, None])


def cable_over(cable: LaidCable, nodes: Sequence[int], shape: StripShape) -> Array:
    """Length of cable (m, 3) that passes those of `nodes` (m,) that are vertices, as their
    stress-free places shift: ``F^T t`` with the mean gradient F of the cells around and the mean t
    of the cable's directions before and after; zero elsewhere and at clamps."""
    found, ways, cells = np.zeros((len(nodes), 3)), turns(cable), shape.strip.simplices.cells
    for i, k in enumerate(nodes):
        if k not in ways or cable.state.nodes[k].kind != "vertex" or k in cable.clamped:
            continue
        rows = shape.strip.solid_rows(cable.state.nodes[k].support)
        X, x = shape.stress_free[cells[rows]], shape.current[cells[rows]]
        F = np.linalg.pinv(X[:, 1:] - X[:, :1]) @ (x[:, 1:] - x[:, :1])  # transposed
        mean = np.average(F, axis=0, weights=norm(shape.stress_free_normals[rows]))
        found[i] = mean @ np.add(*ways[k]) / 2
    return found


def runs(cable: LaidCable) -> list[list[int]]:
    """Nodes of each part of a cable on the membrane, without crossings."""
    parts = itertools.groupby(cable.path_nodes(), key=lambda k: bool(cable.state.lifted[k]))
    return [list(part) for lifted, part in parts if not lifted]


WIDTH = 2.0
"""Width of the box filter, applied twice, in cell sizes."""


def stretches(arc: Array) -> Array:
    """Ends of the stretch of cable of each node, (n, 2), from arc lengths (n,)."""
    middles = (arc[1:] + arc[:-1]) / 2
    return np.stack(
        [np.concatenate([arc[:1], middles]), np.concatenate([middles, arc[-1:]])], axis=1
    )


def smoothed(
    arc: Array, forces: Array, at: Array, width: float, ends: tuple[float, float]
) -> Array:
    """Smoothed forces accumulated from the start of the stretch up to `at` (m,). Two boxes make a
    hat filter; its part beyond an end is reflected, which preserves the sum. Shapes and units: arc,
    forces (n,) (length), at (m,) (length), width (length), ends (length)."""
    start, end = ends
    images = np.concatenate([arc, 2 * start - arc, 2 * end - arc])

    def passed(to: Array) -> Array:
        """Share of each force and its two images below some places, (m, n)."""
        x = np.clip((to[:, None] - images) / width, -1.0, 1.0)
        hat = np.where(x < 0, (1 + x) ** 2 / 2, 1 - (1 - x) ** 2 / 2)
        return hat.reshape(len(to), 3, -1).sum(axis=1)

    return np.asarray((passed(np.asarray(at)) - passed(np.array([start]))) @ forces)


def _smooth_line_load(
    cable: LaidCable, run: list[int], shape: StripShape, normal: Array, bearing: Array, line: Array
) -> None:
    """Set `bearing` and `line` for one run of nodes on the membrane."""
    bearing[run] = normal[run]
    # The turn at a cable's ends is unknown, and the force next to an anchor is no line force.
    nodes, last = cable.state.nodes, len(cable.state.nodes) - 1
    beside = {foot for end, foot in ((0, 1), (last, last - 1)) if nodes[end].kind == "anchor"}
    rows = [
        i for i, k in enumerate(run)
        if 0 < k < last and nodes[k].kind != "tied" and k not in beside
    ]  # fmt: skip
    arc = arc_lengths(cable.state.positions[run])
    own = stretches(arc)[rows]
    inner = [run[i] for i in rows]
    if len(inner) < 2 or own[-1, 1] <= own[0, 0]:
        return
    points = [point for k in inner if (point := nodes[k].point) is not None]
    size = float(np.mean([size_at(shape, point.support) for point in points]))
    ends = float(own[0, 0]), float(own[-1, 1])
    width = min(WIDTH * size, ends[1] - ends[0])

    def between(places: Array) -> Array:
        """Smoothed force between pairs of places (n, 2)."""
        sums = smoothed(arc[rows], normal[inner], places.ravel(), width, ends).reshape(-1, 2)
        return np.asarray(sums[:, 1] - sums[:, 0])

    bearing[inner] = between(own)
    around = np.clip(arc[rows][:, None] + (-size / 2, size / 2), *ends)
    line[inner] = between(around) / (around[:, 1] - around[:, 0])
