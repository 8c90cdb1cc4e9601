"""Rotation of flat pieces so that the warp lies along x."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.design.patterns.conformal import cell_sides_in_plane
from crms_fenicsx.design.patterns.pieces import Piece
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text

SENSE = np.array([1.0, 1e-3, 1e-6])
"""Sense of the warp in the form where it follows the seams."""


def aligned(piece: Piece, flat: Array, warps: Array | None) -> Array:
    """Flat coordinates (n, 2), rotated so that the mean warp (cells' warps (m, 3) in the form; the
    seams' direction if None) lies along x, and moved to the positive quadrant."""
    turned = _turned(flat, _angle(piece, flat, warps))
    if warps is None:
        x = piece.points[piece.triangles]
        sides = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)
        along = sides @ np.linalg.inv(cell_sides_in_plane(turned, piece.triangles))
        if piece.areas @ along[:, :, 0] @ SENSE < 0.0:
            turned = -turned
    return np.asarray(turned - turned.min(axis=0))


def _turned(flat: Array, angle: float) -> Array:
    z = (flat[:, 0] + 1j * flat[:, 1]) * np.exp(-1j * angle)
    return np.stack([z.real, z.imag], axis=1)


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
    images = (cell_sides_in_plane(flat, piece.triangles) @ within)[..., 0]
    z = images[:, 0] + 1j * images[:, 1]
    if (np.abs(z) <= 1e-6 * norm(warps)).any():
        at = x[int(np.abs(z).argmin())].mean(axis=0)
        raise InputError(
            f"flatten: warp is normal to the surface of {piece.name} near {as_text(at)}; give a "
            "direction that has a part in the surface."
        )
    return float(np.angle(np.sum(piece.areas * z / np.abs(z))))
