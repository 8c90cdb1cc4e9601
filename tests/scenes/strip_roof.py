"""A roof of one row of cells, and cables along it."""

from collections.abc import Sequence

import numpy as np

from crms_fenicsx import Cable
from crms_fenicsx.cabling.cables.strip import Strip, StripShape
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.model.cable_state import CableLaw, CableNode, CableState
from crms_fenicsx.model.laid_cable import LaidCable


def roof(heights: Sequence[float]) -> StripShape:
    """A strip of triangles with these heights at x = 0, 1, 2 ...; vertices x, and n + x beyond."""
    n = len(heights)
    cells = [c for k in range(n - 1) for c in ((k, k + 1, n + k), (k + 1, n + k + 1, n + k))]
    points = np.array([(x % n, x // n, heights[x % n]) for x in range(2 * n)], dtype=float)
    none = np.zeros(len(cells), dtype=np.int64)
    strip = Strip(np.array(cells, dtype=np.int64), none, np.arange(len(cells)))
    return StripShape(strip, points, points)


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
    fractions = [
        node.point.fraction if isinstance(node.point, EdgePoint) else np.nan for node in all_nodes
    ]
    state = CableState(
        tuple(all_nodes), np.array(places, dtype=float), np.array(fractions),
        np.zeros(len(all_nodes), dtype=bool), np.full((len(all_nodes), 3), np.nan),
        CableLaw(Cable(1000.0), 1.0, 1.0, 10.0, taut=True),
    )  # fmt: skip
    return LaidCable("cable 1", state)


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
