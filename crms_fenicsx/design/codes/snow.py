"""Snow on roofs by EN 1991-1-3:2003, section 5.3, as functions for `Scene.put_load`.

A shape gives the coefficient mu on the roof, from the local slope or from one pitch of the whole
roof. `snow_load` turns it into a load on plan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Literal

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import PlanDirection, PlanVector, Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.membrane_load import described

FLAT, STEEP = 30.0, 60.0
"""Pitches (degrees) up to which all snow stays and from which none does, Table 5.2."""

MU_1 = 0.8
"""Coefficient mu_1 of flat roofs, Table 5.2."""

MOST_MU_3 = 2.0
"""Recommended upper value of mu_3, 5.3.5(1), note 1."""

MU_W = (0.8, 4.0)
"""Recommended range of mu_w, 5.3.6(1), note 1."""

DRIFTS = (5.0, 15.0)
"""Recommended range of the drift's length l_s (m), 5.3.6(1), note 2."""

SLIDES = 15.0
"""Pitch (degrees) of the upper roof above which its snow slides off, 5.3.6(1)."""

Pitch = Annotated[float, partial(checks.within, low=0.0, high=90.0, unit="degrees")]
Shape = Callable[[Array, Array], Array]
"""Function of points and unit normals, both (3, n), that returns coefficients mu, (n,)."""


def snow_on_pitch(pitch: float | Array, *, retained: bool = False) -> Array:
    """Coefficient mu_1 of a pitch, EN 1991-1-3, Table 5.2.

    Parameters
    ----------
    pitch
        Pitches, 0 to 90 degrees.
    retained
        Whether snow guards or parapets keep the snow from sliding off: mu is then at least 0.8,
        5.3.2(2).

    Returns
    -------
    numpy.ndarray
        mu_1 in the shape of `pitch`: 0.8 up to 30 degrees, then linear to 0 at 60 degrees.

    Raises
    ------
    InputError
        A pitch that is not between 0 and 90 degrees.

    Examples
    --------
    >>> float(codes.snow_on_pitch(45.0))
    0.4
    """
    pitches = np.asarray(pitch, dtype=np.float64)
    if not np.all((pitches >= 0.0) & (pitches <= 90.0)):
        raise InputError(f"snow_on_pitch: pitch = {pitch!r} is not between 0 and 90 degrees.")
    mu = MU_1 * np.clip((STEEP - pitches) / (STEEP - FLAT), 0.0, 1.0)
    return np.full_like(mu, MU_1) if retained else mu


def _along(direction: PlanDirection, origin: PlanVector) -> Callable[[Array], Array]:
    """Coordinates (n,) (length) of points (3, n) along a direction in plan, from an origin."""
    way, start = np.asarray(direction[:2], dtype=float), np.asarray(origin[:2], dtype=float)
    unit = way / np.hypot(*way)
    return lambda x: np.asarray(unit @ (x[:2] - start[:, None]))


@checked
@dataclass(frozen=True)
class PitchedSnow:
    """Snow on a monopitch roof, EN 1991-1-3, 5.3.2, and on any surface by its own slope.

    Parameters
    ----------
    pitch
        Pitch of the whole roof (degrees); by default the local slope counts.
    retained
        As for `snow_on_pitch`.

    Raises
    ------
    InputError
        A pitch that is not between 0 and 90 degrees.

    Examples
    --------
    >>> load = codes.snow_load(0.75, codes.PitchedSnow(pitch=40.0))
    >>> scene.put_load(load, name="snow", per="plan")
    """

    pitch: Pitch | None = None
    retained: bool = False

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients mu at points (3, n) with unit normals (3, n)."""
        slopes: Array = np.degrees(np.arccos(np.clip(np.abs(n[2]), 0.0, 1.0)))
        if self.pitch is not None:
            slopes = np.full(n.shape[1], self.pitch)
        return snow_on_pitch(slopes, retained=self.retained)


@checked
@dataclass(frozen=True)
class DuopitchSnow:
    """Snow on a duopitch roof, EN 1991-1-3, 5.3.3 and figure 5.3.

    Parameters
    ----------
    ridge
        A point (x, y) below the ridge (length).
    across
        Direction (x, y) in plan across the ridge, from the first to the second slope.
    case
        "i": undrifted; "ii": half on the first slope; "iii": half on the second slope.
    pitch, retained
        As for `PitchedSnow`.

    Raises
    ------
    InputError
        An unknown case, a direction without length, or a pitch out of range.

    Examples
    --------
    >>> drifted = codes.DuopitchSnow(ridge=(0, 0), across=(1, 0), case="ii", pitch=20.0)
    >>> scene.put_load(codes.snow_load(0.75, drifted), name="snow ii", per="plan")
    """

    ridge: PlanVector
    across: PlanDirection
    case: Literal["i", "ii", "iii"] = "i"
    pitch: Pitch | None = None
    retained: bool = False

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients mu at points (3, n) with unit normals (3, n)."""
        mu = PitchedSnow(self.pitch, self.retained)(x, n)
        second = _along(self.across, self.ridge)(x) > 0.0
        halved = {"i": np.zeros_like(second), "ii": ~second, "iii": second}[self.case]
        return np.where(halved, 0.5 * mu, mu)


