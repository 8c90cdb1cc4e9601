"""A roof of one row of cells, and cables along it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx import Cable, LaidCable
from crms_fenicsx.cabling.cables.strip import Strip, StripShape
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.model.cable_state import CableLaw, CableNode, CableState


def roof(heights: Sequence[float]) -> StripShape:
    """A strip of triangles with these heights at x = 0, 1, 2 ...; vertices x, and n + x beyond."""
    n = len(heights)
    cells = [c for k in range(n - 1) for c in ((k, k + 1, n + k), (k + 1, n + k + 1, n + k))]
    points = np.array([(x % n, x // n, heights[x % n]) for x in range(2 * n)], dtype=float)
    none = np.zeros(len(cells), dtype=np.int64)
    strip = Strip(np.array(cells, dtype=np.int64), none, np.arange(len(cells)))
    return StripShape(strip, points, points)


def cable_of(
    cable: Cable, nodes: Sequence[CableNode], places: ArrayLike, *, tension: float = 10.0,
    lifted: Sequence[int] = (), **more: Any,
) -> LaidCable:  # fmt: skip
    """A cable in tension with these nodes at these places, on a membrane or not."""
    x = np.array(places, dtype=float)
    fractions = [n.point.fraction if isinstance(n.point, EdgePoint) else np.nan for n in nodes]
    state = CableState(
        tuple(nodes), x, np.array(fractions), np.isin(np.arange(len(x)), lifted),
        np.full_like(x, np.nan), CableLaw(cable, 1.0, 1.0, tension, taut=True),
    )  # fmt: skip
    laid = LaidCable("cable 1", state)
    laid.update(**more)
    return laid


def cable_on(
    shape: StripShape, nodes: Sequence[CableNode], anchors: Sequence[Sequence[float]] = ()
) -> LaidCable:
    """A cable in tension over these nodes, with anchors before the first and after the last."""
    places = []
    for node in nodes:
        ids, weights = node.interpolation()
        places.append(np.dot(weights, [shape.at(i) for i in ids]))
    all_nodes = list(nodes)
    if len(anchors):
        all_nodes = [CableNode("anchor"), *nodes, CableNode("anchor")]
        places = [anchors[0], *places, anchors[1]]
    return cable_of(Cable(1000.0), all_nodes, places)


def along(shape: StripShape, *anchors: Sequence[float]) -> tuple[LaidCable, dict[float, int]]:
    """A cable along y = 1/2 and the numbers of its nodes by x; its ends are tied or anchored."""
    n = len(shape.strip.vertices) // 2
    edges = {float(k): (k, n + k) for k in range(n)}
    edges |= {k + 0.5: (k + 1, n + k) for k in range(n - 1)}
    kinds = dict.fromkeys(edges, "fold")
    if not anchors:
        kinds[0.0] = kinds[n - 1.0] = "tied"
    nodes = [CableNode(kinds[x], EdgePoint(edges[x], 0.5)) for x in sorted(edges)]  # type: ignore[arg-type]
    first = 1 if anchors else 0
    return cable_on(shape, nodes, anchors), {x: first + k for k, x in enumerate(sorted(edges))}
