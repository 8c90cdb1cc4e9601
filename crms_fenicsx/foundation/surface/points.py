"""Points on a triangulated surface: at a vertex, on an edge, in a cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.runtime.errors import PathError

Support = tuple[int, ...]

Edge = tuple[int, int]

LEAST, MOST = float(np.finfo(float).tiny), float(1.0 - np.finfo(float).epsneg)
"""Limits of fractions inside an edge, for points that have reached its ends, also by rounding."""


def edge_of(a: int, b: int) -> Edge:
    """The edge of two vertices, the smaller one first."""
    return (a, b) if a < b else (b, a)


@dataclass(frozen=True)
class VertexPoint:
    """A point of a path at a mesh vertex."""

    vertex: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertex", int(self.vertex))
        if self.vertex < 0:
            raise PathError(f"vertex id {self.vertex} of a path is negative; ids start at 0.")

    @property
    def support(self) -> tuple[int, ...]:
        """Vertices of the smallest simplex that contains the point."""
        return (self.vertex,)

    @property
    def weights(self) -> tuple[float, ...]:
        """Barycentric weights of these vertices."""
        return (1.0,)

    def __str__(self) -> str:
        return f"vertex {self.vertex}"


@dataclass(frozen=True)
class EdgePoint:
    """A point of a path strictly inside a mesh edge."""

    edge: tuple[int, int]
    fraction: float

    def __post_init__(self) -> None:
        a, b = self.edge
        object.__setattr__(self, "edge", (int(a), int(b)))
        object.__setattr__(self, "fraction", float(self.fraction))
        if not 0 <= a < b:
            raise PathError(f"edge ({a}, {b}) of a path; pass its vertex ids as (smaller, larger).")
        if not 0.0 < self.fraction < 1.0:
            raise PathError(
                f"fraction {self.fraction} on edge ({a}, {b}) of a path is outside (0, 1); "
                "use VertexPoint for its ends."
            )

    @property
    def support(self) -> tuple[int, ...]:
        return self.edge

    @property
    def weights(self) -> tuple[float, ...]:
        return (1.0 - self.fraction, self.fraction)

    def __str__(self) -> str:
        return f"edge {self.edge} at {self.fraction:.6g}"


@dataclass(frozen=True)
class CellPoint:
    """An end of a cable tied to the membrane inside a cell."""

    cell: tuple[int, int, int]
    weights: tuple[float, float, float]

    def __post_init__(self) -> None:
        cell = [int(v) for v in self.cell]
        weights = [float(w) for w in self.weights]
        if len(cell) != 3 or len(set(cell)) != 3 or min(cell) < 0:
            raise PathError(f"cell {tuple(cell)} of a path; pass three different vertex ids.")
        # not (...): NaN fails every comparison
        if len(weights) != 3 or not (min(weights) >= 0.0 and abs(sum(weights) - 1.0) <= 1e-9):
            raise PathError(
                f"weights {tuple(weights)} in cell {tuple(cell)} of a path; "
                "pass three that are not negative and sum to 1."
            )
        order = sorted(range(3), key=cell.__getitem__)
        object.__setattr__(self, "cell", tuple(cell[i] for i in order))
        object.__setattr__(self, "weights", tuple(weights[i] for i in order))

    @property
    def support(self) -> tuple[int, ...]:
        return self.cell

    def __str__(self) -> str:
        return f"a place in cell {self.cell}"


SurfacePoint = VertexPoint | EdgePoint | CellPoint
