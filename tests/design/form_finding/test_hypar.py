"""A hypar with edge cables against polynomial surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import SIDES, order, sail
from mpi4py import MPI
from numpy.polynomial import legendre
from scipy.optimize import minimize


def polynomial_form(degree: int, stress: float, tension: float) -> tuple[float, float, float]:
    """Area of the film, length and mean sag of an edge: the least of area times section force and
    length times tension of all surfaces that are polynomials of a degree in both parameters."""
    points, weights = legendre.leggauss(4 * degree)
    P = legendre.legvander(points, degree)
    slopes = np.stack([legendre.legval(points, legendre.legder(e)) for e in np.eye(degree + 1)], 1)
    ends, ones = np.stack([1 - points, 1 + points], 1) / 2, np.ones((len(points), 1))
    B = np.concatenate([ends, P[:, 2:] - P[:, :-2]], axis=1)  # all but the first two vanish at ends
    D = np.concatenate([-ones / 2, ones / 2, slopes[:, 2:] - slopes[:, :-2]], axis=1)
    places = np.zeros((degree + 1, degree + 1, 3))
    places[:2, :2] = [[(0, 0, 3), (0, 10, 0)], [(10, 0, 0), (10, 10, 3)]]
    free = np.ones(places.shape[:2], dtype=bool)
    free[:2, :2] = False
    edges = [(0, slice(None)), (1, slice(None)), (slice(None), 0), (slice(None), 1)]
    area = length = 0.0

    def energy(values: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal area, length
        places[free] = values.reshape(-1, 3)
        a, b = np.einsum("ai,bj,ijd->abd", D, B, places), np.einsum("ai,bj,ijd->abd", B, D, places)
        normals = np.cross(a, b)
        sizes = np.linalg.norm(normals, axis=-1)
        area = float(weights @ sizes @ weights)
        normals *= (np.outer(weights, weights) / sizes)[..., None]
        slope = np.einsum("ai,bj,abd->ijd", D, B, np.cross(b, normals))
        slope = stress * (slope + np.einsum("ai,bj,abd->ijd", B, D, np.cross(normals, a)))
        total = stress * area
        for edge in edges:
            t = D @ places[edge]
            sizes = np.linalg.norm(t, axis=1)
            length = float(weights @ sizes)
            slope[edge] += tension * D.T @ (t * (weights / sizes)[:, None])
            total += tension * length
        return total, slope[free].ravel()

    exact = {"ftol": 1e-15, "gtol": 1e-8, "maxiter": 5000, "maxfun": 5000}
    minimize(energy, places[free].ravel(), jac=True, method="L-BFGS-B", options=exact)
    points = np.linspace(-1.0, 1.0, 2001)
    P = legendre.legvander(points, degree)
    ends = np.stack([1 - points, 1 + points], 1) / 2
    path = np.concatenate([ends, P[:, 2:] - P[:, :-2]], axis=1) @ places[:, 0]
    return area, length, sag(path)


def sag(path: np.ndarray) -> float:
    """Mean distance of a line from its chord."""
    chord = path[-1] - path[0]
    along = (path - path[0]) @ chord / (chord @ chord)
    away = np.linalg.norm(path - path[0] - along[:, None] * chord, axis=1)
    return float(np.sum((away[1:] + away[:-1]) / 2 * np.diff(along)))


def test_hypar(comm: MPI.Intracomm) -> None:
    """Area, length and sag of an edge converge to those of smooth surfaces, with second order."""
    exact = comm.bcast(polynomial_form(6, 2.0, 25.0) if comm.rank == 0 else None)
    sizes, found = (2.0, 1.0, 0.5), []
    for size in sizes:
        form = sail(comm, size, lift=3.0, tension=25.0)
        edge = form.cables[0]
        found.append([form.area, edge.length, sag(edge.path)])
        for own in SIDES:
            assert form.tensions[own] == 25.0
    assert exact[:2] == pytest.approx((71.319078, 10.7650228), rel=1e-7)  # of degree 12
    best = (4 * np.array(found[2]) - np.array(found[1])) / 3
    np.testing.assert_allclose(best, exact, rtol=3e-5)
    for values, limit in zip(np.transpose(found), exact, strict=True):
        assert order(sizes, values - limit) > 1.95
        assert abs(values[-1] / limit - 1) < 3e-3
