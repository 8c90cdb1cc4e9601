"""Fixed-point iteration for the lateral and axial friction forces.

Each pass updates the forces from the state that they produce. This can cycle among few states,
where nodes start to slide or to touch; so changes are relaxed by Aitken's rule for vectors (B. M.
Irons and R. C. Tuck, Int. J. Numer. Meth. Engng 1, 1969).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cabling.cables.clamping import held_by_clamps
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import contact_forces, held_nodes, wrap_angles
from crms_fenicsx.cabling.friction.axial import (
    LEAST_PART,
    RestPlaces,
    between_contacts,
    reference_arcs,
)
from crms_fenicsx.cabling.friction.slip import (
    BISECTIONS,
    Slip,
    full_slips,
    law_along,
    law_sideways,
    node_slips,
    slip_forces,
    slipped_line,
    slips_sideways,
)
from crms_fenicsx.energy.terms.capstan_chain import LAW, find_slips
from crms_fenicsx.energy.terms.lateral_friction import coulomb_forces
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans
from crms_fenicsx.model.friction import LateralFrictionState
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


class AitkenRelaxation:
    """Aitken relaxation factor."""

    def __init__(self, least: float) -> None:
        self.least = least
        self._part = 1.0
        self._last: tuple[Hashable, Array] | None = None

    def factor(self, what: Hashable, change: Array) -> float:
        """Fraction of a change (n,) to apply; the previous change counts if `what` is the same."""
        if self._last is not None and self._last[0] == what:
            bend = change - self._last[1]
            size = float(bend @ bend)
            if size > 0.0:
                part = -self._part * float(self._last[1] @ bend) / size
                self._part = min(max(part, self.least), 1.0)
        self._last = what, change
        return self._part


SETTLED, NEARLY = 1e-3, 0.02
"""Change of the bounds, relative to their sum, below which they have settled, and nearly so."""

LEAST_SHARE = 0.1
"""Least relaxation factor for the distribution of the bounds."""

MAX_SLOPE = 0.9
"""Upper limit of the slope of the fixed-point map of their sum."""

MIN_SLOPE = 30.0
"""Limit of a negative slope, where the state responds to a larger sum with a smaller one."""


class _Brackets:
    """Nodes' bounds between which the state changes by a jump: at a smaller one a node presses more
    than that, at a larger one less. A force between is lawful there, as the pressure is."""

    def __init__(self) -> None:
        self._what: Hashable = None
        self._low: Array = np.zeros(0)
        self._high: Array = np.zeros(0)

    def narrow(self, what: Hashable, used: Array, found: Array) -> None:
        """Take in the bounds found for those used, (n,); others than before if `what` differs."""
        if what != self._what:
            self._what, self._low = what, np.zeros(len(used))
            self._high = np.full(len(used), np.inf)
        rises, falls = found > used, found < used
        self._low = np.where(rises, np.maximum(self._low, used), self._low)
        self._high = np.where(falls, np.minimum(self._high, used), self._high)
        crossed = self._low >= self._high  # the other nodes have moved them
        self._low[crossed & falls], self._high[crossed & rises] = 0.0, np.inf

    def inside(self, bounds: Array) -> Array:
        """The bounds, halfway where they lie outside of their brackets."""
        out = (bounds <= self._low) | (bounds >= self._high)
        middle = (self._low + self._high) / 2
        return np.asarray(np.where(out & np.isfinite(self._high), middle, bounds))

    def closed(self, width: float) -> Booleans:
        """Which brackets are narrower than a width (force), (n,)."""
        return np.asarray(self._high - self._low <= width)


CYCLES = 12
"""Updates after which bounds that have not nearly settled are kept between those tried."""


class LateralIteration:
    """Iterates one cable's lateral bounds to those of the resulting state."""

    # The bounds are proportional to the tension, which a stiff cable soon loses by sliding: plain
    # iteration of their sum converges slowly, so it is found by the secant method. Their
    # distribution among the nodes can alternate between two states, so its change is relaxed.
    settled = SETTLED

    def __init__(self, cable: LaidCable) -> None:
        self.cable = cable
        self.change, self._updates, self._cycles = np.inf, 0, False
        self._forget()

    def _forget(self) -> None:
        self._pace, self._brackets = AitkenRelaxation(LEAST_SHARE), _Brackets()
        self._sums: tuple[float, float] | None = None

    def renew(self, shape: StripShape) -> float:
        """Update the bounds from the current state; return their change, relative to their sum."""
        cable, grip = self.cable, self.cable.state.law.lateral
        assert grip is not None
        if not cable.taut:
            return 0.0
        # Only sliding at nearly constant bounds is real.
        nearly = self.change < NEARLY
        found, moving = _bounds(cable, grip, shape, settled=nearly)
        self.change = _change(grip.bounds, found)
        if self.change <= SETTLED and not nearly:
            found, moving = _bounds(cable, grip, shape, settled=True)
            self.change = _change(grip.bounds, found)
        total, used = float(found.sum()), float(grip.bounds.sum())
        renewed, turn = _turned(cable, grip, shape)
        self._updates += 1
        self._cycles |= self._updates > CYCLES and self.change > NEARLY
        if self._cycles and grip.known:
            self._brackets.narrow(grip.supports, grip.bounds, found)
            found = np.where(self._brackets.closed(SETTLED * used), grip.bounds, found)
            self.change, total = _change(grip.bounds, found), float(found.sum())
        if used > 0.0:
            self.change = max(self.change, turn / used)
        if self.change <= SETTLED:  # keep the bounds that belong to the state
            return self.change
        if not grip.known or np.any(moving != grip.moving):  # another law from here on
            self._forget()
        elif total > 0.0 < used:
            shares = grip.bounds / used
            change = found / total - shares
            part = self._pace.factor(grip.supports, change)
            found = np.asarray(self._fixed_point(used, total) * (shares + part * change))
            if self._cycles:
                found = self._brackets.inside(found)
        cable.update(lateral=replace(renewed, bounds=found, moving=moving, known=True))
        return self.change

    def _fixed_point(self, used: float, found: float) -> float:
        """Secant estimate, in logarithms, of the fixed point of the sum."""
        here, slope = (float(np.log(used)), float(np.log(found))), 0.0
        if self._sums is not None and here[0] != self._sums[0]:
            slope = (here[1] - self._sums[1]) / (here[0] - self._sums[0])
        self._sums = here
        step = (here[1] - here[0]) / (1 - min(max(slope, -MIN_SLOPE), MAX_SLOPE))
        return float(np.exp(here[0] + step))


