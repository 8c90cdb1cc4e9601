"""Triangulated surfaces by formulas, geodesics of the smooth ones, and paths along mesh lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import ConvexHull, Delaunay

from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, SurfacePoint, VertexPoint

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mesh = tuple[Ints, Floats]


def structured(n: int, size: float = 100.0) -> Mesh:
    """A square of n x n squares, all cut by the same diagonal; vertex (i, j) is i (n + 1) + j."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    first = (i * (n + 1) + j).ravel()
    lower = np.stack([first, first + n + 1, first + n + 2], axis=1)
    upper = np.stack([first, first + n + 2, first + 1], axis=1)
    x = np.linspace(0.0, size, n + 1)
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((n + 1, n + 1))], axis=-1)
    return np.concatenate([lower, upper]), points.reshape(-1, 3)


def unstructured(n: int, rng: np.random.Generator, width: float = 100.0) -> Mesh:
    """A rectangle, 100 deep, with about n vertices a side; the inner ones are jittered."""
    x, y = np.linspace(0.0, width, n + 1), np.linspace(0.0, 100.0, n + 1)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    inner = np.all((points > 0) & (points < (width, 100.0)), axis=1)
    shift = rng.uniform(-0.3, 0.3, (inner.sum(), 2)) / n
    points[inner] += shift * (width, 100.0)
    cells = Delaunay(points).simplices.astype(np.int64)
    a, b = points[cells[:, 1]] - points[cells[:, 0]], points[cells[:, 2]] - points[cells[:, 0]]
    flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) < 1e-6 * width * 100.0 / n**2
    return cells[~flat], np.column_stack([points, np.zeros(len(points))])


def sphere(n: int, rng: np.random.Generator) -> Mesh:
    """A unit sphere of n vertices, spread like a sunflower's seeds and jittered."""
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z**2)
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    points += rng.uniform(-0.3, 0.3, points.shape) * np.sqrt(4.0 * np.pi / n)
    points /= np.linalg.norm(points, axis=1)[:, None]
    cells = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = points[cells].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    cells[inward] = cells[inward][:, ::-1]
    return cells, points


def torus(n: int, R: float, r: float, rng: np.random.Generator) -> Mesh:
    """A torus around the z axis, 2 n by n squares cut in two, the vertices jittered."""
    i, j = np.meshgrid(np.arange(2 * n), np.arange(n), indexing="ij")
    u = np.pi * (i + rng.uniform(-0.3, 0.3, i.shape)) / n
    v = 2 * np.pi * (j + rng.uniform(-0.3, 0.3, i.shape)) / n
    out = R + r * np.cos(v)
    points = np.stack([out * np.cos(u), out * np.sin(u), r * np.sin(v)], axis=-1).reshape(-1, 3)
    a, b, c, d = (((i + di) % (2 * n) * n + (j + dj) % n).ravel() for di in (0, 1) for dj in (0, 1))
    return np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)]), points


def mesh_lines(mesh: Mesh) -> csr_matrix:
    """The lengths of the mesh's edges as a graph."""
    cells, points = mesh
    a, b = np.unique(np.sort(cells[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)), axis=0).T
    length = np.linalg.norm(points[b] - points[a], axis=1)
    n = len(points)
    return csr_matrix((np.tile(length, 2), (np.r_[a, b], np.r_[b, a])), shape=(n, n))


def along_mesh_lines(mesh: Mesh, stops: Sequence[int]) -> list[SurfacePoint]:
    """The shortest path along mesh lines from stop to stop."""
    graph = mesh_lines(mesh)
    vertices = [stops[0]]
    for start, end in pairwise(stops):
        before = dijkstra(graph, indices=start, return_predecessors=True)[1]
        leg = [end]
        while leg[-1] != start:
            leg.append(int(before[leg[-1]]))
        vertices += leg[-2::-1]
    return [VertexPoint(vertex) for vertex in vertices]


def nearest(mesh: Mesh, *place: float) -> int:
    """The vertex nearest to a place."""
    return int(np.argmin(np.linalg.norm(mesh[1][:, : len(place)] - place, axis=1)))


def positions(path: Sequence[SurfacePoint], points: Floats) -> Floats:
    """Where the points of a path are, (n, 3)."""
    weights: list[tuple[float, ...]] = [
        p.weights if isinstance(p, CellPoint)
        else (1 - p.fraction, p.fraction) if isinstance(p, EdgePoint) else (1.0,)
        for p in path
    ]  # fmt: skip
    return np.array([w @ points[list(p.support)] for w, p in zip(weights, path, strict=True)])


def length(path: Sequence[SurfacePoint], points: Floats) -> float:
    """Length of the polyline through the points of a path."""
    return float(np.linalg.norm(np.diff(positions(path, points), axis=0), axis=1).sum())


def geodesic_length(
    polyline: Floats,
    gradient: Callable[[Floats], Floats],
    hessian: Callable[[Floats, Floats], Floats],
) -> float:
    """Length of the geodesic of {F = 0} between the ends of a polyline near it, by shooting.

    `gradient(x)` is that of F, `hessian(x, v)` its second derivative along v, v.H(x).v.
    """
    start, end = polyline[0], polyline[-1]
    frame = [np.linalg.svd(gradient(x)[None])[2][1:] for x in (start, end)]
    first = frame[0] @ (polyline[np.argmax(np.linalg.norm(polyline - start, axis=1) > 0.1)] - start)
    guess = np.linalg.norm(np.diff(polyline, axis=0), axis=1).sum()

    def motion(_: float, state: Floats) -> Floats:
        x, v = state[:3], state[3:]
        n = gradient(x)
        return np.concatenate([v, -hessian(x, v) / (n @ n) * n])

    def miss(unknowns: Floats) -> Floats:
        angle, far = unknowns
        v = np.array([np.cos(angle), np.sin(angle)]) @ frame[0]
        way = solve_ivp(motion, (0.0, far), np.r_[start, v], rtol=1e-9, atol=1e-11)
        return frame[1] @ (way.y[:3, -1] - end)

    result = root(miss, [np.arctan2(first[1], first[0]), guess], tol=1e-9)
    assert result.success and np.all(np.abs(result.fun) < 1e-8), result.message
    return float(result.x[1])
