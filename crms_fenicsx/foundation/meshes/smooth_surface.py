"""The smooth surface through the vertices of a triangulation, and lengths of curves on it.

Facets lie inside a curved surface: a path over them is too short by about 0.13 (h / R)^2 of its
length (cell size h, radius R). Here an edge is replaced by the parabola through its vertices that
is orthogonal to the vertex normals, and a curve between two points by an arc.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.triangles import cross, dot, double_areas, mix, norm
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans, Integers

CREASE = np.cos(np.radians(15.0))
"""Cosine of the angle between the normals of a cell and its vertex beyond which the vertex counts
as a crease: half the angle between two faces. On a sphere, cells of half the radius reach it."""
PAIRS = ((0, 1), (1, 2), (2, 0))


@dataclass(frozen=True)
class SmoothSurface:
    """Vertices with normals."""

    points: Array  # (n, 3) positions of the vertices (length)
    # (n, 3) unit normals; zero at boundaries, seams and creases, where the surface is not smooth
    normals: Array

    @classmethod
    def of(cls, points: Array, cells: Integers) -> SmoothSurface:
        """Normals by N. Max (1999), exact on spheres, from the cells around each vertex."""
        sides = points[cells[:, [1, 2, 0]]] - points[cells]  # side k leaves corner k
        areas = double_areas(points[cells])
        square = dot(sides, sides)
        total = np.zeros_like(points)
        for k in range(3):
            share = areas / (square[:, k] * square[:, k - 1])[:, None]
            np.add.at(total, cells[:, k], share)
        size = norm(total)
        normals = total / np.where(size > 0, size, 1.0)[:, None]
        table = EdgeTable.of(cells)
        normals[table.vertices[table.counts != 2].ravel()] = 0.0
        slopes = dot(normals[cells], (areas / norm(areas)[:, None])[:, None])
        normals[cells[slopes < CREASE]] = 0.0
        return cls(points, normals)

    def fitted(self, cells: Integers, vertices: Integers) -> Array:
        """Normals (k, 3) at vertices (k,) of the quadrics through them that fit their neighbours;
        zero where the surface is not smooth. Where the cells around are not symmetric, the mean of
        their normals is off by (h / R)^2, to the same side all over a regular mesh."""
        from scipy.sparse import csr_array

        normals = self.normals[vertices]
        row = np.full(len(self.points), -1)
        row[vertices] = np.where(normals.any(axis=1), np.arange(len(vertices)), -1)
        centre, other = cells[:, [0, 0, 1, 1, 2, 2]].ravel(), cells[:, [1, 2, 0, 2, 0, 1]].ravel()
        near = row[centre] >= 0
        of, ways = row[centre[near]], self.points[other[near]] - self.points[centre[near]]
        count = np.maximum(np.bincount(of, minlength=len(vertices)), 1)
        size = np.maximum(np.bincount(of, norm(ways), len(vertices)) / count, EPSILON)
        ways /= size[of][:, None]
        least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
        first = cross(least, normals)
        first /= np.maximum(norm(first), EPSILON)[:, None]
        second = cross(normals, first)
        x, y, z = (dot(ways, axis[of]) for axis in (first, second, normals))
        terms = np.stack([x, y, x * x, x * y, y * y], axis=1)
        sums = csr_array((np.ones(len(of)), (of, np.arange(len(of)))), (len(vertices), len(of)))
        products = (terms[:, :, None] * terms[:, None, :]).reshape(-1, 25)
        matrix, right = (sums @ products).reshape(-1, 5, 5), sums @ (terms * z[:, None])
        # four neighbours do not determine all terms: the smallest ones then
        found = np.einsum("nij,nj->ni", np.linalg.pinv(matrix, 1e-9, hermitian=True), right)
        normals = normals - found[:, :1] * first - found[:, 1:2] * second
        return normals / np.maximum(norm(normals), EPSILON)[:, None]

    def raised(self, corners: Integers, weights: Array) -> tuple[Array, Array]:
        """Vectors (k, 3) (length) from points on facets to the surface, and unit normals there."""
        x, n = self.points[corners], self.normals[corners]
        height = np.zeros(len(corners))
        for i, j in PAIRS:
            edge = x[:, j] - x[:, i]
            height += weights[:, i] * weights[:, j] * _turns(n[:, i], n[:, j], edge) / 2
        mean = mix(weights, n)
        size = norm(mean)
        unit = mean / np.where(size > 0, size, 1.0)[:, None]
        return height[:, None] * unit, unit


def arc_lengths_on(points: Array, normals: Array, straight: Booleans) -> Array:
    """Arc lengths between points with surface normals (k, 3), (k - 1,); of chords if `straight`."""
    steps = np.diff(points, axis=0)
    chords = norm(steps)
    turns = _turns(normals[:-1], normals[1:], steps) / np.where(chords > 0, chords, 1.0)
    turns = np.where(straight, 0.0, turns)
    return np.asarray(chords * (1 + turns**2 / 24))


def _turns(start: Array, end: Array, steps: Array) -> Array:
    """Turn of the normals along steps, times these; doubled if only one normal is known."""
    known = [np.any(normals != 0.0, axis=-1) for normals in (start, end)]
    turn = dot(end, steps) - dot(start, steps)
    return np.where(known[0] == known[1], turn, 2 * turn)
