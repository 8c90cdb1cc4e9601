"""Foldable elements: strain energy of the cells that cables cross (sections 2.1 and 2.3).

A folded cell unfolds into a triangle whose sides are the lengths of its folded edges, through all
their fold points. The Green-Lagrange strain is linear in the squared sides, so the energy depends
on the unknowns only through lengths of segments between points:

    points -> segments -> sides -> strain -> energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from crms_fenicsx.energy.terms import compiled_laws as laws
from crms_fenicsx.energy.terms.kinematics import Stiffening
from crms_fenicsx.energy.terms.segments import (
    add_segment_forces,
    difference,
    segment_lengths,
    segment_stiffness,
    slope_over_distance,
)
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern, SegmentPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.runtime.arrays import Array, Indices, Integers


@dataclass(frozen=True)
class FoldedCells(ElementTable):
    """This rank's folded cells, as tables. Side k of a cell joins its corners k and k + 1."""

    cells: Indices  # (n,) local cell numbers
    segments: Indices  # (m, 2) blocks of the segments' ends
    eps: Array  # (m,) smoothing of the segments' lengths
    side_pointers: Indices  # side_pointers, side_segments: segments of each side in CSR form
    side_segments: Indices
    sides: Indices  # (n, 3) the three sides of each cell
    side_vectors: Array  # (n, 3, 2) stress-free sides in the material axes
    # laws (n,), parameters (n, N_PARAMETERS): stress law and `MembraneMaterial.parameters`
    laws: Indices
    parameters: Array
    addresses = ("segments",)

    def some(self, rows: Integers) -> FoldedCells:
        """Subset of the cells, with their sides and segments."""
        used, sides = np.unique(self.sides[rows], return_inverse=True)
        counts = np.diff(self.side_pointers)[used]
        pointers = np.append(0, np.cumsum(counts))
        first = np.repeat(self.side_pointers[used] - pointers[:-1], counts)
        segments = self.side_segments[first + np.arange(pointers[-1])]
        return FoldedCells(
            cells=self.cells[rows],
            segments=self.segments[segments],
            eps=self.eps[segments],
            side_pointers=pointers.astype(np.int32),
            side_segments=np.arange(len(segments), dtype=np.int32),
            sides=sides.reshape(-1, 3).astype(np.int32),
            side_vectors=self.side_vectors[rows],
            laws=self.laws[rows],
            parameters=self.parameters[rows],
        )

    @property
    def areas(self) -> Array:
        """Stress-free areas, (n,)."""
        a, b = self.side_vectors[:, 0], self.side_vectors[:, 1]
        areas: Array = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        return areas

    @property
    def strain_maps(self) -> Array:
        """Matrices (n, 3, 3) from changes of the squared sides to (E11, E22, 2 E12)."""
        d1, d2 = self.side_vectors[..., 0], self.side_vectors[..., 1]
        rows = np.stack([2 * d1**2, 2 * d2**2, 2 * d1 * d2], axis=-1)
        return np.asarray(np.linalg.inv(rows), dtype=float)

    @cached_property
    def element_blocks(self) -> tuple[Indices, Indices]:
        """Distinct blocks of each cell in CSR form: pointers, blocks."""
        found: tuple[Indices, Indices] = _distinct_blocks(
            self.segments, self.side_pointers, self.side_segments, self.sides
        )
        return found


@numba.njit(cache=True)
def _distinct_blocks(segments, side_pointers, side_segments, sides):  # type: ignore[no-untyped-def]
    """Distinct blocks of each cell, side by side, in CSR form."""
    most, n = 0, 0
    for c in range(len(sides)):
        for k in range(3):
            most += 2 * (side_pointers[sides[c, k] + 1] - side_pointers[sides[c, k]])
    blocks, pointers = np.empty(most, np.int32), np.zeros(len(sides) + 1, np.int32)
    for c in range(len(sides)):
        for k in range(3):
            for q in range(side_pointers[sides[c, k]], side_pointers[sides[c, k] + 1]):
                for m in range(2):
                    blocks[n] = segments[side_segments[q], m]
                    i = pointers[c]
                    while blocks[i] != blocks[n]:
                        i += 1
                    n += i == n
        pointers[c + 1] = n
    return pointers, blocks[:n]


