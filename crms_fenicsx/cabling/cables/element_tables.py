"""A rank's element tables of taut cables: segments, folded cells, facets, held points; and of plain
cells beside them.

They address cable nodes and vertices as local blocks of unknowns; see `numbering` for ownership.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.points_on_edges import ANCHOR, CROSSING, FOLD, TIED
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.energy.minimization.damping import Damping, Springs
from crms_fenicsx.energy.terms.fold_penalty import FoldAngles
from crms_fenicsx.energy.terms.folded_membrane import FoldedCells, FoldedMembraneEnergy
from crms_fenicsx.energy.terms.folded_pressure import Facets, FoldedFollowerPressure
from crms_fenicsx.energy.terms.held_line import HeldPoints
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.pressure import FollowerPressure
from crms_fenicsx.energy.terms.term import ElementwiseTerms
from crms_fenicsx.foundation.dofs.layout import Unknowns, rows_of, rows_on
from crms_fenicsx.foundation.meshes.triangles import area_vectors, cell_sides
from crms_fenicsx.foundation.runtime.arrays import (
    Array,
    Booleans,
    Indices,
    Integers,
    pointers,
    runs,
)
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.foundation.surface.polygons import (
    Polygons,
    fan_facets,
    fan_owners,
    split_polygons,
)
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL


class CutCells:
    """This rank's folded cells (with points on a side) and the chords through them."""

    def __init__(self, numbering: CableNumbering) -> None:
        self.numbering = numbering
        strip, simplices = numbering.strip, numbering.strip.simplices
        rows = np.unique(simplices.around(numbering.points.edges)[1])
        # (n,) rows of the cells in the strip, ascending
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
        # (n + 1,) first chord of each cell
        self.chords_of = np.searchsorted(place[order], np.arange(len(self.rows) + 1))
        starts = pointers(last - first + 2)
        members = np.empty(starts[-1], dtype=np.int64)
        members[runs(starts[:-1], last - first + 1)] = links.first[runs(first, last - first + 1)]
        members[starts[1:] - 1] = links.second[last]
        # CSR form of the node rows on each chord: its two ends, and crossings between
        self.chords = starts, members

    def pieces(self, some: Integers, vertices: Integers, nodes: Integers) -> Polygons:
        """Polygons, oriented as the membrane, into which chords cut the cells `some`, with the
        index in `some` of each polygon's cell; all points on sides are corners."""
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
        """Corners around cells in CSR form: each vertex, then the points on the side after it."""
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


NEAR_ANCHOR = 1e-3
"""Smoothing of a segment at an anchor, relative to others."""


@dataclass(frozen=True)
class CableTables:
    """This rank's elements of taut cables."""

    segments: Indices  # (n, 2) segments of the polylines
    eps: Array  # (n,) their smoothing (length)
    cable: Indices  # (n,) number among the taut cables
    links: Integers  # (n, 2) rows of each segment's end nodes in the table of nodes
    folded: FoldedCells  # cells with folded sides
    # chord ends at free fold points: corner blocks (k, 4), rows of `folded` and of nodes (k,)
    kinks: Indices
    kink_cells: Integers
    kink_nodes: Integers
    facets: Facets  # of the folded cells under pressure

    def penalty(self, factor: float, moduli: Array) -> FoldAngles:
        """Weighted penalty with mu = factor x E t x A; `moduli` (n,) is E t of the folded cells."""
        areas = (factor * moduli * self.folded.areas)[self.kink_cells]
        return FoldAngles(self.kinks, areas, True)

    def literal_penalty(self, mu: float) -> FoldAngles:
        """The paper's penalty with a single coefficient, (2.5-1)."""
        return FoldAngles(self.kinks, np.full(len(self.kinks), mu), False)


