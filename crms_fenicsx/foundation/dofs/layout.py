"""Layout of the unknowns: displacements of mesh vertices, cable points and joints.

Unknowns are counted in *blocks* of three components. On each rank the local blocks are

    [ owned vertices | owned cable points | ghost vertices | ghost cable points | far vertices ]

and PETSc vectors own the first two groups. Cable points are fold points on edges, anchors and other
points of cables that are not mesh vertices. Terms of the potential see one local array (n, 3) of
displacements, ghosts included, and address its blocks.

Bars are few compared to vertices: rank 0 owns all joints, computes all bars and knows their
vertices. All ranks know all joints, so that cables can end at them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import ClassVar, Self

import numba
import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap


class ElementTable:
    """Base of the frozen dataclasses that hold a term's elements.

    Attributes: `addresses`: names of the fields that hold block numbers; `joins`: whether a term
    needs the tables of several processes as one.
    """

    addresses: ClassVar[tuple[str, ...]]
    joins: ClassVar[bool] = False

    @property
    def element_blocks(self) -> tuple[Indices, Indices]:
        """Blocks of each element in CSR form: pointers (n + 1,), blocks (m,). By default the rows
        of the first of `addresses`."""
        return rows_of(getattr(self, self.addresses[0]))

    def rows_on(self, chosen: Booleans) -> Integers:
        """Elements (m,) with at least one chosen block."""
        rows: Integers = rows_on(*self.element_blocks, chosen)
        return rows

    def renumbered(self, number: Indices) -> Self:
        """The same elements with renumbered blocks: block b becomes ``number[b]``."""
        return replace(self, **{name: number[getattr(self, name)] for name in self.addresses})  # type: ignore[type-var]

    def some(self, rows: Integers) -> Self:
        """Subset of the elements."""
        given = ((field.name, getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]
        some = {name: value[rows] for name, value in given if isinstance(value, np.ndarray)}
        return replace(self, **some)  # type: ignore[type-var]

    @classmethod
    def joined(cls, tables: Sequence[Self]) -> Sequence[Self]:
        """Merge the tables of several processes into as few as a term needs."""
        return [cls.concatenated(tables)] if cls.joins else tables

    @classmethod
    def concatenated(cls, tables: Sequence[Self]) -> Self:
        """All elements of several tables."""
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        return cls(*(np.concatenate([getattr(t, name) for t in tables]) for name in names))


def rows_of(table: Indices) -> tuple[Indices, Indices]:
    """Rows of a table (n, k) in CSR form: pointers, entries."""
    n, k = table.shape
    return np.arange(0, k * n + 1, k, dtype=np.int32), table.reshape(-1)


@numba.njit(cache=True)
def rows_on(pointers, blocks, chosen):  # type: ignore[no-untyped-def]
    """Elements (m,) in CSR form with at least one chosen block."""
    rows, m = np.empty(len(pointers) - 1, dtype=np.int64), 0
    for e in range(len(rows)):
        for q in range(pointers[e], pointers[e + 1]):
            if chosen[blocks[q]]:
                rows[m] = e
                m += 1
                break
    return rows[:m]


def vertex_places(V: fem.FunctionSpace) -> Array:
    """Stress-free positions (length) of the vertices by local degree of freedom, (n, 3), from the
    mesh geometry: those of DOLFINx's `tabulate_dof_coordinates` are mapped from the reference cell
    of some cell, so that their rounding depends on the mesh's distribution."""
    vertices = V.dofmap.index_map
    places = np.zeros((vertices.size_local + vertices.num_ghosts, 3))
    places[V.dofmap.list] = V.mesh.geometry.x[geometry_dofmap(V.mesh)]
    return places


def vertex_dofs(V: fem.FunctionSpace) -> Indices:
    """Local degree of freedom of each local vertex, (n,)."""
    dofs = np.zeros(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, dtype=np.int32)
    dofs[V.mesh.topology.connectivity(2, 0).array] = V.dofmap.list.ravel()
    return dofs


def edge_ends(V: fem.FunctionSpace) -> Indices:
    """Local degrees of freedom of the end vertices of all local edges, (n, 2)."""
    V.mesh.topology.create_connectivity(1, 0)
    return vertex_dofs(V)[V.mesh.topology.connectivity(1, 0).array.reshape(-1, 2)]


def vertex_starts(V: fem.FunctionSpace) -> Integers:
    """Global number of each rank's first vertex, (ranks,). Collective."""
    return np.array(V.mesh.comm.allgather(V.dofmap.index_map.local_range[0]))


EVENLY = "vec_mdot_use_gemv"
"""PETSc option, read when a vector is created: compute several dot products as a matrix product."""


