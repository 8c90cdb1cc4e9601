"""Recovered values of the membrane at its vertices, and the utilisation that is judged.

Cells have one value each, which jumps from cell to cell and belongs to none of its points in
particular. The recovered value of a vertex is the mean of the cells around it, weighted by area (O.
C. Zienkiewicz and J. Z. Zhu, 1987); only cells of one material and one pair of strengths are
averaged. It is exact where the field is uniform. Where the field is linear it is exact at vertices
whose cells lie symmetrically, and elsewhere, such as at edges, off by the gradient times a part of
a cell, so that it converges with the cells' size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.model.strengths import ALL
from crms_fenicsx.results.membrane_results import MembraneResults, nodal_means
from crms_fenicsx.results.reinforcement import Patch, reinforced


def recovered(results: MembraneResults, name: str) -> Array:
    """Values of a quantity at the corners of this rank's cells, (n, 3), means of the cells around
    of the same material and strengths; NaN where these have none. Collective."""
    values, kinds = results.values(name), _kinds(results)
    space = results.membrane.nodal_values
    corners = space.dofmap.list[: len(values)]
    found = np.full((len(values), 3), np.nan)
    present = np.concatenate(results.comm.allgather(np.unique(kinds)))
    for kind in np.unique(present):
        own = kinds == kind
        masked = np.where(own, values, np.nan)
        means = nodal_means(results.membrane, name, masked, results.stress_free_areas)
        found[own] = means.x.array[corners[own]]
    return found


def _kinds(results: MembraneResults) -> Integers:
    """Number of the material and strengths of this rank's cells, the same on all ranks, (n,)."""
    membrane, n = results.membrane, len(results.state)
    tags = np.zeros(n, dtype=np.int64)
    if membrane.cell_tags is not None:
        tags += membrane.cell_tags.values[:n]
    strengths = np.zeros(n, dtype=np.int64)
    for number, part in enumerate(membrane.strengths, 1):
        strengths[slice(None) if part == ALL else results.parts[part]] = number
    return np.asarray(tags * (len(membrane.strengths) + 1) + strengths)


@dataclass(frozen=True)
class JudgedUtilisation:
    """The utilisation that summaries, reports and pictures use."""

    corners: Array  # (n, 3) recovered at the corners of this rank's cells
    patched: Booleans  # (n, 3) which of them lie in reinforcement
    # (n,) largest difference of a cell's own value from those at its corners out of reinforcement
    spread: Array

    @property
    def judged(self) -> Array:
        """Values at the corners, (n, 3), NaN in reinforcement."""
        return np.where(self.patched, np.nan, self.corners)

    @property
    def shown(self) -> Array:
        """As `judged`, with the largest other value of the cell where it has any, to draw it."""
        most = np.max(self.judged, axis=1, initial=-np.inf, where=~self.patched)
        most = np.where(np.isfinite(most), most, np.nan)
        return np.where(self.patched, most[:, None], self.corners)


def judged_utilisation(results: MembraneResults, patches: dict[str, Patch]) -> JudgedUtilisation:
    """Recover the utilisation and mark the corners in reinforcement. Collective."""
    corners = recovered(results, "utilisation")
    dofs = results.membrane.V.dofmap.list[: len(corners)]
    patched = reinforced(results.membrane.stress_free, patches)[dofs]
    away = np.abs(corners - results.values("utilisation")[:, None])
    spread = np.max(away, axis=1, initial=0.0, where=~patched)
    return JudgedUtilisation(corners, patched, spread)


def at_facets(results: MembraneResults, corners: Array) -> Array:
    """Values (m, 3) at the corners of the facets of the current surface, linear in each cell
    between those at its corners (n, 3)."""
    surface = results.surface
    dofs = results.membrane.V.dofmap.list[surface.parents]
    x = results.membrane.stress_free[dofs]
    places = surface.stress_free[surface.triangles]
    sides = x[:, 1:] - x[:, :1]
    product = np.einsum("nai,nbi->nab", sides, sides)
    away = np.einsum("nki,nai->nka", places - x[:, :1], sides)
    share = np.einsum("nab,nkb->nka", np.linalg.inv(product), away)
    weights = np.concatenate([1.0 - share.sum(axis=2, keepdims=True), share], axis=2)
    return np.einsum("nkv,nv->nk", weights, corners[surface.parents])
