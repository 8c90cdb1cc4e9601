"""Ponding water: its level, and its energy, integrated exactly.

Water of specific weight w up to the level s has over the plan A the energy

    Pi = -w/2 int <s - z>^2 dA + w s V0,    <h> = h where positive, else 0.

For a given level V0 is zero, as water flows in and out. For a given volume V0 the level follows
from ``int <s - z> dA = V0``, where Pi is stationary in s: its gradient is that at the level found,
and its second derivatives are those of a given level plus the dyad

    w / A_wet  grad(V) grad(V)^T,    V = int <s - z> dA,    A_wet = int_{z < s} dA.

On a facet everything follows from the moments of the shape functions over the wet part, as means
over the facet: ``t_ij = mean(N_i N_j over z < s)``. With the depths h_i of its corners, negative if
dry, ``mean(<h> N_i) = t_ij h_j`` and ``mean(<h>^2) = t_ij h_i h_j``. The wet part is the whole
facet, its corner at one wet vertex, or all but the corner at one dry vertex. Pi is twice
continuously differentiable unless an edge or a facet lies in the water surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numba
import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.terms.folded_pressure import Facets
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.model.membrane_load import Pond

MAX_ITERATIONS = 200
"""Limit of Newton steps and bisections; about ten suffice from any start to the last digit."""


def find_level(
    comm: MPI.Intracomm,
    fill: Callable[[float], None],
    sums: Array,
    volume: float,
    level: float,
) -> float:
    """Find the level at which water has a volume, by Newton's method. Collective. The volume is a
    convex function of the level where the membrane lies under all of the water, so that Newton's
    iterates come from above; elsewhere, and where it is dry, they are bracketed. Units: sums
    (length cubed), volume (length cubed), level (length)."""
    low, high, step = -float("inf"), float("inf"), volume ** (1 / 3)
    total = sums.copy()
    for _ in range(MAX_ITERATIONS):
        fill(level)
        comm.Allreduce(sums, total, op=MPI.SUM)
        surplus, area = float(total[-2]) - volume, float(total[-1])
        if surplus > 0.0:
            high = min(high, level)
        else:
            low = max(low, level)
        if area > 0.0 and abs(surplus) <= 8 * EPSILON * volume:
            return level
        newton = level - surplus / area if area > 0.0 else float("inf")
        if low < newton < high:
            target = newton
        elif high - low < float("inf"):
            target = (low + high) / 2
        else:  # no bracket yet: up to where there is a surface, or down to below it
            target, step = level + (step if surplus <= 0.0 else -step), 2 * step
        if abs(target - level) <= 2 * EPSILON * max(abs(target), abs(level)):
            return target
        level = target
    return level


@numba.njit(cache=True)
def _wet_products(h, t):  # type: ignore[no-untyped-def]
    """Means of ``N_i N_j`` over the wet part of a facet with depths h (3,) into `t` (3, 3)."""
    wet = 0
    for i in range(3):
        wet += h[i] > 0.0
    whole = 1.0 if wet >= 2 else 0.0
    for i in range(3):
        for j in range(3):
            t[i, j] = whole * (2.0 if i == j else 1.0) / 12.0
    if wet == 0 or wet == 3:
        return
    # the corner at the single wet, or dry, vertex
    k = 0
    while (h[k] > 0.0) != (wet == 1):
        k += 1
    a, b = (k + 1) % 3, (k + 2) % 3
    s, r = h[k] / (h[k] - h[a]), h[k] / (h[k] - h[b])
    scale = s * r / 12.0 if wet == 1 else -s * r / 12.0
    # Shape functions at the corner's three vertices; the mean of a product of linear functions is
    # a twelfth of the sum of the products at the vertices plus the product of the sums.
    sk, sa, sb = 3.0 - s - r, s, r
    t[k, k] += scale * (1.0 + (1.0 - s) ** 2 + (1.0 - r) ** 2 + sk * sk)
    t[a, a] += scale * (s * s + sa * sa)
    t[b, b] += scale * (r * r + sb * sb)
    ka = scale * ((1.0 - s) * s + sk * sa)
    kb = scale * ((1.0 - r) * r + sk * sb)
    ab = scale * sa * sb
    t[k, a] += ka
    t[a, k] += ka
    t[k, b] += kb
    t[b, k] += kb
    t[a, b] += ab
    t[b, a] += ab


@numba.njit(cache=True)
def _facet(X, x, corners, level, p, h, t):  # type: ignore[no-untyped-def]
    """Positions p (3, 3), depths and wet moments of a facet; returns its signed area in plan."""
    for m in range(3):
        for i in range(3):
            p[m, i] = X[corners[m], i] + x[corners[m], i]
        h[m] = level - p[m, 2]
    _wet_products(h, t)
    return 0.5 * (
        (p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[2, 0] - p[0, 0]) * (p[1, 1] - p[0, 1])
    )


@numba.njit(cache=True)
def water_sums(X, x, corners, weights, level, out):  # type: ignore[no-untyped-def]
    """Integrals over the wet plan into `out` (3,): of <h>^2, of <h>, and its area."""
    out[:] = 0.0
    p, h, t = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for f in range(len(corners)):
        area = weights[f] * _facet(X, x, corners[f], level, p, h, t)
        for i in range(3):
            for j in range(3):
                out[0] += area * h[i] * t[i, j] * h[j]
                out[1] += area * t[i, j] * h[j]
                out[2] += area * t[i, j]


@numba.njit(cache=True)
def _add_gradient(X, x, corners, weights, level, squared, depth, g):  # type: ignore[no-untyped-def]
    """Add the gradient of ``squared int <h>^2 dA + depth int <h> dA``."""
    p, h, t = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for f in range(len(corners)):
        area = _facet(X, x, corners[f], level, p, h, t)
        per_area = 0.0
        for i in range(3):
            mean, share = 0.0, 0.0
            for j in range(3):
                mean += t[i, j] * h[j]
                share += t[i, j]
            per_area += squared * mean * h[i] + depth * mean
            g[corners[f, i], 2] -= weights[f] * area * (2.0 * squared * mean + depth * share)
        per_area *= weights[f] / 2.0
        for i in range(3):
            a, b, node = (i + 1) % 3, (i + 2) % 3, corners[f, i]
            g[node, 0] += per_area * (p[a, 1] - p[b, 1])
            g[node, 1] += per_area * (p[b, 0] - p[a, 0])


@numba.njit(cache=True)
def _hessian(X, x, corners, weights, level, factor, blocks):  # type: ignore[no-untyped-def]
    """Second derivatives of ``factor int <h>^2 dA``, blocks (n, 3, 3, 3, 3) of the corners."""
    p, h, t, of_area = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 2))
    for f in range(len(corners)):
        area = _facet(X, x, corners[f], level, p, h, t)
        scale = factor * weights[f]
        square = 0.0
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            of_area[i, 0], of_area[i, 1] = 0.5 * (p[a, 1] - p[b, 1]), 0.5 * (p[b, 0] - p[a, 0])
            for j in range(3):
                square += h[i] * t[i, j] * h[j]
        blocks[f] = 0.0
        for i in range(3):
            mean = 0.0
            for j in range(3):
                mean += t[i, j] * h[j]
                blocks[f, i, j, 2, 2] = 2.0 * scale * area * t[i, j]
            for j in range(3):
                for c in range(2):
                    blocks[f, i, j, 2, c] -= 2.0 * scale * mean * of_area[j, c]
                    blocks[f, j, i, c, 2] -= 2.0 * scale * mean * of_area[j, c]
            a = (i + 1) % 3
            blocks[f, i, a, 0, 1] += 0.5 * scale * square
            blocks[f, i, a, 1, 0] -= 0.5 * scale * square
            blocks[f, a, i, 1, 0] += 0.5 * scale * square
            blocks[f, a, i, 0, 1] -= 0.5 * scale * square


@numba.njit(cache=True)
def add_water_pressure(X, x, corners, weights, level, factor, g):  # type: ignore[no-untyped-def]
    """Add ``factor`` times the nodal forces of the pressure <h> along the facets' normals."""
    p, h, t = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for f in range(len(corners)):
        _facet(X, x, corners[f], level, p, h, t)
        for i in range(3):
            mean = 0.0
            for j in range(3):
                mean += t[i, j] * h[j]
            scale = 0.5 * factor * weights[f] * mean
            node = corners[f, i]
            for c in range(3):
                a, b = (c + 1) % 3, (c + 2) % 3
                g[node, c] += scale * (
                    (p[1, a] - p[0, a]) * (p[2, b] - p[0, b])
                    - (p[1, b] - p[0, b]) * (p[2, a] - p[0, a])
                )


