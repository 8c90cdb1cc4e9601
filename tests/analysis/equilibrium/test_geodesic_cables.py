"""Cables on surfaces that give way little or not at all are geodesics of these surfaces.

A cable is laid with a detour and tightened until it is just in tension; the lengths of smooth
surfaces' geodesics are exact or integrated.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cabled_square import advanced, clamped, order
from curved_surfaces import geodesic_length
from grids import numbered, triangles
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

Map = Callable[[np.ndarray, np.ndarray], np.ndarray]


def patch(n: int, place: Map) -> tuple[np.ndarray, np.ndarray]:
    """A surface over -1 <= u, v <= 1 in 2 n x 2 n squares cut in two, its vertices jittered."""
    rng = np.random.default_rng(n)
    i, j = np.meshgrid(np.arange(2 * n + 1), np.arange(2 * n + 1), indexing="ij")
    u, v = i / n - 1, j / n - 1
    inner = (np.abs(u) < 1) & (np.abs(v) < 1)
    # the ends of the cables, half-way out, stay where they are
    inner &= ~((np.abs(np.abs(u) - 0.5) < 1e-9) & (np.abs(np.abs(v) - 0.5) < 1e-9))
    for w in (u, v):
        w += inner * rng.uniform(-0.25, 0.25, w.shape) / n
    return place(u.ravel(), v.ravel()), triangles(numbered(*u.shape))


def sphere(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    x = np.stack([0.8 * u, 0.8 * v, np.ones_like(u)], axis=-1)
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def cylinder(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack([1.2 * u, np.sin(v), np.cos(v)], axis=-1)


def ellipsoid(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return sphere(u, v) * [1.5, 1.0, 0.7]


def torus(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Its outer side, on top."""
    out = 2.0 + np.cos(v)
    return np.stack([out * np.sin(0.8 * u), np.sin(v), out * np.cos(0.8 * u)], axis=-1)


def on_ellipsoid(axes: tuple[float, float, float]):
    w = 1 / np.square(axes)
    return lambda x: 2 * w * x, lambda x, v: 2 * float(w @ v**2)


def on_torus(R: float, r: float):
    """F = (rho - R)^2 + y^2 - r^2, rho the distance from the y axis."""

    def gradient(x):
        rho = np.hypot(x[0], x[2])
        share = 2 * (1 - R / rho)
        return np.array([share * x[0], 2 * x[1], share * x[2]])

    def hessian(x, v):
        rho = np.hypot(x[0], x[2])
        along = (x[0] * v[0] + x[2] * v[2]) / rho
        flat = v[0] ** 2 + v[2] ** 2
        return 2 * along**2 + 2 * (1 - R / rho) * (flat - along**2) + 2 * v[1] ** 2

    return gradient, hessian


SURFACES = {
    "sphere": (sphere, on_ellipsoid((1.0, 1.0, 1.0))),
    "cylinder": (cylinder, on_ellipsoid((np.inf, 1.0, 1.0))),
    "ellipsoid": (ellipsoid, on_ellipsoid((1.5, 1.0, 0.7))),
    "torus": (torus, on_torus(2.0, 1.0)),
}


def tightened(comm: MPI.Intracomm, n: int, place: Map, ends: np.ndarray):
    """A rigid surface and a cable on it, laid with a detour and shortened until it is taut."""
    points, cells = patch(n, place)
    mesh = meshes.from_arrays(comm, points, cells)
    scene = Scene(mesh, IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False))
    scene.fix(lambda x: np.full(x.shape[1], True))
    along = np.linspace(0.0, 1.0, 9)[:, None]
    route = ends[0] + along * (ends[1] - ends[0])
    route[1:-1, 1] += 0.3 * np.sin(np.pi * along[1:-1, 0])
    cable = scene.lay_cable(Cable(EA=1.0), place(*route.T), hold="sleeve")
    chord = float(np.linalg.norm(cable.state.positions[0] - cable.state.positions[-1]))
    Solver(scene).advance(L0={cable: chord})
    assert cable.taut
    return scene, cable


@pytest.mark.ranks
@pytest.mark.parametrize("name", SURFACES)
def test_cable_on_a_rigid_surface_is_a_geodesic(comm, name: str) -> None:
    """Jitter scatters the errors, so that the fitted order is that of three sizes roughly."""
    place, (gradient, hessian) = SURFACES[name]
    ends = np.array([(-0.5, -0.5), (0.5, 0.5)])
    sizes, errors = (4, 8, 16), []
    for n in sizes:
        _, cable = tightened(comm, n, place, ends)
        exact = geodesic_length(cable.state.positions, gradient, hessian)
        errors.append(cable.length / exact - 1)
    assert order([1 / n for n in sizes], errors) > 1.75
    assert abs(errors[-1]) < 4e-4
    x = cable.state.positions
    if name == "sphere":  # on the great circle through its ends
        plane = np.cross(x[0], x[-1]) / np.linalg.norm(np.cross(x[0], x[-1]))
        assert np.abs(x @ plane).max() < 0.1 / 16
    if name == "cylinder":  # on the helix through its ends
        angle = np.arctan2(x[:, 1], x[:, 2])
        straight = np.interp(x[:, 0], x[[0, -1], 0], angle[[0, -1]])
        assert np.abs(angle - straight).max() < 0.1 / 16


@pytest.mark.parametrize("name", SURFACES)
def test_cable_on_a_rigid_surface_is_the_geodesic_of_its_cells(comm, name: str) -> None:
    """Against potpourri3d, which shortens by flipping edges of the mesh itself."""
    potpourri3d = pytest.importorskip("potpourri3d")
    place = SURFACES[name][0]
    n = 6
    points, cells = patch(n, place)
    _, cable = tightened(comm, n, place, np.array([(-0.5, -0.5), (0.5, 0.5)]))
    first, last = (int(np.argmin(np.linalg.norm(points - x, axis=1)))
                   for x in cable.state.positions[[0, -1]])  # fmt: skip
    solver = potpourri3d.EdgeFlipGeodesicSolver(points, cells)
    way = solver.find_geodesic_path(first, last)
    length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    assert cable.length == pytest.approx(length, rel=1e-4)


def test_cable_on_a_stiff_inflated_dome_is_a_great_circle(comm) -> None:
    """The fabric stretches by 5e-6, and the cable hardly presses.

    The arc is that over the cable's ends, which lie inside flat cells, below the sphere.
    """
    errors, sizes, R = [], (0.2, 0.1, 0.05), 1.25
    for size in sizes:
        dome = meshes.spherical_cap(comm, 1.0, 0.5, size)
        scene = clamped(dome, IsotropicMembrane(E=1e7, nu=0.3, thickness=0.01))
        solver = advanced(Solver(scene), pressure=1.0)
        cable = scene.lay_cable(Cable(EA=1.0), [(-0.6, -0.3), (0.0, 0.1), (0.6, -0.3)])
        solver.advance(L0={cable: 1.24})
        assert cable.taut
        x = np.add(cable.state.positions, [0.0, 0.0, R - 0.5])  # from the sphere's centre
        a, b = x[[0, -1]] / np.linalg.norm(x[[0, -1]], axis=1)[:, None]
        errors.append(cable.length / (R * float(np.arccos(a @ b))) - 1)
        assert np.abs(x @ np.cross(a, b)).max() < 0.1 * size * np.linalg.norm(np.cross(a, b))
    assert order(sizes, errors) > 1.9
