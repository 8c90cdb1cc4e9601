"""The cables' tables and meetings by loops over nodes, links and cells: slow and easy to read."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from polygon_twins import split_slowly

from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.strip import Strip
from crms_fenicsx.foundation.surface.points import Edge, EdgePoint
from crms_fenicsx.model.cable_state import NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL

Array = npt.NDArray[Any]
Link = tuple[int, int, int, tuple[int, ...] | None]


def points_by_edge(cables: Sequence[LaidCable]) -> dict[Edge, list[tuple[float, int, int]]]:
    """Points, none lifted, of cables in tension on each edge, sorted from its first vertex to its
    last: places on the edge (fractions), and numbers of cables and nodes."""
    found: dict[Edge, list[tuple[float, int, int]]] = {}
    for c, cable in enumerate(cables):
        for k, node in enumerate(cable.state.nodes) if cable.taut else ():
            if isinstance(node.point, EdgePoint) and node.kind != "crossing":
                points = found.setdefault(node.point.edge, [])
                if not cable.state.lifted[k]:
                    points.append((float(cable.state.fractions[k]), c, k))
    return {edge: sorted(points) for edge, points in found.items() if points}


class SlowTables:
    """What a rank has of the cables in tension; each part is a list of rows."""

    def __init__(self, numbering: CableNumbering) -> None:
        self.numbering, self.strip, self.rank = numbering, numbering.strip, numbering.rank
        self.cables = numbering.cables
        self.on_edge = points_by_edge(self.cables)
        self.links = [link for c in range(len(self.cables)) for link in self._links_of(c)]
        rows = {row for edge in self.on_edge for row in self.strip.rows(edge)}
        self.rows = sorted(row for row in rows if self.strip.owner[row] == self.rank)
        self.chords = self._chords()

    def _links_of(self, c: int) -> list[Link]:
        """Cable, two nodes one after the other that it touches, and the cell or edge of both."""
        links: list[Link] = []
        nodes = self.cables[c].state.nodes
        for k, m in pairwise(self.cables[c].contacts()) if self.cables[c].taut else ():
            a, b = nodes[k].point, nodes[m].point
            both = () if a is None or b is None else tuple(sorted({*a.support, *b.support}))
            links.append((c, k, m, both if both and self.strip.rows(both) else None))
        return links

    def around(self, link: Link) -> tuple[int, ...]:
        """What a link lies on, or its first node, or the node beside that if it is an anchor."""
        c, k, _, on = link
        nodes = self.cables[c].state.nodes
        point = nodes[k].point or nodes[1 if k == 0 else k - 1].point
        assert point is not None
        return on or point.support

    def own_links(self) -> list[Link]:
        """Those that this rank computes."""
        rows = {link: self.strip.rows(self.around(link)) for link in self.links}
        return [link for link in self.links if min(self.strip.owner[rows[link]]) == self.rank]

    def smoothing(self, link: Link, sizes: Array) -> float:
        """Smoothing of a link, with the sizes of the strip's cells."""
        c, k, m, on = link
        kinds = {self.cables[c].state.nodes[n].kind for n in (k, m)}
        rows = [r for r in self.strip.rows(self.around(link)) if self.strip.owner[r] == self.rank]
        size = float(min(sizes[row] for row in rows))
        if kinds == {"tied"} or (on is None and not kinds & {"fold", "edge slider", "crossing"}):
            return -SAME_PLACE * size
        return TOL.smoothing * size * (1e-3 if "anchor" in kinds else 1.0)

    def _chords(self) -> dict[int, list[list[NodeId]]]:
        """Chords through the inside of this rank's cells, by row: nodes from rim to rim."""
        chords: dict[int, list[list[NodeId]]] = defaultdict(list)
        for c, k, m, on in self.links:
            if on is not None and len(on) == 3:
                own = chords[self.strip.rows(on)[0]]
                if own and own[-1][-1] == (c, k):
                    own[-1].append((c, m))
                else:
                    own.append([(c, k), (c, m)])
        return chords

    def line(self, edge: Edge) -> list[int]:
        """Blocks along an edge."""
        inner = [self.numbering.block(c, k) for _, c, k in self.on_edge.get(edge, [])]
        return [self.numbering.vertex(edge[0]), *inner, self.numbering.vertex(edge[1])]

    def sides(self) -> tuple[list[list[int]], list[tuple[int, int]]]:
        """Numbers of the folded cells' sides as they first occur, and their segments."""
        numbers: dict[Edge, int] = {}
        segments: list[tuple[int, int]] = []
        sides = []
        for row in self.rows:
            edges = [edge for edge, _ in sides_of(self.strip.corners[row])]
            for edge in edges:
                if edge not in numbers:
                    numbers[edge] = len(numbers)
                    segments += pairwise(self.line(edge))
            sides.append([numbers[edge] for edge in edges])
        return sides, segments

    def kinks(self) -> list[tuple[list[int], int, NodeId]]:
        """Corner blocks, place of the cell, fold point."""
        kinks = []
        for n, row in enumerate(self.rows):
            for chord in self.chords[row]:
                for (c, k), other in ((chord[0], chord[-1]), (chord[-1], chord[0])):
                    node = self.cables[c].state.nodes[k]
                    if node.kind == "fold" and isinstance(node.point, EdgePoint):
                        line, block = self.line(node.point.edge), self.numbering.block(c, k)
                        at = line.index(block)
                        corners = [line[at - 1], block, line[at + 1], self.numbering.block(*other)]
                        kinks.append((corners, n, (c, k)))
        return kinks

    def polygons(self, row: int) -> list[list[int]]:
        """Blocks around the pieces of a cell."""
        around: list[int] = []
        for edge, forward in sides_of(self.strip.corners[row]):
            around += self.line(edge)[:-1] if forward else self.line(edge)[:0:-1]
        chords = [[self.numbering.block(*node) for node in chord] for chord in self.chords[row]]
        return split_slowly(around, chords)

    def sliders(self) -> list[tuple[list[int], float]]:
        """Blocks of this rank's sliding points and of their edges' ends, and their places."""
        return [
            ([self.numbering.block(c, k), *map(self.numbering.vertex, edge)], fraction)
            for edge, points in self.on_edge.items()
            for fraction, c, k in points
            if self.cables[c].state.nodes[k].slides and self.numbering.is_mine(c, k)
        ]


