"""Least strain energy: the flat shapes from which pieces take the form with the wanted strain.

The energy of a piece is that of what its strain, from the flat shape to the form, has beside the
wanted one: sum of A/2 (E - Ew):D:(E - Ew), A the areas of the form. It is a sum of squares in the
flat places, so that Gauss-Newton steps need first derivatives only. Both sides of a seam are kept
equally long by multipliers. Their system is made of each piece's own: the pieces are factorised
side by side, on any number of processes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

from crms_fenicsx.patterns.conformal import cell_sides_in_plane, double_areas_in_plane
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.errors import ConvergenceError, raised_together

CLOSE = 1e-12
"""Last step of the flat places, relative to the piece's size."""
MOST_STEPS = 100
"""Gauss-Newton steps; where cells of 16 columns are wide in curvature it takes 5 to 10."""
ROUNDING = 1e-13
"""Strain that is none."""
LEAST_STEP = 1e-6
"""Part of a step below which there is no way on."""


@dataclass(frozen=True)
class FlatProblem:
    """The strain energy of a piece as a function of its flat shape."""

    name: str  # of the piece
    points: Array  # (n, 3) places in the form (length)
    triangles: Integers  # (m, 3)
    stiffness: Array  # (m, 3, 3) in the flat axes, Voigt order (force per length)
    wanted: Array  # (m, 3) wanted strains (E11, E22, 2 E12) from the flat shape to the form
    fixed: Integers = field(repr=False)  # the flat places' components that stay, by 2 vertex + axis

    @cached_property
    def metric(self) -> Array:
        """Scalar products of two sides of each cell in the form, (m, 2, 2)."""
        x = self.points[self.triangles]
        sides = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)
        return np.swapaxes(sides, 1, 2) @ sides

    @cached_property
    def areas(self) -> Array:
        """Areas of the cells in the form, (m,)."""
        return np.asarray(np.sqrt(np.linalg.det(self.metric)) / 2)

    @cached_property
    def roots(self) -> Array:
        """Matrices (m, 3, 3) whose squares weight the strains."""
        root = np.swapaxes(np.linalg.cholesky(self.stiffness), 1, 2)
        return np.asarray(np.sqrt(self.areas)[:, None, None] * root)

    @cached_property
    def rounding(self) -> float:
        """Energy that rounding leaves."""
        return ROUNDING**2 * float((self.roots**2).sum())

    @cached_property
    def free(self) -> Integers:
        """The components that are free."""
        return np.setdiff1d(np.arange(2 * len(self.points)), self.fixed)

    @cached_property
    def size(self) -> float:
        """A length of the piece."""
        return float(np.ptp(self.points, axis=0).max())

    def strains(self, flat: Array) -> Array:
        """Green-Lagrange strains (m, 3) from flat places (n, 2) to the form, (E11, E22, 2 E12)."""
        return self._strains(flat)[0]

    def _strains(self, flat: Array) -> tuple[Array, Array, Array]:
        T = np.asarray(np.linalg.inv(cell_sides_in_plane(flat, self.triangles)))
        C = np.asarray(np.swapaxes(T, 1, 2) @ self.metric @ T, dtype=np.float64)
        E = np.stack([(C[:, 0, 0] - 1) / 2, (C[:, 1, 1] - 1) / 2, C[:, 0, 1]], axis=1)
        return E, C, T

    def energy(self, flat: Array) -> float:
        """Energy (force x length); infinite where a cell is turned over."""
        if double_areas_in_plane(flat, self.triangles).min() <= 0.0:
            return np.inf
        r = np.einsum("nij,nj->ni", self.roots, self.strains(flat) - self.wanted)
        return float((r**2).sum()) / 2

    def linearised(self, flat: Array) -> tuple[csr_matrix, Array]:
        """Gauss-Newton matrix and gradient with respect to the free components."""
        E, C, T = self._strains(flat)
        m, n = len(self.triangles), len(self.points)
        D = -np.einsum("nic,nkj->nkcij", C, T)  # of C/2 along side k, component c; to be symmetric
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
        """Flat places moved by a step of the free components."""
        out = flat.ravel().copy()
        out[self.free] += step
        return out.reshape(-1, 2)

    def solve(self, flat: Array) -> Array:
        """The flat shape of least energy, from a start; seams are free."""
        energy = self.energy(flat)
        for _ in range(MOST_STEPS):
            H, g = self.linearised(flat)
            step, part = splu(H).solve(-g), 1.0
            most = (1 + 1e-9) * energy + self.rounding
            while (new := self.energy(self.moved(flat, part * step))) > most:
                part /= 2
                if part < LEAST_STEP:
                    raise ConvergenceError(
                        f"flatten: {self.name} does not lie flat: no step makes its energy less; "
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
    """The sides of seams that belong to a piece."""

    rows: Integers  # (k,) numbers of the joints
    ends: Integers  # (k, 2) vertices
    signs: Array  # (k,) 1 on the first side of a joint, -1 on the second

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
    """Flat shapes (n, 2) of all pieces, of which each rank has its own as problems by their
    numbers; with joints both their sides are equally long. Collective."""
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
    """Flat shapes of least energy among those whose seams have two equal sides. Collective."""
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
    """Derivatives (k, 2 n) of signed lengths with respect to flat places (n, 2)."""
    k = np.arange(len(own.rows))
    values = own.signs[:, None] * np.concatenate([-units, units], axis=1)
    columns = (2 * own.ends[:, :, None] + np.arange(2)).reshape(-1, 4)
    return csr_matrix((values.ravel(), (np.repeat(k, 4), columns.ravel())), shape=(len(k), 2 * n))


def _multipliers(shares: list[dict[int, tuple[Integers, Array, Array]]], joints: int) -> Array:
    """Multipliers (joints,) of the equal lengths, from what all pieces have of their system."""
    every = {k: share for part in shares for k, share in part.items()}
    ordered = [every[k] for k in sorted(every)]  # so that sums round alike on any number of ranks
    right = np.zeros(joints)
    for rows, _, gap in ordered:
        np.add.at(right, rows, gap)
    i = np.concatenate([np.repeat(rows, len(rows)) for rows, _, _ in ordered])
    j = np.concatenate([np.tile(rows, len(rows)) for rows, _, _ in ordered])
    values = np.concatenate([block.ravel() for _, block, _ in ordered])
    S = coo_matrix((values, (i, j)), shape=(joints, joints)).tocsc()
    return np.asarray(splu(S).solve(right))
