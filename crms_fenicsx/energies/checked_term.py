"""Checks of a term that a user adds to a scene."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.integral import FusedAssembly, Integral
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, raised_together

NAMES = ("membrane", "pressure", "dead load", "penalty", "cables", "friction")
"""Names of the package's own terms."""


def checked_energy(
    term: object, u: fem.Function, cell_tags: Any, taken: Collection[str]
) -> tuple[EnergyTerm, float]:
    """Check a term, and evaluate it once. Collective.

    Returns the term, and its energy (force x length).
    """
    if not isinstance(term, EnergyTerm):
        raise InputError(
            f"add_term: {term!r} is no EnergyTerm; derive its class from crms_fenicsx.EnergyTerm."
        )
    name, owner = getattr(term, "name", None), type(term).__name__
    if not isinstance(name, str) or not name or name != name.strip():
        raise InputError(
            f"add_term: the name of {owner} is {name!r}; tables need text without blanks around "
            'it, as in name = "springs".'
        )
    if name in NAMES or name in taken:
        raise InputError(f"add_term: there is a term {name!r} already; give {owner} another name.")
    checks.whole(f"add_term: n_sums of {name!r}", term.n_sums, 1)
    _check_integral(name, term.integral, u.function_space, cell_tags)
    return term, _evaluated(term, u)


def _check_integral(name: str, integral: object, V: fem.FunctionSpace, cell_tags: Any) -> None:
    if integral is None:
        return
    if not isinstance(integral, Integral) or integral.V.mesh is not V.mesh:
        raise InputError(
            f"add_term: the integral of {name!r} is no Integral over this scene's membrane; make "
            "it with scene.V."
        )
    if integral.cell_tags is not None and integral.cell_tags is not cell_tags:
        raise InputError(
            f"add_term: the integral of {name!r} has cell tags of its own; all share one pass over "
            "the mesh, so give it scene.cell_tags."
        )


def _evaluated(term: EnergyTerm, u: fem.Function) -> float:
    """Energy at the current displacements."""
    unknowns = Unknowns(u.function_space)
    comm, vector = unknowns.comm, np.zeros((unknowns.n_local, 3))
    vector[unknowns.vertex_blocks()] = u.x.array.reshape(-1, 3)
    x, g, own = vector.copy(), np.zeros_like(vector), np.full(term.n_sums, np.nan)
    if term.integral is not None:
        FusedAssembly.of([term.integral]).assemble()
    with raised_together(comm):
        term.attach(unknowns)
        term.sums(x, own)
        _check_values(term, "sums", own, x, vector)
    sums = np.zeros_like(own)
    comm.Allreduce(own, sums, op=MPI.SUM)
    energy = 0.0
    with raised_together(comm):
        energy = checks.finite(f"add_term: the energy of {term.name!r}", term.energy(sums))
        term.add_gradient(x, sums, g)
        _check_values(term, "add_gradient", g, x, vector)
    checks.same(comm, "add_term", **{f"energy of {term.name}": energy})
    return energy


def _check_values(term: EnergyTerm, method: str, values: Array, x: Array, before: Array) -> None:
    what = f"add_term: {method} of {term.name!r}"
    if not np.all(np.isfinite(values)):
        raise InputError(
            f"{what} leaves numbers that are not finite at the current state; it must write all "
            "its sums, and add finite forces."
        )
    if not np.array_equal(x, before):
        raise InputError(f"{what} changes the displacements x; it may only read them.")
