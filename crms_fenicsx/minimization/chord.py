"""Is the energy convex between the start of a solve and its end?

Along the straight way from one state to the other the energy's slope rises where it is convex. At
the end's loads a stable path from the start leads down such a way, and the slope goes up to zero.
Where the slope falls in between, the energy has negative second derivatives there: something may
have snapped through. Only the slopes' ratios count, so that units and sizes do not.
"""

from __future__ import annotations

import itertools

import numpy as np
from mpi4py import MPI

from crms_fenicsx.minimization.potential import Potential
from crms_fenicsx.runtime.arrays import Array

FALL = 0.01
"""Fall of the slope, relative to the largest one, from which on the energy is not convex."""

PLACES = (0.0, 1 / 3, 2 / 3, 1.0)
"""Where the slope is found, as parts of the way; the last one is the state itself."""


def is_convex_from(potential: Potential, start: Array) -> bool:
    """Whether the energy is convex on the way from a start to the potential's state. Collective.

    It takes four evaluations; the state is afterwards as before, and evaluated. Shapes and units:
    start (n_local, 3) (length).
    """
    n, end = potential.unknowns.n_owned, potential.x.copy()
    way = end - start
    free = np.where(potential.unknowns.held[:n], 0.0, way[:n])
    slopes = np.zeros(len(PLACES))
    for k, part in enumerate(PLACES):
        potential.x[:] = end if part == 1.0 else start + part * way
        potential.place()
        potential.evaluate()
        slopes[k] = np.vdot(potential.g[:n], free)
    potential.comm.Allreduce(MPI.IN_PLACE, slopes, op=MPI.SUM)
    falls = [a - b for a, b in itertools.combinations(slopes.tolist(), 2)]
    return bool(max(falls) <= FALL * np.abs(slopes).max())
