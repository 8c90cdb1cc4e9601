"""Ownership and numbering of cable points, and the directions of those on held edges.

The owner of a crossed cell evaluates all segments, chords and facets in it. A cable point belongs
to one rank and is a ghost on others that need it. All ranks know the cables' paths and the strip of
crossed cells, so they number consistently without communication.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem

from crms_fenicsx.cabling.cables.points_on_edges import (
    ANCHOR,
    EDGE_SLIDER,
    TIED,
    VERTEX,
    NodeTable,
    PointsOnEdges,
    fractions_of,
    positions_of,
)
from crms_fenicsx.cabling.cables.row_shifts import RowShifts
from crms_fenicsx.cabling.cables.strip import NOBODY, Strip, StripShape
from crms_fenicsx.energy.terms.segments import BlockLists
from crms_fenicsx.foundation.dofs.layout import FrameBlocks, Unknowns, vertex_places
from crms_fenicsx.foundation.meshes.triangles import lists
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers, pointers, runs
from crms_fenicsx.model.cable_state import NodeId
from crms_fenicsx.model.laid_cable import LaidCable


class _EdgeSliders:
    """Edge sliders of taut cables known to this rank, with the blocks of their edges' ends, and the
    other sliders beside them: blocks (n,), projectors (n, 3, 3)."""

    def __init__(
        self,
        cables: Sequence[LaidCable],
        members: Sequence[NodeId],
        blocks: Indices,
        ends: Indices,
        others: tuple[Indices, Array],
    ) -> None:
        self._cables, self.members, self.blocks, self.ends = cables, members, blocks, ends
        self._others = others

    def known_fractions(self) -> Array:
        """Fractions of the edge sliders on their edges, from the cables, (n,)."""
        return np.array([self._cables[c].state.fractions[k] for c, k in self.members], dtype=float)

    def place(self, unknowns: Unknowns, x: Array) -> None:
        """Restore the edge sliders' fractions on their edges, which may have moved with x."""
        if not self.members:
            return
        places = unknowns.X[self.ends] + x[self.ends]
        sides = places[:, 1] - places[:, 0]
        unknowns.X[self.blocks] = places[:, 0] + self.known_fractions()[:, None] * sides
        x[self.blocks] = 0.0
        d = sides / np.linalg.norm(sides, axis=1)[:, None]
        blocks, projectors = self._others
        unknowns.set_sliders(
            np.concatenate([self.blocks, blocks]),
            np.concatenate([d[:, :, None] * d[:, None, :], projectors]),
        )

    def fractions(self, unknowns: Unknowns, x: Array) -> Array:
        """Fractions of the edge sliders on their edges at the displacements x, (n,)."""
        start, end = (unknowns.X[own] + x[own] for own in self.ends.T)
        side, way = end - start, unknowns.X[self.blocks] + x[self.blocks] - start
        fractions: Array = np.sum(way * side, axis=1) / np.sum(side**2, axis=1)
        return fractions


@dataclass(frozen=True)
class Links:
    """The n straight links of the cables' polylines, from contact to contact."""

    first: Integers  # (n,) rows of both end nodes in the table of nodes
    second: Integers
    on: Integers  # (n,) number of the cell or edge of a link; -1 off the membrane
    around: Integers  # (n,) the same; off the membrane the simplex of the first node
    owner: Integers  # (n,) rank that computes it


