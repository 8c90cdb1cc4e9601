"""Conformal maps of pieces to the plane: the initial shapes for flattening."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from crms_fenicsx.foundation.meshes.triangles import cross, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers


def conformal(points: Array, triangles: Integers) -> Array:
    """Flat coordinates (n, 2) of a disc's vertices (n, 3) by the least-squares conformal map,
    scaled to the disc's area (B. Levy et al., ACM Trans. Graph. 21, 2002)."""
    x = points[triangles]
    p, q = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    length, double_area = norm(p), norm(cross(p, q))
    third = (np.einsum("ni,ni->n", p, q) + 1j * double_area) / length
    z = np.stack([0j * length, length + 0j, third], axis=1)
    weights = (np.roll(z, -2, axis=1) - np.roll(z, -1, axis=1)) / np.sqrt(double_area)[:, None]
    m, n = len(triangles), len(points)
    rows = np.repeat(np.arange(m), 3)
    M = csr_matrix((weights.ravel(), (rows, triangles.ravel())), shape=(m, n))
    first = int(np.argmax(norm(points - points.mean(axis=0))))
    pinned = np.array([first, int(np.argmax(norm(points - points[first])))])
    free = np.setdiff1d(np.arange(n), pinned)
    flat = np.zeros(n, dtype=complex)
    flat[pinned] = 0.0, norm(points[pinned[1]] - points[first])
    own = M[:, free]
    normal = (own.conj().T @ own).tocsc()
    flat[free] = splu(normal).solve(-(own.conj().T @ (M @ flat)))
    found = np.stack([flat.real, flat.imag], axis=1)
    return np.asarray(
        found * np.sqrt(double_area.sum() / double_areas_in_plane(found, triangles).sum())
    )


def double_areas_in_plane(flat: Array, triangles: Integers) -> Array:
    """Twice the signed areas (m,) of plane triangles, positive if counter-clockwise."""
    sides = cell_sides_in_plane(flat, triangles)
    return np.asarray(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])


def cell_sides_in_plane(flat: Array, triangles: Integers) -> Array:
    """Two side vectors of each plane triangle as columns, (m, 2, 2)."""
    x = flat[triangles]
    return np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)
