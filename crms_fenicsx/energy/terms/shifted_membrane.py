"""Cells with corners whose stress-free places shift: energy E(x, X) of both places.

The vertices of a cable that slides along a line of the mesh have two displacements, u of the vertex
and w of its stress-free place, both from the mesh. In axes that stay those of the cell in the mesh,
its stress-free sides are ``F0 = sides + axes . (differences of w)``, (2, 2), linear in w. With the
current sides L, (3, 2), the image of the axes is F = L F0^-1, and the energy is

    E = A psi(e) + b . G v,    A = det(F0) / 2,    e = (F^T F - 1) / 2.

b is a third of the load on the cell in the mesh, which `NodalForces` hold at each corner, v the sum
of the corners' shifts w in the axes, and G what F is at w = 0: the load stays on the fabric that
was at the corner, which is now by about G w away. Let n_c be the gradient of corner c's shape
function in F0, m_c that at w = 0, S the section forces, P = F S, f_c = A P n_c. Then

    dE/dx_c = f_c + (m_c . v) b,    dE/dX_c = A psi n_c - F^T f_c + G^T b.

A variation enters F as ``(dx_c - F dX_c) n_c^T`` only: a variation of X is one of x by -F dX. With
``K_cd = A (B_c^T C B_d + n_c . S n_d)``, the stiffness of plain cells, and s_cd = 1 for corners
(0, 1), (1, 2), (2, 0), -1 for the reverse, 0 on the diagonal, J = ((0, 1), (-1, 0)):

    d2E/dx_c dx_d = K_cd
    d2E/dx_c dX_d = -K_cd F + s_cd P J / 2 + b m_c^T
    d2E/dX_c dX_d = F^T K_cd F + s_cd (psi - S : F^T F) J / 2

With b = 0 and without the parts with s_cd it is positive semidefinite wherever K is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numba
import numpy as np

from crms_fenicsx.energy.terms import compiled_laws as laws
from crms_fenicsx.energy.terms.kinematics import Stiffening, dual_axes
from crms_fenicsx.energy.terms.term import ElementTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockSink, ElementPattern
from crms_fenicsx.foundation.dofs.layout import ElementTable
from crms_fenicsx.foundation.meshes.triangles import cell_sides
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.model.tolerances import UNSTRAINED

if TYPE_CHECKING:
    from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy


@dataclass(frozen=True)
class ShiftedCells(ElementTable):
    """This rank's cells with shifted corners."""

    cells: Indices  # (n,) local cell numbers
    corners: Indices  # (n, 3) blocks of the corners, in the cell's order
    shifts: Indices  # (n, 3) blocks of their stress-free places, -1 where these stay
    sides: Array  # (n, 2, 2) stress-free sides from corner 0 to 1 and 2 in the axes, at w = 0
    axes: Array  # (n, 2, 3) the axes in space, as `MembraneEnergy.material_axes`
    # laws (n,), parameters (n, N_PARAMETERS): stress law and `MembraneMaterial.parameters`
    laws: Indices
    parameters: Array
    loads: Array  # (n, 3) a third of each cell's load (force), to be set as loads change
    # (n, 3) section forces beside the law's, S11, S22, S12 in the axes, to be set with the places
    residual: Array
    addresses = ("corners", "shifts")

    @classmethod
    def of(
        cls, membrane: MembraneEnergy, cells: Indices, corners: Indices, shifts: Indices
    ) -> ShiftedCells:
        """Some cells of a membrane, without loads; all arguments as the fields."""
        axes = membrane.material_axes(cells)
        given = cell_sides(membrane.u.function_space.mesh, cells)
        sides = np.stack([given[:, 0], -given[:, 2]], axis=1)
        return cls(
            cells,
            corners,
            shifts,
            np.einsum("nki,nai->nka", sides, axes),
            axes,
            *membrane.laws(cells),
            *np.zeros((2, len(cells), 3)),
        )

    @property
    def areas(self) -> Array:
        """Stress-free areas at w = 0, (n,)."""
        a, b = self.sides[:, 0], self.sides[:, 1]
        areas: Array = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        return areas

    @property
    def slopes(self) -> Array:
        """Gradients m_c (n, 3, 2) of the corners' shape functions at w = 0 (1 / length)."""
        inner = np.linalg.inv(self.sides).transpose(0, 2, 1)
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)

    @property
    def rest(self) -> Array:
        """Squared sides 1, 2 and product (n, 3) in the mesh, less those of `sides`: zero but for
        cells with a stress-free shape of their own."""
        frames = dual_axes(self.axes)
        change = np.einsum("nai,nbi->nab", frames, frames) - np.eye(2)
        change[np.abs(change) < UNSTRAINED] = 0.0
        change = np.einsum("nka,nab,nlb->nkl", self.sides, change, self.sides)
        return np.stack([change[:, 0, 0], change[:, 1, 1], change[:, 0, 1]], axis=1)

    @cached_property
    def element_blocks(self) -> tuple[Indices, Indices]:
        """Blocks of each cell in CSR form, corners first: pointers, blocks."""
        every = np.concatenate([self.corners, self.shifts], axis=1)
        there = every >= 0
        pointers = np.append(0, np.cumsum(there.sum(axis=1)))
        return pointers.astype(np.int32), every[there].astype(np.int32)

    def renumbered(self, number: Indices) -> ShiftedCells:
        """The same cells with renumbered blocks: block b becomes ``number[b]``."""
        shifts = np.where(self.shifts < 0, -1, number[self.shifts]).astype(np.int32)
        return replace(self, corners=number[self.corners], shifts=shifts)