class Unknowns(LocalBlocks):
    """Numbering, ghosted vectors and held components of the unknowns.

    Attributes: `X` (n, 3): positions at zero displacement: stress-free vertices, initial cable
    points (to be filled in by the caller that lays the cable); `starts` (ranks + 1,): global number
    of each rank's first block, and number of all blocks; `bounds`: bounds of the displacements, for
    one-sided obstacles; `shifts` (m,): local blocks that are not places of points but displacements
    of stress-free places, among cells of `shift_sizes` (m,). Shapes: ghost_points (n, 2),
    far_vertices (n, 2).
    """

    def __init__(
        self,
        V: fem.FunctionSpace,
        owned_points: int = 0,
        ghost_points: Sequence[tuple[int, int]] = (),
        far_vertices: Sequence[tuple[int, int]] = (),
    ) -> None:
        self.V = V
        self.comm = V.mesh.comm
        vertices = V.dofmap.index_map
        self.n_vertices = vertices.size_local
        self.n_points = owned_points
        self.n_owned = self.n_vertices + self.n_points
        self.n_ghost_vertices = vertices.num_ghosts
        self.n_ghost_points = len(ghost_points)
        self.n_local = (
            self.n_owned + self.n_ghost_vertices + self.n_ghost_points + len(far_vertices)
        )

        # Combined global numbering: rank by rank, vertices first.
        first_vertices = vertex_starts(V)
        sizes = np.array(self.comm.allgather((self.n_vertices, self.n_points)))
        starts = np.concatenate([[0], np.cumsum(sizes.sum(axis=1))])
        owners = vertices.owners
        ghosts = np.empty(self.n_local - self.n_owned, dtype=PETSc.IntType)
        ghosts[: self.n_ghost_vertices] = vertices.ghosts - first_vertices[owners] + starts[owners]
        for k, (owner, index) in enumerate(ghost_points):
            ghosts[self.n_ghost_vertices + k] = starts[owner] + sizes[owner, 0] + index
        for k, (owner, dof) in enumerate(far_vertices, start=len(ghosts) - len(far_vertices)):
            ghosts[k] = starts[owner] + dof
        self.ghosts, self.starts = ghosts, starts
        self.start = int(starts[self.comm.rank])
        self.n_global = int(starts[-1])

        X = np.zeros((self.n_local, 3))
        X[self.vertex_blocks()] = vertex_places(V)
        super().__init__(X)
        self.bounds: tuple[Array, Array] | None = None
        self.shifts: Indices = np.zeros(0, dtype=np.int32)
        self.shift_sizes: Array = np.zeros(0)
        self.n_shifts = 0  # on all ranks

    def vertex_blocks(self) -> Indices:
        """Local blocks of the vertices in DOLFINx's local order (owned, then ghosts)."""
        ghosts = self.n_owned + np.arange(self.n_ghost_vertices)
        return np.concatenate([np.arange(self.n_vertices), ghosts]).astype(np.int32)

    def read_vertices(self, x: Array, out: Array) -> None:
        """Copy the vertices' rows of x to `out`, in DOLFINx's order; allocates nothing."""
        n, end = self.n_vertices, self.n_owned + self.n_ghost_vertices
        out[:n] = x[:n]
        out[n:] = x[self.n_owned : end]

    def add_to_vertices(self, values: Array, g: Array) -> None:
        """Add values in DOLFINx's order to the vertices' rows of g; allocates nothing."""
        n, end = self.n_vertices, self.n_owned + self.n_ghost_vertices
        for i in range(3):  # numpy takes twice as long for whole rows of three
            g[:n, i] += values[:n, i]
            g[self.n_owned : end, i] += values[n:, i]

    def owned_point_blocks(self) -> Indices:
        """Local blocks of the cable points owned by this rank."""
        return np.arange(self.n_vertices, self.n_owned, dtype=np.int32)

    def ghost_point_blocks(self) -> Indices:
        """Local blocks of other ranks' cable points."""
        first = self.n_owned + self.n_ghost_vertices
        return np.arange(first, first + self.n_ghost_points, dtype=np.int32)

    def far_vertex_blocks(self) -> Indices:
        """Local blocks of the vertices at the far ends of spans."""
        first = self.n_owned + self.n_ghost_vertices + self.n_ghost_points
        return np.arange(first, self.n_local, dtype=np.int32)

    def vector(self) -> tuple[PETSc.Vec, Array]:
        """A ghosted vector and its local array (n, 3), ghosts included, which share memory. PETSc's
        default multiple dot product is switched off: its rounding depends on the spacing of the
        vectors in memory, so that runs would not be reproducible."""
        options = PETSc.Options()
        if not options.hasName(EVENLY):
            options[EVENLY] = False
        array = np.zeros((self.n_local, 3))
        vector = PETSc.Vec().createGhostWithArray(
            self.ghosts, array.reshape(-1), size=(3 * self.n_owned, 3 * self.n_global), bsize=3,
            comm=self.comm,
        )  # fmt: skip
        return vector, array

    def numbers(self) -> Integers:
        """Global numbers of the local blocks, (n_local,)."""
        owned = np.arange(self.start, self.start + self.n_owned, dtype=PETSc.IntType)
        return np.concatenate([owned, self.ghosts])

    def largest_shift(self, x: Array) -> float:
        """Largest shift of a stress-free place, relative to the cell size, at owned displacements x
        (n, 3). Collective."""
        own = self.shifts < self.n_owned
        ways = x[self.shifts[own]]
        squares = np.einsum("ni,ni->n", ways, ways) / self.shift_sizes[own] ** 2
        largest = float(squares.max(initial=0.0))
        return float(self.comm.allreduce(largest, op=MPI.MAX) ** 0.5)

    def update_ghosts(self, vector: PETSc.Vec) -> None:
        """Copy owned values to the ghosts on other ranks."""
        if self.comm.size > 1:
            vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)

    def add_ghosts(self, vector: PETSc.Vec) -> None:
        """Add ghost values to their owners' values."""
        if self.comm.size > 1:
            vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def gather_forces(self, vector: PETSc.Vec, g: Array) -> None:
        """Pass forces `g` (n, 3) of tied points on to vertices, and of ghosts to their owners."""
        self.transfer_tied_forces(g)
        self.add_ghosts(vector)


