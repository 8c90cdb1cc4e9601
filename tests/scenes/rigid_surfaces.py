"""Rigid surfaces with cables on curves that friction can just hold, known by formulas.

A cable in tension stays where |geodesic curvature| <= mu * normal curvature. So it is laid along a
curve of constant ratio of the two: it stays if the ratio is below mu, else it slides as a whole and
ends on the curve of ratio mu between the same ends. Sizes are about 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from grids import numbered, triangles
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.spatial import Delaunay, cKDTree

from crms_fenicsx import Cable, Friction, IsotropicMembrane, LaidCable, Scene, meshes
from crms_fenicsx.model.materials import MembraneMaterial

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mesh = tuple[Floats, Ints]

KINDS = ("jittered", "structured", "delaunay", "lattice")
STIFF = IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False)
"""Beside it cables of EA = 1 are soft: the edges that they fold bend by .0005 of their length."""


@dataclass(frozen=True)
class Surface:
    """A smooth surface {F = 0}, its outside where F > 0.

    Attributes
    ----------
    place, parameters
        x(u, v), (..., 3), its normal x_u x x_v to the outside, and its inverse.
    gradient, bend
        Of F at x; and its second derivative along t, t.H(x).t.
    middle, course
        Parameters of the middle of the curves on it, and their angle to the u lines there.
    inside
        Whether the membrane's outer side is the inside, where F < 0; cables there are in sleeves.
    """

    place: Callable[[Floats, Floats], Floats]
    parameters: Callable[[Floats], tuple[Floats, Floats]]
    gradient: Callable[[Floats], Floats]
    bend: Callable[[Floats, Floats], float]
    middle: tuple[float, float]
    course: float
    inside: bool = False


def ellipsoid(a: float, b: float, c: float, middle: tuple[float, float], course: float) -> Surface:
    """Longitude u, latitude v."""
    axes = np.array([a, b, c])
    return Surface(
        lambda u, v: axes * np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], -1),
        lambda x: (np.arctan2(x[..., 1] / b, x[..., 0] / a), np.arcsin(x[..., 2] / c)),
        lambda x: 2 * x / axes**2,
        lambda x, t: float(2 * np.sum(t**2 / axes**2)),
        middle,
        course,
    )


def torus(R: float, r: float, middle: tuple[float, float], course: float) -> Surface:
    """Angle u about the z axis, v about the circle of radius R."""

    def place(u: Floats, v: Floats) -> Floats:
        out = R + r * np.cos(v)
        return np.stack([out * np.cos(u), out * np.sin(u), r * np.sin(v)], axis=-1)

    def parameters(x: Floats) -> tuple[Floats, Floats]:
        away = np.hypot(x[..., 0], x[..., 1]) - R
        return np.arctan2(x[..., 1], x[..., 0]), np.arctan2(x[..., 2], away)

    def gradient(x: Floats) -> Floats:
        away = 1 - R / np.hypot(x[..., 0], x[..., 1])
        return 2 * np.stack([away * x[..., 0], away * x[..., 1], x[..., 2]], axis=-1)

    def bend(x: Floats, t: Floats) -> float:
        out = float(np.hypot(x[0], x[1]))
        radial = (x[0] * t[0] + x[1] * t[1]) / out
        around = t[0] ** 2 + t[1] ** 2 - radial**2
        return float(2 * (radial**2 + (1 - R / out) * around + t[2] ** 2))

    return Surface(place, parameters, gradient, bend, middle, course)


def sphere(latitude: float) -> Surface:
    """A unit sphere, with the circle of a latitude (rad): its ratio is tan(latitude)."""
    return ellipsoid(1.0, 1.0, 1.0, (0.0, latitude), 0.0)


def hyperboloid() -> Surface:
    """Angle u about the z axis, where it bends outward; along v it bends inward: a saddle."""
    return Surface(
        lambda u, v: np.stack([np.cosh(v) * np.cos(u), np.cosh(v) * np.sin(u), np.sinh(v)], -1),
        lambda x: (np.arctan2(x[..., 1], x[..., 0]), np.arcsinh(x[..., 2])),
        lambda x: 2 * x * (1.0, 1.0, -1.0),
        lambda x, t: float(2 * (t[0] ** 2 + t[1] ** 2 - t[2] ** 2)),
        (0.0, 0.0),
        0.2,
    )


def cylinder(inside: bool = False) -> Surface:
    """Angle u about the y axis, v along it; on top."""
    return Surface(
        lambda u, v: np.stack([np.sin(u), v, np.cos(u)], axis=-1),
        lambda x: (np.arctan2(x[..., 0], x[..., 2]), x[..., 1]),
        lambda x: 2 * x * (1.0, 0.0, 1.0),
        lambda x, t: float(2 * (t[0] ** 2 + t[2] ** 2)),
        (0.0, 0.0),
        0.3,
        inside,
    )


SURFACES = {
    "cylinder": cylinder(),
    "ellipsoid": ellipsoid(1.0, 0.8, 0.6, (0.3, 0.6), 0.2),
    "torus": torus(1.0, 0.5, (0.0, 0.0), 0.2),
    "saddle": hyperboloid(),
    "concave cylinder": cylinder(inside=True),
}


@dataclass(frozen=True)
class Curve:
    """A curve of constant ratio of geodesic to normal curvature; it turns to its left."""

    surface: Surface
    ratio: float
    points: Floats
    tangents: Floats

    @cached_property
    def length(self) -> float:
        """Of the smooth curve; the chords between its points are shorter by 1e-5 at most."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def sideways(self, polyline: Floats, n: int = 401) -> Floats:
        """Distances of evenly spaced points of a polyline from the curve, to the left, (n,)."""
        x = resampled(polyline, n)
        k = np.asarray(cKDTree(self.points).query(x)[1])
        up = self.surface.gradient(self.points[k])
        left = np.cross(up, self.tangents[k])
        left /= np.linalg.norm(left, axis=1)[:, None]
        aside: Floats = np.sum((x - self.points[k]) * left, axis=1)
        return aside

    def slid(self, mu: float) -> Curve:
        """The curve of ratio mu between the same ends."""
        a, b = self.points[0], self.points[-1]
        frame = [np.linalg.svd(self.surface.gradient(x)[None])[2][1:] for x in (a, b)]
        first = frame[0] @ self.tangents[0]

        def reach(unknowns: Floats, n: int) -> Curve:
            t = np.array([np.cos(unknowns[0]), np.sin(unknowns[0])]) @ frame[0]
            return _follow(self.surface, mu, a, t, float(unknowns[1]), n)

        result = root(
            lambda q: frame[1] @ (reach(q, 2).points[-1] - b),
            [np.arctan2(first[1], first[0]), self.length],
            tol=1e-9,
        )
        if np.any(np.abs(result.fun) > 1e-8):  # too far for one go
            assert abs(mu - self.ratio) > 1e-3, result.message
            return self.slid((mu + self.ratio) / 2).slid(mu)
        return reach(result.x, len(self.points))

    def coefficient_of(self, polyline: Floats) -> float:
        """Friction coefficient with which an exact cable would have slid as far, in the mean.

        It is told up to the ratio of this curve, at which a cable stays; much beyond there may be
        no curve between the same ends.
        """
        found = float(self.sideways(polyline).mean())
        mu = self.ratio * np.array([0.75, 0.85, 0.95, 1.0])
        exact = np.array([self.sideways(self.slid(float(m)).points).mean() for m in mu])
        return float(np.interp(-found, -exact, mu))


