"""Integrals over the cells and their gradients, assembled in one pass over the mesh.

Value and gradient, and the integrals of several terms, need the same geometry and displacement of a
cell, and DOLFINx's access to a cell costs as much as any of them. So one form assembles them all;
its test function has four components for each integral:

    (v, q)  ->  gradient along v  +  integral of density * q.

As the shape functions sum to one everywhere, the vertices' entries of q sum to the integral.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from crms_fenicsx.energy.terms.compiled_forms import ALL, FormInputs, compiled_form
from crms_fenicsx.foundation.runtime.arrays import Array


def one_point(mesh: Any, **options: Any) -> ufl.Measure:
    """Measure of the stress-free surface; one point is exact, as strains are constant in a cell."""
    return ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": 0}, **options)


def counting_cells(mesh: Any, inputs: FormInputs | None, cell_tags: Any) -> ufl.Measure:
    """The same for a form that leaves out cells without `factors`."""
    everywhere = inputs is None or not inputs.factors or cell_tags is not None
    dx = one_point(mesh, subdomain_data=cell_tags)
    return dx if everywhere else dx(ALL)


class Integral:
    """A functional of the vertex displacements with its gradient, assembled by `FusedAssembly`.

    Attributes: `value`: this rank's part of the integral in the last pass; `gradient` (n, 3): the
    part of its gradient from this rank's cells, in DOLFINx's order. Shapes: form (3,).
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        form: Callable[[Any, Any, ufl.Measure], Any],
        prepare: Callable[[], None] | None = None,
        cell_tags: Any = None,
        inputs: FormInputs | None = None,
    ) -> None:
        self.V, self.form, self.prepare, self.cell_tags = V, form, prepare, cell_tags
        self.inputs = inputs
        self.value = 0.0
        self.gradient: Array = np.zeros((0, 3))
        self.passes: dict[tuple[Integral, ...], FusedAssembly] = {}
        """Passes that start with this integral, by all the integrals they assemble."""


class FusedAssembly:
    """Assembles several integrals with one form."""

    def __init__(self, integrals: Sequence[Integral]) -> None:
        self.integrals = integrals
        V, size = integrals[0].V, 4 * len(integrals)
        space = fem.functionspace(V.mesh, ("Lagrange", 1, (size,)))
        # Rows are read as V's: DOLFINx's numbering does not depend on the number of components.
        assert np.array_equal(space.dofmap.list, V.dofmap.list)
        dofs = space.dofmap.index_map
        self._entries: Array = np.zeros((dofs.size_local + dofs.num_ghosts, size))
        tags = next((i.cell_tags for i in integrals if i.cell_tags is not None), None)

        def write() -> ufl.Form:
            test, form = ufl.TestFunction(space), 0
            dx = counting_cells(V.mesh, inputs, tags)  # a form has one measure, tags or none
            for k, integral in enumerate(integrals):
                v = ufl.as_vector([test[4 * k + i] for i in range(3)])
                form += integral.form(v, test[4 * k + 3], dx)
            return form

        known = [integral.inputs for integral in integrals if integral.inputs is not None]
        inputs = FormInputs.joint(known) if len(known) == len(integrals) else None
        self._bind = lambda: compiled_form(inputs, [space], write, tags)
        self._form: fem.Form = self._bind()
        self._lasting = inputs is None or not inputs.factors

    @classmethod
    def of(cls, integrals: Sequence[Integral]) -> FusedAssembly:
        """Return the pass over these integrals and the cells that count now; compiled once."""
        passes, key = integrals[0].passes, tuple(integrals)
        if key not in passes:
            passes[key] = cls(integrals)
        elif not passes[key]._lasting:
            passes[key]._form = passes[key]._bind()
        return passes[key]

    def assemble(self) -> None:
        """Update value and gradient of all integrals at the current state of their functions."""
        for integral in self.integrals:
            if integral.prepare is not None:
                integral.prepare()
        self._entries[:] = 0.0
        fem.assemble_vector(self._entries.reshape(-1), self._form)
        for k, integral in enumerate(self.integrals):
            integral.gradient = self._entries[:, 4 * k : 4 * k + 3]
            integral.value = float(self._entries[:, 4 * k + 3].sum())
