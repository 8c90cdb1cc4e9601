"""Residual section forces of an unstrained membrane, in addition to its materials' prestress."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from crms_fenicsx.energy.terms.integral import Integral, one_point
from crms_fenicsx.energy.terms.kinematics import Kinematics, tangent_basis
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, FormPattern
from crms_fenicsx.foundation.dofs.layout import Unknowns, vertex_places
from crms_fenicsx.foundation.meshes.triangles import cell_normals
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.membrane import Membrane


class ResidualStress(EnergyTerm):
    """Energy ``int S : E`` of constant second Piola-Kirchhoff forces S at the strain E, given
    for the places of the cells. Shapes and units: forces (n, 3, 3) (force per length).

    Attributes: `elsewhere` (k,): cells whose energy another term has."""

    name = "residual stress"
    exact_hessian = True
    integral: Integral

    def __init__(self, u: fem.Function, forces: Array) -> None:
        V = u.function_space
        self.u, self.section_forces = u, forces
        self._places, self._present = vertex_places(V), forces
        self.elsewhere: Indices = np.zeros(0, dtype=np.int32)
        self._S = S = fem.Function(fem.functionspace(V.mesh, ("DG", 0, (3,))))
        stress = ufl.as_matrix([[S[0], S[2]], [S[2], S[1]]])
        basis = tangent_basis(V.mesh, None)
        kinematics = Kinematics(u, basis)

        def variation(v: Any, q: Any, dx: ufl.Measure) -> Any:
            work = ufl.inner(stress, kinematics.strain_variation(v))
            return (ufl.inner(stress, kinematics.strain()) * q + work) * dx

        self.integral = Integral(V, variation)
        v, w = ufl.TestFunction(V), ufl.TrialFunction(V)
        dv, dw = ([ufl.dot(ufl.grad(f), e) for e in basis] for f in (v, w))
        pairs = [(i, j) for i in (0, 1) for j in (0, 1)]
        geometric: Any = sum(stress[i, j] * ufl.dot(dv[i], dw[j]) for i, j in pairs)
        self._hessian = FormPattern(fem.form(geometric * one_point(V.mesh)), V)
        self.patterns = (self._hessian,)

    def follow(self, membrane: Membrane) -> None:
        """Take the forces at the present stress-free places of the cells. Collective."""
        assert self.section_forces is not None
        self._present = membrane.at_places(self.section_forces, self._places)

    @property
    def present_forces(self) -> Array:
        return self._present

    def components(self, axes: Array, cells: Indices) -> Array:
        """Section forces (S11, S22, S12) of some cells in axes (n, 2, 3), (n, 3)."""
        both = np.einsum("nia,nab,njb->nij", axes, self._present[cells], axes)
        return np.asarray(both[:, [0, 1, 0], [0, 1, 1]])

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        cells = np.arange(len(self._present), dtype=np.int32)
        values = self.components(_axes(self.u.function_space.mesh)[cells], cells)
        values[self.elsewhere] = 0.0
        self._S.x.array[: values.size] = values.ravel()
        self._hessian.attach(unknowns)

    def sums(self, x: Array, out: Array) -> None:
        out[0] = self.integral.value

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        self.unknowns.add_to_vertices(self.integral.gradient, g)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        self._hessian.add(A)


def _axes(mesh: Any) -> Array:
    """Axes of `tangent_basis` without a warp, (n, 2, 3)."""
    x = mesh.geometry.x[geometry_dofmap(mesh)]
    first = x[:, 1] - x[:, 0]
    first = first / np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(cell_normals(mesh), first)], axis=1)