@numba.njit(cache=True)
def _minus(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit(cache=True)
def _plus(a, b):  # type: ignore[no-untyped-def]
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True)
def _shift(x, block):  # type: ignore[no-untyped-def]
    """Displacement of a block, zero for none."""
    return (x[block, 0], x[block, 1], x[block, 2]) if block >= 0 else (0.0, 0.0, 0.0)


@numba.njit(cache=True)
def _evaluate(  # type: ignore[no-untyped-def]
    X, x, corners, shifts, sides, axes, rest, first, loads, residual, law, p, areas, slopes,
    images, sums, pulls, densities, out, forces, orthotropic,
):  # fmt: skip
    """Energy of all cells; areas A (n,), gradients n_c `slopes` (n, 3, 2), columns of F `images`
    (n, 2, 3), v `sums` (n, 2), G^T b `pulls` (n, 2), psi `densities` (n,), strain, stress and state
    `out` (n, 7), section forces with the residual ones `forces` (n, 3). For a cell without a
    positive stress-free area the energy is NaN, which no line search accepts, as it does infinity
    if it compares changes with the energy."""
    e, s, energy = np.empty(3), np.empty(3), 0.0
    for c in range(len(corners)):
        i, j, k = corners[c]
        n, side, m = slopes[c], sides[c], axes[c]
        # edges 1 and 2 from corner 0: in the mesh, their changes, and now; w at all corners
        A1, A2 = _minus(X[j], X[i]), _minus(X[k], X[i])
        u1, u2 = _minus(x[j], x[i]), _minus(x[k], x[i])
        a1, a2 = _plus(A1, u1), _plus(A2, u2)
        w0, w1, w2 = _shift(x, shifts[c, 0]), _shift(x, shifts[c, 1]), _shift(x, shifts[c, 2])
        d1, d2 = _minus(w1, w0), _minus(w2, w0)
        h10, h11, h20, h21 = _dot(m[0], d1), _dot(m[1], d1), _dot(m[0], d2), _dot(m[1], d2)
        f10, f11, f20, f21 = side[0, 0] + h10, side[0, 1] + h11, side[1, 0] + h20, side[1, 1] + h21
        D = f10 * f21 - f11 * f20
        if not D > 0.0:
            energy = np.nan
            areas[c] = densities[c] = 0.0
            n[:], images[c], sums[c], pulls[c], out[c], forces[c] = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            continue
        # changes of squared sides and product, as differences would cancel at small strains
        g1 = rest[c, 0] + _dot(_plus(a1, A1), u1)
        g1 -= (f10 + side[0, 0]) * h10 + (f11 + side[0, 1]) * h11
        g2 = rest[c, 1] + _dot(_plus(a2, A2), u2)
        g2 -= (f20 + side[1, 0]) * h20 + (f21 + side[1, 1]) * h21
        g12 = rest[c, 2] + _dot(a1, u2) + _dot(u1, A2)
        g12 -= f10 * h20 + f11 * h21 + h10 * side[1, 0] + h11 * side[1, 1]
        inverse = 1.0 / D
        n10, n11, n20, n21 = f21 * inverse, -f20 * inverse, -f11 * inverse, f10 * inverse
        n[0, 0], n[0, 1], n[1, 0], n[1, 1] = -n10 - n20, -n11 - n21, n10, n11
        n[2, 0], n[2, 1] = n20, n21
        e[0] = 0.5 * (g1 * n10 * n10 + g2 * n20 * n20) + g12 * n10 * n20
        e[1] = 0.5 * (g1 * n11 * n11 + g2 * n21 * n21) + g12 * n11 * n21
        e[2] = g1 * n10 * n11 + g2 * n20 * n21 + g12 * (n10 * n21 + n11 * n20)
        for q in range(3):
            images[c, 0, q] = a1[q] * n10 + a2[q] * n20
            images[c, 1, q] = a1[q] * n11 + a2[q] * n21
        density, state = laws.stress(law[c], p[c], e, s, orthotropic)
        density += _dot(residual[c], e)
        w = _plus(_plus(w0, w1), w2)
        v0, v1 = _dot(m[0], w), _dot(m[1], w)
        sums[c, 0], sums[c, 1] = v0, v1
        areas[c], densities[c] = 0.5 * D, density
        energy += areas[c] * density
        b1, b2 = _dot(loads[c], a1), _dot(loads[c], a2)
        for q in range(2):
            pulls[c, q] = b1 * first[c, 1, q] + b2 * first[c, 2, q]
        energy += v0 * pulls[c, 0] + v1 * pulls[c, 1]
        for q in range(3):
            out[c, q], out[c, 3 + q] = e[q], s[q]
            forces[c, q] = s[q] + residual[c, q]
        out[c, 6] = state
    return energy


