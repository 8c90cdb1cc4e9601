"""Air pressure on plain cells as an exact follower load (section 2.4), and on a sliding rim.

The volume V under the membrane, measured from a point c, has the exact pressure forces as its
gradient only in the interior; at an edge a -> b of the rim each of its vertices lacks the force

    f = (a - c) x (b - c) / 6

for a unit pressure. Held vertices do not need it. If both are held in a direction k at the same
height h above c, as in a plane of symmetry, f without its component along k is the gradient of

    -h / 6 (a_i b_j - a_j b_i),    i, j the directions that follow k,

the volume between the plane and c. At an end v of a chain of such edges (v_j, -v_i) h / 6 remains.
If i or j is held as well, at a corner with another plane or on a held edge, this is the gradient of
-+ h / 6 v_i v_j. All these are products of three coordinates; they make the result independent of
c.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from crms_fenicsx.energy.terms.integral import FormInputs, Integral
from crms_fenicsx.energy.terms.kinematics import Kinematics, tangent_basis
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, BlockSink
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE


def volume_pattern(corners: Indices) -> BlockPattern:
    """Second derivatives of the volumes under facets with `corners` (n, 3): a skew value for each
    corner, by the two others; those by the same corner twice vanish."""
    rows, cols = corners[:, [1, 2, 2, 0, 0, 1]], corners[:, [2, 1, 0, 2, 1, 0]]
    return BlockPattern(rows.ravel(), cols.ravel(), np.tile([1.0, -1.0], (corners.size, 1)))


class FollowerPressure(EnergyTerm):
    """Potential ``-p (V - V0)`` of a uniform pressure, with the volume V under the membrane.

    Its gradient is the pressure's exact nodal forces, normal to the current surface, if the
    `open_edges` are held; for edges that slide in planes `RimPressure` adds the missing part. V is
    measured from `origin`; V0 is that of the stress-free surface of the mesh as given, so that the
    energy is the work done since, independent of the origin.

    Attributes: `integral`: the volume gained, and the gradient of the potential; `moved`: this
    rank's part of `moved_volume`. Shapes and units: pressure (force per area), origin (3,)
    (length).
    """

    name = "pressure"
    exact_hessian = True
    integral: Integral
    moved = 0.0

    def __init__(
        self,
        u: fem.Function,
        cells: fem.Function,
        pressure: fem.Constant,
        origin: Array,
    ) -> None:
        self.u, self.cells, self.pressure = u, cells, pressure
        self.origin = fem.Constant(u.function_space.mesh, origin)
        inputs = FormInputs("pressure", (u, cells), (pressure, self.origin), (cells,))
        self.integral = Integral(u.function_space, self._variation, inputs=inputs)

    def _variation(self, v: Any, q: Any, dx: ufl.Measure) -> Any:
        """The form of volume and forces for `Integral`."""
        e1, e2 = tangent_basis(self.u.function_space.mesh, None)
        F = Kinematics(self.u, (e1, e2)).F
        X = ufl.SpatialCoordinate(self.u.function_space.mesh) - self.origin
        # V - V0 per area, term by term, so that small changes are not lost in a large volume.
        n0, n = ufl.cross(e1, e2), ufl.cross(F[0], F[1])
        change = ufl.dot(self.u, n) + ufl.dot(X, n - n0)
        # derivative of u . n + X . n by hand: UFL's has twice as many products
        x, dF = X + self.u, [ufl.dot(ufl.grad(v), e) for e in (e1, e2)]
        work = ufl.dot(v, n) + ufl.dot(dF[0], ufl.cross(F[1], x))
        work += ufl.dot(dF[1], ufl.cross(x, F[0]))
        return self.cells / 3 * (change * q - self.pressure * work) * dx

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        own = self.cells.x.array[: self.u.function_space.mesh.topology.index_map(2).size_local] > 0
        self._corners = unknowns.vertex_blocks()[self.u.function_space.dofmap.list[: len(own)][own]]
        self.patterns = (volume_pattern(self._corners),)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        (pattern,) = self.patterns
        places = (self.unknowns.X + x)[self._corners.ravel()] - self.origin.value
        places *= -float(self.pressure.value) / 6
        for i in range(3):  # as in `folded_pressure`
            j, k = (i + 1) % 3, (i + 2) % 3
            pattern.values[:, i, j], pattern.values[:, j, i] = places[:, k], -places[:, k]
        pattern.add(A)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained, V - V0 (length cubed)."""
        out[0] = self.integral.value + self.moved

    def energy(self, sums: Array) -> float:
        """Minus the work of the pressure since the stress-free shape (force x length)."""
        return -float(self.pressure.value) * float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Add the pressure's nodal forces, with the sign of a gradient."""
        self.unknowns.add_to_vertices(self.integral.gradient, g)


@dataclass(frozen=True)
class Rim:
    """This rank's part of the rim."""

    # (m, 3) coordinates in each product, as three times the local degree of freedom plus direction
    components: Indices
    factors: Array  # (m,) their factors in the volume
    # (n,) local degrees of freedom of vertices where the rim is free: neither held nor in a plane
    # that is held in its normal direction
    free: Indices
    sliding: Indices  # (k,) local edges that are not held, but slide in a plane


