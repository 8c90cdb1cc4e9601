"""Flat round membranes under pressure: meshes, and an ordinary differential equation beside them.

The meridian of a pressurised disk of revolution, with the stretches l1 along it and l2 around it as
functions of the stress-free radius, obeys

    d(rho P1 cos(slope))/d rho = P2 - p r l1 sin(slope)
    d(rho P1 sin(slope))/d rho = p r l1 cos(slope)

where P1, P2 are the section forces per stress-free width and p the pressure. It shares no code with
the package.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import lambertw

from crms_fenicsx import Scene, Solver, meshes
from crms_fenicsx.design.study import convergence
from crms_fenicsx.design.study.convergence import Convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.materials import MembraneMaterial
from validation.table import COMM

Array = NDArray[np.float64]
Law = Callable[[float, float], tuple[float, float]]
"""Section forces P1, P2 from the stretches."""


def disk(radius: float, rings: int) -> MembraneMesh:
    """Mesh of a disk with a vertex in its centre; its k-th ring has 6 k vertices."""
    points: list[Array] = [np.zeros((1, 2))]
    for k in range(1, rings + 1):
        turn = 2 * np.pi * np.arange(6 * k) / (6 * k)
        points.append(radius * k / rings * np.column_stack([np.cos(turn), np.sin(turn)]))
    first = np.cumsum([0, *map(len, points)])
    cells = []
    for k in range(1, rings + 1):
        for side in range(6):
            outer = first[k] + (side * k + np.arange(k + 1)) % (6 * k)
            inner = first[k - 1] + (side * (k - 1) + np.arange(k)) % max(1, 6 * (k - 1))
            cells += [(inner[i], outer[i], outer[i + 1]) for i in range(k)]
            cells += [(inner[i], outer[i + 1], inner[i + 1]) for i in range(k - 1)]
    return meshes.from_arrays(COMM, np.vstack(points), cells)


def to_rim(radius: float, rings: int) -> Callable[[Array], Array]:
    """Moves new vertices (3, n) on the rim of `disk` to the circle, and leaves all others."""

    def project(points: Array) -> Array:
        r = np.linalg.norm(points, axis=0)
        rim = r > radius * (1 - 0.15 / rings**2)
        return np.asarray(points * np.where(rim, radius / np.where(rim, r, 1.0), 1.0))

    return project


def inflated(
    mesh: MembraneMesh, material: MembraneMaterial, pressure: float, steps: int = 1
) -> Solver:
    """A disk that is held along its rim, under pressure."""
    scene = Scene(mesh, material)
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance(pressure=pressure, steps=steps)
    return solver


def rise(solver: Solver) -> float:
    """Height of the centre."""
    return float(solver.scene.positions()[:, 2].max())


def limit(
    build: Callable[[MembraneMesh], Solver],
    radius: float,
    rings: int = 4,
    levels: int = 3,
    quantities: dict[str, Callable[[Solver], float]] | None = None,
) -> Convergence:
    """Results of a disk on finer and finer meshes."""
    return convergence(
        build, disk(radius, rings), levels, quantities=quantities or {"rise": rise},
        project=to_rim(radius, rings),
    )  # fmt: skip


def saint_venant(Et: float, nu: float) -> Law:
    """St. Venant-Kirchhoff in plane stress."""

    def law(l1: float, l2: float) -> tuple[float, float]:
        E1, E2 = (l1**2 - 1) / 2, (l2**2 - 1) / 2
        s = Et / (1 - nu**2)
        return l1 * s * (E1 + nu * E2), l2 * s * (E2 + nu * E1)

    return law


def neo_hooke(E: float, nu: float, thickness: float) -> Law:
    """Compressible, mu/2 (I1 - 3 - 2 ln J) + lame/2 (ln J)^2, in plane stress."""
    mu, lame = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))

    def law(l1: float, l2: float) -> tuple[float, float]:
        plane = (l1 * l2) ** 2
        ratio = 2 * mu / lame
        thin = lambertw(ratio / plane * np.exp(ratio)).real / ratio
        bulk = lame * np.log(plane * thin) / 2
        P1, P2 = (thickness * (mu * (x - 1 / x) + bulk / x) for x in (l1, l2))
        return P1, P2

    return law


def meridian(law: Law, radius: float, pressure: float, stretch: float, n: int = 201) -> Array:
    """From the centre, where both stretches are given: rows of rho, r, z, force P1."""
    rho = np.linspace(1e-6 * radius, radius, n)

    def l1_of(P: float, l2: float) -> float:
        return float(brentq(lambda l1: law(l1, l2)[0] - P, 0.2, 20.0, xtol=1e-12))

    def motion(at: float, state: Array) -> list[float]:
        r, _, *force = state
        whole = float(np.hypot(*force))
        cosine, sine = force[0] / whole, force[1] / whole
        l1, l2 = l1_of(whole / at, r / at), r / at
        push = pressure * r * l1
        return [l1 * cosine, -l1 * sine, law(l1, l2)[1] - push * sine, push * cosine]

    start = [stretch * rho[0], 0.0, rho[0] * law(stretch, stretch)[0], 0.0]
    way = solve_ivp(motion, (rho[0], radius), start, t_eval=rho, rtol=1e-10, atol=1e-12 * radius)
    rho = rho[: way.y.shape[1]]  # fewer where it has curled up
    return np.column_stack([rho, way.y[0], way.y[1], np.hypot(*way.y[2:]) / rho])


def by_ode(law: Law, radius: float, pressure: float, most: float) -> Array:
    """The meridian of a disk whose rim is held at z = 0, its centre stretched by less than `most`.

    With little stretch in its centre a meridian curls up short of the rim; with much it goes on.
    """

    def gap(stretch: float) -> float:
        found = meridian(law, radius, pressure, stretch, 2)
        return float(found[-1, 1]) - radius if len(found) == 2 else -radius

    less = most
    while gap(less) > 0:
        most, less = less, 1 + (less - 1) * 0.95
    found = meridian(law, radius, pressure, float(brentq(gap, less, most, xtol=1e-13)))
    found[:, 2] -= found[-1, 2]
    return found
