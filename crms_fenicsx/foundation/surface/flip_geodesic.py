"""Shortening of a cable's path by flips over the vertices that do not hold it.

A frictionless cable lies along a geodesic of the surface. Within the corridor of its path it is a
taut string, which bends at vertices, with an angle of at least pi on the side of the unfolded
strip. If the angle on the other side of the vertex is less than pi, the string would be shorter
there, and the corridor is led around that side: a flip. A path without possible flips is straight
except at vertices with angles of at least pi on both sides: a geodesic.

Only edge lengths matter, so the surface may be folded along cables. The computations are small and
the same on all ranks.

Source: edge-flip geodesics (N. Sharp and K. Crane, You can find geodesic paths in triangle meshes
by just flipping edges, ACM Trans. Graph. 39, 2020), but without changing the mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import MeshError, PathError
from crms_fenicsx.foundation.surface.corridor import (
    Corridor,
    TautString,
    cell_between,
    corner_angle,
    corridor,
    pull_taut,
    snap_ends,
    why_invalid,
    without_detours,
)
from crms_fenicsx.foundation.surface.points import (
    LEAST,
    MOST,
    CellPoint,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
)
from crms_fenicsx.foundation.surface.vertex_flip import (
    TIE,
    Arcs,
    EdgeLengths,
    Flip,
    Hold,
    IntrinsicSurface,
    MissingCells,
    Ring,
    compatible,
    ordered,
)

STRAIGHT = 1e-7
"""Angle (rad) by which the other side of a vertex must be below pi for a flip.

