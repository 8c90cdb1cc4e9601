"""Slow, readable twins of the membrane's strain and stress laws."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from crms_fenicsx.model.materials import LINEAR, MembraneMaterial

Array = npt.NDArray[Any]


def energy_at_angle(C: Array, e: Array, angle: Array, both: bool = True) -> Array:
    """Largest ``sigma : E - 1/2 sigma : C : sigma`` of tensile stresses with principal axes at an
    angle to axis 1, of uniaxial ones only unless both may act; C the compliance (3, 3), e strains
    (..., 3) as (E11, E22, 2 E12)."""
    c, s = np.cos(angle), np.sin(angle)
    first = np.stack([c * c, s * s, c * s], axis=-1)  # n n, what a unit principal stress is
    second = np.stack([s * s, c * c, -c * s], axis=-1)
    e1, e2 = np.sum(first * e, axis=-1), np.sum(second * e, axis=-1)
    c11 = np.einsum("...i,ij,...j", first, C, first)
    c22 = np.einsum("...i,ij,...j", second, C, second)
    c12 = np.einsum("...i,ij,...j", first, C, second)
    if not both:
        alone: Array = np.maximum(e1, 0) ** 2 / (2 * c11)
        return alone
    determinant = c11 * c22 - c12**2
    s1, s2 = (c22 * e1 - c12 * e2) / determinant, (c11 * e2 - c12 * e1) / determinant
    biaxial = np.where((s1 >= 0) & (s2 >= 0), (s1 * e1 + s2 * e2) / 2, 0.0)
    one = np.maximum(e1, 0) ** 2 / (2 * c11)
    other = np.maximum(e2, 0) ** 2 / (2 * c22)
    best: Array = np.maximum(np.maximum(biaxial, one), other)
    return best


def best_angle(C: Array, e: Array, n: int = 361) -> Array:
    """Angle to axis 1 of the uniaxial stress with the largest ``(n E n)^2 / (2 n n : C : n n)``,
    by search and bisection for where the slope over the angle vanishes, (...)."""

    def rises(angle: Array) -> Array:
        c, s = np.cos(angle), np.sin(angle)
        nn = np.stack([c * c, s * s, c * s], axis=-1)
        slope = np.stack([-2 * c * s, 2 * c * s, c * c - s * s], axis=-1)
        along = np.sum(nn * e, axis=-1) * np.einsum("...i,ij,...j", slope, C, nn)
        return np.sum(slope * e, axis=-1) * np.einsum("...i,ij,...j", nn, C, nn) > along

    grid = np.linspace(0, np.pi, n)
    best = grid[np.argmax(energy_at_angle(C, e[..., None, :], grid, both=False), axis=-1)]
    low, high = best - grid[1], best + grid[1]
    for _ in range(60):
        middle = (low + high) / 2
        rising = rises(middle)
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    angle: Array = (low + high) / 2
    return angle


def relaxed_energy(D: Array, e: Array, n: int = 721) -> Array:
    """Energy of a membrane without compression, by search over all directions of stress, (...)."""
    C = np.linalg.inv(D)
    grid = np.linspace(0, np.pi / 2, n)
    best = grid[np.argmax(energy_at_angle(C, e[..., None, :], grid), axis=-1)]
    low, high = best - grid[1], best + grid[1]
    for _ in range(50):  # the maximum's neighbourhood, thirds dropped again and again
        a, b = low + (high - low) / 3, high - (high - low) / 3
        rising = energy_at_angle(C, e, a) < energy_at_angle(C, e, b)
        low, high = np.where(rising, a, low), np.where(rising, high, b)
    return energy_at_angle(C, e, (low + high) / 2)


def density(material: MembraneMaterial, e: Array) -> Array:
    """Energy per stress-free area at strains (..., 3), zero at zero strain."""
    D, s0 = material.stiffness, material.prestress_vector
    if material.law != LINEAR:
        e0 = np.linalg.inv(D) @ s0
        return relaxed_energy(D, e + e0) - e0 @ D @ e0 / 2
    linear: Array = e @ s0 + np.einsum("...i,ij,...j", e, D, e) / 2
    return linear


def axes_of(corners: Array, warp: Array | None = None) -> Array:
    """In-plane unit axes (2, 3) of a triangle, the first along the projected warp."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    first = corners[1] - corners[0] if warp is None else np.asarray(warp, dtype=float)
    first = first - (first @ normal) * normal
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def strain(stress_free: Array, current: Array, axes: Array) -> Array:
    """(E11, E22, 2 E12) of a triangle, E = (F^T F - 1) / 2, from its corners (3, 3)."""
    edges = axes @ (stress_free[1:] - stress_free[0]).T
    F = (current[1:] - current[0]).T @ np.linalg.inv(edges)
    E = (F.T @ F - np.eye(2)) / 2
    return np.array([E[0, 0], E[1, 1], 2 * E[0, 1]])


def area(corners: Array) -> float:
    """Area of a triangle."""
    return float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) / 2)


def unfolded(ij: float, jk: float, ik: float) -> Array:
    """Triangle with these sides in a plane, corners (3, 3): i at the origin, k on the x axis, j
    where the circles about them intersect, as in (2.3-4 ... 2.3-7)."""
    x = (ij**2 + ik**2 - jk**2) / (2 * ik)
    return np.array([[0, 0, 0], [x, np.sqrt(ij**2 - x**2), 0], [ik, 0, 0]])
