"""The paper's equations for one folded element and one cable, in numpy and nothing else.

Written from the paper's text alone, and independent of the package: an element i-j-k that a cable
a-p-q-b crosses at p on its side i-j and at q on j-k. Numbers in parentheses are the paper's
equations. What is lost in the scan is said where it counts: the pressure has no part here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

Array = NDArray[np.float64]
I, J, K, A, P, Q, B = range(7)  # noqa: E741
"""Points: corners of the element, first end of the cable, its two sliding nodes, its other end."""


def length(x: Array, *points: int) -> float:
    """Length of a polyline."""
    return float(np.linalg.norm(np.diff(x[list(points)], axis=0), axis=1).sum())


def angle(x: Array, one: int, at: int, other: int) -> float:
    """Angle at a point between two others (rad)."""
    u, v = x[one] - x[at], x[other] - x[at]
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))


def isotropic(E: float, nu: float) -> Array:
    """Stiffness in plane stress (2.3-12)."""
    return E / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])


def orthotropic(E1: float, E2: float, G12: float, nu21: float) -> Array:
    """Stiffness in plane stress, the warp along the side i-k (2.3-13)."""
    n, m = E1 / E2, G12 / E2
    free = 1 - n * nu21**2
    return E2 / free * np.array([[n, n * nu21, 0], [n * nu21, 1, 0], [0, 0, m * free]])


@dataclass
class Element:
    """The folded element: its unfolded sides tell all of its strain.

    Attributes
    ----------
    D, thickness
        Stiffness (3, 3), and thickness.
    stress
        At the beginning of the step (3,).
    sides
        Lengths of i-p-j, j-q-k and i-k at the beginning of the step.
    """

    D: Array
    thickness: float
    stress: Array = field(default_factory=lambda: np.zeros(3))
    sides: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def begin(self, x: Array) -> None:
        """Begin a step (2.3-1, 2.3-2)."""
        self.sides = self.unfolded(x)

    @staticmethod
    def unfolded(x: Array) -> tuple[float, float, float]:
        """Lengths of the three sides, those that are folded along their polylines."""
        return length(x, I, P, J), length(x, J, Q, K), length(x, I, K)

    def strain(self, x: Array) -> tuple[Array, float]:
        """Strain increment, and area at the beginning of the step (2.3-3 ... 2.3-10)."""
        corner, moved = apex(*self.sides), apex(*self.unfolded(x))
        stretch = self.unfolded(x)[2] - self.sides[2]
        i, k, j = np.zeros(2), np.array([self.sides[2], 0.0]), corner
        area = k[0] * j[1] / 2
        b = np.array([k[1] - j[1], j[1] - i[1], i[1] - k[1]])  # of i, k, j
        c = np.array([j[0] - k[0], i[0] - j[0], k[0] - i[0]])
        rows = np.zeros((3, 6))
        rows[0, 0::2], rows[1, 1::2] = b, c
        rows[2, 0::2], rows[2, 1::2] = c, b
        moves = np.array([0, 0, stretch, 0, *(moved - corner)])
        return rows @ moves / (2 * area), area

    def work(self, x: Array) -> float:
        """Of a step (2.3-11, 2.3-14)."""
        strain, area = self.strain(x)
        return float((self.stress + self.D @ strain / 2) @ strain) * self.thickness * area

    def end(self, x: Array) -> None:
        """Take over a step's end."""
        self.stress = self.stress + self.D @ self.strain(x)[0]


def apex(ij: float, jk: float, ik: float) -> Array:
    """Corner j of a triangle with i at the origin and k on the x axis, by its three sides."""
    x = (ik**2 + ij**2 - jk**2) / (2 * ik)
    return np.array([x, np.sqrt(ij**2 - x**2)])


@dataclass
class Rope:
    """The cable: one tension all along it.

    Attributes
    ----------
    EA
        Stiffness.
    tension, length
        At the beginning of the step.
    """

    EA: float
    tension: float = 0.0
    length: float = 0.0

    def begin(self, x: Array) -> None:
        """Begin a step."""
        self.length = length(x, A, P, Q, B)

    def gain(self, x: Array) -> float:
        """Tension that a step adds (2.2-1, 2.2-2)."""
        return self.EA * (length(x, A, P, Q, B) / self.length - 1)

    def work(self, x: Array) -> float:
        """Of a step (2.2-3)."""
        return (self.tension + self.gain(x) / 2) * (length(x, A, P, Q, B) - self.length)

    def end(self, x: Array) -> None:
        """Take over a step's end."""
        self.tension += self.gain(x)


def penalty(x: Array, mu: float) -> float:
    """Keeps both folded sides straight when the element is unfolded (2.5-1)."""
    at_p = angle(x, I, P, Q) + angle(x, J, P, Q) - np.pi
    at_q = angle(x, J, Q, P) + angle(x, P, Q, K) - np.pi
    return mu * float(at_p**2 + at_q**2)


@dataclass(frozen=True)
class Step:
    """State after a step: tension of the cable, places of its points a, p, q, b, and the work."""

    tension: float
    line: Array
    work: float


def raised(
    element: Element, rope: Rope, x: Array, mu: float, lift: float, steps: int
) -> list[Step]:
    """Raise both ends of the cable in steps; p and q minimise the work of each (2.6-1).

    Parameters
    ----------
    element, rope
        Both are changed.
    x
        The seven points at the beginning (7, 3).
    mu
        Coefficient of the penalty.
    lift, steps
        Way of the ends, and number of the steps.
    """
    found, total = [], 0.0
    for _ in range(steps):
        element.begin(x)
        rope.begin(x)
        x = x.copy()
        x[[A, B], 2] += lift / steps

        def work(free: Array, x: Array = x) -> float:
            y = placed(x, free)
            return rope.work(y) + element.work(y) + penalty(y, mu)

        x[[P, Q], 2] += lift / steps / 2
        free = minimize(work, x[[P, Q]].ravel(), jac=lambda q: slope(work, q), tol=1e-7).x
        x = placed(x, free)
        total += work(free)
        element.end(x)
        rope.end(x)
        found.append(Step(rope.tension, x[[A, P, Q, B]], total))
    return found


def placed(x: Array, free: Array) -> Array:
    """All points, with the two that slide."""
    y = x.copy()
    y[[P, Q]] = free.reshape(2, 3)
    return y


def slope(work: Callable[[Array], float], q: Array, h: float = 1e-4) -> Array:
    """Gradient by differences of the fourth order."""
    steps = h * np.eye(len(q))
    near = np.array([work(q + d) - work(q - d) for d in steps])
    far = np.array([work(q + 2 * d) - work(q - 2 * d) for d in steps])
    return np.asarray((8 * near - far) / (12 * h))
