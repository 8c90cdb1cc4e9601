"""Corridors: the vertices a path visits and the edges it crosses, and the taut string in them.

A corridor is the tuple of the supports of a path's points: a vertex (a,), an edge (a, b), or, at
its ends, a cell (a, b, c). It is purely combinatorial: two paths through the same corridor have the
same taut string. The cells along it are unfolded one after the other from their edge lengths; a
funnel (Lee and Preparata 1984) then finds the shortest path through their common edges in linear
time. All formulas are symmetric in left and right: a mirrored strip gives a mirrored string.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    Edge,
    EdgePoint,
    Support,
    SurfacePoint,
    edge_of,
)

Corridor = tuple[Support, ...]


def corridor(points: Sequence[SurfacePoint]) -> Corridor:
    """Supports of a path's points."""
    return tuple(point.support for point in points)


def cell_between(a: Support, b: Support) -> Support:
    """Sorted vertices of the cell or edge through which a path goes from a to b."""
    return tuple(sorted({*a, *b}))


def without_detours(supports: Sequence[Support]) -> Corridor:
    """Simplify a corridor between its ends: remove edges crossed back and forth, vertices where the
    path turns straight back, and edges crossed next to a visit of one of their vertices."""
    kept: list[Support] = []
    for i, new in enumerate(supports):
        _append(kept, new, last=i == len(supports) - 1)
    return tuple(kept)


def _append(kept: list[Support], new: Support, *, last: bool) -> None:
    """Append a support to a simplified corridor, and simplify it again."""
    while kept:
        top, only = kept[-1], len(kept) == 1
        if top == new:
            if only and last:
                break
            if not only and len(top) == 2 and not last:
                kept.pop()  # crossed to and fro: both go
                return
            if not last:
                return
            kept.pop()
        elif len(top) == 1 and len(new) == 2 and top[0] in new and not last:
            return
        elif len(top) == 2 and len(new) == 1 and new[0] in top and not only:
            kept.pop()
        elif not only and _turns_back(kept[-2], top, new):
            kept.pop()
        else:
            break
    kept.append(new)


def _turns_back(a: Support, b: Support, c: Support) -> bool:
    """Whether a path from a to b continues to c through the cell or edge it came from."""
    there, back = cell_between(a, b), cell_between(b, c)
    if _along_edge(a, b):
        return set(there) <= set(back)
    return set(back) <= set(there) if _along_edge(c, b) else there == back


def _along_edge(end: Support, vertex: Support) -> bool:
    """Whether the link between two supports runs along an edge."""
    return len(end) == 2 and len(vertex) == 1 and vertex[0] in end


def snap_ends(supports: Corridor, opposite_vertices: Callable[[Edge], tuple[int, ...]]) -> Corridor:
    """Move each end on an edge that the corridor follows into a cell beside it, if possible not the
    one through which the path continues."""
    result = list(supports)
    for i, step in ((0, 1), (-1, -1)):
        if _along_edge(supports[i], supports[i + step]):
            a, b = supports[i]
            cells = sorted(tuple(sorted((a, b, c))) for c in opposite_vertices((a, b)))
            if len(supports) > 2:
                onward = cell_between(supports[i + step], supports[i + 2 * step])
                cells.sort(key=onward.__eq__)
            result[i] = cells[0]
    return tuple(result)


def why_invalid(
    supports: Corridor, opposite_vertices: Callable[[Edge], tuple[int, ...]]
) -> str | None:
    """Why no cable can follow a corridor; None if one can."""
    if len(supports) < 2:
        return "nothing of it is left between its ends"
    links = [cell_between(a, b) for a, b in pairwise(supports)]
    if len(links) == 1 and supports[0] == supports[1] and len(links[0]) < 3:
        return f"both of its ends lie on {links[0]}"
    # the two ends of a hoop, a closed loop, may lie on the same vertex or edge
    hoop = supports[0] == supports[-1] and len(supports[0]) < 3
    visited = supports[1:] if hoop else supports
    partly = {s for s in (supports[0], supports[-1]) if len(s) == 2}
    passed = [s for s in visited if len(s) < 3] + [link for link in links if link not in partly]
    again = next((s for s, n in Counter(passed).items() if n > 1), None)
    if again is not None:
        return f"it uses {again} twice"
    # a cell entered once has at most two points on its edges, unless one is an end
    edges = {s for s in supports if len(s) == 2}
    for end in partly:
        for third in opposite_vertices((end[0], end[1])):
            cell = (*end, third)
            sides = [tuple(sorted(set(cell) - {v})) for v in cell]
            if edges.issuperset(sides):
                return f"it has points on all edges of cell {tuple(sorted(cell))}"
    return None