def sides_of(cell: Sequence[int]) -> list[tuple[Edge, bool]]:
    """Sides of a cell: the ids ascending, and whether that is the cell's own direction."""
    return [((min(a, b), max(a, b)), a < b) for a, b in pairwise((*cell, cell[0]))]


def meetings(cables: Sequence[LaidCable], strip: Strip) -> list[tuple[NodeId, NodeId, Array]]:
    """Links of cables in tension that cross inside cells: first nodes, how far along each is."""
    on_edge: dict[Edge, list[tuple[float, int, int]]] = defaultdict(list)
    chords: dict[int, list[NodeId]] = defaultdict(list)
    for c, cable in enumerate(cables):
        for k, node in enumerate(cable.state.nodes) if cable.taut else ():
            if isinstance(node.point, EdgePoint):
                on_edge[node.point.edge].append((float(cable.state.fractions[k]), c, k))
        for k, (a, b) in enumerate(pairwise(cable.state.nodes)) if cable.taut else ():
            if a.point is not None and b.point is not None:
                both = tuple(sorted({*a.support, *b.support}))
                if len(both) == 3:
                    chords[strip.rows(both)[0]].append((c, k))
    found = []
    for row, members in chords.items():
        around: dict[Any, int] = {}  # places on the rim, of corners and of points
        for (a, b), forward in sides_of(strip.corners[row]):
            around[a if forward else b] = len(around)
            line = sorted(on_edge[a, b])
            for _, c, k in line if forward else line[::-1]:
                around[c, k] = len(around)
        for first, second in combinations(members, 2):
            ends = [(c, k + i) for c, k in (first, second) for i in (0, 1)]
            t = _intersection(*(_flat(cables, end, strip.cells[row]) for end in ends))
            rims = [around.get(_corner(cables, end)) for end in ends]
            if first[0] != second[0] and _cross(rims, t):
                found.append((first, second, t))
    return found


def _corner(cables: Sequence[LaidCable], end: NodeId) -> int | NodeId:
    node = cables[end[0]].state.nodes[end[1]]
    return node.support[0] if node.kind == "vertex" else end


def _flat(cables: Sequence[LaidCable], end: NodeId, cell: Array) -> Array:
    """Barycentric weights of a node."""
    share = dict(zip(*cables[end[0]].interpolation(end[1]), strict=True))
    return np.array([share.get(int(vertex), 0.0) for vertex in cell])


def _intersection(a: Array, b: Array, p: Array, q: Array) -> Array:
    """How far along lines ab and pq they cross."""
    matrix = np.stack([b - a, p - q], axis=1)[:2]
    return np.linalg.solve(matrix, (p - a)[:2]) if np.linalg.det(matrix) else np.full(2, 0.5)


def _cross(rims: Sequence[int | None], t: Array) -> bool:
    """Whether ends alternate around a cell; with one inside, whether the lines meet."""
    places = [place for place in rims if place is not None]
    if len(places) < 4:
        return bool(np.all((t > 0) & (t < 1)))
    low, high = sorted(places[:2])
    return len(set(places)) == 4 and (low < places[2] < high) != (low < places[3] < high)


def cells_around(strip: Strip) -> dict[tuple[int, ...], list[int]]:
    """Rows of the cells around each vertex (a,), edge (a, b) and cell (a, b, c) of a strip."""
    table: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for row, cell in enumerate(strip.cells.tolist()):
        for size in (1, 2, 3):
            for key in combinations(sorted(cell), size):
                table[key].append(row)
    return dict(table)