@numba.njit(cache=True)
def cell_forces(  # type: ignore[no-untyped-def]
    lengths, pointers, side_segments, sides, maps, squares, areas, law, p, forces, out,
    orthotropic,
):  # fmt: skip
    """Energy of all cells; forces of the segments (m,); strain,
    stress and state into `out` (n, 7). `orthotropic` as in
    `energy.terms.compiled_laws.stress`."""
    forces[:] = 0.0
    energy = 0.0
    e, s, r = np.empty(3), np.empty(3), np.empty(3)
    for c in range(sides.shape[0]):
        e[:] = 0.0
        for k in range(3):
            r[k] = 0.0
            for q in range(pointers[sides[c, k]], pointers[sides[c, k] + 1]):
                r[k] += lengths[side_segments[q]]
            for i in range(3):
                e[i] += maps[c, i, k] * (r[k] * r[k] - squares[c, k])
        density, state = laws.stress(law[c], p[c], e, s, orthotropic)
        energy += areas[c] * density
        for k in range(3):
            force = 0.0
            for i in range(3):
                force += s[i] * maps[c, i, k]
            force *= 2 * r[k] * areas[c]
            for q in range(pointers[sides[c, k]], pointers[sides[c, k] + 1]):
                forces[side_segments[q]] += force
        for i in range(3):
            out[c, i], out[c, 3 + i] = e[i], s[i]
        out[c, 6] = state
    return energy


@numba.njit(cache=True)
def _cell_stiffness(  # type: ignore[no-untyped-def]
    X, x, segments, eps, lengths, pointers, side_segments, sides, maps, areas, law, p, out, floor,
    prestress, exact, element_pointers, element_blocks, offsets, values, tension, orthotropic,
):  # fmt: skip
    """Stiffness ``sum K_kl grad(r_k) grad(r_l)^T`` of each cell with sides r. K = 4 r_k r_l A
    (M^T C M)_kl, plus on the diagonal force / side if tensile, or always with `exact`. `tension`
    (m,) gets the sum of these forces in each segment: their tensile parts are taken per cell rather
    than of the sum, so that ranks sharing a side make the same stiffness as one rank."""
    tension[:] = 0.0
    C, K, r, most = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), 0
    for c in range(sides.shape[0]):
        most = max(most, element_pointers[c + 1] - element_pointers[c])
    B, KB = np.empty((most, 3, 3)), np.empty((most, 3, 3))
    for c in range(sides.shape[0]):
        start = element_pointers[c]
        size = element_pointers[c + 1] - start
        own = element_blocks[start : start + size]
        laws.tangent(law[c], p[c], out[c, :3], floor, C, orthotropic)
        B[:size], r[:] = 0.0, 0.0
        for k in range(3):
            for q in range(pointers[sides[c, k]], pointers[sides[c, k] + 1]):
                segment = side_segments[q]
                a, b = segments[segment, 0], segments[segment, 1]
                r0, r1, r2, d = difference(X, x, a, b)
                slope = slope_over_distance(d, eps[segment])
                r[k] += lengths[segment]
                i = j = 0
                while own[i] != a:  # np.searchsorted would take half a second to compile
                    i += 1
                while own[j] != b:
                    j += 1
                for m, component in enumerate((r0, r1, r2)):
                    B[i, k, m] -= slope * component
                    B[j, k, m] += slope * component
        for k in range(3):
            for n in range(3):
                K[k, n] = 0.0
                for i in range(3):
                    for j in range(3):
                        K[k, n] += maps[c, i, k] * C[i, j] * maps[c, j, n]
                K[k, n] *= 4 * r[k] * r[n] * areas[c]
            force = 0.0
            for i in range(3):
                force += out[c, 3 + i] * maps[c, i, k]
            pull = 2 * areas[c] * force
            if pull < 0.0 and not exact:
                pull = 0.0
            K[k, k] += pull
            for q in range(pointers[sides[c, k]], pointers[sides[c, k] + 1]):
                segment = side_segments[q]
                tension[segment] += pull * r[k] + 0.5 * prestress * lengths[segment]
        for i in range(size):
            for k in range(3):
                for a in range(3):
                    KB[i, k, a] = K[k, 0] * B[i, 0, a] + K[k, 1] * B[i, 1, a] + K[k, 2] * B[i, 2, a]
            for j in range(i + 1):
                block = values[offsets[c] + i * size + j]
                mirrored = values[offsets[c] + j * size + i]
                for a in range(3):
                    for b in range(3):
                        value = 0.0
                        for k in range(3):
                            value += KB[i, k, a] * B[j, k, b]
                        block[a, b] = mirrored[b, a] = value


