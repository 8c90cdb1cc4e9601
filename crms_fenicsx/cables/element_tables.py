"""Tables of what a rank computes for the cables in tension: segments, folded cells, kinks, facets.

Nodes of cables and vertices become local blocks of the unknowns here; see `numbering` for who owns
what.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cables.cell_cuts import chords_by_row, cut, folded_rows
from crms_fenicsx.cables.numbering import CableNumbering, Link
from crms_fenicsx.energies.fold_penalty import FoldAngles
from crms_fenicsx.energies.folded_membrane import FoldedCells
from crms_fenicsx.energies.folded_pressure import Facets
from crms_fenicsx.energies.membrane import MembraneEnergy
from crms_fenicsx.meshes.cell_geometry import area_vectors
from crms_fenicsx.minimization.damping import Damping
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.model.materials import N_PARAMETERS
from crms_fenicsx.model.tolerances import SAME_PLACE, SMOOTHING
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.points import Edge, EdgePoint
from crms_fenicsx.surface.polygons import fan_facets

NEAR_ANCHOR = 1e-3
"""Smoothing of a length to an anchor, relative to that of others."""


@dataclass(frozen=True)
class CableTables:
    """What this rank computes for the cables in tension.

    Attributes
    ----------
    segments : (n, 2), eps : (n,), cable : (n,)
        Segments of the cables' polylines, their smoothing, and the cable's place among the taut.
    links
        Which nodes of which cables the segments join.
    folded : FoldedCells
        Cells with folded sides.
    kinks : list of (corner blocks (4,), row of `folded`, fold point)
        Where chords meet sides at fold points that are free.
    facets : Facets
        Facets of the folded cells under pressure.
    """

    segments: Indices
    eps: Array
    cable: Indices
    links: list[Link]
    folded: FoldedCells
    kinks: list[tuple[tuple[int, int, int, int], int, NodeId]]
    facets: Facets

    def penalty(self, factor: float, moduli: Array) -> FoldAngles:
        """Weighted penalty with mu = factor x E t x A; `moduli` (n,) is E t of the folded cells."""
        rows = np.array([row for _, row, _ in self.kinks], dtype=np.int64)
        return FoldAngles(self._corners(), (factor * moduli * self.folded.areas)[rows], True)

    def literal_penalty(self, mu: float) -> FoldAngles:
        """The paper's penalty with one coefficient for all, (2.5-1)."""
        return FoldAngles(self._corners(), np.full(len(self.kinks), mu), False)

    def _corners(self) -> Indices:
        return np.array([k for k, _, _ in self.kinks], dtype=np.int32).reshape(-1, 4)


def cable_tables(
    numbering: CableNumbering, membrane: MembraneEnergy, pressed: Booleans
) -> CableTables:
    """Tables of the cables in tension; `pressed` says which local cells are under pressure."""
    taut = {c: n for n, c in enumerate(c for c, k in enumerate(numbering.cables) if k.taut)}
    mesh = numbering.u.function_space.mesh
    strip, rows = numbering.strip, numbering.own_rows
    sizes = np.zeros(len(strip.cells))  # of this rank's cells of the strip
    areas = np.linalg.norm(area_vectors(mesh, strip.local[rows]), axis=1)
    sizes[rows] = np.sqrt(2 * areas)
    own = [
        k for k in numbering.links if k.cable in taut and numbering.link_owner(k) == numbering.rank
    ]
    segments = [(numbering.block(c, k), numbering.block(c, m)) for c, k, m, _ in own]
    cells = _FoldedCellsOf(numbering)
    return CableTables(
        np.array(segments, dtype=np.int32).reshape(-1, 2),
        np.array([_smoothing(numbering, link, sizes) for link in own]),
        np.array([taut[link.cable] for link in own], dtype=np.int32),
        own,
        cells.folded(membrane),
        cells.kinks(),
        cells.facets(pressed),
    )


def _smoothing(numbering: CableNumbering, link: Link, sizes: Array) -> float:
    """Smoothing of a link's length; negative where its ends are given."""
    nodes = numbering.cables[link.cable].nodes
    first, second = nodes[link.first], nodes[link.second]
    around = link.vertices or numbering.place_of(link.cable, link.first).support
    slides = "crossing" in (first.kind, second.kind) or first.slides or second.slides
    if link.vertices is not None:
        slides = not {first.kind, second.kind} <= {"rider"}
    strip = numbering.strip
    rows = [row for row in strip.rows(around) if strip.owners[row] == numbering.rank]
    size = float(min(sizes[row] for row in rows))
    # An anchor may lie on the held place next to it: no direction, and none is needed.
    if not slides:
        return -SAME_PLACE * size
    # It may be moved off that place by very little: lengths are exact from there on.
    return SMOOTHING * size * (NEAR_ANCHOR if "anchor" in (first.kind, second.kind) else 1.0)


