"""Flattening: the flat shapes from which pieces take the form with the least strain energy.

The search starts from conformal maps of the pieces to the plane.

The energy of a piece is sum A/2 (E - Ew):D:(E - Ew), with the strain E from the flat shape to the
form, the wanted strain Ew and the areas A of the form's cells. As it is a sum of squares,
Gauss-Newton steps need first derivatives only. Lagrange multipliers keep both sides of a seam
equally long; their system is the Schur complement of the pieces, which are factorised
independently, on any number of processes.

Energies are extrapolated to infinitely fine cells. The cells of a piece are divided into four, in
their planes, until they resolve how its strains vary across it; the surface stays faceted. With 8,
16 and 32 columns across a sphere's gore of any width the energy is 52, 16 and 4.7 % too large,
extrapolated at the observed rate .2 % too small. The facets of 4 columns are off by 6 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

from crms_fenicsx.design.patterns.pieces import Piece
from crms_fenicsx.foundation.meshes.cell_division import QUARTERS
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.triangles import cross, cross_in_plane, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import (
    ConvergenceError,
    InputError,
    as_text,
    raised_together,
)

CLOSE = 1e-12
"""Largest component of the last step of the flat coordinates, relative to the piece's size."""
MOST_STEPS = 100
"""Maximum number of Gauss-Newton steps; pieces 16 columns wide need 5 to 10."""
ROUNDING = 1e-13
"""Strain of the order of rounding errors."""
LEAST_STEP = 1e-6
"""Smallest step fraction of the line search."""
COLUMNS_TO_EXTRAPOLATE = 32
"""Columns of cells at which two energies are extrapolated with an error of 1 %."""
MOST = 64
"""Columns of cells at which the energy itself has an error of 1 %."""


def conformal(points: Array, triangles: Integers) -> Array:
    """Flat coordinates (n, 2) of a disc's vertices (n, 3) by the least-squares conformal map,
    scaled to the disc's area (B. Levy et al., ACM Trans. Graph. 21, 2002)."""
    x = points[triangles]
    p, q = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    length, double_area = norm(p), norm(cross(p, q))
    third = (np.einsum("ni,ni->n", p, q) + 1j * double_area) / length
    z = np.stack([0j * length, length + 0j, third], axis=1)
    weights = (np.roll(z, -2, axis=1) - np.roll(z, -1, axis=1)) / np.sqrt(double_area)[:, None]
    m, n = len(triangles), len(points)
    rows = np.repeat(np.arange(m), 3)
    M = csr_matrix((weights.ravel(), (rows, triangles.ravel())), shape=(m, n))
    first = int(np.argmax(norm(points - points.mean(axis=0))))
    pinned = np.array([first, int(np.argmax(norm(points - points[first])))])
    free = np.setdiff1d(np.arange(n), pinned)
    flat = np.zeros(n, dtype=complex)
    flat[pinned] = 0.0, norm(points[pinned[1]] - points[first])
    own = M[:, free]
    normal = (own.conj().T @ own).tocsc()
    flat[free] = splu(normal).solve(-(own.conj().T @ (M @ flat)))
    found = np.stack([flat.real, flat.imag], axis=1)
    return np.asarray(
        found * np.sqrt(double_area.sum() / double_areas_in_plane(found, triangles).sum())
    )


def double_areas_in_plane(flat: Array, triangles: Integers) -> Array:
    """Twice the signed areas (m,) of plane triangles, positive if counter-clockwise."""
    sides = sides_of(flat, triangles)
    return cross_in_plane(sides[..., 0], sides[..., 1])


def sides_of(points: Array, triangles: Integers) -> Array:
    """Two side vectors of each triangle as columns, (m, d, 2), from points (n, d)."""
    x = points[triangles]
    return np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)


def aligned(piece: Piece, flat: Array, warps: Array | None) -> Array:
    """Flat coordinates (n, 2), rotated so that the mean warp (warps (m, 3) of all pieces' cells in
    the form; the seams' direction if None) lies along x, and moved to the positive quadrant."""
    z = (flat[:, 0] + 1j * flat[:, 1]) * np.exp(-1j * _angle(piece, flat, warps))
    turned: Array = np.stack([z.real, z.imag], axis=1)
    if warps is None:
        # along seams, the warp runs in the sense of x, or else of y, or z
        if piece.areas @ gradients(piece, turned)[:, :, 0] @ (1.0, 1e-3, 1e-6) < 0.0:
            turned = -turned
    return np.asarray(turned - turned.min(axis=0))