def curve(surface: Surface, ratio: float, half: float, n: int = 401) -> Curve:
    """The curve of a ratio through the surface's middle, `half` to either side (length)."""
    u, v = (np.array(value) for value in surface.middle)
    x, e = surface.place(u, v), 1e-6
    along = surface.place(u + e, v) - x
    along /= np.linalg.norm(along)
    across = np.cross(surface.gradient(x), along)
    across /= np.linalg.norm(across)
    t = np.cos(surface.course) * along + np.sin(surface.course) * across
    there = _follow(surface, ratio, x, t, half, n)
    back = _follow(surface, -ratio, x, -t, half, n)  # what turned left turns right on the way back
    points = np.concatenate([back.points[:0:-1], there.points])
    tangents = np.concatenate([-back.tangents[:0:-1], there.tangents])
    return Curve(surface, ratio, points, tangents)


def _follow(surface: Surface, ratio: float, x: Floats, t: Floats, far: float, n: int) -> Curve:
    """The curve that starts at x in the direction t."""

    def motion(_: float, state: Floats) -> Floats:
        x, t = state[:3], state[3:]
        g = surface.gradient(x)
        size = float(np.linalg.norm(g))
        bend = surface.bend(x, t) / size
        return np.concatenate([t, bend * (ratio * np.cross(g, t) - g) / size])

    at = np.linspace(0.0, far, n)
    way = solve_ivp(
        motion, (0.0, far), np.r_[x, t], t_eval=at, method="DOP853", rtol=1e-11, atol=1e-12
    )
    return Curve(surface, ratio, way.y[:3].T, way.y[3:].T)


