"""Forms that are compiled once in a process, whatever the meshes.

DOLFINx finds a form's code by its signature: to write the expression down in UFL and to sign it
takes longer than a load step on a coarse mesh. A form whose expression follows from a few words is
known by these instead.
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
class CompiledCode:
    """The code of forms of one key."""

    form: Any  # DOLFINx's `CompiledForm`
    functions: dict[ufl.Coefficient, int]  # those of the inputs, in the order of the code
    constants: dict[ufl.Constant, int]
    parts: tuple[int, ...]  # tags of the cells that it integrates over; none for all

    @classmethod
    def of(cls, comm: MPI.Intracomm, form: ufl.Form, inputs: FormInputs) -> CompiledCode:
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


COMPILED: dict[Hashable, CompiledCode] = {}


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
        code = COMPILED[key] = CompiledCode.of(comm, write(), inputs)
    assert code is not None
    return code.bound(spaces, inputs, cell_tags)