@numba.njit(cache=True)
def _add_forces(  # type: ignore[no-untyped-def]
    corners, shifts, axes, first, loads, areas, slopes, images, sums, pulls, densities, forces, g
):
    """Add the gradient at the last `_evaluate` to g, (n_blocks, 3)."""
    P, f = np.empty((2, 3)), np.empty(3)
    for c in range(len(corners)):
        n, F, A, load = slopes[c], images[c], areas[c], loads[c]
        for m in range(3):
            P[0, m] = A * (forces[c, 0] * F[0, m] + forces[c, 2] * F[1, m])
            P[1, m] = A * (forces[c, 2] * F[0, m] + forces[c, 1] * F[1, m])
        for k in range(3):
            part = first[c, k, 0] * sums[c, 0] + first[c, k, 1] * sums[c, 1]
            t0 = A * densities[c] * n[k, 0] + pulls[c, 0]
            t1 = A * densities[c] * n[k, 1] + pulls[c, 1]
            for m in range(3):
                f[m] = n[k, 0] * P[0, m] + n[k, 1] * P[1, m]
                t0 -= F[0, m] * f[m]
                t1 -= F[1, m] * f[m]
                g[corners[c, k], m] += f[m] + part * load[m]
            if shifts[c, k] >= 0:
                for m in range(3):
                    g[shifts[c, k], m] += axes[c, 0, m] * t0 + axes[c, 1, m] * t1


@numba.njit(cache=True)
def _tensile(s0, s1, s2):  # type: ignore[no-untyped-def]
    """(S11, S22, S12) with negative principal values set to zero."""
    mean, half = 0.5 * (s0 + s1), 0.5 * (s0 - s1)
    radius = math.sqrt(half * half + s2 * s2)
    if mean - radius >= 0.0:
        return s0, s1, s2
    if mean + radius <= 0.0:
        return 0.0, 0.0, 0.0
    sphere, share = 0.5 * (mean + radius), 0.5 * (mean + radius) / radius
    return sphere + share * half, sphere - share * half, share * s2


