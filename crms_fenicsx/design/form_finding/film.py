"""A film of prescribed section forces and its inner pressure."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from crms_fenicsx.energy.terms.integral import FormInputs, compiled_form, one_point
from crms_fenicsx.energy.terms.kinematics import Kinematics, tangent_basis
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.model.membrane import Membrane


class Film:
    """A film whose section forces per current length stay constant while the mesh moves.

    Forces per length s1 along the warp and s2 across it do the virtual work

        R(v) = int_a (s2 I + (s1 - s2) w w) : grad(v) da,   w = P d / |P d|,

    over the current surface, with the projection w of a direction d in space. The stiffness is its
    exact derivative, or that of the updated reference strategy, int S : grad(v)^T grad(w) da with
    constant stress S, which is positive definite (K.-U. Bletzinger and E. Ramm, Int. J. Space
    Structures 14, 1999; for soap films U. Pinkall and K. Polthier, Experimental Math. 2, 1993).

    A film does not determine the place of its vertices within the surface. An elastic sheet on
    them can: it has the strain of small displacements `sheet`, which move no vertex, and a
    stiffness E t of the mean section force. Positions `start` (n, 3) (length) count from `origin`.
    """

    def __init__(self, membrane: Membrane, forces: Array, directions: Array, origin: Array) -> None:
        self.comm, self.V, self.u = membrane.comm, membrane.V, membrane.u
        domain = self.V.mesh
        self.start: Array = membrane.stress_free - origin
        start = fem.Function(self.V)
        start.x.array[:] = self.start.ravel()
        self.sheet = fem.Function(self.V)
        constants = fem.functionspace(domain, ("DG", 0))
        s1, s2 = fem.Function(constants), fem.Function(constants)
        d = fem.Function(fem.functionspace(domain, ("DG", 0, (3,))))
        s1.x.array[:], s2.x.array[:] = forces.T
        d.x.array[:] = directions.ravel()
        largest = float(np.max(forces, initial=0.0))
        self.largest = membrane.comm.allreduce(largest, op=MPI.MAX)
        self.isotropic = not membrane.comm.allreduce(bool(np.ptp(forces, axis=1).any()), op=MPI.LOR)
        self._exact, self._pressure = (fem.Constant(domain, np.float64(0.0)) for _ in range(2))
        self._inputs = FormInputs(
            ("film", self.isotropic),
            (self.u, start, self.sheet, s1, s2, d),
            (self._exact, self._pressure),
        )
        spaces = {"force": [self.V], "growth": [self.V], "volume": [], "area": []}
        self._forms: dict[str, Any] = {name: self._form(name, of) for name, of in spaces.items()}
        for name in ("stiffness", "elastic"):
            self._forms[name] = self._form(name, [self.V, self.V])
        self.matrix, self.elastic = (
            fem_petsc.create_matrix(self._forms["stiffness"]) for _ in range(2)
        )
        self._sum = la.vector(self.V.dofmap.index_map, 3, dtype=np.float64)

    def _form(self, name: str, spaces: list[fem.FunctionSpace]) -> fem.Form:
        """A form, which is written where it has not been compiled before."""
        key = self._inputs.key, name
        return compiled_form(replace(self._inputs, key=key), spaces, lambda: self._written[name])

    @cached_property
    def _written(self) -> dict[str, Any]:
        """Forms, and stress and sides of the cells, in UFL."""
        _, start, sheet, s1, s2, d = self._inputs.functions
        basis, dx = tangent_basis(self.V.mesh, None), one_point(self.V.mesh)
        F = Kinematics(self.u, basis).F
        C = ufl.as_matrix([[ufl.dot(a, b) for b in F] for a in F])
        inverse, J = ufl.inv(C), ufl.sqrt(ufl.det(C))
        # second Piola-Kirchhoff section forces of the start mesh
        S: Any = s2 * J * inverse
        if not self.isotropic:
            along = inverse * ufl.as_vector([ufl.dot(a, d) for a in F])
            S += (s1 - s2) * J / ufl.dot(along, C * along) * ufl.outer(along, along)
        v, w = ufl.TestFunction(self.V), ufl.TrialFunction(self.V)
        dv, dw, of_sheet = ([ufl.dot(ufl.grad(f), e) for e in basis] for f in (v, w, sheet))

        def elastic(d: Any) -> Any:
            """Section forces of the sheet by displacements with these derivatives."""
            strain = [[ufl.dot(F[i], d[j]) + ufl.dot(F[j], d[i]) for j in (0, 1)] for i in (0, 1)]
            return (s1 + s2) / 4 * J * inverse * ufl.as_matrix(strain) * inverse

        S, K = S + elastic(of_sheet), elastic(dw)
        pairs = [(i, j) for i in (0, 1) for j in (0, 1)]
        force: Any = sum(S[i, j] * ufl.dot(F[i], dv[j]) for i, j in pairs) * dx
        elastic_force: Any = sum(K[i, j] * ufl.dot(F[i], dv[j]) for i, j in pairs) * dx
        held: Any = sum(S[i, j] * ufl.dot(dw[i], dv[j]) for i, j in pairs) * dx
        volume: Any = ufl.dot(start + self.u, ufl.cross(*F)) / 3 * dx
        growth: Any = ufl.dot(v, ufl.cross(*F)) * dx  # derivative of the volume inside the rim
        exact = ufl.derivative(force - self._pressure * growth, self.u, w)
        stiffness = (1 - self._exact) * held + self._exact * exact
        stress = ufl.as_vector([S[i, j] / J for i, j in ((0, 0), (0, 1), (1, 1))])
        sides = ufl.as_vector([A[i] for A in F for i in range(3)])
        return {
            "force": force, "volume": volume, "growth": growth, "area": J * dx,
            "stiffness": stiffness, "elastic": elastic_force, "stress": stress,
            "sides": sides,
        }  # fmt: skip

    @cached_property
    def _cell_values(self) -> list[fem.Expression]:
        """Stress and sides of the cells."""
        middle, names = np.array([[1 / 3, 1 / 3]]), ("stress", "sides")
        return [fem.Expression(self._written[name], middle) for name in names]

    def area(self) -> float:
        """Area of the current surface (length squared). Collective."""
        return float(self.comm.allreduce(fem.assemble_scalar(self._forms["area"])))

    def volume(self) -> float:
        """Volume between the surface and the origin (length cubed). Collective."""
        return float(self.comm.allreduce(fem.assemble_scalar(self._forms["volume"])))

    def forces(self) -> Array:
        """Nodal forces of film and sheet on this rank's vertices, (n, 3). Collective."""
        return self._vector("force")

    def growth(self) -> Array:
        """Derivatives of the volume by this rank's vertices, (n, 3) (length squared).
        Collective."""
        return self._vector("growth")

    def _vector(self, name: str) -> Array:
        array = self._sum.array
        array[:] = 0.0
        fem.assemble_vector(array, self._forms[name])
        return self.gathered(array.reshape(-1, 3))

    def gathered(self, local: Array) -> Array:
        """Sum vertex vectors, (n, 3) with ghosts, on their owners. Collective."""
        self._sum.array[:] = local.ravel()
        self._sum.scatter_reverse(la.InsertMode.add)
        n = self.V.dofmap.index_map.size_local
        return self._sum.array[: 3 * n].reshape(n, 3).copy()

    def positions(self) -> Array:
        """Current positions of the vertices from `origin`, (n, 3), with ghosts (length)."""
        return self.start + self.u.x.array.reshape(-1, 3)

    def assemble(self, *, exact: bool, pressure: float = 0.0) -> None:
        """Assemble the stiffness, ready for cables to be added; pressure (force per area)."""
        self._exact.value, self._pressure.value = float(exact), pressure
        self.matrix.zeroEntries()
        fem_petsc.assemble_matrix(self.matrix, self._forms["stiffness"])

    def assemble_elastic(self) -> None:
        """Assemble the stiffness of the elastic sheet."""
        self.elastic.zeroEntries()
        fem_petsc.assemble_matrix(self.elastic, self._forms["elastic"])
        self.elastic.assemble()

    def section_forces(self) -> Array:
        """True section forces of this rank's cells as tensors in space, (n, 3, 3)."""
        cells = np.arange(len(self.V.dofmap.list), dtype=np.int32)
        stress, F = (
            np.asarray(value.eval(self.V.mesh, cells)).reshape(len(cells), width)
            for value, width in zip(self._cell_values, (3, 6), strict=True)
        )
        S, sides = stress[:, [0, 1, 1, 2]].reshape(-1, 2, 2), F.reshape(-1, 2, 3)
        return np.asarray(np.einsum("nij,nia,njb->nab", S, sides, sides))


