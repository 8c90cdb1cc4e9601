"""An integral over the cells and its gradient, assembled in one pass over the mesh.

Both need the same geometry and strain of a cell, and DOLFINx's way to a cell and back costs as much
as either. So there is one form for both, whose test function has four components instead of three:

    (v, q)  ->  gradient along v  +  integral of density * q.

As the shape functions sum to one everywhere, the vertices' entries of q sum to the integral.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

Array = npt.NDArray[np.float64]


class Integral:
    """A functional of the vertex displacements with its gradient.

    Parameters
    ----------
    V
        Vertex displacements: continuous piecewise linear vectors (3).
    form
        UFL form, linear in what it is called with: a test displacement v (3,), which stands with
        the gradient, and a test scalar q, which stands with the density.

    Attributes
    ----------
    gradient : (n, 3) array
        Nodal forces of this rank's cells at the last `assemble`, in DOLFINx's order.
    """

    def __init__(self, V: fem.FunctionSpace, form: Callable[[Any, Any], Any]) -> None:
        space = fem.functionspace(V.mesh, ("Lagrange", 1, (4,)))
        # Rows are read as V's: DOLFINx numbers vertices alike whatever they carry.
        assert np.array_equal(space.dofmap.list, V.dofmap.list)
        test = ufl.TestFunction(space)
        self._form = fem.form(form(ufl.as_vector([test[0], test[1], test[2]]), test[3]))
        dofs = V.dofmap.index_map
        self._entries = np.zeros((dofs.size_local + dofs.num_ghosts, 4))
        self.gradient: Array = self._entries[:, :3]

    def assemble(self) -> float:
        """This rank's part of the integral, at the current values of the form's functions."""
        self._entries[:] = 0.0
        fem.assemble_vector(self._entries.reshape(-1), self._form)
        return float(self._entries[:, 3].sum())