class Ponding(EnergyTerm):
    """Energy of a pond, relative to its water at the height `datum`.

    Unlike other terms it communicates in `sums` if the volume is given, to find the level.

    Attributes: `pond`: the water, whose factor load steps change; `level`: height z of the water
    surface at the last `sums` (length). Units: datum (length).
    """

    name = "pond"
    exact_hessian = True
    n_sums = 3

    def __init__(self, pond: Pond, table: Facets, datum: float) -> None:
        self.pond, self.datum, self.level = pond, datum, pond.level
        # Plan areas are positive if the pond's side of the cells faces up.
        self.table, self._weights = table, pond.side * table.weights
        self._pattern = ElementPattern(*table.element_blocks)
        self.patterns = (self._pattern,)

    @property
    def _weight(self) -> float:
        """Specific weight at the current factor (force / length cubed)."""
        return self.pond.factor * self.pond.weight

    def sums(self, x: Array, out: Array) -> None:
        """This rank's parts of the integrals of depth squared, depth, and 1 over the wet plan.
        Collective if the volume is given."""
        facets = (self.unknowns.X, x, self.table.corners, self._weights)
        if self.pond.given == "level":
            self.level = self.pond.level
        else:
            self.level = find_level(
                self.unknowns.comm, lambda level: water_sums(*facets, level, out), out,
                self.pond.volume, self.level,
            )  # fmt: skip
        water_sums(*facets, self.level, out)

    def energy(self, sums: Array) -> float:
        kept = self.pond.volume * (self.level - self.datum) if self.pond.given == "volume" else 0.0
        return self._weight * (kept - float(sums[0]) / 2)

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        _add_gradient(
            self.unknowns.X, x, self.table.corners, self._weights, self.level,
            -self._weight / 2, 0.0, g,
        )  # fmt: skip

    def add_pressure(self, x: Array, g: Array, factor: float) -> None:
        """Add `factor` times the water's forces normal to the membrane: the gradient's except at
        the rim of the pond's cells, where water would flow over."""
        add_water_pressure(
            self.unknowns.X,
            x,
            self.table.corners,
            self._weights,
            self.level,
            -factor * self._weight,
            g,
        )

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        blocks = self._pattern.values.reshape(-1, 3, 3, 3, 3)
        _hessian(
            self.unknowns.X, x, self.table.corners, self._weights, self.level,
            -self._weight / 2, blocks,
        )  # fmt: skip
        self._pattern.add(A)

    def dyads(self, sums: Array, exact: bool) -> Sequence[float]:
        """Stiffness of a given volume beyond that of a given level (force / length^5)."""
        if self.pond.given == "level" or not sums[2] > 0.0:
            return ()
        return (self._weight / float(sums[2]),)

    def add_dyad_column(self, k: int, x: Array, g: Array) -> None:
        """Add the gradient of the volume below the level."""
        corners = self.table.corners
        _add_gradient(self.unknowns.X, x, corners, self._weights, self.level, 0.0, 1.0, g)
