"""From laid cables to tables: who owns which point, and what each rank computes.

A crossed cell is evaluated by the rank that owns it, with all segments, chords and facets in it.
Cable points belong to one rank and are ghosts on the others that need them. All ranks know the
cables' paths and the strip of crossed cells, so they number alike without communication.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from crms_fenicsx.cables.cable import LaidCable
from crms_fenicsx.cables.fold import FoldedCells
from crms_fenicsx.cables.length import COINCIDENT, SMOOTHING
from crms_fenicsx.cables.penalty import Kinks
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.cables.volume import Facets, fan_facets, split_polygon
from crms_fenicsx.compat import geometry_dofmap
from crms_fenicsx.membrane import MembraneEnergy
from crms_fenicsx.unknowns import Unknowns

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]
Edge = tuple[int, int]
Corner = int | tuple[int, int]
"""A corner of a piece of a folded cell: a vertex by its id, or a cable's point (cable, node)."""

BLOCKED = SMOOTHING
"""A fold point nearer than this to an end of its side (fraction) has run into the vertex.

Farther off lengths are exact, so that nothing but the cable and the membrane holds it there.
"""


@dataclass(frozen=True)
class CableTables:
    """What this rank computes for the cables in tension.

    Attributes
    ----------
    segments : (n, 2), eps : (n,), cable : (n,)
        Segments of the cables' polylines, their smoothing, and the cable's place among the taut.
    folded : FoldedCells
        Cells with folded sides.
    kinks : tuple of (corner blocks (4,), row of `folded`)
        Where chords meet sides at fold points that are free.
    facets : Facets
        Facets of the folded cells.
    """

    segments: Indices
    eps: Array
    cable: Indices
    folded: FoldedCells
    kinks: list[tuple[tuple[int, int, int, int], int]]
    facets: Facets

    def penalty(self, factor: float, moduli: Array) -> Kinks:
        """Weighted penalty with mu = factor x E t x A; `moduli` (n,) is E t of the folded cells."""
        rows = np.array([row for _, row in self.kinks], dtype=np.int64)
        return Kinks(self._corners(), (factor * moduli * self.folded.areas)[rows], True)

    def literal_penalty(self, mu: float) -> Kinks:
        """The paper's penalty with one coefficient for all, (2.5-1)."""
        return Kinks(self._corners(), np.full(len(self.kinks), mu), False)

    def _corners(self) -> Indices:
        return np.array([k for k, _ in self.kinks], dtype=np.int32).reshape(-1, 4)


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
        self._find_edges()
        self._find_owners()
        self._number_vertices()

    def _find_edges(self) -> None:
        """Points on each mesh edge, and the links of each cable with what they lie on."""
        self.numbers: dict[tuple[int, int], int] = {}  # (cable, node) -> point
        self.links: list[tuple[int, int, tuple[int, ...] | None]] = []  # cable, node, vertices
        for c, cable in enumerate(self.cables):
            for k, node in enumerate(cable.nodes):
                if node.kind != "vertex":
                    self.numbers[c, k] = len(self.numbers)
            for k in range(len(cable.nodes) - 1):
                a, b = cable.nodes[k].point, cable.nodes[k + 1].point
                on = None if a is None or b is None else tuple({*a.support, *b.support})
                self.links.append((c, k, on))

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

    def link_owner(self, link: tuple[int, int, tuple[int, ...] | None]) -> int:
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

    def _corner_block(self, corner: Corner) -> int:
        return self.vertex(corner) if isinstance(corner, int) else self.block(*corner)

    def hold(self, unknowns: Unknowns) -> None:
        """Hold the anchors; let tied points and the fold points of slack cables ride."""
        riders, masters, weights = [], [], []
        for (c, k), number in self.numbers.items():
            block, cable = int(self.blocks[number]), self.cables[c]
            if block < 0:
                continue
            node = cable.nodes[k]
            unknowns.held[block] = node.kind == "anchor"
            if node.kind == "rider" or (node.kind == "fold" and not cable.taut):
                ids, share = node.masters(cable.fractions[k] if node.kind == "fold" else None)
                own = [self.vertex(i) for i in ids]
                riders.append(block)
                masters.append(own + own[:1] * (3 - len(own)))
                weights.append([*share, 0.0, 0.0][:3])
        unknowns.set_riders(
            np.array(riders, dtype=np.int32),
            np.array(masters, dtype=np.int32).reshape(-1, 3),
            np.array(weights, dtype=float).reshape(-1, 3),
        )

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
        """Tell all ranks where the cables' points and fold points on their edges are."""
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
        total = np.zeros_like(local)
        unknowns.comm.Allreduce(local, total)
        for c, cable in enumerate(self.cables):
            part = total[sizes[c] : sizes[c + 1]]
            cable.positions[:] = part[:, :3]
            fold = np.array([node.kind == "fold" for node in cable.nodes])
            if cable.taut:
                cable.fractions[fold] = part[fold, 3]
            close = (cable.fractions < BLOCKED) | (cable.fractions > 1 - BLOCKED)
            cable.blocked = tuple(int(k) for k in np.flatnonzero(fold & close) if cable.taut)

    def tables(self, membrane: MembraneEnergy) -> CableTables:
        """Tables of the cables in tension."""
        taut = {c: n for n, c in enumerate(c for c, k in enumerate(self.cables) if k.taut)}
        sizes = _cell_sizes(self.u)
        segments: list[tuple[int, int]] = []
        eps: list[float] = []
        number: list[int] = []
        for link in self.links:
            c, k, _ = link
            if c in taut and self.link_owner(link) == self.rank:
                segments.append((self.block(c, k), self.block(c, k + 1)))
                number.append(taut[c])
                eps.append(self._link_smoothing(link, sizes))
        folded, kinks, facets = self._cell_tables(membrane, set(taut))
        return CableTables(
            np.array(segments, dtype=np.int32).reshape(-1, 2),
            np.array(eps),
            np.array(number, dtype=np.int32),
            folded,
            kinks,
            facets,
        )

    def _link_smoothing(self, link: tuple[int, int, tuple[int, ...] | None], sizes: Array) -> float:
        c, k, on = link
        first, second = self.cables[c].nodes[k : k + 2]
        if on is None:
            point = first.point or second.point
            assert point is not None, "two anchors in a row"
            on, slides = point.support, "fold" in (first.kind, second.kind)
        else:
            slides = not {first.kind, second.kind} <= {"rider"}
        rows = [r for r in self.strip.rows(on) if self.strip.owner[r] == self.rank]
        size = float(min(sizes[self.strip.local[r]] for r in rows))
        # An anchor may lie on the held place next to it: no direction, and none is needed.
        return SMOOTHING * size if slides else -COINCIDENT * size

    def points_by_edge(self, cables: set[int]) -> dict[Edge, list[tuple[float, int, int]]]:
        """Points (fraction, cable, node) on each edge, sorted from its first vertex to its last."""
        table: dict[Edge, list[tuple[float, int, int]]] = defaultdict(list)
        for c in cables:
            cable = self.cables[c]
            for k, node in enumerate(cable.nodes):
                if node.kind in ("fold", "rider") and len(node.masters()[0]) == 2:
                    edge = node.masters()[0]
                    fraction = cable.fractions[k] if node.kind == "fold" else node.masters()[1][1]
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
        on_edge, chords = self.points_by_edge(taut), self._chords(taut)
        return [
            (int(self.strip.local[row]), polygon)
            for row in self._folded_rows(on_edge)
            for polygon in self._cut(row, on_edge, chords.get(row, []), number)
        ]

    def _chords(self, taut: set[int]) -> dict[int, list[tuple[tuple[int, int], tuple[int, int]]]]:
        """Links, as their two (cable, node), through the inside of this rank's cells, by row."""
        chords: dict[int, list[tuple[tuple[int, int], tuple[int, int]]]] = defaultdict(list)
        for c, k, on in self.links:
            if c in taut and on is not None and len(on) == 3:
                row = self.strip.rows(on)[0]
                if self.strip.owner[row] == self.rank:
                    chords[row].append(((c, k), (c, k + 1)))
        return chords

    def _folded_rows(self, on_edge: dict[Edge, list[tuple[float, int, int]]]) -> list[int]:
        cells = self.strip.cells
        return [
            int(row)
            for row in self.own_rows
            if any(_edge(cells[row], k)[0] in on_edge for k in range(3))
        ]

    def _cut(
        self,
        row: int,
        on_edge: dict[Edge, list[tuple[float, int, int]]],
        chords: list[tuple[tuple[int, int], tuple[int, int]]],
        number: Callable[[Corner], int],
    ) -> list[list[int]]:
        """Polygons of one cell."""
        around: list[Corner] = []
        for k in range(3):
            edge, forward = _edge(self.strip.cells[row], k)
            line: list[Corner] = [edge[0], *((c, i) for _, c, i in on_edge.get(edge, [])), edge[1]]
            around += (line if forward else line[::-1])[:-1]
        ends = [(number(self._corner(*a)), number(self._corner(*b))) for a, b in chords]
        return split_polygon([number(corner) for corner in around], ends)

    def _cell_tables(
        self, membrane: MembraneEnergy, taut: set[int]
    ) -> tuple[FoldedCells, list[tuple[tuple[int, int, int, int], int]], Facets]:
        """Tables of this rank's folded cells."""
        on_edge, chords = self.points_by_edge(taut), self._chords(taut)
        strip, rows = self.strip, self._folded_rows(on_edge)
        mesh = self.u.function_space.mesh
        local = strip.local[rows].astype(np.int32)
        X: Array = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[local]], dtype=float)
        vectors = np.roll(X, -1, axis=1) - X
        axes = membrane.material_axes(local)
        tags = membrane.material_tags(local)
        segments: dict[tuple[int, int], int] = {}
        eps: list[float] = []
        sides: dict[Edge, int] = {}
        side_segments: list[list[int]] = []
        cell_sides = np.zeros((len(rows), 3), dtype=np.int32)
        kinks: list[tuple[tuple[int, int, int, int], int]] = []
        facets: list[tuple[tuple[int, int, int], float]] = []
        for n, row in enumerate(rows):
            neighbours: dict[int, tuple[int, int]] = {}
            for k in range(3):
                edge, _ = _edge(strip.cells[row], k)
                nodes = [(c, i) for _, c, i in on_edge.get(edge, [])]
                inner = [self.block(*m) for m in nodes]
                line = [self.vertex(edge[0]), *inner, self.vertex(edge[1])]
                if edge not in sides:
                    sides[edge] = len(side_segments)
                    length = float(np.linalg.norm(vectors[n, k]))
                    own = []
                    for pair in itertools.pairwise(line):
                        own.append(segments.setdefault(pair, len(segments)))
                        if own[-1] == len(eps):
                            eps.append(SMOOTHING * length if nodes else 0.0)
                    side_segments.append(own)
                cell_sides[n, k] = sides[edge]
                for i in range(1, len(line) - 1):
                    neighbours[line[i]] = (line[i - 1], line[i + 1])
            for a, b in chords.get(row, []):
                p, q = self.block(*a), self.block(*b)
                for node, end, other in ((a, p, q), (b, q, p)):
                    if self.cables[node[0]].nodes[node[1]].kind == "fold" and end in neighbours:
                        before, after = neighbours[end]
                        kinks.append(((before, end, after, other), n))
            for part in self._cut(row, on_edge, chords.get(row, []), self._corner_block):
                facets += fan_facets(part)
        pointers = np.cumsum([0] + [len(own) for own in side_segments])
        materials = [membrane.materials[int(tag)] for tag in tags]
        folded = FoldedCells(
            cells=local,
            segments=np.array(list(segments), dtype=np.int32).reshape(-1, 2),
            eps=np.array(eps),
            side_pointers=pointers.astype(np.int32),
            side_segments=np.array([s for own in side_segments for s in own], dtype=np.int32),
            sides=cell_sides,
            side_vectors=np.einsum("nki,nai->nka", vectors, axes),
            laws=np.array([m.law for m in materials], dtype=np.int32),
            parameters=np.array([m.parameters for m in materials]).reshape(-1, 17),
        )
        corners = [[self.vertex(v) for v in strip.cells[row].tolist()] for row in rows]
        return (
            folded,
            kinks,
            Facets(
                np.array([f for f, _ in facets], dtype=np.int32).reshape(-1, 3),
                np.array([w for _, w in facets]),
                np.array(corners, dtype=np.int32).reshape(-1, 3),
            ),
        )


def _edge(cell: npt.NDArray[np.int64], k: int) -> tuple[Edge, bool]:
    """Side k of a cell with its ids ascending, and whether that is the cell's own direction."""
    a, b = int(cell[k]), int(cell[(k + 1) % 3])
    return ((a, b), True) if a < b else ((b, a), False)


def _cell_sizes(u: fem.Function) -> Array:
    """Square roots of twice the stress-free areas of the local cells (length)."""
    mesh = u.function_space.mesh
    x = mesh.geometry.x[geometry_dofmap(mesh)]
    cross = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return np.sqrt(np.linalg.norm(cross, axis=1))
