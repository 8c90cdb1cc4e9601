"""Contact forces per length of the cable."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.gap import size_at
from crms_fenicsx.meshes.triangles import arc_lengths
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array

WIDTH = 2.0
"""Width of the box filter that is applied twice, in sizes of the cells."""


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

    Two boxes make a hat. What it would spread beyond an end is reflected there, so that the sum
    stays. Shapes and units: arc, forces (n,) (length), at (m,) (length), width (length), ends
    (length).
    """
    start, end = ends
    images = np.concatenate([arc, 2 * start - arc, 2 * end - arc])

    def passed(to: Array) -> Array:
        """Share of each force and its two images below some places, (m, n)."""
        x = np.clip((to[:, None] - images) / width, -1.0, 1.0)
        hat = np.where(x < 0, (1 + x) ** 2 / 2, 1 - (1 - x) ** 2 / 2)
        return hat.reshape(len(to), 3, -1).sum(axis=1)

    return np.asarray((passed(np.asarray(at)) - passed(np.array([start]))) @ forces)


def smooth_line_load(
    cable: LaidCable, run: list[int], shape: StripShape, normal: Array, bearing: Array, line: Array
) -> None:
    """Fill in `bearing` and `line` for one run of nodes on the membrane."""
    bearing[run] = normal[run]
    # Of the turn at the cable's ends nothing is known, and what presses on an edge of the boundary,
    # next to an anchor, is no line force.
    rows = [i for i, k in enumerate(run) if _may_slide(cable, k) and not _beside_anchor(cable, k)]
    arc = arc_lengths(cable.positions[run])
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
