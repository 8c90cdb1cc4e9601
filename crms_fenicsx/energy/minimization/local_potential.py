"""The potential of a patch of blocks with all others held, minimised by Newton's method.

Its terms are the elements that depend on these blocks; all other forces on them are constant. The
first rank gathers the elements and minimises, so the result does not depend on the partition of the
mesh. A patch is small: its stiffness is a dense matrix, to which the cables' dyads are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.blas import dsyr

from crms_fenicsx.energy.minimization.damping import Damping
from crms_fenicsx.energy.minimization.initial_hessian import EXACT_SHIFT, SHIFT
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import Strategy
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, scatter_blocks
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers

SPRINGS = -1
"""Term number of the damping springs."""

STEADY = 1e-11
"""Energy change, relative to its parts, below which the trapezoidal rule avoids rounding."""


@dataclass(frozen=True)
class PatchData:
    """Elements of a patch, and the state of the n blocks that these address."""

    numbers: Integers  # (n,) global numbers of the blocks
    owned: Booleans  # (n,) whether the telling rank owns them
    # X, x, g: (n, 3) positions at zero displacement, displacements, forces of the whole potential
    X: Array
    x: Array
    g: Array
    moves: Booleans  # (n,) whether they move; all others are held
    held: Booleans  # (n, 3) components with a prescribed value
    projectors: Array  # (n, 3, 3) of sliders; zero for others
    # rides_on, weights: (n, 3) global numbers of the blocks that tied points ride on, -1 for other
    # blocks, and weights
    rides_on: Integers
    weights: Array
    tables: Sequence[tuple[int, ElementTable]]  # term numbers of the potential, elements of each

    @classmethod
    def of(cls, potential: Potential, moves: Booleans) -> PatchData:
        """This rank's part of the patch of the flagged blocks, (n_local,)."""
        unknowns, n = potential.unknowns, potential.unknowns.n_local
        used, on_points = moves.copy(), moves[unknowns.interpolation].any(axis=1)
        used[unknowns.tied_points] |= on_points
        tables = [(k, term.elements_on(used)) for k, term in enumerate(potential.terms)]
        if potential.damping is not None:
            tables.append((SPRINGS, potential.damping.elements_on(used)))
        told = [(k, table) for k, table in tables if table is not None]
        used = moves.copy()
        for _, table in told:
            for name in table.addresses:
                used[getattr(table, name)] = True
        used[unknowns.interpolation[used[unknowns.tied_points]]] = True
        blocks = np.flatnonzero(used)
        number = np.full(n, -1, dtype=np.int32)
        number[blocks] = np.arange(len(blocks))
        numbers = unknowns.numbers().astype(np.int64)
        projectors, weights = np.zeros((n, 3, 3)), np.zeros((n, 3))
        rides_on = np.full((n, 3), -1, dtype=np.int64)
        projectors[unknowns.sliders] = unknowns.projectors
        rides_on[unknowns.tied_points] = numbers[unknowns.interpolation]
        weights[unknowns.tied_points] = unknowns.weights
        values = (
            numbers, np.arange(n) < unknowns.n_owned, unknowns.X, potential.x, potential.g, moves,
            unknowns.held, projectors, rides_on, weights,
        )  # fmt: skip
        own = [(k, table.renumbered(number)) for k, table in told]
        return cls(*(value[blocks] for value in values), own)  # type: ignore[call-arg, arg-type]

    @classmethod
    def joined(cls, parts: Sequence[PatchData]) -> PatchData:
        """Merge the parts told by several ranks."""
        if len(parts) == 1:
            return parts[0]
        numbers = np.concatenate([part.numbers for part in parts])
        # Of duplicates the owner's comes last and is kept.
        order = np.argsort(np.concatenate([part.owned for part in parts]), kind="stable")
        _, last, place = np.unique(numbers[order[::-1]], return_index=True, return_inverse=True)
        kept = order[::-1][last]
        places = np.empty(len(order), dtype=np.int32)
        places[order[::-1]] = place
        at = np.split(places, np.cumsum([len(part.numbers) for part in parts])[:-1])
        names = [field.name for field in fields(cls) if field.name != "tables"]
        values = [np.concatenate([getattr(part, name) for part in parts])[kept] for name in names]
        told = [
            (k, t.renumbered(own)) for p, own in zip(parts, at, strict=True) for k, t in p.tables
        ]
        return cls(*values, told)  # type: ignore[call-arg]

    def elements_of(self, term: int) -> Sequence[ElementTable]:
        """Elements of a term, in as few tables as possible."""
        tables = [table for k, table in self.tables if k == term]
        return type(tables[0]).joined(tables) if tables else ()


