"""Where the cables' points are, gathered on all ranks: in space, on edges, on the membrane."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np

from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.model.tolerances import BLOCKED
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.triangles import norm


class NodePositions:
    """Finds where the nodes of all cables are, by tables of them, one cable after the other.

    Parameters
    ----------
    numbering
        The cables; what they touch and which of them are in tension stays as it is.
    unknowns
        The layout that the numbering has made.
    """

    def __init__(self, numbering: CableNumbering, unknowns: Unknowns) -> None:
        self.numbering, self.unknowns = numbering, unknowns
        sizes = (len(cable.nodes) for cable in numbering.cables)
        self._starts = list(accumulate(sizes, initial=0))
        self._list_own_nodes()
        self._list_lines()
        self._list_links()

    def _list_own_nodes(self) -> None:
        """Nodes that this rank places: their blocks, and what they lie on on the membrane."""
        numbering = self.numbering
        own, blocks, interpolation, weights, slides = [], [], [], [], []
        for start, (c, cable) in zip(self._starts, enumerate(numbering.cables), strict=False):
            lifted = cable.lifted & cable.taut
            for k, node in enumerate(cable.nodes):
                if lifted[k] or not numbering.is_mine(c, k):
                    continue
                own.append(start + k)
                blocks.append(numbering.block(c, k))
                ids, share = ((), ()) if node.point is None else node.interpolation()
                interpolation.append([*(numbering.vertex(i) for i in ids), 0, 0, 0][:3])
                weights.append([*share, 0.0, 0.0, 0.0][:3])
                slides.append(node.slides)
        self._own, self._blocks = np.array(own, dtype=np.int64), np.array(blocks, dtype=np.int64)
        self._corners = np.array(interpolation, dtype=np.int64).reshape(-1, 3)
        self._weights = np.array(weights, dtype=float).reshape(-1, 3)
        self._sliders = np.flatnonzero(np.array(slides, dtype=bool))

    def _list_lines(self) -> None:
        """This rank's edges with the points on them, and its rails."""
        numbering = self.numbering
        lines, on_lines = [], []
        for edge, points in numbering.on_edge.items():
            if numbering.strip.owner_of(edge) == numbering.rank:
                lines.append(numbering.blocks_along(edge))
                on_lines.append([self._starts[c] + k for _, c, k in points])
        self._lines = _Lines(lines)
        self._on_lines = np.array([m for line in on_lines for m in line], dtype=np.int64)
        mine = [n for n, (c, k) in enumerate(numbering.rails.members) if numbering.is_mine(c, k)]
        self._own_rails = np.array(mine, dtype=np.int64)
        self._rails = np.array(
            [self._starts[c] + k for c, k in numbering.rails.members], dtype=np.int64
        )

    def _list_links(self) -> None:
        """Links with crossings on them, and which two nodes each crossing is."""
        links, shared = [], defaultdict(list)
        known, slides, free = [], [], []
        for start, cable in zip(self._starts, self.numbering.cables, strict=False):
            kinds = [node.kind for node in cable.nodes]
            on = [
                node.point is not None and not lifted
                for node, lifted in zip(cable.nodes, cable.lifted, strict=True)
            ]
            known += [here and kind != "crossing" for here, kind in zip(on, kinds, strict=True)]
            slides += [node.slides for node in cable.nodes]
            free += [cable.taut and not lifted for lifted in cable.lifted]
            for a, b in pairwise([k for k, kind in enumerate(kinds) if kind != "crossing"]):
                if b - a > 1 and on[a] and on[b]:
                    links.append([start + k for k in range(a, b + 1)])
            for k, node in enumerate(cable.nodes):
                if node.crossing is not None:
                    shared[node.crossing].append(start + k)
        self._known, self._slides = np.array(known, dtype=bool), np.array(slides, dtype=bool)
        self._free = np.array(free, dtype=bool)
        self._links = _Lines(links)
        pairs = [pair for pair in shared.values() if len(pair) == 2]
        self._pairs = np.array(pairs, dtype=np.int64).reshape(-1, 2)

    def gather(self, x: Array) -> None:
        """Give the cables the places of their points at the displacements x (n, 3). Collective.

        The points of slack cables in x are brought up to date.
        """
        numbering, unknowns = self.numbering, self.unknowns
        unknowns.place_idle_riders(x)
        local = np.zeros((self._starts[-1], 7))  # position, fraction, place when stress-free
        position, fraction, material = local[:, :3], local[:, 3], local[:, 4:]
        places = unknowns.X + x
        position[self._own] = places[self._blocks]
        fraction[self._on_lines] = self._lines.shares(places)
        if len(self._rails):
            found = numbering.rails.fractions(unknowns, x)
            fraction[self._rails[self._own_rails]] = found[self._own_rails]
        # whoever owns a sliding point has found its place on its edge, too
        before = np.concatenate([cable.fractions for cable in numbering.cables])
        sliders = self._own[self._sliders]
        s = np.where(self._free[sliders], fraction[sliders], before[sliders])
        self._weights[self._sliders, :2] = np.stack([1 - s, s], axis=1)
        material[self._own] = np.einsum("nm,nmi->ni", self._weights, unknowns.X[self._corners])
        # A slack cable may have been draped anew since its points began to ride where they were.
        slack = self._sliders[~self._free[sliders]]
        corners = places[self._corners[slack]]
        position[self._own[slack]] = np.einsum("nm,nmi->ni", self._weights[slack], corners)
        total = np.zeros_like(local)
        unknowns.comm.Allreduce(local, total)
        self._set_material(total)
        for (start, end), cable in zip(pairwise(self._starts), numbering.cables, strict=True):
            part, slides = total[start:end], self._slides[start:end] & ~cable.lifted
            known = ~cable.lifted if cable.taut else slice(None)
            positions, fractions = cable.positions.copy(), cable.fractions.copy()
            positions[known] = part[known, :3]
            if cable.taut:
                fractions[slides] = part[slides, 3]
            close = (fractions < BLOCKED) | (fractions > 1 - BLOCKED)
            cable.update(
                positions=positions,
                fractions=fractions,
                reference_positions=part[:, 4:].copy(),
                blocked=tuple(int(k) for k in np.flatnonzero(slides & close) if cable.taut),
            )

    def _set_material(self, total: Array) -> None:
        """Find the nodes' places on the stress-free membrane; none where a cable is off it.

        A crossing slides in its cell while its cell point stays: between two contacts it goes onto
        the line from one to the other, where the cable has bent it to. Beside a lifted node the
        cable does not say where it is, but the other one may.
        """
        position, material = total[:, :3], total[:, 4:]
        material[~self._known] = np.nan
        first, last = material[self._links.first], material[self._links.last]
        share = self._links.shares(position)[:, None]
        material[self._links.inner] = first + share * (last - first)
        for one, other in (self._pairs.T, self._pairs.T[::-1]):
            lacking = np.isnan(material[one, 0])
            material[one[lacking]] = material[other[lacking]]


class _Lines:
    """Polylines of three or more points each, given by rows of a table of places.

    Attributes
    ----------
    inner, first, last : (n,)
        The rows of all their inner points, and of the ends of the polylines that these are on.
    """

    def __init__(self, lines: Sequence[Sequence[int]]) -> None:
        longest = max((len(line) for line in lines), default=3)
        rows = [[*line, *[line[-1]] * (longest - len(line))] for line in lines]
        self._rows = np.array(rows, dtype=np.int64).reshape(-1, longest)
        sizes = np.array([len(line) for line in lines], dtype=np.int64)
        self._inner = np.arange(1, longest - 1) < sizes[:, None] - 1
        self.inner = self._rows[:, 1:-1][self._inner]
        self.first, self.last = (np.repeat(self._rows[:, k], sizes - 2) for k in (0, -1))

    def shares(self, places: Array) -> Array:
        """Share of its polyline's length at which each inner point is, (n,); places are (m, 3)."""
        run = np.cumsum(norm(np.diff(places[self._rows], axis=1)), axis=1)
        shares: Array = (run[:, :-1] / run[:, -1:])[self._inner]
        return shares
