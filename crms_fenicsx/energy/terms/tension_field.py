"""Tension field of orthotropic membranes in plain cells, evaluated cell by cell, then held.

The tension direction in a wrinkled cell has no closed form. Before energy and gradient are
assembled, a compiled loop puts each cell's stress and energy into DG0 fields. As the energy is a
maximum over directions, its derivative is that at the fixed direction (envelope theorem), so energy
and gradient assembled from the fields are exact.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import ufl
from dolfinx import fem

from crms_fenicsx.energy.terms import stress_laws as laws
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.materials import ORTHOTROPIC_TENSION_FIELD, LawTerms, symmetric, voigt


@numba.njit(cache=True)
def cell_values(u, dofs, axes, rest, shapes, row, p, cells, strains, values):  # type: ignore[no-untyped-def]
    """Strains (n, 3); energy per area, section forces and state into `values` at the cells. `rest`
    (n, 3) is the strain at u = 0, `shapes` (n, 2, 2) maps differences of u along two sides to
    slopes along the axes, `row` (n,) is each cell's row of parameters."""
    e, s = np.empty(3), np.empty(3)
    slopes = np.empty((2, 3))
    for c in range(len(cells)):
        i, j, k = dofs[c, 0], dofs[c, 1], dofs[c, 2]
        for a in range(2):
            for m in range(3):
                slopes[a, m] = shapes[c, a, 0] * (u[j, m] - u[i, m]) + shapes[c, a, 1] * (
                    u[k, m] - u[i, m]
                )
        e[:] = rest[c]
        for m in range(3):
            x, y = axes[c, 0, m], axes[c, 1, m]
            du, dv = slopes[0, m], slopes[1, m]
            e[0] += (x + 0.5 * du) * du
            e[1] += (y + 0.5 * dv) * dv
            e[2] += x * dv + y * du + du * dv
        energy, state = laws.stress(ORTHOTROPIC_TENSION_FIELD, p[row[c]], e, s, True)
        into = values[cells[c]]
        into[0], into[1], into[2], into[3], into[4] = energy, s[0], s[1], s[2], state
        for m in range(3):
            strains[c, m] = e[m]


@numba.njit(cache=True)
def cell_tangents(strains, row, p, cells, tangents):  # type: ignore[no-untyped-def]
    """Consistent tangents (3, 3) into `tangents` at the cells, flat."""
    C = np.empty((3, 3))
    for c in range(len(cells)):
        laws.tangent(ORTHOTROPIC_TENSION_FIELD, p[row[c]], strains[c], 0.0, C, True)
        tangents[cells[c]] = C.ravel()


class TensionField:
    """Stress, energy and tangent of wrinkling orthotropic cells, as fields for UFL forms. Shapes:
    cells, row (n,), axes, duals (n, 2, 3), rest strain (n, 3), parameters (k, N_PARAMETERS)."""

    def __init__(
        self, u: fem.Function, cells: Indices, axes: Array, duals: Array, rest: Array,
        parameters: Array, row: Indices,
    ) -> None:  # fmt: skip
        mesh = u.function_space.mesh
        self.u, self.cells, self.axes, self.rest = u, cells, axes, rest
        self.parameters, self.row = parameters, row
        self.dofs = np.ascontiguousarray(u.function_space.dofmap.list[cells])
        x = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
        self.shapes = np.linalg.inv(np.einsum("nki,nai->nka", x[:, 1:] - x[:, :1], duals))
        self.strains = np.zeros((len(cells), 3))
        self.values = fem.Function(fem.functionspace(mesh, ("DG", 0, (5,))))
        """Energy per area, section forces (S11, S22, S12) and state of each cell."""
        self.tangents = fem.Function(fem.functionspace(mesh, ("DG", 0, (3, 3))))
        """Consistent tangent of each cell, in Voigt order."""

    def update(self) -> None:
        """Evaluate the law at the current displacement."""
        cell_values(
            self.u.x.array.reshape(-1, 3), self.dofs, self.axes, self.rest, self.shapes, self.row,
            self.parameters, self.cells, self.strains, self.values.x.array.reshape(-1, 5),
        )  # fmt: skip

    def update_tangents(self) -> None:
        """Evaluate the tangents at the last `update`."""
        tangents = self.tangents.x.array.reshape(-1, 9)
        cell_tangents(self.strains, self.row, self.parameters, self.cells, tangents)

    def terms(self, parameters: Any) -> LawTerms:
        """The law with the fields held."""
        values, tangents = self.values, self.tangents
        D = ufl.as_matrix([[parameters[3 * i + j] for j in range(3)] for i in range(3)])

        def tangent(a: Any, b: Any) -> Any:
            return ufl.dot(voigt(a), ufl.dot(tangents, voigt(b)))

        def taut_tangent(a: Any, b: Any) -> Any:
            return ufl.dot(voigt(a), D * voigt(b))

        stress = symmetric([values[1], values[2], values[3]])
        return LawTerms(values[0], stress, values[4], tangent, taut_tangent)
