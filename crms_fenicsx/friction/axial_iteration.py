"""Passes that settle the friction forces along a cable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.contact_force import wrap_angles
from crms_fenicsx.energies.capstan_chain import LAW, find_slips
from crms_fenicsx.friction.aitken import AitkenRelaxation
from crms_fenicsx.friction.axial import LEAST_PART, between_contacts, reference_arcs
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array

SETTLED = 1e-4
"""Change of the tensions, relative to the sum of the bounds, below which these have settled. What
is sharper than sideways costs one short pass here."""


class AxialIteration:
    """Brings the bounds of one cable in a load step to those of the state that they lead to."""

    settled = SETTLED

    def __init__(self, cable: LaidCable) -> None:
        self.cable = cable
        self._pace = AitkenRelaxation(LEAST_PART)

    def renew(self, shape: StripShape) -> float:
        """Take the bounds from the current state.

        Returns
        -------
        Change of the tension that follows from them, relative to their sum.
        """

        cable, grip = self.cable, self.cable.axial
        assert grip is not None
        strain = cable.length / cable.L0 - 1
        if not cable.taut or strain <= 0.0 or len(grip.spans) != len(grip.supports) + 1:
            return 0.0
        friction, EA = cable.cable.friction, cable.cable.EA
        places = reference_arcs(cable, shape)
        wrap = cable.cable.along * wrap_angles(cable, shape)[places.nodes]
        # The slip of a node that just holds, relative to what its force stretches one cell by: so
        # sticking is much stiffer than the cable on every mesh, however stiff the cable is.
        eps = np.where(wrap > 0, friction.tolerance * places.size * wrap * strain, 1.0)  # type: ignore[union-attr]
        slips, unstressed = grip.slips.copy(), np.zeros(len(grip.spans))
        L0 = cable.L0 + cable.excess
        find_slips(LAW, grip.spans, places.rest, L0, wrap, eps, slips, unstressed)
        strains = (grip.spans - unstressed) / unstressed
        bounds = EA * capstan_bounds(np.sqrt(strains[1:] * strains[:-1]), wrap, slips / eps)
        total, used = float(bounds.sum()), float(grip.bounds.sum())
        if used == 0.0 == total:
            return 0.0
        # What counts is the tension: as nodes move along their edges, neighbours share differently.
        error = np.abs(np.cumsum(bounds - grip.bounds)).max()
        change = float(error) / max(total, 1e-3 * used)
        if change > self.settled:  # the state found stays the one that belongs to its bounds
            tensions = between_contacts(cable, EA * strains)
            if used > 0.0:
                part = self._pace.factor(grip.supports, bounds - grip.bounds)
                # Where nothing holds the cable, now or before, eps has no meaning.
                before = np.where(grip.bounds > 0.0, grip.eps, eps)
                eps = (1 - part) * before + part * np.where(wrap > 0.0, eps, before)
                bounds = (1 - part) * grip.bounds + part * bounds
            cable.update(axial=replace(grip, bounds=bounds, eps=eps, tensions=tensions))
        return change


def capstan_bounds(mean: Array, wrap: Array, y: Array) -> Array:
    """Friction bounds with which the potential has the tensions of the law, relative to EA.

    Parameters
    ----------
    mean : (n,)
        Geometric mean of the strains beside each node.
    wrap : (n,)
        Coefficient of friction times angle of wrap.
    y : (n,)
        Slip relative to the one at which friction is fully mobilised.

    Notes
    -----
    With the tensions T1 and T2 and ``P = T + T^2/(2 EA)``, the work of the tension per unstressed
    arc, it is ``(P2 - P1)/f'(y)``; the difference ``T2 - T1 = 2 sqrt(T1 T2) sinh(wrap/2)`` of a
    node that slides is written so that it stays accurate for small angles.
    """
    share = np.minimum(np.abs(y), 1.0)
    z = wrap * share * (2.0 - share)
    return wrap * (mean * _sinhc(z / 2) + mean**2 * _sinhc(z))


def _sinhc(x: Array) -> Array:
    """sinh(x)/x."""
    small = np.abs(x) < 1e-4
    return np.where(small, 1 + x**2 / 6, np.sinh(x) / np.where(small, 1.0, x))
