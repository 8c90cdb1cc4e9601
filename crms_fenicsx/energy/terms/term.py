"""The protocol of a term of the potential energy, and checks of user-defined terms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.energy.terms.integral import FusedAssembly, Integral
from crms_fenicsx.energy.terms.kinematics import Stiffening
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, BlockSink
from crms_fenicsx.foundation.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together


@dataclass(frozen=True)
class ElementwiseTerms:
    """Creates element-wise terms in place of a term that is assembled by DOLFINx."""

    # elements_on, of_elements: as the term's methods
    elements_on: Callable[[Booleans], ElementTable | None]
    of_elements: Callable[[Any], EnergyTerm]


class EnergyTerm(ABC):
    """A term of the total potential energy; `Scene.add_term` adds one of your own.

    An evaluation has two halves around one reduction over the ranks. First each term writes this
    rank's share of its scalar sums (`sums`), then it computes energy and gradient from the global
    sums (`energy`, `add_gradient`); `sums` keeps what both halves need. Only `sums` and
    `add_gradient` are compulsory.

    Arrays `x` and `g` are (n_local, 3): displacements (length) and forces (force) of the local
    blocks of a layout, ghosts included. A term of mesh vertices needs from its `Unknowns`

    ``n_vertices``
        Number of vertices owned by this rank. Their blocks are their degrees of freedom in
        DOLFINx's order, 0 ... n_vertices - 1, as `Scene.vertices` returns them; higher numbers are
        not vertices.
    ``vertex_blocks()``
        Blocks of all local vertices, ghosts included, by degree of freedom.
    ``X``
        Positions of all blocks at zero displacement, (n_local, 3) (length).

    Each rank adds its own share, to ghosts as well; each contribution is added by one rank only.
    Methods must not communicate (except `sums` of terms without elements, which all ranks call
    together). `sums`, `energy` and `add_gradient` are called in each iteration: they should neither
    allocate memory nor loop over elements in Python.

    Attributes
    ----------
    name
        Name of its energy in ``scene.energies`` and in tables.
    n_sums
        Number of scalar sums.
    integral
        An `Integral` over the membrane. Its value and gradient are updated before `sums`, in one
        pass over the mesh with all others.
    stiffening
        Artificial stiffness beyond its energy, set by the minimiser.
    of_cables
        Whether it exists only because of cables and vanishes without them.
    has_history
        Whether `begin_step` and `commit` have an effect. Each solve then starts at the beginning of
        the load step. Checkpoints do not save the history of a user-defined term, and refuse it.
    exact_hessian
        Whether `add_hessian` and the dyads are the complete second derivatives of its energy, and
        its forces are the energy's gradient; `Solver.tangent` names the terms for which this is
        False.
    links : (n, 2)
        Pairs of blocks that it couples most; linked ones are relaxed together.
    section_forces : (n, 3, 3)
        Second Piola-Kirchhoff section forces of this rank's cells in addition to the materials',
        tensors in space (force per length), which results include; None without any.
    patterns
        Block positions of its stiffness, see `foundation.dofs.block_patterns`; from `attach` on.
    elementwise
        Provides `elements_on` and `of_elements` by loops over few cells, for terms assembled by
        DOLFINx forms; None if there is none.
    unknowns
        The layout, from `attach` on.

    Examples
    --------
    Linear springs from all vertices of this rank to the ground:

    >>> class Springs(EnergyTerm):
    ...     name = "springs"
    ...
    ...     def __init__(self, stiffness):
    ...         self.k = stiffness
    ...
    ...     def sums(self, x, out):
    ...         own = x[: self.unknowns.n_vertices]
    ...         out[0] = self.k / 2 * np.vdot(own, own)
    ...
    ...     def add_gradient(self, x, sums, g):
    ...         n = self.unknowns.n_vertices
    ...         g[:n] += self.k * x[:n]
    >>> scene.add_term(Springs(0.1))
    """

    name: str
    n_sums: int = 1
    integral: Integral | None = None
    stiffening: Stiffening | None = None
    of_cables: bool = False
    has_history: bool = False
    exact_hessian: bool = False
    links: Indices | None = None
    section_forces: Array | None = None
    patterns: Sequence[BlockPattern] = ()
    elementwise: ElementwiseTerms | None = None
    unknowns: Unknowns

    @property
    def present_forces(self) -> Array | None:
        """The section forces where stress-free places have moved with lines that slide."""
        return self.section_forces

    def attach(self, unknowns: Unknowns) -> None:
        """Use this layout; called for each new layout of the scene, as cables come or slacken, or
        as stress-free places move."""
        self.unknowns = unknowns

    @abstractmethod
    def sums(self, x: Array, out: Array) -> None:
        """Write this rank's share of the scalar sums to `out`, (n_sums,)."""

    def energy(self, sums: Array) -> float:
        """Energy (force x length) from the global sums, (n_sums,); by default the first."""
        return float(sums[0])

    @abstractmethod
    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add this rank's share of the gradient to `g`; `x` is that of the last `sums`."""

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add a positive semidefinite stiffness (force/length) to the matrix of H0.

        It affects the speed, not the solution; without it the minimiser learns of the term only
        from gradients. The matrix takes (3, 3) blocks of `patterns` only, and is symmetric: of two
        mirrored blocks it takes the one above the diagonal.
        """

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the energy's second derivatives (force/length), without the dyads, to the matrix.

        They may be indefinite. By default they are the stiffness.
        """
        self.add_stiffness(x, sums, A)

    def dyads(self, sums: Array, exact: bool) -> Sequence[float] | Array:
        """Values (force/length) of the stiffness ``value * column column^T`` that couples many
        points, to be added to `add_hessian` if `exact`, else to `add_stiffness`.

        Values that are not positive are skipped.
        """
        return ()

    def add_dyad_column(self, k: int, x: Array, g: Array) -> None:
        """Add this rank's share of column k to `g`."""
        raise NotImplementedError(f"{type(self).__name__} has dyads, but no columns")

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the rounding errors of forces that cancel at this rank's points."""
        return 0.0

    def elements_on(self, chosen: Booleans) -> ElementTable | None:
        """Return this rank's elements that depend on chosen blocks.

        Any rank can make a term of them by `of_elements`, in which these blocks move and others are
        fixed. By default those of `elementwise`. With None, this term's forces are held, which is
        exact for energies linear in these blocks.

        Parameters
        ----------
        chosen : (n_local,)
            Whether a block moves, ghosts included. The state is that of the last `sums`.
        """
        return None if self.elementwise is None else self.elementwise.elements_on(chosen)

    def of_elements(self, table: Any, sums: Array) -> EnergyTerm:
        """Make a term of elements from this term on some rank, joined or renumbered.

        Parameters
        ----------
        table
            The elements.
        sums
            The global sums; the state is that of the last `sums`.
        """
        assert self.elementwise is not None, f"{type(self).__name__} is not made of elements"
        return self.elementwise.of_elements(table)

    def begin_step(self, x: Array) -> None:
        """Mark the current state as the start of a load step."""

    def commit(self, x: Array, sums: Array) -> None:
        """Mark the current state as the end of an accepted load step."""


