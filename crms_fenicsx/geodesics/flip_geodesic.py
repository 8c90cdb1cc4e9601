"""Shortening: a cable's path slides over the vertices that do not hold it.

A cable without friction lies along a geodesic of the surface. In the corridor of its path it is a
taut string, which bends at vertices. Seen from the strip the angle of a bend is pi or more. Where
the angle on the other side of the vertex is less than pi the string would be shorter there, and
the corridor is led around that side: a flip. A path without flips left is straight everywhere but
at vertices whose angles are pi or more on both sides, which is a geodesic.

Only lengths of edges count, so the surface may be folded along cables. All is plain geometry on
few numbers, the same on all ranks.

Source: the idea is that of edge-flip geodesics (N. Sharp and K. Crane, You can find geodesic paths
in triangle meshes by just flipping edges, ACM Trans. Graph. 39, 2020), but the mesh stays as it is.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, field
from itertools import pairwise

from crms_fenicsx.geodesics.corridor import (
    Corridor,
    cell_between,
    corridor,
    flaw,
    tied,
    without_detours,
)
from crms_fenicsx.geodesics.funnel import TautString, corner_angle, pull_taut
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import MeshError, PathError
from crms_fenicsx.surface.intrinsic import MissingStars, Ring, Surface
from crms_fenicsx.surface.points import (
    CellPoint,
    Edge,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
    edge_of,
)

__all__ = ["Corridor", "MissingStars", "Ring", "Shortened", "Surface", "corridor", "shorten"]

STRAIGHT = 1e-7
"""Angle (rad) by which the other side of a vertex must be less than pi for a flip.

A flip by less would shorten the cable by a fraction below 1e-14, which no length computed here can
show; the rounding of angles is far below it (1e-12 where cells are as thin as 1e-4).
"""
TIE = 1e-6
"""Difference (rad) below which two angles count as equal.

A symmetric shape that a solver has found is symmetric only to the solver's tolerance. A cable left
on a ridge that is less uneven than this is at rest to the same accuracy.
"""
LONGER = 1e-12
"""Growth of the length, relative, that rounding may cause: some 1e-16 for each cell unfolded."""
TOGETHER = 0.5
"""Part of the sharpest turn from which on others are flipped with it in one sweep.

On a surface that curves outward there is a geodesic on either side of a vertex. Flipping all at
once ends more often in the longer one (by about 1e-4), and one by one takes ten times as long.
"""
LEAST, MOST = sys.float_info.min, 1.0 - sys.float_info.epsilon / 2
"""Fractions of points at an edge's ends, where the string touches a vertex."""


@dataclass(frozen=True)
class Shortened:
    """A path that has been pulled taut.

    Attributes
    ----------
    points
        The path: both ends as given, and in between the taut string's own places on every edge
        that it crosses, also if they are no more than rounding away from a vertex. An end inside
        an edge that the path then follows is given as a place in a cell beside it.
    flips
        The vertices over which it has slid, in order; empty if and only if its corridor is the
        one given.
    length, before
        Lengths of the taut strings in its corridor and in the one given (length).
    """

    points: tuple[SurfacePoint, ...]
    flips: tuple[int, ...]
    length: float
    before: float


def shorten(
    points: Sequence[SurfacePoint],
    surface: Surface,
    *,
    refused: Set[Corridor] = frozenset(),
    max_flips: int | None = None,
    grip: float = STRAIGHT,
    held_at: Set[int] | None = None,
) -> Shortened:
    """Pull a path taut, and let it slide over vertices until it is a geodesic.

    Parameters
    ----------
    points
        A path (see `Path.links`). Both ends stay in place; a vertex in between holds the string
        until a flip leaves it to one side. Fractions of other points do not matter.
    surface
        Lengths and neighbours.
    refused
        Corridors that must not be taken. That of the path given is taken anyway.
    max_flips
        How many vertices it may slide over; None: as many as it takes.
    grip
        Angle (rad) by which a path that visits a vertex must bend there to leave it.
    held_at
        The only vertices that it may slide over; None: all.

    Returns
    -------
    The shortened path. With k = `max_flips` it has slid over the first k vertices that it slides
    over without a limit, unless a sweep is rejected (see the notes) with the limit or without.

    Raises
    ------
    PathError
        The path goes where the surface has no cell, or turns back, or uses an edge or a cell
        twice; or a length is not positive.
    InputError
        `max_flips` is no whole number, or negative.
    MissingStars
        The surface does not know all cells around some of the vertices that hold the string.

    Notes
    -----
    The vertex with the smallest angle on its other side comes first. In one sweep it is followed by
    all others that share no cell with those before. Equal angles are ordered by their places along
    the path, from its middle to its ends. So neither the vertices' ids nor the handedness of the
    surface decides. A sweep that is rejected is replaced by its first flip that is not.

    A flip is rejected if no cable could follow its corridor (see `corridor.flaw`), if the corridor
    is refused or was visited before, and if the taut string becomes longer. As no corridor is
    visited twice, and a surface has a finite number of those that cross no edge twice, it ends. A
    vertex from which both sides are equally short, as on the ridge of a symmetric shape, is not
    left.
    """
    limit = None if max_flips is None else checks.whole("shorten: max_flips", max_flips, 0)
    _check(points, surface)
    state = _State(points, surface, refused, grip, held_at)
    state.pull(corridor(points))
    before = state.length
    flips: list[int] = []
    while limit is None or len(flips) < limit:
        done = state.sweep(None if limit is None else limit - len(flips))
        if not done:
            break
        flips.extend(done)
    return Shortened(state.points(), tuple(flips), state.length, before)


