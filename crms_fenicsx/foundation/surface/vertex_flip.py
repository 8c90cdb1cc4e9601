"""Arcs around a vertex, and the flips over vertices that shorten a taut string.

Flips need an intrinsic view of the surface only: edge lengths, and the order of cells at a vertex.
Vertex coordinates do not matter, so a cell folded along a cable enters with the lengths of its
folded edges.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from crms_fenicsx.foundation.meshes.edge_table import line_of
from crms_fenicsx.foundation.runtime.errors import MeshError, PathError
from crms_fenicsx.foundation.surface.corridor import (
    Corridor,
    corner_angle,
    why_invalid,
    without_detours,
)
from crms_fenicsx.foundation.surface.points import Edge, Support, edge_of


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


def ring_of(vertex: int, cells: Iterable[Sequence[int]]) -> Ring:
    """Ring of a vertex from the corners of its cells, in any order; it may be left out of these."""
    link = [edge_of(*(v for v in cell if v != vertex)) for cell in cells]
    line, ends = line_of(link)
    if len(line) != len(link) + 1:
        raise MeshError(
            f"the cells around vertex {vertex} do not form one fan; "
            "pass a surface whose vertices each have their cells side by side."
        )
    return Ring(tuple(line if ends else line[:-1]), closed=not ends)


@dataclass(frozen=True)
class _OtherSide:
    """A corridor led around the other side of a vertex."""

    corridor: Corridor  # after the change
    # left, taken: replaced supports (edges at the vertex, or the vertex itself), and new ones
    left: Corridor
    taken: Corridor


def other_side(
    supports: Corridor, surface: IntrinsicSurface, vertex: int, upward: bool | None = None
) -> _OtherSide | None:
    """Lead a corridor around the other side of a vertex; None if no cable could follow it."""
    run = [i for i, s in enumerate(supports) if vertex in s and len(s) < 3]
    inner = [i for i in run if 0 < i < len(supports) - 1]
    inner = [i for i in inner if len(supports[i]) == 1] or inner  # only visits, if there are any
    if not inner or inner != list(range(inner[0], inner[-1] + 1)):
        return None
    first, last = inner[0], inner[-1]
    ring = surface.ring(vertex)
    if not {*supports[first - 1], *supports[last + 1]} <= {vertex, *ring.neighbours}:
        return None
    arcs = Arcs(vertex, ring, supports[first - 1], supports[last + 1])
    own = supports[first : last + 1]
    if upward is None:
        upward = arcs.up != own
    other = arcs.up if upward else arcs.down
    if other is None or other == own:
        return None
    new = without_detours([*supports[:first], *other, *supports[last + 1 :]])
    if why_invalid(new, surface.opposite_vertices) is not None:
        return None
    return _OtherSide(new, own, other)


class EdgeLengths(dict[Edge, float]):
    """Lengths of the edges requested so far."""

    def __init__(self, surface: IntrinsicSurface) -> None:
        super().__init__()
        self._surface = surface

    def __missing__(self, edge: Edge) -> float:
        value = self[edge] = float(self._surface.length(edge))
        if not 0.0 < value < math.inf:
            raise PathError(
                f"edge {edge} near a path has length {value}; "
                "pass a surface whose edges have positive, finite lengths."
            )
        return value


class Arcs:
    """The two arcs around a vertex between adjacent supports; None for one outside the surface."""

    def __init__(self, vertex: int, ring: Ring, a: Support, b: Support) -> None:
        # Positions around the ring are numbered: 2 i at neighbour i, 2 i + 1 in the cell between
        # neighbours i and i + 1. `up` goes with the numbers, `down` against them.
        self.vertex, self.ring = vertex, ring
        p, q = self._place(a), self._place(b)
        self.reversed = not ring.closed and p > q
        if self.reversed:
            p, q = q, p
        self._ends = p, q
        n = len(ring.neighbours)
        up = self._spokes(p, q if q >= p else q + 2 * n)
        down = self._spokes(q, p if p >= q else p + 2 * n)[::-1] if ring.closed else None
        self.up: Corridor | None = up
        self.down: Corridor | None = down
        if self.reversed:
            self.up, self.down = None, up[::-1]

    def _place(self, support: Support) -> int:
        neighbours = self.ring.neighbours
        at = sorted(neighbours.index(v) for v in support if v != self.vertex)
        if len(at) == 1:
            return 2 * at[0]
        return 2 * at[0] + 1 if at[1] == at[0] + 1 else 2 * at[1] + 1

    def _spokes(self, p: int, q: int) -> Corridor:
        neighbours = self.ring.neighbours
        return tuple(
            edge_of(self.vertex, neighbours[i % len(neighbours)])
            for i in range(p // 2 + 1, (q + 1) // 2)
        )

    def angle(
        self, lengths: EdgeLengths, arriving: dict[int, float], leaving: dict[int, float]
    ) -> float:
        """Angle (rad) of the only arc inside the surface, or of the arc `up`."""
        p, q = self._ends
        neighbours = self.ring.neighbours
        n = len(neighbours)
        if self.reversed:
            arriving, leaving = leaving, arriving
        i, j = (p + 1) // 2, (q if q >= p else q + 2 * n) // 2
        parts = [
            corner_angle(self.vertex, neighbours[k % n], neighbours[(k + 1) % n], lengths)
            for k in range(i, j)
        ]
        if p % 2:
            parts.append(arriving[neighbours[i % n]])
        if q % 2:
            parts.append(leaving[neighbours[j % n]])
        return math.fsum(parts)


TIE = 1e-6
"""Difference (rad) below which two angles count as equal.