def rim_of(membrane: Membrane) -> Rim:
    """Classify a membrane's open edges by how they are held in its current shape. Collective."""
    edges, V, held = membrane.open_edges, membrane.V, membrane.held
    places, size = membrane.positions(), membrane.size
    pairs, senses = edges.vertices, edges.senses
    both = held[pairs].all(axis=1)
    level = np.abs(places[pairs[:, 0]] - places[pairs[:, 1]]) <= SAME_PLACE * size
    closed: npt.NDArray[np.bool_] = np.all(both, axis=1)
    plane = np.where(
        closed, -2, np.where(np.any(both & level, axis=1), np.argmax(both & level, axis=1), -1)
    )
    free = [pairs[plane == -1].ravel()]
    owned = edges.numbers < V.mesh.topology.index_map(1).size_local
    products: list[tuple[Indices, Array]] = [(np.zeros((0, 3), dtype=np.int32), np.zeros(0))]

    def add(factor: Array, *coordinates: tuple[Indices, int]) -> None:
        columns = [3 * dofs + direction for dofs, direction in coordinates]
        products.append((np.stack(columns, axis=1).astype(np.int32), factor / 6))

    in_planes = np.bincount(plane[owned & (plane >= 0)], minlength=3)
    for k in np.flatnonzero(membrane.comm.allreduce(in_planes)):
        i, j = (k + 1) % 3, (k + 2) % 3
        own = owned & (plane == k)
        a, b, s = pairs[own, 0], pairs[own, 1], senses[own]
        add(-s, (a, k), (a, i), (b, j))
        add(s, (a, k), (a, j), (b, i))
        ends, excess = _ends(V, a, b, s)
        free.append(ends[~held[ends][:, [i, j]].any(axis=1)])
        add(np.where(held[ends, i], -excess, excess), (ends, k), (ends, i), (ends, j))
    components, factors = (np.concatenate(parts) for parts in zip(*products, strict=True))
    loose = np.concatenate(free)
    loose = loose[~np.all(held[loose], axis=1)]
    return Rim(components, factors, loose, edges.numbers[~closed])


def _ends(V: fem.FunctionSpace, a: Indices, b: Indices, s: Array) -> tuple[Indices, Array]:
    """Owned end vertices of chains of edges, and their excess of starts over ends. Collective."""
    count = la.vector(V.dofmap.index_map, dtype=np.float64)
    np.add.at(count.array, a, s)
    np.subtract.at(count.array, b, s)
    count.scatter_reverse(la.InsertMode.add)
    excess = count.array[: V.dofmap.index_map.size_local]
    ends = np.flatnonzero(excess).astype(np.int32)
    return ends, excess[ends].copy()


class RimPressure(EnergyTerm):
    """Potential of the pressure on the volume that closes the rim. Shapes and units: pressure
    (force per area), origin (3,) (length)."""

    name = "pressure"

    def __init__(self, rim: Rim, pressure: fem.Constant, origin: Array) -> None:
        self.rim, self.pressure, self.origin = rim, pressure, origin

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        vertex, direction = np.divmod(self.rim.components, 3)
        self._at = 3 * unknowns.vertex_blocks()[vertex] + direction
        self._X = (unknowns.X - self.origin).reshape(-1)[self._at]

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the volume gained (length cubed)."""
        out[0] = self.rim.factors @ gain(self._X, x.reshape(-1)[self._at])

    def energy(self, sums: Array) -> float:
        return -float(self.pressure.value) * float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Subtract the rim's missing forces; those along held directions are meaningless."""
        y, factors = (
            self._X + x.reshape(-1)[self._at],
            -float(self.pressure.value) * self.rim.factors,
        )
        for k in range(3):
            force = factors * y[:, (k + 1) % 3] * y[:, (k + 2) % 3]
            np.add.at(g.reshape(-1), self._at[:, k], force)


def gain(X: Array, x: Array) -> Array:
    """``prod(X + x) - prod(X)`` of rows of three, without cancellation."""
    (A, B, C), (a, b, c) = X.T, x.T
    return np.asarray(a * (B + b) * (C + c) + A * (b * (C + c) + B * c))


def volume_change(X: Array, u: Array, triangles: npt.NDArray[np.integer]) -> Array:
    """Change (n,) of the volumes between triangles and the origin, without cancellation."""
    a, h = X[triangles], u[triangles]
    d, s = a[:, 1:] - a[:, :1], h[:, 1:] - h[:, :1]
    n0 = np.cross(d[:, 0], d[:, 1])
    change = np.cross(d[:, 0], s[:, 1]) + np.cross(s[:, 0], d[:, 1]) + np.cross(s[:, 0], s[:, 1])
    at, moved = a.mean(axis=1), h.mean(axis=1)
    volume: Array = np.sum(moved * (n0 + change) + at * change, axis=1) / 6
    return volume


def moved_volume(membrane: Membrane, rim: Rim) -> float:
    """This rank's part of the volume between the pressurised cells of the mesh as given and of the
    present stress-free shape (length cubed): volumes are gained since the first."""
    if membrane.moved is None:
        return 0.0
    cells, X = membrane.V.dofmap.list, membrane.given - membrane.centre
    of_cells = volume_change(X, membrane.moved, cells[membrane.pressed[: len(cells)]]).sum()
    ends = (places.reshape(-1)[rim.components] for places in (X, membrane.moved))
    return float(of_cells + rim.factors @ gain(*ends))
