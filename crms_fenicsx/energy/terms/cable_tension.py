"""Strain energy of the cables: uniform tension along each, no compression (section 2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crms_fenicsx.energy.terms.segments import (
    add_segment_forces,
    segment_lengths,
    segment_stiffness,
)
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, SegmentPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans, Indices
from crms_fenicsx.model.cable_state import StepStart
from crms_fenicsx.model.tolerances import TOL


@dataclass(frozen=True)
class _CableSegments(ElementTable):
    """Segments of cables."""

    ends: Indices  # (n, 2) blocks
    eps: Array  # (n,) smoothing of their lengths
    cable: Indices  # (n,) number of the cable
    lengths: Array  # (n,) lengths at the last evaluation
    addresses = ("ends",)
    joins = True  # as a cable's length is the sum of theirs


class CableTension(EnergyTerm):
    """``EA/(2 L0) (L - L0)^2`` for L > L0, with the length L of a cable's whole polyline.

    Cables of one segment, marked in `alone` (n_cables,), put their axial stiffness into the sparse
    matrix; others have a dyad each.

    Attributes: `smoothing_length` (n_cables,): length that smoothing adds to each cable in the
    previous state, subtracted again (length); changed in place between solves. Shapes and units:
    segments, eps, cable (n,), EA, L0 (n_cables,) (force).
    """

    name = "cables"
    exact_hessian = True
    of_cables = True
    starts: Sequence[StepStart | None] = ()
    """States at the step's start, for cables with the step-wise law."""
    kept: Booleans | None = None
    """For derivatives: which cables count as taut, whatever their length; None: by their length."""

    def __init__(
        self,
        segments: npt.NDArray[np.int32],
        eps: Array,
        cable: npt.NDArray[np.int32],
        EA: Array,
        L0: Array,
        alone: Booleans | None = None,
    ) -> None:
        self.segments, self.eps, self.cable = segments, eps, cable
        self.EA, self.L0 = EA, L0
        self.alone: Booleans = np.zeros(len(EA), dtype=bool) if alone is None else alone
        self._shared = np.flatnonzero(~self.alone)
        self.smoothing_length: Array = np.zeros(len(EA))
        self.n_sums = len(EA)
        self._lengths = np.zeros(len(segments))
        self._forces = np.zeros(len(segments))
        self.pattern, self.links = SegmentPattern(segments), segments
        self.patterns = (self.pattern,)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of each cable's length."""
        segment_lengths(self.unknowns.X, x, self.segments, self.eps, self._lengths)
        out[:] = -self.smoothing_length if self.unknowns.comm.rank == 0 else 0.0
        np.add.at(out, self.cable, self._lengths)

    def tensions(self, lengths: Array) -> Array:
        """Tension of each cable (force)."""
        return self.EA / self.L0 * self._elongations(lengths)

    def energies(self, lengths: Array) -> Array:
        """Strain energy of each cable (force x length)."""
        return 0.5 * self.EA / self.L0 * self._elongations(lengths) ** 2

    def _elongations(self, lengths: Array) -> Array:
        """Elongation of each taut cable, else 0 (length)."""
        if self.kept is None:
            return np.maximum(lengths - self.L0, 0.0)
        return np.where(self.kept, lengths - self.L0, 0.0)

    def energy(self, sums: Array) -> float:
        return float(np.sum(self.energies(sums)))

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        np.take(self.tensions(sums), self.cable, out=self._forces)
        add_segment_forces(self.unknowns.X, x, self.segments, self.eps, self._forces, g)

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the rounding errors of this rank's segment forces: of directions and
        tensions, due to the coordinates. Prescribed ends that coincide have none."""
        ends = self.unknowns.X[self.segments] + x[self.segments]
        far = np.linalg.norm(ends, axis=2).max(axis=1)
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        counts = lengths >= -self.eps
        lengths = np.maximum(lengths, self.eps)[counts]
        turned = np.abs(self.tensions(sums))[self.cable[counts]] / lengths
        stretched = (self.EA / self.L0)[self.cable[counts]]
        return float(np.sum((EPSILON * (turned + stretched) * far[counts]) ** 2))

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the geometric stiffness, and the axial one of cables `alone`."""
        self._add_stiffness(x, sums, A, exact=False)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """The same, without axial stiffness of slack cables."""
        self._add_stiffness(x, sums, A, exact=True)

    def _add_stiffness(self, x: Array, sums: Array, A: BlockSink, exact: bool) -> None:
        """Add the geometric stiffness, and the axial one of cables `alone` as in `stiffnesses`."""
        forces = np.maximum(self.tensions(sums), 0.0)[self.cable]
        segment_stiffness(self.unknowns.X, x, self.segments, self.eps, forces, self.pattern.values)
        (single,) = np.nonzero(self.alone[self.cable])
        if len(single):
            ends = self.segments[single]
            ways = self.unknowns.X[ends] + x[ends]
            ways = ways[:, 1] - ways[:, 0]
            squares = np.maximum(np.sum(ways**2, axis=1), self.eps[single] ** 2)
            axial = self.stiffnesses(sums, exact)[self.cable[single]] / squares
            self.pattern.values[single] += (
                axial[:, None, None] * ways[:, :, None] * ways[:, None, :]
            )
        self.pattern.add(A)

    def stiffnesses(self, sums: Array, exact: bool = False) -> Array:
        """Axial stiffness EA/L0 of taut cables, else 0 (force/length). Unless `exact`, nearly taut
        ones count as taut, which a step may make them."""
        taut = sums > (self.L0 if exact else (1 - TOL.nearly_taut) * self.L0)
        if exact and self.kept is not None:
            taut = self.kept
        return np.where(taut, self.EA / self.L0, 0.0)

    def dyads(self, sums: Array, exact: bool) -> Array:
        """Axial stiffnesses of the cables of several segments."""
        return self.stiffnesses(sums, exact)[self._shared]

    def add_dyad_column(self, k: int, x: Array, g: Array) -> None:
        """Add the gradient of such a cable's length."""
        self.add_length_gradient(int(self._shared[k]), x, g)

    def add_length_gradient(self, k: int, x: Array, g: Array) -> None:
        """Add the gradient of a cable's length."""
        self._forces[:] = self.cable == k
        add_segment_forces(self.unknowns.X, x, self.segments, self.eps, self._forces, g)

    def elements_on(self, chosen: Booleans) -> _CableSegments | None:
        table = _CableSegments(self.segments, self.eps, self.cable, self._lengths)
        rows = table.rows_on(chosen)
        return table.some(rows) if len(rows) else None

    def of_elements(self, table: _CableSegments, sums: Array) -> CableTension:
        """Tension of such segments; the rest of each cable keeps its length."""
        some = CableTension(table.ends, table.eps, table.cable, self.EA, self.L0, self.alone)
        some.smoothing_length = np.bincount(table.cable, table.lengths, len(self.EA)) - sums
        return some
