"""Load steps of the paper, written from its equations (2.2-1) to (3.4-1), for a mesh and a cable.

Plain numpy with derivatives by the complex step, which shares no code with the package. The points
of an element are i, k, j and, where it is folded, p on ij and q on jk; the path must not change.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from crms_fenicsx import LaidCable, Scene
from crms_fenicsx.foundation.runtime.arrays import Array

STEP = 1e-30
"""The complex step: without cancellation, so that derivatives are exact to rounding."""


def norm(v: Array) -> Array:
    """Lengths of vectors (..., 3), which may be complex."""
    return np.asarray(np.sqrt(np.sum(v * v, axis=-1)))


def angle(at: Array, first: Array, last: Array) -> Array:
    """Angles at points (n, 3) between the ways to two others."""
    u, v = first - at, last - at
    return np.asarray(np.arccos(np.sum(u * v, axis=-1) / (norm(u) * norm(v))))


def isotropic(E: float, nu: float) -> Array:
    """(2.3-12)."""
    return E / (1 - nu**2) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])


def orthotropic(E1: float, E2: float, G12: float, nu21: float) -> Array:
    """(2.3-13), in the axes of warp and weft."""
    n, m = E1 / E2, G12 / E2
    one = 1 - n * nu21**2
    D = np.array([[n, n * nu21, 0], [n * nu21, 1, 0], [0, 0, m * one]])
    return np.asarray(E2 / one * D)


def turned(D: Array, side: Array, warp: Array, upward: bool) -> Array:
    """D in the frame whose x axis is a side (2,), and whose y axis points to corner j."""
    side, warp = side / np.linalg.norm(side), warp / np.linalg.norm(warp)
    c, s = side @ warp, (warp[0] * side[1] - warp[1] * side[0]) * (1 if upward else -1)
    strains = [
        [c * c, s * s, -c * s],
        [s * s, c * c, c * s],
        [2 * c * s, -2 * c * s, c * c - s * s],
    ]
    T = np.array(strains)
    return np.asarray(T.T @ D @ T)


@dataclass
class Elements:
    """Plain or folded elements, with their state at step n."""

    points: Array  # (n, 3) or (n, 5)
    D: Array  # (n, 3, 3), times the thickness
    stress: Array  # (n, 3), times the thickness
    sides: Array  # (3, n) r1, r2, |ik|

    @staticmethod
    def lengths(P: Array) -> Array:
        """(2.3-1 ... 2.3-5) for places P (n, 3 or 5, 3)."""
        i, k, j, *fold = np.moveaxis(P, 1, 0)
        p, q = fold if fold else (None, None)
        r1 = norm(j - i) if p is None else norm(p - i) + norm(j - p)
        r2 = norm(k - j) if q is None else norm(q - k) + norm(j - q)
        return np.array([r1, r2, norm(k - i)])

    def increment(self, P: Array) -> tuple[Array, Array]:
        """Strain increments (n, 3) and areas (n,), (2.3-6 ... 2.3-10)."""
        (r1, r2, a), (r1_, r2_, a_) = self.sides, self.lengths(P)
        x, x_ = (a**2 + r1**2 - r2**2) / (2 * a), (a_**2 + r1_**2 - r2_**2) / (2 * a_)
        y, y_ = np.sqrt(r1**2 - x**2), np.sqrt(r1_**2 - x_**2)
        du_k, du_j, dv_j = a_ - a, x_ - x, y_ - y
        # i = (0, 0), k = (a, 0), j = (x, y): b_k = y_j - y_i, b_j = y_i - y_k, c_k = x_i - x_j ...
        b_k, b_j, c_k, c_j, S = y, 0.0, -x, a, a * y / 2
        eps = [b_k * du_k + b_j * du_j, c_j * dv_j, c_k * du_k + c_j * du_j + b_j * dv_j]
        return np.stack(eps, axis=-1) / (2 * S)[:, None], S

    def work(self, P: Array) -> Array:
        """(2.3-11 ... 2.3-14) of each."""
        eps, S = self.increment(P)
        after = self.stress + np.einsum("nij,nj->ni", self.D, eps)
        return np.asarray(np.sum(0.5 * (self.stress + after) * eps, axis=-1) * S)

    def end_step(self, P: Array) -> None:
        """Step n + 1 becomes step n."""
        self.stress = self.stress + np.einsum("nij,nj->ni", self.D, self.increment(P)[0])
        self.sides = self.lengths(P)


@dataclass
class FrictionElement:
    """One of (3.2, 3.3), at step n."""

    point: int
    vertex: int
    force: float  # F = mu N
    direction: Array  # (3,) across the cable, in the surface


class WrittenPaper:
    """The paper's functional for a scene with one cable, from its current state on."""

    def __init__(
        self, scene: Scene, cable: LaidCable, D: Array, *, mu: float, friction: float = 0.0,
        warp: tuple[float, float] | None = None,
    ) -> None:  # fmt: skip
        self.scene, self.cable, self.mu, self.friction = scene, cable, mu, friction
        self.tension = cable.tension
        self.flat = self._of_all(scene.membrane.stress_free)
        self.nv = len(self.flat)
        self.X = self.places()
        on = {
            frozenset(node.point.support): self.nv + k
            for k, node in enumerate(cable.state.nodes)
            if node.point is not None and node.slides
        }
        rows: dict[int, list[tuple[int, ...]]] = {3: [], 5: []}
        for cell in self._cells():
            pairs = [(cell[m], cell[(m + 1) % 3]) for m in range(3)]
            folds = [on.get(frozenset(pair)) for pair in pairs]
            plain = [m for m in range(3) if folds[m] is None]
            assert len(plain) in (1, 3), "the cable passes a vertex"
            m = plain[0]  # side ik
            i, k, j = cell[m], cell[(m + 1) % 3], cell[(m + 2) % 3]
            fold = () if len(plain) == 3 else (folds[(m + 2) % 3], folds[(m + 1) % 3])
            rows[3 + len(fold)].append((i, k, j, *fold))
        self.groups = [
            self._elements(np.array(own, dtype=int).reshape(-1, n), D, warp)
            for n, own in rows.items()
        ]

    def _elements(self, points: Array, D: Array, warp: tuple[float, float] | None) -> Elements:
        i, k, j = (self.flat[points[:, m]] for m in range(3))
        up = np.cross(k - i, j - i)[:, 2] > 0
        axes = k - i if warp is None else np.broadcast_to([*warp, 0.0], i.shape)
        own = [turned(D, (k - i)[n, :2], axes[n, :2], up[n]) for n in range(len(points))]
        return Elements(
            points, np.array(own).reshape(-1, 3, 3), np.zeros((len(points), 3)),
            Elements.lengths(self.X[points]),
        )  # fmt: skip

    def _cells(self) -> Array:
        """Vertex ids of all cells, (n, 3)."""
        own = self.scene.mesh.mesh.topology.index_map(2).size_local
        cells = self.scene.membrane.vertex_ids[self.scene.V.dofmap.list[:own]]
        return np.concatenate(self.scene.comm.allgather(cells))

    def _of_all(self, values: Array) -> Array:
        """Values of all vertices, by their ids."""
        n, ids = self.scene.V.dofmap.index_map.size_local, self.scene.membrane.vertex_ids
        parts = self.scene.comm.allgather((ids[:n], values[:n]))
        found = np.zeros((sum(len(own) for own, _ in parts), 3), values.dtype)
        for own, given in parts:
            found[own] = given
        return found

    def places(self) -> Array:
        """Current positions of all vertices, and of the cable's nodes."""
        return np.vstack([self._of_all(self.scene.positions()), self.cable.state.positions])

    def penalty(self, P: Array) -> Array:
        """(2.5-1) with mu = nu, of each folded element."""
        i, k, j, p, q = np.moveaxis(P, 1, 0)
        at_p = angle(p, i, q) + angle(p, j, q) - np.pi
        at_q = angle(q, j, p) + angle(q, p, k) - np.pi
        return np.asarray(self.mu * (at_p**2 + at_q**2))

    def pressure_forces(self, pressure: float) -> Array:
        """p_m = S_m Pa on i, k, j of each element, along its normal at step n, (2.4-1)."""
        forces = np.zeros_like(self.X)
        for group in self.groups:
            corners = group.points[:, :3]
            i, k, j = (self.X[corners[:, m]] for m in range(3))
            normals = np.cross(k - i, j - i)
            normals *= np.sign(normals[:, 2:])
            np.add.at(forces, corners, (pressure * normals / 2 / 3)[:, None])
        return forces

    def change_of_tension(self, Y: Array) -> float:
        """(2.2-1, 2)."""
        before, after = (float(norm(np.diff(x[self.nv :], axis=0)).sum()) for x in (self.X, Y))
        return self.cable.cable.EA / before * (after - before)

    def friction_elements(self) -> list[FrictionElement]:
        """Size (3.2-1 ... 3.2-3) and direction of the forces, at step n."""
        found, line = [], self.X[self.nv :]
        for k, node in enumerate(self.cable.state.nodes):
            if node.point is None or not node.slides:
                continue
            t1, t2 = line[k] - line[k - 1], line[k + 1] - line[k]
            t1, t2 = t1 / norm(t1), t2 / norm(t2)
            theta = np.arctan2(norm(np.cross(t1, t2)), t1 @ t2)
            N = 2 * self.tension * np.sin(theta / 2)
            if k in (1, len(line) - 2):
                N = self.tension * np.tan(theta / 2)  # (1 - cos) / sin
            a, b = node.point.support
            to_a, to_b = self.X[a] - line[k], self.X[b] - line[k]
            edge = to_b / norm(to_b) - to_a / norm(to_a)
            normal = np.cross(edge, t1 + t2)
            normal *= np.sign(normal[2])
            across = np.cross(normal, t1 + t2)
            nearer = a if norm(to_a) < norm(to_b) else b
            found.append(
                FrictionElement(
                    self.nv + k, int(nearer), self.friction * float(N), across / norm(across)
                )
            )
        return found

    def end_step(self, pressure: float = 0.0, held: Collection[int] = ()) -> tuple[Array, float]:
        """Derivatives of (3.4-1) by the free places at the scene's state, which are zero if it is
        the paper's step n + 1, and the largest force of a node. Then this state is step n. Of the
        cable's nodes those `held` by friction have what they need of its force, at most mu N."""
        Y = self.places()
        parts = [-self.pressure_forces(pressure)]
        for group in self.groups:
            parts.append(gradient(group.work, group.points, Y))
        folded = self.groups[1].points
        parts.append(gradient(self.penalty, folded, Y))
        own, rubbing = np.zeros_like(Y), np.zeros_like(Y)
        segments = np.diff(Y[self.nv :], axis=0)
        pulls = (self.tension + self.change_of_tension(Y)) * segments / norm(segments)[:, None]
        own[self.nv + 1 :] += pulls
        own[self.nv : -1] -= pulls
        parts.append(own)
        G = np.sum(parts, axis=0)
        for one in self.friction_elements() if self.friction else ():
            way = (Y - self.X)[one.point] - (Y - self.X)[one.vertex]
            force = one.force * np.sign(one.direction @ way)
            if one.point - self.nv in held:
                force = -float(one.direction @ G[one.point])
                assert abs(force) <= one.force * (1 + 1e-9)
            rubbing[one.point] += force * one.direction
            rubbing[one.vertex] -= force * one.direction
        parts.append(rubbing)
        G += rubbing
        free = np.ones(Y.shape, dtype=bool)
        free[: self.nv] = ~self._of_all(self.scene.held)
        free[[self.nv, -1]] = False
        self.tension += self.change_of_tension(Y)
        for group in self.groups:
            group.end_step(Y[group.points])
        self.X = Y
        return G[free], max(float(np.abs(part).max()) for part in parts)


def gradient(work: Callable[[Array], Array], points: Array, Y: Array) -> Array:
    """Derivatives (n, 3) of the sum of elements' works by all places."""
    G = np.zeros_like(Y)
    P = Y[points].astype(complex)
    for m in range(points.shape[1]):
        for axis in range(3):
            P[:, m, axis] += 1j * STEP
            np.add.at(G[:, axis], points[:, m], work(P).imag / STEP)
            P[:, m, axis] = P[:, m, axis].real
    return G