def cable_tables(
    numbering: CableNumbering, membrane: MembraneEnergy, pressed: Booleans
) -> CableTables:
    """Tables of taut cables; `pressed` flags the local cells under pressure."""
    nodes, links = numbering.nodes, numbering.links
    own = np.flatnonzero(nodes.taut[links.first] & (links.owner == numbering.rank))
    ends = np.stack([links.first[own], links.second[own]], axis=1)
    number = np.cumsum([cable.taut for cable in numbering.cables]) - 1
    cells = _FoldedCellsOf(numbering)
    return CableTables(
        numbering.node_blocks[ends].astype(np.int32),
        _smoothing(numbering, own),
        number[nodes.cable[ends[:, 0]]].astype(np.int32),
        ends,
        cells.folded(membrane),
        *cells.kinks(),
        cells.facets(pressed),
    )


def facets_of(numbering: CableNumbering, cells: Booleans) -> Facets:
    """Facets of the folded cells among the given local cells."""
    return _FoldedCellsOf(numbering).facets(cells)


def depth_of(numbering: CableNumbering) -> tuple[Facets, Integers]:
    """Facets around the space between folded cells and their corner triangles, and local cells."""
    return _FoldedCellsOf(numbering).depth()


def _smoothing(numbering: CableNumbering, own: Integers) -> Array:
    """Smoothing of this rank's links; negative where both ends are given."""
    nodes, links, strip = numbering.nodes, numbering.links, numbering.strip
    rows = numbering.own_rows
    sizes = np.full(len(strip.cells), np.inf)  # of this rank's cells of the strip
    areas = area_vectors(numbering.u.function_space.mesh, strip.local[rows])
    sizes[rows] = np.sqrt(2 * np.linalg.norm(areas, axis=1))
    counts, around = strip.simplices.around(links.around[own])
    size = np.minimum.reduceat(sizes[around], pointers(counts)[:-1]) if len(own) else np.zeros(0)
    first, second = links.first[own], links.second[own]
    over = np.isinf(size)  # between crossings over a hole
    parts = [cable.length / max(len(cable.contacts()) - 1, 1) for cable in numbering.cables]
    size[over] = np.array(parts)[nodes.cable[first[over]]]

    def one(of: Booleans) -> Booleans:
        return of[first] | of[second]

    slides = one((nodes.kind == CROSSING) | nodes.slides)
    slides |= (links.on[own] >= 0) & one(nodes.kind != TIED)
    # A tiny move of an anchor off the adjacent held place is resolved exactly. An anchor may also
    # coincide with that place, where no direction is defined or needed.
    near = np.where(one(nodes.kind == ANCHOR), NEAR_ANCHOR, 1.0)
    return np.where(slides, TOL.smoothing * size * near, -SAME_PLACE * size)


