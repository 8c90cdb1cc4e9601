"""Blocks of three components with their positions, and how some move with others.

Some cable points have less freedom than three components. *Riders* are weighted means of vertices,
*rails* move along a straight line in space. Both are a change of variables x = P y: positions are
put where P has them, forces and stiffness become P^T g and P^T K P. For a rail P = d d^T, d the
line's direction; so what starts on the line stays there.
"""

from __future__ import annotations

import numpy as np

from crms_fenicsx.runtime.arrays import Array, Indices


class LocalBlocks:
    """Positions, held components, riders and rails of blocks of this process.

    Attributes: `n_local`: how many blocks there are; `held` (n, 3) bool array: components with a
    prescribed value. Shapes and units: X (n, 3) (length).
    """

    def __init__(self, X: Array) -> None:
        self.X, self.n_local = X, len(X)
        self.held = np.zeros((len(X), 3), dtype=bool)
        none = np.zeros(0, dtype=np.int32)
        self.set_riders(none, none.reshape(0, 3), np.zeros((0, 3)))
        self.set_rails(none, np.zeros((0, 3)))

    def set_riders(
        self, riders: Indices, interpolation: Indices, weights: Array, n_loaded: int | None = None
    ) -> None:
        """Let points ride on vertices: their position is a weighted mean of the vertices'.

        `X` must have the places of all these blocks. Shapes: riders (n,), interpolation, weights
        (n, 3).
        """
        self.riders, self.interpolation, self.weights = riders, interpolation, weights
        self.n_riders, self.n_loaded = len(riders), len(riders) if n_loaded is None else n_loaded
        self.held[riders] = True
        self._undisplaced = np.einsum("nk,nki->ni", weights, self.X[interpolation]) - self.X[riders]
        loaded = interpolation[: self.n_loaded]
        self._loaded_components = (3 * loaded[:, :, None] + np.arange(3)).ravel()

    def place_riders(self, x: Array) -> None:
        """Move the riders that have forces with their vertices."""
        if self.n_loaded:
            self._place(slice(0, self.n_loaded), x)

    def place_idle_riders(self, x: Array) -> None:
        """Move the riders without forces with their vertices."""
        if self.n_loaded < self.n_riders:
            self._place(slice(self.n_loaded, self.n_riders), x)

    def _place(self, some: slice, x: Array) -> None:
        moved = np.einsum("nk,nki->ni", self.weights[some], x[self.interpolation[some]])
        x[self.riders[some]] = moved + self._undisplaced[some]

    def set_rails(self, rails: Indices, directions: Array) -> None:
        """Let points be displaced along a direction only.

        Shapes: rails (n,), directions (n, 3).
        """
        self.rails, self.directions = np.asarray(rails, dtype=np.intp), directions
        self.n_rails = len(rails)
        self._at_rails, self._along = np.zeros((self.n_rails, 3)), np.zeros(self.n_rails)

    def project(self, values: Array) -> None:
        """Leave of the rails' vectors in `values` (n_local, 3) the part along their lines.

        Allocates nothing.
        """
        if self.n_rails:
            np.take(values, self.rails, axis=0, out=self._at_rails, mode="clip")
            np.einsum("ni,ni->n", self._at_rails, self.directions, out=self._along)
            np.einsum("ni,n->ni", self.directions, self._along, out=self._at_rails)
            values[self.rails] = self._at_rails

    def hand_over(self, g: Array) -> None:
        """Hand the riders' forces to their vertices."""
        if self.n_loaded:
            riders = self.riders[: self.n_loaded]
            parts = self.weights[: self.n_loaded, :, None] * g[riders][:, None, :]
            # one by one: six times as fast as by rows of three
            np.add.at(g.reshape(-1), self._loaded_components, parts.ravel())
            g[riders] = 0.0

    def spread(self, rows: Indices, cols: Indices) -> tuple[Indices, Indices, Array]:
        """Where stiffness blocks go, those of riders to their vertices.

        Shapes: rows, cols (n,). Returns places: local blocks of rows and columns, (2, m); sources,
        weights: which of the n blocks goes there, and what part of it, (m,).
        """
        if self.n_riders == 0:
            return np.stack([rows, cols]), np.arange(len(rows), dtype=np.int32), np.ones(len(rows))
        blocks = np.zeros((self.n_local, 3), dtype=np.int32)
        share = np.zeros((self.n_local, 3))
        blocks[:, 0], share[:, 0] = np.arange(self.n_local), 1.0
        blocks[self.riders], share[self.riders] = self.interpolation, self.weights
        rides = np.zeros(self.n_local, dtype=bool)
        rides[self.riders] = True
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

    def project_blocks(self, rows: Indices, cols: Indices, values: Array) -> Array:
        """Stiffness blocks (n, 3, 3) with those of rails projected: P_row K P_col."""
        number = np.full(self.n_local, -1)
        number[self.rails] = np.arange(self.n_rails)
        values = values.copy()
        at = np.flatnonzero(number[rows] >= 0)
        d = self.directions[number[rows[at]]]
        values[at] = np.einsum("ni,nk,nkj->nij", d, d, values[at])
        at = np.flatnonzero(number[cols] >= 0)
        d = self.directions[number[cols[at]]]
        values[at] = np.einsum("nik,nk,nj->nij", values[at], d, d)
        return values
