"""Cables with friction along their axis: strain energy and friction, with stick and slip.

The tension T_k varies from span to span between the nodes at which the cable touches the membrane.
The energy of such a cable is

    sum over spans EA/2 <l_k - d_k>^2 / d_k  +  sum over nodes B_k eps_k f(s_k/eps_k),

with the current length l_k and the current unstressed length d_k of a span, and the axial slip s_k
at a node, measured on the unstressed cable. The slips are not unknowns of the solver: for given
span lengths, which every rank has from the one reduction, they minimise this energy
(`energy.terms.capstan_chain`), so that its derivative by l_k is T_k.

The unstressed arc length at rest at a fold point depends on its position on the edge, as an edge is
not orthogonal to the cable: ``rest = slope * fraction + offset``. Otherwise axial friction would
also resist sideways sliding. So does that at a vertex of a row, on the shift w of its stress-free
place: ``rest = by_shift . w + offset``. Otherwise the lower one of two cables would rub on the
upper one where they cross, and not on the fabric that slides below both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crms_fenicsx.energy.terms.capstan_chain import ENERGY, find_slips
from crms_fenicsx.energy.terms.lateral_friction import (
    friction_energy,
    secant_stiffness,
    stored_and_lost,
)
from crms_fenicsx.energy.terms.segments import (
    add_segment_forces,
    add_slip_forces,
    edge_fractions,
    segment_lengths,
    segment_stiffness,
    shift_fractions,
)
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern, SegmentPattern
from crms_fenicsx.foundation.runtime.arrays import Array, Indices

MOST_DYADS = 8
"""Largest number of dyads per cable in H0: each costs a solve, so further runs are stiffer."""


@dataclass(frozen=True)
class Grips:
    """Friction bounds and rest positions of the cables' nodes, the same on all ranks."""

    offset: Array  # (n_nodes,) unstressed arc length at rest at fraction zero (length)
    # bound, eps, elastic: (n_nodes,) B (force), slip at which it is reached, largest elastic slip
    # (length)
    bound: Array
    eps: Array
    elastic: Array
    slips: Array  # (n_nodes,) initial guess of the slips (length)
    # slope, by_shift: unstressed arc length by edge fraction (n,) (length) and by shift (n, 3) of
    # this rank's fold points and vertices that shift; one and zero of the others
    slope: Array
    by_shift: Array


@dataclass(frozen=True)
class Chains:
    """Cables with friction along their axis."""

    EA: Array  # (n_cables,) axial stiffness (force)
    # (n_cables + 1,) first span of each cable, and the number of all spans. The nodes of cable c
    # start at ``starts[c] - c``.
    starts: npt.NDArray[np.int64]
    # segments (n, 2), smoothing (n,), span (n,): this rank's segments, smoothing of their lengths,
    # and their spans
    segments: Indices
    smoothing: Array
    span: Indices
    # pointers, blocks, place: blocks along the edges of fold points near this rank's cells, and
    # position of the fold point among them; see `energy.terms.segments.EdgePoints`. Of vertices
    # that shift: the block of the shift
    pointers: Indices
    blocks: Indices
    place: Indices
    # node, owned: number of each such point among all nodes, and whether this rank owns its edge
    # or vertex
    node: Indices
    owned: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class _StuckRun:
    """Spans of a cable between two sticking nodes: they share one elongation."""

    first: int
    last: int
    nodes: tuple[int, int]
    stiffness: float
    stretch: float


