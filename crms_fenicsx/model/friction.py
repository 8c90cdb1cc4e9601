"""A cable's friction on the membrane: coefficients, law (chapter 3) and history."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.surface.points import Support

MOST_TOLERANCE = 0.1
"""Slip tolerances above this (parts of a cell) are no friction any more."""


@dataclass(frozen=True)
class Friction:
    """Dry friction between a cable and the membrane.

    Parameters
    ----------
    mu
        Coefficient of friction against sliding sideways, of a cable that slides (kinetic). 0: it
        slides sideways freely.
    static
        Coefficient for a cable that is at rest, `mu` or more; None: as `mu`.
    along
        Coefficient against sliding along the cable's axis; with one the tension varies along the
        cable, between two nodes by ``exp(along * angle)`` at most (`LaidCable.tensions`). The angle
        is the turn around the membrane; in a pocket, which pulls in the surface as well, the whole
        turn. An unstressed length that changes is taken in or let out at the
        cable's last end. 0: the cable slides along itself freely, assumption 6 of the paper.
    cone
        How the limits sideways, ``mu N``, and along, ``along N``, of a contact force N go together.
        False: each on its own, a box; the force of a cable that slides obliquely is too large by
        up to 1.41. True: an ellipse, with `along` equal to `mu` Coulomb's cone, and a cable slides
        in the direction that dissipates most. It takes more passes.
    law
        "coulomb": stick and slip. "step": the paper's friction element (section 3.3), whose force
        keeps its direction and size in a load step (assumption 7), so that nothing can stick: a
        cable that should stay is pushed back.
    tolerance
        Elastic slip at which the friction force is fully mobilised: the width that the jump of the
        friction force is smoothed to. Sideways it is relative to the size of the cells, along the
        cable to what the friction force of a node stretches the cable by in a cell.

    Raises
    ------
    InputError
        A coefficient that is negative, `static` below `mu`, an unknown law, `cone` without `mu`
        and `along`, with a static coefficient or with the law "step", or a tolerance that is not
        between 0 and 0.1.
    """

    mu: float
    static: float | None = None
    along: float = 0.0
    law: Literal["coulomb", "step"] = "coulomb"
    tolerance: float = 3e-3
    cone: bool = False

    def __post_init__(self) -> None:
        for name in ("mu", "along"):
            if checks.finite(f"Friction: {name}", getattr(self, name)) < 0:
                raise InputError(
                    f"Friction: {name} = {getattr(self, name)} is negative; give 0 or more."
                )
        if self.static is not None and checks.finite("Friction: static", self.static) < self.mu:
            raise InputError(
                f"Friction: static = {self.static} is smaller than mu = {self.mu}, the coefficient "
                "of a cable that slides; give at least that."
            )
        checks.one_of("Friction: law", self.law, ("coulomb", "step"))
        if self.law == "step" and (self.static not in (None, self.mu) or self.along):
            raise InputError(
                'Friction: law = "step" knows neither a static coefficient nor friction along the '
                f"cable, but static = {self.static}, along = {self.along}; leave them out, or use "
                '"coulomb".'
            )
        if self.cone and (self.law == "step" or min(self.mu, self.along) == 0):
            raise InputError(
                f"Friction: cone = True couples the friction forces sideways and along the cable, "
                f'but mu = {self.mu}, along = {self.along}, law = "{self.law}"; give both '
                'coefficients with the law "coulomb", or leave cone out.'
            )
        if self.cone and self.static not in (None, self.mu):
            raise InputError(
                f"Friction: cone = True knows no static coefficient, but static = {self.static}; "
                "leave one of them out."
            )
        tolerance = checks.positive("Friction: tolerance", self.tolerance)
        if tolerance > MOST_TOLERANCE:
            raise InputError(
                f"Friction: tolerance = {tolerance} is a slip of more than {MOST_TOLERANCE} of a "
                "cell, which is no sticking; give about 0.003."
            )

    @property
    def at_rest(self) -> float:
        """Coefficient for a cable that is at rest."""
        return self.mu if self.static is None else self.static

    @property
    def any(self) -> bool:
        """Whether there is friction at all."""
        return self.at_rest > 0 or self.along > 0


@dataclass(frozen=True)
class MaterialCurve:
    """Where a cable lay on the stress-free membrane."""

    points: Annotated[Array, "m", 3]  # (m, 3) its points (length)
    arc: Annotated[Array, "m"]  # (m,) arc length from its first point (length)
    # (m,) number of the part that lies on the membrane; between parts the cable was off it
    part: Annotated[Integers, "m"]
    elastic: Annotated[Array, "m"]  # (m,) elastic slip left at the points (length)
    moving: Annotated[Array, "m"]  # (m,) how they slid in the last step: 1 left, -1 right, 0 not

    def nearest(self, places: Array) -> tuple[Array, Array, Integers]:
        """Arc lengths, points and parts nearest to places (n, 3); part -1 without a curve."""
        joined = np.flatnonzero((self.part[1:] == self.part[:-1]) & (np.diff(self.arc) > 0.0))
        if not len(joined):
            return np.zeros(len(places)), places.copy(), np.full(len(places), -1)
        start, way = self.points[joined], self.points[joined + 1] - self.points[joined]
        size = np.sum(way**2, axis=1)
        t = np.einsum("nmi,mi->nm", places[:, None] - start, way) / size
        inside = np.clip(t, 0.0, 1.0)
        feet = start + inside[:, :, None] * way
        best = np.argmin(np.sum((places[:, None] - feet) ** 2, axis=2), axis=1)
        rows = np.arange(len(places))
        first, at, t = joined[best], inside[rows, best], t[rows, best]
        length = np.sqrt(size[best])
        # Only at the ends of a part does it matter how far beyond a place lies.
        part = self.part[first]
        begins = np.concatenate([[True], self.part[1:] != self.part[:-1]])[first] & (t < 0.0)
        ends = np.concatenate([self.part[1:] != self.part[:-1], [True]])[first + 1] & (t > 1.0)
        share = np.where(begins | ends, t, at)
        return self.arc[first] + share * length, feet[rows, best], part

    def tangents(self, at: Array, parts: Integers, reach: Array) -> Array:
        """Mean directions, unit (n, 3), between a distance `reach` (n,) before and after places."""
        # the direction between two points that lie close together is rounding
        found = np.zeros((len(at), 3))
        for part in np.unique(parts):
            own, rows = self.part == part, parts == part
            arc, points = self.arc[own], self.points[own]
            inside = np.clip(at[rows], arc[0], arc[-1])
            for sign in (1.0, -1.0):
                u = np.clip(inside + sign * reach[rows], arc[0], arc[-1])
                for i in range(3):
                    found[rows, i] += sign * np.interp(u, arc, points[:, i])
        return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])

    def history(self, at: Array, parts: Integers) -> tuple[Array, Array]:
        """Elastic slips (n,) (length) at arc lengths, and how the nearest points slid, (n,)."""
        elastic, moving = np.zeros((2, len(at)))
        for part in np.unique(parts):
            own, rows = self.part == part, parts == part
            elastic[rows] = np.interp(at[rows], self.arc[own], self.elastic[own])
            nearest = np.argmin(np.abs(at[rows][:, None] - self.arc[own]), axis=1)
            moving[rows] = self.moving[own][nearest]
        return elastic, moving


@dataclass(frozen=True)
class SidewaysLaw:
    """How the cone changes the law sideways of nodes, relative to that of the box, (n,) each."""

    bound: Annotated[Array, "n"]  # most friction force
    width: Annotated[Array, "n"]  # slip at which it is reached
    elastic: Annotated[Array, "n"]  # most elastic slip


@dataclass(frozen=True)
class LateralFrictionState:
    """Friction of a laid cable in a load step."""

    curve: MaterialCurve  # where the cable lay when the step began
    supports: Annotated[tuple[Support, ...], "n"]  # places of the nodes that the bounds are of
    bounds: Annotated[Array, "n"]  # (n,) most friction force of each (force)
    moving: Annotated[Array, "n"]  # (n,) how each slides in this step: 1 left, -1 right, 0 not
    dissipated: float = 0.0  # energy dissipated up to the step's start (force x length)
    known: bool = False  # whether the bounds come from a state, and not from a first guess
    cone: SidewaysLaw | None = None  # what friction along the cable takes; None: nothing

    def rows(self, supports: Iterable[Support]) -> list[int]:
        """Rows of nodes in the arrays."""
        return [self.row_of[support] for support in supports]

    def law(self, supports: Iterable[Support], eps: Array) -> tuple[Array, Array, Array]:
        """Bounds (force), slips at which they are reached, and most elastic slips (length)."""
        rows = self.rows(supports)
        bounds, own = self.bounds[rows], self.cone
        if own is None:
            return bounds, eps, eps
        return bounds * own.bound[rows], eps * own.width[rows], eps * own.elastic[rows]

    def at(self, support: Support) -> float:
        """Bound of a node (force)."""
        return float(self.bounds[self.row_of[support]])

    @cached_property
    def row_of(self) -> dict[Support, int]:
        """Place of each node in the arrays."""
        return {support: row for row, support in enumerate(self.supports)}


@dataclass(frozen=True)
class AxialFrictionState:
    """Friction of a laid cable along its axis, in a load step."""

    curve: MaterialCurve  # where the cable lay when the step began, and
    rest: Annotated[Array, "p"]  # the unstressed arcs that rest at its points (length)
    supports: Annotated[tuple[Support, ...], "n"]  # places of the n nodes that friction holds
    # (n,) most friction force of each (force), times the stretch there, so that its work is that on
    # the unstressed arc
    bounds: Annotated[Array, "n"]
    eps: Annotated[Array, "n"]  # (n,) slip at which it is reached (length)
    elastic: Annotated[Array, "n"]  # (n,) most elastic slip (length): `eps`, with a cone less
    # in the state last solved: tensions (m,) between the nodes that the cable touches (force),
    # lengths (n + 1,) between the nodes held, unstressed arcs and slips (n,) at these (length)
    tensions: Annotated[Array, "m"]
    spans: Annotated[Array, "s"]
    arcs: Annotated[Array, "a"]
    slips: Annotated[Array, "n"]
    loss: float = 0.0  # energy dissipated in the step so far (force x length)
    dissipated: float = 0.0  # energy dissipated up to the step's start (force x length)
