"""Layout of the unknowns: displacements of mesh vertices and of the cables' points.

Everything is counted in *blocks* of three components. On each rank the local blocks are

    [ owned vertices | owned cable points | ghost vertices | ghost cable points | far vertices ]

and the PETSc vectors hold the first two groups. Cable points are fold points on edges, anchors and
other points that cables pass without being mesh vertices. Terms of the potential see one local
array (n, 3) of displacements, ghosts included, and address its blocks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.dofs.local_blocks import LocalBlocks
from crms_fenicsx.dofs.vertex_places import vertex_places
from crms_fenicsx.runtime.arrays import Array, Indices, Integers


def vertex_starts(V: fem.FunctionSpace) -> Integers:
    """Global numbers of the ranks' first vertices, (ranks,). Collective."""
    return np.array(V.mesh.comm.allgather(V.dofmap.index_map.local_range[0]))


EVENLY = "vec_mdot_use_gemv"
"""PETSc's option for that way, read when a vector is made."""


class Unknowns(LocalBlocks):
    """Numbering, ghosted vectors and held components of the unknowns.

    Attributes: `X` (n, 3) array: positions that belong to zero displacement: stress-free vertices,
    first positions of cable points (to be filled in by who lays the cable); `starts` (ranks + 1,):
    global numbers of the ranks' first blocks, and of all blocks; `bounds`: one-sided obstacles, as
    bounds of displacements. Shapes: ghost_points (n, 2), far_vertices (n, 2).
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

        # The combined global numbering: rank by rank, vertices first.
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
        self.matrix_numbers = np.argsort(self.matrix_order()).astype(PETSc.IntType)
        self.bounds: tuple[Array, Array] | None = None

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
        """Local blocks of the cable points that this rank owns."""
        return np.arange(self.n_vertices, self.n_owned, dtype=np.int32)

    def ghost_point_blocks(self) -> Indices:
        """Local blocks of the cable points of other ranks."""
        first = self.n_owned + self.n_ghost_vertices
        return np.arange(first, first + self.n_ghost_points, dtype=np.int32)

    def far_vertex_blocks(self) -> Indices:
        """Local blocks of the vertices at far ends of spans."""
        first = self.n_owned + self.n_ghost_vertices + self.n_ghost_points
        return np.arange(first, self.n_local, dtype=np.int32)

    def vector(self) -> tuple[PETSc.Vec, Array]:
        """A ghosted vector and its local array (n, 3), ghosts included, which share memory.

        By default PETSc's products of one vector with several take another way, with other last
        digits, where these happen to lie evenly in memory. A run would not be the same twice.
        """
        options = PETSc.Options()
        if not options.hasName(EVENLY):
            options[EVENLY] = False
        array = np.zeros((self.n_local, 3))
        vector = PETSc.Vec().createGhostWithArray(
            self.ghosts, array.reshape(-1), size=(3 * self.n_owned, 3 * self.n_global), bsize=3,
            comm=self.comm,
        )  # fmt: skip
        return vector, array

    def matrix_order(self) -> Indices:
        """Local blocks in the order that matrices count them: all vertices, as DOLFINx's forms
        number them, then all else."""
        rest = np.arange(self.n_owned + self.n_ghost_vertices, self.n_local, dtype=np.int32)
        return np.concatenate([self.vertex_blocks(), self.owned_point_blocks(), rest])

    def lgmap(self) -> PETSc.LGMap:
        """Local to global map of the blocks in matrix order."""
        return PETSc.LGMap().create(self.numbers()[self.matrix_order()], bsize=3, comm=self.comm)

    def numbers(self) -> Integers:
        """Global numbers of the local blocks, (n_local,)."""
        owned = np.arange(self.start, self.start + self.n_owned, dtype=PETSc.IntType)
        return np.concatenate([owned, self.ghosts])

    def update_ghosts(self, vector: PETSc.Vec) -> None:
        """Copy owned values to the ghosts of other ranks."""
        if self.comm.size > 1:
            vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)

    def add_ghosts(self, vector: PETSc.Vec) -> None:
        """Add ghost values to their owners."""
        if self.comm.size > 1:
            vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def gather_forces(self, vector: PETSc.Vec, g: Array) -> None:
        """Hand the riders' forces to their vertices and those of ghosts to their owners.

        `g` is the vector's local array, (n, 3).
        """
        self.hand_over(g)
        self.add_ghosts(vector)
