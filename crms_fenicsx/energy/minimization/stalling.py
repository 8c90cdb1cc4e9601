"""When a minimisation that makes no progress is given up."""

from __future__ import annotations

import math

STAGES, FALL = 50, 1e-8
"""Stages without progress after which a solve ends, and fall of the energy, relative to it, that is
progress. Solves of slack membranes have gone 366 stages without half the residual, in which the
energy fell by at least 3e-7 in 100; where it fell by less than 1e-9, four of seven failed."""


class Stalling:
    """Notes when a solve has last halved its least residual or lowered its energy."""

    def __init__(self) -> None:
        self._residual, self._energy, self._stage = math.inf, math.inf, 0.0

    def ends(self, stage: float, residual: float, energy: float) -> bool:
        """Whether the solve has made no progress for long, now at this stage. Units: residual
        (force), energy (force x length)."""
        halved = residual < 0.5 * self._residual
        if halved or energy < self._energy - FALL * abs(energy):
            self._residual = min(self._residual, residual)
            self._energy, self._stage = energy, stage
        return stage - self._stage > STAGES
