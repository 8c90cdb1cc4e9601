"""A rope over a rigid drum, and the exact state of an elastic rope with friction on it.

The drum is a half cylinder of radius 1 around the x axis. The rope lies across it and leaves it
along its tangents, straight down on both sides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from grids import numbered, triangles
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import Cable, Friction, IsotropicMembrane, LaidCable, Scene, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array

EA, FREE, WRAP = 1000.0, 0.5, np.pi
"""Axial stiffness of the rope, length of its free ends, angle of wrap."""


def drum(comm: MPI.Intracomm, n: int, jitter: float = 0.0, scale: float = 1.0) -> MembraneMesh:
    """The drum with n cells around it, its inner vertices moved by parts of a cell at random."""
    rows, rng = 4, np.random.default_rng(n)
    i, j = np.meshgrid(np.arange(rows + 1), np.arange(n + 1), indexing="ij")
    inner = (i > 0) & (i < rows) & (j > 0) & (j < n)
    x = (i + inner * jitter * rng.uniform(-1, 1, i.shape)) / rows * 0.4 - 0.2
    angle = (j + inner * jitter * rng.uniform(-1, 1, j.shape)) / n * WRAP - WRAP / 2
    points = scale * np.stack([x, np.sin(angle), np.cos(angle)], axis=-1).reshape(-1, 3)
    cells = triangles(numbered(*i.shape))
    sides = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    edges = {"drum": np.unique(np.sort(sides, axis=1), axis=0)}
    return meshes.from_arrays(comm, points, cells, edges=edges)


def roped(
    comm: MPI.Intracomm,
    n: int,
    along: float,
    *,
    tension: float | None = None,
    jitter: float = 0.0,
    scale: float = 1.0,
    force: float = 1.0,
    mu: float = 0.0,
    cone: bool = False,
) -> tuple[Scene, LaidCable]:
    """A rope over a drum; `scale` and `force` are the units of length and force."""
    scene = Scene(
        drum(comm, n, jitter, scale),
        IsotropicMembrane(E=1e6 * force / scale**2, nu=0.3, thickness=scale, wrinkling=False),
    )
    scene.fix("drum")
    angle = np.linspace(-WRAP / 2, WRAP / 2, 41)
    path = np.column_stack([np.full(41, 0.03), np.sin(angle), np.cos(angle)])
    path = np.vstack([path[0] - (0, 0, FREE), path, path[-1] - (0, 0, FREE)])
    friction = Friction(mu, along=along, cone=cone)
    cable = scene.lay_cable(
        Cable(EA * force, friction=friction),
        scale * path,
        tension=None if tension is None else tension * force,
    )
    return scene, cable


def places(cable: LaidCable) -> Array:
    """Angle around the drum at the middle of each straight part of the rope, 0 ... pi."""
    x = cable.state.positions[cable.contacts()]
    middle = (x[1:] + x[:-1]) / 2
    angle = np.arctan2(middle[:, 1], middle[:, 2]) + WRAP / 2
    angle[0], angle[-1] = 0.0, WRAP
    return np.asarray(angle)


AROUND = np.linspace(0.0, WRAP, 4001)


def exact_tensions(tension: float, mu: float, pulls: Sequence[float]) -> Array:
    """Tensions at the angles `AROUND` after pulls at the rope's end, positive outwards.

    As long as the rope sticks somewhere: there it keeps its tension, and from the end on it slides
    with T proportional to exp(+- mu angle). The unstressed length from the sticking part to the
    end stays the same.
    """
    T, free = np.full_like(AROUND, tension), FREE

    def unstressed(T: Array, free: float) -> float:
        return float(np.trapezoid(1 / (1 + T / EA), AROUND) + free / (1 + T[-1] / EA))

    def pulled(end: float, T: Array, outwards: bool) -> Array:
        way = mu * (WRAP - AROUND)
        return np.maximum(T, end * np.exp(-way)) if outwards else np.minimum(T, end * np.exp(way))

    for pull in pulls:
        before, free = unstressed(T, free), free + pull

        def surplus(
            end: float, before: float = before, T: Array = T, free: float = free, pull: float = pull
        ) -> float:
            return unstressed(pulled(end, T, pull > 0), free) - before

        limits = (T[-1], 1e3 * tension) if pull > 0 else (1e-9 * tension, T[-1])
        T = pulled(float(brentq(surplus, *limits, xtol=1e-14)), T, pull > 0)
        assert T[0] == tension, "it slides at its first end as well"
    return T