class ElementTerm(EnergyTerm):
    """A term that is the sum of the energies of the elements in a `table`."""

    def __init__(self, table: Any) -> None:
        self.table = table

    def elements_on(self, chosen: Booleans) -> ElementTable | None:
        rows = self.table.rows_on(chosen)
        return self.table.some(rows) if len(rows) else None

    def of_elements(self, table: Any, sums: Array) -> EnergyTerm:
        return type(self)(table)


NAMES = frozenset(
    (
        *("bars", "cables", "dead load", "friction", "held lines", "membrane", "penalty", "pond"),
        *("pressure", "side contact", "wind"),
    )
)
"""Names of the package's own terms, whether a scene has them or not."""


def checked_energy(
    term: object, u: fem.Function, cell_tags: Any, taken: Collection[str]
) -> tuple[EnergyTerm, float]:
    """Check a term and evaluate it once; return it and its energy (force x length). Collective."""
    if not isinstance(term, EnergyTerm):
        raise InputError(
            f"add_term: {term!r} is not an EnergyTerm; derive its class from "
            "crms_fenicsx.EnergyTerm."
        )
    name, owner = getattr(term, "name", None), type(term).__name__
    if not isinstance(name, str) or not name or name != name.strip():
        raise InputError(
            f"add_term: the name of {owner} is {name!r}; tables need text without blanks around "
            'it, as in name = "springs".'
        )
    if name in NAMES:
        raise InputError(
            f"add_term: {name!r} is the name of a term of the package, whose energy the scene's "
            f"energies list under it; rename {owner}."
        )
    if name in taken:
        raise InputError(f"add_term: there is a term {name!r} already; rename {owner}.")
    checks.whole(f"add_term: n_sums of {name!r}", term.n_sums, 1)
    _check_integral(name, term.integral, u.function_space, cell_tags)
    return term, _evaluated(term, u)


def _check_integral(name: str, integral: object, V: fem.FunctionSpace, cell_tags: Any) -> None:
    if integral is None:
        return
    if not isinstance(integral, Integral) or integral.V.mesh is not V.mesh:
        raise InputError(
            f"add_term: the integral of {name!r} is not an Integral over this scene's membrane; "
            "make it with scene.V."
        )
    if integral.cell_tags is not None and integral.cell_tags is not cell_tags:
        raise InputError(
            f"add_term: the integral of {name!r} has cell tags of its own; all integrals share one "
            "pass over the mesh, with the cells of the scene's materials; use a factor by cell, "
            "such as a DG 0 function, instead of measures of parts."
        )


def _evaluated(term: EnergyTerm, u: fem.Function) -> float:
    """Energy of the term at the current displacements."""
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
