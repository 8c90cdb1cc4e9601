"""Local relaxation: blocks far out of balance are minimised alone, with all others held.

After a few iterations nearly all unbalanced force of a net sits at a handful of cable points:
crossings near an edge with their two fold points, and fold points close to a vertex. Each is
nonlinear over its own tiny distance, and would limit the step length of all unknowns. So they are
balanced before each step (`relax_points`): a nonlinear elimination. After a change of path or
contact nearly all force is around that place; there points and vertices are relaxed together before
the solve (`relax_patch`), which often suffices.
"""

from __future__ import annotations

import numba
import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.minimization.local_potential import LocalPotential, gather, give_back
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import STRATEGY, Strategy
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import GhostFlags
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices

RISE = 1e-12
"""Rise of the energy, relative to the sum of its terms' sizes, attributed to rounding."""


class LocalRelaxation:
    """Relaxes blocks of a potential that are out of balance.

    Each cluster of blocks is relaxed by one rank, with the elements of all, see `clusters.gather`;
    clusters interact only through cable lengths. Flags are (n_local,), consistent on ghosts.

    Attributes: `steps`: Newton steps made, on all ranks; `has_points`: whether there are points to
    relax: none of cables that run along edges of the mesh.
    """

    def __init__(self, potential: Potential, strategy: Strategy = STRATEGY) -> None:
        self.potential, self.strategy, self.steps = potential, strategy, 0
        unknowns = potential.unknowns
        own = unknowns.n_owned
        self._flags = GhostFlags(unknowns)
        free: Booleans = np.zeros(unknowns.n_local, dtype=bool)
        free[:own] = ~unknowns.held[:own].all(axis=1)
        free = self._flags.of_owners(free)
        self._points = free.copy()
        self._points[unknowns.vertex_blocks()] = self._points[unknowns.far_vertex_blocks()] = False
        self._points[unknowns.shifts] = False
        self._n_points = self._count(self._points)
        self.has_points = self._n_points > 0
        # Forms over all cells may have no counterpart for the cells around some vertices.
        alone = all(
            term.integral is None or term.elementwise is not None for term in potential.terms
        )
        self._all, self._stuck = free if alone else self._points, np.zeros_like(free)
        self._n_all = self._count(self._all)
        pairs = [term.links for term in potential.terms if term.links is not None]
        links = np.concatenate([np.zeros((0, 2), dtype=np.int32), *pairs])
        self._point_links = links[self._points[links].all(axis=1)]
        self._links = links[free[links].all(axis=1)]

    @classmethod
    def of(cls, potential: Potential, strategy: Strategy) -> LocalRelaxation | None:
        """Create one if a potential has cable points that can be relaxed alone."""
        cables = [term for term in potential.terms if term.of_cables]
        parts = all(type(term).elements_on is not EnergyTerm.elements_on for term in cables)
        history = any(term.has_history for term in potential.terms)
        bounds = potential.unknowns.bounds is not None
        possible = cables and parts and not history and not bounds
        return cls(potential, strategy) if possible else None

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._flags.destroy()

    def before_step(
        self, residual: float, tolerance: float, scale: float, *, stressed: bool, first: bool
    ) -> bool:
        """Relax blocks far out of balance before a global step. Collective. Units: residual,
        tolerance (force). Returns whether the state, then evaluated, has changed."""
        if first:
            return stressed and self.relax_patch(scale)
        of_vertices = self._residuals(self._points)[1]
        # One point alone may set the scale; on a flat sheet that is no reason to relax.
        settled = (of_vertices if stressed else residual) < self.strategy.afar * scale
        return settled and residual > self.strategy.settled * scale and self.relax_points(tolerance)

    def relax_points(self, tolerance: float) -> bool:
        """Relax points while they are far more out of balance than the vertices. Collective. Units:
        tolerance (force). Returns whether the state, then evaluated, has changed."""
        s, chosen, aim = self.strategy, np.zeros_like(self._points), 0.0
        self._stuck[:] = False
        for turn in range(s.rounds):
            of_points, of_vertices = self._residuals(self._points)
            goal = max(s.ratio * of_vertices, tolerance, aim)
            if not of_points > goal:
                return turn > 0
            aim = s.balanced * goal
            least = aim / max(self._n_points, 1) ** 0.5
            links = self._point_links
            chosen |= self._around(self._points, links, s.point_part, s.point_rings, least)
            if self._count(chosen) > s.most_relaxed * self._n_points:
                chosen = self._points.copy()
            if not self._relax(chosen, 0.5 * aim, vertices=False):
                return True
        return True

    def relax_patch(self, scale: float) -> bool:
        """Relax points and vertices around the blocks out of balance. Collective. Returns whether
        the state, then evaluated, has changed."""
        s, chosen = self.strategy, np.zeros_like(self._all)
        self._stuck[:] = False
        for turn in range(s.rounds):
            more = chosen | self._around(self._all, self._links, s.patch_part, s.patch_rings, 0.0)
            inside, outside = self._residuals(more)
            least = (s.patched if turn == 0 else s.settled) * scale
            if self._count(more) > s.most_relaxed * self._n_all or inside < max(outside, least):
                return turn > 0
            chosen = more
            least = max(0.1 * outside, 0.1 * s.settled * scale)
            if not self._relax(chosen, least, vertices=True):
                return True
        return True

    def _relax(self, chosen: Booleans, tolerance: float, vertices: bool) -> bool:
        """Relax the chosen blocks (`vertices`: whether these include any) and return whether the
        energy has not risen. Collective."""
        potential, before = self.potential, self.potential.x.copy()
        energy, size = potential.energy(), sum(map(abs, potential.energies().values()))
        potential.unknowns.update_ghosts(potential.g_vector)
        moves = self._flags.of_owners(chosen & ~self._stuck)
        clusters = gather(potential, moves, self._flags.shared, self.strategy.largest_cluster)
        local = LocalPotential(potential, clusters, self.strategy)
        late = local.relax(tolerance, self.strategy.local_steps)
        self.steps += potential.comm.allreduce(local.steps)
        self._stuck |= give_back(potential, clusters, local.blocks, late)
        potential.place()
        if potential.evaluate(vertices) <= energy + RISE * size:
            return True
        potential.x[:] = before
        potential.place()
        potential.evaluate(vertices)
        return False

    def _sizes(self) -> Array:
        """Norms of the free forces on the owned blocks, (n_owned,)."""
        n = self.potential.unknowns.n_owned
        g = np.where(self.potential.unknowns.held[:n], 0.0, self.potential.g[:n])
        return np.asarray(np.linalg.norm(g, axis=1))

    def _residuals(self, of: Booleans) -> tuple[float, float]:
        """Norms of the forces on the given owned blocks and on all others."""
        sizes = self._sizes()
        of = of[: len(sizes)]
        squares = np.array([np.sum((sizes * some) ** 2) for some in (of, ~of)])
        self.potential.comm.Allreduce(MPI.IN_PLACE, squares)
        return float(squares[0] ** 0.5), float(squares[1] ** 0.5)

    def _around(
        self, of: Booleans, links: Indices, part: float, rings: int, least: float
    ) -> Booleans:
        """Blocks out of balance, and rings of linked (n, 2) blocks around them."""
        sizes = self._sizes()
        sizes *= of[: len(sizes)]
        top = self.potential.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
        found = np.zeros_like(of)
        found[: len(sizes)] = sizes > max(part * top, least)
        found = self._flags.of_owners(found)
        for _ in range(rings):
            found = self._flags.on_any(_with_linked(links, found))
        return found

    def _count(self, of: Booleans) -> int:
        """Number of flagged blocks on all ranks. Collective."""
        unknowns = self.potential.unknowns
        return int(unknowns.comm.allreduce(np.count_nonzero(of[: unknowns.n_owned])))


@numba.njit(cache=True)
def _with_linked(links, flags):  # type: ignore[no-untyped-def]
    """Flags of blocks and of those linked to flagged ones by pairs (n, 2)."""
    found = flags.copy()
    for k in range(len(links)):
        a, b = links[k]
        found[a] |= flags[b]
        found[b] |= flags[a]
    return found
