"""Energies of flat pieces on refined cells, extrapolated to infinitely fine ones.

The cells of a piece are divided into four, in their planes, until they resolve how its strains vary
across it; the surface stays faceted. With 8, 16 and 32 columns across a sphere's gore of any width
the energy is 52, 16 and 4.7 % too large, extrapolated at the observed rate .2 % too small. The
facets of 4 columns are off by 6 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from crms_fenicsx.design.patterns.flattening import FlatProblem
from crms_fenicsx.design.patterns.pieces import Piece
from crms_fenicsx.foundation.runtime.arrays import Array, Integers

COLUMNS_TO_EXTRAPOLATE = 32
"""Columns of cells at which two energies are extrapolated with an error of 1 %."""
MOST = 64
"""Columns of cells at which the energy itself has an error of 1 %."""

ProblemOf = Callable[[Piece, Array], FlatProblem]
"""The flattening problem of a piece near flat coordinates (n, 2) of its vertices."""


def columns_of(piece: Piece, flat: Array) -> float:
    """Number of columns of (wide) cells across a piece with flat coordinates (n, 2)."""
    return float(np.ptp(flat[:, 1]) / np.quantile(np.ptp(flat[piece.triangles, 1], axis=1), 0.9))


def divided(piece: Piece) -> tuple[Piece, Integers]:
    """A piece with cells divided into four, and the ends (k, 2) of the edges halved by new
    vertices, which follow the old ones."""
    t, n = piece.triangles, len(piece.points)
    keys = np.unique([np.minimum(p, q) * n + np.maximum(p, q) for p, q in zip(
        t.T, np.roll(t, -1, axis=1).T, strict=True)])  # fmt: skip

    def between(p: Integers, q: Integers) -> Integers:
        return n + np.searchsorted(keys, np.minimum(p, q) * n + np.maximum(p, q))

    ends = np.stack([keys // n, keys % n], axis=1)
    a, b, c = t.T
    ab, bc, ca = between(a, b), between(b, c), between(c, a)
    cells = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    edges = []
    for edge in piece.edges:
        run = np.empty(2 * len(edge.vertices) - 1, dtype=np.int64)
        run[::2], run[1::2] = edge.vertices, between(edge.vertices[:-1], edge.vertices[1:])
        edges.append(replace(edge, vertices=run))
    finer = replace(
        piece, cells=np.tile(piece.cells, 4), edges=tuple(edges),
        triangles=np.concatenate([np.stack(corners, axis=1) for corners in cells]),
        points=np.concatenate([piece.points, piece.points[ends].mean(axis=1)]),
    )  # fmt: skip
    return finer, ends


def fine_energies(piece: Piece, flat: Array, problem_of: ProblemOf) -> list[float]:
    """Least energies of a piece with free seams, on its cells and successive refinements."""
    found: list[float] = []
    while True:
        problem = problem_of(piece, flat)
        flat = problem.solve(flat)
        found.append(problem.energy(flat))
        if found[0] <= problem.rounding:
            return found
        if columns_of(piece, flat) >= (COLUMNS_TO_EXTRAPOLATE if len(found) > 1 else MOST):
            return found
        piece, ends = divided(piece)
        flat = np.concatenate([flat, flat[ends].mean(axis=1)])


def limit_of(energies: list[float]) -> float:
    """Limit of energies on successive refinements: with the rate of the last three, bounded by
    first and second order; with second order from two."""
    if len(energies) < 2:
        return energies[-1]
    last = energies[-2] - energies[-1]
    before = energies[-3] - energies[-2] if len(energies) > 2 else np.inf
    rate = min(max(before / last, 2.0), 4.0) if last > 0.0 else 4.0
    return energies[-1] - last / (rate - 1.0)