def gradients(piece: Piece, flat: Array) -> Array:
    """Deformation gradients (m, 3, 2) of a piece's cells from its flat coordinates (n, 2)."""
    sides = sides_of(piece.points, piece.triangles)
    return np.asarray(sides @ np.linalg.inv(sides_of(flat, piece.triangles)))


def _angle(piece: Piece, flat: Array, warps: Array | None) -> float:
    """Mean angle between warp and x."""
    if warps is None:
        runs = [flat[edge.vertices] for edge in piece.edges if edge.sewn]
        lines = np.concatenate([np.diff(run, axis=0) for run in runs or [flat[piece.outline]]])
        z = lines[:, 0] + 1j * lines[:, 1]
        return float(np.angle(np.sum(z**2 / np.abs(z)))) / 2
    warps, x = warps[piece.cells], piece.points[piece.triangles]
    sides = x[:, 1:] - x[:, :1]
    within = np.linalg.solve(
        sides @ np.swapaxes(sides, 1, 2), np.einsum("nki,ni->nk", sides, warps)[..., None]
    )
    images = (sides_of(flat, piece.triangles) @ within)[..., 0]
    z = images[:, 0] + 1j * images[:, 1]
    if (np.abs(z) <= 1e-6 * norm(warps)).any():
        at = x[int(np.abs(z).argmin())].mean(axis=0)
        raise InputError(
            f"flatten: warp is normal to the surface of {piece.name} near {as_text(at)}."
        )
    return float(np.angle(np.sum(piece.areas * z / np.abs(z))))


@dataclass(frozen=True)
class FlatProblem:
    """Strain energy of a piece as a function of its flat shape."""

    name: str  # of the piece
    points: Array  # (n, 3) coordinates in the form (length)
    triangles: Integers  # (m, 3)
    stiffness: Array  # (m, 3, 3) in the flat axes, Voigt notation (force per length)
    wanted: Array  # (m, 3) wanted strains (E11, E22, 2 E12) from the flat shape to the form
    fixed: Integers = field(repr=False)  # fixed components, numbered 2 vertex + axis

    @cached_property
    def metric(self) -> Array:
        """Metric of each cell in the form: scalar products of two sides, (m, 2, 2)."""
        sides = sides_of(self.points, self.triangles)
        return np.swapaxes(sides, 1, 2) @ sides

    @cached_property
    def roots(self) -> Array:
        """Roots (m, 3, 3) of the cells' stiffness times area, which weight the strains."""
        root = np.swapaxes(np.linalg.cholesky(self.stiffness), 1, 2)
        areas = np.sqrt(np.linalg.det(self.metric)) / 2
        return np.asarray(np.sqrt(areas)[:, None, None] * root)

    @cached_property
    def rounding(self) -> float:
        """Energy of rounding errors."""
        return ROUNDING**2 * float((self.roots**2).sum())

    @cached_property
    def free(self) -> Integers:
        """The free components."""
        return np.setdiff1d(np.arange(2 * len(self.points)), self.fixed)

    @cached_property
    def size(self) -> float:
        """Size of the piece (length)."""
        return float(np.ptp(self.points, axis=0).max())

    def strains(self, flat: Array) -> Array:
        """Green-Lagrange strains (m, 3), (E11, E22, 2 E12), from flat coordinates (n, 2)."""
        return self._strains(flat)[0]

    def _strains(self, flat: Array) -> tuple[Array, Array, Array]:
        T = np.asarray(np.linalg.inv(sides_of(flat, self.triangles)))
        C = np.asarray(np.swapaxes(T, 1, 2) @ self.metric @ T, dtype=np.float64)
        E = np.stack([(C[:, 0, 0] - 1) / 2, (C[:, 1, 1] - 1) / 2, C[:, 0, 1]], axis=1)
        return E, C, T

    def energy(self, flat: Array) -> float:
        """Energy (force x length); infinite if a cell is inverted."""
        if double_areas_in_plane(flat, self.triangles).min() <= 0.0:
            return np.inf
        r = np.einsum("nij,nj->ni", self.roots, self.strains(flat) - self.wanted)
        return float((r**2).sum()) / 2

    def linearised(self, flat: Array) -> tuple[csr_matrix, Array]:
        """Gauss-Newton matrix and gradient of the free components."""
        E, C, T = self._strains(flat)
        m, n = len(self.triangles), len(self.points)
        D = -np.einsum("nic,nkj->nkcij", C, T)  # d(C/2) by side k, component c; unsymmetric
        sides = np.stack([D[..., 0, 0], D[..., 1, 1], D[..., 0, 1] + D[..., 1, 0]], axis=1)
        corners = np.concatenate([-sides.sum(axis=2, keepdims=True), sides], axis=2)
        J = np.einsum("nij,njk->nik", self.roots, corners.reshape(m, 3, 6))
        rows = np.repeat(np.arange(3 * m), 6)
        columns = (2 * self.triangles[:, :, None] + np.arange(2)).reshape(m, 1, 6)
        places = rows, np.repeat(columns, 3, axis=1).ravel()
        whole = csr_matrix((J.ravel(), places), shape=(3 * m, 2 * n))[:, self.free]
        r = np.ravel(np.einsum("nij,nj->ni", self.roots, E - self.wanted))
        return (whole.T @ whole).tocsc(), np.asarray(whole.T @ r)

    def moved(self, flat: Array, step: Array) -> Array:
        """Flat coordinates after a step of the free components."""
        out = flat.ravel().copy()
        out[self.free] += step
        return out.reshape(-1, 2)

    def solve(self, flat: Array) -> Array:
        """Flat shape of least energy with free seams, from an initial shape."""
        energy = self.energy(flat)
        for _ in range(MOST_STEPS):
            H, g = self.linearised(flat)
            step, part = splu(H).solve(-g), 1.0
            most = (1 + 1e-9) * energy + self.rounding
            while (new := self.energy(self.moved(flat, part * step))) > most:
                part /= 2
                if part < LEAST_STEP:
                    raise ConvergenceError(
                        f"flatten: {self.name} does not lie flat: no step lowers its energy; "
                        "cut it into narrower strips."
                    )
            flat, energy = self.moved(flat, part * step), new
            if np.abs(step).max() <= CLOSE * self.size:
                return flat
        raise ConvergenceError(
            f"flatten: {self.name} is not flat after {MOST_STEPS} steps; cut it into narrower "
            "strips."
        )


