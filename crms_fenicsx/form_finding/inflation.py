"""The inner pressure of a form, given or found for a volume or a rise."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.form_finding.film import Film
from crms_fenicsx.runtime.arrays import Array, Booleans

MIDDLE = 1e-6
"""Height that a vertex must have over others for each length that it is farther from the centre."""


class Inflation:
    """The inner pressure.

    Attributes: `pressure`: current pressure (force per area) to the outer side; `acts`, `is_found`:
    whether there is one, and whether it is found for a volume or a rise; `growth` (n, 3):
    derivatives of the volume by the places of this rank's vertices (length squared); `gap`,
    `gap_slope`, `size`: how far volume or rise are from what is wanted, the derivatives of that by
    the places of this rank's vertices, (n, 3), and what it is relative to. Shapes: free (n,).
    """

    def __init__(
        self,
        film: Film,
        pressure: float | None,
        volume: float | None,
        rise: float | None,
        free: Booleans,
    ) -> None:
        self.film, self.pressure = film, pressure or 0.0
        self.is_found = volume is not None or rise is not None
        self.acts = self.is_found or pressure is not None
        self._volume, self._rise, self._free = volume, rise, free
        self.size = (volume if volume is not None else rise) or 1.0
        self.gap = 0.0
        self.growth: Array = np.zeros((0, 3))
        self.gap_slope: Array = np.zeros((0, 3))

    def measure(self, x: Array) -> None:
        """Take volume and rise. Collective.

        Shapes and units: x (n, 3) (length).
        """
        self.growth = self.film.growth()
        if self._volume is not None:
            self.gap, self.gap_slope = self.film.volume() - self._volume, self.growth
        elif self._rise is not None:
            x, comm = x[: len(self.growth)], self.film.comm
            # on a flat mesh all are as high: the one in the middle
            away = np.linalg.norm(x, axis=1)
            heights = np.where(self._free, x[:, 2] - MIDDLE * away, -np.inf)
            own = (float(np.max(heights, initial=-np.inf)), comm.rank)
            _, rank = comm.allreduce(own, op=MPI.MAXLOC)
            top, self.gap_slope = 0.0, np.zeros_like(self.growth)
            if comm.rank == rank:
                crown = int(np.argmax(heights))
                top, self.gap_slope[crown, 2] = float(x[crown, 2]), 1.0
            self.gap = comm.bcast(top, root=rank) - self._rise
