"""Intrinsic view of a triangulated surface: edge lengths, and the order of cells at a vertex.

That is all that pulling a path taut needs. Vertex coordinates do not matter, so a cell folded along
a cable enters with the lengths of its folded edges.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from crms_fenicsx.foundation.runtime.errors import MeshError
from crms_fenicsx.foundation.surface.points import Edge


@dataclass(frozen=True)
class Ring:
    """The neighbours of a vertex in order: consecutive ones share a cell."""

    # ids, all around the vertex or from boundary to boundary, in either sense
    neighbours: tuple[int, ...]
    # whether the last and first neighbour share a cell too, so that the vertex is interior
    closed: bool


class MissingCells(LookupError):  # noqa: N818 - no error: a request for data
    """Cells around these vertices (ids) are missing here: fetch them and call again."""

    def __init__(self, vertices: Iterable[int]) -> None:
        self.vertices = tuple(sorted(set(vertices)))
        super().__init__(self.vertices)

    def __str__(self) -> str:
        return f"not all cells around the vertices {self.vertices} are known"


class IntrinsicSurface(Protocol):
    """Surface data that `shorten` needs."""

    def length(self, edge: Edge) -> float:
        """Length of an edge (a, b), a < b, through all fold points on it."""

    def opposite_vertices(self, edge: Edge) -> tuple[int, ...]:
        """Vertices opposite to an edge (a, b), a < b, in any order; those of unknown cells may be
        left out, except at edges of the given path."""

    def ring(self, vertex: int) -> Ring:
        """Ordered neighbours of a vertex; raises `MissingCells` if some are unknown."""


def ring_of(vertex: int, link: Iterable[Edge]) -> Ring:
    """Ring of a vertex from the opposite sides in its cells, in any order."""
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
