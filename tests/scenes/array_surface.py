"""A triangulated surface from arrays, for paths that are pulled taut on it."""

from __future__ import annotations

from collections.abc import Container, Mapping

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.surface.points import Edge
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells, Ring, ring_of


class ArraySurface:
    """A surface from arrays; its edges are straight where no other length is given.

    Parameters
    ----------
    cells
        (m, 3) vertex ids.
    points
        (n, 3) or (n, 2) positions (length); a vertex's id is its row.
    lengths
        Lengths of edges (a, b), a < b, that are not straight.
    complete
        Vertices around which all cells are given; None for all.

    Raises
    ------
    InputError
        Arrays of other shapes, or ids that are no rows of `points`.
    """

    def __init__(
        self,
        cells: ArrayLike,
        points: ArrayLike,
        lengths: Mapping[Edge, float] | None = None,
        complete: Container[int] | None = None,
    ) -> None:
        self._cells = np.asarray(cells, dtype=np.int64)
        self._points = np.asarray(points, dtype=np.float64)
        for name, array, columns in (
            ("cells", self._cells, (3,)),
            ("points", self._points, (2, 3)),
        ):
            if array.ndim != 2 or array.shape[1] not in columns:
                raise InputError(
                    f"{name} of a surface have shape {array.shape}; give one row for each, of "
                    f"{' or '.join(map(str, columns))} numbers."
                )
        if self._cells.size and not 0 <= self._cells.min() <= self._cells.max() < len(self._points):
            raise InputError(
                f"cells of a surface use ids from {self._cells.min()} to {self._cells.max()}; "
                f"give rows of the {len(self._points)} points."
            )
        self._lengths = {} if lengths is None else lengths
        self._complete = complete
        corners = self._cells.ravel()
        self._order = np.argsort(corners, kind="stable") // 3
        self._start = np.searchsorted(np.sort(corners), np.arange(len(self._points) + 1))
        self._rings: dict[int, Ring] = {}

    def length(self, edge: Edge) -> float:
        """Return the length of an edge; see `Surface.length`."""
        given = self._lengths.get(edge)
        if given is not None:
            return float(given)
        return float(np.linalg.norm(self._points[edge[1]] - self._points[edge[0]]))

    def opposite_vertices(self, edge: Edge) -> tuple[int, ...]:
        """Return the vertices opposite to an edge; see `Surface.opposite_vertices`."""
        a, b = edge
        return tuple(next(v for v in pair if v != b) for pair in self._link(a) if b in pair)

    def ring(self, vertex: int) -> Ring:
        """Return the neighbours of a vertex in order; see `Surface.ring`.

        Raises
        ------
        MissingCells
            Not all cells around it are given.
        MeshError
            They do not form one fan.
        """
        if self._complete is not None and vertex not in self._complete:
            raise MissingCells([vertex])
        if vertex not in self._rings:
            self._rings[vertex] = ring_of(vertex, self._link(vertex))
        return self._rings[vertex]

    def _link(self, vertex: int) -> list[Edge]:
        """Return the sides opposite to a vertex in its cells."""
        if not 0 <= vertex < len(self._points):
            return []
        rows = self._order[self._start[vertex] : self._start[vertex + 1]]
        corners = self._cells[rows]
        others = corners[corners != vertex].reshape(-1, 2)
        return list(zip(others[:, 0].tolist(), others[:, 1].tolist(), strict=True))
