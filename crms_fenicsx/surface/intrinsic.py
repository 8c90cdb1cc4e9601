"""A triangulated surface known from inside: lengths of edges, and the order of cells at a vertex.

That is all that a path needs to be pulled taut. Coordinates of vertices do not matter, so a cell
that is folded along a cable counts with the lengths of its folded edges.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.runtime.errors import InputError, MeshError
from crms_fenicsx.surface.points import Edge


@dataclass(frozen=True)
class Ring:
    """The neighbours of a vertex, each next to the one that it shares a cell with.

    Attributes
    ----------
    neighbours
        Ids, all around the vertex or from boundary to boundary, in either sense.
    closed
        Whether the last and the first neighbour share a cell too: no boundary at the vertex.
    """

    neighbours: tuple[int, ...]
    closed: bool


class MissingStars(LookupError):  # noqa: N818 - no error: a request for data
    """Some cells around these vertices are not known here: fetch them and call again.

    Attributes
    ----------
    vertices
        Ids, ascending.
    """

    def __init__(self, vertices: Iterable[int]) -> None:
        self.vertices = tuple(sorted(set(vertices)))
        super().__init__(f"not all cells around the vertices {self.vertices} are known")


class Surface(Protocol):
    """What `shorten` asks of a surface."""

    def length(self, edge: Edge) -> float:
        """Return the length of an edge (a, b), a < b, through all fold points on it."""

    def thirds(self, edge: Edge) -> tuple[int, ...]:
        """Return the vertices opposite to an edge (a, b), a < b, in any order.

        Two, one at the boundary, none where the surface has no such edge. Those of cells that
        are not known may be left out, except at edges of the path given.
        """

    def ring(self, vertex: int) -> Ring:
        """Return the neighbours of a vertex in order.

        Raises
        ------
        MissingStars
            Not all cells around it are known.
        """


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

    def thirds(self, edge: Edge) -> tuple[int, ...]:
        """Return the vertices opposite to an edge; see `Surface.thirds`."""
        a, b = edge
        return tuple(next(v for v in pair if v != b) for pair in self._link(a) if b in pair)

    def ring(self, vertex: int) -> Ring:
        """Return the neighbours of a vertex in order; see `Surface.ring`.

        Raises
        ------
        MissingStars
            Not all cells around it are given.
        MeshError
            They do not form one fan.
        """
        if self._complete is not None and vertex not in self._complete:
            raise MissingStars([vertex])
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


def ring_of(vertex: int, link: Iterable[Edge]) -> Ring:
    """Return the ring of a vertex from the sides opposite to it in its cells, in any order.

    Raises
    ------
    MeshError
        The cells do not form one fan.
    """
    beside: dict[int, list[int]] = {}
    for a, b in link:
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    ends = [v for v, others in beside.items() if len(others) == 1]
    fan = len(ends) in (0, 2) and beside and max(map(len, beside.values())) <= 2
    walk = [min(ends or beside)] if fan else []
    while fan:
        onward = [v for v in beside[walk[-1]] if v not in walk[-2:]]
        if not onward or onward[0] == walk[0]:
            break
        walk.append(onward[0])
    if not fan or len(walk) != len(beside):
        raise MeshError(
            f"the cells around vertex {vertex} do not form one fan; "
            "give a surface on which every vertex has its cells side by side."
        )
    return Ring(tuple(walk), closed=not ends)
