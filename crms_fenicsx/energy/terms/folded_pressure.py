"""Pressure on folded cells: the volume under them, facet by facet (section 2.4).

Chords cut a folded cell into polygons. The volume under a polygon with more than three corners is
the mean over the fans from each corner, for a quadrilateral that of both diagonals, so that
mirrored scenes have mirrored results. The paper's figure of the partition of a folded triangle
among its nodes is lost; here each facet gives a third of its area to each corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from dolfinx import fem

from crms_fenicsx.energy.terms.pressure import volume_pattern
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


@dataclass(frozen=True)
class Facets(ElementTable):
    """This rank's facets of folded cells."""

    corners: Indices  # (n, 3) blocks, oriented like the membrane
    weights: Array  # (n,) weight of each facet in the mean over fans
    # (m, 3) corners of the folded cells themselves; their stress-free volume is subtracted
    plain_corners: Indices
    addresses = ("corners", "plain_corners")

    def some(self, rows: Integers) -> Facets:
        """Subset of the facets, without a stress-free volume to subtract."""
        return Facets(self.corners[rows], self.weights[rows], self.plain_corners[:0])


@numba.njit(cache=True, inline="always")
def _place(X, x, block, origin):  # type: ignore[no-untyped-def]
    """Current position of a block relative to the origin."""
    return (
        X[block, 0] - origin[0] + x[block, 0],
        X[block, 1] - origin[1] + x[block, 1],
        X[block, 2] - origin[2] + x[block, 2],
    )


@numba.njit(cache=True, inline="always")
def _cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True)
def _volume(X, x, corners, weights, origin):  # type: ignore[no-untyped-def]
    """Volume under all facets."""
    total = 0.0
    for f in range(corners.shape[0]):
        a = _place(X, x, corners[f, 0], origin)
        b, c = _place(X, x, corners[f, 1], origin), _place(X, x, corners[f, 2], origin)
        n = _cross(b, c)
        total += weights[f] / 6.0 * (a[0] * n[0] + a[1] * n[1] + a[2] * n[2])
    return total


@numba.njit(cache=True)
def _add_volume_gradient(X, x, corners, weights, origin, factor, g):  # type: ignore[no-untyped-def]
    for f in range(corners.shape[0]):
        i, j, k = corners[f, 0], corners[f, 1], corners[f, 2]
        a, b, c = _place(X, x, i, origin), _place(X, x, j, origin), _place(X, x, k, origin)
        scale = factor * weights[f] / 6.0
        for node, n in ((i, _cross(b, c)), (j, _cross(c, a)), (k, _cross(a, b))):
            g[node, 0] += scale * n[0]
            g[node, 1] += scale * n[1]
            g[node, 2] += scale * n[2]


@numba.njit(cache=True)
def _volume_hessian(X, x, corners, weights, origin, factor, values):  # type: ignore[no-untyped-def]
    """Put second derivatives of ``factor x volume`` of facets into `values` (3 n, 3, 3) of a
    `volume_pattern`."""
    p = np.empty(3)
    for f in range(len(corners)):
        scale = factor * weights[f] / 6.0
        for m in range(3):
            # the derivative by corners m + 1 and m + 2 is the cross product with corner m
            for i in range(3):
                p[i] = scale * (X[corners[f, m], i] - origin[i] + x[corners[f, m], i])
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                values[3 * f + m, i, j], values[3 * f + m, j, i] = p[k], -p[k]


class FoldedFollowerPressure(ElementTerm):
    """Potential ``-p (V - V0)`` of the folded cells, as `FollowerPressure`."""

    name = "pressure"
    exact_hessian = True
    of_cables = True

    def __init__(self, table: Facets, pressure: fem.Constant, origin: Array) -> None:
        super().__init__(table)
        self.pressure, self.origin = pressure, origin
        self.pattern = volume_pattern(table.corners)
        self.patterns = (self.pattern,)

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        corners = self.table.plain_corners
        self._stress_free = _volume(
            unknowns.X, np.zeros_like(unknowns.X), corners, np.ones(len(corners)), self.origin
        )

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained (length cubed)."""
        t = self.table
        volume = _volume(self.unknowns.X, x, t.corners, t.weights, self.origin)
        out[0] = volume - self._stress_free

    def energy(self, sums: Array) -> float:
        return -float(self.pressure.value) * float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        t, factor = self.table, -float(self.pressure.value)
        if factor != 0.0:
            _add_volume_gradient(self.unknowns.X, x, t.corners, t.weights, self.origin, factor, g)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        t, factor = self.table, -float(self.pressure.value)
        _volume_hessian(
            self.unknowns.X, x, t.corners, t.weights, self.origin, factor, self.pattern.values
        )
        self.pattern.add(A)

    def of_elements(self, table: Facets, sums: Array) -> FoldedFollowerPressure:
        return FoldedFollowerPressure(table, self.pressure, self.origin)


class FoldedWind(FoldedFollowerPressure):
    """Potential ``-sum p_c V_c`` of wind on folded cells, with a closed volume V_c for each cell.

    The wind's nodal forces act on the cells' corner triangles. This term transfers them to the
    facets and their points: V_c is enclosed by a cell's facets, its corner triangle and, along the
    sides, the straight edges. As the surface is closed, the forces of each cell are in equilibrium
    and have a potential, though the wind has none; where p_c is the same on both sides of an edge,
    the contributions between them cancel. Shapes and units: table, cells (n,), origin (3,)
    (length).
    """

    name = "wind"

    def __init__(self, table: Facets, cells: Integers, one: fem.Constant, origin: Array) -> None:
        super().__init__(table, one, origin)
        self._cells, self._shares = cells, table.weights.copy()

    def take(self, pressures: Array) -> None:
        """Set the force per area along the normals of this rank's cells, (m,)."""
        np.multiply(self._shares, pressures[self._cells], out=self.table.weights)
