"""The protocol of a term of the total potential energy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from petsc4py import PETSc

from crms_fenicsx.dofs.block_patterns import BlockSink
from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.dofs.preallocation import RowSizes
from crms_fenicsx.energies.integral import Integral
from crms_fenicsx.energies.stiffening import Stiffening
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers


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
    Nothing here may communicate, and `sums`, `energy` and `add_gradient` are called in each
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
    links : (n, 2)
        Pairs of cable points that it couples most; points are relaxed together with those that
        they are linked to.
    twin
        Makes the part of the term that depends on some blocks (n_local,) in loops over few cells,
        which DOLFINx's forms have not; None if nothing does.
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
    links: Indices | None = None
    twin: Callable[[Booleans], EnergyTerm | None] | None = None
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

    def count_stiffness(self, sizes: RowSizes) -> None:
        """Count the blocks that `add_stiffness` fills, those off the diagonal at least."""

    def add_stiffness(self, x: Array, sums: Array, A: PETSc.Mat) -> None:
        """Add a positive semidefinite stiffness (force/length) to the matrix of H0.

        It sets the speed and not the solution; without it the minimiser learns of the term from
        gradients. `crms_fenicsx.dofs.block_patterns` adds blocks of three, and counts them.
        """

    def add_hessian(self, x: Array, sums: Array, A: PETSc.Mat) -> None:
        """Add the energy's second derivatives (force/length), but for the dyads, to the matrix.

        They need not be definite, and go where `add_stiffness` has put something, if only zeros, in
        its first call. By default they are the stiffness.
        """
        self.add_stiffness(x, sums, A)

    def add_stiffness_without_cables(self, x: Array, sums: Array, A: PETSc.Mat) -> None:
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

    def restricted(self, chosen: Booleans, sums: Array) -> EnergyTerm | None:
        """Return the part that depends on some blocks, as a term of its own of the same blocks.

        Its other blocks are held while these move. By default it is what `twin` makes. Where there
        is none this term's forces are held, which is exact for energies that are linear in these
        blocks.

        Parameters
        ----------
        chosen : (n_local,)
            Whether a block moves. All its elements are of this rank.
        sums
            The global sums; the state is that of the last `sums`.
        """
        return None if self.twin is None else self.twin(chosen)

    def add_dyads(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the dyads of a `restricted` term block by block."""

    def element_blocks(self) -> tuple[Indices, Indices]:
        """Blocks of the elements of a `restricted` term in CSR form, (n + 1,) and (m,)."""
        raise NotImplementedError(f"{type(self).__name__} is not made of elements")

    def element_energies(self, sums: Array) -> Array:
        """Energies of these elements at the last `sums`, (n,) (force x length)."""
        raise NotImplementedError(f"{type(self).__name__} is not made of elements")

    def split(self, groups: Integers) -> EnergyTerm:
        """Return a `restricted` term that is separate for groups of blocks.

        Parameters
        ----------
        groups : (n_local,)
            Number of the group that a block moves with, or -1. No element joins two of them.
        """
        return self

    def begin_step(self, x: Array) -> None:
        """Take the current state as a load step's start."""

    def commit(self, x: Array, sums: Array) -> None:
        """Take the current state as an accepted load step's end."""
