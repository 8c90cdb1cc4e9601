"""The total potential energy: a sum of terms, with gradient and positive definite stiffness.

Equations (2.6-1) and (3.4-1). Terms are independent of each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.damping import Damping
from crms_fenicsx.energy.terms.integral import FusedAssembly
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, BlockSink
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime import interrupt
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans


class Potential:
    """Sum of terms over one layout of unknowns."""

    def __init__(
        self,
        unknowns: Unknowns,
        u: fem.Function,
        terms: Sequence[EnergyTerm],
        damping: Damping | None = None,
    ) -> None:
        self.unknowns, self.u, self.terms = unknowns, u, list(terms)
        self.damping = damping
        self.comm = unknowns.comm
        self.x_vector, self.x = unknowns.vector()
        self.g_vector, self.g = unknowns.vector()
        self._u = u.x.array.reshape(-1, 3)
        for term in self.terms:
            term.attach(unknowns)
        integrals = [term.integral for term in self.terms if term.integral is not None]
        self._pass = FusedAssembly.of(integrals) if integrals else None
        ends = np.cumsum([0] + [term.n_sums for term in self.terms])
        # The last entry counts the ranks told to stop.
        self._local_sums = np.zeros(int(ends[-1]) + 1)
        self._sums = np.zeros(int(ends[-1]) + 1)
        self._slices = [slice(a, b) for a, b in itertools.pairwise(ends)]
        self.evaluations = 0
        self._last_x = self.x_vector.duplicate()
        self._has_last_x = self._is_summed = False
        """Whether the state is that of the minimiser's last evaluation; whether sums are valid."""
        unknowns.add_to_vertices(self._u, self.x)

    def destroy(self) -> None:
        """Free the PETSc vectors."""
        for vector in (self.x_vector, self.g_vector, self._last_x):
            vector.destroy()

    def place(self, X: PETSc.Vec | None = None) -> None:
        """Make X (or the content of `x`) the current state, including ghosts and DOLFINx's
        function. If X was the minimiser's last evaluation, all computed values stay valid."""
        if X is None or not (self._has_last_x and X.equal(self._last_x)):
            self._place(X)

    def _place(self, X: PETSc.Vec | None) -> None:
        self._has_last_x = self._is_summed = False
        if X is not None:
            X.copy(self.x_vector)
        self.unknowns.update_ghosts(self.x_vector)
        self.unknowns.project(self.x)
        self.unknowns.place_tied_points(self.x)  # some ride on sliders
        self.unknowns.read_vertices(self.x, self._u)

    def sum_up(self) -> None:
        """Compute global sums of all terms at the current state, in the only reduction of an
        evaluation."""
        if self._pass is not None:
            self._pass.assemble()
        for term, part in zip(self.terms, self._slices, strict=True):
            term.sums(self.x, self._local_sums[part])
        self._local_sums[-1] = interrupt.noted()
        self.comm.Allreduce(self._local_sums, self._sums, op=MPI.SUM)
        if self._sums[-1] > 0.0:
            interrupt.stop_together(self.comm)
        self._is_summed = True

    def bring_up_to_date(self) -> None:
        """Call `sum_up` unless the sums belong to the current state."""
        if not self._is_summed:
            self.sum_up()

    def energies(self) -> dict[str, float]:
        """Energy of each term from the last sums (force x length)."""
        values: dict[str, float] = {}
        for term, part in zip(self.terms, self._slices, strict=True):
            values[term.name] = values.get(term.name, 0.0) + term.energy(self._sums[part])
        return values

    def energy(self) -> float:
        """Energy from the last sums (force x length)."""
        parts = zip(self.terms, self._slices, strict=True)
        return sum(term.energy(self._sums[part]) for term, part in parts)

    def sums_of(self, term: EnergyTerm) -> Array:
        """Global sums of one term, as last computed."""
        return self._sums[self._slices[self.terms.index(term)]]

    def evaluate(self) -> float:
        """Return the energy at the current state and set `g` to the gradient, including held
        components."""
        self.evaluations += 1
        self.sum_up()
        self.g[:] = 0.0
        energy = 0.0
        for term, part in zip(self.terms, self._slices, strict=True):
            energy += term.energy(self._sums[part])
            term.add_gradient(self.x, self._sums[part], self.g)
        self.unknowns.gather_forces(self.g_vector, self.g)
        self.unknowns.project(self.g)
        return energy

    def objective_gradient(self, tao: PETSc.TAO | None, X: PETSc.Vec, G: PETSc.Vec) -> float:
        """TAO's callback: energy at X, and in G its gradient with held components zero."""
        self._place(X)
        X.copy(self._last_x)
        self._has_last_x = True
        energy = self.evaluate()
        self.free_gradient(G)
        return energy

    def free_gradient(self, G: PETSc.Vec) -> None:
        """Zero the held components of the last gradient and copy it to G."""
        owned = self.unknowns.n_owned
        np.copyto(self.g[:owned], 0.0, where=self.unknowns.held[:owned])
        self.g_vector.copy(G)

    def patterns(self) -> list[BlockPattern]:
        """Block patterns of the stiffness."""
        springs = [] if self.damping is None else self.damping.patterns
        return [*springs, *(pattern for term in self.terms for pattern in term.patterns)]

    def add_stiffness(self, A: BlockSink, exact: bool = False) -> None:
        """Add stiffness and damping at the evaluated state; if `exact`, second derivatives only."""
        if self.damping is not None and not exact:
            self.unknowns.update_ghosts(self.g_vector)
            self.damping.add_stiffness(self.unknowns, self.x, self.g, A)
        for term, part in zip(self.terms, self._slices, strict=True):
            add = term.add_hessian if exact else term.add_stiffness
            add(self.x, self._sums[part], A)

    def dyads(self, exact: bool = False) -> Iterator[tuple[EnergyTerm, int, float]]:
        """Positive dyads of all terms from the last sums: term, number, value. `exact`: those of
        the second derivatives instead of the stiffness."""
        for term, part in zip(self.terms, self._slices, strict=True):
            for k, value in enumerate(term.dyads(self._sums[part], exact)):
                if value > 0.0:
                    yield term, k, float(value)

    def dyad_columns(self, held: Booleans, exact: bool) -> tuple[Array, Array]:
        """Values (m,) of all dyads and this rank's rows of their columns, (3 n_owned, m), zero at
        `held` components (n_owned, 3). Collective."""
        dyads, n = list(self.dyads(exact)), self.unknowns.n_owned
        columns = np.empty((3 * n, len(dyads)), order="F")
        for column, (term, k, _) in zip(columns.T, dyads, strict=True):
            self.dyad_column(term, k)
            self.g[:n][held] = 0.0
            column[:] = self.g[:n].ravel()
        return np.array([value for _, _, value in dyads]), columns

    def dyad_column(self, term: EnergyTerm, k: int) -> None:
        """Set `g` to the column of a term's dyad at the current state."""
        self.g[:] = 0.0
        term.add_dyad_column(k, self.x, self.g)
        self.unknowns.gather_forces(self.g_vector, self.g)
        self.unknowns.project(self.g)

    def rounding(self) -> float:
        """Norm of the rounding error of the forces at the last evaluated state (force). Collective.
        Where large forces cancel (of a cable at a point, of a tight membrane around it) the
        residual is known no better than this."""
        squares = 0.0
        for term, part in zip(self.terms, self._slices, strict=True):
            squares += term.rounding(self.x, self._sums[part])
        return float(self.comm.allreduce(squares, op=MPI.SUM) ** 0.5)

    def begin_step(self) -> None:
        """Begin a load step at the current state, for terms with history."""
        for term in self.terms:
            term.begin_step(self.x)

    def commit(self) -> None:
        """End a load step at the current state, for terms with history."""
        if any(term.has_history for term in self.terms):
            self.sum_up()
        for term, part in zip(self.terms, self._slices, strict=True):
            term.commit(self.x, self._sums[part])

    def evaluate_terms(self) -> tuple[float, float]:
        """Evaluate term by term, reusing valid sums. Returns the energy (force x length) and the
        force scale: the largest norm of one term's free nodal forces. Components across edge
        sliders count, as all others may vanish. If only one term has forces, which vanish in
        equilibrium, the support reactions count too."""
        self.evaluations += not self._is_summed
        self.bring_up_to_date()
        n = self.unknowns.n_owned
        free = ~self.unknowns.held[:n]
        energy, squares = 0.0, np.zeros(len(self.terms) + 1)
        total = np.zeros_like(self.g)
        for k, (term, part) in enumerate(zip(self.terms, self._slices, strict=True)):
            energy += term.energy(self._sums[part])
            self.g[:] = 0.0
            term.add_gradient(self.x, self._sums[part], self.g)
            self.unknowns.gather_forces(self.g_vector, self.g)
            squares[k] = np.sum(self.g[:n][free] ** 2)
            total += self.g
        squares[-1] = np.sum(total[:n][~free] ** 2)
        self.g[:] = total
        self.unknowns.project(self.g)
        *of_terms, of_supports = self.comm.allreduce(squares, op=MPI.SUM).tolist()
        alone = sum(square > 0.0 for square in of_terms) < 2
        return energy, max(*of_terms, of_supports * alone, 0.0) ** 0.5