class GhostFlags:
    """Exchange of flags (n_local,) of a layout's blocks. All methods are collective."""

    def __init__(self, unknowns: Unknowns) -> None:
        self._unknowns = unknowns
        self._vector, self._values = unknowns.vector()

    def destroy(self) -> None:
        self._vector.destroy()

    def of_owners(self, flags: Booleans) -> Booleans:
        """The owners' flags on all copies of a block."""
        if self._unknowns.comm.size == 1:
            return flags
        self._values[:] = flags[:, None]
        self._unknowns.update_ghosts(self._vector)
        return np.asarray(self._values[:, 0] > 0.0)

    def on_any(self, flags: Booleans) -> Booleans:
        """Logical OR over the ranks of each block's flags."""
        if self._unknowns.comm.size == 1:
            return flags
        self._values[:] = flags[:, None]
        self._unknowns.add_ghosts(self._vector)
        return self.of_owners(self._values[:, 0] > 0.0)


class FrameBlocks:
    """Blocks of the joints of bars, and of the vertices they end at.

    Attributes, from `layout` on: `joint_blocks` (n,): local blocks of the joints; `vertex_blocks`
    (m,): local blocks of the vertices on rank 0, -1 on others. Shapes and units: names, joints (n,)
    (length), homes, places (m, 2) (length).
    """

    def __init__(
        self,
        names: Sequence[str],
        joints: Array,
        homes: Sequence[tuple[int, int]],
        places: Array,
    ) -> None:
        self._number = {name: k for k, name in enumerate(names)}
        self.joints, self._homes, self._places = joints, homes, places

    def block(self, joint: str) -> int:
        """Local block of a joint."""
        return int(self.joint_blocks[self._number[joint]])

    def layout(
        self,
        V: fem.FunctionSpace,
        owned: int = 0,
        ghosts: Sequence[tuple[int, int]] = (),
        far: Sequence[tuple[int, int]] = (),
        of_first: int = 0,
    ) -> Unknowns:
        """Create a layout with joints and their vertices beside the cable points. Collective."""
        rank, n = V.mesh.comm.rank, len(self.joints)
        starts = vertex_starts(V)
        joints = [(0, of_first + k) for k in range(n)]
        local = np.full(len(self._homes), -1, dtype=np.int32)
        further = list(far)
        if rank == 0 and self._homes:
            numbers = [starts[owner] + dof for owner, dof in self._homes]
            local[:] = V.dofmap.index_map.global_to_local(np.array(numbers, dtype=np.int64))
            absent = [home for home, own in zip(self._homes, local, strict=True) if own < 0]
            further += [home for home in dict.fromkeys(absent) if home not in further]
        mine, others = (n, []) if rank == 0 else (0, joints)
        unknowns = Unknowns(V, owned + mine, [*ghosts, *others], further)
        points = unknowns.owned_point_blocks() if rank == 0 else unknowns.ghost_point_blocks()
        self.joint_blocks: Indices = points[len(points) - n :]
        unknowns.X[self.joint_blocks] = self.joints
        self.vertex_blocks: Indices = np.append(unknowns.vertex_blocks(), np.int32(-1))[local]
        blocks = unknowns.far_vertex_blocks()
        for k, home in enumerate(self._homes):
            if rank == 0 and local[k] < 0:
                self.vertex_blocks[k] = blocks[further.index(home)]
                unknowns.X[self.vertex_blocks[k]] = self._places[k]
        return unknowns
