"""Directions in which forces on vertices change a form, and those in which they do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.form_finding.cables import EdgeLine
from crms_fenicsx.form_finding.film import Film
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array

LYING = 0.1
"""Part of a direction that supports leave free, up to which there is none."""


class Directions:
    """Splits the directions in which vertices are free into those across a form and within it.

    A vertex that moves within a smooth surface, or along a cable, leaves the form as it is. Across
    are the normal of the surface and the two directions square to a cable, or all where cables end
    or meet.

    Attributes: `free` (n, 3): free components of this rank's vertices; `on_cable` (n,): whether a
    vertex is free to move along a cable; `guided` (n,): whether supports leave a vertex some of its
    directions, but no cable holds it. Its own forces within the surface count as well: a ridge may
    be held vertically only; `across`, `within` (n, 3, 3): projectors on the directions of both
    kinds; `counted`, `along` (n, 3, 3): on those in which forces are to balance, and on those along
    cables.
    """

    def __init__(self, membrane: Membrane, film: Film, lines: Sequence[EdgeLine]) -> None:
        self._film, self._lines = film, lines
        n = membrane.V.dofmap.index_map.size_local
        self.free = ~membrane.held[:n]
        ids = membrane.vertex_ids[:n]
        vertices = np.concatenate([np.zeros(0, dtype=np.int64), *(line.ids for line in lines)])
        numbers, count = np.unique(vertices, return_counts=True)
        ends = [line.ids[[0, -1]] for line in lines]
        inner = np.setdiff1d(numbers[count == 1], np.concatenate([numbers[:0], *ends]))
        self.on_cable = np.isin(ids, inner)
        on_any = np.isin(ids, numbers)
        self._joint = on_any & ~self.on_cable
        self.guided = ~on_any & self.free.any(axis=1) & ~self.free.all(axis=1)
        self.across, self.within, self.counted, self.along = np.zeros((4, n, 3, 3))

    def take(self) -> None:
        """Take the directions of the current shape. Collective."""
        film, free = self._film, self.free[:, :, None] * np.eye(3)
        normal = self._freed(film.growth())
        along = sum((line.tangents(len(film.start)) for line in self._lines), 0.0 * film.start)
        tangent = self._freed(film.gathered(along)) * self.on_cable[:, None]
        held = self.on_cable | self._joint
        self.across = normal[:, :, None] * normal[:, None, :]
        self.across[held] = (free - tangent[:, :, None] * tangent[:, None, :])[held]
        self.within = free - self.across
        self.counted = np.where(self.guided[:, None, None], free, self.across)
        self.along = np.where(self.on_cable[:, None, None], self.within, 0.0)

    def _freed(self, vectors: Array) -> Array:
        """Free parts of vectors (n, 3) as unit vectors, zero where hardly any part is free."""
        lengths = np.linalg.norm(vectors, axis=1)
        parts = np.where(self.free, vectors, 0.0)
        sizes = np.linalg.norm(parts, axis=1)
        sizes = np.where(sizes > LYING * lengths, sizes, np.inf)
        return np.asarray(parts / sizes[:, None])
