"""Air pressure on the plain cells: exact follower load, or constant in a step (section 2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from crms_fenicsx.dofs.layout import Unknowns
from crms_fenicsx.energies.integral import Integral, one_point
from crms_fenicsx.energies.membrane import Kinematics, tangent_basis
from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class OpenEdges:
    """Edges at which the cells under pressure do not cancel each other, as this rank knows them.

    Attributes
    ----------
    numbers : (n,)
        Local numbers of the edges, owned ones and ghosts, sorted.
    vertices : (n, 2)
        Their vertices by local degree of freedom.
    ids : (n, 2)
        The vertices' numbers in the mesh as it was given; the first one is lower.
    senses : (n,)
        How many more cells pass from the first vertex to the second one than back.
    """

    numbers: npt.NDArray[np.int32]
    vertices: npt.NDArray[np.int32]
    ids: npt.NDArray[np.int64]
    senses: Array


def open_edges(V: fem.FunctionSpace, pressed: npt.NDArray[np.bool_]) -> OpenEdges:
    """Edges at which the cells under pressure do not cancel each other. Collective.

    The exact follower pressure has a potential only if these are held or slide in planes: each cell
    makes a volume with the origin, whose sides over an edge cancel if as many cells pass it in the
    one sense as in the other. It is not so at the rim of what is under pressure, nor at a seam of
    three.

    Parameters
    ----------
    V
        Vertex displacements.
    pressed
        Whether there is pressure on each local cell, (n,).
    """
    mesh = V.mesh
    numbers = mesh.topology.connectivity(2, 1).array.reshape(-1, 3)
    ids = cell_vertex_ids(mesh)
    sides = np.stack([np.roll(np.arange(3), -1), np.roll(np.arange(3), -2)], axis=1)
    start, end = ids[:, sides[:, 0]], ids[:, sides[:, 1]]  # side k lies opposite to k
    sense = np.where(start < end, 1.0, -1.0)
    total = la.vector(mesh.topology.index_map(1), dtype=np.float64)
    np.add.at(total.array, numbers[pressed], sense[pressed])
    total.scatter_reverse(la.InsertMode.add)
    total.scatter_forward()
    found = np.flatnonzero(total.array).astype(np.int32)
    pairs = np.zeros((len(total.array), 2), dtype=np.int32)
    named = np.zeros((len(total.array), 2), dtype=np.int64)
    order = np.where((sense > 0)[..., None], sides, sides[:, ::-1])  # (cells, 3, 2)
    pairs[numbers] = np.take_along_axis(V.dofmap.list[:, None, :], order, axis=2)
    named[numbers] = np.take_along_axis(ids[:, None, :], order, axis=2)
    return OpenEdges(found, pairs[found], named[found], total.array[found])


class FollowerPressure:
    """Potential ``-p (V - V0)`` of a uniform pressure, V the volume under the membrane.

    Its gradient is the pressure's exact nodal forces, normal to the current surface, as long as
    the `open_edges` are held; where they slide in planes `crms_fenicsx.energies.pressure_rim` has what is missing. V
    is counted from `origin`; V0 is that of the stress-free surface, so that the energy is the work
    done since and does not depend on the origin.

    Parameters
    ----------
    u
        Vertex displacements.
    cells
        1 in the plain cells under pressure, 0 in others (piecewise constant).
    pressure
        Pressure (force per area) along the surface's normals.
    origin
        Point (3,) from which volumes are counted (length).

    Attributes
    ----------
    integral : Integral
        The volume gained, and the gradient of the potential.
    """

    name = "pressure"
    n_sums = 1

    def __init__(
        self,
        u: fem.Function,
        cells: fem.Function,
        pressure: fem.Constant,
        origin: Array,
    ) -> None:
        mesh = u.function_space.mesh
        self.pressure = pressure
        e1, e2 = tangent_basis(mesh, None)
        F = Kinematics(u, (e1, e2)).F
        self.origin = fem.Constant(mesh, origin)
        X = ufl.SpatialCoordinate(mesh) - self.origin
        # V - V0 per area, term by term, so that a small change is not lost in a large volume.
        n0, n = ufl.cross(e1, e2), ufl.cross(F[0], F[1])
        change = ufl.dot(u, n) + ufl.dot(X, n - n0)
        x = X + u

        def variation(v: Any, q: Any, dx: ufl.Measure) -> Any:
            # of u . n + X . n, by hand: UFL's derivative has twice as many products
            dF = [ufl.dot(ufl.grad(v), e) for e in (e1, e2)]
            work = ufl.dot(v, n) + ufl.dot(dF[0], ufl.cross(F[1], x))
            work += ufl.dot(dF[1], ufl.cross(x, F[0]))
            return cells / 3 * (change * q - pressure * work) * dx

        self.integral = Integral(u.function_space, variation)

    def attach(self, unknowns: Unknowns) -> None:
        """Use this layout."""
        self.unknowns = unknowns

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained, V - V0 (length cubed)."""
        out[0] = self.integral.value

    def energy(self, sums: Array) -> float:
        """Minus the work of the pressure since the stress-free shape (force x length)."""
        return -float(self.pressure.value) * float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the pressure's nodal forces, with the sign of a gradient."""
        self.unknowns.add_to_vertices(self.integral.gradient, g)


class StepPressure:
    """The paper's pressure: nodal forces that keep direction and size in a step, (2.4-1, 2).

    A node carries a third of the area of each of its cells. The volume is summed up step by step,
    which is exact only as the steps get small. It needs no held edges.
    Parameters are those of `FollowerPressure`.

    Attributes
    ----------
    volume_n
        Volume gained in all steps before (length cubed).
    """

    name = "pressure"
    n_sums = 1

    def __init__(self, u: fem.Function, cells: fem.Function, pressure: fem.Constant) -> None:
        mesh, V = u.function_space.mesh, u.function_space
        self.pressure = pressure
        self.u = u
        self.u_n = fem.Function(V)
        F = Kinematics(self.u_n, tangent_basis(mesh, None)).F
        n = ufl.cross(F[0], F[1])
        dx = one_point(mesh)
        self._volume = fem.form(cells * ufl.dot(n, u - self.u_n) * dx)
        self._force = fem.form(cells * ufl.dot(n, ufl.TestFunction(V)) * dx)
        self._forces, self._scaled = np.zeros_like(u.x.array), np.zeros_like(u.x.array)
        self.volume_n = 0.0

    def attach(self, unknowns: Unknowns) -> None:
        """Use this layout."""
        self.unknowns = unknowns

    def begin_step(self, x: Array) -> None:
        """Take the current shape as the step's start."""
        self.u_n.x.array[:] = self.u.x.array
        self._forces[:] = 0.0
        fem.assemble_vector(self._forces, self._force)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained in the step (length cubed)."""
        out[0] = fem.assemble_scalar(self._volume)

    def energy(self, sums: Array) -> float:
        """``-p (V - V0)``, with the volume gained over all steps (force x length)."""
        return -float(self.pressure.value) * (self.volume_n + float(sums[0]))

    def commit(self, x: Array, sums: Array) -> None:
        """End the step: keep its volume."""
        self.volume_n += float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Subtract the step's nodal forces."""
        np.multiply(self._forces, -float(self.pressure.value), out=self._scaled)
        self.unknowns.add_to_vertices(self._scaled.reshape(-1, 3), g)
