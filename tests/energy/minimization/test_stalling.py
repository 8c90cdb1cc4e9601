"""When a minimisation is given up for want of progress."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.energy.minimization.outcome import FALL, STAGES, Stalling


def stage_of_end(residuals: np.ndarray, energies: np.ndarray, per_stage: int = 1) -> float:
    """Stage at which the solve is given up; infinite if it is not."""
    stalling = Stalling()
    for k, (residual, energy) in enumerate(zip(residuals, energies, strict=True)):
        if stalling.ends(k / per_stage, residual, energy):
            return k / per_stage
    return np.inf


K = np.arange(8 * STAGES)


def test_residual_and_energy_that_stand_still_end_a_solve() -> None:
    """After `STAGES` stages, however the residual jumps up and down, also by Newton's method."""
    residuals = 1e-3 * (1.5 + np.sin(7.0 * K)) / 1.5
    energies = np.full(len(K), 40.0)
    assert STAGES < stage_of_end(residuals, energies) <= STAGES + 10
    assert stage_of_end(residuals, energies, 8) == np.inf  # these are fewer stages


def test_slow_fall_of_the_residual_is_progress() -> None:
    """By half in fewer stages than `STAGES`, not in more."""
    energies = np.full(len(K), -3.0)
    assert stage_of_end(0.5 ** (K / (0.8 * STAGES)), energies) == np.inf
    assert stage_of_end(0.5 ** (K / (1.5 * STAGES)), energies) < 2 * STAGES


def test_fall_of_the_energy_is_progress() -> None:
    """Relative to it, of whichever sign, also where it fades, and not by less."""
    residuals = np.full(len(K), 1e-3)
    for energy in (40.0, -40.0):
        for rate, ends in ((2.0, False), (0.5, True)):
            energies = energy - abs(energy) * rate * FALL / STAGES * K
            assert (stage_of_end(residuals, energies) < np.inf) == ends
    assert stage_of_end(residuals, 1e-9 * 0.9**K) == np.inf