A computed symmetric shape is symmetric only to the solver's tolerance. A cable on a ridge with a
smaller asymmetry is in equilibrium to the same accuracy.
"""
TOGETHER = 0.5
"""Turn, relative to the sharpest one, above which vertices are flipped in the same sweep.

On a convex surface there is a geodesic on either side of a vertex. Flipping all at once ends more
often in the longer one (by about 1e-4); flipping one by one takes ten times as long.
"""


@dataclass(frozen=True)
class Hold:
    """A vertex that may hold the string: a bend of it, or a visit of the path."""

    vertex: int  # its id
    first: int  # first, last: the path's supports at the vertex, both included
    last: int
    strip_angle: float | None  # angle (rad) on the strip's side of a bend; None for a visit
    # arriving, leaving: angles (rad) of the string before and after a visit to edges at the vertex
    arriving: dict[int, float] = field(default_factory=dict)
    leaving: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Flip:
    """An arc around a vertex that would shorten the string."""

    angle: float  # angle at the vertex on that side (rad)
    vertex: int  # its id
    first: int  # first, last: the supports to be replaced, both included
    last: int
    spokes: Corridor  # the edges to cross instead
    cells: frozenset[Support]  # the cells and edges of the new links


def ordered(flips: Sequence[Flip], middle: int) -> list[Flip]:
    """Flips sorted by angle; equal ones from the middle of the path to its ends."""
    flips = sorted(flips, key=lambda flip: (flip.angle, flip.first))
    rank = dict.fromkeys(range(len(flips)), 0)
    for i in range(1, len(flips)):
        equal = flips[i].angle <= flips[rank[i - 1]].angle + TIE
        rank[i] = rank[i - 1] if equal else i
    keys = [(rank[i], abs(f.first + f.last - middle), f.first) for i, f in enumerate(flips)]
    return [flips[i] for i in sorted(range(len(flips)), key=keys.__getitem__)]


def compatible(flips: Sequence[Flip]) -> list[Flip]:
    """The first flip and others that turn nearly as sharply, without common cells."""
    chosen: list[Flip] = []
    least = TOGETHER * (math.pi - flips[0].angle) - TIE if flips else 0.0
    busy: set[int] = set()
    cells: set[Support] = set()
    for flip in flips:
        if math.pi - flip.angle < least:
            continue
        # supports that stay may be shared: the string crosses both of their sides
        own = range(flip.first, flip.last + 1)
        around = range(flip.first - 1, flip.last + 2)
        if busy.isdisjoint(around) and cells.isdisjoint(flip.cells):
            chosen.append(flip)
            busy.update(own)
            cells |= flip.cells
    return chosen
