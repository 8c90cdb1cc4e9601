"""Discrete harmonic functions on the edges of a distributed mesh."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, pointers, runs
from crms_fenicsx.foundation.runtime.compat import direct_solver


class HarmonicExtension:
    """Extends vectors from some vertices to the others, each with the weighted mean of its
    neighbours."""

    def __init__(
        self, V: fem.FunctionSpace, ids: Integers, edges: Integers, weights: Array, known: Booleans
    ) -> None:
        """Factorise the equations of the vertices that are not `known`, of which each part of the
        mesh has one. `known` (m,) and `edges` (k, 2), with `weights` (k,), are by the numbers of
        vertices in the mesh as given and the same on all ranks; `ids` (n,) are the numbers of the
        local vertices. Collective."""
        comm, vertices = V.mesh.comm, V.dofmap.index_map
        own = vertices.size_local
        column = np.empty(len(known), dtype=PETSc.IntType)
        column[np.concatenate(comm.allgather(ids[:own]))] = np.arange(len(known))
        both = np.concatenate([edges, edges[:, ::-1]])
        order = np.argsort(both[:, 0], kind="stable")
        both, weights = both[order], np.concatenate([weights, weights])[order]
        degree = np.bincount(both[:, 0], minlength=len(known))
        mine, counts = ids[:own], degree[ids[:own]]
        to = np.repeat(np.arange(own), counts)
        at = runs(pointers(degree)[mine], counts)
        of, weights = both[at, 1], weights[at]
        free = ~known[mine]
        linked = free[to] & ~known[of]
        rows = np.concatenate([np.arange(own), to[linked]])
        columns = np.concatenate([column[mine], column[of[linked]]])
        total = np.bincount(to, weights, own)
        values = np.concatenate([np.where(free, total, 1.0), -weights[linked]])
        order = np.lexsort((columns, rows))
        first = pointers(np.bincount(rows, minlength=own)).astype(PETSc.IntType)
        matrix = PETSc.Mat().createAIJ(
            2 * [(own, len(known))], csr=(first, columns[order], values[order]), comm=comm
        )
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._factor = PETSc.PC().create(comm)
        self._factor.setOperators(matrix)
        self._factor.setType(PETSc.PC.Type.CHOLESKY)
        self._factor.setFactorSolverType(direct_solver(comm))
        self._factor.setUp()
        self._vectors = matrix.createVecs()
        self._found = la.vector(vertices, 3, dtype=np.float64)
        border = free[to] & known[of]
        self._to, self._of, self._weights = to[border], of[border], weights[border]
        self._known, self._ids = known, ids

    def destroy(self) -> None:
        for one in (self._factor, *self._vectors):
            one.destroy()

    def of(self, values: Array) -> Array:
        """The values (m, 3) of known vertices, and theirs at the others, of local vertices (n, 3).
        Collective."""
        right, found = self._vectors
        local = self._found.array.reshape(-1, 3)
        given = self._weights[:, None] * values[self._of]
        for k in range(3):
            right.array = np.bincount(self._to, given[:, k], len(right.array))
            self._factor.apply(right, found)
            local[: len(right.array), k] = found.array
        self._found.scatter_forward()
        return np.where(self._known[self._ids, None], values[self._ids], local)
