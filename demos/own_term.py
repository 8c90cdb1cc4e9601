"""An energy term of your own
==========================

Bars tie down an inflated square: an energy term that the package does not have.

Bars run from the vertices around the middle of the sheet to one anchor below it, each with the
strain energy of a spring. A cable is then tightened beside the bars. Units: kgf, cm.

::

    ./run python demos/own_term.py
"""

from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, EnergyTerm, IsotropicMembrane, Scene, Solver, meshes, taylor_test
from crms_fenicsx.foundation.dofs.block_patterns import ElementPattern
from crms_fenicsx.results.output import draw

RESULTS = "results/own_term"


# %%
# The term
# --------
# A term has methods for its value and for its gradient. The stiffness is optional; it makes stiff
# terms converge fast.
class Bars(EnergyTerm):
    """Strain energy ``EA/(2 L0) (l - L0)^2`` of bars from vertices to an anchor.

    Parameters
    ----------
    vertices
        Local degrees of freedom, as `Scene.vertices` returns them.
    anchor
        Common end of the bars, (3,).
    EA, L0
        Axial stiffness (force) and unstressed length of each bar.
    """

    name = "anchor bars"

    def __init__(self, vertices: Any, anchor: tuple[float, ...], EA: float, L0: float) -> None:
        self.vertices, self.anchor, self.EA, self.L0 = vertices, anchor, EA, L0

    def attach(self, unknowns: Any) -> None:
        super().attach(unknowns)
        self.own = self.vertices[self.vertices < unknowns.n_vertices]  # the others are ghosts
        self.pattern = ElementPattern(np.arange(len(self.own) + 1), self.own)
        self.patterns = (self.pattern,)

    def sums(self, x: Any, out: Any) -> None:
        ways = self.unknowns.X[self.own] + x[self.own] - self.anchor
        self.lengths = np.linalg.norm(ways, axis=1)
        self.directions = ways / self.lengths[:, None]
        out[0] = self.EA / (2 * self.L0) * np.sum((self.lengths - self.L0) ** 2)

    @property
    def tensions(self) -> Any:
        return self.EA * (self.lengths / self.L0 - 1)

    def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
        g[self.own] += self.tensions[:, None] * self.directions

    def add_stiffness(self, x: Any, sums: Any, A: Any) -> None:
        along = self.directions[:, :, None] * self.directions[:, None, :]
        across = np.maximum(self.tensions / self.lengths, 0.0)[:, None, None]
        self.pattern.values[:] = self.EA / self.L0 * along + across * (np.eye(3) - along)
        self.pattern.add(A)


# %%
# The scene
# ---------
# ``taylor_test`` checks the gradient against the energy: the order must be 2.
mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=100.0, size=5.0)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
middle = scene.vertices(lambda x: np.hypot(x[0] - 50.0, x[1] - 50.0) < 12.0)
bars = Bars(middle, anchor=(50.0, 50.0, -40.0), EA=20.0, L0=40.0)
rates = taylor_test(bars, scene.u, stiffness="semidefinite")
scene.add_term(bars)
solver = Solver(scene, results=RESULTS)

solver.advance(pressure=0.01)
cable = scene.lay_cable(Cable(EA=32000.0), path=[(0.0, 20.0), (100.0, 30.0)])
solver.advance(L0={cable: 0.99 * cable.L0})
draw(solver, f"{RESULTS}/tied_down.png", title="Tied down", unit="cm", force="kgf")
# %%
# Balance
# -------
bars_pull = scene.comm.allreduce(bars.tensions @ bars.directions)

if scene.comm.rank == 0:
    print(f"Taylor test   order   {rates.gradient:8.3f}")
    print(f"bars          energy  {scene.energies['anchor bars']:8.3f} kgf cm")
    print(f"              pull    {bars_pull[2]:8.3f} kgf")
    print(f"cable         tension {cable.tension:8.3f} kgf")
    print(f"files: {RESULTS}")