class _FoldedCellsOf:
    """This rank's cells that taut cables fold."""

    def __init__(self, numbering: CableNumbering) -> None:
        self.numbering, self.cells = numbering, CutCells(numbering)
        self.strip = numbering.strip
        self.local = self.strip.local[self.cells.rows].astype(np.int32)

    def folded(self, membrane: MembraneEnergy) -> FoldedCells:
        """Folded cells: their sides as segments, and their material."""
        cells = self.local
        vectors = cell_sides(self.numbering.u.function_space.mesh, cells)
        lengths = np.linalg.norm(vectors, axis=2).ravel()
        # Sides numbered by first occurrence.
        sides = self.strip.simplices.sides[self.cells.rows].ravel()
        edges, first, inverse = np.unique(sides, return_index=True, return_inverse=True)
        order = np.argsort(first)
        lines, blocks = self.numbering.lines(edges[order])
        parts = np.diff(lines) - 1
        start = runs(lines[:-1], parts)
        smoothing = np.where(parts > 1, TOL.smoothing * lengths[first[order]], 0.0)
        laws, parameters = membrane.laws(cells)
        return FoldedCells(
            cells=cells,
            segments=np.stack([blocks[start], blocks[start + 1]], axis=1),
            eps=np.repeat(smoothing, parts),
            side_pointers=pointers(parts).astype(np.int32),
            side_segments=np.arange(len(start), dtype=np.int32),
            sides=np.argsort(order)[inverse].reshape(-1, 3).astype(np.int32),
            side_vectors=np.einsum("nki,nai->nka", vectors, membrane.material_axes(cells)),
            laws=laws,
            parameters=parameters,
        )

    def kinks(self) -> tuple[Indices, Integers, Integers]:
        """Chord ends at free fold points on sides: corner blocks, index of the cell, node row."""
        numbering = self.numbering
        starts, members = self.cells.chords
        # From rim to rim, as a crossing may come arbitrarily close to the rim.
        ends = np.stack([members[starts[:-1]], members[starts[1:] - 1]], axis=1)
        cell = np.repeat(np.arange(len(self.cells.rows)), np.diff(self.cells.chords_of))
        node, other, cell = ends.ravel(), ends[:, ::-1].ravel(), np.repeat(cell, 2)
        free = numbering.nodes.kind[node] == FOLD
        node, other, cell = node[free], other[free], cell[free]
        lines, blocks = numbering.lines(numbering.on[node])
        at = lines[:-1] + 1 + numbering.points.place[node]
        around = blocks[np.stack([at - 1, at, at + 1], axis=1)]
        last = numbering.node_blocks[other].astype(np.int32)
        return np.concatenate([around, last[:, None]], axis=1), cell, node

    def facets(self, pressed: Booleans) -> Facets:
        """Facets of the polygons into which chords cut the cells under pressure."""
        numbering = self.numbering
        some = np.flatnonzero(pressed[self.local])
        pieces = self.cells.pieces(some, numbering.vertex_blocks, numbering.node_blocks)
        plain = numbering.vertex_blocks[self.strip.simplices.cells[self.cells.rows[some]]]
        return Facets(*fan_facets(pieces.starts, pieces.corners), plain)

    def depth(self) -> tuple[Facets, Integers]:
        """Facets around the space between cells' facets and corner triangles, and local cells."""
        numbering, simplices, rows = self.numbering, self.strip.simplices, self.cells.rows
        every = np.arange(len(rows))
        pieces = self.cells.pieces(every, numbering.vertex_blocks, numbering.node_blocks)
        top, shares = fan_facets(pieces.starts, pieces.corners)
        below = numbering.vertex_blocks[simplices.cells[rows]].astype(np.int32)
        sides, forward = simplices.sides[rows].ravel(), simplices.forward[rows].ravel()
        folded = np.flatnonzero(numbering.points.counts[sides])
        lines, blocks = numbering.lines(sides[folded])
        walls, parts = fan_facets(lines, blocks.astype(np.int64))
        side = folded[fan_owners(lines)]
        corners = np.concatenate([top, below, walls])
        signs = np.where(forward[side], -1.0, 1.0)  # back along the edge, over the points
        weights = np.concatenate([shares, np.full(len(rows), -1.0), signs * parts])
        cell = np.concatenate([pieces.cell[fan_owners(pieces.starts)], every, side // 3])
        return Facets(corners, weights, below[:0]), self.local[cell]


class PlainCells:
    """This rank's plain cells beside folded ones, for terms of some of them: DOLFINx forms
    integrate over all cells, relaxation next to a cable needs only a few."""

    def __init__(self, unknowns: Unknowns, membrane: MembraneEnergy) -> None:
        self._energy, mesh = membrane, membrane.u.function_space.mesh
        self.cells = np.flatnonzero(
            membrane.plain.x.array[: mesh.topology.index_map(2).size_local]
        ).astype(np.int32)
        dofs = membrane.u.function_space.dofmap.list[self.cells]
        self.blocks = unknowns.vertex_blocks()[dofs]

    def _around(self, chosen: Booleans) -> Integers:
        """Rows of the cells with any chosen vertex."""
        rows: Integers = rows_on(*rows_of(self.blocks), chosen)
        return rows

    def membrane(self) -> ElementwiseTerms:
        """Compiled counterpart of their strain energy."""
        stiffening = self._energy.stiffening
        return ElementwiseTerms(self._cells, lambda table: FoldedMembraneEnergy(table, stiffening))

    def _cells(self, chosen: Booleans) -> FoldedCells | None:
        """The cells with any chosen vertex, (n_local,)."""
        rows, membrane = self._around(chosen), self._energy
        if len(rows) == 0:
            return None
        cells, n = self.cells[rows], 3 * len(rows)
        sides = cell_sides(membrane.u.function_space.mesh, cells)
        laws, parameters = membrane.laws(cells)
        ends = self.blocks[rows]
        return FoldedCells(
            cells=cells,
            segments=np.stack([ends, np.roll(ends, -1, axis=1)], axis=2).reshape(-1, 2),
            eps=np.zeros(n),
            side_pointers=np.arange(n + 1, dtype=np.int32),
            side_segments=np.arange(n, dtype=np.int32),
            sides=np.arange(n, dtype=np.int32).reshape(-1, 3),
            side_vectors=np.einsum("nki,nai->nka", sides, membrane.material_axes(cells)),
            laws=laws,
            parameters=parameters,
        )

    def pressure(self, term: FollowerPressure) -> ElementwiseTerms:
        """Compiled counterpart of a pressure on them."""

        def facets(chosen: Booleans) -> Facets | None:
            rows = self._around(chosen)
            rows = rows[term.cells.x.array[self.cells[rows]] > 0.0]
            none = np.zeros((0, 3), dtype=np.int32)
            table = Facets(self.blocks[rows], np.ones(len(rows)), none)
            return table if len(rows) else None

        return ElementwiseTerms(
            facets,
            lambda table: FoldedFollowerPressure(table, term.pressure, term.origin.value),
        )


def damping(numbering: CableNumbering, segments: Indices) -> Damping:
    """Damping of the points of taut cables, with this rank's segments (m, 2)."""
    rows = numbering.points.nodes
    own = (numbering.node_owners[rows] == numbering.rank) & numbering.nodes.slides[rows]
    rows = rows[own]
    ends = numbering.support_blocks(rows)[:, :2]
    sliders = np.concatenate([numbering.node_blocks[rows, None], ends], axis=1).astype(np.int32)
    mine = numbering.own_shifts
    shifts = numbering.shift_blocks[mine], numbering.shifts.sizes[mine]
    return Damping(Springs(sliders, numbering.fractions()[rows], segments, *shifts))


HOLDING = 1e2
"""Relative stiffness of the points' springs: they yield by a hundredth of the fabric's strain."""


def holds_points(cables: Iterable[LaidCable]) -> bool:
    """Whether some taut cable has points held on their edges."""
    return any(c.taut and c.keeps_line and any(n.slides for n in c.state.nodes) for c in cables)


def stiffest(materials: Iterable[MembraneMaterial]) -> float:
    """Stiffness of the stiffest fabric (force per length)."""
    return max(m.reference_modulus + float(np.abs(m.prestress_vector).max()) for m in materials)


def held_points(
    numbering: CableNumbering, shape: StripShape, materials: Iterable[MembraneMaterial]
) -> HeldPoints:
    """Points of taut cables that are held on their edges."""
    fabric = stiffest(materials)
    rows, rest, lengths = [], [], []
    for c, cable in enumerate(numbering.cables):
        for k, node in enumerate(cable.state.nodes):
            point = node.point
            if cable.taut and cable.keeps_line and node.slides and isinstance(point, EdgePoint):
                a, b = (shape.stress_free_at(vertex) for vertex in point.edge)
                rows.append(numbering.row(c, k))
                rest.append(point.fraction)
                lengths.append(float(np.linalg.norm(b - a)))
    all_rows = np.array(rows, dtype=np.int64)
    own = numbering.strip.simplices.owner[numbering.on[all_rows]] == numbering.rank
    all_rows = all_rows[own]
    points = numbering.points_now()
    pointers, blocks = numbering.lines(numbering.on[all_rows], points)
    places = (points.place[all_rows] + 1).astype(np.int32)
    stiffness = HOLDING * fabric * np.array(lengths)[own] ** 2
    return HeldPoints(pointers.astype(np.int32), blocks, places, np.array(rest)[own], stiffness)
