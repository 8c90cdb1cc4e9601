"""Membrane strains in UFL, and the artificial stiffness of cells in H0."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.foundation.meshes.triangles import double_areas
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.materials import MembraneMaterial


def warp_directions(
    comm: MPI.Intracomm, material: MembraneMaterial, corners: Array, cells: npt.NDArray[np.int32]
) -> Array:
    """Unit warp directions (n, 3) in all cells with corners (n, 3, 3), checked in `cells`."""
    normal, centre = double_areas(corners), corners.mean(axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    warp = material.warp
    with raised_together(comm):  # invalid values may occur on one rank only
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
                f"{centre[bad[0]]}; pass a direction that is nowhere normal to it."
            )
    return np.asarray(flat / np.maximum(length, 1e-300)[:, None])


def tangent_basis(mesh: Any, warp: fem.Function | None) -> tuple[Any, Any]:
    """Orthonormal in-plane axes of the cells, UFL; axis 1 along the warp or the first edge."""
    J = ufl.Jacobian(mesh)
    first, second = J[:, 0], J[:, 1]
    normal = ufl.cross(first, second)
    normal = normal / ufl.sqrt(ufl.dot(normal, normal))
    e1 = first / ufl.sqrt(ufl.dot(first, first)) if warp is None else warp
    return e1, ufl.cross(normal, e1)


def dual_axes(axes: Array) -> Array:
    """In-plane dual basis (n, 2, 3) of axes (n, 2, 3); the same for orthonormal axes."""
    products = np.einsum("nai,nbi->nab", axes, axes)
    return np.asarray(np.linalg.solve(products, axes))


class Kinematics:
    """Green-Lagrange strain of a surface in in-plane axes, without cancellation at small strain."""

    def __init__(self, u: Any, basis: tuple[Any, Any], rest: bool = False) -> None:
        """With `rest`, the basis is the image in the mesh of orthonormal axes of the stress-free
        shape, and the mesh's own strain is included."""
        self.basis, self.rest = basis, rest
        self.H = [ufl.dot(ufl.grad(u), e) for e in basis]
        self.F = [e + h for e, h in zip(basis, self.H, strict=True)]

    def strain(self) -> Any:
        """E, (2, 2)."""
        e, H = self.basis, self.H
        E = ufl.as_matrix(
            [
                [
                    (ufl.dot(e[a], H[b]) + ufl.dot(H[a], e[b]) + ufl.dot(H[a], H[b])) / 2
                    for b in (0, 1)
                ]
                for a in (0, 1)
            ]
        )
        if not self.rest:
            return E
        G = ufl.as_matrix([[ufl.dot(e[a], e[b]) for b in (0, 1)] for a in (0, 1)])
        return E + (G - ufl.Identity(2)) / 2

    def strain_variation(self, v: Any) -> Any:
        """First variation of E along v, (2, 2)."""
        dH = [ufl.dot(ufl.grad(v), e) for e in self.basis]
        F = self.F
        return ufl.as_matrix(
            [[(ufl.dot(F[a], dH[b]) + ufl.dot(dH[a], F[b])) / 2 for b in (0, 1)] for a in (0, 1)]
        )


def tensile_part(s: Any) -> Any:
    """Symmetric (2, 2) tensor with its negative eigenvalues set to zero."""
    mean, half, shear = (s[0, 0] + s[1, 1]) / 2, (s[0, 0] - s[1, 1]) / 2, s[0, 1]
    radius = ufl.sqrt(half**2 + shear**2)
    larger, smaller = mean + radius, mean - radius
    sphere = (ufl.max_value(larger, 0) + ufl.max_value(smaller, 0)) / 2
    mixed = ufl.conditional(ufl.le(larger, 0), 0.0, larger / (2 * radius))
    share = ufl.conditional(ufl.ge(smaller, 0), 1.0, mixed)
    return ufl.as_matrix(
        [[sphere + share * half, share * shear], [share * shear, sphere - share * half]]
    )


FLOOR, FLOOR_FROM_FLAT = 1e-5, 1e-2
"""Fraction of the taut stiffness added in H0 to the tangent of wrinkled and slack cells to keep it
definite: in general, and while a flat sheet gets its first stresses and cells alternate between
taut and wrinkled. A hundredth throughout would make the iterations grow with the mesh: 6 in a load
step of the inflated square with 32 cells a side and 19 with 128, which now takes 9."""


class Stiffening:
    """Artificial stiffness in H0 of plain and folded cells, beyond the energy.

    Attributes: `prestress`: isotropic section force (force per length), as a flat sheet has no
    stiffness against pressure; `floor`: fraction of the taut stiffness added to the tangent of
    wrinkling laws; `compression`: fraction of compressive section forces in the geometric
    stiffness: 0 to keep it semidefinite, 1 for the second derivatives.
    """

    def __init__(self, mesh: Any) -> None:
        self.prestress = fem.Constant(mesh, PETSc.ScalarType(0.0))
        self.floor = fem.Constant(mesh, PETSc.ScalarType(FLOOR))
        self.compression = fem.Constant(mesh, PETSc.ScalarType(0.0))

    @contextmanager
    def none(self) -> Iterator[None]:
        """Within this context, assemble the energy's second derivatives."""
        parts = self.prestress, self.floor, self.compression
        kept = [float(part.value) for part in parts]
        for part, value in zip(parts, (0.0, 0.0, 1.0), strict=True):
            part.value = value
        try:
            yield
        finally:
            for part, value in zip(parts, kept, strict=True):
                part.value = value

    def set(self, prestress: float, failures: int = 0, least: float = 0.0) -> None:
        """Set the prestress and its floor, at least `least`. Each failure of a line search, due to
        slack cells that allow too large steps, raises the floor tenfold."""
        self.prestress.value = prestress
        raised = failures + (prestress > 0.0)
        floor = FLOOR_FROM_FLAT * 10.0 ** (raised - 1) if raised else FLOOR
        self.floor.value = min(max(floor, least), 1.0)
