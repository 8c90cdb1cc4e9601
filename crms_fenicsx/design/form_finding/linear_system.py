"""Directions in which the vertices of a form move, and the linear system of an iteration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.design.form_finding.film import Film
from crms_fenicsx.design.form_finding.form_cables import EdgeLine
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.membrane import Membrane

SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN
LYING = 0.1
"""Part of a direction left free by supports up to which the direction counts as held."""


class Directions:
    """Splits the free directions of vertices into those across a form and those within it.

    Across are the surface normal, at cables the two directions square to the cable, and where
    cables end or meet all directions; a vertex that moves within leaves the form unchanged. At a
    `guided` vertex, held in some directions, forces within the surface count as well. `across`,
    `within`, `counted` (where forces must balance), `moving` (where vertices move that a sheet
    holds: these, but not along lines of guided vertices) and `along` (cables) are projectors,
    (n, 3, 3).
    """

    def __init__(self, membrane: Membrane, film: Film, lines: Sequence[EdgeLine]) -> None:
        self._film, self._lines = film, lines
        n = membrane.V.dofmap.index_map.size_local
        self.free = ~membrane.held[:n]
        ids = membrane.vertex_ids[:n]
        vertices = np.concatenate([np.zeros(0, dtype=np.int64), *(line.ids for line in lines)])
        numbers, count = np.unique(vertices, return_counts=True)
        ends = [line.ids[[0, -1]] for line in lines]
        inner = np.setdiff1d(numbers[count == 1], np.concatenate([numbers[:0], *ends]))
        self.on_cable = np.isin(ids, inner)
        on_any = np.isin(ids, numbers)
        self._joint = on_any & ~self.on_cable
        partly = membrane.held.any(axis=1) & ~membrane.held.all(axis=1)
        partly &= ~np.isin(membrane.vertex_ids, numbers)
        self.guided = partly[:n]
        sides = film.V.dofmap.list[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        self._guides = sides[partly[sides].all(axis=1)]
        self._has_guides = membrane.comm.allreduce(len(self._guides)) > 0
        self.across, self.within, self.counted, self.moving, self.along = np.zeros((5, n, 3, 3))

    def take(self) -> None:
        """Update the directions to the current shape. Collective."""
        film, free = self._film, self.free[:, :, None] * np.eye(3)
        normal = self._freed(film.growth())
        along = sum((line.tangents(len(film.start)) for line in self._lines), 0.0 * film.start)
        tangent = self._freed(film.gathered(along)) * self.on_cable[:, None]
        held = self.on_cable | self._joint
        self.across = normal[:, :, None] * normal[:, None, :]
        self.across[held] = (free - tangent[:, :, None] * tangent[:, None, :])[held]
        self.within = free - self.across
        self.counted = np.where(self.guided[:, None, None], free, self.across)
        self.along = np.where(self.on_cable[:, None, None], self.within, 0.0)
        self.moving = self.counted
        if self._has_guides:
            tangent = self._freed(self._guide_tangents()) * self.guided[:, None]
            self.moving = self.counted - tangent[:, :, None] * tangent[:, None, :]

    def _guide_tangents(self) -> Array:
        """Tangents (n, 3) of lines of guided vertices at these. Collective."""
        x = self._film.positions()
        sides = x[self._guides[:, 1]] - x[self._guides[:, 0]]
        squares = np.zeros((len(x), 3, 3))
        for end in self._guides.T:
            np.add.at(squares, end, sides[:, :, None] * sides[:, None, :])
        rows = [self._film.gathered(squares[:, k]) for k in range(3)]
        values, axes = np.linalg.eigh(np.stack(rows, axis=1))
        return np.where(values[:, 2:] > 0.0, axes[:, :, 2], 0.0)

    def _freed(self, vectors: Array) -> Array:
        """Free components of vectors (n, 3) as unit vectors, zero if almost none is free."""
        lengths = np.linalg.norm(vectors, axis=1)
        parts = np.where(self.free, vectors, 0.0)
        sizes = np.linalg.norm(parts, axis=1)
        sizes = np.where(sizes > LYING * lengths, sizes, np.inf)
        return np.asarray(parts / sizes[:, None])


Border = list[tuple[Array, Array, float]]
"""Forces (n, 3) of each unknown tension and pressure, and the derivatives of its equation by this
rank's vertices (n, 3) and by itself."""


