"""Passes that settle the friction forces along a cable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.contact_force import wrap_angles
from crms_fenicsx.energies.capstan_chain import LAW, find_slips
from crms_fenicsx.energies.smooth_coulomb import coulomb_forces
from crms_fenicsx.friction.aitken import AitkenRelaxation
from crms_fenicsx.friction.axial import LEAST_PART, RestPlaces, between_contacts, reference_arcs
from crms_fenicsx.friction.cone import Slip, full_slips, law_along, slips_sideways
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array

SETTLED = 1e-4
"""Change of the tensions, relative to the sum of the bounds, below which these have settled. What
is sharper than sideways costs one short pass here."""


MOST_TURNS, TURNED = 30, 1e-6
"""How often the direction of the friction force is taken from the slips that it leads to, and
their change, relative to the largest one, below which it has been found."""


@dataclass(frozen=True)
class _Law:
    """Coulomb's law along a cable, solved."""

    # most, eps, elastic: (n,) most logarithm of the ratio of tensions at nodes, and the slips
    # (length) at which it is reached and that are elastic at most
    most: Array
    eps: Array
    elastic: Array
    # slips (n,), unstressed (n + 1,): slips and unstressed lengths of the spans (length)
    slips: Array
    unstressed: Array


class AxialIteration:
    """Brings the bounds of one cable in a load step to those of the state that they lead to."""

    settled = SETTLED

    def __init__(self, cable: LaidCable) -> None:
        self.cable = cable
        self._pace = AitkenRelaxation(LEAST_PART)

    def renew(self, shape: StripShape) -> float:
        """Take the bounds from the current state.

        Returns change of the tension that follows from them, relative to their sum.
        """

        cable, grip = self.cable, self.cable.axial
        assert grip is not None
        if not cable.taut or cable.length <= cable.L0 or len(grip.spans) != len(grip.supports) + 1:
            return 0.0
        places, EA = reference_arcs(cable, shape), cable.cable.EA
        wrap = cable.cable.along * wrap_angles(cable, shape)[places.nodes]
        law = self._law(places, wrap, shape)
        strains = (grip.spans - law.unstressed) / law.unstressed
        mean, eps = np.sqrt(strains[1:] * strains[:-1]), law.eps
        bounds = EA * capstan_bounds(mean, law.most, law.slips / eps)
        total, used = float(bounds.sum()), float(grip.bounds.sum())
        if used == 0.0 == total:
            return 0.0
        # What counts is the tension: as nodes move along their edges, neighbours share differently.
        changes = bounds - grip.bounds
        if cable.cable.cone:  # where other slips are the law has another width
            before = np.where(grip.bounds > 0.0, grip.eps, 1.0)
            changes = coulomb_forces(law.slips, bounds, eps)
            changes -= coulomb_forces(grip.slips, grip.bounds, before)
            total = float(EA * capstan_bounds(mean, wrap, np.zeros(len(wrap))).sum())
        error = np.abs(np.cumsum(changes)).max()
        change = float(error) / max(total, 1e-3 * used)
        if change > self.settled:  # the state found stays the one that belongs to its bounds
            tensions = between_contacts(cable, EA * strains)
            elastic = law.elastic
            if used > 0.0:
                part = self._pace.factor(grip.supports, bounds - grip.bounds)
                # Where nothing holds the cable, now or before, eps has no meaning.
                before = np.where(grip.bounds > 0.0, grip.eps, eps)
                eps = (1 - part) * before + part * np.where(wrap > 0.0, eps, before)
                bounds = (1 - part) * grip.bounds + part * bounds
            elastic = elastic if cable.cable.cone else eps
            cable.update(
                axial=replace(grip, bounds=bounds, eps=eps, elastic=elastic, tensions=tensions)
            )
        return change

    def _law(self, places: RestPlaces, wrap: Array, shape: StripShape) -> _Law:
        """Solve Coulomb's law along the cable for the lengths of its spans."""
        cable, grip = self.cable, self.cable.axial
        assert grip is not None
        slips, unstressed = grip.slips.copy(), np.zeros(len(grip.spans))
        full = full_slips(cable, places.size, wrap)
        L0 = cable.L0 + cable.excess
        if not cable.cable.cone or cable.grip is None:
            find_slips(LAW, grip.spans, places.rest, L0, wrap, full, slips, unstressed)
            return _Law(wrap, full, full, slips, unstressed)
        sideways = slips_sideways(cable, cable.grip, shape, places.nodes)
        for _ in range(MOST_TURNS):
            before, along = slips.copy(), Slip.of(cable.cable.along, slips, full)
            bound, width, elastic = law_along(sideways, along)
            most, eps = wrap * bound, full * width
            find_slips(LAW, grip.spans, places.rest, L0, most, eps, slips, unstressed)
            if np.abs(slips - before).max(initial=0.0) <= TURNED * np.abs(slips).max(initial=0.0):
                break
        return _Law(most, eps, full * elastic, slips, unstressed)


def capstan_bounds(mean: Array, wrap: Array, y: Array) -> Array:
    """Friction bounds with which the potential has the tensions of the law, relative to EA.

    With the tensions T1 and T2 and ``P = T + T^2/(2 EA)``, the work of the tension per unstressed
    arc, it is ``(P2 - P1)/f'(y)``; the difference ``T2 - T1 = 2 sqrt(T1 T2) sinh(wrap/2)`` of a
    node that slides is written so that it stays accurate for small angles. Shapes: mean (n,), wrap
    (n,), y (n,).
    """
    share = np.minimum(np.abs(y), 1.0)
    z = wrap * share * (2.0 - share)
    return wrap * (mean * _sinhc(z / 2) + mean**2 * _sinhc(z))


def _sinhc(x: Array) -> Array:
    """sinh(x)/x."""
    small = np.abs(x) < 1e-4
    return np.where(small, 1 + x**2 / 6, np.sinh(x) / np.where(small, 1.0, x))