class FoldedMembraneEnergy(ElementTerm):
    """Strain energy of the folded cells, in total formulation, (2.3)."""

    name = "membrane"
    exact_hessian = True
    of_cables = True
    stiffening: Stiffening

    def __init__(self, table: FoldedCells, stiffening: Stiffening) -> None:
        super().__init__(table)
        self.stiffening = stiffening
        self.areas, self.maps = table.areas, table.strain_maps
        self.squares = np.sum(table.side_vectors**2, axis=-1)
        self.lengths = np.zeros(len(table.segments))
        self.forces = np.zeros(len(table.segments))
        self._tension = np.zeros(len(table.segments))
        self.results = np.zeros((len(table.cells), 7))
        """Strain (E11, E22, 2 E12), section forces (S11, S22, S12) and state of each cell."""
        self._orthotropic = laws.orthotropic_flag(table.laws)
        self._element_pointers, self._element_blocks = table.element_blocks
        self.links = table.segments
        self.elements = ElementPattern(self._element_pointers, self._element_blocks)
        self.edges = SegmentPattern(table.segments)
        self.patterns = (self.elements, self.edges)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the energy; keeps the segment forces for the gradient."""
        t = self.table
        segment_lengths(self.unknowns.X, x, t.segments, t.eps, self.lengths)
        out[0] = cell_forces(
            self.lengths, t.side_pointers, t.side_segments, t.sides, self.maps, self.squares,
            self.areas, t.laws, t.parameters, self.forces, self.results,
            self._orthotropic,
        )  # fmt: skip

    def cell_results(self) -> Array:
        """See `results`."""
        return self.results

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        t = self.table
        add_segment_forces(self.unknowns.X, x, t.segments, t.eps, self.forces, g)

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the material stiffness, and the geometric one of segments in tension."""
        floor, prestress = self.stiffening.floor, self.stiffening.prestress
        self._add(x, A, float(floor.value), float(prestress.value), exact=False)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the second derivatives, including those of segments in compression."""
        self._add(x, A, 0.0, 0.0, exact=True)

    def _add(self, x: Array, A: BlockSink, floor: float, prestress: float, exact: bool) -> None:
        t, X = self.table, self.unknowns.X
        _cell_stiffness(
            X, x, t.segments, t.eps, self.lengths, t.side_pointers, t.side_segments, t.sides,
            self.maps, self.areas, t.laws, t.parameters, self.results, floor, prestress, exact,
            self._element_pointers, self._element_blocks, self.elements.offsets,
            self.elements.values, self._tension, self._orthotropic,
        )  # fmt: skip
        self.elements.add(A)
        segment_stiffness(X, x, t.segments, t.eps, self._tension, self.edges.values)
        self.edges.add(A)

    def of_elements(self, table: FoldedCells, sums: Array) -> FoldedMembraneEnergy:
        return FoldedMembraneEnergy(table, self.stiffening)