Lengths = Mapping[Edge, float]

TOUCHES = 1e-9
"""Angle (rad) within which a string that passes a vertex of the strip counts as touching it.

It is far above rounding (about 1e-13 after hundreds of cells), so that bends of a string that runs
exactly through a vertex do not depend on the order of ids; treating it as a bend lengthens the
string by a fraction below 1e-18.
"""


@dataclass(frozen=True)
class _Bend:
    """A vertex of the strip at which the string bends."""

    vertex: int  # its id
    first: int  # first and last edge of the strip at the vertex
    last: int
    angle: float  # on the strip's side (rad), at least pi; NaN if the string ends there


@dataclass(frozen=True)
class TautString:
    """The shortest path through a strip."""

    length: float
    bends: tuple[_Bend, ...] = ()  # in order
    # angles (rad) between the string's first and last segment and the edges at its ends, by the
    # edges' other vertices; meaningful if that end is a vertex
    leaving: dict[int, float] = field(default_factory=dict)
    arriving: dict[int, float] = field(default_factory=dict)
    cross: Callable[[], tuple[float, ...]] = tuple  # finds `fractions`, which few strings need

    @cached_property
    def fractions(self) -> tuple[float, ...]:
        """Crossing of each edge (a, b): 0 at a, 1 at b."""
        return self.cross()


def corner_angle(at: int, b: int, c: int, lengths: Lengths) -> float:
    """Angle (rad) of cell (at, b, c) at its first vertex."""
    p, q, r = lengths[edge_of(at, b)], lengths[edge_of(at, c)], lengths[edge_of(b, c)]
    return math.atan2(_four_areas(p, q, r), p * p + (q - r) * (q + r))


def _four_areas(p: float, q: float, r: float) -> float:
    """Four times the area of a triangle by Kahan's formula; 0 if the sides form no triangle."""
    z, y, x = sorted((p, q, r))
    return math.sqrt(max(0.0, (x + (y + z)) * (z - (x - y)) * (z + (x - y)) * (x + (y - z))))


def _apex(a: complex, b: complex, ab: float, ac: float, bc: float) -> complex:
    """Third corner of a triangle with corners a, b: to the left from a to b."""
    along = (ac - bc) * (ac + bc) / (2 * ab * ab)
    height = _four_areas(ab, ac, bc) / (2 * ab * ab)
    return (a + b) / 2 + (b - a) * complex(along, height)


def _cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def _turns(a: complex, b: complex, sign: float) -> bool:
    """Whether b turns from a to one side (1 left, -1 right) or is parallel; not antiparallel."""
    turn = a.conjugate() * b
    return sign * turn.imag > -TOUCHES * turn.real


def _angle(a: complex, b: complex) -> float:
    """Angle (rad) between two directions, from 0 to pi."""
    turn = a.conjugate() * b
    return math.atan2(abs(turn.imag), turn.real)


def _at(point: SurfacePoint, places: Mapping[int, complex]) -> complex:
    """Position of a point whose cell has been unfolded."""
    if isinstance(point, EdgePoint):
        a, b = point.edge
        return (1.0 - point.fraction) * places[a] + point.fraction * places[b]
    if isinstance(point, CellPoint):
        return sum(w * places[v] for v, w in zip(point.cell, point.weights, strict=True))
    return places[point.vertex]


def _direct(start: SurfacePoint, end: SurfacePoint, lengths: Lengths) -> TautString:
    """The string between two points of one cell or edge."""
    corners = sorted({*start.support, *end.support})
    a, b = corners[:2]
    ab = lengths[a, b]
    places = {a: complex(0, ab / 2), b: complex(0, -ab / 2)}
    for c in corners[2:]:
        places[c] = _apex(places[a], places[b], ab, lengths[a, c], lengths[b, c])
    p, q = _at(start, places), _at(end, places)
    return TautString(
        abs(q - p),
        leaving={v: _angle(q - p, z - p) for v, z in places.items() if v not in start.support},
        arriving={v: _angle(p - q, z - q) for v, z in places.items() if v not in end.support},
    )


