"""Smoothed Coulomb friction."""

from __future__ import annotations

import math

import numba
import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array


@numba.njit(cache=True, inline="always")
def _potential(y, bound, eps):  # type: ignore[no-untyped-def]
    """Potential of a node at the absolute slip y eps."""
    if y < 1.0:
        return bound * eps * y * y * (1.0 - y / 3.0)
    return bound * eps * (y - 1.0 / 3.0)


@numba.njit(cache=True)
def friction_energy(slip, bound, eps, force):  # type: ignore[no-untyped-def]
    """Potential of all nodes; its derivatives by their slips into `force` (n,)."""
    energy = 0.0
    for k in range(slip.shape[0]):
        y = abs(slip[k]) / eps[k]
        energy += _potential(y, bound[k], eps[k])
        force[k] = math.copysign(bound[k] * y * (2.0 - y) if y < 1.0 else bound[k], slip[k])
    return energy


@numba.njit(cache=True)
def friction_potentials(slip, bound, eps):  # type: ignore[no-untyped-def]
    """Potential of each node, (n,) (force x length)."""
    potentials = np.empty(slip.shape[0])
    for k in range(slip.shape[0]):
        potentials[k] = _potential(abs(slip[k]) / eps[k], bound[k], eps[k])
    return potentials


def coulomb_forces(slip: Array, bound: Array, eps: Array) -> Array:
    """Friction force of each node, (n,) (force)."""
    y = np.minimum(np.abs(slip) / eps, 1.0)
    return np.asarray(np.copysign(bound * y * (2.0 - y), slip))


def stored_and_lost(slip: Array, bound: Array, eps: Array, elastic: Array) -> tuple[float, float]:
    """Elastically stored and dissipated friction energy (force x length); all arguments (n,)."""
    force = np.abs(coulomb_forces(slip, bound, eps))
    back = np.minimum(np.abs(slip), elastic)
    y = np.minimum(back / eps, 1.0)
    return float(np.sum(force * back * (1.0 - y / 3.0) / (2.0 - y))), float(
        np.sum(force * (np.abs(slip) - back))
    )


def secant_stiffness(slip: Array, bound: Array, eps: Array) -> Array:
    """Secant stiffness ``force / slip`` of nodes, (n,) (force/length). Its parabola touches the
    potential and lies above it elsewhere; the tangent would vanish beyond eps."""
    y = np.abs(slip) / eps
    return np.asarray(bound / eps * np.where(y < 1.0, 2.0 - y, 1.0 / np.maximum(y, 1.0)))


def tangent_stiffness(slip: Array, bound: Array, eps: Array) -> Array:
    """Second derivatives of the potentials by the slips, (n,) (force/length)."""
    return np.asarray(2 * bound / eps * np.maximum(1 - np.abs(slip) / eps, 0.0))
