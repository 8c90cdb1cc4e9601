"""How supports and anchors move in a call of `Solver.advance`: along a line, or by a function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import EPSILON, Array, Booleans
from crms_fenicsx.runtime.errors import InputError

Way = Callable[[Array, float], Array]
"""Displacements (3, n) (length) of places (3, n) at the call's start, at a part t of the call, 0 to
1; zero at t = 0."""

Move = Sequence[float] | Array | Way
"""One displacement (3,) for all, reached in equal parts, or a function."""

ROUNDING = 64 * EPSILON
"""What a function may have left of zero, relative to places and displacements."""


@dataclass(frozen=True)
class Rotation:
    """A movement of supports for `Solver.advance`: they turn about an axis, on circles.

    Parameters
    ----------
    point
        A point on the axis, (3,) (length).
    axis
        Its direction, (3,), of any length.
    angle
        Angle by which they turn in the whole call (rad), right-handed about the axis. More than a
        full turn is possible.

    Raises
    ------
    InputError
        A point, axis or angle that is not finite, or an axis without length.

    Examples
    --------
    >>> solver.advance(move={"ring": Rotation((0, 0, 0), (0, 0, 1), np.pi / 6)}, steps=3)
    """

    point: Sequence[float]
    axis: Sequence[float]
    angle: float

    def __post_init__(self) -> None:
        checks.vector("Rotation: point", self.point)
        axis = checks.vector("Rotation: axis", self.axis)
        if not np.linalg.norm(axis) > 0.0:
            raise InputError(
                f"Rotation: axis = {self.axis!r} has no direction; give one, as in (0, 0, 1)."
            )
        checks.finite("Rotation: angle", self.angle)

    def __call__(self, x: Array, t: float) -> Array:
        """Displacements (3, n) of places x (3, n) at a part t of the turn; Rodrigues' formula."""
        axis = np.asarray(self.axis, dtype=float)
        axis = axis / np.linalg.norm(axis)
        arm = x - np.reshape(np.asarray(self.point, dtype=float), (3, 1))
        across = np.cross(axis, arm, axisa=0, axisb=0, axisc=0)
        half = 0.5 * t * self.angle  # 1 - cos without cancellation
        inwards = np.cross(axis, across, axisa=0, axisb=0, axisc=0)
        way: Array = np.sin(2 * half) * across + 2 * np.sin(half) ** 2 * inwards
        return way


@dataclass(frozen=True)
class Motion:
    """A checked movement of some places."""

    what: str  # what moves, for messages
    move: Array | Way  # one displacement (3,) for all, or a function
    places: Array  # (n, 3) where they are at the call's start (length)
    steps: int  # increments of the call; a function has been checked at their ends

    @classmethod
    def of(cls, what: str, given: object, places: Array, steps: int) -> Motion:
        """Check what the user gave, but for the values of a function: see `sampled`."""
        if callable(given):
            return cls(what, given, places, steps)
        return cls(what, checks.vector(what, given), places, steps)

    def at(self, share: float) -> Array:
        """Displacements (n, 3) at a part of the call, or (3,) for all (length)."""
        if not callable(self.move):
            return share * self.move
        given = np.asarray(self.move(self.places.T.copy(), share))
        due = (3, len(self.places))
        if given.shape != due or given.dtype.kind not in "fiu":
            raise InputError(
                f"{self.what}: the function returned an array of shape {given.shape} and type "
                f"{given.dtype}; it must return displacements, real numbers of shape {due}."
            )
        bad = ~np.isfinite(given).all(axis=0)
        if bad.any():
            first = int(np.argmax(bad))
            raise InputError(
                f"{self.what}: the function returned {given[:, first]} for the place "
                f"{self.places[first]} at t = {share:g}; it must return finite displacements."
            )
        return np.asarray(given.T, dtype=np.float64)

    @cached_property
    def sampled(self) -> Array:
        """Displacements at the ends of the increments, (steps, n, 3); of one for all the last."""
        if callable(self.move):
            start = self.at(0.0)
            ends = [self.at((k + 1) / self.steps) for k in range(self.steps)]
            size = max(float(np.abs(v).max(initial=0.0)) for v in (self.places, *ends))
            far = np.flatnonzero(np.abs(start).max(axis=1, initial=0.0) > ROUNDING * size)
            if len(far):
                raise InputError(
                    f"{self.what}: the function returned {start[far[0]]} for the place "
                    f"{self.places[far[0]]} at t = 0; displacements count from the call's start "
                    "and must begin at zero."
                )
            return np.array(ends).reshape(self.steps, -1, 3)
        return np.broadcast_to(self.move, (1, *self.places.shape))

    def moving(self) -> Booleans:
        """Which components of the places move, (n, 3), by more than a function's rounding."""
        least = self._rounding() if callable(self.move) else 0.0
        return np.asarray((np.abs(self.sampled) > least).any(axis=0))

    def _rounding(self) -> float:
        """Displacements up to which a function may mean zero (length)."""
        return ROUNDING * float(
            max(np.abs(v).max(initial=0.0) for v in (self.places, self.sampled))
        )

    @property
    def displacement(self) -> Array | None:
        """The displacement (3,) that all have at the end; None of a function."""
        return None if callable(self.move) else self.move
