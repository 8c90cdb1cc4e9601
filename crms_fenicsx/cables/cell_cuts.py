"""How the cables in tension cut this rank's cells: along chords, into polygons."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.runtime.arrays import Integers, pointers, runs
from crms_fenicsx.surface.polygons import Polygons, split_polygons


class CutCells:
    """This rank's folded cells, those with points on a side, and the chords through their inside.

    Attributes: `rows` (n,): rows of the cells in the strip, ascending; `chords_of` (n + 1,): where
    the chords of each cell begin among the m chords; `chords` (m + 1,), (k,): rows of the nodes on
    each chord from rim to rim, in CSR form: pointers, rows. Between its two ends a chord has the
    crossings on it.
    """

    def __init__(self, numbering: CableNumbering) -> None:
        self.numbering = numbering
        strip, simplices = numbering.strip, numbering.strip.simplices
        rows = np.unique(simplices.around(numbering.points.edges)[1])
        self.rows = rows[strip.owner[rows] == numbering.rank]
        links, nodes = numbering.links, numbering.nodes
        inside = (links.on >= 0) & nodes.taut[links.first]
        inside &= simplices.corners[links.on, 2] >= 0
        row = np.full(len(inside), -1)
        row[inside] = simplices.rows[simplices.pointers[links.on[inside]]]
        goes_on = (row[1:] == row[:-1]) & (links.first[1:] == links.second[:-1]) & inside[1:]
        first = np.flatnonzero(inside & ~np.concatenate([[False], goes_on]))
        last = np.flatnonzero(inside & ~np.concatenate([goes_on, [False]]))
        place = np.searchsorted(self.rows, row[first])
        mine = np.append(self.rows, -1)[place] == row[first]
        first, last, place = first[mine], last[mine], place[mine]
        order = np.argsort(place, kind="stable")
        first, last = first[order], last[order]
        self.chords_of = np.searchsorted(place[order], np.arange(len(self.rows) + 1))
        starts = pointers(last - first + 2)
        members = np.empty(starts[-1], dtype=np.int64)
        members[runs(starts[:-1], last - first + 1)] = links.first[runs(first, last - first + 1)]
        members[starts[1:] - 1] = links.second[last]
        self.chords = starts, members

    def pieces(self, some: Integers, vertices: Integers, nodes: Integers) -> Polygons:
        """Polygons into which the chords cut some cells.

        Shapes: some (n,). Returns the polygons in the membrane's orientation, with the place in
        `some` of the cell of each. Points on sides that no chord leaves are corners too.
        """
        cut = np.diff(self.chords_of)[some]
        chord = runs(self.chords_of[some], cut)
        starts, members = self.chords
        sizes = np.diff(starts)[chord]
        members = nodes[members[runs(starts[chord], sizes)]]
        rims = self._rims(self.rows[some], vertices, nodes)
        return split_polygons(rims, pointers(cut), (pointers(sizes), members))

    def _rims(
        self, rows: Integers, vertices: Integers, nodes: Integers
    ) -> tuple[Integers, Integers]:
        """Corners around cells in CSR form: vertices, and the points on the sides after each."""
        points, simplices = self.numbering.points, self.numbering.strip.simplices
        sides, forward = simplices.sides[rows].ravel(), simplices.forward[rows].ravel()
        counts = points.counts[sides]
        begins = pointers(counts + 1)
        corners = np.empty(begins[-1], dtype=np.int64)
        corners[begins[:-1]] = vertices[simplices.cells[rows].ravel()]
        place = runs(np.zeros_like(counts), counts)  # of each point along its side
        side = np.repeat(np.arange(len(sides)), counts)
        along = np.where(forward[side], place, counts[side] - 1 - place)
        corners[begins[side] + 1 + place] = nodes[points.nodes[points.starts[sides][side] + along]]
        return begins[::3], corners