def _change(used: Array, found: Array) -> float:
    """Change of the bounds, relative to their sum."""
    total, before = float(found.sum()), float(used.sum())
    if before == 0.0 == total:
        return 0.0
    return float(np.abs(found - used).sum()) / max(total, 1e-3 * before)


def _turned(
    cable: LaidCable, grip: LateralFrictionState, shape: StripShape
) -> tuple[LateralFrictionState, float]:
    """Friction with the cone and along the line of the current state, and the sum of its changes of
    forces along the edges (force)."""
    friction = cable.cable.sideways
    assert friction is not None
    slips = node_slips(cable, grip.curve, shape, grip.line)
    line = slipped_line(cable, slips, shape) or grip.line
    renewed = replace(grip, cone=law_sideways(cable, grip, shape), line=line)
    turned = node_slips(cable, renewed.curve, shape, renewed.line)
    changes = slip_forces(friction, renewed, turned) * turned.slope
    changes -= slip_forces(friction, grip, slips) * slips.slope
    return renewed, float(np.abs(changes / slips.size).sum())


def _bounds(
    cable: LaidCable, grip: LateralFrictionState, shape: StripShape, settled: bool
) -> tuple[Array, Array]:
    """Friction bounds in the current state (force), and sliding directions of the nodes."""
    friction = cable.cable.sideways
    assert friction is not None
    slips = node_slips(cable, grip.curve, shape, grip.line)
    moving = grip.moving.copy()
    rows = grip.rows(slips.supports)
    if settled:
        starts = (np.abs(slips.slip) > TOL.sliding * slips.size) & (moving[rows] == 0.0)
        moving[rows] = np.where(starts, np.sign(slips.slip), moving[rows])
    in_motion = (moving[rows] != 0.0) | (slips.moving * slips.slip > 0.0)
    coefficients = np.full(len(grip.supports), friction.at_rest)
    coefficients[rows] = np.where(in_motion, friction.mu, friction.at_rest)
    return coefficients * contact_forces(cable, shape).bearing[held_nodes(cable)], moving


CLAMPED = 10.0
"""Largest logarithm of the tension ratio at clamps, more than any cable has."""

MAX_ITERATIONS, TURNED = 30, 1e-6
"""Limit of iterations for the friction's direction, and relative change of slips at convergence."""


@dataclass(frozen=True)
class _Law:
    """Solved Coulomb law along a cable."""

    most: Array  # (n,) largest logarithm of the tension ratio at nodes
    eps: Array  # (n,) slips at which it is reached (length)
    elastic: Array  # (n,) largest elastic slips (length)
    slips: Array  # (n,) (length)
    unstressed: Array  # (n + 1,) unstressed lengths of the spans (length)


