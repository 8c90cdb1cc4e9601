"""The inner pressure of a form, given or found for a volume or a rise."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.form_finding.film import Film
from crms_fenicsx.runtime.arrays import Array


class Inflation:
    """The inner pressure.

    Parameters
    ----------
    film
        What is inflated.
    pressure, volume, rise
        What is given (force per area; length cubed; length), the others None; none of them: there
        is no pressure.
    base
        Height above which the rise counts (length).

    Attributes
    ----------
    pressure
        Current pressure (force per area) to the outer side.
    acts, is_found
        Whether there is one, and whether it is found for a volume or a rise.
    growth : (n, 3)
        Derivatives of the volume by the places of this rank's vertices (length squared).
    gap, gap_slope, size
        How far volume or rise are from what is wanted, the derivatives of that by the places of
        this rank's vertices, (n, 3), and what it is relative to.
    """

    def __init__(
        self,
        film: Film,
        pressure: float | None,
        volume: float | None,
        rise: float | None,
        base: float,
    ) -> None:
        self.film, self.pressure = film, pressure or 0.0
        self.is_found = volume is not None or rise is not None
        self.acts = self.is_found or pressure is not None
        self._volume, self._rise, self._base = volume, rise, base
        self.size = (volume if volume is not None else rise) or 1.0
        self.gap = 0.0
        self.growth: Array = np.zeros((0, 3))
        self.gap_slope: Array = np.zeros((0, 3))

    def measure(self, x: Array) -> None:
        """Take volume and rise at places x (n, 3) of this rank's vertices. Collective."""
        self.growth = self.film.growth()
        if self._volume is not None:
            self.gap, self.gap_slope = self.film.volume() - self._volume, self.growth
        elif self._rise is not None:
            n = len(self.growth)
            comm = self.film.comm
            own = float(np.max(x[:n, 2], initial=-np.inf))
            top, rank = comm.allreduce((own, comm.rank), op=MPI.MAXLOC)
            self.gap = top - self._base - self._rise
            self.gap_slope = np.zeros_like(self.growth)
            if comm.rank == rank:
                self.gap_slope[int(np.argmax(x[:n, 2])), 2] = 1.0