@numba.njit(cache=True)
def _put(out, size, i, j, U, V, h00, h01, h10, h11, level):  # type: ignore[no-untyped-def]
    """Put ``U^T h V + level`` into block i, j of a cell's dense blocks (size^2, 3, 3), and its
    transpose into j, i. Shapes: U, V (2, 3)."""
    block, mirrored = out[i * size + j], out[j * size + i]
    for b in range(3):
        v0, v1 = h00 * V[0, b] + h01 * V[1, b], h10 * V[0, b] + h11 * V[1, b]
        for a in range(3):
            value = U[0, a] * v0 + U[1, a] * v1
            if a == b:
                value += level
            block[a, b] = mirrored[b, a] = value


@numba.njit(cache=True)
def _cell_stiffness(  # type: ignore[no-untyped-def]
    shifts, axes, first, loads, law, p, areas, slopes, images, densities, results, forces, floor,
    prestress, exact, offsets, values, orthotropic,
):  # fmt: skip
    """Second derivatives of each cell if `exact`, else their semidefinite part, with the
    tensile parts of the section forces only, plus `prestress` in all directions, which holds the
    stress-free places, too: in an unstressed cell they could move with the corners at will."""
    C, b, slots = np.empty((3, 3)), np.empty((3, 2)), np.empty(3, np.int64)
    for c in range(len(shifts)):
        size = 3
        for k in range(3):
            slots[k] = size if shifts[c, k] >= 0 else 0
            size += shifts[c, k] >= 0
        blocks = values[offsets[c] : offsets[c + 1]]
        n, F, A = slopes[c], images[c], areas[c]
        laws.tangent(law[c], p[c], results[c, :3], floor, C, orthotropic)
        c00, c01, c11 = _dot(F[0], F[0]), _dot(F[0], F[1]), _dot(F[1], F[1])
        s0, s1, s2 = forces[c]
        if exact:
            half, turn = 0.5, 0.5 * (densities[c] - s0 * c00 - s1 * c11 - 2 * s2 * c01)
            t0, t1, t2 = s0, s1, s2
        else:
            half = turn = 0.0
            t0, t1, t2 = _tensile(s0, s1, s2)
            t0, t1 = t0 + prestress, t1 + prestress
        for j in range(3):
            x, y = A * n[j, 0], A * n[j, 1]
            for k in range(3):
                b[k, 0], b[k, 1] = C[k, 0] * x + C[k, 2] * y, C[k, 1] * y + C[k, 2] * x
            g0, g1, p0, p1 = t0 * x + t2 * y, t2 * x + t1 * y, prestress * x, prestress * y
            for i in range(3):
                x, y = n[i, 0], n[i, 1]
                d00, d01 = x * b[0, 0] + y * b[2, 0], x * b[0, 1] + y * b[2, 1]
                d10, d11 = y * b[1, 0] + x * b[2, 0], y * b[1, 1] + x * b[2, 1]
                level, sign = x * g0 + y * g1, (j - i + 4) % 3 - 1
                if i <= j:
                    _put(blocks, size, i, j, F, F, d00, d01, d10, d11, level)
                if slots[j] == 0:
                    continue
                h00, h01 = d00 * c00 + d01 * c01 + level, d00 * c01 + d01 * c11
                h10, h11 = d10 * c00 + d11 * c01, d10 * c01 + d11 * c11 + level
                r, q = sign * half, sign * turn
                _put(
                    blocks, size, i, slots[j], F, axes[c],
                    -h00 - r * s2, -h01 + r * s0, -h10 - r * s1, -h11 + r * s2, 0.0,
                )  # fmt: skip
                if i <= j and slots[i]:
                    _put(
                        blocks, size, slots[i], slots[j], axes[c], axes[c],
                        c00 * h00 + c01 * h10, c00 * h01 + c01 * h11 + q,
                        c01 * h00 + c11 * h10 - q, c01 * h01 + c11 * h11,
                        0.0 if exact else x * p0 + y * p1,
                    )  # fmt: skip
        if exact and np.any(loads[c]):
            _add_load(blocks, size, slots, loads[c], first[c], axes[c])


