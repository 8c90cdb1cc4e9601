"""Which cells to divide, by their shares in an estimated error."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Indices
from crms_fenicsx.runtime.errors import InputError

SAME = 1e-4
"""Relative difference of shares that count as the same, as of cells that mirror each other: a
solver's tolerance and the order of sums on several ranks make such differences."""


def checked_share(share: object) -> float:
    """What part of the error marked cells are to have.

    Raises
    ------
    InputError
        A number that is none of more than 0 and up to 1.
    """
    number = checks.positive("adapt: share", share)
    if number > 1.0:
        raise InputError(
            f"adapt: share = {number} is more than all of the error; give a number up to 1, as 0.5."
        )
    return number


def marked_cells(comm: MPI.Intracomm, shares: Array, share: float) -> Indices:
    """The fewest cells that have a part of all the error, and those with the same. Collective.

    Parameters
    ----------
    comm
        Ranks that have cells.
    shares : (n,)
        Of this rank's own cells, none negative.
    share
        What part of the sum they are to have, up to 1.

    Returns
    -------
    ndarray
        Local numbers of this rank's cells, the same cells on any number of ranks.

    Raises
    ------
    InputError
        On all ranks: there is no error.
    """
    gathered = comm.gather(shares)
    least = 0.0
    if gathered is not None:
        falling = -np.sort(-np.concatenate(gathered))
        sums = np.cumsum(falling)
        if sums[-1] > 0.0:
            enough = int(np.argmax(sums >= (1.0 - SAME) * share * sums[-1]))
            least = (1.0 - SAME) * float(falling[enough])
    least = comm.bcast(least)
    if least == 0.0:
        raise InputError(
            "adapt: the estimate sees no error; load the scene first, or use solver.refine()."
        )
    return np.flatnonzero(shares >= least).astype(np.int32)
