"""The edges of a triangulation, numbered, with the cells on their sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


def edge_keys(pairs: NDArray[np.integer]) -> NDArray[np.int64]:
    """Give each vertex pair, shape (k, 2), an integer that does not depend on its order."""
    pairs = np.sort(pairs.astype(np.int64).reshape(-1, 2), axis=1)
    return (pairs[:, 0] << 32) | pairs[:, 1]


@dataclass(frozen=True)
class EdgeTable:
    """Edges of a triangulation; side 3 c + k runs from vertex k of cell c to the next one.

    Attributes
    ----------
    keys
        Sorted `edge_keys` of the edges, shape (e,).
    vertices
        Their vertices, the smaller one first, shape (e, 2).
    counts
        Number of cells on each edge, shape (e,).
    ascending
        Whether a side runs from its smaller to its greater vertex, shape (3 m,).
    order
        Sides sorted by the edge they lie on, shape (3 m,).
    """

    keys: NDArray[np.int64]
    vertices: NDArray[np.int64]
    counts: NDArray[np.intp]
    ascending: NDArray[np.bool_]
    order: NDArray[np.intp]

    @classmethod
    def of(cls, cells: NDArray[np.int64]) -> EdgeTable:
        """Build the table of the cells, shape (m, 3)."""
        sides = cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        side_keys = edge_keys(sides)
        order = np.argsort(side_keys, kind="stable")
        keys, start, counts = np.unique(side_keys[order], return_index=True, return_counts=True)
        vertices = np.sort(sides[order[start]], axis=1)
        return cls(keys, vertices, counts, sides[:, 0] < sides[:, 1], order)

    def sides_of(self, edge: int) -> NDArray[np.intp]:
        """Return the sides that lie on one edge."""
        start = int(self.counts[:edge].sum())
        return self.order[start : start + int(self.counts[edge])]

    def inner_sides(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the two sides of every edge between two cells."""
        start = np.cumsum(self.counts) - self.counts
        inner = start[self.counts == 2]
        return self.order[inner], self.order[inner + 1]

    def boundary(self) -> NDArray[np.int64]:
        """Return the vertex pairs of the edges with one cell, shape (k, 2)."""
        pairs: NDArray[np.int64] = self.vertices[self.counts == 1]
        return pairs
