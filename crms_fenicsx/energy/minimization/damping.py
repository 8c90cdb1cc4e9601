"""Springs in H0 that restrain cable points while forces are unbalanced.

A cable has little lateral restraint short of the next vertex, and two points at a crossing near an
edge are so close that their distance does not control the next one. Newton's step moves such points
far beyond the quadratic model, and the line search then shortens the whole step. So springs tie

* each sliding point to its place on its edge,
* the ends of each straight segment of a cable to each other, and
* each stress-free place that shifts to where it is.

With them the unbalanced force on a point alone moves it by a fraction of the edge, or by the
segment's length. They vanish with the forces: Levenberg damping proportional to the residual.
Second derivatives have no springs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.dofs.block_patterns import (
    BlockPattern,
    BlockSink,
    SegmentPattern,
)
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices

SLIDE = 0.1
"""Fraction of its edge, or of the cell size, by which the unbalanced force alone moves a sliding
point; 0.02 to 0.2 perform alike."""


@dataclass(frozen=True)
class Springs(ElementTable):
    """This rank's springs."""

    # sliders (n, 3), fractions (n,): sliding points and ends of their edges, edge fractions
    sliders: Indices
    fractions: Array
    segments: Indices  # (m, 2) blocks at the ends of straight cable segments
    shifts: Indices  # (k,) blocks of stress-free places
    sizes: Array  # (k,) cell sizes there (length)
    addresses = ("sliders", "segments", "shifts")


class Damping:
    """Stiffness of the springs."""

    def __init__(self, springs: Springs) -> None:
        self.springs, fractions = springs, springs.fractions
        weights = np.stack([np.ones(len(fractions)), fractions - 1, -fractions], axis=1)
        shares = weights[:, :, None] * weights[:, None, :]
        rows, cols = np.repeat(springs.sliders, 3, axis=1), np.tile(springs.sliders, 3)
        self._on_edges = BlockPattern(rows.ravel(), cols.ravel(), shares.reshape(-1, 9))
        self._along = SegmentPattern(springs.segments)
        self._of_shifts = BlockPattern(springs.shifts, springs.shifts)
        self.patterns = (self._on_edges, self._along, self._of_shifts)

    def elements_on(self, chosen: Booleans) -> Springs:
        """Springs that touch the chosen blocks, (n_local,)."""
        s = self.springs
        own, parts = chosen[s.sliders[:, 0]], chosen[s.segments].any(axis=1)
        shifts = chosen[s.shifts]
        return Springs(
            s.sliders[own], s.fractions[own], s.segments[parts], s.shifts[shifts], s.sizes[shifts]
        )

    def add_stiffness(self, unknowns: Unknowns, x: Array, g: Array, A: BlockSink) -> None:
        """Add the springs' stiffness to the matrix. Shapes: x, g (n_local, 3)."""
        X = unknowns.X + x
        force = np.linalg.norm(g, axis=1)
        point, start, end = self.springs.sliders.T
        to_start, to_end = (np.linalg.norm(X[point] - X[v], axis=1) for v in (start, end))
        travel = np.minimum(SLIDE * np.linalg.norm(X[end] - X[start], axis=1), to_start)
        travel = np.minimum(travel, to_end)
        stiffness = _ratio(force[point], travel)
        np.multiply(stiffness[:, None, None], np.eye(3), out=self._on_edges.values)
        self._on_edges.add(A)
        a, b = self.springs.segments.T
        stiffness = _ratio(np.maximum(force[a], force[b]), np.linalg.norm(X[a] - X[b], axis=1))
        np.multiply(stiffness[:, None, None], np.eye(3), out=self._along.values)
        self._along.add(A)
        stiffness = _ratio(force[self.springs.shifts], SLIDE * self.springs.sizes)
        np.multiply(stiffness[:, None, None], np.eye(3), out=self._of_shifts.values)
        self._of_shifts.add(A)


def _ratio(a: Array, b: Array) -> Array:
    """a / b; 0 where two points coincide, since their direction is then undefined."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)
