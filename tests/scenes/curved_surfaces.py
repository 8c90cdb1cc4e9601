"""Triangulated surfaces by formulas or from arrays, geodesics of the smooth ones, and paths along
mesh lines."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from itertools import pairwise

import numpy as np
from grids import grid, numbered, triangles
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import ConvexHull, Delaunay

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    Edge,
    EdgePoint,
    SurfacePoint,
    VertexPoint,
)
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells, Ring, ring_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mesh = tuple[Ints, Floats]


def structured(n: int, size: float = 100.0) -> Mesh:
    """A square of n x n squares, all cut by the same diagonal; vertex (i, j) is i (n + 1) + j."""
    x = np.linspace(0.0, size, n + 1)
    points, cells = grid(x, x)
    return cells, points


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
    return triangles(np.pad(numbered(2 * n, n), (0, 1), mode="wrap")), points


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


class ArraySurface:
    """A surface from arrays; its edges are straight where no other length is given.

    Parameters
    ----------
    cells
        (m, 3) vertex ids.
    points
        (n, 3) or (n, 2) positions (length); a vertex's id is its row.
    lengths
        Lengths of edges (a, b), a < b, that are not straight.
    complete
        Vertices around which all cells are given; None for all.

    Raises
    ------
    InputError
        Arrays of other shapes, or ids that are no rows of `points`.
    """

    def __init__(
        self,
        cells: ArrayLike,
        points: ArrayLike,
        lengths: Mapping[Edge, float] | None = None,
        complete: Container[int] | None = None,
    ) -> None:
        self._cells = np.asarray(cells, dtype=np.int64)
        self._points = np.asarray(points, dtype=np.float64)
        for name, array, columns in (
            ("cells", self._cells, (3,)),
            ("points", self._points, (2, 3)),
        ):
            if array.ndim != 2 or array.shape[1] not in columns:
                raise InputError(
                    f"{name} of a surface have shape {array.shape}; give one row for each, of "
                    f"{' or '.join(map(str, columns))} numbers."
                )
        if self._cells.size and not 0 <= self._cells.min() <= self._cells.max() < len(self._points):
            raise InputError(
                f"cells of a surface use ids from {self._cells.min()} to {self._cells.max()}; "
                f"give rows of the {len(self._points)} points."
            )
        self._lengths = {} if lengths is None else lengths
        self._complete = complete
        corners = self._cells.ravel()
        self._order = np.argsort(corners, kind="stable") // 3
        self._start = np.searchsorted(np.sort(corners), np.arange(len(self._points) + 1))
        self._rings: dict[int, Ring] = {}

    def length(self, edge: Edge) -> float:
        """Return the length of an edge; see `Surface.length`."""
        given = self._lengths.get(edge)
        if given is not None:
            return float(given)
        return float(np.linalg.norm(self._points[edge[1]] - self._points[edge[0]]))

    def opposite_vertices(self, edge: Edge) -> tuple[int, ...]:
        """Return the vertices opposite to an edge; see `Surface.opposite_vertices`."""
        a, b = edge
        return tuple(next(v for v in pair if v != b) for pair in self._link(a) if b in pair)

    def ring(self, vertex: int) -> Ring:
        """Return the neighbours of a vertex in order; see `Surface.ring`.

        Raises
        ------
        MissingCells
            Not all cells around it are given.
        MeshError
            They do not form one fan.
        """
        if self._complete is not None and vertex not in self._complete:
            raise MissingCells([vertex])
        if vertex not in self._rings:
            self._rings[vertex] = ring_of(vertex, self._link(vertex))
        return self._rings[vertex]

    def _link(self, vertex: int) -> list[Edge]:
        """Return the sides opposite to a vertex in its cells."""
        if not 0 <= vertex < len(self._points):
            return []
        rows = self._order[self._start[vertex] : self._start[vertex + 1]]
        corners = self._cells[rows]
        others = corners[corners != vertex].reshape(-1, 2)
        return list(zip(others[:, 0].tolist(), others[:, 1].tolist(), strict=True))