@checked
@dataclass(frozen=True)
class MultispanSnow:
    """Snow on multi-span roofs and on ridges and valleys of tents, EN 1991-1-3, 5.3.4, figure 5.4.

    Parameters
    ----------
    origin
        A point (x, y) from which ridges and valleys are measured (length).
    across
        Direction (x, y) in plan across them.
    lines
        Distances of the ridges and valleys along `across`, in turn, from the first ridge to the
        last one (length): 3, 5, 7 ... numbers.
    pitches
        Pitches of the slopes up to a ridge and down from it, along `across` (degrees).
    case
        "i": undrifted, mu_1 of each slope; "ii": drifted, between the outer ridges linear from mu_1
        at the ridges to mu_2 of the mean pitch in the valleys.
    retained
        As for `snow_on_pitch`.

    Raises
    ------
    InputError
        An unknown case, a direction without length, lines that do not increase or do not begin and
        end with a ridge, pitches out of range, or a mean one above 60 degrees, for which table 5.2
        has no mu_2.

    Examples
    --------
    >>> bays = {"origin": (0, 0), "across": (1, 0), "lines": (5, 10, 15), "pitches": (20, 20)}
    >>> drifted = codes.MultispanSnow(**bays, case="ii")
    >>> round(drifted.mu_2, 2)
    1.33
    """

    origin: PlanVector
    across: PlanDirection
    lines: Sequence[float]
    pitches: tuple[float, float]
    case: Literal["i", "ii"] = "i"
    retained: bool = False

    def __post_init__(self) -> None:
        checks.collection("MultispanSnow: lines", self.lines, Sequence, "lines=(5, 10, 15)", 3)
        given = [checks.finite("MultispanSnow: lines", one) for one in self.lines]
        if len(given) % 2 == 0 or sorted(set(given)) != given:
            raise InputError(
                f"MultispanSnow: lines = {given!r}; pass an odd number of increasing distances, of "
                "ridge, valley, ridge ..."
            )
        pitches = checks.vector("MultispanSnow: pitches", self.pitches, (2,))
        for pitch in pitches:
            checks.within("MultispanSnow: pitch", float(pitch), 0.0, 90.0, "degrees")
        checks.within("MultispanSnow: mean pitch", float(pitches.mean()), 0.0, STEEP, "degrees")

    @property
    def mu_2(self) -> float:
        """Coefficient mu_2 of the mean pitch in the valleys, table 5.2."""
        return MU_1 + MU_1 * min(sum(self.pitches) / 2, FLAT) / FLAT

    @property
    def computed(self) -> str:
        """Coefficients for reports."""
        up, down = (float(snow_on_pitch(one, retained=self.retained)) for one in self.pitches)
        told = f"mu_1 = {up:.3g} and {down:.3g}"
        return told if self.case == "i" else f"{told}, mu_2 = {self.mu_2:.3g} in the valleys"

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients mu at points (3, n) with unit normals (3, n)."""
        at, lines = _along(self.across, self.origin)(x), np.asarray(self.lines, dtype=float)
        up, down = (float(snow_on_pitch(one, retained=self.retained)) for one in self.pitches)
        slope = np.searchsorted(lines, at)  # even: up to a ridge, odd: down from one
        falls = slope % 2 == 1
        mu = np.where(falls, down, up)
        inner = (slope > 0) & (slope < len(lines))
        if self.case == "i" or not inner.any():
            return mu
        before, after = lines[np.maximum(slope - 1, 0)], lines[np.minimum(slope, len(lines) - 1)]
        share = np.where(inner, (at - before) / np.where(inner, after - before, 1.0), 0.0)
        share = np.where(falls, share, 1.0 - share)  # 0 at the ridge, 1 in the valley
        return np.where(inner, mu + share * (self.mu_2 - mu), mu)


@checked
@dataclass(frozen=True)
class CylindricalSnow:
    """Snow on a cylindrical roof, EN 1991-1-3, 5.3.5 and figure 5.6.

    Parameters
    ----------
    crown
        A point (x, y) below the crown (length).
    across
        Direction (x, y) in plan across the roof, towards the side with the heavier drift.
    span, rise
        Width b and height h of the roof's arc (length).
    case
        "i": undrifted, 0.8; "ii": drifted, up to mu_3 = 0.2 + 10 h/b, 2 at most.

    Attributes
    ----------
    width : float
        Width l_s with snow, in plan (length), where the tangent of a circular arc has up to
        60 degrees.

    Raises
    ------
    InputError
        An unknown case, a direction without length, a span or rise that is not positive, or a rise
        of more than half the span, beyond the figure.

    Examples
    --------
    >>> drifted = codes.CylindricalSnow((0, 0), across=(1, 0), span=40, rise=10, case="ii")
    >>> round(drifted.mu_3, 2), round(drifted.width, 1)
    (2.0, 40.0)
    """

    crown: PlanVector
    across: PlanDirection
    span: Positive
    rise: Positive
    case: Literal["i", "ii"] = "i"

    def __post_init__(self) -> None:
        checks.within("CylindricalSnow: rise / span", self.rise / self.span, 0.0, 0.5)

    @property
    def width(self) -> float:
        """Width l_s with snow (length)."""
        radius = (self.span**2 / 4 + self.rise**2) / (2 * self.rise)
        return float(min(self.span, 2 * radius * np.sin(np.radians(STEEP))))

    @property
    def mu_3(self) -> float:
        """Coefficient mu_3, expression (5.4)."""
        return min(0.2 + 10 * self.rise / self.span, MOST_MU_3)

    @property
    def computed(self) -> str:
        """Coefficients for reports."""
        told = f"mu = {MU_1:g}" if self.case == "i" else f"mu_3 = {self.mu_3:.3g}"
        return f"{told}, h/b = {self.rise / self.span:.3g}, l_s = {self.width:.4g}"

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients mu at points (3, n) with unit normals (3, n)."""
        part = _along(self.across, self.crown)(x) / (self.width / 2)
        if self.case == "i":
            return np.where(np.abs(part) <= 1.0, MU_1, 0.0)
        hat = np.clip(1.0 - np.abs(2 * np.abs(part) - 1.0), 0.0, None)  # 1 at a quarter of l_s
        return self.mu_3 * np.where(part > 0.0, 1.0, 0.5) * hat