@numba.njit(cache=True)
def _add_load(blocks, size, slots, load, first, axes):  # type: ignore[no-untyped-def]
    """Add the second derivatives of ``b . G v`` to a cell's dense blocks."""
    for d in range(3):
        if slots[d] == 0:
            continue
        for c in range(3):
            block, mirrored = blocks[c * size + slots[d]], blocks[slots[d] * size + c]
            for j in range(3):
                slope = first[c, 0] * axes[0, j] + first[c, 1] * axes[1, j]
                for i in range(3):
                    block[i, j] += load[i] * slope
                    mirrored[j, i] += load[i] * slope


class ShiftedMembraneEnergy(ElementTerm):
    """Strain energy of cells with shifted corners, and what shifts change of the loads' energy."""

    name = "membrane"
    exact_hessian = True
    of_cables = True
    stiffening: Stiffening

    def __init__(self, table: ShiftedCells, stiffening: Stiffening) -> None:
        super().__init__(table)
        self.stiffening = stiffening
        n = len(table.cells)
        self._rest, self._first = table.rest, table.slopes
        self._areas, self._densities = np.zeros((2, n))
        self._sums, self._pulls = np.zeros((2, n, 2))
        self._slopes, self._images = np.zeros((n, 3, 2)), np.zeros((n, 2, 3))
        self.forces, self.results = np.zeros((n, 3)), np.zeros((n, 7))
        """Strain (E11, E22, 2 E12), section forces (S11, S22, S12) and state of each cell by its
        law; `forces` have the residual ones, too."""
        self._orthotropic = laws.orthotropic_flag(table.laws)
        self.elements = ElementPattern(*table.element_blocks)
        self.patterns = (self.elements,)

    def renew(self, membrane: MembraneEnergy) -> None:
        """Start from the present stress-free places of the corners."""
        t = self.table
        table = ShiftedCells.of(membrane, t.cells, t.corners, t.shifts)
        self.table = replace(table, loads=t.loads, residual=t.residual)
        self._rest, self._first = self.table.rest, self.table.slopes

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the energy; keeps the state for the derivatives."""
        t = self.table
        out[0] = _evaluate(
            self.unknowns.X, x, t.corners, t.shifts, t.sides, t.axes, self._rest, self._first,
            t.loads, t.residual, t.laws, t.parameters, self._areas, self._slopes, self._images,
            self._sums, self._pulls, self._densities, self.results, self.forces, self._orthotropic,
        )  # fmt: skip

    def cell_results(self) -> Array:
        """See `results`."""
        return self.results

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        t = self.table
        _add_forces(
            t.corners, t.shifts, t.axes, self._first, t.loads, self._areas, self._slopes,
            self._images, self._sums, self._pulls, self._densities, self.forces, g,
        )  # fmt: skip

    def add_stiffness(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the material stiffness and the geometric one of tensile section forces, those of
        plain cells in ``x - F X``."""
        floor, prestress = self.stiffening.floor, self.stiffening.prestress
        self._add(A, float(floor.value), float(prestress.value), exact=False)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        self._add(A, 0.0, 0.0, exact=True)

    def _add(self, A: BlockSink, floor: float, prestress: float, exact: bool) -> None:
        t = self.table
        _cell_stiffness(
            t.shifts, t.axes, self._first, t.loads, t.laws, t.parameters, self._areas, self._slopes,
            self._images, self._densities, self.results, self.forces, floor, prestress, exact,
            self.elements.offsets, self.elements.values, self._orthotropic,
        )  # fmt: skip
        self.elements.add(A)

    def of_elements(self, table: ShiftedCells, sums: Array) -> ShiftedMembraneEnergy:
        return ShiftedMembraneEnergy(table, self.stiffening)