A smaller one would shorten the cable by less than 1e-14 of its length, below the accuracy of
lengths; the rounding of angles is far smaller (1e-12 where cells are as thin as 1e-4).
"""
LONGER = 1e-12
"""Relative growth of the length attributed to rounding: about 1e-16 for each unfolded cell."""


@dataclass(frozen=True)
class FlippedPath:
    """A path that has been pulled taut."""

    flips: tuple[int, ...]  # vertices it has been flipped over, in order
    length: float  # length of the taut string (length)
    before: float  # length of the taut string in the given corridor (length)
    find: Callable[[], tuple[SurfacePoint, ...]]  # finds `points`, which few paths need

    @cached_property
    def points(self) -> tuple[SurfacePoint, ...]:
        """Both ends as given, or moved into a cell beside an edge that the path follows; in between
        the crossings of the taut string, even if only rounding separates them from a vertex."""
        return self.find()


def shorten(
    points: Sequence[SurfacePoint],
    surface: IntrinsicSurface,
    *,
    refused: Set[Corridor] = frozenset(),
    max_flips: int | None = None,
    grip: float = STRAIGHT,
    held_at: Set[int] | None = None,
    checked: bool = False,
) -> FlippedPath:
    """Pull a path taut and flip it over at most `max_flips` vertices, by default to a geodesic."""
    # Each sweep starts with the vertex of the smallest angle on the other side and adds all others
    # that share no cell with the chosen ones. Equal angles are ordered from the path's middle to
    # its ends, so that neither ids nor the handedness of the surface decides. It terminates, as no
    # corridor is visited twice and those that cross no edge twice are finite in number.
    limit = None if max_flips is None else checks.whole("shorten: max_flips", max_flips, 0)
    if not checked:
        _check(points, surface)
    state = _GeodesicPath(points, surface, refused, grip, held_at)
    state.pull(corridor(points))
    before = state.length
    flips: list[int] = []
    while limit is None or len(flips) < limit:
        done = state.sweep(None if limit is None else limit - len(flips))
        if not done:
            break
        flips.extend(done)
    return FlippedPath(tuple(flips), state.length, before, state.points)


class _GeodesicPath:
    """A path while it is shortened to a geodesic."""

    def __init__(
        self,
        points: Sequence[SurfacePoint],
        surface: IntrinsicSurface,
        refused: Set[Corridor],
        grip: float,
        held_at: Set[int] | None,
    ) -> None:
        self.held_at = held_at
        self.start, self.end = points[0], points[-1]
        self.surface, self.refused = surface, refused
        self.lateral = {False: STRAIGHT, True: max(grip, STRAIGHT)}  # of bends and of visits
        self.lengths = EdgeLengths(surface)
        self.corridor: Corridor = ()
        self.visited: set[Corridor] = set()
        self.length = math.inf
        self._stars: dict[int, tuple[Ring, float]] = {}

    def pull(self, new: Corridor) -> bool:
        """Accept a corridor unless its taut string is longer; return whether it was accepted."""
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
        """The path, with the crossings of the taut string."""
        first, *_, last = snap_ends(self.corridor, self.surface.opposite_vertices)
        points: list[SurfacePoint] = [_in_cell(self.start, first)]
        for i, string in self._strings:
            if i > 0:
                points.append(VertexPoint(self.corridor[i][0]))
            crossed = self.corridor[i + 1 : i + 1 + len(string.fractions)]
            for (a, b), fraction in zip(crossed, string.fractions, strict=True):
                points.append(EdgePoint((a, b), min(max(fraction, LEAST), MOST)))
        return (*points, _in_cell(self.end, last))

    def sweep(self, limit: int | None) -> list[int]:
        """Flip as many vertices as are compatible, at most `limit`; return them."""
        # a rejected sweep is replaced by its first accepted flip
        flips = self._flips()
        together = compatible(flips)[:limit]
        if not together:
            return []
        if self._accept(together):
            return [flip.vertex for flip in together]
        possible = [flip for flip in flips if self._corridor_after([flip]) is not None]
        if len(possible) < len(flips):
            together = compatible(possible)[:limit]
            if together and self._accept(together):
                return [flip.vertex for flip in together]
        return next(([flip.vertex] for flip in possible if self._accept([flip])), [])

    def _accept(self, flips: Sequence[Flip]) -> bool:
        new = self._corridor_after(flips)
        return new is not None and self.pull(new)

    def _corridor_after(self, flips: Sequence[Flip]) -> Corridor | None:
        """The corridor after flips; None if it is invalid, refused or already visited."""
        new = list(self.corridor)
        for flip in sorted(flips, key=lambda flip: flip.first, reverse=True):
            new[flip.first : flip.last + 1] = flip.spokes
        result = without_detours(new)
        if (
            result in self.visited
            or why_invalid(result, self.surface.opposite_vertices) is not None
        ):
            return None
        return None if snap_ends(result, self.surface.opposite_vertices) in self.refused else result

    def _flips(self) -> list[Flip]:
        """All flips that would shorten the string, the best first."""
        flips: list[Flip] = []
        missing: list[int] = []
        for hold in self._holds():
            if self.held_at is not None and hold.vertex not in self.held_at:
                continue
            try:
                flips.extend(self._ways_around(hold))
            except MissingCells as stars:
                missing.extend(stars.vertices)
            except MeshError:
                continue  # a vertex where several sheets of membrane meet holds the string
        if missing:
            raise MissingCells(missing)
        return ordered(flips, len(self.corridor) - 1)

    def _holds(self) -> Iterator[Hold]:
        """Vertices that hold the string, in order."""
        previous: TautString | None = None
        for i, string in self._strings:
            if previous is not None:
                vertex = self.corridor[i][0]
                yield Hold(vertex, i, i, None, previous.arriving, string.leaving)
            for bend in string.bends:
                first, last = i + 1 + bend.first, i + 1 + bend.last
                yield Hold(bend.vertex, first, last, bend.angle)
            previous = string

    def _ways_around(self, hold: Hold) -> list[Flip]:
        """Flips over a vertex that would shorten the string."""
        ring, total = self.star(hold.vertex)
        before, after = self.corridor[hold.first - 1], self.corridor[hold.last + 1]
        if not {*before, *after} <= {hold.vertex, *ring.neighbours}:
            return []  # the path passes this vertex from beyond the boundary
        arcs = Arcs(hold.vertex, ring, before, after)
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
                return []  # both sides are equally short, as on the ridge of a symmetric shape
        return [
            Flip(
                angle,
                hold.vertex,
                hold.first,
                hold.last,
                spokes,
                frozenset(cell_between(*pair) for pair in pairwise((before, *spokes, after))),
            )
            for angle, spokes in sides
            if spokes is not None and angle < math.pi - self.lateral[hold.strip_angle is None]
        ]

    def star(self, vertex: int) -> tuple[Ring, float]:
        """The ring of a vertex and its total angle (rad)."""
        if vertex not in self._stars:
            ring = self.surface.ring(vertex)
            around = ring.neighbours + ring.neighbours[:1] * ring.closed
            corners = (corner_angle(vertex, *pair, self.lengths) for pair in pairwise(around))
            # fsum is exactly rounded, so that the ring's start does not matter
            self._stars[vertex] = ring, math.fsum(corners)
        return self._stars[vertex]


def _in_cell(end: SurfacePoint, support: Support) -> SurfacePoint:
    """An end as a point in the cell into which it was moved, if it was."""
    if not isinstance(end, EdgePoint) or len(support) != 3:
        return end
    weight = dict(zip(end.edge, (1.0 - end.fraction, end.fraction), strict=True))
    a, b, c = support
    return CellPoint((a, b, c), (weight.get(a, 0.0), weight.get(b, 0.0), weight.get(c, 0.0)))


def _check(points: Sequence[SurfacePoint], surface: IntrinsicSurface) -> None:
    """Raise PathError unless the points are a path that can be shortened."""
    if len(points) < 2:
        raise PathError(f"a path of {len(points)} points; a cable needs two or more.")
    for i, point in enumerate(points):
        if isinstance(point, CellPoint) and 0 < i < len(points) - 1:
            raise PathError(f"point {i} of a path is {point}; only its ends may lie inside a cell.")
    for i, (a, b) in enumerate(pairwise(points)):
        link = cell_between(a.support, b.support)
        opposite_vertices = (
            surface.opposite_vertices((link[0], link[1])) if len(link) in (2, 3) else ()
        )
        if not opposite_vertices or (len(link) == 3 and link[2] not in opposite_vertices):
            raise PathError(
                f"a path cannot go from {a} to {b}: no cell of the surface has both (link {i})."
            )
    given = corridor(points)
    problem = why_invalid(given, surface.opposite_vertices)
    if problem is None and without_detours(given) != given:
        problem = "it turns back into the cell or edge that it came from"
    if problem is not None:
        raise PathError(
            f"a path from {points[0]} to {points[-1]} cannot be shortened: {problem}; "
            "lay it another way."
        )
