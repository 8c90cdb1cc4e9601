"""The points of all cables: which rank owns each, and what its number is.

A crossed cell is evaluated by the rank that owns it, with all segments, chords and facets in it.
Cable points belong to one rank and are ghosts on the others that need them. All ranks know the
cables' paths and the strip of crossed cells, so they number alike without communication.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from crms_fenicsx.cables.points_on_edges import points_by_edge
from crms_fenicsx.cables.rails import Rails
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.dofs.vertex_places import vertex_places
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import Edge, SurfacePoint

Corner = int | NodeId
"""A corner of a piece of a folded cell: a vertex by its id, or a cable's point (cable, node)."""


class Link(NamedTuple):
    """A straight part of a cable's polyline, from a node that it touches to the next.

    Attributes
    ----------
    cable, first, second
        Numbers of the cable and of the two nodes.
    vertices
        Ids of the cell (3) or edge (2) that it lies on; None off the membrane.
    """

    cable: int
    first: int
    second: int
    vertices: tuple[int, ...] | None


class CableNumbering:
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
        self._nodes = [cable.nodes for cable in cables]  # loops read them faster
        self.rank = u.function_space.mesh.comm.rank
        self._number_points()
        self._find_owners()
        self._number_vertices()
        self._lines: dict[Edge, list[int]] = {}

    def _number_points(self) -> None:
        """Numbers of the points that are no vertices, and the links between nodes."""
        self.numbers: dict[NodeId, int] = {}  # the two sides of a crossing have the same one
        self.links: list[Link] = []
        self._first: list[NodeId] = []  # a node of each point
        shared: dict[int, int] = {}
        for c, cable in enumerate(self.cables):
            # The points of a slack cable ride on the membrane, all of them.
            contacts = cable.contacts() if cable.taut else list(range(len(cable.nodes)))
            for k in contacts:
                node = cable.nodes[k]
                if node.kind == "vertex":
                    continue
                number = len(self._first)
                if node.crossing is not None:
                    number = shared.setdefault(node.crossing, number)
                if number == len(self._first):
                    self._first.append((c, k))
                self.numbers[c, k] = number
            for k, m in itertools.pairwise(contacts):
                self.links.append(
                    Link(c, k, m, self._shared_simplex(cable.nodes[k], cable.nodes[m]))
                )

    def _shared_simplex(self, a: CableNode, b: CableNode) -> tuple[int, ...] | None:
        """The cell or edge that two nodes of a cable lie on."""
        if a.point is None or b.point is None:
            return None
        both = tuple(sorted({*a.point.support, *b.point.support}))
        return both if self.strip.rows(both) else None

    def place_of(self, c: int, k: int) -> SurfacePoint:
        """The place of the mesh that says which rank a node belongs to.

        An anchor belongs to whom the point next to it belongs.
        """
        nodes = self._nodes[c]
        point = nodes[k].point or nodes[1 if k == 0 else k - 1].point
        assert point is not None, "two anchors in a row"
        return point

    def _find_owners(self) -> None:
        self.owners = np.array(
            [self.strip.owner_of(self.place_of(c, k).support) for c, k in self._first],
            dtype=np.int64,
        )

    def is_mine(self, c: int, k: int) -> bool:
        """Whether this rank owns a cable's node; whoever owns a vertex has the nodes on it."""
        node = self._nodes[c][k]
        if node.kind == "vertex":
            return self.strip.owner_of(node.interpolation()[0]) == self.rank
        return bool(self.owners[self.numbers[c, k]] == self.rank)

    def link_owner(self, link: Link) -> int:
        """The rank that computes a link of a cable."""
        on = link.vertices or self.place_of(link.cable, link.first).support
        return self.strip.owner_of(on)

    def _number_vertices(self) -> None:
        """Degrees of freedom of the vertices of this rank's cells of the strip, by id."""
        strip, dofmap = self.strip, self.u.function_space.dofmap
        self.own_rows = np.flatnonzero(strip.owner == self.rank)
        ids = strip.cells[self.own_rows].ravel()
        dofs = dofmap.list[strip.local[self.own_rows]].ravel()
        self._dof: dict[int, int] = {int(i): int(dof) for i, dof in zip(ids, dofs, strict=True)}
        # Points that this rank needs: those on its links and on the edges of its cells.
        needed = {number for number, (c, k) in enumerate(self._first) if self._near(c, k)}
        far: set[tuple[int, int]] = set()  # vertices at ends of spans, on ranks without them
        for link in self.links:
            owner = self.link_owner(link)
            for c, k in ((link.cable, link.first), (link.cable, link.second)):
                if (c, k) in self.numbers and owner == self.rank:
                    needed.add(self.numbers[c, k])
                node = self._nodes[c][k]
                if link.vertices is None and node.kind in ("vertex", "rail", "rider"):
                    far |= {(owner, vertex) for vertex in node.interpolation()[0]}
        self.owned = np.flatnonzero(self.owners == self.rank)
        index = np.zeros(len(self.owners), dtype=np.int64)
        for rank in np.unique(self.owners):
            own = np.flatnonzero(self.owners == rank)
            index[own] = np.arange(len(own))
        self.foreign = np.array(
            sorted(n for n in needed if self.owners[n] != self.rank), dtype=np.int64
        )
        self.ghosts = [(int(self.owners[n]), int(index[n])) for n in self.foreign]
        self._find_far_vertices(sorted(far))

    def _near(self, c: int, k: int) -> bool:
        """Whether a node lies on a cell of this rank."""
        point, strip = self._nodes[c][k].point, self.strip
        return point is not None and any(
            strip.owners[row] == self.rank for row in strip.rows(point.support)
        )

    def _find_far_vertices(self, far: Sequence[tuple[int, int]]) -> None:
        """Owner and number there of the vertices at ends of spans that this rank has not.

        Those that are the ends themselves, and those on which rails and riders at ends depend.
        """
        strip = self.strip
        far = [(rank, v) for rank, v in far if not np.any(strip.owner[strip.rows((v,))] == rank)]
        self.far_vertices: dict[int, tuple[int, int]] = {}
        self._far_X: list[Array] = []
        if not far:  # all ranks know the same
            return
        vertices = self.u.function_space.dofmap.index_map
        wanted = {v for _, v in far if self._dof.get(v, vertices.size_local) < vertices.size_local}
        X = vertex_places(self.u.function_space)
        mine = {v: (self.rank, self._dof[v], X[self._dof[v]]) for v in wanted if v in self._dof}
        known = {
            v: place
            for part in self.u.function_space.mesh.comm.allgather(mine)
            for v, place in part.items()
        }
        for rank, v in far:
            if rank == self.rank:
                owner, dof, place = known[v]
                self.far_vertices[v] = (owner, dof)
                self._far_X.append(place)

    def unknowns(self) -> Unknowns:
        """A layout with all cables' points, at their current positions."""
        unknowns = Unknowns(
            self.u.function_space, len(self.owned), self.ghosts, list(self.far_vertices.values())
        )
        self.blocks = np.full(len(self.owners), -1, dtype=np.int32)
        self.blocks[self.owned] = unknowns.owned_point_blocks()
        self.blocks[self.foreign] = unknowns.ghost_point_blocks()
        self._block_of: list[int] = self.blocks.tolist()
        blocks = unknowns.vertex_blocks()
        self._vertex_blocks = {v: int(blocks[dof]) for v, dof in self._dof.items()}
        far = unknowns.far_vertex_blocks()
        for v, block in zip(self.far_vertices, far, strict=True):
            self._vertex_blocks[v] = int(block)
        unknowns.X[far] = np.array(self._far_X).reshape(-1, 3)
        self.place_points(unknowns.X)
        return unknowns

    def place_points(self, places: Array) -> None:
        """Put the cables' points into the rows of `places`, local blocks, where they are now."""
        positions = [cable.positions for cable in self.cables]
        here = [(self._block_of[n], positions[c][k]) for (c, k), n in self.numbers.items()]
        here = [(block, place) for block, place in here if block >= 0]
        if here:
            places[[block for block, _ in here]] = [place for _, place in here]

    def dof(self, vertex: int) -> int:
        """Local degree of freedom of a vertex, by id."""
        return self._dof[vertex]

    def vertex(self, vertex: int) -> int:
        """Local block of a vertex, by id."""
        return self._vertex_blocks[vertex]

    def block(self, c: int, k: int) -> int:
        """Local block of a cable's node."""
        number = self.numbers.get((c, k))
        if number is not None:
            return self._block_of[number]
        node = self._nodes[c][k]
        assert node.kind == "vertex", "a lifted node has no block"
        return self.vertex(node.interpolation()[0][0])

    def corner(self, c: int, k: int) -> Corner:
        """A cable's node as a corner, the same one for both cables of a crossing."""
        node = self._nodes[c][k]
        return (
            node.interpolation()[0][0] if node.kind == "vertex" else self._first[self.numbers[c, k]]
        )

    def hold(self, unknowns: Unknowns) -> None:
        """Hold the anchors; let tied points and the sliding points of slack cables ride.

        Collective.
        """
        loaded: list[tuple[int, list[int], list[float]]] = []
        idle: list[tuple[int, list[int], list[float]]] = []
        rails: list[NodeId] = []
        for (c, k), number in self.numbers.items():
            block, cable, node = self._block_of[number], self.cables[c], self._nodes[c][k]
            if block < 0:
                continue
            unknowns.held[block] = node.kind == "anchor"
            if node.kind == "rail" and cable.taut:
                rails.append((c, k))
            if node.kind == "rider" or (node.slides and not cable.taut):
                ids, share = node.interpolation(cable.fractions[k] if node.slides else None)
                own = [self.vertex(i) for i in ids]
                interpolation, weights = own + own[:1] * (3 - len(own)), [*share, 0.0, 0.0][:3]
                (loaded if cable.taut else idle).append((block, interpolation, weights))
        riders = loaded + idle
        unknowns.set_riders(
            np.array([block for block, _, _ in riders], dtype=np.int32),
            np.array([interpolation for _, interpolation, _ in riders], dtype=np.int32).reshape(
                -1, 3
            ),
            np.array([weights for _, _, weights in riders], dtype=float).reshape(-1, 3),
            len(loaded),
        )
        self.rails = Rails(
            self.cables,
            rails,
            np.array([self.block(c, k) for c, k in rails], dtype=np.int32),
            np.array(
                [
                    [self.vertex(v) for v in self.cables[c].nodes[k].interpolation()[0]]
                    for c, k in rails
                ],
                dtype=np.int32,
            ).reshape(-1, 2),
        )
        if any(n.kind == "rail" for cable in self.cables if cable.taut for n in cable.nodes):
            vector, x = unknowns.vector()
            x[unknowns.vertex_blocks()] = self.u.x.array.reshape(-1, 3)
            unknowns.update_ghosts(vector)  # on far vertices
            self.rails.place(unknowns, x)
            vector.destroy()

    @cached_property
    def on_edge(self) -> dict[Edge, list[tuple[float, int, int]]]:
        """Points of the cables in tension on each edge, in the order that they keep."""
        return points_by_edge(self.cables)

    def blocks_along(self, edge: Edge) -> list[int]:
        """Local blocks along an edge with the points of all cables in tension; see `line`."""
        if edge not in self._lines:
            self._lines[edge] = self.line(edge, self.on_edge.get(edge, []))
        return self._lines[edge]

    def line(self, edge: Edge, points: Sequence[tuple[float, int, int]]) -> list[int]:
        """Local blocks along an edge: its first vertex, its points in order, its last vertex."""
        inner = (self.block(c, k) for _, c, k in points)
        return [self.vertex(edge[0]), *inner, self.vertex(edge[1])]
