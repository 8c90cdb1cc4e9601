"""Outlines of flat membranes: simple polygons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.runtime.errors import MeshError


def simple_outline(corners: Sequence[Sequence[float]]) -> Array:
    """Return the corners of a simple polygon, shape (n, 2), in the given order."""
    try:
        outline = np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError):
        outline = np.empty(0)
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise MeshError(f"the polygon's corners are {corners!r}: give three or more points (x, y)")
    if not np.isfinite(outline).all():
        raise MeshError(f"the polygon's corners {corners!r} are not all finite")
    following = np.roll(outline, -1, axis=0)
    along = following - outline
    bad = np.flatnonzero((along == 0).all(axis=1))
    if len(bad):
        raise MeshError(
            f"side {bad[0] + 1} of the polygon has no length, from and to "
            f"{tuple(outline[bad[0]].tolist())}: give every corner once"
        )
    i, j = np.triu_indices(len(outline), k=1)
    adjacent = (j == i + 1) | ((i == 0) & (j == len(outline) - 1))
    crossing = np.where(
        adjacent,
        _folds_back(along[i], along[j]),
        _meet(outline[i], following[i], outline[j], following[j]),
    )
    bad = np.flatnonzero(crossing)
    if len(bad):
        raise MeshError(
            f"sides {i[bad[0]] + 1} and {j[bad[0]] + 1} of the polygon intersect or touch: give "
            "the corners in their order around it"
        )
    return outline


def _cross(u: Array, v: Array) -> Array:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _folds_back(u: Array, v: Array) -> Booleans:
    back = (_cross(u, v) == 0) & (np.einsum("ij,ij->i", u, v) < 0)
    return np.asarray(back, dtype=np.bool_)


def _meet(
    a: Array,
    b: Array,
    c: Array,
    d: Array,
) -> Booleans:
    """Tell which segments a-b and c-d have a point in common."""
    apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
    c_d_sides = _cross(b - a, c - a) * _cross(b - a, d - a)
    a_b_sides = _cross(d - c, a - c) * _cross(d - c, b - c)
    return ~apart.any(axis=1) & (c_d_sides <= 0) & (a_b_sides <= 0)
