"""A flat annulus whose inner rim is turned in its plane: one-dimensional reference, and meshes.

The sheet wrinkles everywhere along spirals. A point at (R, angle) goes to (r(R), angle + phi(R)),
so that in the axes radius, circumference

    2 E11 = r'^2 + (r phi')^2 - 1,  2 E22 = (r / R)^2 - 1,  2 E12 = r^2 phi' / R,

and W = 2 pi int psi(E) R dR is smallest among all r, phi with the rims' values.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from cabled_square import clamped
from grids import alternating, numbered, triangles
from mpi4py import MPI
from scipy.optimize import minimize_scalar, root
from term_twins import best_angle

from crms_fenicsx import Scene, Solver, Step
from crms_fenicsx.foundation.meshes import MembraneMesh, from_arrays
from crms_fenicsx.model.materials import MembraneMaterial

Array = npt.NDArray[Any]

INNER, OUTER = 40.0, 60.0


def small_twist_torque(Et: float, angle: float) -> float:
    """Torque of the classical tension field, for an angle that tends to 0 (E. Reissner, 1938).

    The tension lines are straight; all of them touch a circle of radius p, for which the torque
    ``4 pi E t angle p^2 / log((b^2 - p^2) / (a^2 - p^2))`` is largest. Of Poisson's ratio it does
    not depend.
    """

    def torque(p: float) -> float:
        return float(4 * np.pi * p**2 / np.log((OUTER**2 - p**2) / (INNER**2 - p**2)))

    best = minimize_scalar(
        lambda p: -torque(p), bounds=(0.0, INNER), method="bounded", options={"xatol": 1e-9}
    )
    return Et * angle * -float(best.fun)


def reference(D: Array, angle: float, degree: int = 16) -> tuple[float, float]:
    """Energy and torque of a wrinkled annulus by Ritz's method with polynomials of the radius.

    Parameters
    ----------
    D
        Stiffness (3, 3) in the axes radius, circumference.
    angle
        By which the inner rim is turned (rad).
    degree
        Of the polynomials; the error shrinks exponentially.
    """
    nodes, weights = np.polynomial.legendre.leggauss(2 * degree)
    R = (INNER + OUTER) / 2 + (OUTER - INNER) / 2 * nodes
    dx = 2 / (OUTER - INNER)
    measure = weights / dx * 2 * np.pi * R
    shapes = [np.polynomial.Legendre.basis(k) * np.polynomial.Polynomial([1, 0, -1]).convert(
        kind=np.polynomial.Legendre) for k in range(degree - 1)]  # fmt: skip
    B, dB = np.array([f(nodes) for f in shapes]), dx * np.array([f.deriv()(nodes) for f in shapes])
    C, size = np.linalg.inv(D), INNER * angle

    def state(c: Array, final: bool = False) -> tuple[Array, ...]:
        first, second = c.reshape(2, -1)
        r, dr = R + size * first @ B, 1 + size * first @ dB
        slope = -angle / (OUTER - INNER) + angle * second @ dB
        e = np.stack([(dr**2 + (r * slope) ** 2 - 1) / 2, ((r / R) ** 2 - 1) / 2, r**2 * slope / R])
        theta = best_angle(C, e.T)
        n = np.stack([np.cos(theta) ** 2, np.sin(theta) ** 2, np.sin(theta) * np.cos(theta)])
        tension = np.sum(n * e, axis=0) / np.einsum("in,ij,jn->n", n, C, n)
        assert tension.min() > 0
        assert not final or np.linalg.det(voigt_matrices(e.T @ D)).max() < 0, "taut somewhere"
        return r, dr, slope, tension * n, e

    def gradient(c: Array) -> Array:
        r, dr, slope, s, _ = state(c)
        by_r = measure * (s[0] * r * slope**2 + s[1] * r / R**2 + 2 * s[2] * r * slope / R)
        by_dr = measure * s[0] * dr
        by_slope = measure * (s[0] * r**2 * slope + s[2] * r**2 / R)
        return np.concatenate([size * (B @ by_r + dB @ by_dr), angle * dB @ by_slope])

    found = root(gradient, np.zeros(2 * len(shapes)), tol=1e-13)
    r, _, slope, s, e = state(found.x, final=True)
    energy = measure @ np.sum(s * e, axis=0) / 2
    assert np.abs(gradient(found.x)).max() < 1e-9 * energy, found.message
    # the same on all radii; the inner rim's turn makes the slope negative
    torque = -measure @ (s[0] * r**2 * slope + s[2] * r**2 / R) / (OUTER - INNER)
    return float(energy), float(torque)


def voigt_matrices(s: Array) -> Array:
    """Stresses (n, 3) as matrices (n, 2, 2)."""
    return s[:, [0, 2, 2, 1]].reshape(-1, 2, 2)


def annulus(comm: MPI.Intracomm, n: int) -> MembraneMesh:
    """Rings of n cells between the rims, 12 n around, cut by diagonals that alternate."""
    radii = np.linspace(INNER, OUTER, n + 1)
    angles = np.linspace(0, 2 * np.pi, 12 * n, endpoint=False)
    r, t = np.meshgrid(radii, angles, indexing="ij")
    points = np.stack([r * np.cos(t), r * np.sin(t)], axis=-1).reshape(-1, 2)
    rings = np.pad(numbered(*r.shape), ((0, 0), (0, 1)), mode="wrap")
    return from_arrays(comm, points, triangles(rings, alternating(n, 12 * n)))


def radial(x: Array) -> Array:
    """Direction of the radius at points (3, n)."""
    direction: Array = np.stack([x[0], x[1], 0 * x[0]])
    return direction


def twisted(
    comm: MPI.Intracomm, n: int, material: MembraneMaterial, angle: float
) -> tuple[Scene, Solver, Step, float]:
    """Solve on a mesh; the scene, its solver, the step and the torque on the inner rim."""
    scene = clamped(annulus(comm, n), material)
    scene.fix(lambda x: np.full(x.shape[1], True), "z")
    X = scene.V.tabulate_dof_coordinates()
    R = np.linalg.norm(X, axis=1)
    turn = angle * (OUTER - R) / (OUTER - INNER)
    c, s = np.cos(turn), np.sin(turn)
    u = scene.u.x.array.reshape(-1, 3)
    u[:, 0] = c * X[:, 0] - s * X[:, 1] - X[:, 0]
    u[:, 1] = s * X[:, 0] + c * X[:, 1] - X[:, 1]
    solver = Solver(scene)
    step = solver.advance()
    middle = (INNER + OUTER) / 2
    rim = solver.reactions(lambda x: np.hypot(x[0], x[1]) < middle)
    torque = np.cross(rim.positions, rim.forces)[:, 2].sum()
    return scene, solver, step, float(comm.allreduce(float(torque)))
