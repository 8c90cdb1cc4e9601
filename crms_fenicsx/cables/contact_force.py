"""Equivalent contact force: how hard a cable presses on the membrane (section 3.2).

The paper takes it from the turning angle theta of the cable at a sliding node,

    N = 2 T sin(theta/2) inside the membrane,   N = T tan(theta/2) at its boundary   (3.2-1, 2).

A cable that is held back by friction also turns sideways, and this turn does not press. By default
only the part of the force along the membrane's normal counts. Fold points come irregularly, some
close together, and their forces with them; what converges is the force per length of cable. So it
is summed up along the cable, smoothed over a few cells, and each node gets the part that belongs
to its stretch of cable.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.cable import LaidCable
from crms_fenicsx.cables.contact import size_at
from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.cables.triangles import cross

Array = npt.NDArray[np.float64]

WIDTH = 2.0
"""Width of the box filter that is applied twice, in sizes of the cells."""
ACROSS = 0.05
"""Sine of the least angle between a cable and an edge at which the two span a plane."""


@dataclass(frozen=True)
class ContactForces:
    """What a cable in tension does to the membrane at its nodes; zero where it does not touch it.

    Attributes
    ----------
    normal, lateral : (n,)
        Force along the outward normal of the membrane, positive if the cable presses, and sideways
        in the surface, positive to the left seen from outside (force).
    bearing : (n,)
        Part of the smoothed normal force that belongs to each node's stretch of cable (force).
    line : (n,)
        Smoothed normal force per length of cable (force per length); NaN off the membrane.
    """

    normal: Array
    lateral: Array
    bearing: Array
    line: Array


def contact_forces(cable: LaidCable, shape: StripShape) -> ContactForces:
    """Contact forces of a cable in its current shape, with its current tension.

    Parameters
    ----------
    cable
        A cable.
    shape
        Positions of the vertices around.

    Notes
    -----
    With e the direction of the edge at a node, t1 and t2 those of the cable before and after, and t
    their mean, ``normal = -(T2 t2 - T1 t1) . n`` with n = e x t to the outside; the tensions T1 and
    T2 differ where friction along the cable holds it. Where cables cross, the
    upper one presses on the lower and not on the membrane: what the lower hands on is in its own
    forces beside the crossing.
    """
    n = len(cable.nodes)
    normal, lateral, bearing = np.zeros((3, n))
    line = np.full(n, np.nan)
    if not cable.taut:
        return ContactForces(normal, lateral, bearing, line)
    first, last = _tensions_at(cable)
    for k, (before, after) in turns(cable).items():
        if cable.nodes[k].kind == "crossing":
            continue
        up, left = directions(cable, k, shape, before, after)
        pull = last[k] * after - first[k] * before
        normal[k], lateral[k] = -pull @ up, pull @ left
    for run in runs(cable):
        _smooth(cable, run, shape, normal, bearing, line)
    if cable.sleeve:  # it bears from below as well
        return ContactForces(normal, lateral, np.abs(bearing), np.abs(line))
    return ContactForces(normal, lateral, np.maximum(bearing, 0.0), line)


def wrap_angles(cable: LaidCable, shape: StripShape) -> Array:
    """Angle by which the cable wraps the membrane at each node, (n,).

    It is the turn around the membrane that the normal contact force comes from, without the turn
    sideways, and smoothed like that force; zero where the membrane would be pulled.
    """
    angles, wrap = np.zeros((2, len(cable.nodes)))
    for k, (before, after) in turns(cable).items():
        if cable.nodes[k].kind != "crossing":
            up, _ = directions(cable, k, shape, before, after)
            half = np.clip((before - after) @ up / 2, -1.0, 1.0)
            angles[k] = 2 * np.arcsin(half)
    line = np.zeros_like(angles)
    for run in runs(cable):
        _smooth(cable, run, shape, angles, wrap, line)
    return np.abs(wrap) if cable.sleeve else np.maximum(wrap, 0.0)


def paper_forces(cable: LaidCable) -> Array:
    """Equivalent contact force of the paper at each node, (n,) (force).

    Equations (3.2-1) inside the membrane and (3.2-2) next to an anchor, at its boundary; both are
    zero at zero angle, and stay finite up to pi and just below it.
    """
    forces = np.zeros(len(cable.nodes))
    if not cable.taut:
        return forces
    contacts = cable.contacts()
    for k, (before, after) in turns(cable).items():
        if cable.nodes[k].kind == "crossing":
            continue
        # |t2 - t1| = 2 sin(theta/2) and |t2 + t1| = 2 cos(theta/2): no angle, and no division by
        # the sine.
        sine = float(np.linalg.norm(after - before)) / 2
        cosine = float(np.linalg.norm(after + before)) / 2
        i = contacts.index(k)
        beside = {cable.nodes[contacts[i - 1]].kind, cable.nodes[contacts[i + 1]].kind}
        if "anchor" in beside:
            forces[k] = cable.tension * sine / max(cosine, np.finfo(float).eps)
        else:
            forces[k] = 2 * cable.tension * sine
    return forces


def _tensions_at(cable: LaidCable) -> tuple[Array, Array]:
    """Tensions before and after each node that the cable touches, (n,); zero elsewhere."""
    contacts = cable.contacts()
    first, last = np.zeros((2, len(cable.nodes)))
    first[contacts[1:]], last[contacts[:-1]] = cable.tensions, cable.tensions
    return first, last


def turns(cable: LaidCable) -> dict[int, tuple[Array, Array]]:
    """Directions of the cable before and after each node that it touches but its ends."""
    contacts = cable.contacts()
    steps = np.diff(cable.positions[contacts], axis=0)
    sizes = np.linalg.norm(steps, axis=1)
    found = {}
    for i in range(1, len(contacts) - 1):
        # Points in one place have no direction between them: the next one has.
        before = next((m for m in range(i - 1, -1, -1) if sizes[m] > 0.0), None)
        after = next((m for m in range(i, len(sizes)) if sizes[m] > 0.0), None)
        if before is not None and after is not None:
            found[contacts[i]] = steps[before] / sizes[before], steps[after] / sizes[after]
    return found


def directions(
    cable: LaidCable, k: int, shape: StripShape, before: Array, after: Array
) -> tuple[Array, Array]:
    """Outward normal at a node, square to edge and cable, and the direction to the cable's left."""
    node = cable.nodes[k]
    assert node.point is not None
    outside = shape.normal(node.point.support)
    along = before + after
    size = np.linalg.norm(along)
    along = along / size if size > 0.0 else before
    up: Array = outside - (outside @ along) * along
    if node.slides:
        square = cross(edge_direction(cable, k, shape), along)
        if np.linalg.norm(square) > ACROSS:
            up = square if square @ outside > 0 else -square
    up = np.asarray(up / np.linalg.norm(up), dtype=float)
    return up, cross(up, along)


