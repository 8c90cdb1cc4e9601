"""The points of all cables: who owns which, what its number is, and where it is now.

A crossed cell is evaluated by the rank that owns it, with all segments, chords and facets in it.
Cable points belong to one rank and are ghosts on the others that need them. All ranks know the
cables' paths and the strip of crossed cells, so they number alike without communication.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from crms_fenicsx.cables.cable import LaidCable
from crms_fenicsx.cables.length import SMOOTHING
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.cables.volume import split_polygon
from crms_fenicsx.unknowns import Unknowns

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]
Edge = tuple[int, int]
Corner = int | tuple[int, int]
"""A corner of a piece of a folded cell: a vertex by its id, or a cable's point (cable, node)."""

Member = tuple[int, int]
"""A node of a cable: the cable's number, the node's number."""


class Link(NamedTuple):
    """A segment of a cable's polyline, from a node to the next.

    Attributes
    ----------
    cable, node
        Numbers of the cable and of the first node.
    vertices
        Ids of the cell (3) or edge (2) that it lies on; None off the membrane.
    """

    cable: int
    node: int
    vertices: tuple[int, ...] | None


BLOCKED = SMOOTHING
"""A sliding point nearer than this to an end of its side (fraction) has run into the vertex.

Farther off lengths are exact, so that nothing but the cable and the membrane holds it there.
"""


