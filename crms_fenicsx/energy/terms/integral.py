"""Integrals over the cells and their gradients, assembled in one pass over the mesh.

Value and gradient, and the integrals of several terms, need the same geometry and displacement of a
cell, and DOLFINx's access to a cell costs as much as any of them. So one form assembles them all;
its test function has four components for each integral:

    (v, q)  ->  gradient along v  +  integral of density * q.

As the shape functions sum to one everywhere, the vertices' entries of q sum to the integral.

DOLFINx finds a form's code by its signature: to write the expression down in UFL and to sign it
takes longer than a load step on a coarse mesh. A form whose expression follows from a few words is
therefore compiled once in a process, whatever the meshes, and known by these words.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.arrays import Array

DOMAIN = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(3,)))
SCALARS = ufl.FunctionSpace(DOMAIN, basix.ufl.element("DG", "triangle", 0))
ALL = 0
"""Tag of all cells in forms on meshes without tags, which leave out cells."""


@dataclass(frozen=True)
class FormInputs:
    """What a form takes from its mesh; forms of equal keys have the same expression of them."""

    key: Hashable
    functions: tuple[fem.Function, ...]
    constants: tuple[fem.Constant, ...]
    # values of cells; those where all are zero contribute nothing and are left out
    factors: tuple[fem.Function, ...] = ()

    @property
    def mesh(self) -> Any:
        """The mesh."""
        return self.functions[0].function_space.mesh

    @classmethod
    def joint(cls, parts: Sequence[FormInputs]) -> FormInputs:
        """Those of a sum of forms."""
        limited = all(part.factors for part in parts)
        return cls(
            tuple(part.key for part in parts),
            tuple(function for part in parts for function in part.functions),
            tuple(constant for part in parts for constant in part.constants),
            tuple(factor for part in parts for factor in part.factors if limited),
        )


@dataclass(frozen=True)
class _CompiledCode:
    """The code of forms of one key."""

    form: Any  # DOLFINx's `CompiledForm`
    functions: dict[ufl.Coefficient, int]  # those of the inputs, in the order of the code
    constants: dict[ufl.Constant, int]
    parts: tuple[int, ...]  # tags of the cells that it integrates over; none for all

    @classmethod
    def of(cls, comm: MPI.Intracomm, form: ufl.Form, inputs: FormInputs) -> _CompiledCode:
        """Compile a form. Collective."""
        compiled = fem.compile_form(comm, form)
        functions, constants = list(map(id, inputs.functions)), list(map(id, inputs.constants))
        # Stand-ins, as DOLFINx looks for functions in the expression: they keep no mesh alive.
        coefficients = {
            ufl.Coefficient(SCALARS): functions.index(id(one)) for one in form.coefficients()
        }
        numbers = {ufl.Constant(DOMAIN): constants.index(id(one)) for one in form.constants()}
        code = compiled.ufcx_form
        assert code.num_coefficients == len(coefficients)
        ids = {code.form_integral_ids[i] for i in range(code.form_integral_offsets[1])} - {-1}
        compiled.ufl_form = ufl.classes.ExprList(*coefficients, *numbers)
        return cls(compiled, coefficients, numbers, tuple(sorted(ids)))

    def bound(
        self, spaces: Sequence[fem.FunctionSpace], inputs: FormInputs, cell_tags: Any
    ) -> fem.Form:
        """The form on a mesh, over the cells that count now."""
        mesh = inputs.mesh
        owned = mesh.topology.index_map(2).size_local
        counts = [one.x.array[:owned] != 0.0 for one in inputs.factors] or [np.ones(owned, bool)]
        cells = np.flatnonzero(np.any(counts, axis=0)).astype(np.int32)
        own = [
            (tag, cells if cell_tags is None else np.intersect1d(cells, cell_tags.find(tag)))
            for tag in self.parts
        ]
        functions = {one: inputs.functions[k] for one, k in self.functions.items()}
        constants = {one: inputs.constants[k] for one, k in self.constants.items()}
        domains = {fem.IntegralType.cell: own} if own else {}
        return fem.create_form(self.form, list(spaces), mesh, domains, functions, constants)


COMPILED: dict[Hashable, _CompiledCode] = {}


def compiled_form(
    inputs: FormInputs | None,
    spaces: Sequence[fem.FunctionSpace],
    write: Callable[[], ufl.Form],
    cell_tags: Any = None,
) -> fem.Form:
    """The form that `write` returns; None as inputs compiles it by its signature. Collective.

    `spaces` are those of its arguments.
    """
    if inputs is None:
        return fem.form(write())
    comm = inputs.mesh.comm
    functions, constants = list(map(id, inputs.functions)), list(map(id, inputs.constants))
    # Inputs that are one object are one in the code, too.
    same = (*map(functions.index, functions), *map(constants.index, constants))
    key = (inputs.key, same)
    code = COMPILED.get(key)
    if not comm.allreduce(code is not None, op=MPI.LAND):
        code = COMPILED[key] = _CompiledCode.of(comm, write(), inputs)
    assert code is not None
    return code.bound(spaces, inputs, cell_tags)


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
