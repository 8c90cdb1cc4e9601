"""Positions of cable points in space, on edges and on the stress-free membrane, on all ranks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.points_on_edges import CROSSING
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, pointers, runs


class NodePositions:
    """Gathers the node positions of all cables, in the order of the cables."""

    def __init__(self, numbering: CableNumbering, unknowns: Unknowns) -> None:
        self.numbering, self.unknowns = numbering, unknowns
        nodes, points, rank = numbering.nodes, numbering.points, numbering.rank
        self._starts = [int(start) for start in nodes.starts]
        empty = np.zeros(0, dtype=bool)
        lifted = np.concatenate([empty, *(cable.state.lifted for cable in numbering.cables)])
        # Nodes that this rank places, with their blocks and supports on the membrane.
        self._own = np.flatnonzero(~(lifted & nodes.taut) & (numbering.node_owners == rank))
        self._blocks = numbering.node_blocks[self._own]
        self._corners = np.maximum(numbering.support_blocks(self._own), 0)
        self._weights = nodes.weights[self._own]
        self._sliders = np.flatnonzero(nodes.slides[self._own])
        # This rank's edges with points on them, and its edge sliders.
        edges = points.edges[numbering.strip.simplices.owner[points.edges] == rank]
        self._lines = _Lines(*numbering.lines(edges))
        self._on_lines = points.nodes[runs(points.starts[edges], points.counts[edges])]
        edge_sliders = [int(nodes.starts[c]) + k for c, k in numbering.edge_sliders.members]
        self._edge_sliders = np.array(edge_sliders, dtype=np.int64)
        own = numbering.node_owners[self._edge_sliders] == rank
        self._own_edge_sliders = np.flatnonzero(own)
        # Links with crossings, and the two nodes of each crossing.
        on = (nodes.size > 0) & ~lifted
        self._known, self._slides = on & (nodes.kind != CROSSING), nodes.slides
        self._free = nodes.taut & ~lifted
        others = np.flatnonzero(nodes.kind != CROSSING)
        a, b = others[:-1], others[1:]
        crossed = (nodes.cable[a] == nodes.cable[b]) & (b - a > 1) & on[a] & on[b]
        a, counts = a[crossed], (b - a)[crossed] + 1
        self._links = _Lines(pointers(counts), runs(a, counts))
        sides = np.flatnonzero(nodes.crossing >= 0)
        sides = sides[np.argsort(nodes.crossing[sides], kind="stable")]
        _, first, counts = np.unique(nodes.crossing[sides], return_index=True, return_counts=True)
        self._pairs = sides[first[counts == 2][:, None] + np.arange(2)]

    def gather(self, x: Array) -> None:
        """Update the cables' node positions at the displacements x (n, 3), in which the points of
        slack cables are updated. Collective."""
        numbering, unknowns = self.numbering, self.unknowns
        unknowns.place_idle_tied_points(x)
        local = np.zeros((self._starts[-1], 7))  # position, fraction, stress-free position
        position, fraction, material = local[:, :3], local[:, 3], local[:, 4:]
        places = unknowns.X + x
        position[self._own] = places[self._blocks]
        fraction[self._on_lines] = self._lines.shares(places)
        if len(self._edge_sliders):
            found = numbering.edge_sliders.fractions(unknowns, x)
            fraction[self._edge_sliders[self._own_edge_sliders]] = found[self._own_edge_sliders]
        # the owner of a sliding point has also found its place on the edge
        before = np.concatenate([cable.state.fractions for cable in numbering.cables])
        sliders = self._own[self._sliders]
        s = np.where(self._free[sliders], fraction[sliders], before[sliders])
        self._weights[self._sliders, :2] = np.stack([1 - s, s], axis=1)
        material[self._own] = np.einsum("nm,nmi->ni", self._weights, unknowns.X[self._corners])
        # A slack cable may have been draped again since its points were tied at their old places.
        slack = self._sliders[~self._free[sliders]]
        corners = places[self._corners[slack]]
        position[self._own[slack]] = np.einsum("nm,nmi->ni", self._weights[slack], corners)
        total = np.zeros_like(local)
        unknowns.comm.Allreduce(local, total)
        self._set_material(total)
        for (start, end), cable in zip(pairwise(self._starts), numbering.cables, strict=True):
            part, slides = total[start:end], self._slides[start:end] & ~cable.state.lifted
            known = ~cable.state.lifted if cable.taut else slice(None)
            positions, fractions = cable.state.positions.copy(), cable.state.fractions.copy()
            positions[known] = part[known, :3]
            if cable.taut:
                fractions[slides] = part[slides, 3]
            cable.update(
                positions=positions,
                fractions=fractions,
                reference_positions=part[:, 4:].copy(),
            )

    def _set_material(self, total: Array) -> None:
        """Set the nodes' positions on the stress-free membrane; NaN where a cable is off it."""
        # A crossing slides in its cell while its cell point stays: it is placed on the line between
        # the adjacent contacts, to which the cable has moved it. Beside a lifted node this cable
        # cannot place it, but the other one may.
        position, material = total[:, :3], total[:, 4:]
        material[~self._known] = np.nan
        first, last = material[self._links.first], material[self._links.last]
        share = self._links.shares(position)[:, None]
        material[self._links.inner] = first + share * (last - first)
        for one, other in (self._pairs.T, self._pairs.T[::-1]):
            lacking = np.isnan(material[one, 0])
            material[one[lacking]] = material[other[lacking]]


class _Lines:
    """Polylines of three or more points, given as rows of a table of positions in CSR form."""

    def __init__(self, starts: Integers, members: npt.NDArray[np.integer]) -> None:
        sizes = np.diff(starts)
        longest = int(sizes.max(initial=3))
        place = np.minimum(np.arange(longest), sizes[:, None] - 1)  # padded with the last one
        self._rows = members[starts[:-1, None] + place].astype(np.int64)
        self._inner = np.arange(1, longest - 1) < sizes[:, None] - 1
        self.inner = self._rows[:, 1:-1][self._inner]  # rows of all inner points
        # and the end points of their polylines
        self.first, self.last = (np.repeat(self._rows[:, k], sizes - 2) for k in (0, -1))

    def shares(self, places: Array) -> Array:
        """Arc-length fraction of each inner point on its polyline, (n,); places are (m, 3)."""
        run = np.cumsum(norm(np.diff(places[self._rows], axis=1)), axis=1)
        shares: Array = (run[:, :-1] / run[:, -1:])[self._inner]
        return shares
