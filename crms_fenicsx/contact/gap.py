"""The gap between a cable and the membrane below it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.meshes.triangles import cross
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import INSIDE, PAST
from crms_fenicsx.runtime.arrays import Array


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