@dataclass(frozen=True)
class OtherSide:
    """The way around a vertex on the side where a corridor does not go.

    Attributes
    ----------
    corridor
        With the new way.
    left, taken
        The edges that are crossed around the vertex, or the vertex that is visited, and what is
        crossed instead.
    """

    corridor: Corridor
    left: Corridor
    taken: Corridor


def other_side(
    supports: Corridor, surface: Surface, vertex: int, upward: bool | None = None
) -> OtherSide | None:
    """Lead a corridor around the other side of a vertex.

    Parameters
    ----------
    supports
        A corridor.
    surface
        Neighbours.
    vertex
        A vertex whose edges the corridor crosses, or that it visits.
    upward
        Whether to go around the vertex in the order of its ring, or against it; None: on the side
        where the corridor does not go. A visit needs to be told.

    Returns
    -------
    None if no cable could follow it.

    Raises
    ------
    MissingStars
        The surface does not know all cells around the vertex.
    """
    run = [i for i, s in enumerate(supports) if vertex in s and len(s) < 3]
    inner = [i for i in run if 0 < i < len(supports) - 1]
    visits = [i for i in inner if len(supports[i]) == 1]
    if visits:
        inner = visits
    if not inner or inner != list(range(inner[0], inner[-1] + 1)):
        return None
    first, last = inner[0], inner[-1]
    ring = surface.ring(vertex)
    if not {*supports[first - 1], *supports[last + 1]} <= {vertex, *ring.neighbours}:
        return None
    arcs = _Arcs(vertex, ring, supports[first - 1], supports[last + 1])
    own = supports[first : last + 1]
    if upward is None:
        upward = arcs.up != own
    other = arcs.up if upward else arcs.down
    if other is None or other == own:
        return None
    new = without_detours([*supports[:first], *other, *supports[last + 1 :]])
    if flaw(new, surface.thirds) is not None:
        return None
    return OtherSide(new, own, other)


class _Lengths(dict[Edge, float]):
    """Lengths of the edges asked for so far."""

    def __init__(self, surface: Surface) -> None:
        super().__init__()
        self._surface = surface

    def __missing__(self, edge: Edge) -> float:
        value = self[edge] = float(self._surface.length(edge))
        if not 0.0 < value < math.inf:
            raise PathError(
                f"edge {edge} near a path has length {value}; "
                "give a surface whose edges have positive, finite lengths"
            )
        return value


@dataclass(frozen=True)
class _Flip:
    """A way around a vertex that would make the string shorter.

    Attributes
    ----------
    angle
        Angle at the vertex on that side (rad).
    vertex
        Its id.
    first, last
        The supports to be replaced, both included.
    spokes
        The edges to cross instead.
    cells
        The cells and edges through which the path would go.
    """

    angle: float
    vertex: int
    first: int
    last: int
    spokes: Corridor
    cells: frozenset[Support]


@dataclass(frozen=True)
class _Hold:
    """A vertex that may hold the string: a bend of it, or a visit of the path.

    Attributes
    ----------
    vertex
        Its id.
    first, last
        The supports of the path at the vertex, both included.
    strip_angle
        Angle (rad) on the strip's side of a bend; None for a visit.
    arriving, leaving
        Angles (rad) of the string before and after a visit to edges at the vertex.
    """

    vertex: int
    first: int
    last: int
    strip_angle: float | None
    arriving: dict[int, float] = field(default_factory=dict)
    leaving: dict[int, float] = field(default_factory=dict)


class _Arcs:
    """The two ways around a vertex from one support next to it to another.

    Places around the ring are numbered: 2 i at neighbour i, 2 i + 1 in the cell between the
    neighbours i and i + 1. `up` goes with the numbers, `down` against them; None stands for a
    way outside the surface.
    """

    def __init__(self, vertex: int, ring: Ring, a: Support, b: Support) -> None:
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
        self, lengths: _Lengths, arriving: dict[int, float], leaving: dict[int, float]
    ) -> float:
        """Return the angle of the one way inside the surface, or of that up (rad)."""
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


