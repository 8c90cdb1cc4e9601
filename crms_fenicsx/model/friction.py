"""A cable's friction on the membrane: coefficients, law (chapter 3) and history."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np

from crms_fenicsx.foundation.runtime.arguments import Finite, NonNegative, Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.surface.points import Support

MOST_TOLERANCE = 0.1
"""Largest slip tolerance (parts of a cell): beyond it the model is no longer dry friction."""


@checked
@dataclass(frozen=True)
class Friction:
    """Dry friction between a cable and the membrane.

    Parameters
    ----------
    mu
        Kinetic coefficient of friction against sideways sliding. 0: slides sideways freely.
    static
        Static coefficient, at least `mu`; None: equal to `mu`.
    along
        Coefficient against sliding along the cable's axis. The tension then varies along the cable,
        between two nodes by at most ``exp(along * angle)`` (`LaidCable.tensions`). The angle is the
        cable's turn around the membrane; in a pocket, which also exerts in-plane forces, the whole
        turn. A change of unstressed length is fed in or out at the cable's last end. 0: slides
        along itself freely, assumption 6 of the paper.
    cone
        How the limits sideways, ``mu N``, and along, ``along N``, of a contact force N combine.
        False: independently, a box, which overestimates the force on an obliquely sliding cable by
        up to 1.41. True: an ellipse (Coulomb's cone if `along` equals `mu`), and the cable slides
        in the direction of greatest dissipation. It takes more passes.
    law
        "coulomb": stick and slip. "step": the paper's friction element (section 3.3) between the
        cable and a membrane node, whose force has the size ``mu N`` and the direction of the load
        step's start (assumption 7), (3.2-1 ... 3.3-2), against the slip of the step. Where neither
        sense of this force lets the cable slide, it holds the cable with less than ``mu N``, and a
        warning tells so: the paper does not treat sticking.
    tolerance
        Elastic slip at which the friction force is fully mobilised, the width over which its jump
        is smoothed: sideways relative to the cell size, along the cable to the elongation that a
        node's friction force causes in a cell.

    Raises
    ------
    InputError
        If a coefficient is negative, `static` is below `mu`, the law is unknown, `cone` comes
        without `mu` and `along`, with a static coefficient or with the law "step", or the tolerance
        is not between 0 and 0.1.

    Examples
    --------
    >>> rope = Cable(EA=1e3, friction=Friction(0.2, along=0.1))
    >>> cable = scene.lay_cable(rope, [(2.0, 0.0), (2.0, 4.0)], tension=3.0)
    >>> step = solver.advance(pressure=1.5)
    >>> bool(np.ptp(cable.tensions) > 0.0)  # differs along the cable
    True
    """

    mu: NonNegative
    static: Finite | None = None
    along: NonNegative = 0.0
    law: Literal["coulomb", "step"] = "coulomb"
    tolerance: Positive = 3e-3
    cone: bool = False

    def __post_init__(self) -> None:
        if self.static is not None and self.static < self.mu:
            raise InputError(
                f"Friction: static = {self.static} is smaller than mu = {self.mu}, the coefficient "
                "of a cable that slides; use at least that."
            )
        if self.law == "step" and (self.static not in (None, self.mu) or self.along):
            raise InputError(
                'Friction: law = "step" has neither a static coefficient nor friction along the '
                f"cable, but static = {self.static}, along = {self.along}; leave them out, or use "
                '"coulomb".'
            )
        if self.cone and (self.law == "step" or min(self.mu, self.along) == 0):
            raise InputError(
                f"Friction: cone = True couples the friction forces sideways and along the cable, "
                f'but mu = {self.mu}, along = {self.along}, law = "{self.law}"; pass both '
                'coefficients with the law "coulomb", or leave cone out.'
            )
        if self.cone and self.static not in (None, self.mu):
            raise InputError(
                f"Friction: cone = True has no static coefficient, but static = {self.static}; "
                "leave one of them out."
            )
        if self.tolerance > MOST_TOLERANCE:
            raise InputError(
                f"Friction: tolerance = {self.tolerance} is a slip of more than {MOST_TOLERANCE} "
                "of a cell, too large for sticking; use about 0.003."
            )

    @property
    def at_rest(self) -> float:
        """Static coefficient."""
        return self.mu if self.static is None else self.static

    @property
    def any(self) -> bool:
        """Whether there is any friction."""
        return self.at_rest > 0 or self.along > 0


@dataclass(frozen=True)
class MaterialCurve:
    """Line of a cable on the stress-free membrane."""

    points: Annotated[Array, "m", 3]  # (m, 3) its points (length)
    arc: Annotated[Array, "m"]  # (m,) arc length from its first point (length)
    # (m,) number of the contiguous part on the membrane; between parts the cable was lifted off
    part: Annotated[Integers, "m"]
    elastic: Annotated[Array, "m"]  # (m,) remaining elastic slip at the points (length)
    moving: Annotated[Array, "m"]  # (m,) sliding in the last step: 1 left, -1 right, 0 none

    @property
    def joined(self) -> Integers:
        """Points (n,) from which the curve runs on to the next one."""
        return np.flatnonzero((self.part[1:] == self.part[:-1]) & (np.diff(self.arc) > 0.0))

    def nearest(self, places: Array) -> tuple[Array, Array, Integers]:
        """Arc lengths, points and parts closest to places (n, 3); part -1 without a curve."""
        joined = self.joined
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
        # Beyond the ends of a part, the arc length is extrapolated.
        part = self.part[first]
        begins = np.concatenate([[True], self.part[1:] != self.part[:-1]])[first] & (t < 0.0)
        ends = np.concatenate([self.part[1:] != self.part[:-1], [True]])[first + 1] & (t > 1.0)
        share = np.where(begins | ends, t, at)
        return self.arc[first] + share * length, feet[rows, best], part

    def tangents(self, at: Array, parts: Integers, reach: Array) -> Array:
        """Unit chords (n, 3) from a distance `reach` (n,) before each place to as far after it."""
        # a chord between two points close together is dominated by rounding
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
        """Elastic slips (n,) (length) at arc lengths, and sliding (n,) of the nearest points."""
        elastic, moving = np.zeros((2, len(at)))
        for part in np.unique(parts):
            own, rows = self.part == part, parts == part
            elastic[rows] = np.interp(at[rows], self.arc[own], self.elastic[own])
            nearest = np.argmin(np.abs(at[rows][:, None] - self.arc[own]), axis=1)
            moving[rows] = self.moving[own][nearest]
        return elastic, moving


@dataclass(frozen=True)
class LateralLaw:
    """Factors by which the cone changes the box's sideways law at n nodes."""

    bound: Annotated[Array, "n"]  # largest friction force
    width: Annotated[Array, "n"]  # slip at which it is reached
    elastic: Annotated[Array, "n"]  # largest elastic slip


@dataclass(frozen=True)
class ElementSlips:
    """Slips of the paper's friction elements of n nodes, ``left . (x_p - x_v) + offset``, from the
    positions of node and vertex. Elements not placed yet have an offset of NaN."""

    vertices: Annotated[Integers, "n"]  # membrane node v of each element
    left: Annotated[Array, "n", 3]  # direction of positive slip, as the step began
    offset: Annotated[Array, "n"]  # (length)
    bound: Annotated[Array, "n"]  # mu N as the step began (force)

    @classmethod
    def missing(cls, bound: Array) -> ElementSlips:
        """Elements of nodes with these bounds, none placed yet."""
        n = len(bound)
        return cls(np.full(n, -1), np.zeros((n, 3)), np.full(n, np.nan), bound)

    def remapped(self, bound: Array, stays: Sequence[int], rows: Sequence[int]) -> ElementSlips:
        """Elements of nodes with these bounds, of which `stays` have been `rows`."""
        new = ElementSlips.missing(bound)
        new.vertices[stays], new.left[stays] = self.vertices[rows], self.left[rows]
        new.offset[stays] = self.offset[rows]
        return new


@dataclass(frozen=True)
class LateralFrictionState:
    """Sideways friction of a laid cable in a load step."""

    curve: MaterialCurve  # the cable's line at the start of the step
    supports: Annotated[tuple[Support, ...], "n"]  # supports of the nodes that have bounds
    bounds: Annotated[Array, "n"]  # (n,) largest friction force of each (force)
    moving: Annotated[Array, "n"]  # (n,) sliding in this step: 1 left, -1 right, 0 none
    dissipated: float = 0.0  # energy dissipated up to the step's start (force x length)
    known: bool = False  # whether the bounds come from a solved state, not from a first guess
    cone: LateralLaw | None = None  # reduction by friction along the cable; None: none
    elements: ElementSlips | None = None  # of the paper's law; None: of another law
    # the cable's line at the last update of the forces, with slips at its points in place of
    # elastic ones; None: `curve`
    line: MaterialCurve | None = None
    # vertices of its row that slide with it; () for a cable that crosses edges
    shifting: tuple[Support, ...] = ()

    def rows(self, supports: Iterable[Support]) -> list[int]:
        """Rows of nodes in the arrays."""
        return [self.row_of[support] for support in supports]

    def law(self, supports: Iterable[Support], eps: Array) -> tuple[Array, Array, Array]:
        """Bounds (force), slips at which they are reached, and largest elastic slips (length)."""
        rows = self.rows(supports)
        bounds, own = self.bounds[rows], self.cone
        if own is None:
            return bounds, eps, eps
        return bounds * own.bound[rows], eps * own.width[rows], eps * own.elastic[rows]

    def at(self, support: Support) -> float:
        """Bound of a node (force)."""
        return float(self.bounds[self.row_of[support]])

    @property
    def held(self) -> int:
        """Number of nodes that friction elements hold in place."""
        if self.elements is None:
            return 0
        placed = ~np.isnan(self.elements.offset)
        return int(np.sum(placed & (self.moving == 0.0) & (self.bounds > 0.0)))

    @cached_property
    def row_of(self) -> dict[Support, int]:
        """Row of each node in the arrays."""
        return {support: row for row, support in enumerate(self.supports)}


@dataclass(frozen=True)
class AxialFrictionState:
    """Friction of a laid cable along its axis in a load step."""

    curve: MaterialCurve  # the cable's line at the start of the step
    rest: Annotated[Array, "p"]  # unstressed arc lengths at its points (length)
    supports: Annotated[tuple[Support, ...], "n"]  # supports of the n nodes with friction
    # (n,) largest friction force of each (force), times the local stretch, so that it is conjugate
    # to the unstressed arc length
    bounds: Annotated[Array, "n"]
    eps: Annotated[Array, "n"]  # (n,) slip at which it is reached (length)
    elastic: Annotated[Array, "n"]  # (n,) largest elastic slip (length): `eps`, less with a cone
    # last solved state: tensions (m,) between contacts (force), lengths (n + 1,) between the nodes
    # with friction, unstressed arc lengths and slips (n,) at these (length)
    tensions: Annotated[Array, "m"]
    spans: Annotated[Array, "s"]
    arcs: Annotated[Array, "a"]
    slips: Annotated[Array, "n"]
    loss: float = 0.0  # energy dissipated in this step (force x length)
    dissipated: float = 0.0  # energy dissipated before this step (force x length)