@checked
@dataclass(frozen=True)
class DriftedSnow:
    """Snow on a roof that abuts taller construction works, EN 1991-1-3, 5.3.6 and figure 5.7.

    Parameters
    ----------
    wall
        Point (x, y) of the wall of the taller works (length).
    away
        Direction (x, y) in plan from the wall over the roof.
    height
        Height h of the taller works above the roof (m).
    upper, lower
        Widths b_1 of the taller works and b_2 of this roof (m).
    s_k
        Characteristic snow load on the ground (kN/m^2).
    upper_pitch, upper_slope
        Pitch (degrees) of the upper roof and width in plan (m) of its slope towards this roof.
        Above 15 degrees half of its largest snow load slides down.
    weight
        Weight of snow by volume, gamma (kN/m^3).

    Attributes
    ----------
    length, mu_w, mu_s : float
        Length l_s of the drift (m), and its coefficients by wind and by sliding.

    Raises
    ------
    InputError
        A size that is not positive, a pitch out of range, or a steep upper roof without
        `upper_slope`.

    Notes
    -----
    Use m and kN/m^2, the units of the recommended bounds 0.8 <= mu_w <= 4 and 5 m <= l_s <= 15 m.

    Examples
    --------
    >>> drift = codes.DriftedSnow(
    ...     wall=(-20, 0), away=(1, 0), height=4.0, upper=15.0, lower=40.0, s_k=0.75
    ... )
    >>> drift.length, round(drift.mu_w, 2)
    (8.0, 4.0)
    """

    wall: PlanVector
    away: PlanDirection
    height: Positive
    upper: Positive
    lower: Positive
    s_k: Positive
    upper_pitch: Pitch = 0.0
    upper_slope: float = 0.0
    weight: Positive = 2.0

    def __post_init__(self) -> None:
        if self.upper_pitch > SLIDES:
            checks.positive("DriftedSnow: upper_slope", self.upper_slope)

    @property
    def length(self) -> float:
        """Length l_s of the drift (m), expression (5.9)."""
        return min(max(2 * self.height, DRIFTS[0]), DRIFTS[1])

    @property
    def mu_w(self) -> float:
        """Coefficient mu_w due to wind, expression (5.8)."""
        drift = min((self.upper + self.lower) / (2 * self.height),
                    self.weight * self.height / self.s_k)  # fmt: skip
        return min(max(drift, MU_W[0]), MU_W[1])

    @property
    def mu_s(self) -> float:
        """Coefficient mu_s due to sliding: half of the upper slope's snow, as a triangle."""
        if self.upper_pitch <= SLIDES:
            return 0.0
        return float(snow_on_pitch(self.upper_pitch)) * self.upper_slope / self.length

    @property
    def computed(self) -> str:
        """Length and coefficients for reports."""
        return f"l_s = {self.length:.4g}, mu_w = {self.mu_w:.3g}, mu_s = {self.mu_s:.3g}"

    def __call__(self, x: Array, n: Array) -> Array:
        """Coefficients mu at points (3, n) with unit normals (3, n)."""
        part = np.clip(_along(self.away, self.wall)(x) / self.length, 0.0, 1.0)
        highest = max(self.mu_s + self.mu_w, MU_1)
        return np.asarray(highest + (MU_1 - highest) * part)