class _Strip:
    """A strip in the plane. Node 0 is the start, node -1 the end, the others are its vertices."""

    def __init__(
        self, start: SurfacePoint, edges: Sequence[Edge], end: SurfacePoint, lengths: Lengths
    ) -> None:
        a, b = edges[0]
        ab = lengths[a, b]
        self.at = [0j, complex(0, ab / 2), complex(0, -ab / 2)]  # positions of the nodes
        # vertex ids of the nodes, and the first and last edge at each
        self.vertex, self.first, self.last = [-1, a, b], [-1, 0, 0], [-1, 0, 0]
        self.left, self.right = [1], [2]  # nodes at the ends of the edges
        # id and position of the vertex before the first edge; `end_beyond`: after the last one
        self.start_beyond = self._beyond(start, 2, 1, lengths)
        self.at[0] = _at(start, dict([self.start_beyond, (a, self.at[1]), (b, self.at[2])]))
        left, right = 1, 2
        at, vertex = self.at, self.vertex
        for k, edge in enumerate(edges[1:], start=1):
            new = len(at)  # replaces the node at the left or right end of the edge before
            if vertex[left] in edge:
                stays, goes = left, right
            else:
                stays, goes = right, left
            vertex.append(edge[0] if edge[1] == vertex[stays] else edge[1])
            own, other = lengths[edge], lengths[edge_of(vertex[goes], vertex[new])]
            if stays == left:
                at.append(_apex(at[left], at[right], ab, own, other))
                right = new
            else:
                at.append(_apex(at[left], at[right], ab, other, own))
                left = new
            ab = own
            self.first.append(k)
            self.last.append(k)
            self.last[stays] = k
            self.left.append(left)
            self.right.append(right)
        self.end_beyond = self._beyond(end, left, right, lengths)
        sides = [(self.vertex[left], self.at[left]), (self.vertex[right], self.at[right])]
        self.at.append(_at(end, dict([self.end_beyond, *sides])))

    def _beyond(self, point: SurfacePoint, a: int, b: int, lengths: Lengths) -> tuple[int, complex]:
        va, vb = self.vertex[a], self.vertex[b]
        (new,) = {*point.support} - {va, vb}
        ab, ac, bc = lengths[edge_of(va, vb)], lengths[edge_of(va, new)], lengths[edge_of(vb, new)]
        return new, _apex(self.at[a], self.at[b], ab, ac, bc)

    def nodes_of_string(self) -> list[int]:
        """Nodes of the shortest string, both ends included."""
        at = self.at
        parent = [0] * len(at)
        chains: tuple[deque[int], deque[int]] = (deque([1]), deque([2]))
        apex = 0
        final = len(at) - 1
        for k in range(1, len(self.left) + 1):
            if k == len(self.left):
                side, sign, new = 0, 1.0, final
            elif self.left[k] != self.left[k - 1]:
                side, sign, new = 0, 1.0, self.left[k]
            else:
                side, sign, new = 1, -1.0, self.right[k]
            own, other = chains[side], chains[1 - side]
            while own:
                a, b = at[own[-1]] - at[own[-2] if len(own) > 1 else apex], at[new] - at[own[-1]]
                if _turns(a, b, sign):
                    break
                own.pop()
            if not own:
                while other:
                    a, b = at[other[0]] - at[apex], at[new] - at[other[0]]
                    if not _turns(a, b, -sign):
                        break
                    apex = other.popleft()
            parent[new] = own[-1] if own else apex
            own.append(new)
        nodes = [final]
        while nodes[-1] != 0:
            nodes.append(parent[nodes[-1]])
        return nodes[::-1]


