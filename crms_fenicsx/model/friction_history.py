"""What friction knows of the load steps before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.surface.points import Support


@dataclass(frozen=True)
class MaterialCurve:
    """Where a cable lay on the stress-free membrane.

    Attributes
    ----------
    points : (m, 3)
        Its points (length).
    arc : (m,)
        Arc length from its first point (length).
    part : (m,)
        Number of the part that lies on the membrane; between parts the cable was off it.
    elastic : (m,)
        Elastic slip left at the points (length).
    moving : (m,)
        In which direction they slid in the last load step: 1 left, -1 right, 0 not.
    """

    points: Annotated[Array, "m", 3]
    arc: Annotated[Array, "m"]
    part: Annotated[Integers, "m"]
    elastic: Annotated[Array, "m"]
    moving: Annotated[Array, "m"]

    def nearest(self, places: Array) -> tuple[Array, Array, Integers]:
        """Arc lengths (n,), places (n, 3) and parts (n,) of the points nearest to places (n, 3).

        An arc length lies beyond the ends of its part by what the place does. Where the curve is
        nowhere, so are they: the parts are -1.
        """
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
        """Mean directions between a distance `reach` (n,) before and after places, unit (n, 3).

        Points that lie close together have none of their own that means anything.
        """
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

    def elastic_at(self, at: Array, parts: Integers) -> Array:
        """Elastic slips at places, (n,) (length)."""
        found = np.zeros(len(at))
        for part in np.unique(parts):
            own, rows = self.part == part, parts == part
            found[rows] = np.interp(at[rows], self.arc[own], self.elastic[own])
        return found

    def moving_at(self, at: Array, parts: Integers) -> Array:
        """Directions in which the nearest points slid in the last load step, (n,)."""
        found = np.zeros(len(at))
        for part in np.unique(parts):
            own, rows = self.part == part, parts == part
            nearest = np.argmin(np.abs(at[rows][:, None] - self.arc[own]), axis=1)
            found[rows] = self.moving[own][nearest]
        return found


@dataclass(frozen=True)
class SidewaysLaw:
    """How the cone changes the law sideways of nodes, relative to that of the box, (n,) each.

    Attributes
    ----------
    bound, width
        Most friction force, and the slip at which it is reached.
    elastic
        Most elastic slip.
    """

    bound: Annotated[Array, "n"]
    width: Annotated[Array, "n"]
    elastic: Annotated[Array, "n"]


@dataclass(frozen=True)
class Grip:
    """Friction of a laid cable in a load step.

    Attributes
    ----------
    curve
        Where the cable lay when the step began.
    supports
        Places of the nodes that the bounds are of.
    bounds : (n,)
        Most friction force of each (force).
    moving : (n,)
        Direction in which each slides in this step: 1 left, -1 right, 0 not.
    dissipated
        Energy that friction has dissipated up to the step's start (force x length).
    known
        Whether the bounds come from a state, and not from a first guess.
    cone
        What friction along the cable takes of that sideways; None: nothing.
    """

    curve: MaterialCurve
    supports: Annotated[tuple[Support, ...], "n"]
    bounds: Annotated[Array, "n"]
    moving: Annotated[Array, "n"]
    dissipated: float = 0.0
    known: bool = False
    cone: SidewaysLaw | None = None

    def law(self, rows: list[int], eps: Array) -> tuple[Array, Array, Array]:
        """Bounds (force), slips at which they are reached, and most elastic slips (length).

        Parameters
        ----------
        rows
            Nodes, by number.
        eps
            Slips at which friction is fully mobilised in pure sliding sideways (length).
        """
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
class AxialGrip:
    """Friction of a laid cable along its axis, in a load step.

    Attributes
    ----------
    curve
        Where the cable lay when the step began, and
    rest
        the unstressed arcs that rest at its points (length).
    supports
        Places of the n nodes that friction holds.
    bounds, eps : (n,)
        Most friction force of each (force; times the stretch there, so that its work is that on
        the unstressed arc), and the slip at which it is reached (length).
    elastic : (n,)
        Most elastic slip (length): `eps`, with a cone less.
    tensions : (m,)
        Tension between the nodes that the cable touches, in the state last solved (force).
    spans : (n + 1,), arcs, slips : (n,)
        Lengths between the nodes that friction holds, the unstressed arcs at them, and their slips
        (length), in that state.
    loss
        Energy that friction has dissipated in the step so far (force x length).
    dissipated
        Energy that it has dissipated up to the step's start (force x length).
    """

    curve: MaterialCurve
    rest: Annotated[Array, "p"]
    supports: Annotated[tuple[Support, ...], "n"]
    bounds: Annotated[Array, "n"]
    eps: Annotated[Array, "n"]
    elastic: Annotated[Array, "n"]
    tensions: Annotated[Array, "m"]
    spans: Annotated[Array, "s"]
    arcs: Annotated[Array, "a"]
    slips: Annotated[Array, "n"]
    loss: float = 0.0
    dissipated: float = 0.0
