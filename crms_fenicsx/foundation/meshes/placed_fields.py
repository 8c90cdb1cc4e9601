"""Fields per cell of a mesh as values at places: what a cell has after its vertices have moved.

The data are the values of the cells where these were. A cell whose mean corner has come to X takes

    f = f_0 + r(X) - r(X_0),

f_0 its own value, at X_0, and r the linear interpolation of vertex values, those of the linear
field that fits the cells around best. This is exact where the field is linear, and f_0 where the
cell has not moved. Where it jumps, r is smooth over a cell; the integral is kept.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from crms_fenicsx.foundation.meshes.first_surface import FirstSurface
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Indices


class PlacedFields:
    """Values of fields at places on the surface of a mesh.

    Cells are those of this rank, in its order; all methods are collective.
    """

    def __init__(self, V: fem.FunctionSpace, surface: FirstSurface, kinds: Indices) -> None:
        """Take the surface where the data are, and the kinds of this rank's cells (n,): fields may
        jump between different ones."""
        topology, points = V.mesh.topology, surface.smooth.points
        self._comm, self._surface, self._corners = V.mesh.comm, surface, V.dofmap.list
        self._own = topology.index_map(2).size_local
        self._numbers = np.asarray(topology.original_cell_index[: self._own], dtype=np.int64)
        every = self._gathered(kinds[: self._own, None].astype(float))[:, 0].astype(np.int64)
        self._kinds = every
        # (m, 3) stars of the corners: the cells of each kind around a vertex
        corners = surface.cells + len(points) * every[:, None]
        numbers, of = np.unique(corners, return_inverse=True)
        self._stars, self._count = of.reshape(-1, 3), len(numbers)
        self._areas = norm(double_areas(points[surface.cells]))
        self._centres = points[surface.cells].mean(axis=1)
        means = self._means(self._centres)
        self._aside = points[numbers % len(points)] - means  # of the vertices
        # (m, 3, 3) ways of the centres from the means; across the surface they tell nothing
        self._ways = self._centres[:, None] - means[self._stars]
        squares = self._means(self._ways[..., None] * self._ways[..., None, :])
        self._inverse = np.linalg.pinv(squares, rcond=1e-2, hermitian=True)
        # stars of centres in a line, as at corners of the rim, take the slopes of those beside
        self._known = np.linalg.matrix_rank(squares, rtol=1e-2, hermitian=True) > 1

    def values(self, data: Array, X: Array) -> Array:
        """Values (n, ...) of a field at the cells' mean corners, from its data (n, ...) and the
        places X (k, 3) of the local vertices with ghosts."""
        given = data.reshape(len(data), -1)
        every = self._gathered(given)
        if not np.ptp(every, axis=0).any():
            return data
        means = self._means(every)
        slopes = self._inverse @ self._means(
            self._ways[..., None] * (every[:, None] - means[self._stars])[:, :, None]
        )
        slopes *= self._known[:, None, None]
        count = self._means(self._known[self._stars].mean(axis=1)[:, None])[:, 0]
        beside = self._means(slopes[self._stars].mean(axis=1).reshape(len(every), -1))
        beside /= np.maximum(count, EPSILON)[:, None]
        slopes = np.where(self._known[:, None, None], slopes, beside.reshape(slopes.shape))
        vertex = means + np.einsum("vi,vik->vk", self._aside, slopes)
        now = X[self._corners[: self._own]].mean(axis=1)
        away = norm(now - self._centres[self._numbers])
        moves = np.flatnonzero(away > self._surface.least.max(initial=0.0))
        cells, shares = self._surface.cells_at(self._numbers[moves], now[moves])
        new = given.copy()
        new[moves] += (shares[:, :, None] * vertex[self._stars[cells]]).sum(axis=1)
        new[moves] -= vertex[self._stars[self._numbers[moves]]].mean(axis=1)
        return self._keeping_sums(given, new, X).reshape(data.shape)

    def _keeping_sums(self, given: Array, new: Array, X: Array) -> Array:
        """New values (n, k) with the integrals that the given ones had over the cells of each kind:
        what is missing goes to the cells whose values have changed, as their change."""
        before = self._areas[self._numbers, None]
        now = norm(double_areas(X[self._corners[: self._own]]))[:, None]
        changes = np.abs(new - given)
        parts = np.stack([before * given - now * new, now * changes])
        sums = np.zeros((2, self._kinds.max(initial=0) + 1, given.shape[1]))
        for kind in range(sums.shape[1]):
            sums[:, kind] = parts[:, self._kinds[self._numbers] == kind].sum(axis=1)
        missing, weight = self._comm.allreduce(sums)
        shares = missing / np.maximum(weight, 1e-300)
        shares[weight <= EPSILON * np.abs(missing)] = 0.0
        return np.asarray(new + changes * shares[self._kinds[self._numbers]])

    def _means(self, values: Array) -> Array:
        """Means (v, ...) by area over the cells of each star of values of their corners (m, 3,
        ...), or of cells (m, k), alike at all corners."""
        if values.ndim == 2:
            values = np.repeat(values[:, None], 3, axis=1)
        stars, weights = self._stars.ravel(), np.repeat(self._areas, 3)
        flat = values.reshape(len(stars), -1) * weights[:, None]
        total = [np.bincount(stars, column, self._count) for column in flat.T]
        found = np.stack(total, axis=1) / np.bincount(stars, weights, self._count)[:, None]
        return np.asarray(found.reshape(self._count, *values.shape[2:]))

    def _gathered(self, data: Array) -> Array:
        """Values (m, k) of all cells on all ranks, in the order of the mesh as given."""
        found = np.zeros((len(self._surface.cells), data.shape[1]))
        for numbers, some in self._comm.allgather((self._numbers, data)):
            found[numbers] = some
        return found
