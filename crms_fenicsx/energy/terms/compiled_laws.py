"""Compiled stress laws of `model.materials`, for folded and orthotropic plain cells.

In plain cells a wrinkled orthotropic membrane's tension direction has no closed form. Before energy
and gradient are assembled, a compiled loop puts each cell's stress and energy into DG0 fields. As
the energy is a maximum over directions, its derivative is that at the fixed direction (envelope
theorem), so energy and gradient assembled from the fields are exact.

Orthotropic tension field. A membrane without compressive stiffness has the energy of the optimal
tensile stress, ``max sigma : E - 1/2 sigma : C : sigma``. If D E is tensile, that is the stress
(taut); if E is negative semidefinite, it is zero (slack). Otherwise it is uniaxial along some n
(wrinkled), with the energy ``max over n of (n E n)^2 / (2 n n : C : n n)``. With

    rho = (c11 / c22)^(1/4),  kappa = (2 c12 + c66) / (2 (c11 c22)^(1/2)),
    a = E11,  b = rho E12,  d = rho^2 E22,  M = (a + d) / 2,  H = (a - d) / 2,
    tan(psi / 2) = n2 / (n1 rho)

this is the maximum over psi of N^2 / (2 c11 q), N = M + H cos(psi) + b sin(psi) and
q = 1 + (kappa - 1) / 2 sin(psi)^2. As q is even in cosine and sine, psi lies in the quadrant of the
signs of H and b, where the derivative has one zero:

    (1 + kappa) / 2 |H| / |cos(psi)| - |b| / |sin(psi)| = (1 - kappa) / 2 M.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.materials import (
    LINEAR,
    ORTHOTROPIC_TENSION_FIELD,
    TENSION_FIELD,
    LawTerms,
    symmetric,
    taut_stiffness,
    voigt,
)
from crms_fenicsx.model.tolerances import UNSTRAINED

MOST_STEPS = 50
"""Limit of Newton steps for a direction; 4 are needed on average, at most 10."""


@numba.njit(cache=True)
def _tension_line(p, e0, e1, e2):  # type: ignore[no-untyped-def]
    """Tension direction of a wrinkled orthotropic membrane: (cos(psi), sin(psi), N, M) as above."""
    rho, kappa = p[16], p[17]
    a, b, d = e0, 0.5 * rho * e2, rho * rho * e1
    mean, half = 0.5 * (a + d), 0.5 * (a - d)
    slope, level, r = 0.5 * (1 + kappa) * abs(half), abs(b), 0.5 * (kappa - 1) * mean
    steep = r >= 0.0
    if not steep:
        slope, level, r = level, slope, -r
    # slope x - level + r x / (1 + x^2)^(1/2) = 0, x = tan(psi) if steep, else its inverse. The
    # left side is concave: from a lower bound of the root Newton's iterates rise, until rounding.
    slope = max(slope, 1e-100 * (level + r))
    x = 0.0
    if slope > 0.0:
        x = max(level / (slope + r), (level - r) / slope)
        for _ in range(MOST_STEPS):
            h = math.sqrt(1 + x * x)
            new = x - (slope * x - level + r * x / h) / (slope + r / (h * h * h))
            if not new > x:
                break
            x = new
    h = math.sqrt(1 + x * x)
    c, s = (1 / h, x / h) if steep else (x / h, 1 / h)
    N = mean + c * abs(half) + s * abs(b)
    return math.copysign(c, half), math.copysign(s, b), N, mean


def orthotropic_flag(laws: npt.ArrayLike) -> bool | None:
    """Value of the argument `orthotropic` of `stress` and `tangent` for cells with these laws."""
    return True if np.any(np.asarray(laws) == ORTHOTROPIC_TENSION_FIELD) else None


@numba.njit(cache=True)
def stress(law, p, e, s, orthotropic):  # type: ignore[no-untyped-def]
    """Energy per area; section forces (S11, S22, S12) into s. Returns (energy, state). `p` is
    `MembraneMaterial.parameters`, e the strain (E11, E22, 2 E12); state is 2 taut, 1 wrinkled, 0
    slack. With `orthotropic` None instead of True, the orthotropic tension field is not compiled,
    whose iteration takes longer to compile than all the rest."""
    # Taut: the constant prestress energy S^2 / E t is left out, as small changes would be lost.
    energy = 0.0
    for i in range(3):
        s[i] = p[12 + i]
        for j in range(3):
            s[i] += p[3 * i + j] * e[j]
        energy += 0.5 * e[i] * (p[12 + i] + s[i])
    if law == LINEAR:
        return energy, 2
    e0, e1, e2 = e[0] + p[9], e[1] + p[10], e[2] + p[11]
    if orthotropic is None or law == TENSION_FIELD:
        density, state = _isotropic(p, e0, e1, e2, s)
    else:
        density, state = _orthotropic(p, e0, e1, e2, s)
    if state == 2:
        return energy, state
    rest = 0.0
    for i in range(3):
        rest += 0.5 * p[9 + i] * p[12 + i]
    return density - rest, state


@numba.njit(cache=True)
def _isotropic(p, e0, e1, e2, s):  # type: ignore[no-untyped-def]
    """`stress` of cells that are not taut, from the total strain; s holds the taut stress."""
    mean, half, shear = 0.5 * (e0 + e1), 0.5 * (e0 - e1), 0.5 * e2
    radius = math.sqrt(half * half + shear * shear)
    larger, smaller = mean + radius, mean - radius
    if smaller + p[16] * larger >= 0.0:
        return 0.0, 2
    if larger > 0.0:
        t = p[15] * larger
        s[0] = 0.5 * t * (1 + half / radius)
        s[1] = 0.5 * t * (1 - half / radius)
        s[2] = 0.5 * t * shear / radius
        return 0.5 * t * larger, 1
    s[0] = s[1] = s[2] = 0.0
    return 0.0, 0


@numba.njit(cache=True)
def _orthotropic(p, e0, e1, e2, s):  # type: ignore[no-untyped-def]
    if s[0] >= 0.0 and s[1] >= 0.0 and s[0] * s[1] >= s[2] * s[2]:
        return 0.0, 2
    if e0 > 0.0 or e1 > 0.0 or 4 * e0 * e1 < e2 * e2:
        cos, sin, N, _ = _tension_line(p, e0, e1, e2)
        if N > 0.0:
            rho = p[16]
            t = p[15] * N / (1 + 0.5 * (p[17] - 1) * sin * sin)
            s[0] = 0.5 * t * (1 + cos)
            s[1] = 0.5 * t * (1 - cos) * rho * rho
            s[2] = 0.5 * t * sin * rho
            return 0.5 * t * N, 1
    s[0] = s[1] = s[2] = 0.0
    return 0.0, 0


@numba.njit(cache=True)
def tangent(law, p, e, floor, C, orthotropic):  # type: ignore[no-untyped-def]
    """Consistent tangent (3, 3) into C, plus `floor` times the taut stiffness in wrinkling laws;
    `orthotropic` as in `stress`."""
    for i in range(3):
        for j in range(3):
            C[i, j] = p[3 * i + j]
    if law == LINEAR:
        return
    e0, e1, e2 = e[0] + p[9], e[1] + p[10], e[2] + p[11]
    if orthotropic is None or law == TENSION_FIELD:
        taut, along, across, first, second = _isotropic_dyads(p, e0, e1, e2)
    else:
        taut, along, across, first, second = _orthotropic_dyads(p, e0, e1, e2)
    factor = 1 + floor if taut else floor
    for i in range(3):
        for j in range(3):
            C[i, j] *= factor
            if not taut:
                C[i, j] += first * along[i] * along[j] + second * across[i] * across[j]


@numba.njit(cache=True)
def _isotropic_dyads(p, e0, e1, e2):  # type: ignore[no-untyped-def]
    """Whether (nearly) taut, else the tangent's dyads, paired with (E11, E22, 2 E12): one along the
    tension and one for its rotation with the strain, each with its factor."""
    nothing = (0.0, 0.0, 0.0)
    mean, half, shear = 0.5 * (e0 + e1), 0.5 * (e0 - e1), 0.5 * e2
    radius = math.sqrt(half * half + shear * shear)
    larger, smaller = mean + radius, mean - radius
    taut = smaller + p[16] * larger >= -UNSTRAINED
    if taut or larger <= 0.0:
        return taut, nothing, nothing, 0.0, 0.0
    c, s = half / radius, shear / radius
    along = (0.5 * (1 + c), 0.5 * (1 - c), 0.5 * s)
    across = (-0.5 * s, 0.5 * s, 0.5 * c)
    return taut, along, across, p[15], p[15] * larger / radius


@numba.njit(cache=True)
def _orthotropic_dyads(p, e0, e1, e2):  # type: ignore[no-untyped-def]
    """As `_isotropic_dyads`. With the energy f(psi, E) for a given direction, the tangent of its
    maximum over psi is ``f_EE + f_Epsi f_Epsi^T / (-f_psipsi)``."""
    nothing = (0.0, 0.0, 0.0)
    s0 = p[0] * e0 + p[1] * e1 + UNSTRAINED * p[0]
    s1 = p[3] * e0 + p[4] * e1 + UNSTRAINED * p[4]
    s2 = p[8] * e2
    taut = s0 >= 0.0 and s1 >= 0.0 and s0 * s1 >= s2 * s2
    if taut or (e0 <= 0.0 and e1 <= 0.0 and 4 * e0 * e1 >= e2 * e2):
        return taut, nothing, nothing, 0.0, 0.0
    cos, sin, N, mean = _tension_line(p, e0, e1, e2)
    if N <= 0.0:
        return taut, nothing, nothing, 0.0, 0.0
    rho, m = p[16], 0.5 * (p[17] - 1)
    q = 1 + m * sin * sin
    turn = m * sin * cos / q  # q' / (2 q), at the maximum equal to N' / N
    along = (0.5 * (1 + cos), 0.5 * (1 - cos) * rho * rho, 0.5 * sin * rho)
    across = (
        -0.5 * sin - turn * along[0],
        0.5 * sin * rho * rho - turn * along[1],
        0.5 * cos * rho - turn * along[2],
    )
    # -f_psipsi c11 q / N^2; positive, as the stress at the maximum is unique
    curvature = (N - mean) / N + m * (cos * cos - sin * sin) / q - turn * turn
    factor = p[15] / q
    return taut, along, across, factor, factor / curvature


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
        energy, state = stress(ORTHOTROPIC_TENSION_FIELD, p[row[c]], e, s, True)
        into = values[cells[c]]
        into[0], into[1], into[2], into[3], into[4] = energy, s[0], s[1], s[2], state
        for m in range(3):
            strains[c, m] = e[m]


@numba.njit(cache=True)
def _cell_tangents(strains, row, p, cells, tangents):  # type: ignore[no-untyped-def]
    """Consistent tangents (3, 3) into `tangents` at the cells, flat."""
    C = np.empty((3, 3))
    for c in range(len(cells)):
        tangent(ORTHOTROPIC_TENSION_FIELD, p[row[c]], strains[c], 0.0, C, True)
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
        self.shapes = self._shapes(duals)
        self.strains = np.zeros((len(cells), 3))
        self.values = fem.Function(fem.functionspace(mesh, ("DG", 0, (5,))))
        """Energy per area, section forces (S11, S22, S12) and state of each cell."""
        self.tangents = fem.Function(fem.functionspace(mesh, ("DG", 0, (3, 3))))
        """Consistent tangent of each cell, in Voigt order."""

    def place(self, axes: Array) -> None:
        """Use these orthonormal axes of the present stress-free shape of the mesh."""
        self.axes, self.shapes = axes, self._shapes(axes)

    def _shapes(self, duals: Array) -> Array:
        """What maps differences of u along two sides to slopes along the axes, (n, 2, 2)."""
        mesh = self.u.function_space.mesh
        x = mesh.geometry.x[geometry_dofmap(mesh)[self.cells]]
        sides = np.einsum("nki,nai->nka", x[:, 1:] - x[:, :1], duals)
        return np.asarray(np.linalg.inv(sides))

    def update(self) -> None:
        """Evaluate the law at the current displacement."""
        cell_values(
            self.u.x.array.reshape(-1, 3), self.dofs, self.axes, self.rest, self.shapes, self.row,
            self.parameters, self.cells, self.strains, self.values.x.array.reshape(-1, 5),
        )  # fmt: skip

    def update_tangents(self) -> None:
        """Evaluate the tangents at the last `update`."""
        tangents = self.tangents.x.array.reshape(-1, 9)
        _cell_tangents(self.strains, self.row, self.parameters, self.cells, tangents)

    def terms(self, parameters: Any) -> LawTerms:
        """The law with the fields held."""
        values, tangents = self.values, self.tangents

        def tangent(a: Any, b: Any) -> Any:
            return ufl.dot(voigt(a), ufl.dot(tangents, voigt(b)))

        stress = symmetric([values[1], values[2], values[3]])
        return LawTerms(values[0], stress, values[4], tangent, taut_stiffness(parameters)[1])
