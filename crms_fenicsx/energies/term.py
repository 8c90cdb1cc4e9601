"""The protocol of a term of the potential energy, and the checks of a term that a user adds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from crms_fenicsx.dofs.block_patterns import BlockPattern, BlockSink, ColumnPattern
from crms_fenicsx.dofs.layout import ElementTable, Unknowns
from crms_fenicsx.energies.integral import FusedAssembly, Integral
from crms_fenicsx.energies.kinematics import Stiffening
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.runtime.errors import InputError, raised_together


@dataclass(frozen=True)
class CompiledCells:
    """What makes terms of few elements in the place of a term without any."""

    # elements_on, of_elements: as the term's methods
    elements_on: Callable[[Booleans], ElementTable | None]
    of_elements: Callable[[Any], EnergyTerm]


class EnergyTerm(ABC):
    """A term of the total potential energy; `Scene.add_term` adds one of your own.

    An evaluation has two halves around one reduction over the ranks. First each term writes this
    rank's share of its scalar sums (`sums`), then it computes energy and gradient from the global
    sums (`energy`, `add_gradient`). What both halves need is computed in `sums`, and kept. Of a
    term only `sums` and `add_gradient` are compulsory.

    Arrays `x` and `g` are (n_local, 3): displacements (length) and forces (force) of the local
    blocks of a layout, ghosts included. Of its `Unknowns` a term of mesh vertices needs

    ``n_vertices``
        Vertices that this rank owns. Their blocks are their degrees of freedom in DOLFINx's order,
        0 ... n_vertices - 1, as `Scene.vertices` returns them; higher numbers are not vertices.
    ``vertex_blocks()``
        Blocks of all local vertices, ghosts too, by degree of freedom.
    ``X``
        Positions of all blocks at zero displacement, (n_local, 3) (length).

    Each rank adds its own share, to ghosts as well, and each share is added by one rank only.
    Nothing here may communicate (but `sums` of terms that are not made of elements, which all ranks
    call together), and `sums`, `energy` and `add_gradient` are called in each
    iteration: they should allocate nothing and have no loop over elements in Python.

    Attributes
    ----------
    name
        Name of its energy in ``scene.energies`` and in tables.
    n_sums
        Number of scalar sums.
    integral
        An `Integral` over the membrane, whose value and gradient are brought up to date before
        `sums`, in one pass over the mesh with all others.
    stiffening
        What its stiffness has that its energy has not, set by the minimiser.
    of_cables
        Whether it is there because of cables, and nothing of it would be without them.
    has_history
        Whether `begin_step` and `commit` do anything. Each solve then begins where the load step
        began. Checkpoints do not keep the history of a term of your own, and refuse it.
    exact_hessian
        Whether `add_hessian` and the dyads are all of its energy's second derivatives, and its
        forces nothing but the energy's slope; `Solver.tangent` names the terms of which it is not.
    links : (n, 2)
        Pairs of cable points that it couples most; points are relaxed together with those that
        they are linked to.
    section_forces : (n, 3, 3)
        Second Piola-Kirchhoff section forces that it puts in this rank's cells beside those of the
        materials, tensors in space (force per length): results add them. None without any.
    patterns
        Where its stiffness has blocks, see `crms_fenicsx.dofs.block_patterns`; from `attach` on.
    active : (n,)
        Elements of which stiffness is wanted, where a term can leave out others; they have blocks
        of no use then.
    columns
        Where the columns of the dyads of a term that was `split` have entries; None without dyads.
    twin
        Does what `elements_on` and `of_elements` do in loops over few cells, which DOLFINx's forms
        have not; None if nothing does.
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
    columns: ColumnPattern | None = None
    active: Booleans | None = None
    twin: CompiledCells | None = None
    unknowns: Unknowns

    def attach(self, unknowns: Unknowns) -> None:
        """Use this layout; called whenever the scene gets a new one, as cables come or slacken."""
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

        It sets the speed and not the solution; without it the minimiser learns of the term from
        gradients. The matrix takes blocks of three, of `patterns` alone.
        """

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the energy's second derivatives (force/length), but for the dyads, to the matrix.

        They need not be definite. By default they are the stiffness.
        """
        self.add_stiffness(x, sums, A)

    def add_stiffness_without_cables(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add what the stiffness would be without cables to a matrix of the vertices alone.

        Multigrid is made of it. By default it is that of `add_stiffness`, of which such a matrix
        drops the entries of cables' points, and nothing of terms of cables.
        """
        if not self.of_cables:
            self.add_stiffness(x, sums, A)

    def dyads(self, sums: Array) -> Sequence[float] | Array:
        """Values (force/length) of stiffness ``value * column column^T`` that couples many points.

        Those that are not positive are skipped.
        """
        return ()

    def add_dyad_column(self, k: int, x: Array, g: Array) -> None:
        """Add this rank's share of column k to `g`."""
        raise NotImplementedError(f"{type(self).__name__} has dyads, but no columns")

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of what rounding leaves of forces that cancel at this rank's points."""
        return 0.0

    def elements_on(self, chosen: Booleans) -> ElementTable | None:
        """Return this rank's elements that depend on some blocks.

        Any rank can make a term of them by `of_elements`, in which other blocks are held while
        these move. By default they are those of `twin`. Where there are none this term's forces are
        held, which is exact for energies that are linear in these blocks.

        Parameters
        ----------
        chosen : (n_local,)
            Whether a block moves, ghosts included. The state is that of the last `sums`.
        """
        return None if self.twin is None else self.twin.elements_on(chosen)

    def of_elements(self, table: Any, sums: Array) -> EnergyTerm:
        """Make a term of elements that this term of some rank has given, joined or renumbered.

        Parameters
        ----------
        table
            The elements.
        sums
            The global sums; the state is that of the last `sums`.
        """
        assert self.twin is not None, f"{type(self).__name__} is not made of elements"
        return self.twin.of_elements(table)

    def dyad_columns(self, x: Array, sums: Array) -> None:
        """Put the dyads of a term that was `split` into its `columns`."""

    def element_energies(self, sums: Array) -> Array:
        """Energies of a term's elements at the last `sums`, (n,) (force x length)."""
        raise NotImplementedError(f"{type(self).__name__} is not made of elements")

    def split(self, groups: Integers, comm: MPI.Intracomm) -> EnergyTerm:
        """Return a term `of_elements` that is separate for groups of blocks. Collective.

        Parameters
        ----------
        groups : (n_local,)
            Number of the group that a block moves with, or -1. No element joins two of them.
        comm
            Processes, each with groups of its own.
        """
        return self

    def begin_step(self, x: Array) -> None:
        """Take the current state as a load step's start."""

    def commit(self, x: Array, sums: Array) -> None:
        """Take the current state as an accepted load step's end."""


NAMES = ("membrane", "pressure", "dead load", "penalty", "cables", "friction")
"""Names of the package's own terms."""


def checked_energy(
    term: object, u: fem.Function, cell_tags: Any, taken: Collection[str]
) -> tuple[EnergyTerm, float]:
    """Check a term, and evaluate it once. Collective. Returns the term, and its energy
    (force x length)."""
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
