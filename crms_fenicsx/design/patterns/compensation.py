"""Compensation: how much shorter than the form the fabric is cut, to be stretched into it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.materials import UFL_LAW, MembraneMaterial

MOST = 0.5
"""Bound of the compensation, as a fraction: a larger one is an input error."""

Profile = float | Sequence[tuple[float, float]]
"""A number, or pairs of position along a piece (0 at its start, 1 at its end) and number."""


@dataclass(frozen=True)
class Shrink:
    """Compensation of a piece: shares by which it is cut shorter along warp and weft.

    Parameters
    ----------
    warp, weft
        Shares, .01 for 1 %: a number, or pairs of place and share, linear between them, with places
        from 0 to 1 along the warp of the piece.

    Raises
    ------
    InputError
        A share of 50 % or more, or places that do not ascend.

    Examples
    --------
    >>> weft = [(0.0, 0.0), (0.2, 0.012), (0.8, 0.012), (1.0, 0.0)]
    >>> shrink = patterns.Shrink(warp=0.008, weft=weft)
    """

    warp: Profile = 0.0
    weft: Profile = 0.0

    def __post_init__(self) -> None:
        for name in ("warp", "weft"):
            given = getattr(self, name)
            stations = _stations(f"Shrink: {name}", given)
            for _, part in stations:
                _check_part(f"Shrink: {name}", part)
            if any(b[0] <= a[0] for a, b in pairwise(stations)):
                raise InputError(f"Shrink: the places of {name} = {given!r} must ascend.")

    def at(self, places: Array) -> Array:
        """Compensations along warp and weft at positions along a piece, (n, 2)."""
        found = [np.array(_stations("", given)) for given in (self.warp, self.weft)]
        return np.stack([np.interp(places, *one.T) for one in found], axis=1)


def _stations(what: str, given: object) -> list[tuple[float, float]]:
    if not isinstance(given, Sequence) or isinstance(given, str):
        return [(0.0, checks.finite(what, given))]
    try:
        return [(checks.finite(what, s), checks.finite(what, part)) for s, part in given]
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{what} = {given!r}, expected a number, or pairs of place and part."
        ) from None


def _check_part(what: str, value: object) -> None:
    part = checks.finite(what, value)
    if not -MOST < part < MOST:
        raise InputError(
            f"{what} = {part:g}: fabric is never cut {part:.0%} shorter than its form; use less "
            f"than {MOST:.0%}, .01 for 1 %."
        )


@checked
@dataclass(frozen=True)
class EdgeShrink:
    """De-compensation of an edge, along itself, in place of the piece's compensation.

    Parameters
    ----------
    part
        Share by which the edge is cut shorter; 0 along a clamping profile, which cannot stretch.
    band
        Width (length) of the strip along the edge in which the compensation changes linearly to
        that of the piece.
    """

    part: float = 0.0
    band: Positive = 0.5

    def __post_init__(self) -> None:
        _check_part("EdgeShrink: part", self.part)


def shrink_for(material: MembraneMaterial, forces: float | tuple[float, float]) -> Shrink:
    """Return the compensation for given section forces in the form.

    Section forces are per current length: n1 = (l1 / l2) S1, n2 = (l2 / l1) S2, where l are the
    stretches and S = D E the law's forces.

    Parameters
    ----------
    material
        The fabric.
    forces
        Section forces along warp and weft, or one for both (force per length).

    Returns
    -------
    Shrink
        1 - 1 / l along warp and weft.

    Raises
    ------
    InputError
        Compressive forces, forces beyond the law, or a `UflMembrane`.

    Examples
    --------
    >>> patterns.shrink_for(fabric, (2.0, 2.0))
    """
    if not isinstance(material, MembraneMaterial) or material.law == UFL_LAW:
        raise InputError(
            f"shrink_for: material = {material!r} has no linear law; use an IsotropicMembrane or "
            "OrthotropicMembrane, or pass a Shrink yourself."
        )
    n: Array = np.array(checks.pair("shrink_for: forces", forces))
    if (n < 0.0).any():
        raise InputError(f"shrink_for: forces = {forces!r} are compressive.")
    D = material.stiffness[:2, :2]
    stretch: Array = np.ones(2)
    for _ in range(100):
        before = stretch
        strain = np.linalg.solve(D, n * stretch[::-1] / stretch)
        if (strain <= -0.5).any() or (strain > 1.0 / MOST).any():
            break
        stretch = np.sqrt(1.0 + 2.0 * strain)
        if np.abs(stretch - before).max() < 1e-15:
            return Shrink(*(float(1.0 - 1.0 / one) for one in stretch))
    raise InputError(
        f"shrink_for: {material} has no strains with the section forces {n[0]:g} and {n[1]:g}; "
        "use smaller ones."
    )


def largest_width(material: MembraneMaterial, force: float, curvature: float) -> float:
    """Return the largest width of strips without compression along the warp.

    On a doubly curved form a strip of width W has further strains of ``K W**2 / 24`` in its middle
    and ``-K W**2 / 12`` at its edges: on a dome the seams are slacker than the middle; on a saddle
    the middle is slacker, by half as much.

    Parameters
    ----------
    material
        The fabric.
    force
        Section force along the warp (force per length).
    curvature
        Gaussian curvature of the form (1 / length squared), such as `Piece.curvature`.

    Returns
    -------
    float
        ``sqrt(12 n / (E t |K|))`` (length), on the safe side on a saddle; infinite without
        curvature.

    Examples
    --------
    >>> round(patterns.largest_width(fabric, force=2.0, curvature=-0.01), 2)
    1.63
    """
    K = checks.finite("largest_width: curvature", curvature)
    return width_in_tension(float(warp_moduli(material.stiffness)), force, K)


def warp_moduli(stiffness: Array) -> Array:
    """Moduli E t along the warp (...) of stiffness matrices (..., 3, 3)."""
    return np.asarray(1.0 / np.linalg.inv(stiffness)[..., 0, 0])


def width_in_tension(modulus: float, force: float, curvature: float) -> float:
    """`largest_width` of a fabric with the modulus E t along the warp."""
    n, K = checks.positive("largest_width: force", force), abs(curvature)
    return float(np.sqrt(12.0 * n / (modulus * K))) if K > 0.0 else float("inf")


def shrinks_of(
    given: Shrink | Mapping[str, Shrink] | None, parts: Mapping[str, Integers]
) -> dict[str, Shrink]:
    """Compensations by names of pieces and parts; "" stands for all."""
    if given is None:
        return {}
    found = dict(given) if isinstance(given, Mapping) else {"": given}
    for name, one in found.items():
        if name:
            checks.named("piece or part", parts, name)
        checks.of_type("flatten: shrink", one, Shrink)
    return found