class LinearSystem:
    """Factorised stiffness of a film and its cables."""

    def __init__(
        self, film: Film, lines: Sequence[EdgeLine], directions: Directions, prefix: str
    ) -> None:
        self.film, self.lines, self.directions = film, lines, directions
        self.free = directions.free
        first, last = film.V.dofmap.index_map.local_range
        self._rows = (np.flatnonzero(~self.free) + 3 * first).astype(PETSc.IntType)
        self._on_cable = (np.flatnonzero(np.repeat(directions.on_cable, 3)) + 3 * first).astype(
            PETSc.IntType
        )
        self._pointers = np.arange(0, 9 * (last - first) + 1, 3, dtype=PETSc.IntType)
        columns = 3 * np.arange(first, last)[:, None, None] + np.arange(3)
        self._columns = np.repeat(columns, 3, axis=1).ravel().astype(PETSc.IntType)
        self._vector = film.matrix.createVecLeft()
        self._way = self._vector.duplicate()
        for matrix in (film.matrix, film.elastic):
            matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._pc = PETSc.PC().create(film.comm)
        self._pc.setOptionsPrefix(prefix)
        self._pc.setOperators(film.matrix)
        self._pc.setType(PETSc.PC.Type.LU)
        self._pc.setFactorSolverType("mumps")
        self._pc.setFromOptions()
        if self._pc.getFactorSolverType() == "mumps":  # twice its estimate, which may be too small
            self._pc.setFactorSetUpSolverType()
            self._pc.getFactorMatrix().setMumpsIcntl(14, 100)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for own in (self._pc, self._vector, self._way, self.film.matrix, self.film.elastic):
            own.destroy()

    def assemble(self, *, exact: bool, pressure: float = 0.0) -> None:
        """Assemble the exact stiffness, or that of the updated reference strategy, with cables as
        force densities."""
        self.film.assemble(exact=exact, pressure=pressure)
        for line in self.lines:
            line.add_stiffness(self.film.matrix, even=not exact)
        self.film.matrix.assemble()

    def balance(self, counted: Array, placed: Array, pressure: float, share: float) -> None:
        """Assemble the exact stiffness, with a share of that of the elastic sheet, in the
        directions `counted`, and what places the vertices in the others: the sheet, at cables
        their lengths."""
        film = self.film
        self._assemble_both(pressure, share)
        film.elastic.zeroRows(self._on_cable, diag=0.0)
        for line in self.lines:
            line.add_stiffness(film.elastic, even=True)
        film.elastic.assemble()
        left = self._diagonal(counted), self._diagonal(placed)
        self._replace(left[0].matMult(film.matrix), left[1].matMult(film.elastic), *left)

    def hold(self, pressure: float, share: float) -> None:
        """Assemble the exact stiffness, with a share of that of the elastic sheet, by displacements
        across the form, and that of the sheet by its own within the form."""
        self._assemble_both(pressure, share)
        moving = self.directions.moving
        right = self._diagonal(moving), self._diagonal(np.eye(3) - moving)
        self._replace(
            self.film.matrix.matMult(right[0]), self.film.elastic.matMult(right[1]), *right
        )

    def _assemble_both(self, pressure: float, share: float) -> None:
        """Assemble the exact stiffness, with a share of that of the sheet, and the sheet's."""
        self.assemble(exact=True, pressure=pressure)
        self.film.assemble_elastic()
        self.film.matrix.axpy(share, self.film.elastic, SAME)

    def _replace(self, one: PETSc.Mat, other: PETSc.Mat, *spent: PETSc.Mat) -> None:
        """Replace the matrix by a sum."""
        one.axpy(1.0, other, SAME)
        one.copy(self.film.matrix, SAME)
        for own in (one, other, *spent):
            own.destroy()

    def _diagonal(self, blocks: Array) -> PETSc.Mat:
        """The matrix of blocks of the vertices, (n, 3, 3), on its diagonal."""
        return PETSc.Mat().createAIJ(
            self.film.matrix.getSizes(), csr=(self._pointers, self._columns, blocks.ravel()),
            comm=self.film.comm,
        )  # fmt: skip

    def times(self, way: Array) -> Array:
        """Forces (n, 3) due to displacements (n, 3), before `factorise`. Collective."""
        self._way.array[:] = way.ravel()
        self.film.matrix.mult(self._way, self._vector)
        return self._vector.array.reshape(-1, 3).copy()

    def factorise(self) -> None:
        """Apply the supports and factorise. Collective."""
        self.film.matrix.zeroRowsColumns(self._rows, diag=1.0)
        self._pc.setOperators(self.film.matrix)
        self._pc.setUp()

    def solved(self, forces: Array) -> Array:
        """Displacements (n, 3) due to forces (n, 3). Collective."""
        self._vector.array[:] = np.where(self.free, forces, 0.0).ravel()
        self._pc.apply(self._vector, self._way)
        return self._way.array.reshape(-1, 3).copy()

    def bordered(
        self, forces: Array, start: Array, border: Border, gaps: Array
    ) -> tuple[Array, list[Array], Array]:
        """Displacements, alone and per extra unknown, and the changes of those unknowns.
        Collective."""
        way = start + self.solved(forces)
        ways = [self.solved(column) for column, _, _ in border]
        change = np.zeros(len(gaps))
        if border:
            local = np.array([[np.vdot(row, own) for own in (*ways, way)] for _, row, _ in border])
            total = self.film.comm.allreduce(local, op=MPI.SUM)
            system = np.diag([diagonal for _, _, diagonal in border]) - total[:, :-1]
            if np.isfinite(total).all():  # else cells have collapsed, which is detected later
                # singular if cables are straight
                change = np.linalg.lstsq(system, -gaps - total[:, -1], rcond=1e-12)[0]
        return way, ways, change