@dataclass(frozen=True)
class Sides:
    """Seam segments along a piece."""

    rows: Integers  # (k,) joint numbers
    ends: Integers  # (k, 2) end vertices
    signs: Array  # (k,) 1 on the joint's first side, -1 on its second

    def lengths(self, flat: Array) -> tuple[Array, Array]:
        """Lengths (k,) and unit vectors (k, 2)."""
        along = flat[self.ends[:, 1]] - flat[self.ends[:, 0]]
        lengths = np.hypot(along[:, 0], along[:, 1])
        return lengths, along / lengths[:, None]


def flat_shapes(
    problems: dict[int, FlatProblem],
    starts: dict[int, Array],
    sides: dict[int, Sides],
    joints: int,
    comm: MPI.Intracomm,
) -> list[Array]:
    """Flat shapes (n, 2) of all pieces, with equal seam lengths if `joints` > 0. Each rank gives
    the problems of its own pieces, by piece number. Collective."""
    flat: dict[int, Array] = {}
    with raised_together(comm):
        for k, problem in problems.items():
            flat[k] = problem.solve(starts[k])
    if joints:
        flat = _with_equal_seams(problems, flat, sides, joints, comm)
    every = {k: shape for part in comm.allgather(flat) for k, shape in part.items()}
    return [every[k] for k in sorted(every)]


def _with_equal_seams(
    problems: dict[int, FlatProblem], flat: dict[int, Array], sides: dict[int, Sides],
    joints: int, comm: MPI.Intracomm,
) -> dict[int, Array]:  # fmt: skip
    """Flat shapes of least energy with equally long seam sides. Collective."""
    for _ in range(MOST_STEPS):
        solved, shares = {}, {}
        with raised_together(comm):
            for k, problem in problems.items():
                H, g = problem.linearised(flat[k])
                own = sides[k]
                lengths, units = own.lengths(flat[k])
                B = _gradient(own, units, len(problem.points))[:, problem.free].toarray()
                factor = splu(H)
                Y, z = factor.solve(B.T), factor.solve(-g)
                solved[k] = Y, z
                shares[k] = own.rows, B @ Y, own.signs * lengths + B @ z
        multipliers = _multipliers(comm.allgather(shares), joints)
        steps = {k: z - Y @ multipliers[sides[k].rows] for k, (Y, z) in solved.items()}
        part = 1.0
        while not comm.allreduce(
            all(
                np.isfinite(problems[k].energy(problems[k].moved(flat[k], part * step)))
                for k, step in steps.items()
            ),
            op=MPI.LAND,
        ):
            part /= 2
            if part < LEAST_STEP:
                raise ConvergenceError(
                    "flatten: the sides of seams cannot be made equally long; cut narrower strips."
                )
        flat = {k: problems[k].moved(flat[k], part * step) for k, step in steps.items()}
        change = max((np.abs(s).max() / problems[k].size for k, s in steps.items()), default=0.0)
        if comm.allreduce(float(change), op=MPI.MAX) <= CLOSE:
            return flat
    raise ConvergenceError(
        f"flatten: the sides of seams are not equal after {MOST_STEPS} steps; cut narrower strips."
    )