def resampled(polyline: Floats, n: int) -> Floats:
    """Evenly spaced points of a polyline, (n, 3)."""
    steps = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, arc[-1], n)
    return np.stack([np.interp(at, arc, polyline[:, i]) for i in range(3)], axis=1)


def band(
    way: Curve, h: float, seed: int, kind: str = "jittered", turn: float | None = None
) -> Mesh:
    """A mesh of cells of size h around a curve: a lattice that is turned and shifted against it.

    Curvature sits in the vertices of a mesh. Rows of them along the cable would make the strip
    between two rows a developable surface, over which the ratio does not change.

    Parameters
    ----------
    way
        The curve.
    h
        Size of the cells (length).
    seed
        Of the lattice's turn and shift, and of what shakes it.
    kind
        "jittered", "structured" (all squares cut by the same diagonal), "delaunay" or "lattice" (of
        equilateral triangles).
    turn
        Angle (rad) to the curve's middle; None: at random, .2 to .6.
    """
    rng = np.random.default_rng(seed)
    surface, e = way.surface, 1e-6
    u, v = (np.array(value) for value in surface.middle)
    x = surface.place(u, v)
    su = float(np.linalg.norm(surface.place(u + e, v) - x)) / e
    sv = float(np.linalg.norm(surface.place(u, v + e) - x)) / e
    scale = h / np.array([su, sv])
    angle = rng.uniform(0.2, 0.6) if turn is None else turn
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s], [s, c]])
    plan = (np.stack(surface.parameters(way.points), axis=-1) - (u, v)) / scale @ R
    low, high = np.floor(plan.min(axis=0)) - 9, np.ceil(plan.max(axis=0)) + 9
    n = (high - low).astype(int)
    i, j = np.meshgrid(np.arange(n[0] + 1), np.arange(n[1] + 1), indexing="ij")
    points = np.stack([i, j], axis=-1).reshape(-1, 2).astype(float)
    if kind == "lattice":
        points = (points + np.outer(j.ravel() % 2, (0.5, 0.0))) * (1.0, 0.75**0.5)
    elif kind in ("jittered", "delaunay"):
        points += rng.uniform(-0.3, 0.3, points.shape)
    points += low + rng.uniform(-0.5, 0.5, 2)
    if kind in ("delaunay", "lattice"):
        cells = Delaunay(points).simplices.astype(np.int64)
        a, b = points[cells[:, 1]] - points[cells[:, 0]], points[cells[:, 2]] - points[cells[:, 0]]
        turned = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
        cells[turned] = cells[turned, ::-1]
    else:
        cells = triangles(numbered(*i.shape))
    aside = np.asarray(cKDTree(plan).query(points[cells].mean(axis=1))[0])
    cells = cells[aside < 3.0 + 0.15 / h]
    used, numbers = np.unique(cells, return_inverse=True)
    u, v = (points[used] @ R.T * scale + (u, v)).T
    return surface.place(u, v), numbers.reshape(-1, 3)


def rigid(
    comm: MPI.Intracomm,
    way: Curve,
    mesh: Mesh,
    friction: float | Friction,
    EA: float = 1.0,
    path: Floats | None = None,
    material: MembraneMaterial = STIFF,
) -> tuple[Scene, LaidCable]:
    """A rigid surface with a cable along a curve, or another path, tied to it at its ends."""
    outside = way.surface.gradient(way.points[len(way.points) // 2])
    outside *= -1.0 if way.surface.inside else 1.0
    membrane = meshes.from_arrays(comm, *mesh, outside=tuple(float(x) for x in outside))
    scene = Scene(membrane, material)
    scene.fix(lambda x: np.full(x.shape[1], True))
    route = way.points[::16] if path is None else path  # chords of it are 1e-4 off the curve
    sleeve = way.surface.inside
    return scene, scene.lay_cable(
        Cable(EA=EA, friction=friction), route, hold="sleeve" if sleeve else "outside"
    )