def edge_direction(cable: LaidCable, k: int, shape: StripShape) -> Array:
    """Direction of the edge of a sliding node: the mean of its two halves, (3,)."""
    point = cable.nodes[k].point
    assert point is not None
    a, b = (shape.at(vertex) for vertex in point.support)
    parts = [cable.positions[k] - a, b - cable.positions[k]]
    if cable.nodes[k].kind == "rail":  # its edge is straight, and it may lie beyond an end of it
        parts = [b - a]
    edge = np.zeros(3)
    for part in parts:
        size = float(np.linalg.norm(part))
        edge += part / size if size > 0.0 else part
    return np.asarray(edge / np.linalg.norm(edge))


def runs(cable: LaidCable) -> list[list[int]]:
    """Nodes of each part of a cable that lies on the membrane, crossings not counted."""
    parts = itertools.groupby(cable.rim(), key=lambda k: bool(cable.lifted[k]))
    return [list(part) for lifted, part in parts if not lifted]


def stretches(arc: Array) -> Array:
    """Ends of the stretch of cable that belongs to each node, (n, 2), from arc lengths (n,)."""
    middles = (arc[1:] + arc[:-1]) / 2
    return np.stack(
        [np.concatenate([arc[:1], middles]), np.concatenate([middles, arc[-1:]])], axis=1
    )


def smoothed(
    arc: Array, forces: Array, at: Array, width: float, ends: tuple[float, float]
) -> Array:
    """Smoothed forces from the start of their stretch of cable up to some places, (m,).

    Parameters
    ----------
    arc, forces : (n,)
        Where they act (length), and the forces.
    at : (m,)
        Places (length).
    width
        Width of the box filter that is applied twice (length).
    ends
        Where the stretch begins and ends (length).

    Notes
    -----
    Two boxes make a hat. What it would spread beyond an end is reflected there, so that the sum
    stays.
    """
    start, end = ends
    images = np.concatenate([arc, 2 * start - arc, 2 * end - arc])

    def passed(to: Array) -> Array:
        """Share of each force and its two images below some places, (m, n)."""
        x = np.clip((to[:, None] - images) / width, -1.0, 1.0)
        hat = np.where(x < 0, (1 + x) ** 2 / 2, 1 - (1 - x) ** 2 / 2)
        return hat.reshape(len(to), 3, -1).sum(axis=1)

    return np.asarray((passed(np.asarray(at)) - passed(np.array([start]))) @ forces)


def _smooth(
    cable: LaidCable, run: list[int], shape: StripShape, normal: Array, bearing: Array, line: Array
) -> None:
    """Fill in `bearing` and `line` for one run of nodes on the membrane."""
    bearing[run] = normal[run]
    # Of the turn at the cable's ends nothing is known, and what presses on an edge of the boundary,
    # next to an anchor, is no line force.
    rows = [i for i, k in enumerate(run) if _may_slide(cable, k) and not _beside_anchor(cable, k)]
    steps = np.linalg.norm(np.diff(cable.positions[run], axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    own = stretches(arc)[rows]
    inner = [run[i] for i in rows]
    if len(inner) < 2 or own[-1, 1] <= own[0, 0]:
        return
    supports = [node.point.support for k in inner if (node := cable.nodes[k]).point is not None]
    size = float(np.mean([size_at(shape, support) for support in supports]))
    ends = float(own[0, 0]), float(own[-1, 1])
    width = min(WIDTH * size, ends[1] - ends[0])

    def between(places: Array) -> Array:
        """Smoothed force between pairs of places (n, 2)."""
        sums = smoothed(arc[rows], normal[inner], places.ravel(), width, ends).reshape(-1, 2)
        return np.asarray(sums[:, 1] - sums[:, 0])

    bearing[inner] = between(own)
    around = np.clip(arc[rows][:, None] + (-size / 2, size / 2), *ends)
    line[inner] = between(around) / (around[:, 1] - around[:, 0])


def _may_slide(cable: LaidCable, k: int) -> bool:
    """Whether a node is neither an end of its cable nor tied to the membrane."""
    return cable.nodes[k].kind != "rider" and 0 < k < len(cable.nodes) - 1


def _beside_anchor(cable: LaidCable, k: int) -> bool:
    """Whether a node lies next to an anchor, off the membrane or where it is held."""
    first, last = (cable.nodes[end].kind == "anchor" for end in (0, -1))
    return (first and k == 1) or (last and k == len(cable.nodes) - 2)
