"""Start of flattening: conformal maps of pieces to the plane, turned so that warp lies along x."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from crms_fenicsx.design.patterns.pieces import Piece
from crms_fenicsx.foundation.meshes.triangles import cross, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, as_text


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
    sides = sides_of(flat, triangles)
    return np.asarray(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])


def sides_of(points: Array, triangles: Integers) -> Array:
    """Two side vectors of each triangle as columns, (m, d, 2), from points (n, d)."""
    x = points[triangles]
    return np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)


def aligned(piece: Piece, flat: Array, warps: Array | None) -> Array:
    """Flat coordinates (n, 2), rotated so that the mean warp (cells' warps (m, 3) in the form; the
    seams' direction if None) lies along x, and moved to the positive quadrant."""
    z = (flat[:, 0] + 1j * flat[:, 1]) * np.exp(-1j * _angle(piece, flat, warps))
    turned: Array = np.stack([z.real, z.imag], axis=1)
    if warps is None:
        # along seams, the warp runs in the sense of x, or else of y, or z
        if piece.areas @ gradients(piece, turned)[:, :, 0] @ (1.0, 1e-3, 1e-6) < 0.0:
            turned = -turned
    return np.asarray(turned - turned.min(axis=0))


def gradients(piece: Piece, flat: Array) -> Array:
    """Deformation gradients (m, 3, 2) of a piece's cells from its flat coordinates (n, 2)."""
    sides = sides_of(piece.points, piece.triangles)
    return np.asarray(sides @ np.linalg.inv(sides_of(flat, piece.triangles)))


def _angle(piece: Piece, flat: Array, warps: Array | None) -> float:
    """Mean angle between warp and x."""
    if warps is None:
        runs = [flat[edge.vertices] for edge in piece.edges if edge.sewn]
        lines = np.concatenate([np.diff(run, axis=0) for run in runs or [flat[piece.outline]]])
        z = lines[:, 0] + 1j * lines[:, 1]
        return float(np.angle(np.sum(z**2 / np.abs(z)))) / 2
    x = piece.points[piece.triangles]
    sides = x[:, 1:] - x[:, :1]
    within = np.linalg.solve(
        sides @ np.swapaxes(sides, 1, 2), np.einsum("nki,ni->nk", sides, warps)[..., None]
    )
    images = (sides_of(flat, piece.triangles) @ within)[..., 0]
    z = images[:, 0] + 1j * images[:, 1]
    if (np.abs(z) <= 1e-6 * norm(warps)).any():
        at = x[int(np.abs(z).argmin())].mean(axis=0)
        raise InputError(
            f"flatten: warp is normal to the surface of {piece.name} near {as_text(at)}."
        )
    return float(np.angle(np.sum(piece.areas * z / np.abs(z))))
