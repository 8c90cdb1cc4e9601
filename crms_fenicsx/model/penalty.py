"""The factor of the penalty that keeps unfolded cells triangles."""

from __future__ import annotations

import warnings

from mpi4py import MPI

from crms_fenicsx.runtime.errors import PenaltyWarning

STABLE_PENALTY = (1e-3, 1.0)
"""Penalty factors between which folded cells are stable and do not lock."""


def warn_of_penalty(comm: MPI.Intracomm, penalty: float) -> None:
    """Warn on rank 0 of a factor for which folded cells are not sound."""
    lower, upper = STABLE_PENALTY
    if lower <= penalty <= upper or comm.rank > 0:
        return
    happens = (
        "folded cells are unstable, as sides in compression repel their fold points"
        if penalty < lower
        else "folded cells lock and cables come out too tight"
    )
    warnings.warn(
        f"Scene: penalty = {penalty:g} lies outside {lower:g} ... {upper:g}: {happens}; give one "
        "in this range.",
        PenaltyWarning,
        stacklevel=3,
    )
