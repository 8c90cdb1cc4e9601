"""Relaxation: a patch of blocks far out of balance is minimised alone, with all others held.

After a change of path or contact nearly all unbalanced force is around that place. Before the solve
the cable points and vertices there are relaxed together, which often suffices to judge the change:
its cost then hardly grows with the mesh.
"""

from __future__ import annotations

import numba
import numpy as np
from mpi4py import MPI

from crms_fenicsx.energy.minimization.local_potential import LocalPotential, PatchData
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import STRATEGY, Strategy
from crms_fenicsx.foundation.dofs.layout import GhostFlags
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers

RISE = 1e-12
"""Rise of the energy, relative to the sum of its terms' sizes, attributed to rounding."""


class Relaxation:
    """Relaxes blocks of a potential that are out of balance; flags are (n_local,), consistent on
    ghosts. Attributes: `steps`: Newton steps made."""

    def __init__(self, potential: Potential, strategy: Strategy = STRATEGY) -> None:
        self.potential, self.strategy, self.steps = potential, strategy, 0
        unknowns = potential.unknowns
        self._flags = GhostFlags(unknowns)
        free: Booleans = np.zeros(unknowns.n_local, dtype=bool)
        free[: unknowns.n_owned] = ~unknowns.held[: unknowns.n_owned].all(axis=1)
        self._free = self._flags.of_owners(free)
        self._n_free = self._count(self._free)
        pairs = [term.links for term in potential.terms if term.links is not None]
        links = np.concatenate([np.zeros((0, 2), dtype=np.int32), *pairs])
        self._links = links[self._free[links].all(axis=1)]

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self._flags.destroy()

    def relax(self, scale: float) -> bool:
        """Relax what is around the blocks out of balance. Collective. Units: scale (force). Returns
        whether the state, then evaluated, may have changed."""
        s, chosen = self.strategy, np.zeros_like(self._free)
        most = min(s.most_relaxed * self._n_free, s.largest_patch)
        for turn in range(s.rounds):
            more = chosen | self._around()
            inside, outside = self._residuals(more)
            least = (s.patched if turn == 0 else s.settled) * scale
            if self._count(more) > most or inside < max(outside, least):
                return turn > 0
            chosen = more
            if not self._minimize(chosen, max(0.1 * outside, 0.1 * s.settled * scale)):
                return True
        return True

    def _minimize(self, chosen: Booleans, tolerance: float) -> bool:
        """Minimise over the chosen blocks to `tolerance` (force); return whether that was reached.
        Where the energy of the whole rises the state stays. Collective."""
        potential, before = self.potential, self.potential.x.copy()
        energy, size = potential.energy(), sum(map(abs, potential.energies().values()))
        potential.unknowns.update_ghosts(potential.g_vector)
        parts = potential.comm.gather(PatchData.of(potential, chosen))
        found: tuple[Integers, Array, int, bool] | None = None
        if parts is not None:
            patch = PatchData.joined(parts)
            local = LocalPotential(potential, patch, self.strategy)
            reached, moved = local.minimize(tolerance), local.blocks
            found = patch.numbers[moved], local.x[moved], local.steps, reached
        numbers, x, steps, reached = potential.comm.bcast(found)
        self.steps += steps
        numbers = numbers - potential.unknowns.start
        own = (numbers >= 0) & (numbers < potential.unknowns.n_owned)
        potential.x[numbers[own]] = x[own]
        potential.place()
        if potential.evaluate() <= energy + RISE * size:
            return reached
        potential.x[:] = before
        potential.place()
        potential.evaluate()
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

    def _around(self) -> Booleans:
        """Free blocks out of balance, and rings of linked blocks around them."""
        sizes = self._sizes() * self._free[: self.potential.unknowns.n_owned]
        top = self.potential.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
        found = np.zeros_like(self._free)
        found[: len(sizes)] = sizes > self.strategy.patch_part * top
        found = self._flags.of_owners(found)
        for _ in range(self.strategy.patch_rings):
            found = self._flags.on_any(_with_linked(self._links, found))
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
