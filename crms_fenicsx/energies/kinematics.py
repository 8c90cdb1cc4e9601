"""Strains of a membrane by UFL."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from crms_fenicsx.meshes.cell_geometry import cell_normals
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.runtime.errors import InputError, raised_together


def warp_field(mesh: Any, material: MembraneMaterial, cells: npt.NDArray[np.int32]) -> fem.Function:
    """Unit warp directions in the surface, one per cell (piecewise constant)."""
    space = fem.functionspace(mesh, ("DG", 0, (3,)))
    field = fem.Function(space)
    normal, centre = cell_normals(mesh), space.tabulate_dof_coordinates()
    warp = material.warp
    with raised_together(mesh.comm):  # one rank's cells may be bad, another's good
        given = (
            np.asarray(warp(centre.T), dtype=float).T
            if callable(warp)
            else np.broadcast_to(np.asarray(warp, dtype=float), centre.shape)
        )
        if given.shape != centre.shape or not np.all(np.isfinite(given[cells])):
            raise InputError(
                f"warp: the function returned an array of shape {given.T.shape} or with values "
                f"that are not finite; it must return finite directions of shape {centre.T.shape}."
            )
        flat = given - np.sum(given * normal, axis=1)[:, None] * normal
        length = np.linalg.norm(flat, axis=1)
        bad = cells[length[cells] <= 1e-6 * np.linalg.norm(given[cells], axis=1)]
        if len(bad):
            raise InputError(
                f"warp: the direction {given[bad[0]]} is normal to the membrane at "
                f"{centre[bad[0]]}; give a direction that has a part in the surface everywhere."
            )
    field.x.array[:] = (flat / np.maximum(length, 1e-300)[:, None]).ravel()
    return field


def tangent_basis(mesh: Any, warp: fem.Function | None) -> tuple[Any, Any]:
    """Orthonormal in-plane axes of the cells, UFL; axis 1 along the warp or the first edge."""
    J = ufl.Jacobian(mesh)
    first, second = J[:, 0], J[:, 1]
    normal = ufl.cross(first, second)
    normal = normal / ufl.sqrt(ufl.dot(normal, normal))
    e1 = first / ufl.sqrt(ufl.dot(first, first)) if warp is None else warp
    return e1, ufl.cross(normal, e1)


class Kinematics:
    """Green-Lagrange strain of a surface in in-plane axes, without cancellation at small strain."""

    def __init__(self, u: Any, basis: tuple[Any, Any]) -> None:
        self.basis = basis
        self.H = [ufl.dot(ufl.grad(u), e) for e in basis]
        self.F = [e + h for e, h in zip(basis, self.H, strict=True)]

    def strain(self) -> Any:
        """E, (2, 2)."""
        e, H = self.basis, self.H
        return ufl.as_matrix(
            [
                [
                    (ufl.dot(e[a], H[b]) + ufl.dot(H[a], e[b]) + ufl.dot(H[a], H[b])) / 2
                    for b in (0, 1)
                ]
                for a in (0, 1)
            ]
        )

    def strain_variation(self, v: Any) -> Any:
        """First variation of E along v, (2, 2)."""
        dH = [ufl.dot(ufl.grad(v), e) for e in self.basis]
        F = self.F
        return ufl.as_matrix(
            [[(ufl.dot(F[a], dH[b]) + ufl.dot(dH[a], F[b])) / 2 for b in (0, 1)] for a in (0, 1)]
        )


def tensile_part(s: Any) -> Any:
    """The symmetric (2, 2) tensor with its negative eigenvalues set to zero."""
    mean, half, shear = (s[0, 0] + s[1, 1]) / 2, (s[0, 0] - s[1, 1]) / 2, s[0, 1]
    radius = ufl.sqrt(half**2 + shear**2)
    larger, smaller = mean + radius, mean - radius
    sphere = (ufl.max_value(larger, 0) + ufl.max_value(smaller, 0)) / 2
    mixed = ufl.conditional(ufl.le(larger, 0), 0.0, larger / (2 * radius))
    share = ufl.conditional(ufl.ge(smaller, 0), 1.0, mixed)
    return ufl.as_matrix(
        [[sphere + share * half, share * shear], [share * shear, sphere - share * half]]
    )