def pull_taut(
    start: SurfacePoint, edges: Sequence[Edge], end: SurfacePoint, lengths: Lengths
) -> TautString:
    """Shortest string between two points through edges. D. T. Lee and F. P. Preparata, Euclidean
    shortest paths in the presence of rectilinear barriers, Networks 14 (1984)."""
    if not edges:
        return _direct(start, end, lengths)
    strip = _Strip(start, edges, end, lengths)
    nodes = strip.nodes_of_string()
    touched = _touched(strip, nodes)
    to_start = _towards(start, strip.start_beyond)
    to_end = _towards(end, strip.end_beyond)
    bends = []
    for before, node, after, (i, j) in zip(nodes, nodes[1:], nodes[2:], touched[1:], strict=False):
        a, b = (
            (towards.get(strip.vertex[node], strip.at[n]) if n == fixed else strip.at[n])
            for n, fixed, towards in ((before, 0, to_start), (after, nodes[-1], to_end))
        )
        spokes = [strip.at[strip.left[k] + strip.right[k] - node] for k in range(i, j + 1)]
        angle = _turn(strip.at[node], [a, *spokes, b])
        bends.append(_Bend(strip.vertex[node], strip.first[node], strip.last[node], angle))
    parts = [strip.at[b] - strip.at[a] for a, b in pairwise(nodes)]
    return TautString(
        sum(map(abs, parts)),
        tuple(bends),
        {strip.vertex[n]: _angle(parts[0], strip.at[n] - strip.at[0]) for n in (1, 2)},
        {
            strip.vertex[n]: _angle(-parts[-1], strip.at[n] - strip.at[-1])
            for n in (strip.left[-1], strip.right[-1])
        },
        lambda: _fractions(strip, edges, nodes, touched),
    )


def _touched(strip: _Strip, nodes: list[int]) -> list[tuple[int, int]]:
    """First and last edge crossed at each node of the string: at a bend all edges there, unless the
    string comes or leaves along one of them."""
    touched = [(strip.first[n], strip.last[n]) for n in nodes[:-1]]
    touched.append((len(strip.left), len(strip.left)))
    for i in range(1, len(nodes) - 2):
        (first, end), (start, last) = touched[i : i + 2]
        if end >= start:
            common = max(first, start)
            touched[i : i + 2] = (first, common), (common, last)
    return touched


def _fractions(
    strip: _Strip, edges: Sequence[Edge], nodes: list[int], touched: list[tuple[int, int]]
) -> tuple[float, ...]:
    """Crossings of the edges as fractions; the midpoint of edges along which the string runs."""
    at, left, right = strip.at, strip.left, strip.right
    fractions = [math.nan] * len(edges)  # from left to right
    for (p, q), (before, after) in zip(pairwise(nodes), pairwise(touched), strict=True):
        for k in range(before[1] + 1, after[0]):
            fractions[k] = _crossing(at[p], at[q], at[left[k]], at[right[k]])
        for k in range(after[0], min(after[1] + 1, len(edges))):
            fractions[k] = 0.5 if k == before[1] else float(right[k] == q)
    return tuple(
        t if strip.vertex[n] == edge[0] else 1.0 - t
        for t, n, edge in zip(fractions, left, edges, strict=True)
    )


def _crossing(p: complex, q: complex, a: complex, b: complex) -> float:
    """Crossing of a string from p to q with an edge, from a (0) to b (1)."""
    string, edge = q - p, b - a
    across = _cross(string, edge)
    if abs(across) > TOUCHES * abs(string) * abs(edge):
        t = _cross(string, p - a) / across
    else:  # along the edge, which contains one end: the point where it reaches the edge
        t = ((p - a) * edge.conjugate()).real / abs(edge) ** 2
    return min(max(t, 0.0), 1.0)


def _towards(end: SurfacePoint, beyond: tuple[int, complex]) -> dict[int, complex]:
    """Position in the direction of an end, by vertex of its edge, as the end may be too close."""
    if not isinstance(end, EdgePoint):
        return {}
    return {v: beyond[1] for v in end.edge if v != beyond[0]}


def _turn(at: complex, places: list[complex]) -> float:
    """Angle (rad) at a point, summed from the first of other points over all to the last."""
    ways = [place - at for place in places]
    if min(abs(ways[0]), abs(ways[-1])) <= TOUCHES * max(map(abs, ways)):
        return math.nan
    return math.fsum(_angle(a, b) for a, b in pairwise(ways))
