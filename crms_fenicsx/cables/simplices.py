"""Vertices, edges and cells of a strip by number, so that many are looked up in one go."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.runtime.arrays import Booleans, Integers, runs

_CORNERS = np.array([[1, 0, 0], [2, 0, 0], [3, 0, 0], [1, 2, 0], [1, 3, 0], [2, 3, 0], [1, 2, 3]])
"""Corners, counted from 1, of the vertices and edges of a cell, and of the cell itself."""


class Simplices:
    """The m vertices, edges and cells of n cells, with the cells around each.

    Attributes: `vertices` (k,): ids of all vertices, ascending; `cells` (n, 3): the cells as rows
    of `vertices`, each in its own order; `corners` (m, 3): rows of `vertices` on which a simplex
    lies, ascending; -1 after the last one; `pointers` (m + 1,), rows: the cells around the
    simplices, ascending for each; `owner` (m,): the rank that owns what lies on a simplex: the
    lowest one with a cell there; `sides`, `forward` (n, 3): the edge from each corner of a cell to
    the next, and whether it leads there. Shapes: cells (n, 3), owner (n,).
    """

    def __init__(self, cells: Integers, owner: Integers) -> None:
        self.vertices = np.unique(cells)
        self.cells = np.searchsorted(self.vertices, cells)
        corners = np.sort(self.cells, axis=1) + 1
        corners = np.concatenate([np.zeros((len(cells), 1), dtype=np.int64), corners], axis=1)
        keys: Integers = self._keys(corners[:, _CORNERS] - 1).ravel()
        order = np.argsort(keys, kind="stable")
        self.rows = order // len(_CORNERS)
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        self.pointers = np.append(first, len(keys))
        self.keys = keys[first]
        base = len(self.vertices) + 1
        rest, c = np.divmod(self.keys, base)
        self.corners = np.stack([*np.divmod(rest, base), c], axis=1) - 1
        owners = owner[self.rows]
        self.owner = np.minimum.reduceat(owners, first) if len(first) else owners
        ends = np.stack([self.cells, np.roll(self.cells, -1, axis=1)], axis=2)
        self.forward: Booleans = ends[..., 0] < ends[..., 1]
        none = np.full((*ends.shape[:2], 1), -1)
        edges = np.concatenate([np.sort(ends, axis=2), none], axis=2)
        self.sides = np.searchsorted(self.keys, self._keys(edges))

    def _keys(self, corners: Integers) -> Integers:
        """One number for each simplex (..., 3), given as `corners`."""
        base = len(self.vertices) + 1
        keys: Integers = np.dot(corners + 1, [base**2, base, 1])
        return keys

    def find(self, supports: Integers) -> Integers:
        """Numbers of simplices given by vertex ids (k, 3), ascending and then -1; -1: not here."""
        if len(self.keys) == 0:
            return np.full(len(supports), -1)
        corners = np.minimum(np.searchsorted(self.vertices, supports), len(self.vertices) - 1)
        here = ((self.vertices[corners] == supports) | (supports < 0)).all(axis=1)
        keys = self._keys(np.where(supports < 0, -1, corners))
        found = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(here & (self.keys[found] == keys), found, -1)

    def spanned(self, first: Integers, second: Integers) -> Integers:
        """Numbers of the simplices of the vertices of two supports (k, 3) together; -1: none."""
        ids = np.sort(np.concatenate([first, second], axis=1), axis=1)
        ids[:, 1:][ids[:, 1:] == ids[:, :-1]] = -1
        ids = np.sort(ids, axis=1)
        fits = (ids[:, 2] < 0) & (first[:, 0] >= 0) & (second[:, 0] >= 0)
        none = np.iinfo(np.int64).max
        ids = np.sort(np.where(ids < 0, none, ids), axis=1)[:, :3]
        return np.where(fits, self.find(np.where(ids == none, -1, ids)), -1)

    def around(self, simplices: Integers) -> tuple[Integers, Integers]:
        """How many cells there are around each of some simplices (k,), and their rows."""
        first, counts = self.pointers[simplices], np.diff(self.pointers)[simplices]
        return counts, self.rows[runs(first, counts)]

    def touch(self, cells: Booleans) -> Booleans:
        """Whether there are some of the chosen cells (n,) around the simplices, (m,)."""
        chosen = cells[self.rows]
        return np.logical_or.reduceat(chosen, self.pointers[:-1]) if len(chosen) else chosen
