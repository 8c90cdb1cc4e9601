"""Blocks of three components with their positions, and linear constraints between them.

*Tied points* are weighted means of vertices; *sliders* move along a straight line or in a plane.
Both are a change of variables x = P y: positions are set to P y, forces and stiffness become P^T g
and P^T K P. A slider's P is a projector: d d^T for the direction d of a line, I - n n^T for the
normal n of a plane, so a point that starts on the line or in the plane stays there.
"""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


class LocalBlocks:
    """Positions, held components, tied points and sliders of this process's blocks.

    Attributes: `n_local`: number of blocks; `held` (n, 3), bool: components with a prescribed
    value. Shapes and units: X (n, 3) (length).
    """

    def __init__(self, X: Array) -> None:
        self.X, self.n_local = X, len(X)
        self.held = np.zeros((len(X), 3), dtype=bool)
        none = np.zeros(0, dtype=np.int32)
        self.set_tied_points(none, none.reshape(0, 3), np.zeros((0, 3)))
        self.set_sliders(none, np.zeros((0, 3, 3)))

    def set_tied_points(
        self,
        tied_points: Indices,
        interpolation: Indices,
        weights: Array,
        n_loaded: int | None = None,
    ) -> None:
        """Tie points to vertices, as weighted means; `X` must hold the positions of all these
        blocks. Shapes: tied points (n,), interpolation, weights (n, 3)."""
        self.tied_points, self.interpolation, self.weights = tied_points, interpolation, weights
        self.n_tied_points, self.n_loaded = (
            len(tied_points),
            len(tied_points) if n_loaded is None else n_loaded,
        )
        self.held[tied_points] = True
        self._undisplaced = (
            np.einsum("nk,nki->ni", weights, self.X[interpolation]) - self.X[tied_points]
        )
        loaded = interpolation[: self.n_loaded]
        self._loaded_components = (3 * loaded[:, :, None] + np.arange(3)).ravel()

    def place_tied_points(self, x: Array) -> None:
        """Move the tied points with forces, the first `n_loaded`, with their vertices."""
        if self.n_loaded:
            self._place(slice(0, self.n_loaded), x)

    def place_idle_tied_points(self, x: Array) -> None:
        """Move the tied points without forces with their vertices."""
        if self.n_loaded < self.n_tied_points:
            self._place(slice(self.n_loaded, self.n_tied_points), x)

    def _place(self, some: slice, x: Array) -> None:
        moved = np.einsum("nk,nki->ni", self.weights[some], x[self.interpolation[some]])
        x[self.tied_points[some]] = moved + self._undisplaced[some]

    def set_sliders(self, sliders: Indices, projectors: Array) -> None:
        """Restrict the displacements of sliders (n,), and of no other blocks, by projectors
        (n, 3, 3), symmetric and idempotent."""
        self.sliders, self.projectors = np.asarray(sliders, dtype=np.intp), projectors
        self.n_sliders = len(sliders)
        self._at_sliders, self._projected = np.zeros((2, self.n_sliders, 3))

    def project(self, values: Array) -> None:
        """Project the sliders' vectors in `values` (n_local, 3), in place."""
        if self.n_sliders:
            np.take(values, self.sliders, axis=0, out=self._at_sliders, mode="clip")
            np.einsum("nij,nj->ni", self.projectors, self._at_sliders, out=self._projected)
            values[self.sliders] = self._projected

    def transfer_tied_forces(self, g: Array) -> None:
        """Transfer the tied points' forces to their vertices."""
        if self.n_loaded:
            tied_points = self.tied_points[: self.n_loaded]
            parts = self.weights[: self.n_loaded, :, None] * g[tied_points][:, None, :]
            # component by component: six times as fast as by rows of three
            np.add.at(g.reshape(-1), self._loaded_components, parts.ravel())
            g[tied_points] = 0.0

    def tie_weights(self) -> tuple[Indices, Array]:
        """Blocks that carry each block, and their weights, (n_local, 3)."""
        blocks = np.zeros((self.n_local, 3), dtype=np.int32)
        shares = np.zeros((self.n_local, 3))
        blocks[:, 0], shares[:, 0] = np.arange(self.n_local), 1.0
        blocks[self.tied_points], shares[self.tied_points] = self.interpolation, self.weights
        return blocks, shares

    def spread(self, rows: Indices, cols: Indices) -> tuple[Indices, Indices, Array]:
        """Distribute stiffness blocks at rows, cols (n,), those of tied points to their vertices.
        Returns places (2, m): local rows and columns; sources, weights (m,): block and weight."""
        if self.n_tied_points == 0:
            return np.stack([rows, cols]), np.arange(len(rows), dtype=np.int32), np.ones(len(rows))
        blocks, share = self.tie_weights()
        rides = np.zeros(self.n_local, dtype=bool)
        rides[self.tied_points] = True
        spreads = rides[rows] | rides[cols]
        some, plain = np.flatnonzero(spreads), np.flatnonzero(~spreads)
        parts = share[rows[some]][:, :, None] * share[cols[some]][:, None, :]
        part, i, j = np.nonzero(parts)
        entry = some[part]
        order = np.argsort(np.concatenate([plain, entry]), kind="stable")
        places = np.stack(
            [
                np.concatenate([rows[plain], blocks[rows[entry], i]])[order],
                np.concatenate([cols[plain], blocks[cols[entry], j]])[order],
            ]
        )
        weights = np.concatenate([np.ones(len(plain)), parts[part, i, j]])[order]
        return places, np.concatenate([plain, entry])[order].astype(np.int32), weights

    def project_blocks(self, rows: Integers, cols: Integers, values: Array) -> Array:
        """Project the sliders' stiffness blocks (n, 3, 3): P_row K P_col."""
        number = np.full(self.n_local, -1)
        number[self.sliders] = np.arange(self.n_sliders)
        values = values.copy()
        at = np.flatnonzero(number[rows] >= 0)
        values[at] = self.projectors[number[rows[at]]] @ values[at]
        at = np.flatnonzero(number[cols] >= 0)
        values[at] = values[at] @ self.projectors[number[cols[at]]]
        return values