class Inflation:
    """The inner pressure (force per area), given or sought for a volume or a rise.

    `gap`, `gap_slope`, `size`: error of volume or rise, its derivatives by this rank's vertices
    (n, 3), and its reference value.
    """

    def __init__(
        self,
        film: Film,
        free: Booleans,
        pressure: float | None,
        volume: float | None = None,
        rise: float | None = None,
    ) -> None:
        self.film, self.pressure = film, pressure or 0.0
        self.is_found = volume is not None or rise is not None
        self.acts = self.is_found or pressure is not None
        self._volume, self._rise, self._free = volume, rise, free
        self.size = (volume if volume is not None else rise) or 1.0
        self.gap = 0.0
        self.growth: Array = np.zeros((0, 3))
        self.gap_slope: Array = np.zeros((0, 3))

    def measure(self, x: Array) -> None:
        """Measure volume and rise. Collective. Shapes and units: x (n, 3) (length)."""
        self.growth = self.film.growth()
        if self._volume is not None:
            self.gap, self.gap_slope = self.film.volume() - self._volume, self.growth
        elif self._rise is not None:
            x, comm = x[: len(self.growth)], self.film.comm
            # on a flat mesh all vertices are equally high: take the central one
            away = np.linalg.norm(x, axis=1)
            heights = np.where(self._free, x[:, 2] - 1e-6 * away, -np.inf)
            own = (float(np.max(heights, initial=-np.inf)), comm.rank)
            _, rank = comm.allreduce(own, op=MPI.MAXLOC)
            top, self.gap_slope = 0.0, np.zeros_like(self.growth)
            if comm.rank == rank:
                crown = int(np.argmax(heights))
                top, self.gap_slope[crown, 2] = float(x[crown, 2]), 1.0
            self.gap = comm.bcast(top, root=rank) - self._rise