class Network:
    """Numbering of the points of all cables of a scene.

    Parameters
    ----------
    cables
        The laid cables, the same on all ranks.
    strip
        Cells around their paths.
    u
        Vertex displacements.
    """

    def __init__(self, cables: Sequence[LaidCable], strip: Strip, u: fem.Function) -> None:
        self.cables, self.strip, self.u = tuple(cables), strip, u
        self.rank = u.function_space.mesh.comm.rank
        self._number_points()
        self._find_owners()
        self._number_vertices()

    def _number_points(self) -> None:
        """Numbers of the points that are no vertices, and the links between nodes."""
        self.numbers: dict[tuple[int, int], int] = {}  # (cable, node) -> point
        self.links: list[Link] = []
        for c, cable in enumerate(self.cables):
            for k, node in enumerate(cable.nodes):
                if node.kind != "vertex":
                    self.numbers[c, k] = len(self.numbers)
            for k in range(len(cable.nodes) - 1):
                a, b = cable.nodes[k].point, cable.nodes[k + 1].point
                on = None if a is None or b is None else tuple({*a.support, *b.support})
                self.links.append(Link(c, k, on))

    def _find_owners(self) -> None:
        strip = self.strip
        self.owners = np.zeros(len(self.numbers), dtype=np.int64)
        for (c, k), number in self.numbers.items():
            nodes = self.cables[c].nodes
            # An anchor belongs to whom the point next to it belongs.
            near = k if nodes[k].point is not None else (1 if k == 0 else k - 1)
            point = nodes[near].point
            assert point is not None, "two anchors in a row"
            self.owners[number] = strip.owner_of(point.support)

    def link_owner(self, link: Link) -> int:
        """The rank that computes a link of a cable."""
        c, k, on = link
        if on is not None:
            return self.strip.owner_of(on)
        anchor = k if self.cables[c].nodes[k].point is None else k + 1
        return int(self.owners[self.numbers[c, anchor]])

    def _number_vertices(self) -> None:
        """Degrees of freedom of the vertices of this rank's cells of the strip, by id."""
        strip, dofmap = self.strip, self.u.function_space.dofmap
        self.own_rows = np.flatnonzero(strip.owner == self.rank)
        self._dof: dict[int, int] = {}
        for row in self.own_rows:
            for vertex, dof in zip(
                strip.cells[row].tolist(), dofmap.list[strip.local[row]].tolist(), strict=True
            ):
                self._dof[vertex] = dof
        # Points that this rank needs: those on its links and on the edges of its cells.
        needed = set()
        for link in self.links:
            if self.link_owner(link) == self.rank:
                c, k, _ = link
                needed |= {self.numbers.get((c, k), -1), self.numbers.get((c, k + 1), -1)}
        for (c, k), number in self.numbers.items():
            point = self.cables[c].nodes[k].point
            if point is not None and any(
                strip.owner[row] == self.rank for row in strip.rows(point.support)
            ):
                needed.add(number)
        needed -= {-1}
        self.owned = np.flatnonzero(self.owners == self.rank)
        index = np.zeros(len(self.owners), dtype=np.int64)
        for rank in np.unique(self.owners):
            own = np.flatnonzero(self.owners == rank)
            index[own] = np.arange(len(own))
        self.foreign = np.array(
            sorted(n for n in needed if self.owners[n] != self.rank), dtype=np.int64
        )
        self.ghosts = [(int(self.owners[n]), int(index[n])) for n in self.foreign]

    def unknowns(self) -> Unknowns:
        """A layout with all cables' points, at their current positions."""
        unknowns = Unknowns(self.u.function_space, len(self.owned), self.ghosts)
        self.blocks = np.full(len(self.numbers), -1, dtype=np.int32)
        self.blocks[self.owned] = unknowns.owned_point_blocks()
        self.blocks[self.foreign] = unknowns.ghost_point_blocks()
        self._vertex_blocks = unknowns.vertex_blocks()
        for (c, k), number in self.numbers.items():
            if self.blocks[number] >= 0:
                unknowns.X[self.blocks[number]] = self.cables[c].positions[k]
        return unknowns

    def dof(self, vertex: int) -> int:
        """Local degree of freedom of a vertex, by id."""
        return self._dof[vertex]

    def vertex(self, vertex: int) -> int:
        """Local block of a vertex, by id."""
        return int(self._vertex_blocks[self._dof[vertex]])

    def block(self, c: int, k: int) -> int:
        """Local block of a cable's node."""
        point = self.cables[c].nodes[k]
        if point.kind == "vertex":
            return self.vertex(point.masters()[0][0])
        return int(self.blocks[self.numbers[c, k]])

    def _corner(self, c: int, k: int) -> Corner:
        node = self.cables[c].nodes[k]
        return node.masters()[0][0] if node.kind == "vertex" else (c, k)

    def corner_block(self, corner: Corner) -> int:
        return self.vertex(corner) if isinstance(corner, int) else self.block(*corner)

    def hold(self, unknowns: Unknowns) -> None:
        """Hold the anchors; let tied points and the sliding points of slack cables ride."""
        riders, masters, weights = [], [], []
        self.rails: list[Member] = []
        for (c, k), number in self.numbers.items():
            block, cable = int(self.blocks[number]), self.cables[c]
            if block < 0:
                continue
            node = cable.nodes[k]
            unknowns.held[block] = node.kind == "anchor"
            if node.kind == "rail" and cable.taut:
                self.rails.append((c, k))
            if node.kind == "rider" or (node.slides and not cable.taut):
                ids, share = node.masters(cable.fractions[k] if node.slides else None)
                own = [self.vertex(i) for i in ids]
                riders.append(block)
                masters.append(own + own[:1] * (3 - len(own)))
                weights.append([*share, 0.0, 0.0][:3])
        unknowns.set_riders(
            np.array(riders, dtype=np.int32),
            np.array(masters, dtype=np.int32).reshape(-1, 3),
            np.array(weights, dtype=float).reshape(-1, 3),
        )
        if self.rails:
            x = np.zeros_like(unknowns.X)
            x[unknowns.vertex_blocks()] = self.u.x.array.reshape(-1, 3)
            self.place_rails(unknowns, x)

    def rail_table(self) -> tuple[Indices, Indices, Array]:
        """Rails: blocks (n,), blocks of their edges' ends (n, 2), places on the edges (n,)."""
        edges = [self.cables[c].nodes[k].masters()[0] for c, k in self.rails]
        ends = [(self.vertex(a), self.vertex(b)) for a, b in edges]
        return (
            np.array([self.block(c, k) for c, k in self.rails], dtype=np.int32),
            np.array(ends, dtype=np.int32).reshape(-1, 2),
            np.array([self.cables[c].fractions[k] for c, k in self.rails], dtype=float),
        )

    def place_rails(self, unknowns: Unknowns, x: Array) -> None:
        """Put the rails where they were on their edges, which may have been moved with x."""
        if not self.rails:
            return
        blocks, ends, fractions = self.rail_table()
        places = unknowns.X[ends] + x[ends]
        sides = places[:, 1] - places[:, 0]
        unknowns.X[blocks] = places[:, 0] + fractions[:, None] * sides
        x[blocks] = 0.0
        unknowns.set_rails(blocks, sides / np.linalg.norm(sides, axis=1)[:, None])

    def _rail_fractions(self, unknowns: Unknowns, x: Array) -> Array:
        """Current places of the rails on their edges, (n,)."""
        blocks, ends, _ = self.rail_table()
        start, end = (unknowns.X[own] + x[own] for own in ends.T)
        side, way = end - start, unknowns.X[blocks] + x[blocks] - start
        fractions: Array = np.sum(way * side, axis=1) / np.sum(side**2, axis=1)
        return fractions

    def _all_segments(self) -> tuple[Indices, Indices]:
        """Segments of all cables, taut or slack, that this rank computes; number of the cable."""
        own = [link for link in self.links if self.link_owner(link) == self.rank]
        segments = [(self.block(c, k), self.block(c, k + 1)) for c, k, _ in own]
        return (
            np.array(segments, dtype=np.int32).reshape(-1, 2),
            np.array([c for c, _, _ in own], dtype=np.int32),
        )

    def lengths(self, unknowns: Unknowns, x: Array) -> Array:
        """Lengths of all cables' polylines, (n_cables,)."""
        if not hasattr(self, "_segments"):
            self._segments, self._segment_cables = self._all_segments()
        ends = unknowns.X[self._segments] + x[self._segments]
        distances = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        local = np.bincount(self._segment_cables, distances, minlength=len(self.cables))
        total = np.zeros(len(self.cables))
        unknowns.comm.Allreduce(local.astype(float), total)
        return total

    def update_cables(self, unknowns: Unknowns, x: Array) -> None:
        """Tell all ranks where the cables' points are, and the sliding ones on their edges."""
        taut = {c for c, cable in enumerate(self.cables) if cable.taut}
        sizes = np.cumsum([0] + [len(cable.nodes) for cable in self.cables])
        local = np.zeros((int(sizes[-1]), 4))
        for c, cable in enumerate(self.cables):
            for k, node in enumerate(cable.nodes):
                if node.kind == "vertex":
                    mine = self.strip.owner_of(node.masters()[0]) == self.rank
                else:
                    mine = self.owners[self.numbers[c, k]] == self.rank
                if mine:
                    block = self.block(c, k)
                    local[sizes[c] + k, :3] = unknowns.X[block] + x[block]
        for edge, points in self.points_by_edge(taut).items():
            if self.strip.owner_of(edge) == self.rank:
                chain = [self.vertex(edge[0]), *(self.block(c, k) for _, c, k in points)]
                places = (unknowns.X + x)[[*chain, self.vertex(edge[1])]]
                steps = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))
                for (_, c, k), run in zip(points, steps[:-1], strict=True):
                    local[sizes[c] + k, 3] = run / steps[-1]
        for (c, k), fraction in zip(self.rails, self._rail_fractions(unknowns, x), strict=True):
            if self.owners[self.numbers[c, k]] == self.rank:
                local[sizes[c] + k, 3] = fraction
        total = np.zeros_like(local)
        unknowns.comm.Allreduce(local, total)
        for c, cable in enumerate(self.cables):
            part = total[sizes[c] : sizes[c + 1]]
            cable.positions[:] = part[:, :3]
            slides = np.array([node.slides for node in cable.nodes])
            if cable.taut:
                cable.fractions[slides] = part[slides, 3]
            close = (cable.fractions < BLOCKED) | (cable.fractions > 1 - BLOCKED)
            cable.blocked = tuple(int(k) for k in np.flatnonzero(slides & close) if cable.taut)

    def points_by_edge(self, cables: set[int]) -> dict[Edge, list[tuple[float, int, int]]]:
        """Points (fraction, cable, node) on each edge, sorted from its first vertex to its last."""
        table: dict[Edge, list[tuple[float, int, int]]] = defaultdict(list)
        for c in cables:
            cable = self.cables[c]
            for k, node in enumerate(cable.nodes):
                if (node.slides or node.kind == "rider") and len(node.masters()[0]) == 2:
                    edge = node.masters()[0]
                    fraction = cable.fractions[k] if node.slides else node.masters()[1][1]
                    table[edge[0], edge[1]].append((float(fraction), c, k))
        return {edge: sorted(points) for edge, points in table.items()}

    def pieces(self, number: Callable[[Corner], int]) -> list[tuple[int, list[int]]]:
        """Polygons into which the cables in tension cut this rank's folded cells.

        Parameters
        ----------
        number
            Gives the number of a corner in the caller's arrays.

        Returns
        -------
        list of (cell, polygon)
            Local cell number, and corners in the membrane's orientation, by number. Points on
            sides that no chord leaves are corners too.
        """
        taut = {c for c, cable in enumerate(self.cables) if cable.taut}
        on_edge, chords = self.points_by_edge(taut), self.chords_by_row(taut)
        return [
            (int(self.strip.local[row]), polygon)
            for row in self.folded_rows(on_edge)
            for polygon in self.cut(row, on_edge, chords.get(row, []), number)
        ]

    def chords_by_row(self, taut: set[int]) -> dict[int, list[tuple[Member, Member]]]:
        """Links, as their two (cable, node), through the inside of this rank's cells, by row."""
        chords: dict[int, list[tuple[Member, Member]]] = defaultdict(list)
        for c, k, on in self.links:
            if c in taut and on is not None and len(on) == 3:
                row = self.strip.rows(on)[0]
                if self.strip.owner[row] == self.rank:
                    chords[row].append(((c, k), (c, k + 1)))
        return chords

    def folded_rows(self, on_edge: dict[Edge, list[tuple[float, int, int]]]) -> list[int]:
        """Rows of this rank's cells with points on a side."""
        cells = self.strip.cells
        return [
            int(row)
            for row in self.own_rows
            if any(side_of(cells[row], k)[0] in on_edge for k in range(3))
        ]

    def cut(
        self,
        row: int,
        on_edge: dict[Edge, list[tuple[float, int, int]]],
        chords: Sequence[tuple[Member, Member]],
        number: Callable[[Corner], int],
    ) -> list[list[int]]:
        """Polygons of one cell."""
        around: list[Corner] = []
        for k in range(3):
            edge, forward = side_of(self.strip.cells[row], k)
            line: list[Corner] = [edge[0], *((c, i) for _, c, i in on_edge.get(edge, [])), edge[1]]
            around += (line if forward else line[::-1])[:-1]
        ends = [(number(self._corner(*a)), number(self._corner(*b))) for a, b in chords]
        return split_polygon([number(corner) for corner in around], ends)


def side_of(cell: npt.NDArray[np.int64], k: int) -> tuple[Edge, bool]:
    """Side k of a cell with its ids ascending, and whether that is the cell's own direction."""
    a, b = int(cell[k]), int(cell[(k + 1) % 3])
    return ((a, b), True) if a < b else ((b, a), False)