class _PatchBlocks(LocalBlocks):
    """The blocks of a patch as a layout."""

    comm = MPI.COMM_SELF

    def __init__(self, patch: PatchData) -> None:
        super().__init__(patch.X)
        self.held[:] = patch.held
        tied_points = np.flatnonzero(patch.rides_on[:, 0] >= 0).astype(np.int32)
        order = np.argsort(patch.numbers)
        on = order[np.searchsorted(patch.numbers[order], patch.rides_on[tied_points])]
        self.set_tied_points(tied_points, on.astype(np.int32), patch.weights[tied_points])
        sliders = np.flatnonzero(patch.projectors.any(axis=(1, 2))).astype(np.int32)
        self.set_sliders(sliders, patch.projectors[sliders])


class _DenseStiffness:
    """Stiffness of the moving `blocks` (n,), to which terms add as to a PETSc matrix: only what is
    on and above the diagonal of `values` (3 n, 3 n) counts."""

    def __init__(self, layout: LocalBlocks, blocks: Integers) -> None:
        self._layout, self._number = layout, np.full(layout.n_local, -1)
        self._number[blocks] = np.arange(len(blocks))
        self.values: Array = np.zeros((3 * len(blocks), 3 * len(blocks)))
        self._places: dict[BlockPattern, Any] = {}

    def take(self, pattern: BlockPattern) -> None:
        """Add a pattern's values, except those of held blocks."""
        if pattern not in self._places:
            (rows, cols), sources, weights = self._layout.spread(pattern.rows, pattern.cols)
            i, j = self._number[rows], self._number[cols]
            own = np.flatnonzero((i >= 0) & (j >= i))
            size = len(self.values)
            starts, strides = 3 * (i[own] * size + j[own]), np.full(len(own), size)
            self._places[pattern] = *pattern.parts(sources[own], weights[own]), starts, strides
        scatter_blocks(pattern.values, *self._places[pattern], self.values.reshape(-1))

    def solve(self, b: Array, exact: bool, bound: Integers, projectors: Array) -> Array | None:
        """Solve for b (n, 3), with the blocks `bound` (k,) on their free directions, given by
        `projectors` (k, 3, 3); None if the matrix is not definite. Overwrites `values`. The
        diagonal is shifted as that of H0, less if `exact`."""
        A, n = self.values, len(b)
        traces = A.diagonal().reshape(n, 3).sum(axis=1)
        some = np.log(traces[traces > 0.0])
        mean = float(np.exp(some.mean())) if len(some) else 1.0
        part = EXACT_SHIFT if exact else SHIFT
        A.reshape(-1)[:: 3 * n + 1] += np.repeat(part * (np.maximum(traces, 0.0) + mean), 3)
        for k, P in zip(3 * bound, projectors, strict=True):
            own = slice(k, k + 3)
            A[:k, own] = A[:k, own] @ P
            A[own, k + 3 :] = P @ A[own, k + 3 :]
            A[own, own] = P @ A[own, own] @ P + mean * (np.eye(3) - P)
        try:
            factors = cho_factor(A.T, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return None
        return np.asarray(cho_solve(factors, b.ravel(), check_finite=False).reshape(n, 3))


class LocalPotential:
    """Part of a potential that depends on some blocks, as a function of them alone.

    Attributes: `blocks` (n,): the moving blocks, of those of the patch; `x` (n_blocks, 3):
    displacements of all blocks of the patch (length), changed in place; `g` (n, 3): forces on the
    moving blocks, last evaluated (force); `energy`: at that state (force x length); `steps`: Newton
    steps made.
    """

    def __init__(self, whole: Potential, patch: PatchData, strategy: Strategy) -> None:
        self.strategy, self.layout = strategy, _PatchBlocks(patch)
        self.terms: list[EnergyTerm] = []
        for k, term in enumerate(whole.terms):
            for table in patch.elements_of(k):
                self.terms.append(term.of_elements(table, whole.sums_of(term)))
                self.terms[-1].attach(self.layout)  # type: ignore[arg-type]  # as terms need
        self._sums = [np.zeros(term.n_sums) for term in self.terms]
        springs: Sequence[Any] = patch.elements_of(SPRINGS)
        self._damping = [Damping(table) for table in springs]
        self.blocks = np.flatnonzero(patch.moves)
        self.x, self._forces, self.steps = patch.x, np.zeros_like(patch.x), 0
        sliders = np.asarray(patch.projectors[self.blocks].any(axis=(1, 2)))
        held = patch.held[self.blocks]
        self._bound = np.flatnonzero(held.any(axis=1) | sliders)
        P = np.eye(3) * ~held[self._bound, None]
        P[sliders[self._bound]] = patch.projectors[self.blocks[sliders]]
        self._projectors = P
        self.g: Array = np.zeros((len(self.blocks), 3))
        self._others: Array = self.g
        self.energy, self._size, self._start = 0.0, 0.0, self.x[self.blocks]
        given = self._project(patch.g[self.blocks])
        self.evaluate()
        # Forces from everything but these terms are constant.
        self._others = given - self.g
        self.g = given
        self._matrix = _DenseStiffness(self.layout, self.blocks)

    def evaluate(self) -> None:
        """Compute energy and forces at the current state."""
        self.layout.place_tied_points(self.x)
        self._forces[:] = 0.0
        parts = []
        for term, sums in zip(self.terms, self._sums, strict=True):
            term.sums(self.x, sums)
            term.add_gradient(self.x, sums, self._forces)
            parts.append(term.energy(sums))
        self.layout.transfer_tied_forces(self._forces)
        self.g = self._project(self._forces[self.blocks]) + self._others
        work = float(np.sum(self._others * (self.x[self.blocks] - self._start)))
        self.energy, self._size = sum(parts) + work, sum(map(abs, parts))

    def _project(self, values: Array) -> Array:
        """Project vectors of the moving blocks (n, 3) on the free directions, in place."""
        free = np.einsum("nij,nj->ni", self._projectors, values[self._bound])
        values[self._bound] = free
        return values

    def minimize(self, tolerance: float) -> bool:
        """Minimise to `tolerance` (force) in a few steps; return whether that was reached. Short
        steps by the second derivatives are followed by as many with H0."""
        s, short, least = self.strategy, 0, max(tolerance, 1e-3 * float(np.linalg.norm(self.g)))
        for step in range(s.local_steps):
            if np.linalg.norm(self.g) <= least:
                return True
            exact = step > 0 and short < s.twice
            length = self._step(exact)
            if length == 0.0:
                return False
            short = (short + 1 if length < s.short else 0) if exact else short - (short >= s.twice)
        return bool(np.linalg.norm(self.g) <= least)

    def _step(self, exact: bool) -> float:
        """Make a Newton step with line search; return its length, 1 at most, or 0 where the energy
        does not fall."""
        start, g0, energy0 = self.x[self.blocks], self.g, self.energy
        d = self._direction(True) if exact else None
        d = self._direction(False) if d is None else d
        if d is None:
            return 0.0
        slope, length = float(np.sum(d * g0)), 1.0
        while slope < 0.0 and length >= self.strategy.shortest_local:
            self.x[self.blocks] = start + length * d
            self.evaluate()
            change = self.energy - energy0
            if abs(change) <= STEADY * self._size:
                change = 0.5 * length * (slope + float(np.sum(d * self.g)))
            if change <= self.strategy.descent * length * slope:
                self.steps += 1
                return length
            curved = 2 * (change - slope * length)  # nan where the energy is not finite
            best = -slope * length**2 / curved if curved > 0.0 else 0.0
            length = min(max(best, 0.1 * length), 0.5 * length)
        self.x[self.blocks] = start
        self.evaluate()
        return 0.0

    def _direction(self, exact: bool) -> Array | None:
        """Newton direction by the second derivatives, or by H0 with springs, at the current state,
        (n, 3); None if they are not definite."""
        self._assemble(exact)
        if not exact:
            self._forces[:] = 0.0  # held blocks need no damping
            self._forces[self.blocks] = self.g
            layout: Any = self.layout  # as much as springs need
            for damping in self._damping:
                damping.add_stiffness(layout, self.x, self._forces, self._matrix)
        return self._matrix.solve(-self.g, exact, self._bound, self._projectors)

    def _assemble(self, exact: bool) -> None:
        """Assemble the stiffness of all terms, or their second derivatives."""
        A = self._matrix
        A.values[:] = 0.0
        for term, sums in zip(self.terms, self._sums, strict=True):
            (term.add_hessian if exact else term.add_stiffness)(self.x, sums, A)
            for k, value in enumerate(term.dyads(sums, exact)):
                self._forces[:] = 0.0
                term.add_dyad_column(k, self.x, self._forces)
                self.layout.transfer_tied_forces(self._forces)
                column = self._forces[self.blocks].ravel()
                if value > 0.0 and column.any():
                    dsyr(value, column, lower=1, a=A.values.T, overwrite_a=1)