@checked
def snow_load(
    s_k: Positive, shape: Shape | None = None, *, exposure: Positive = 1.0, thermal: Positive = 1.0
) -> Callable[[Array, Array], Array]:
    """Snow load s = mu C_e C_t s_k on the plan, EN 1991-1-3, expression (5.1).

    Parameters
    ----------
    s_k
        Characteristic snow load on the ground (force per area).
    shape
        A `PitchedSnow` (the default), `DuopitchSnow`, `MultispanSnow`, `CylindricalSnow` or
        `DriftedSnow`.
    exposure
        C_e: 0.8 windswept, 1.0 normal, 1.2 sheltered, Table 5.1.
    thermal
        C_t, 1.0 unless a heated roof melts the snow, 5.2(8).

    Returns
    -------
    callable
        For `Scene.put_load`, with ``per="plan"``.

    Raises
    ------
    InputError
        A load or coefficient that is not positive, or an invalid shape.

    Examples
    --------
    >>> vault = codes.CylindricalSnow((0, 0), across=(1, 0), span=40, rise=10, case="ii")
    >>> scene.put_load(codes.snow_load(0.75, vault), name="snow drifted", per="plan")
    """
    load = s_k * exposure * thermal
    shape = PitchedSnow() if shape is None else shape
    if not callable(shape):
        raise InputError(
            f"snow_load: shape = {shape!r} is not a snow shape; use PitchedSnow(), for example."
        )

    def force(x: Array, n: Array) -> Array:
        mu = shape(x, n)
        return np.stack([0 * mu, 0 * mu, -load * mu])

    force.__doc__ = f"s_k = {s_k:g}, C_e = {exposure:g}, C_t = {thermal:g}, mu: {described(shape)}"
    return force
