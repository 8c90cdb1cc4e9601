"""Nodes of a cable from places on its path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.model.cable_state import CableNode, End
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import CellPoint, EdgePoint, SurfacePoint, VertexPoint


def nodes_of(
    points: Sequence[SurfacePoint], strip: Strip, ends: tuple[End, End]
) -> tuple[CableNode, ...]:
    """The points of a polyline, with anchors at its ends where it has them."""
    nodes: list[CableNode] = []
    last = len(points) - 1
    for k, point in enumerate(points):
        in_place = (k == 0 and ends[0] != "off") or (k == last and ends[1] != "off")
        if isinstance(point, VertexPoint):
            nodes.append(CableNode("vertex", point))
        elif in_place or isinstance(point, CellPoint):
            nodes.append(CableNode("rider", point))
        elif point.edge in strip.held_edges:
            nodes.append(CableNode("rail", point))
        else:
            nodes.append(CableNode("fold", point))
    if ends[0] != "tied":
        nodes.insert(0, CableNode("anchor"))
    if ends[1] != "tied":
        nodes.append(CableNode("anchor"))
    return tuple(nodes)


def fractions_of(nodes: Sequence[CableNode]) -> Array:
    """Places of the nodes on edges; NaN for other nodes."""
    points = (node.point for node in nodes)
    return np.array([p.fraction if isinstance(p, EdgePoint) else np.nan for p in points])