class _FoldedCellsOf:
    """This rank's cells that the cables in tension fold, cell by cell."""

    def __init__(self, numbering: CableNumbering) -> None:
        self.numbering = numbering
        self.chords = chords_by_row(numbering)
        self.rows = folded_rows(numbering)

    def sides(self, row: int) -> list[Edge]:
        """The three sides of a cell."""
        return [edge for edge, _ in self.numbering.strip.sides[row]]

    def folded(self, membrane: MembraneEnergy) -> FoldedCells:
        """Sides in segments, and the cells' material."""
        mesh = self.numbering.u.function_space.mesh
        cells = self.numbering.strip.local[self.rows].astype(np.int32)
        X: Array = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)[cells]], dtype=float)
        vectors = np.roll(X, -1, axis=1) - X
        lengths = np.linalg.norm(vectors, axis=2)
        segments: list[tuple[int, int]] = []
        eps: list[float] = []
        numbers: dict[Edge, int] = {}
        pointers = [0]
        sides = np.zeros((len(self.rows), 3), dtype=np.int32)
        for n, row in enumerate(self.rows):
            for k, edge in enumerate(self.sides(row)):
                if edge not in numbers:
                    numbers[edge] = len(numbers)
                    parts = list(itertools.pairwise(self.numbering.blocks_along(edge)))
                    segments += parts
                    pointers.append(len(segments))
                    smoothing = SMOOTHING * float(lengths[n, k]) if len(parts) > 1 else 0.0
                    eps += [smoothing] * len(parts)
                sides[n, k] = numbers[edge]
        tags, material = np.unique(membrane.material_tags(cells), return_inverse=True)
        materials = [membrane.materials[int(tag)] for tag in tags]
        return FoldedCells(
            cells=cells,
            segments=np.array(segments, dtype=np.int32).reshape(-1, 2),
            eps=np.array(eps),
            side_pointers=np.array(pointers, dtype=np.int32),
            side_segments=np.arange(len(segments), dtype=np.int32),
            sides=sides,
            side_vectors=np.einsum("nki,nai->nka", vectors, membrane.material_axes(cells)),
            laws=np.array([m.law for m in materials], dtype=np.int32)[material],
            parameters=np.array([m.parameters for m in materials]).reshape(-1, N_PARAMETERS)[
                material
            ],
        )

    def kinks(self) -> list[tuple[tuple[int, int, int, int], int, NodeId]]:
        """Where chords meet sides at free fold points: corner blocks, the cell's place, point."""
        numbering, kinks = self.numbering, []
        for n, row in enumerate(self.rows):
            for chord in self.chords.get(row, []):
                # From rim to rim: a crossing may come as near to the rim as it likes.
                for member, other in ((chord[0], chord[-1]), (chord[-1], chord[0])):
                    node = numbering.cables[member[0]].nodes[member[1]]
                    if node.kind == "fold" and isinstance(node.point, EdgePoint):
                        block, line = (
                            numbering.block(*member),
                            numbering.blocks_along(node.point.edge),
                        )
                        k = line.index(block)
                        corners = (line[k - 1], block, line[k + 1], numbering.block(*other))
                        kinks.append((corners, n, member))
        return kinks

    def facets(self, pressed: Booleans) -> Facets:
        """Facets of the polygons into which chords cut the cells under pressure."""
        numbering = self.numbering
        rows = [row for row in self.rows if pressed[numbering.strip.local[row]]]
        polygons: list[list[int]] = []
        for row in rows:
            chords = [[numbering.block(*k) for k in chord] for chord in self.chords.get(row, [])]
            polygons += cut(numbering, row, numbering.blocks_along, chords)
        corners, weights = fan_facets(polygons)
        plain = [[numbering.vertex(v) for v in numbering.strip.corners[row]] for row in rows]
        return Facets(corners, weights, np.array(plain, dtype=np.int32).reshape(-1, 3))


def damping(numbering: CableNumbering, segments: Indices) -> Damping:
    """What holds back the points of the cables in tension, with this rank's segments (m, 2)."""
    sliders, fractions = [], []
    for edge, points in numbering.on_edge.items():
        for fraction, c, k in points:
            own = numbering.owners[numbering.numbers[c, k]] == numbering.rank
            if own and numbering.cables[c].nodes[k].slides:
                ends = (numbering.vertex(vertex) for vertex in edge)
                sliders.append((numbering.block(c, k), *ends))
                fractions.append(fraction)
    return Damping(np.array(sliders, dtype=np.int32).reshape(-1, 3), np.array(fractions), segments)