class CapstanTension(EnergyTerm):
    """Strain energy and axial friction of cables. Shapes and units: L0 (n_cables,) (length)."""

    name = "cables"
    of_cables = True

    def __init__(self, chains: Chains, grips: Grips, L0: Array) -> None:
        self.chains, self.grips, self.L0 = chains, grips, L0
        c = chains
        self.n_spans, self.n_nodes = int(c.starts[-1]), int(c.starts[-1]) - len(c.EA)
        self.n_sums = self.n_spans + self.n_nodes
        self._lengths, self._forces = np.zeros((2, len(c.segments)))
        self._fractions = np.zeros(len(c.place))
        self._gradients = np.zeros((len(c.blocks), 3))
        self.slips, self.unstressed = grips.slips.copy(), np.zeros(self.n_spans)
        self._friction, self._force = np.zeros(len(c.EA)), np.zeros(self.n_nodes)
        self._solved: Array | None = None
        self._runs: list[_StuckRun] = []
        self.pattern = SegmentPattern(c.segments)
        self._prepare_links()
        self.patterns = (self.pattern, self.span_pattern)

    def renew(self, grips: Grips) -> None:
        """Use other bounds and rest positions for the same nodes."""
        self.grips, self.slips, self._solved = grips, grips.slips.copy(), None

    def spans_of(self, c: int) -> slice:
        return slice(int(self.chains.starts[c]), int(self.chains.starts[c + 1]))

    def nodes_of(self, c: int) -> slice:
        """Nodes of a cable that have friction."""
        return slice(int(self.chains.starts[c]) - c, int(self.chains.starts[c + 1]) - c - 1)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the spans' lengths and the nodes' rest arc lengths (less offset)."""
        c, X = self.chains, self.unknowns.X
        segment_lengths(X, x, c.segments, c.smoothing, self._lengths)
        edge_fractions(X, x, c.pointers, c.blocks, c.place, self._fractions, self._gradients)
        shift_fractions(
            x, c.pointers, c.blocks, self.grips.by_shift, self._fractions, self._gradients
        )
        out[:] = 0.0
        np.add.at(out, c.span, self._lengths)
        own = self.n_spans + c.node[c.owned]
        out[own] = (self.grips.slope * self._fractions)[c.owned]

    def _solve(self, sums: Array) -> None:
        """Solve for slips, unstressed lengths and friction forces at these sums."""
        known = np.concatenate([sums, self.L0])
        if self._solved is not None and np.array_equal(known, self._solved):
            return
        grips = self.grips
        lengths, rest = sums[: self.n_spans], sums[self.n_spans :] + grips.offset
        for c, EA in enumerate(self.chains.EA):
            spans, nodes = self.spans_of(c), self.nodes_of(c)
            eps = grips.eps[nodes]
            found = find_slips(
                ENERGY, lengths[spans], rest[nodes], self.L0[c], grips.bound[nodes] / EA, eps,
                self.slips[nodes], self.unstressed[spans],
            )  # fmt: skip
            self._friction[c] = friction_energy(
                self.slips[nodes], grips.bound[nodes], eps, self._force[nodes]
            )
            if found < 0:  # NaN makes the line search step back
                self._friction[c] = np.nan
        self._solved = known

    def tensions(self, sums: Array) -> Array:
        """Tension of each span (force)."""
        self._solve(sums)
        EA = np.repeat(self.chains.EA, np.diff(self.chains.starts))
        elongation = sums[: self.n_spans] - self.unstressed
        return np.asarray(EA * np.maximum(elongation, 0.0) / self.unstressed)

    def friction(self, sums: Array) -> tuple[Array, Array]:
        """Stored and dissipated friction energy of each cable (force x length)."""
        self._solve(sums)
        stored, lost = np.zeros((2, len(self.chains.EA)))
        for c in range(len(lost)):
            at, grips = self.nodes_of(c), self.grips
            stored[c], lost[c] = stored_and_lost(
                self.slips[at], grips.bound[at], grips.eps[at], grips.elastic[at]
            )
        return stored, lost

    @property
    def friction_potential(self) -> float:
        """Potential of friction at the last evaluation (force x length)."""
        return float(self._friction.sum())

    def energy(self, sums: Array) -> float:
        """Strain energy and friction potential (force x length)."""
        EA = np.repeat(self.chains.EA, np.diff(self.chains.starts))
        energies = self.tensions(sums) ** 2 * self.unstressed / (2 * EA)
        by_cable = np.add.reduceat(energies, self.chains.starts[:-1])
        return float(by_cable.sum() + self._friction.sum())

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the nodal forces of the tensions, and of friction along the edges."""
        c = self.chains
        np.take(self.tensions(sums), c.span, out=self._forces)
        add_segment_forces(self.unknowns.X, x, c.segments, c.smoothing, self._forces, g)
        self._add_rest(np.where(c.owned, -self._force[c.node], 0.0), g)

    def _add_rest(self, weights: Array, g: Array) -> None:
        """Add the weighted gradient of the rest arc lengths of this rank's points."""
        c = self.chains
        add_slip_forces(c.pointers, c.blocks, self._gradients, weights * self.grips.slope, g)

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the geometric stiffness, and the axial one of single spans between sticking nodes."""
        c = self.chains
        forces = self.tensions(sums)[c.span]
        segment_stiffness(self.unknowns.X, x, c.segments, c.smoothing, forces, self.pattern.values)
        self.pattern.add(A)
        self._add_links(x, sums, A)

    def _find_runs(self, sums: Array) -> list[_StuckRun]:
        """Taut runs of spans between sticking nodes. A node sticks if its secant friction stiffness
        ``force / slip`` exceeds that of the cable beside it: many barely slip, and soon stick."""
        grips, lengths = self.grips, sums[: self.n_spans]
        stiffness = secant_stiffness(self.slips, grips.bound, grips.eps)
        runs = []
        for c, EA in enumerate(self.chains.EA):
            spans, nodes = self.spans_of(c), self.nodes_of(c)
            springs = EA / self.unstressed[spans]
            stuck = np.flatnonzero(stiffness[nodes] > np.minimum(springs[1:], springs[:-1]))
            firsts, lasts = [0, *(stuck + 1)], [*stuck, spans.stop - spans.start - 1]
            for a, b in zip(firsts, lasts, strict=True):
                own = slice(spans.start + int(a), spans.start + int(b) + 1)
                length, unstressed = lengths[own].sum(), self.unstressed[own].sum()
                if length > unstressed:
                    ends = (
                        nodes.start + int(a) - 1 if a > 0 else -1,
                        nodes.start + int(b) if own.stop < spans.stop else -1,
                    )
                    stretch = float(length / unstressed)
                    runs.append(_StuckRun(own.start, own.stop - 1, ends, EA / unstressed, stretch))
        return runs

    def dyads(self, sums: Array, exact: bool) -> Array:
        """Axial stiffness of the longest runs of spans (force/length)."""
        return np.array([run.stiffness for run in self._longest_runs(sums)])

    def _longest_runs(self, sums: Array) -> list[_StuckRun]:
        self._solve(sums)
        several = [run for run in self._find_runs(sums) if run.last > run.first]
        several.sort(key=lambda run: run.first - run.last)
        self._runs = several[: MOST_DYADS * len(self.chains.EA)]
        return self._runs

    def add_dyad_column(self, k: int, x: Array, g: Array) -> None:
        """Add the gradient of a run's elongation."""
        c, run = self.chains, self._runs[k]
        self._forces[:] = (c.span >= run.first) & (c.span <= run.last)
        add_segment_forces(self.unknowns.X, x, c.segments, c.smoothing, self._forces, g)
        ends = 1.0 * (c.node == run.nodes[0]) - 1.0 * (c.node == run.nodes[1])
        self._add_rest(np.where(c.owned, run.stretch * ends, 0.0), g)

    def _prepare_links(self) -> None:
        """Collect the blocks on which each local span's elongation depends, edges included."""
        c = self.chains
        cable_of = np.repeat(np.arange(len(c.EA)), np.diff(c.starts))
        row_of = {int(node): row for row, node in enumerate(c.node)}
        pointers = [0]
        blocks: list[int] = []
        self._links: list[tuple[int, list[int], tuple[int, int]]] = []
        for span in map(int, np.unique(c.span)):
            own = [int(k) for k in np.flatnonzero(c.span == span)]
            # the nodes before and after span s of cable n have the numbers s - n - 1 and s - n
            before = span - int(cable_of[span]) - 1
            inside = np.isin([span, span + 1], c.starts, invert=True)
            rows = [
                row_of.get(node, -1) if there else -1
                for node, there in zip((before, before + 1), inside, strict=True)
            ]
            blocks += [int(block) for block in c.segments[own].ravel()]
            for row in rows:
                if row >= 0:
                    edge = c.blocks[c.pointers[row] : c.pointers[row + 1]]
                    blocks += [int(block) for block in edge]
            pointers.append(len(blocks))
            self._links.append((span, own, (rows[0], rows[1])))
        self.link_pointers = np.array(pointers, dtype=np.int32)
        self.span_pattern = ElementPattern(self.link_pointers, np.array(blocks, dtype=np.int32))

    def _add_links(self, x: Array, sums: Array, A: BlockSink) -> None:
        c, X = self.chains, self.unknowns.X
        stiffness, stretch = np.zeros(self.n_spans), np.ones(self.n_spans)
        EA = np.repeat(c.EA, np.diff(c.starts))
        dyads = {run.first for run in self._longest_runs(sums)}
        for run in self._find_runs(sums):
            if run.first not in dyads:
                own = slice(run.first, run.last + 1)
                # upper bound of springs in series that has no coupling
                stiffness[own] = EA[own] / self.unstressed[own]
                stretch[own] = run.stretch
        slope, start = self.grips.slope, 0
        for (span, segments, ends), n in zip(self._links, np.diff(self.link_pointers), strict=True):
            values = self.span_pattern.values[start : start + n * n]
            values[:] = 0.0
            start += n * n
            # An anchor that coincides with the next held point has no direction.
            there = self._lengths[segments] > -c.smoothing[segments]
            if stiffness[span] == 0.0 or not there.any():
                continue
            # Segments of a span, as at a crossing inside a cell, share one elongation; those on
            # other ranks are not coupled by blocks.
            share = float(self._lengths[segments][there].sum() / sums[span])
            a, b = c.segments[segments].T
            way = X[b] + x[b] - X[a] - x[a]
            least = np.maximum(np.linalg.norm(way, axis=1), np.abs(c.smoothing[segments]))
            way *= np.divide(1.0, least, out=np.zeros_like(least), where=there)[:, None]
            column, at = np.zeros((n, 3)), 2 * len(segments)
            column[:at] = np.stack([-way, way], axis=1).reshape(at, 3)
            for row, sign in zip(ends, (1.0, -1.0), strict=True):
                if row >= 0:
                    edge = self._gradients[c.pointers[row] : c.pointers[row + 1]]
                    column[at : at + len(edge)] = sign * share * stretch[span] * slope[row] * edge
                    at += len(edge)
            dyad = np.einsum("ai,bj->abij", column, column).reshape(n * n, 3, 3)
            values[:] = stiffness[span] / share * dyad
        self.span_pattern.add(A)