def _gradient(own: Sides, units: Array, n: int) -> csr_matrix:
    """Derivatives (k, 2 n) of the signed segment lengths by the flat coordinates (n, 2)."""
    k = np.arange(len(own.rows))
    values = own.signs[:, None] * np.concatenate([-units, units], axis=1)
    columns = (2 * own.ends[:, :, None] + np.arange(2)).reshape(-1, 4)
    return csr_matrix((values.ravel(), (np.repeat(k, 4), columns.ravel())), shape=(len(k), 2 * n))


def _multipliers(shares: list[dict[int, tuple[Integers, Array, Array]]], joints: int) -> Array:
    """Multipliers (joints,) of the seam constraints, from all pieces' contributions."""
    every = {k: share for part in shares for k, share in part.items()}
    ordered = [every[k] for k in sorted(every)]  # equal rounding for any number of ranks
    right = np.zeros(joints)
    for rows, _, gap in ordered:
        np.add.at(right, rows, gap)
    i = np.concatenate([np.repeat(rows, len(rows)) for rows, _, _ in ordered])
    j = np.concatenate([np.tile(rows, len(rows)) for rows, _, _ in ordered])
    values = np.concatenate([block.ravel() for _, block, _ in ordered])
    S = coo_matrix((values, (i, j)), shape=(joints, joints)).tocsc()
    return np.asarray(splu(S).solve(right))


ProblemOf = Callable[[Piece, Array], FlatProblem]
"""The flattening problem of a piece near flat coordinates (n, 2) of its vertices."""


def columns_of(piece: Piece, flat: Array) -> float:
    """Number of columns of (wide) cells across a piece with flat coordinates (n, 2)."""
    return float(np.ptp(flat[:, 1]) / np.quantile(np.ptp(flat[piece.triangles, 1], axis=1), 0.9))


def divided(piece: Piece) -> tuple[Piece, Integers]:
    """A piece with cells divided into four, and the ends (k, 2) of the edges halved by new
    vertices, which follow the old ones."""
    t, n, table = piece.triangles, len(piece.points), EdgeTable.of(piece.triangles)

    def between(p: Integers, q: Integers) -> Integers:
        keys = edge_keys(np.stack([p, q], axis=-1))
        return n + np.searchsorted(table.keys, keys).reshape(p.shape)

    around = np.concatenate([t, between(t, np.roll(t, -1, axis=1))], axis=1)
    edges = []
    for edge in piece.edges:
        run = np.empty(2 * len(edge.vertices) - 1, dtype=np.int64)
        run[::2], run[1::2] = edge.vertices, between(edge.vertices[:-1], edge.vertices[1:])
        edges.append(replace(edge, vertices=run))
    finer = replace(
        piece, cells=np.tile(piece.cells, 4), edges=tuple(edges),
        triangles=np.concatenate([around[:, corners] for corners in QUARTERS]),
        points=np.concatenate([piece.points, piece.points[table.vertices].mean(axis=1)]),
    )  # fmt: skip
    return finer, table.vertices


def fine_energies(piece: Piece, flat: Array, problem_of: ProblemOf) -> list[float]:
    """Least energies of a piece with free seams, on its cells and successive refinements."""
    found: list[float] = []
    while True:
        problem = problem_of(piece, flat)
        flat = problem.solve(flat)
        found.append(problem.energy(flat))
        if found[0] <= problem.rounding:
            return found
        if columns_of(piece, flat) >= (COLUMNS_TO_EXTRAPOLATE if len(found) > 1 else MOST):
            return found
        piece, ends = divided(piece)
        flat = np.concatenate([flat, flat[ends].mean(axis=1)])


def limit_of(energies: list[float]) -> float:
    """Limit of energies on successive refinements: with the rate of the last three, bounded by
    first and second order; with second order from two."""
    if len(energies) < 2:
        return energies[-1]
    last = energies[-2] - energies[-1]
    before = energies[-3] - energies[-2] if len(energies) > 2 else np.inf
    rate = min(max(before / last, 2.0), 4.0) if last > 0.0 else 4.0
    return energies[-1] - last / (rate - 1.0)