class _State:
    """A path on its way to a geodesic."""

    def __init__(
        self,
        points: Sequence[SurfacePoint],
        surface: Surface,
        refused: Set[Corridor],
        grip: float,
        held_at: Set[int] | None,
    ) -> None:
        self.held_at = held_at
        self.start, self.end = points[0], points[-1]
        self.surface, self.refused = surface, refused
        self.grip = {False: STRAIGHT, True: max(grip, STRAIGHT)}  # of bends and of visits
        self.lengths = _Lengths(surface)
        self.corridor: Corridor = ()
        self.visited: set[Corridor] = set()
        self.length = math.inf
        self._stars: dict[int, tuple[Ring, float]] = {}

    def pull(self, new: Corridor) -> bool:
        """Take a corridor unless its taut string is longer than that of the present one."""
        self.visited.add(new)
        stops = [0, *(i for i in range(1, len(new) - 1) if len(new[i]) == 1), len(new) - 1]
        strings: list[tuple[int, TautString]] = []
        length = 0.0
        for i, j in pairwise(stops):
            a = self.start if i == 0 else VertexPoint(new[i][0])
            b = self.end if j == len(new) - 1 else VertexPoint(new[j][0])
            edges = [(s[0], s[1]) for s in new[i + 1 : j]]
            string = pull_taut(a, edges, b, self.lengths)
            strings.append((i, string))
            length += string.length
        if length > self.length * (1 + LONGER):
            return False
        self.corridor, self.length, self._strings = new, length, strings
        return True

    def points(self) -> tuple[SurfacePoint, ...]:
        """Return the path with the taut string's fractions."""
        first, *_, last = tied(self.corridor, self.surface.thirds)
        points: list[SurfacePoint] = [_in_cell(self.start, first)]
        for i, string in self._strings:
            if i > 0:
                points.append(VertexPoint(self.corridor[i][0]))
            crossed = self.corridor[i + 1 : i + 1 + len(string.fractions)]
            for (a, b), fraction in zip(crossed, string.fractions, strict=True):
                points.append(EdgePoint((a, b), min(max(fraction, LEAST), MOST)))
        return (*points, _in_cell(self.end, last))

    def sweep(self, limit: int | None) -> list[int]:
        """Flip as many vertices as go together, `limit` at most; return them."""
        flips = self._flips()
        together = self._compatible(flips)[:limit]
        if not together:
            return []
        if self._accept(together):
            return [flip.vertex for flip in together]
        possible = [flip for flip in flips if self._corridor_after([flip]) is not None]
        if len(possible) < len(flips):
            together = self._compatible(possible)[:limit]
            if together and self._accept(together):
                return [flip.vertex for flip in together]
        return next(([flip.vertex] for flip in possible if self._accept([flip])), [])

    def _accept(self, flips: Sequence[_Flip]) -> bool:
        new = self._corridor_after(flips)
        return new is not None and self.pull(new)

    def _corridor_after(self, flips: Sequence[_Flip]) -> Corridor | None:
        """Return the corridor that flips lead to; None if it cannot be taken."""
        new = list(self.corridor)
        for flip in sorted(flips, key=lambda flip: flip.first, reverse=True):
            new[flip.first : flip.last + 1] = flip.spokes
        result = without_detours(new)
        if result in self.visited or flaw(result, self.surface.thirds) is not None:
            return None
        return None if tied(result, self.surface.thirds) in self.refused else result

    def _compatible(self, flips: Sequence[_Flip]) -> list[_Flip]:
        """Return the first flip and those that turn nearly as sharply and share no cell with it.

        Nor with each other.
        """
        chosen: list[_Flip] = []
        least = TOGETHER * (math.pi - flips[0].angle) - TIE if flips else 0.0
        busy: set[int] = set()
        cells: set[Support] = set()
        for flip in flips:
            if math.pi - flip.angle < least:
                continue
            # supports that stay may be shared: the string goes through both sides of them
            own = range(flip.first, flip.last + 1)
            around = range(flip.first - 1, flip.last + 2)
            if busy.isdisjoint(around) and cells.isdisjoint(flip.cells):
                chosen.append(flip)
                busy.update(own)
                cells |= flip.cells
        return chosen

    def _flips(self) -> list[_Flip]:
        """Return all flips that would shorten the string, in the order of their merits."""
        flips: list[_Flip] = []
        missing: list[int] = []
        for hold in self._holds():
            if self.held_at is not None and hold.vertex not in self.held_at:
                continue
            try:
                flips.extend(self._ways_around(hold))
            except MissingStars as stars:
                missing.extend(stars.vertices)
            except MeshError:
                continue  # where several sheets of membrane meet the vertex holds
        if missing:
            raise MissingStars(missing)
        return self._ordered(flips)

    def _ordered(self, flips: list[_Flip]) -> list[_Flip]:
        """Order by angle; equal ones from the middle of the path to its ends."""
        flips = sorted(flips, key=lambda flip: (flip.angle, flip.first))
        rank = dict.fromkeys(range(len(flips)), 0)
        for i in range(1, len(flips)):
            equal = flips[i].angle <= flips[rank[i - 1]].angle + TIE
            rank[i] = rank[i - 1] if equal else i
        middle = len(self.corridor) - 1
        keys = [(rank[i], abs(f.first + f.last - middle), f.first) for i, f in enumerate(flips)]
        return [flips[i] for i in sorted(range(len(flips)), key=keys.__getitem__)]

    def _holds(self) -> Iterator[_Hold]:
        """Return what holds the string, in order."""
        previous: TautString | None = None
        for i, string in self._strings:
            if previous is not None:
                vertex = self.corridor[i][0]
                yield _Hold(vertex, i, i, None, previous.arriving, string.leaving)
            for bend in string.bends:
                first, last = i + 1 + bend.first, i + 1 + bend.last
                yield _Hold(bend.vertex, first, last, bend.angle)
            previous = string

    def _ways_around(self, hold: _Hold) -> list[_Flip]:
        """Return the flips over a vertex that would shorten the string."""
        ring, total = self.star(hold.vertex)
        before, after = self.corridor[hold.first - 1], self.corridor[hold.last + 1]
        if not {*before, *after} <= {hold.vertex, *ring.neighbours}:
            return []  # the path comes from beyond the boundary, past this vertex
        arcs = _Arcs(hold.vertex, ring, before, after)
        if hold.strip_angle is not None:
            own = self.corridor[hold.first : hold.last + 1]
            other = arcs.down if arcs.up == own else arcs.up
            sides = [(total - hold.strip_angle, other)]
        else:
            angle = arcs.angle(self.lengths, hold.arriving, hold.leaving)
            sides = (
                [(angle, arcs.up), (total - angle, arcs.down)]
                if ring.closed
                else [(angle, arcs.down if arcs.up is None else arcs.up)]
            )
            angles = sorted(angle for angle, _ in sides)
            if len(sides) == 2 and angles[1] < math.pi - STRAIGHT and angles[1] - angles[0] <= TIE:
                return []
        return [
            _Flip(
                angle,
                hold.vertex,
                hold.first,
                hold.last,
                spokes,
                frozenset(cell_between(*pair) for pair in pairwise((before, *spokes, after))),
            )
            for angle, spokes in sides
            if spokes is not None and angle < math.pi - self.grip[hold.strip_angle is None]
        ]

    def star(self, vertex: int) -> tuple[Ring, float]:
        """Return the ring of a vertex and its total angle (rad)."""
        if vertex not in self._stars:
            ring = self.surface.ring(vertex)
            around = ring.neighbours + ring.neighbours[:1] * ring.closed
            corners = (corner_angle(vertex, *pair, self.lengths) for pair in pairwise(around))
            # exactly rounded, so that it does not matter where the ring begins
            self._stars[vertex] = ring, math.fsum(corners)
        return self._stars[vertex]