class AxialIteration:
    """Iterates one cable's axial bounds to those of the resulting state."""

    settled = 1e-4
    """Change of the tensions, relative to the sum of the bounds, below which these have settled.
    Being sharper than for lateral friction costs one short pass."""

    def __init__(self, cable: LaidCable) -> None:
        self.cable = cable
        self._pace = AitkenRelaxation(LEAST_PART)

    def renew(self, shape: StripShape) -> float:
        """Update the bounds from the current state; return the relative change of tension."""
        cable, grip = self.cable, self.cable.state.law.axial
        assert grip is not None
        if not cable.taut or cable.length <= cable.L0 or len(grip.spans) != len(grip.supports) + 1:
            return 0.0
        places, EA = reference_arcs(cable, shape), cable.cable.EA
        wrap = cable.cable.along * wrap_angles(cable, shape)[places.nodes]
        clamped = np.isin(places.nodes, cable.clamped)
        if clamped.any():
            wrap[clamped] = self._held_ratios(clamped)
        law = self._law(places, wrap, shape)
        strains = (grip.spans - law.unstressed) / law.unstressed
        mean, eps = np.sqrt(strains[1:] * strains[:-1]), law.eps
        bounds = EA * capstan_bounds(mean, law.most, law.slips / eps)
        if clamped.any():
            bounds[clamped] = held_by_clamps(cable)[0]
        total, used = float(bounds[~clamped].sum()), float(grip.bounds[~clamped].sum())
        if used == 0.0 == total:
            return 0.0
        # The tension counts: as nodes move along edges, neighbours share it differently.
        changes = np.where(clamped, 0.0, bounds - grip.bounds)
        if cable.cable.cone:  # the width depends on the other slips
            before = np.where(grip.bounds > 0.0, grip.eps, 1.0)
            changes = coulomb_forces(law.slips, bounds, eps)
            changes -= coulomb_forces(grip.slips, grip.bounds, before)
            changes[clamped] = 0.0
            most = EA * capstan_bounds(mean, wrap, np.zeros(len(wrap)))
            total = float(most[~clamped].sum())
        error = np.abs(np.cumsum(changes)).max()
        change = float(error) / max(total, 1e-3 * used)
        if change > self.settled:  # else keep the bounds that belong to the state
            tensions = between_contacts(cable, EA * strains)
            elastic = law.elastic
            if used > 0.0:
                part = self._pace.factor(grip.supports, changes)
                # Without friction, now or before, eps has no meaning.
                before = np.where(grip.bounds > 0.0, grip.eps, eps)
                eps = (1 - part) * before + part * np.where(wrap > 0.0, eps, before)
                bounds = (1 - part) * grip.bounds + part * bounds
            elastic = elastic if cable.cable.cone else eps
            cable.update(
                axial=replace(grip, bounds=bounds, eps=eps, elastic=elastic, tensions=tensions)
            )
        return change

    def _held_ratios(self, clamped: Booleans) -> Array:
        """Logarithms of the tension ratios that clamps hold, at the current tensions on both sides:
        with P = T + T^2/(2 EA) the grip is P2 - P1."""
        cable, grip = self.cable, self.cable.state.law.axial
        assert grip is not None
        unstressed = np.diff([0.0, *grip.arcs, cable.L0 + cable.state.law.smoothing_length])
        strains = np.maximum((grip.spans - unstressed) / unstressed, EPSILON)
        mean = np.sqrt(strains[1:] * strains[:-1])[clamped]
        held = held_by_clamps(cable)[0] / cable.cable.EA
        low: Array = np.zeros(len(mean))
        high: Array = np.full(len(mean), CLAMPED)
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            less = capstan_bounds(mean, middle, np.ones(len(mean))) < held
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        return high

    def _law(self, places: RestPlaces, wrap: Array, shape: StripShape) -> _Law:
        """Solve Coulomb's law along the cable for the lengths of its spans."""
        cable, grip = self.cable, self.cable.state.law.axial
        assert grip is not None
        slips, unstressed = grip.slips.copy(), np.zeros(len(grip.spans))
        full = full_slips(cable, places.size, wrap)
        clamped = np.isin(places.nodes, cable.clamped)
        if clamped.any():
            full[clamped] = held_by_clamps(cable)[1]
        L0 = cable.L0 + cable.state.law.smoothing_length
        if not cable.cable.cone or cable.state.law.lateral is None:
            find_slips(LAW, grip.spans, places.rest, L0, wrap, full, slips, unstressed)
            return _Law(wrap, full, full, slips, unstressed)
        sideways = slips_sideways(cable, cable.state.law.lateral, shape, places.nodes)
        for _ in range(MAX_ITERATIONS):
            before, along = slips.copy(), Slip.of(cable.cable.along, slips, full)
            bound, width, elastic = law_along(sideways, along)
            bound[clamped] = width[clamped] = elastic[clamped] = 1.0
            most, eps = wrap * bound, full * width
            find_slips(LAW, grip.spans, places.rest, L0, most, eps, slips, unstressed)
            if np.abs(slips - before).max(initial=0.0) <= TURNED * np.abs(slips).max(initial=0.0):
                break
        return _Law(most, eps, full * elastic, slips, unstressed)


def capstan_bounds(mean: Array, wrap: Array, y: Array) -> Array:
    """Friction bounds (n,), relative to EA, for which the potential has the law's tensions."""
    # With tensions T1, T2 and P = T + T^2/(2 EA), the work of the tension per unstressed arc, the
    # bound is (P2 - P1)/f'(y); T2 - T1 = 2 sqrt(T1 T2) sinh(wrap/2) of a sliding node is written
    # such that it is accurate for small angles.
    share = np.minimum(np.abs(y), 1.0)
    z = wrap * share * (2.0 - share)
    return wrap * (mean * _sinhc(z / 2) + mean**2 * _sinhc(z))


def _sinhc(x: Array) -> Array:
    """sinh(x)/x."""
    small = np.abs(x) < 1e-4
    return np.where(small, 1 + x**2 / 6, np.sinh(x) / np.where(small, 1.0, x))
