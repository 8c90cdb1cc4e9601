"""All nodes of all cables as arrays, cable by cable."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Integers, pointers

VERTEX, FOLD, RAIL, RIDER, ANCHOR, CROSSING = range(6)
NUMBERS = dict(
    zip(("vertex", "fold", "rail", "rider", "anchor", "crossing"), range(6), strict=True)
)
"""The numbers of `CableNode.kind`."""


class NodeTable:
    """The nodes of some cables, n in all; what they are, not where they are in space.

    Attributes: `starts`: rows at which the cables begin; `cable`, `place` (n,): numbers of the
    cable and of the node in it; `kind`, `crossing` (n,): as of `CableNode`; -1 without a crossing;
    `support`, `weights` (n, 3): vertices (ids) on which a node lies or between which, -1 after the
    last one, and their weights on the unfolded mesh, 0 there; `size` (n,): how many these are; 0
    for anchors; `taut`, `lifted`, `slides` (n,): whether the node is one of a cable in tension, is
    lifted, slides on an edge.
    """

    def __init__(self, cables: Sequence[LaidCable]) -> None:
        nodes = [node for cable in cables for node in cable.nodes]
        counts = np.array([len(cable.nodes) for cable in cables], dtype=np.int64)
        n = len(nodes)
        self.starts = pointers(counts)
        self.cable = np.repeat(np.arange(len(cables)), counts)
        self.place = np.arange(n) - self.starts[self.cable]
        self.kind = np.fromiter((NUMBERS[node.kind] for node in nodes), np.int64, n)
        shared = (-1 if node.crossing is None else node.crossing for node in nodes)
        self.crossing = np.fromiter(shared, np.int64, n)
        points = [node.point for node in nodes]
        supports = [() if point is None else point.support for point in points]
        self.size = np.fromiter(map(len, supports), np.int64, n)
        there = np.arange(3) < self.size[:, None]
        self.support = np.full((n, 3), -1)
        self.support[there] = np.fromiter(chain.from_iterable(supports), np.int64)
        weights = (point.weights for point in points if point is not None)
        self.weights = np.zeros((n, 3))
        self.weights[there] = np.fromiter(chain.from_iterable(weights), float)
        self.taut = np.repeat(np.array([cable.taut for cable in cables], dtype=bool), counts)
        empty = np.zeros(0, dtype=bool)
        self.lifted = np.concatenate([empty, *(cable.lifted for cable in cables)])
        self.slides = (self.kind == FOLD) | (self.kind == RAIL)

    def ids(self, rows: Integers) -> list[NodeId]:
        """Numbers of the cable and of the node for some rows."""
        return list(zip(map(int, self.cable[rows]), map(int, self.place[rows]), strict=True))