def _in_cell(end: SurfacePoint, support: Support) -> SurfacePoint:
    """Return an end as a place in the cell to which it has been tied, if it has been."""
    if not isinstance(end, EdgePoint) or len(support) != 3:
        return end
    weight = dict(zip(end.edge, (1.0 - end.fraction, end.fraction), strict=True))
    a, b, c = support
    return CellPoint((a, b, c), (weight.get(a, 0.0), weight.get(b, 0.0), weight.get(c, 0.0)))


def _check(points: Sequence[SurfacePoint], surface: Surface) -> None:
    """Raise PathError unless the points are a path that can be shortened."""
    if len(points) < 2:
        raise PathError(f"a path of {len(points)} points; a cable needs two or more")
    for i, point in enumerate(points):
        if isinstance(point, CellPoint) and 0 < i < len(points) - 1:
            raise PathError(f"point {i} of a path is {point}; only its ends may lie inside a cell")
    for i, (a, b) in enumerate(pairwise(points)):
        link = cell_between(a.support, b.support)
        thirds = surface.thirds((link[0], link[1])) if len(link) in (2, 3) else ()
        if not thirds or (len(link) == 3 and link[2] not in thirds):
            raise PathError(
                f"a path cannot go from {a} to {b}: no cell of the surface has both (link {i})"
            )
    given = corridor(points)
    problem = flaw(given, surface.thirds)
    if problem is None and without_detours(given) != given:
        problem = "it turns back into the cell or edge that it came from"
    if problem is not None:
        raise PathError(
            f"a path from {points[0]} to {points[-1]} cannot be shortened: {problem}; "
            "lay it another way"
        )
