"""Strain energy of the plain (not folded) membrane cells, assembled by DOLFINx (section 2.3)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from crms_fenicsx.energy.terms.integral import FormInputs, Integral, compiled_form, counting_cells
from crms_fenicsx.energy.terms.kinematics import (
    Kinematics,
    Stiffening,
    dual_axes,
    tangent_basis,
    tensile_part,
    warp_directions,
)
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, FormPattern
from crms_fenicsx.foundation.dofs.layout import Unknowns, edge_ends
from crms_fenicsx.foundation.meshes.triangles import area_vectors, cell_normals, cross
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Indices
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.frames import own_areas
from crms_fenicsx.model.materials import (
    LINEAR,
    N_PARAMETERS,
    ORTHOTROPIC_TENSION_FIELD,
    UFL_LAW,
    LawTerms,
    MembraneMaterial,
    law_terms,
)
from crms_fenicsx.model.ufl_material import UflMembrane

if TYPE_CHECKING:
    from crms_fenicsx.energy.terms.compiled_laws import TensionField


class MembraneEnergy(EnergyTerm):
    """Strain energy of the cells whose `plain` indicator is 1, in total formulation.

    Attributes: `plain`: 1 in plain cells, 0 in folded cells, which thus leave this term without new
    code; `integral`: energy and nodal forces; `stiffening`: artificial stiffness; `frames`: see
    `Membrane.frames`.
    """

    name = "membrane"
    exact_hessian = True
    integral: Integral
    stiffening: Stiffening

    def __init__(
        self,
        u: fem.Function,
        materials: Mapping[int, MembraneMaterial],
        cell_tags: Any = None,
        frames: Array | None = None,
    ) -> None:
        V, mesh = u.function_space, u.function_space.mesh
        self.u, self.frames = u, frames
        self.plain = fem.Function(fem.functionspace(mesh, ("DG", 0)))
        self.plain.x.array[:] = 1.0
        self.stiffening = Stiffening(mesh)
        self.materials = materials
        self.cell_tags = cell_tags
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        self.warps: dict[int, fem.Function | None] = {}
        vectors = None
        for tag, material in materials.items():
            self.warps[tag] = None
            if material.warp is not None and frames is None:
                vectors = vectors or fem.functionspace(mesh, ("DG", 0, (3,)))
                self.warps[tag] = fem.Function(vectors)
        self._renew_warps()
        self._area = self._area_in_mesh()
        self.tension_field = self._tension_field(cells)
        self._rest = float(np.abs(self.rest_strains(cells)).max(initial=0.0))
        self._sewn = None if frames is None else self._sewn_fields(frames)
        self._parameters = {
            tag: fem.Constant(mesh, material.parameters) for tag, material in materials.items()
        }
        self.renew_materials()
        self._pattern = FormPattern(self._bound_stiffness(), V)
        self.patterns = (self._pattern,)
        prepare = None if self.tension_field is None else self.tension_field.update
        self.integral = Integral(V, self._variation, prepare, cell_tags, self._inputs("energy"))
        self._cell_values: dict[int, fem.Expression] = {}

    def renew_places(self) -> None:
        """Follow the stress-free places of the vertices, which have moved in the mesh."""
        self._renew_warps()
        self._area = self._area_in_mesh()
        if self.tension_field is not None:
            self.tension_field.place(self.material_axes(self.tension_field.cells))

    def _renew_warps(self) -> None:
        """Compute the warp directions in the present mesh. Collective."""
        mesh = self.u.function_space.mesh
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        corners = np.asarray(mesh.geometry.x[geometry_dofmap(mesh)], dtype=float)
        for tag, warp in self.warps.items():
            if warp is not None:
                own = cells if self.cell_tags is None else self.cell_tags.find(tag)
                ways = warp_directions(mesh.comm, self.materials[tag], corners, own)
                warp.x.array[:] = ways.ravel()

    def _area_in_mesh(self) -> float:
        """Area of this rank's own cells in the present mesh."""
        mesh = self.u.function_space.mesh
        own = mesh.topology.index_map(2).size_local
        return float(np.linalg.norm(area_vectors(mesh)[:own], axis=1).sum())

    def _inputs(self, form: str) -> FormInputs | None:
        """What a form takes from the mesh; None with a material of the user's own law."""
        laws = tuple(
            (tag, material.law, self.warps[tag] is None) for tag, material in self.materials.items()
        )
        if any(law == UFL_LAW for _, law, _ in laws):
            return None
        functions = [self.u, self.plain, *(self._sewn or ())]
        functions += [warp for warp in self.warps.values() if warp is not None]
        if self.tension_field is not None:
            functions += [self.tension_field.values, self.tension_field.tangents]
        stiffening = self.stiffening
        constants = stiffening.prestress, stiffening.floor, stiffening.compression
        key = f"{form} of the membrane", laws, self.cell_tags is None, self._sewn is None
        numbers = (*constants, *self._parameters.values())
        return FormInputs(key, tuple(functions), numbers, (self.plain,))

    def _bound_stiffness(self) -> fem.Form:
        """The form of the stiffness over the plain cells."""
        inputs, V = self._inputs("stiffness"), self.u.function_space
        return compiled_form(inputs, [V, V], lambda: self._stiffness(inputs), self.cell_tags)

    @cached_property
    def terms(self) -> dict[int, tuple[LawTerms, Kinematics]]:
        """Law and kinematics of each material, in UFL."""
        found = {}
        for tag, material in self.materials.items():
            basis = tangent_basis(self.u.function_space.mesh, self.warps[tag])
            if self._sewn is not None:
                basis = self._sewn[1:]
            kinematics = Kinematics(self.u, basis, rest=self.frames is not None)
            parameters = self._parameters[tag]
            if material.law == ORTHOTROPIC_TENSION_FIELD:
                assert self.tension_field is not None
                law = self.tension_field.terms(parameters)
            elif isinstance(material, UflMembrane):
                law = material.law_terms(kinematics.strain(), parameters)
            else:
                law = law_terms(material.law, kinematics.strain(), parameters)
            found[tag] = law, kinematics
        return found

    @property
    def _part(self) -> Any:
        """Area weight of each cell, relative to its area in the mesh."""
        return self.plain if self._sewn is None else self.plain * self._sewn[0]

    def renew_materials(self) -> None:
        """Update the parameters from `materials`; laws and warps are unchanged."""
        materials = self.materials.values()
        self._modulus = max(material.reference_modulus for material in materials)
        self._prestress = max(float(np.abs(m.prestress_vector).max()) for m in materials)
        for tag, parameters in self._parameters.items():
            parameters.value[:] = self.materials[tag].parameters
        if self.tension_field is not None:
            self.tension_field.parameters[:] = self._of_tension_field()

    def _of_tension_field(self) -> Array:
        """Parameters of the wrinkling orthotropic materials, in the order of tags."""
        own = sorted(self.materials.items())
        wrinkle = [m.parameters for _, m in own if m.law == ORTHOTROPIC_TENSION_FIELD]
        return np.array(wrinkle)

    def _on(self, tag: int, dx: ufl.Measure) -> ufl.Measure:
        return dx if self.cell_tags is None else dx(tag)

    def _variation(self, v: Any, q: Any, dx: ufl.Measure) -> Any:
        """The form of energy and gradient, as `Integral` needs it."""
        variation: Any = 0
        for tag, (law, kinematics) in self.terms.items():
            work = ufl.inner(law.stress, kinematics.strain_variation(v))
            variation += self._part * (law.energy * q + work) * self._on(tag, dx)
        return variation

    def _stiffness(self, inputs: FormInputs | None) -> ufl.Form:
        """The form of the stiffness, positive semidefinite."""
        V = self.u.function_space
        v, du = ufl.TestFunction(V), ufl.TrialFunction(V)
        dx = counting_cells(V.mesh, inputs, self.cell_tags)
        stiffness: Any = 0
        for tag, (law, kinematics) in self.terms.items():
            linear = self.materials[tag].law == LINEAR
            a, b = kinematics.strain_variation(v), kinematics.strain_variation(du)
            compressible = linear or self.materials[tag].law == UFL_LAW
            S = law.stress
            if compressible:
                tensile = tensile_part(S)
                S = tensile + self.stiffening.compression * (S - tensile)
            S = S + self.stiffening.prestress * ufl.Identity(2)
            dv = [ufl.dot(ufl.grad(v), e) for e in kinematics.basis]
            ddu = [ufl.dot(ufl.grad(du), e) for e in kinematics.basis]
            geometric = sum(S[i, j] * ufl.dot(dv[i], ddu[j]) for i in (0, 1) for j in (0, 1))
            material_part = law.tangent(a, b)
            if not linear:
                material_part += self.stiffening.floor * law.taut_tangent(a, b)
            stiffness += self._part * (material_part + geometric) * self._on(tag, dx)
        return stiffness

    def _tension_field(self, cells: npt.NDArray[np.int32]) -> TensionField | None:
        """The law of the owned cells that wrinkle and are orthotropic; None without any."""
        wanted = sorted(
            tag for tag, own in self.materials.items() if own.law == ORTHOTROPIC_TENSION_FIELD
        )
        if not wanted:
            return None
        from crms_fenicsx.energy.terms.compiled_laws import TensionField

        tags = self.material_tags(cells)
        own = np.isin(tags, wanted)
        parameters = self._of_tension_field()
        row = np.searchsorted(wanted, tags[own]).astype(np.int32)
        cells = cells[own]
        duals, rest = self.material_axes(cells), self.rest_strains(cells)
        axes = duals if self.frames is None else self.frames[cells]
        return TensionField(self.u, cells, axes, duals, rest, parameters, row)

    def _sewn_fields(self, frames: Array) -> tuple[fem.Function, fem.Function, fem.Function]:
        """Area ratios of the cells' own shapes to those in the mesh, and both frame vectors."""
        mesh = self.u.function_space.mesh
        weight = fem.Function(self.plain.function_space)
        weight.x.array[:] = own_areas(frames)
        vectors = fem.functionspace(mesh, ("DG", 0, (3,)))
        first, second = fem.Function(vectors), fem.Function(vectors)
        for axis, values in zip((first, second), np.moveaxis(frames, 1, 0), strict=True):
            axis.x.array[:] = values.ravel()
        return weight, first, second

    def rest_strains(self, cells: Indices) -> Array:
        """Strains (n, 3) of cells in the mesh: 0 if it is their stress-free shape."""
        if self.frames is None:
            return np.zeros((len(cells), 3))
        g = self.frames[cells]
        G = np.einsum("nai,nbi->nab", g, g)
        return np.stack([(G[:, 0, 0] - 1) / 2, (G[:, 1, 1] - 1) / 2, G[:, 0, 1]], axis=1)

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        if self._inputs("stiffness") is not None:
            self._pattern.form = self._bound_stiffness()
        self._pattern.attach(unknowns)

    def sums(self, x: Array, out: Array) -> None:
        out[0] = self.integral.value

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        self.unknowns.add_to_vertices(self.integral.gradient, g)

    def rounding(self, x: Array, sums: Array) -> float:
        """Squared norm of the rounding errors of forces at this rank's vertices. A cell's forces
        are its section force times its size; the squared sizes sum up to the area. The section
        force is the prestress plus that of displacement gradients estimated as the largest
        displacement over a quarter of the membrane."""
        if self._area == 0.0:
            return 0.0
        gradient = 4 * float(np.abs(self.u.x.array).max(initial=0.0)) / self._area**0.5 + self._rest
        force = self._prestress + self._modulus * gradient
        return self._area * (4 * EPSILON * force) ** 2

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        if self.tension_field is not None:
            self.tension_field.update_tangents()
        self._pattern.add(A)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        with self.stiffening.none():
            self.add_stiffness(x, sums, A)

    @property
    def links(self) -> Indices:  # type: ignore[override]
        """Vertex pairs along the sides of cells, if cells can be relaxed separately."""
        none = np.zeros((0, 2), dtype=np.int32)
        return none if self.elementwise is None else self.edges()

    def edges(self) -> Indices:
        """Blocks of the vertices of all local edges, (n, 2)."""
        return self.unknowns.vertex_blocks()[self._edge_dofs]

    @cached_property
    def _edge_dofs(self) -> Indices:
        """Local degrees of freedom of these vertices, the same in all layouts."""
        return edge_ends(self.u.function_space)

    def cell_results(self) -> Array:
        """Strain (E11, E22, 2 E12), section forces (S11, S22, S12) and state of the owned cells, in
        the material axes, (n, 7), as in `FoldedMembraneEnergy.results`; folded cells are treated as
        plain. Collective: the first call compiles."""
        mesh = self.u.function_space.mesh
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        tags = self.material_tags(cells)
        results = np.zeros((len(cells), 7))
        if self.tension_field is not None:
            self.tension_field.update()
        for tag, (law, kinematics) in self.terms.items():
            if tag not in self._cell_values:
                E, S = kinematics.strain(), law.stress
                values = [E[0, 0], E[1, 1], 2 * E[0, 1], S[0, 0], S[1, 1], S[0, 1], law.state]
                # One point is enough, as all values are constant in a cell.
                self._cell_values[tag] = fem.Expression(
                    ufl.as_vector(values), np.array([[1 / 3, 1 / 3]])
                )
            own = cells[tags == tag]
            results[own] = self._cell_values[tag].eval(mesh, own).reshape(len(own), 7)
        return results

    def material_tags(self, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Material tag of each cell, (n,)."""
        if self.cell_tags is None:
            return np.full(len(cells), next(iter(self.materials)), dtype=np.int32)
        order = np.searchsorted(self.cell_tags.indices, cells)
        return np.asarray(self.cell_tags.values[order], dtype=np.int32)

    def moduli(self, cells: npt.NDArray[np.int32]) -> Array:
        """Reference moduli of the cells' materials, (n,) (force per length)."""
        tags, material = np.unique(self.material_tags(cells), return_inverse=True)
        moduli = [self.materials[int(tag)].reference_modulus for tag in tags]
        return np.array(moduli, dtype=float)[material]

    def laws(self, cells: npt.NDArray[np.int32]) -> tuple[Indices, Array]:
        """Stress laws (n,) of the cells, and their parameters (n, N_PARAMETERS)."""
        tags, material = np.unique(self.material_tags(cells), return_inverse=True)
        materials = [self.materials[int(tag)] for tag in tags]
        laws = np.array([own.law for own in materials], dtype=np.int32)
        parameters = np.array([own.parameters for own in materials]).reshape(-1, N_PARAMETERS)
        return laws[material], parameters[material]

    def material_axes(self, cells: npt.NDArray[np.int32]) -> Array:
        """Dual in-plane axes 1 and 2 of the cells, (n, 2, 3): their products with vectors in the
        mesh are components in the stress-free shape."""
        if self.frames is not None:
            return dual_axes(self.frames[cells])
        mesh = self.u.function_space.mesh
        x = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
        first: Array = np.asarray(x[:, 1] - x[:, 0], dtype=float)
        for tag, warp in self.warps.items():
            if warp is not None:
                own = self.material_tags(cells) == tag
                first[own] = warp.x.array.reshape(-1, 3)[cells[own]]
        first /= np.linalg.norm(first, axis=1)[:, None]
        return np.stack([first, cross(cell_normals(mesh, cells), first)], axis=1)
