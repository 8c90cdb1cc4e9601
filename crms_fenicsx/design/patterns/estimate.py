"""Estimates of the distortion of pieces, before flattening."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from crms_fenicsx.design.patterns.alignment import aligned
from crms_fenicsx.design.patterns.compensation import warp_moduli
from crms_fenicsx.design.patterns.conformal import conformal
from crms_fenicsx.design.patterns.pattern import CutOptions, Materials, Warp, of_cells
from crms_fenicsx.design.patterns.pieces import Pieces
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, collective, raised_together

STATIONS = 64
"""Number of sections at which a piece's width is measured."""


@dataclass(frozen=True)
class Estimate:
    """Estimate of the distortion of a flat piece.

    Attributes
    ----------
    width
        Largest width across the warp (length).
    curvature
        Mean Gaussian curvature (1 / length squared).
    strain
        Largest strain, ``|K| W**2 / 12``.
    energy
        Energy per area, ``E t K**2 W**4 / 1440`` with E t along the warp and the mean of W**4 over
        the piece (force per length).
    """

    width: float
    curvature: float
    strain: float
    energy: float


@collective
def estimates(
    pieces: Pieces, material: Materials, *, warp: Warp | None = None
) -> dict[str, Estimate]:
    """Estimate the strains of pieces before they are laid flat. Collective.

    Parameters
    ----------
    pieces
        Pieces from `cut`.
    material, warp
        As of `flatten`.

    Returns
    -------
    dict of str to Estimate
        Estimates by names of pieces.

    Raises
    ------
    InputError
        On all ranks: invalid arguments.

    Examples
    --------
    >>> {name: one.strain for name, one in patterns.estimates(pieces, fabric).items()}
    """
    if not isinstance(pieces, Pieces):
        raise InputError(f"estimates: pieces = {pieces!r}; give what patterns.cut returned.")
    checks.same(pieces.comm, "estimates", material=material, warp=warp)
    stiffness, warps = of_cells(pieces, material, CutOptions(warp))
    found = {}
    with raised_together(pieces.comm):
        for piece in pieces.pieces:
            own = None if warps is None else warps[piece.cells]
            flat = aligned(piece, conformal(piece.points, piece.triangles), own)
            widths, K = _widths(flat[piece.outline]), piece.curvature
            modulus = float(piece.areas @ warp_moduli(stiffness[piece.cells])) / piece.area
            fourth = float(np.sum(widths**5) / np.sum(widths))
            widest = float(widths.max())
            found[piece.name] = Estimate(
                widest, K, abs(K) * widest**2 / 12.0, modulus * K**2 * fourth / 1440.0
            )
    return found


def _widths(outline: Array) -> Array:
    """Widths (STATIONS,) of a closed outline (n, 2) at equidistant sections across x."""
    low, high = outline[:, 0].min(), outline[:, 0].max()
    stations = low + (high - low) * (np.arange(STATIONS) + 0.5) / STATIONS
    least, most = np.full(STATIONS, np.inf), np.full(STATIONS, -np.inf)
    for a, b in pairwise(np.concatenate([outline, outline[:1]])):
        within = (stations - a[0]) * (stations - b[0]) <= 0.0
        if a[0] == b[0] or not within.any():
            continue
        y = a[1] + (stations[within] - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
        least[within], most[within] = np.minimum(least[within], y), np.maximum(most[within], y)
    return most - least