class CableNumbering:
    """Numbering of all cable points of a scene."""

    def __init__(
        self,
        cables: Sequence[LaidCable],
        strip: Strip,
        u: fem.Function,
        nodes: NodeTable | None = None,
        shifts: RowShifts | None = None,
        facing: BlockLists | None = None,
    ) -> None:
        """Number the points of cables; where rows of the table of nodes face others, the owner of
        each first one knows those behind it."""
        self.cables, self.strip, self.u, self._facing = tuple(cables), strip, u, facing
        self.shifts = RowShifts.none() if shifts is None else shifts
        self.rank = u.function_space.mesh.comm.rank
        self.nodes = NodeTable.of(self.cables, nodes)
        # (nodes,) number of the simplex of each node in the strip; -1 for anchors
        self.on = self.nodes.on(strip.simplices)
        # (m,) owner of points on each simplex; over holes, where only crossings are, the first rank
        owner = strip.simplices.owner
        self._open = owner == NOBODY
        self._owner = np.where(self._open, 0, owner)
        # All points of a slack cable are tied to the membrane, but those over holes.
        over = (self.on >= 0) & np.append(self._open, False)[self.on]
        self._used = np.flatnonzero(~(self.nodes.lifted & (self.nodes.taut | over)))
        self.links = self._find_links()
        self._number_points()
        self._number_vertices()

    def _places(self, rows: Integers) -> Integers:
        """Simplices that determine the owners of nodes; an anchor takes that of the next node."""
        nodes = self.nodes
        beside = np.where(nodes.place[rows] == 0, rows + 1, rows - 1)
        places = self.on[np.where(nodes.size[rows] == 0, beside, rows)]
        assert np.all(places >= 0), "two anchors in a row, or a node off the strip"
        return places

    def _find_links(self) -> Links:
        nodes, simplices = self.nodes, self.strip.simplices
        first, second = self._used[:-1], self._used[1:]
        same = nodes.cable[first] == nodes.cable[second]
        first, second = first[same], second[same]
        on = simplices.spanned(self.on[first], self.on[second])
        on[np.append(self._open, False)[on]] = -1
        on[nodes.in_air[first] | nodes.in_air[second]] = -1
        around = on.copy()
        off = np.flatnonzero(on < 0)
        around[off] = self._places(first[off])
        open_ = off[self._open[around[off]]]
        around[open_] = self._places(second[open_])
        return Links(first, second, on, around, self._owner[around])

    def _number_points(self) -> None:
        """Number the points that are not vertices, and find their owners."""
        nodes = self.nodes
        points = self._used[nodes.kind[self._used] != VERTEX]
        shared = np.flatnonzero(nodes.crossing[points] >= 0)
        _, first, side = np.unique(
            nodes.crossing[points[shared]], return_index=True, return_inverse=True
        )
        same = np.arange(len(points))
        same[shared] = shared[first[side]]
        new = same == np.arange(len(points))
        # (nodes,) point number, common to a crossing's nodes; -1 for vertices and lifted nodes
        self.number = np.full(len(nodes.kind), -1)
        self.number[points] = (np.cumsum(new) - 1)[same]
        self.n_nodes = int(np.count_nonzero(new))  # points that are nodes
        # row of one node of each point, and of each shift
        self.first = np.concatenate([points[new], self.shifts.nodes])
        self.owners = self._owner[self._places(self.first)].astype(np.int64)
        self.node_owners = np.where(self.number >= 0, np.append(self.owners, -1)[self.number], -1)
        at_vertex = nodes.kind == VERTEX  # nodes at a vertex belong to its owner
        self.node_owners[at_vertex] = self.strip.simplices.owner[self.on[at_vertex]]

    @property
    def numbers(self) -> dict[NodeId, int]:
        """Point numbers by cable and node."""
        rows = np.flatnonzero(self.number >= 0)
        return dict(zip(self.nodes.ids(rows), map(int, self.number[rows]), strict=True))

    def row(self, c: int, k: int) -> int:
        """Row of a cable's node in the table of nodes."""
        return int(self.nodes.starts[c]) + k

    def is_mine(self, c: int, k: int) -> bool:
        """Whether this rank owns a cable's node."""
        return bool(self.node_owners[self.row(c, k)] == self.rank)

    def _number_vertices(self) -> None:
        """Find local degrees of freedom of the strip's vertices, and this rank's points."""
        strip, links, simplices = self.strip, self.links, self.strip.simplices
        self.own_rows = np.flatnonzero(strip.owner == self.rank)
        # local degrees of freedom of the strip's vertices; -1 on other ranks
        self.dofs = np.full(len(strip.vertices), -1)
        dofs = self.u.function_space.dofmap.list[strip.local[self.own_rows]]
        self.dofs[simplices.cells[self.own_rows]] = dofs
        # Points needed by this rank: those on its links and on the edges of its cells.
        near = simplices.touch(strip.owner == self.rank)
        on = self.on[self.first]
        needed = (on >= 0) & np.append(near, False)[on]
        ends = np.stack([links.first, links.second], axis=1)
        numbers = self.number[ends[links.owner == self.rank]]
        needed[numbers[numbers >= 0]] = True
        faced, facing = self._faced()  # held vertices follow their shifts, also far ones
        mine = self.nodes.support[faced[facing == self.rank], 0]
        needed[self.n_nodes + np.flatnonzero(np.isin(self.shifts.vertices, mine))] = True
        self.owned = np.flatnonzero(self.owners == self.rank)
        index = np.zeros(len(self.owners), dtype=np.int64)
        for rank in np.unique(self.owners):
            own = np.flatnonzero(self.owners == rank)
            index[own] = np.arange(len(own))
        self.foreign = np.flatnonzero(needed & (self.owners != self.rank))
        owners = self.owners[self.foreign]
        self.ghosts = [
            (int(rank), int(n)) for rank, n in zip(owners, index[self.foreign], strict=True)
        ]
        off = np.repeat(links.on < 0, 2)
        owner, ends = np.repeat(links.owner, 2)[off], ends.ravel()[off]
        given = np.isin(self.nodes.kind[ends], (VERTEX, EDGE_SLIDER, TIED))
        supports = self.nodes.support[ends[given]]
        far = np.stack([np.repeat(owner[given], 3), supports.ravel()], axis=1)
        far = np.append(far, np.stack([facing, self.nodes.support[faced, 0]], axis=1), axis=0)
        # Vertices at ends of spans, on ranks that lack them.
        self._find_far_vertices(far[far[:, 1] >= 0])

    def _faced(self) -> tuple[Integers, Integers]:
        """Rows (n,) of nodes that face others, and ranks that compute these contacts."""
        if self._facing is None:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        rows, begins = self._facing.blocks.astype(np.int64), self._facing.pointers
        return rows, np.repeat(self.node_owners[rows[begins[:-1]]], np.diff(begins))

    def _find_far_vertices(self, far: Integers) -> None:
        """Find owner and number of vertices that ends of this rank's spans depend on but that it
        lacks; `far` (n, 2) are ranks and vertices."""
        strip = self.strip
        at = strip.simplices.find(np.pad(far[:, 1:], ((0, 0), (0, 2)), constant_values=-1))
        counts, rows = strip.simplices.around(at)
        there = strip.owner[rows] == np.repeat(far[:, 0], counts)
        own = np.bincount(np.repeat(np.arange(len(far)), counts), there, len(far)) > 0
        far = np.unique(far[~own], axis=0)
        self.far_vertices: dict[int, tuple[int, int]] = {}
        self._far_X: list[Array] = []
        if len(far) == 0:  # the same on all ranks
            return
        vertices = self.u.function_space.dofmap.index_map
        X = vertex_places(self.u.function_space)
        dofs = {v: self.dof(v) for v in map(int, far[:, 1])}
        wanted = {v: dof for v, dof in dofs.items() if 0 <= dof < vertices.size_local}
        mine = {v: (self.rank, dof, X[dof]) for v, dof in wanted.items()}
        known = dict(ChainMap(*self.u.function_space.mesh.comm.allgather(mine)))
        for rank, v in lists(far):
            if rank == self.rank:
                owner, dof, place = known[v]
                self.far_vertices[v] = (owner, dof)
                self._far_X.append(place)

    def unknowns(self, frame: FrameBlocks | None = None) -> Unknowns:
        """Layout with all cable points at their current positions, and a frame's blocks."""
        self._frame = frame
        V, far_vertices = self.u.function_space, list(self.far_vertices.values())
        if frame is None:
            unknowns = Unknowns(V, len(self.owned), self.ghosts, far_vertices)
        else:
            of_first = int(np.count_nonzero(self.owners == 0))
            unknowns = frame.layout(V, len(self.owned), self.ghosts, far_vertices, of_first)
        # local blocks of points, of the strip's vertices and of nodes; -1 if absent on this rank
        self.blocks = np.full(len(self.owners), -1, dtype=np.int32)
        self.blocks[self.owned] = unknowns.owned_point_blocks()[: len(self.owned)]
        self.blocks[self.foreign] = unknowns.ghost_point_blocks()[: len(self.foreign)]
        # A rank may have no vertex.
        self.vertex_blocks = np.append(unknowns.vertex_blocks(), np.int32(-1))[self.dofs]
        far = unknowns.far_vertex_blocks()[: len(far_vertices)]
        self.vertex_blocks[[self.strip.row_of[v] for v in self.far_vertices]] = far
        # (m,) local blocks of the shifts, and of their vertices; -1 if absent on this rank
        self.shift_blocks = self.blocks[self.n_nodes :]
        self.node_blocks = np.where(self.number >= 0, np.append(self.blocks, -1)[self.number], -1)
        at_vertex = self.nodes.kind == VERTEX
        corners = self.strip.simplices.corners[self.on[at_vertex], 0]
        self.node_blocks[at_vertex] = self.vertex_blocks[corners]
        unknowns.X[far] = np.array(self._far_X).reshape(-1, 3)
        here = self.shift_blocks >= 0
        self.shifted_blocks = np.where(here, self.node_blocks[self.shifts.nodes], -1)
        unknowns.shifts, unknowns.n_shifts = self.shift_blocks[here], len(here)
        self.place_shifts(unknowns)
        self.place_points(unknowns.X)
        return unknowns

    def renew_places(self, unknowns: Unknowns, shape: StripShape) -> None:
        """Read the stress-free places of the vertices again; bounds stay in space."""
        before = unknowns.X.copy()
        unknowns.X[unknowns.vertex_blocks()] = vertex_places(self.u.function_space)
        far = [self.strip.row_of[v] for v in self.far_vertices]
        unknowns.X[unknowns.far_vertex_blocks()[: len(far)]] = shape.stress_free[far]
        for bounds in unknowns.bounds or ():
            bounds += before - unknowns.X

    @property
    def own_shifts(self) -> Integers:
        """Which of the shifts this rank owns, (k,)."""
        return np.flatnonzero(self.owners[self.n_nodes :] == self.rank)

    def place_shifts(self, unknowns: Unknowns) -> None:
        """Put the shifts of this rank where their vertices are now, which tied ones follow.
        Collective."""
        here = np.flatnonzero(self.shift_blocks >= 0)
        own, blocks = self.shifts.nodes[here], self.shifted_blocks[here]
        dofs = self.dofs[self.strip.simplices.corners[self.on[own], 0]]
        u = self.u.x.array.reshape(-1, 3)[dofs]
        if self._facing is not None:  # some may be far vertices
            vector, x = unknowns.vector()
            x[unknowns.vertex_blocks()] = self.u.x.array.reshape(-1, 3)
            unknowns.update_ghosts(vector)
            u = x[blocks]
            vector.destroy()
        unknowns.X[self.shift_blocks[here]] = unknowns.X[blocks] + u

    def place_points(self, places: Array) -> None:
        """Set the rows of `places` (local blocks) of cable points to their current positions."""
        rows = self._own_points
        places[self.node_blocks[rows]] = positions_of(self.cables)[rows]

    @cached_property
    def _own_points(self) -> Integers:
        """Rows of the nodes whose points are on this rank."""
        return np.flatnonzero((self.number >= 0) & (self.node_blocks >= 0))

    def dof(self, vertex: int) -> int:
        """Local degree of freedom of a vertex id; -1 on ranks without a cell there."""
        return int(self.dofs[self.strip.row_of[vertex]])

    def vertex(self, vertex: int) -> int:
        """Local block of a vertex id."""
        return int(self.vertex_blocks[self.strip.row_of[vertex]])

    def block(self, c: int, k: int) -> int:
        """Local block of a cable's node, or -1."""
        return int(self.node_blocks[self.row(c, k)])

    def shift_blocks_at(self, rows: Integers) -> Indices:
        """Local blocks of the shifts of nodes at vertices that shift, (n,)."""
        at = np.searchsorted(self.shifts.vertices, self.nodes.support[rows, 0])
        return self.shift_blocks[at]

    def support_blocks(self, rows: Integers) -> Integers:
        """Local blocks of the nodes' support vertices, (n, 3), padded with -1."""
        on = self.on[rows]
        corners = self.strip.simplices.corners[on]
        return np.where((corners < 0) | (on < 0)[:, None], -1, self.vertex_blocks[corners])

    def hold(self, unknowns: Unknowns) -> None:
        """Hold anchors, and tie to the membrane or joints: tied points, sliding points of slack
        cables and cable ends fixed to joints. Collective."""
        nodes, rows, joints = self.nodes, self._own_points, self._joint_blocks()
        unknowns.held[self.node_blocks[rows[nodes.kind[rows] == ANCHOR]]] = True
        rides = (nodes.kind == TIED) | (nodes.slides & ~nodes.taut) | (joints >= 0)
        loaded, idle = (rows[rides[rows] & (nodes.taut[rows] == taut)] for taut in (True, False))
        tied_points = np.concatenate([loaded, idle])
        weights = nodes.weights[tied_points]
        slides = nodes.slides[tied_points]
        s = self.fractions()[tied_points[slides]]
        weights[slides, :2] = np.stack([1 - s, s], axis=1)
        ends = self.support_blocks(tied_points)
        on_joint = joints[tied_points] >= 0
        ends[on_joint, 0], weights[on_joint, 0] = joints[tied_points[on_joint]], 1.0
        here = self.shift_blocks >= 0
        with_shifts = np.flatnonzero(here & self.shifts.held)
        carried = np.repeat(self.shift_blocks[with_shifts, None], 3, axis=1)
        unknowns.set_tied_points(
            np.append(self.shifted_blocks[with_shifts], self.node_blocks[tied_points]).astype(
                np.int32
            ),
            np.append(carried, np.where(ends < 0, ends[:, :1], ends), axis=0).astype(np.int32),
            np.append(np.tile([1.0, 0.0, 0.0], (len(carried), 1)), weights, axis=0),
            len(carried) + len(loaded),
        )
        edge_sliders = rows[(nodes.kind[rows] == EDGE_SLIDER) & nodes.taut[rows]]
        self.edge_sliders = _EdgeSliders(
            self.cables,
            nodes.ids(edge_sliders),
            self.node_blocks[edge_sliders].astype(np.int32),
            self.support_blocks(edge_sliders)[:, :2].astype(np.int32),
            (self.shift_blocks[here], self.shifts.projectors[here]),
        )
        unknowns.set_sliders(self.shift_blocks[here], self.shifts.projectors[here])
        unknowns.shift_sizes = self.shifts.sizes[here]
        if np.any((nodes.kind == EDGE_SLIDER) & nodes.taut):
            vector, x = unknowns.vector()
            x[unknowns.vertex_blocks()] = self.u.x.array.reshape(-1, 3)
            unknowns.update_ghosts(vector)  # on far vertices
            self.edge_sliders.place(unknowns, x)
            vector.destroy()

    def _joint_blocks(self) -> Integers:
        """Local blocks of the joints to which nodes are fixed, (nodes,); -1 for others."""
        found = np.full(len(self.nodes.kind), -1)
        for c, cable in enumerate(self.cables):
            for k, name in zip(
                (0, len(cable.state.nodes) - 1), cable.state.laid.joints, strict=True
            ):
                if name is not None:
                    assert self._frame is not None
                    found[self.row(c, k)] = self._frame.block(name)
        return found

    def fractions(self) -> Array:
        """Current fractions of the nodes on their edges, (nodes,)."""
        return fractions_of(self.cables)

    @cached_property
    def points(self) -> PointsOnEdges:
        """Points of taut cables on each edge, in an order that stays fixed."""
        return self.points_now()

    def points_now(self) -> PointsOnEdges:
        """The same in their current order: edge sliders may have passed others."""
        size = len(self.strip.simplices.owner)
        return PointsOnEdges(self.nodes, ~self.nodes.lifted, self.on, self.fractions(), size)

    def lines(
        self, edges: Integers, points: PointsOnEdges | None = None
    ) -> tuple[Integers, Indices]:
        """Local blocks along edges in CSR form: start vertex, points of taut cables, end vertex."""
        points = self.points if points is None else points
        counts = points.counts[edges]
        starts = pointers(counts + 2)
        blocks = np.empty(starts[-1], dtype=np.int32)
        ends = self.vertex_blocks[self.strip.simplices.corners[edges, :2]]
        blocks[starts[:-1]], blocks[starts[1:] - 1] = ends.T
        inner = points.nodes[runs(points.starts[edges], counts)]
        blocks[runs(starts[:-1] + 1, counts)] = self.node_blocks[inner]
        return starts, blocks
