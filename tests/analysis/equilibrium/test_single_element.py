"""Model 1 of the paper with the default laws, against their equations written by hand.

The twin below is minimised by scipy with derivatives by the complex step. With the paper's own laws
the model is in `test_written_paper`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import minimize, root

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.foundation.runtime.arrays import Array

P_I, P_J, P_K = np.array([0.0, 0.0, 0.0]), np.array([25.0, 60.0, 0.0]), np.array([70.0, 0.0, 0.0])
A, B = np.array([-20.0, 30.0, 0.0]), np.array([90.0, 24.0, 0.0])
EA, E, NU, T = 32000.0, 300.0, 0.25, 0.08
D = T * E / (1 - NU**2) * np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]])


def norm(v: Array) -> complex:
    return np.sqrt(np.sum(v * v))


def angle(u: Array, v: Array) -> complex:
    return np.arccos(np.sum(u * v) / (norm(u) * norm(v)))


def corner(ik: complex, ij: complex, kj: complex) -> tuple[complex, complex]:
    """Place of j: circles about i = (0, 0) and k = (|ik|, 0)."""
    x = (ik**2 + ij**2 - kj**2) / (2 * ik)
    return x, np.sqrt(ij**2 - x**2)


@dataclass
class Total:
    """Green-Lagrange strain of the unfolded triangle, W = EA/(2 L0) (L - L0)^2, weighted
    penalty."""

    L0: float

    def parts(self, x: Array, a: Array, b: Array) -> tuple:
        p, q = x[:3], x[3:]
        length = norm(p - a) + norm(q - p) + norm(b - q)
        xj, yj = corner(
            norm(P_K - P_I), norm(p - P_I) + norm(P_J - p), norm(q - P_K) + norm(P_J - q)
        )
        reference = np.array([[P_K[0], P_J[0]], [0.0, P_J[1]]])
        F = np.array([[P_K[0], xj], [0.0, yj]]) @ np.linalg.inv(reference)
        green = (F.T @ F - np.eye(2)) / 2
        return length, np.array([green[0, 0], green[1, 1], 2 * green[0, 1]])

    def energy(self, x: Array, a: Array, b: Array) -> complex:
        length, e = self.parts(x, a, b)
        area = P_K[0] * P_J[1] / 2
        p, q = x[:3], x[3:]
        w_p = 4 * norm(p - P_I) * norm(P_J - p) / (norm(p - P_I) + norm(P_J - p)) ** 2
        w_q = 4 * norm(q - P_J) * norm(P_K - q) / (norm(q - P_J) + norm(P_K - q)) ** 2
        r_p = angle(P_I - p, q - p) + angle(P_J - p, q - p) - np.pi
        r_q = angle(P_J - q, p - q) + angle(P_K - q, p - q) - np.pi
        bending = 0.1 * E * T * area * ((w_p * r_p) ** 2 + (w_q * r_q) ** 2)
        return EA / (2 * self.L0) * (length - self.L0) ** 2 + 0.5 * e @ D @ e * area + bending


def minimum(energy, x: Array) -> Array:
    """Minimise, then solve for a vanishing gradient (complex step: exact to rounding)."""

    def gradient(x: Array) -> Array:
        steps = 1e-30j * np.eye(6)
        return np.array([energy(x + h).imag / 1e-30 for h in steps])

    x = minimize(lambda x: energy(x).real, x, jac=gradient, method="BFGS", tol=1e-9).x
    solution = root(gradient, x, tol=1e-14)
    assert np.abs(gradient(solution.x)).max() < 1e-8 * EA
    return np.asarray(solution.x)


def scene() -> tuple[Scene, LaidCable]:
    cells, points = [[0, 2, 1]], np.array([P_I, P_J, P_K])
    mesh = meshes.from_arrays(MPI.COMM_SELF, points, cells, point_groups={"corners": [0, 1, 2]})
    scene = Scene(mesh, IsotropicMembrane(E, NU, T, wrinkling=False))
    scene.fix("corners")
    # a sleeve, as the element holds the cable when its ends are moved up, too
    return scene, scene.lay_cable(Cable(EA), [A, B], hold="sleeve")


@pytest.mark.parametrize("sign", [1, -1])
def test_single_element_equals_the_equations(sign: int) -> None:
    built, cable = scene()
    x = cable.state.positions[1:3].ravel().copy()
    twin, solver = Total(norm(B - A)), Solver(built, rtol=1e-12)
    for step in range(1, 4):
        lift = np.array([0.0, 0.0, 3.0 * sign])
        solver.advance(move={cable: lift})
        a, b = A + step * lift, B + step * lift
        x = minimum(lambda x, a=a, b=b: twin.energy(x, a, b), x)
        tension = EA * (twin.parts(x, a, b)[0] / twin.L0 - 1)
        assert cable.tension == pytest.approx(tension, rel=1e-8)
        np.testing.assert_allclose(cable.state.positions[1:3].ravel(), x, rtol=0, atol=1e-8 * 70)
        assert built.energy == pytest.approx(twin.energy(x, a, b), rel=1e-8)
