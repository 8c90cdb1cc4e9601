"""Continuum references of membranes of revolution with a ring cable around them.

The profile (y, r) is a function of the stress-free arc s. Green-Lagrange strains, a linear law with
wrinkling along meridians and exact follower pressure: the package's membrane, reduced to one
dimension, with separate quadratic finite elements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array

GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class Revolution:
    """Half of a membrane of revolution, from the plane y = 0 of its ring to its end.

    Attributes
    ----------
    length
        Stress-free arc from the ring to the end (length).
    radius, height
        Stress-free r and y as functions of the arc (length).
    Et, nu
        Extensional stiffness (force / length) and Poisson's ratio.
    pressure
        Pressure (force / length squared).
    pole
        Whether the end is a pole, on the axis; otherwise it is held.
    """

    length: float
    radius: Callable[[Array], Array]
    height: Callable[[Array], Array]
    Et: float
    nu: float
    pressure: float
    pole: bool

    def tension(self, EA: float, L0: float, elements: int = 200) -> float:
        """Tension of a ring around y = 0 with an unstressed length `L0` (force)."""
        x = self._solved(EA, L0, elements)
        return EA * (2 * np.pi * x[0, 1] / L0 - 1)

    def _solved(self, EA: float, L0: float, elements: int) -> Array:
        nodes = np.linspace(0.0, self.length, 2 * elements + 1)
        x = np.column_stack([self.height(nodes), self.radius(nodes)])
        free = np.ones_like(x, dtype=bool)
        free[0, 0] = False
        free[-1] = (True, False) if self.pole else (False, False)
        band = 12  # unknowns that share an element are less than half of this apart
        for _ in range(60):
            g = self._gradient(x, nodes, EA, L0)[free]
            jacobian = np.zeros((len(g), len(g)))
            places = np.flatnonzero(free.ravel())
            for colour in range(band):
                moved = x.astype(complex)
                own = places[places % band == colour]
                moved.ravel()[own] += 1e-30j
                slope = self._gradient(moved, nodes, EA, L0)[free].imag / 1e-30
                nearest = own[np.abs(places[:, None] - own).argmin(axis=1)]
                jacobian[np.arange(len(g)), np.searchsorted(places, nearest)] += slope
            step = np.linalg.solve(jacobian, -g)
            x[free] += step
            if np.abs(step).max() < 1e-11 * self.length:
                return x
        raise RuntimeError("the axisymmetric membrane does not converge")

    def _gradient(self, x: Array, nodes: Array, EA: float, L0: float) -> Array:
        """Derivative of the energy over 2 pi by the nodes' (y, r)."""
        g = np.zeros_like(x)
        rows = np.arange(0, len(nodes) - 2, 2)[:, None] + np.arange(3)
        h = nodes[2] - nodes[0]
        for t, weight in zip((GAUSS + 1) / 2, WEIGHTS / 2, strict=True):
            shape = np.array([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])
            slope = np.array([4 * t - 3, 4 - 8 * t, 4 * t - 1]) / h
            s = nodes[rows[:, 0]] + t * h
            r0 = self.radius(s)
            r, (dy, dr) = x[rows, 1] @ shape, (x[rows, 0] @ slope, x[rows, 1] @ slope)
            E1, E2 = (dy**2 + dr**2 - 1) / 2, ((r / r0) ** 2 - 1) / 2
            stiffness = self.Et / (1 - self.nu**2)
            N1, N2 = stiffness * (E1 + self.nu * E2), stiffness * (E2 + self.nu * E1)
            N1, N2 = np.where(N2.real > 0, N1, self.Et * E1), np.where(N2.real > 0, N2, 0.0)
            by_dy = r0 * N1 * dy - self.pressure * r**2 / 2
            by_dr, by_r = r0 * N1 * dr, N2 * r / r0 - self.pressure * r * dy
            np.add.at(g[:, 0], rows, weight * h * by_dy[:, None] * slope)
            np.add.at(g[:, 1], rows, weight * h * (by_dr[:, None] * slope + by_r[:, None] * shape))
        g[0, 1] += EA * (2 * np.pi * x[0, 1] / L0 - 1) / 2
        return g
