"""Which rank owns each cell: as the caller wants, and all cells at a seam together.

DOLFINx finds the vertices that ranks share at the edges that have fewer than two cells on a rank.
A seam whose cells are scattered would be torn: two ranks would each have vertices of their own
there, silently.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.meshes.orientation import connected_labels
from crms_fenicsx.meshes.surface import CheckedSurface
from crms_fenicsx.runtime.arrays import Array, Indices
from crms_fenicsx.runtime.compat import default_ranks
from crms_fenicsx.runtime.errors import MeshError

Ranks = ArrayLike | Callable[[Array], ArrayLike]
"""The rank of each cell, (m,), or a function that gives it from the cells' midpoints, (m, 3)."""


def cell_ranks(
    comm: MPI.Intracomm, surface: CheckedSurface, given: Indices | None
) -> Indices | None:
    """Ranks of this rank's share of the cells on rank 0; None lets DOLFINx choose. Collective."""
    is_given, has_seams = comm.bcast((given is not None, len(surface.seam_links) > 0))
    if comm.size == 1 or not (is_given or has_seams):
        return None
    if not is_given:
        given = default_ranks(comm, surface.cells)
    ranks, links = np.zeros(0, dtype=np.int32) if given is None else given, surface.seam_links
    if not len(links):
        return ranks
    label = connected_labels(len(ranks), links[:, 0], links[:, 1])
    least = np.full(label.max() + 1, np.iinfo(np.int32).max, dtype=np.int32)
    np.minimum.at(least, label, ranks)
    together: Indices = least[label]  # linked cells go to the lowest of their ranks
    return together


def checked_ranks(surface: CheckedSurface, ranks: Ranks, size: int) -> Indices:
    """The rank of each cell (m,) as the caller wants it."""
    midpoints = surface.points[surface.cells].mean(axis=1)
    given = np.asarray(ranks(midpoints) if callable(ranks) else ranks)
    count = len(midpoints)
    if given.shape != (count,) or given.dtype.kind not in "iu":
        raise MeshError(
            f"`ranks` is an array of {given.dtype} of shape {given.shape}: give an integer for "
            f"each of the {count} cells"
        )
    bad = np.flatnonzero((given < 0) | (given >= size))
    if len(bad):
        raise MeshError(
            f"`ranks` puts cell {bad[0]} on rank {given[bad[0]]}, but there are only ranks 0 to "
            f"{size - 1}: name one of these"
        )
    return given.astype(np.int32)
